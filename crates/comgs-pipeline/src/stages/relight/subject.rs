//! A decomposed object as it lies on disk, and the light it is put under.

use crate::stages::decompose::PROBES_FILE;
use crate::{PipelineError, source};
use comgs_compose::RelightError;
use comgs_light::EnvironmentMap;
use comgs_probe::{ProbeConfig, ProbeError, ProbeSet};
use comgs_scene::{Asset, AssetKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A decomposed object.
pub(crate) struct Subject {
    /// Surfels with material.
    pub asset: Asset,
    /// Probes and how they are looked up; `None` for an object that was decomposed without, and for bare PLYs.
    pub probes: Option<(Arc<ProbeSet>, ProbeConfig)>,
    /// Where it was read from.
    pub path: PathBuf,
}

impl Subject {
    /// Loads an asset, or a PLY of surfels with material.
    ///
    /// # Errors
    /// [`PipelineError::Input`] for surfels without material and for unreadable probes.
    pub fn load(path: &Path) -> Result<Self, PipelineError> {
        let subject = Self::load_any(path)?;
        if subject.asset.surfels.material.is_none() {
            return Err(refused(path, &RelightError::NoMaterial));
        }
        Ok(subject)
    }

    /// Loads an object with or without material.
    ///
    /// # Errors
    /// [`PipelineError`] for what cannot be read.
    pub fn load_any(path: &Path) -> Result<Self, PipelineError> {
        let asset = source::load_surfels(path, AssetKind::Object)?;
        let probes = asset.file(PROBES_FILE).map(|file| read_probes(&file)).transpose()?;
        Ok(Self { asset, probes, path: path.to_owned() })
    }

    /// The probes alone.
    pub fn probe_set(&self) -> Option<&ProbeSet> {
        self.probes.as_ref().map(|(set, _)| &**set)
    }
}

fn read_probes(file: &Path) -> Result<(Arc<ProbeSet>, ProbeConfig), PipelineError> {
    let bytes = std::fs::read(file).map_err(|e| PipelineError::io(file, e))?;
    let read = comgs_probe::from_bytes(&bytes).map(|(set, lookup)| (Arc::new(set), lookup));
    read.map_err(|e| {
        let expected = "probes made by `comgs decompose`";
        PipelineError::input(file.display().to_string(), expected, e.to_string())
    })
}

/// A refusal in the words of the command line.
pub(crate) fn refused(path: &Path, error: &RelightError) -> PipelineError {
    let what = path.display().to_string();
    match error {
        RelightError::NoMaterial => PipelineError::input(
            what,
            "an object with material (run `comgs decompose` first)",
            "surfels without albedo, roughness and metallic",
        ),
        RelightError::Probes(ProbeError::Cancelled { .. }) => PipelineError::Cancelled { kept: None },
        other => {
            let mut got = other.to_string();
            if let Some(reason) = std::error::Error::source(other) {
                got.push_str(&format!(": {reason}"));
            }
            PipelineError::input(what, "an object that can be relit", got)
        }
    }
}

/// Reads an environment map; what was repaired and what is odd is told to `warn`.
///
/// # Errors
/// [`PipelineError::Read`], and [`PipelineError::Light`] for a picture that is no map.
pub(crate) fn read_light(path: &Path, mut warn: impl FnMut(String)) -> Result<EnvironmentMap, PipelineError> {
    let image = comgs_image::read(path)?.color;
    let (map, repaired) = EnvironmentMap::from_image_repaired(&image)
        .map_err(|reason| PipelineError::Light { path: path.to_owned(), reason })?;
    if !repaired.is_clean() {
        warn(format!(
            "{} has unusable samples, which were repaired ({repaired}): NaN by their neighbours, infinite ones by the \
             brightest, negative ones by 0",
            path.display()
        ));
    }
    if map.is_black() {
        warn(format!("{} is black: so will be the pictures", path.display()));
    }
    Ok(map)
}
