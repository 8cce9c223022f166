//! Completion by a learned model.
//!
//! The network sees the panorama turned so that the brighter side of what is known is in the middle, which makes the
//! result turn with its input: no preferred yaw (a turn by whole texels of the model gives the same texels,
//! `tests/learned.rs`). What it denoises is the bundle's [`Space`]:
//!
//! * *codes*, two a channel ([`crate::codes`]) over the whole sphere; in one step it gives the mean of what may be there, in several
//!   steps a sample of it. The small model that ships with comgs.
//! * *latents* of pictures at several exposures, which are merged ([`crate::brackets`]); the models that are fine-tuned from
//!   Stable Diffusion.

mod latent;
mod pixel;
mod view;

pub use latent::{Latent, Shown};

use crate::CompletionError;
use crate::bundle::{Bundle, Manifest, ModelError, Space};
use crate::completion::over_fill;
use crate::onnx::{Graph, Runtime, Tensor};
use crate::partial::{Completer, Partial, resized};
use comgs_image::Image;
use glam::Vec3;
use pixel::Pixel;

/// A model ready to complete panoramas.
pub struct Learned {
    manifest: Manifest,
    engine: Engine,
    steps: usize,
    runtime: &'static str,
}

enum Engine {
    Pixel(Box<Pixel>),
    Latent(Box<Latent>),
}

/// Several completions of the same panorama.
#[derive(Clone, Debug)]
pub struct Samples {
    /// Their mean, linear radiance.
    pub mean: Image,
    /// Their standard deviation, 3 channels; 0 where the panorama is known.
    pub spread: Image,
    /// Each of them.
    pub all: Vec<Image>,
    /// How many were dropped because the network gave NaN or infinity.
    pub dropped: usize,
}

impl Learned {
    /// The model of a bundle.
    ///
    /// * `steps`: how many the sampler takes; the bundle's own number when `None`
    /// * `threads`: all cores when 0
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn new(
        bundle: &Bundle,
        runtime: &Runtime,
        steps: Option<usize>,
        threads: usize,
    ) -> Result<Self, ModelError> {
        let engine = match &bundle.manifest.space {
            Space::Codes(space) => Engine::Pixel(Box::new(Pixel::load(space, bundle, runtime, threads)?)),
            Space::Latent(_) => Engine::Latent(Box::new(Latent::load(bundle, runtime, threads)?)),
        };
        let manifest = bundle.manifest.clone();
        let steps = steps.unwrap_or(manifest.steps).clamp(1, manifest.schedule.timesteps);
        Ok(Self { manifest, engine, steps, runtime: runtime.name() })
    }

    /// What runs it.
    #[must_use]
    pub fn runtime(&self) -> &'static str {
        self.runtime
    }

    /// The model's manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Completes `count` times with seeds `seed, seed + 1, …`. With one step all are the same.
    ///
    /// # Errors
    /// As [`Completer::complete`]; a sample that is not finite is dropped, and only when none is left an error.
    pub fn samples(&self, partial: &Partial, seed: u64, count: usize) -> Result<Samples, CompletionError> {
        let mut all = Vec::new();
        let mut dropped = 0;
        for k in 0..count.max(1) as u64 {
            match self.complete(partial, seed.wrapping_add(k)) {
                Ok(image) => all.push(image),
                Err(CompletionError::Model(ModelError::NotFinite { .. })) => dropped += 1,
                Err(other) => return Err(other),
            }
        }
        if all.is_empty() {
            return Err(ModelError::NotFinite { tried: dropped }.into());
        }
        let n = all.len() as f64;
        let mut mean = all[0].clone();
        let mut spread = all[0].clone();
        for i in 0..mean.data.len() {
            let values = all.iter().map(|image| f64::from(image.data[i]));
            let m = values.clone().sum::<f64>() / n;
            let variance = values.map(|v| (v - m) * (v - m)).sum::<f64>() / n;
            (mean.data[i], spread.data[i]) = (m as f32, variance.sqrt() as f32);
        }
        Ok(Samples { mean, spread, all, dropped })
    }
}

impl Completer for Learned {
    fn name(&self) -> String {
        if self.steps == 1 {
            self.manifest.name.clone()
        } else {
            format!("{} ({} steps)", self.manifest.name, self.steps)
        }
    }

    fn complete(&self, partial: &Partial, seed: u64) -> Result<Image, CompletionError> {
        partial.check()?;
        let fill = match &self.engine {
            Engine::Pixel(model) => model.fill(&self.manifest, self.steps, partial, seed)?,
            Engine::Latent(model) => model.fill(&self.manifest, self.steps, partial, seed)?,
        };
        let fill = resized(&fill, partial.rgb.width, partial.rgb.height);
        over_fill(partial, &|x, y| Vec3::from(fill.rgb(x, y)).as_dvec3())
    }
}

/// Runs a graph for one output of `n` numbers, all of which must be finite.
fn finite(
    graph: &dyn Graph,
    inputs: &[(&str, Tensor)],
    output: &str,
    n: usize,
) -> Result<Vec<f64>, ModelError> {
    let outputs = graph.run(inputs, &[output])?;
    let values: Vec<f64> = outputs[0].to_f32().iter().map(|&v| f64::from(v)).collect();
    if values.len() != n || values.iter().any(|v| !v.is_finite()) {
        return Err(ModelError::NotFinite { tried: 1 });
    }
    Ok(values)
}
