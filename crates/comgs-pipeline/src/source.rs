//! What a path given on the command line is, and how it becomes surfels.

use crate::{Fingerprint, PipelineError};
use comgs_raster::RasterConfig;
use comgs_scene::{Asset, AssetKind, asset};
use std::path::{Path, PathBuf};

/// Something that surfels come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// A folder with `asset.json`.
    Asset(PathBuf),
    /// A bare PLY, of ours or published.
    Ply(PathBuf),
    /// Anything else: a capture, to be reconstructed first.
    Capture(PathBuf),
}

impl Source {
    /// Looks at a path.
    ///
    /// # Errors
    /// [`PipelineError::Io`] when there is nothing.
    pub fn of(path: &Path) -> Result<Self, PipelineError> {
        // An asset may be named by its record too.
        let folder = if path.file_name().is_some_and(|n| n == asset::ASSET_FILE) {
            path.parent().unwrap_or(path)
        } else {
            path
        };
        if Asset::is_asset(folder) {
            return Ok(Self::Asset(folder.to_owned()));
        }
        let metadata = std::fs::metadata(path).map_err(|e| PipelineError::io(path, e))?;
        if metadata.is_file() && extension(path) == "ply" {
            return Ok(Self::Ply(path.to_owned()));
        }
        Ok(Self::Capture(path.to_owned()))
    }

    /// The path.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Asset(p) | Self::Ply(p) | Self::Capture(p) => p,
        }
    }

    /// A name for people and files: the folder's or file's, without `.asset` or `.ply`; `object` or `scene` folders
    /// of the SynCom layout are named by their own last part.
    #[must_use]
    pub fn name(&self) -> String {
        name_of(self.path())
    }
}

/// Last part of a path without `.asset` or `.ply`.
#[must_use]
pub fn name_of(path: &Path) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let last = absolute.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let name = last.strip_suffix(".asset").or_else(|| last.strip_suffix(".ply")).unwrap_or(&last);
    if name.is_empty() { "unnamed".to_owned() } else { name.to_owned() }
}

/// Lower-case extension, without the dot.
#[must_use]
pub fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Loads an asset or a PLY. `kind` is what a bare PLY is taken for.
///
/// # Errors
/// [`PipelineError::Scene`] when it cannot be loaded; [`PipelineError::Input`] for a capture, which must be
/// reconstructed first, and for an asset without surfels.
pub fn load_surfels(path: &Path, kind: AssetKind) -> Result<Asset, PipelineError> {
    let asset = match Source::of(path)? {
        Source::Asset(folder) => Asset::load(folder)?,
        Source::Ply(file) => {
            let (cloud, _) = comgs_surfel::ply::read_surfels(&file).map_err(comgs_scene::SceneError::from)?;
            Asset::new(kind, cloud)
        }
        Source::Capture(folder) => {
            return Err(PipelineError::input(
                folder.display().to_string(),
                "an asset (made with `comgs reconstruct`) or a PLY of surfels",
                "a folder without asset.json",
            ));
        }
    };
    if asset.surfels.is_empty() {
        return Err(PipelineError::input(path.display().to_string(), "at least one surfel", "none"));
    }
    Ok(asset)
}

/// Name under which an asset's training record keeps the near plane it was trained with.
pub const NEAR_METRIC: &str = "near";

/// The rasteriser as an asset was trained with it: what training never saw, in front of its near plane, must not be
/// rendered either.
#[must_use]
pub fn raster_config(asset: &Asset) -> RasterConfig {
    let near = asset.record.training.as_ref().and_then(|t| t.metrics.get(NEAR_METRIC));
    let sound = near.filter(|n| n.is_finite() && **n > 0.0);
    let default = RasterConfig::default();
    RasterConfig { near: sound.map_or(default.near, |n| *n as f32), ..default }
}

impl Fingerprint {
    /// Adds what an asset or PLY is: the checksums of its files, its kind and its up, not when or how it was made.
    ///
    /// # Errors
    /// As [`Fingerprint::path`], and when `asset.json` cannot be read.
    pub fn surfels(&mut self, name: &str, path: &Path) -> Result<(), PipelineError> {
        let Source::Asset(folder) = Source::of(path)? else { return self.path(name, path) };
        let file = folder.join(asset::ASSET_FILE);
        let bytes = std::fs::read(&file).map_err(|e| PipelineError::io(&file, e))?;
        let record = asset::parse_record(&bytes, &file)?;
        let content = (record.kind, record.up, record.unit, &record.files);
        self.config(name, &content)
    }
}
