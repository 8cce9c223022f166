//! Completion by a learned pixel-space model.
//!
//! The network sees the panorama turned so that the brighter side of what is known is in the middle, which makes the
//! result turn with its input: no seam, no preferred yaw (a turn by whole texels of the model gives the same texels,
//! `tests/learned.rs`). It predicts two codes a channel ([`crate::codes`]) over the whole sphere; in one step it gives the
//! mean of what may be there, in several steps a sample of it.

use crate::bundle::{Bundle, Channels, Manifest, ModelError};
use crate::completion::over_fill;
use crate::onnx::{Graph, Runtime, Tensor};
use crate::partial::{Completer, Partial, resized, roll};
use crate::schedule::Sampler;
use crate::simple::known_mean;
use crate::{CompletionError, complete_harmonic};
use comgs_geom::{Rng, equirect};
use comgs_image::Image;
use glam::{Mat3, Vec3};
use std::f64::consts::TAU;

/// A model ready to complete panoramas.
pub struct Learned {
    manifest: Manifest,
    graph: Box<dyn Graph>,
    steps: usize,
    runtime: &'static str,
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
        let graph = bundle.load("denoiser", runtime, threads)?;
        let manifest = bundle.manifest.clone();
        let steps = steps.unwrap_or(manifest.steps).clamp(1, manifest.schedule.timesteps);
        Ok(Self { manifest, graph, steps, runtime: runtime.name() })
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

    /// The network's radiance over the level, codes decoded: `6 · H · W` codes in, image out.
    fn decoded(&self, codes: &[f64], level: f64) -> Result<Image, ModelError> {
        let [width, height] = self.manifest.resolution;
        let n = width * height;
        let mut fill = Image::zeros(width, height, 3);
        for i in 0..n {
            for c in 0..3 {
                let x = self.manifest.codes.decode([codes[c * n + i], codes[(3 + c) * n + i]]);
                if !x.is_finite() {
                    return Err(ModelError::NotFinite { tried: 1 });
                }
                fill.data[3 * i + c] = (x.max(0.0) * level) as f32;
            }
        }
        Ok(fill)
    }

    fn run(&self, condition: &[f32], seed: u64) -> Result<Vec<f64>, ModelError> {
        let [width, height] = self.manifest.resolution;
        let n = 6 * width * height;
        let entry = &self.manifest.graphs["denoiser"];
        let (sample, time) = (&entry.inputs["sample"], &entry.inputs["time"]);
        let (given, prediction) = (&entry.inputs["condition"], &entry.outputs["prediction"]);
        let mut sampler = Sampler::new(&self.manifest.schedule, self.manifest.solver, self.steps);
        let mut rng = Rng::stream(seed, 0x7061_6e6f);
        let noise: Vec<f64> = (0..n).map(|_| f64::from(rng.normal())).collect();
        let mut x = noise.clone();
        let total = self.manifest.schedule.timesteps;
        let mut codes = Vec::new();
        for i in 0..sampler.steps().len() {
            let t = sampler.steps()[i];
            let last = t + 1 == total && self.manifest.zeros_at_last_step;
            let shown: Vec<f32> = if last { vec![0.0; n] } else { x.iter().map(|&v| v as f32).collect() };
            let inputs = [
                (sample.name.as_str(), Tensor::f32(&sample.shape, shown)),
                (time.name.as_str(), Tensor::f32(&time.shape, vec![(t + 1) as f32 / total as f32])),
                (given.name.as_str(), Tensor::f32(&given.shape, condition.to_vec())),
            ];
            let output = self.graph.run(&inputs, &[prediction.name.as_str()])?;
            let output: Vec<f64> = output[0].to_f32().iter().map(|&v| f64::from(v)).collect();
            if output.len() != n || output.iter().any(|v| !v.is_finite()) {
                return Err(ModelError::NotFinite { tried: 1 });
            }
            codes = sampler.split(i, &x, &output).0;
            x = sampler.step(i, &x, &output);
        }
        // What the last step predicts, without what noise its rounding left.
        Ok(codes)
    }
}

/// What the network is given, and how to come back.
struct Prepared {
    condition: Vec<f32>,
    level: f64,
    /// Texels (of the model's size) by which the panorama was turned to the right.
    shift: usize,
}

/// Texels that are known at least this much count as known.
const KNOWN: f32 = 0.5;
/// A texel is clipped when this share of what is known of it was.
const CLIPPED: f32 = 0.25;
/// Radiance below this part of the mean counts as that in the level's geometric mean.
const DARKEST: f64 = 1e-3;

fn prepare(partial: &Partial, manifest: &Manifest) -> Result<Prepared, CompletionError> {
    let [width, height] = manifest.resolution;
    let alpha = resized(&partial.alpha, width, height);
    let rgb = known_mean(partial, width, height);
    let clipped = partial.clipped.as_ref().map(|c| resized(c, width, height));
    let normal = partial.normal.as_ref().map(|n| resized(n, width, height));
    let n = width * height;
    let given = |i: usize| alpha.data[i] > KNOWN;
    let is_clipped =
        |i: usize| given(i) && clipped.as_ref().is_some_and(|c| c.data[i] > CLIPPED * alpha.data[i]);
    let value = |i: usize| rgb.data[3 * i..3 * i + 3].iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0;
    let omega = |i: usize| f64::from(equirect::texel_solid_angle(i / width, width, height));
    let (mut total, mut sum) = (0.0, 0.0);
    for i in (0..n).filter(|&i| given(i)) {
        total += omega(i);
        sum += omega(i) * value(i);
    }
    if total <= 0.0 {
        let largest = partial.alpha.data.iter().copied().fold(0.0, f32::max);
        return Err(CompletionError::NothingSeen { largest });
    }
    let floor = DARKEST * sum / total + 1e-12;
    let logs: f64 = (0..n).filter(|&i| given(i)).map(|i| omega(i) * value(i).max(floor).ln()).sum();
    let level = (logs / total).exp() / manifest.codes.middle;
    // The side of the light, with the bright parts compressed.
    let (mut along_x, mut along_y) = (0.0, 0.0);
    for i in (0..n).filter(|&i| given(i)) {
        let d = equirect::texel_direction(i % width, i / width, width, height);
        let soft = omega(i) * (value(i) / level) / (1.0 + value(i) / level);
        along_x += soft * f64::from(d.x);
        along_y += soft * f64::from(d.y);
    }
    let turns = along_y.atan2(along_x) / TAU * width as f64;
    let shift = (turns + 0.5).floor().rem_euclid(width as f64) as usize % width;
    let turn = Mat3::from_rotation_z(-(shift as f32 / width as f32 * std::f32::consts::TAU));
    let mut condition = Vec::new();
    for group in &manifest.condition {
        let from = condition.len();
        condition.resize(from + group.count() * n, 0.0f32);
        let plane = &mut condition[from..];
        for y in 0..height {
            for x in 0..width {
                let i = y * width + (x + width - shift) % width;
                let at = y * width + x;
                let mut put = |values: [f32; 3]| (0..3).for_each(|c| plane[c * n + at] = values[c]);
                match group {
                    Channels::Reinhard | Channels::Log => {
                        if given(i) {
                            let k = usize::from(*group == Channels::Log);
                            put([0, 1, 2].map(|c| {
                                manifest.codes.encode(f64::from(rgb.data[3 * i + c]) / level)[k] as f32
                            }));
                        }
                    }
                    Channels::Known => plane[at] = f32::from(u8::from(given(i) && !is_clipped(i))),
                    Channels::Clipped => plane[at] = f32::from(u8::from(is_clipped(i))),
                    Channels::Normal => {
                        if let Some(normal) = normal.as_ref().filter(|_| given(i)) {
                            let v = Vec3::from_slice(&normal.data[3 * i..3 * i + 3]);
                            put((turn * v).normalize_or_zero().to_array());
                        }
                    }
                    Channels::Direction => {
                        put(equirect::texel_direction(x, y, width, height).to_array());
                    }
                }
            }
        }
    }
    Ok(Prepared { condition, level, shift })
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
        let prepared = prepare(partial, &self.manifest)?;
        let codes = self.run(&prepared.condition, seed)?;
        let fill = binomial(&self.decoded(&codes, prepared.level)?);
        let [width, _] = self.manifest.resolution;
        let fill = roll(&fill, (width - prepared.shift) % width);
        let fill = joined(partial, &fill)?;
        let fill = resized(&fill, partial.rgb.width, partial.rgb.height);
        over_fill(partial, &|x, y| Vec3::from(fill.rgb(x, y)).as_dvec3())
    }
}

/// A 3 × 3 binomial filter over the sphere (around the azimuth, clamped at the poles). The small network writes four texels from
/// one feature, whose differences are a pattern of dots; the filter is 0 at that frequency and keeps what a lobe gathers.
fn binomial(image: &Image) -> Image {
    let (width, height) = (image.width, image.height);
    let mut out = image.clone();
    for y in 0..height {
        for x in 0..width {
            let mut sum = [0.0f32; 3];
            for (v, wy) in [(y.saturating_sub(1), 1.0), (y, 2.0), ((y + 1).min(height - 1), 1.0)] {
                for (u, wx) in [((x + width - 1) % width, 1.0), (x, 2.0), ((x + 1) % width, 1.0)] {
                    let weight = wx * wy / 16.0;
                    for (s, c) in sum.iter_mut().zip(image.rgb(u, v)) {
                        *s += weight * c;
                    }
                }
            }
            out.pixel_mut(x, y).copy_from_slice(&sum);
        }
    }
    out
}

/// σ of the joint. On maps of neither training nor judgement, before the filter above, 0 / 12 / 25 / 45° gave si-RMSE of the mirror sphere 1.66 / 1.62 /
/// 1.61 / 1.60, glossy 0.317 / 0.315 / 0.324 / 0.337, diffuse 0.084 / 0.087 / 0.093 / 0.107 at 40–60 % coverage.
const JOINED_DEG: f32 = 12.0;

/// The network's fill joined to what is known: near it the harmonic completion, which has no seam and interpolates small
/// holes better; far from it the network's. Mixed in the logarithm with the weight `1 − exp(−(d/σ)²)`, d the angle to the
/// nearest known texel.
fn joined(partial: &Partial, fill: &Image) -> Result<Image, CompletionError> {
    let (width, height) = (fill.width, fill.height);
    let alpha = resized(&partial.alpha, width, height);
    let known = Partial { rgb: known_mean(partial, width, height), alpha, normal: None, clipped: None };
    let smooth = complete_harmonic(&known.rgb, &known.alpha)?;
    let direction = |i: usize| equirect::texel_direction(i % width, i / width, width, height);
    let seen = |i: usize| known.alpha.data[i] > KNOWN;
    // Only the border of what is known can be nearest.
    let border: Vec<Vec3> = (0..width * height)
        .filter(|&i| {
            let (x, y) = (i % width, i / width);
            let near = [
                y * width + (x + 1) % width,
                y * width + (x + width - 1) % width,
                y.saturating_sub(1) * width + x,
                (y + 1).min(height - 1) * width + x,
            ];
            seen(i) && near.iter().any(|&j| !seen(j))
        })
        .map(direction)
        .collect();
    let mut out = fill.clone();
    for (i, pixel) in out.data.chunks_exact_mut(3).enumerate() {
        if seen(i) {
            continue;
        }
        let d = direction(i);
        let cos = border.iter().map(|b| b.dot(d)).fold(-1.0, f32::max);
        let angle = cos.clamp(-1.0, 1.0).acos().to_degrees();
        let weight = 1.0 - (-(angle / JOINED_DEG).powi(2)).exp();
        for (v, s) in pixel.iter_mut().zip(&smooth.data[3 * i..3 * i + 3]) {
            *v = (weight * v.max(1e-9).ln() + (1.0 - weight) * s.max(1e-9).ln()).exp();
        }
    }
    Ok(out)
}
