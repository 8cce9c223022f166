//! Which completer fills a panorama, and how a learned one is run.

use crate::{Context, PipelineError, Run};
use comgs_image::Image;
use comgs_panorama::{
    Bundle, Completer, Constant, Harmonic, Learned, ModelError, Nothing, Partial, Runtime, Samples,
    SphericalHarmonics,
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// How what was never seen is filled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Fill {
    /// A learned model; the one that ships with comgs unless another is named.
    #[default]
    Diffusion,
    /// The smoothest field of log radiance that agrees with what was seen.
    Harmonic,
    /// Spherical harmonics of degree 3 by ridge regression.
    Sh,
    /// The mean of what was seen.
    Constant,
    /// Black.
    None,
}

/// How a learned model is run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ModelConfig {
    /// Folder of the bundle; the shipped one when absent.
    pub model: Option<PathBuf>,
    /// ONNX Runtime's shared library; when absent the one that `ORT_DYLIB_PATH` names, or the embedded runtime.
    pub onnxruntime: Option<PathBuf>,
    /// Sampling steps; the bundle's own when absent.
    pub steps: Option<usize>,
    /// Completions to make.
    pub samples: usize,
    /// Seed of the first.
    pub seed: u64,
    /// What to use, with a warning, when the model cannot be run; an error when absent.
    pub fallback: Option<Fill>,
}

impl ModelConfig {
    /// The shipped model, once.
    #[must_use]
    pub fn shipped() -> Self {
        Self { samples: 1, ..Self::default() }
    }

    /// The runtime asked for.
    #[must_use]
    pub fn runtime(&self) -> Runtime {
        let named = || std::env::var_os("ORT_DYLIB_PATH").filter(|p| !p.is_empty()).map(PathBuf::from);
        self.onnxruntime.clone().or_else(named).map_or(Runtime::Embedded, Runtime::Native)
    }

    /// Reads and loads the model.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn load(&self) -> Result<Learned, ModelError> {
        let bundle = match &self.model {
            Some(folder) => read_bundle(folder)?,
            None => Bundle::shipped()?,
        };
        Learned::new(&bundle, &self.runtime(), self.steps, 0)
    }
}

/// Manifests are small.
const LARGEST_MANIFEST: u64 = 1 << 20;

/// Reads a bundle's folder.
///
/// # Errors
/// [`ModelError`]: a file that is missing or damaged, a manifest that is none.
pub fn read_bundle(folder: &Path) -> Result<Bundle, ModelError> {
    let path = folder.join("model.json");
    let failed = |reason: String| ModelError::Read { path: path.clone(), reason };
    let size = std::fs::metadata(&path).map_err(|e| failed(e.to_string()))?.len();
    if size > LARGEST_MANIFEST {
        return Err(failed(format!("{size} bytes are too many for a manifest")));
    }
    let manifest = std::fs::read(&path).map_err(|e| failed(e.to_string()))?;
    Bundle::from_parts(&manifest, &path, &|file| std::fs::read(folder.join(file)))
}

/// A completed panorama.
#[derive(Clone, Debug)]
pub struct Completed {
    /// Linear radiance, everywhere.
    pub image: Image,
    /// Standard deviation over the samples, when there are several.
    pub spread: Option<Image>,
    /// The samples, when there are several.
    pub samples: Vec<Image>,
    /// What filled it.
    pub by: String,
    /// What ran it.
    pub runtime: Option<String>,
}

/// A completer without learning; `None` for the learned one.
#[must_use]
pub fn simple(fill: Fill) -> Option<Box<dyn Completer>> {
    Some(match fill {
        Fill::Diffusion => return None,
        Fill::Harmonic => Box::new(Harmonic),
        Fill::Sh => Box::new(SphericalHarmonics::default()),
        Fill::Constant => Box::new(Constant),
        Fill::None => Box::new(Nothing),
    })
}

/// Completes a panorama as asked. A fallback is used only when the configuration names one, and never silently.
///
/// # Errors
/// [`PipelineError::Panorama`].
pub fn complete(
    partial: &Partial,
    fill: Fill,
    model: &ModelConfig,
    run: &mut Run,
    context: &Context<'_>,
) -> Result<Completed, PipelineError> {
    if let Some(completer) = simple(fill) {
        let image = completer.complete(partial, model.seed)?;
        return Ok(Completed {
            image,
            spread: None,
            samples: Vec::new(),
            by: completer.name(),
            runtime: None,
        });
    }
    let learned = model.load().map_err(comgs_panorama::CompletionError::from);
    let outcome = learned.and_then(|l| l.samples(partial, model.seed, model.samples).map(|s| (l, s)));
    match (outcome, model.fallback) {
        (Ok((learned, Samples { mean, spread, all, dropped })), _) => {
            if dropped > 0 {
                run.warn(context, format!("{dropped} samples of the model were no numbers and were dropped"));
            }
            let several = all.len() > 1;
            Ok(Completed {
                image: mean,
                spread: several.then_some(spread),
                samples: if several { all } else { Vec::new() },
                by: learned.name(),
                runtime: Some(learned.runtime().to_owned()),
            })
        }
        (Err(comgs_panorama::CompletionError::Model(reason)), Some(fallback))
            if fallback != Fill::Diffusion =>
        {
            run.warn(
                context,
                format!("the model cannot be used, so the completion is {fallback:?}: {reason}"),
            );
            complete(partial, fallback, model, run, context)
        }
        (Err(reason), _) => Err(reason.into()),
    }
}
