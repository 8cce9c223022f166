//! A pixel-space model of high dynamic range.

use super::view::{KNOWN, View};
use crate::bundle::{Bundle, Channels, CodesSpace, GraphEntry, Manifest, ModelError};
use crate::onnx::{Graph, Runtime, Tensor};
use crate::partial::{Partial, resized};
use crate::schedule::Sampler;
use crate::simple::known_mean;
use crate::{CompletionError, complete_harmonic};
use comgs_geom::{Rng, equirect};
use comgs_image::Image;
use glam::Vec3;

/// Network and its space.
pub(super) struct Pixel {
    space: CodesSpace,
    entry: GraphEntry,
    graph: Box<dyn Graph>,
}

impl Pixel {
    pub fn load(
        space: &CodesSpace,
        bundle: &Bundle,
        runtime: &Runtime,
        threads: usize,
    ) -> Result<Self, ModelError> {
        let graph = bundle.load("denoiser", runtime, threads)?;
        Ok(Self { space: space.clone(), entry: bundle.manifest.graphs["denoiser"].clone(), graph })
    }

    /// Linear radiance of the whole sphere at the model's size, in the panorama's own yaw.
    pub fn fill(
        &self,
        manifest: &Manifest,
        steps: usize,
        partial: &Partial,
        seed: u64,
    ) -> Result<Image, CompletionError> {
        let view = View::new(partial, manifest.resolution, self.space.codes.middle)?;
        let level = view.geometric_mean / self.space.codes.middle;
        let codes = self.run(manifest, steps, &self.condition(&view, level), seed)?;
        let fill = self.decoded(&codes, &view, level)?;
        joined(partial, &view.back(&binomial(&fill)))
    }

    /// The network's radiance over the level, codes decoded: `6 · H · W` codes in, image out.
    fn decoded(&self, codes: &[f64], view: &View, level: f64) -> Result<Image, ModelError> {
        let n = view.width * view.height;
        let mut fill = Image::zeros(view.width, view.height, 3);
        for i in 0..n {
            for c in 0..3 {
                let x = self.space.codes.decode([codes[c * n + i], codes[(3 + c) * n + i]]);
                if !x.is_finite() {
                    return Err(ModelError::NotFinite { tried: 1 });
                }
                fill.data[3 * i + c] = (x.max(0.0) * level) as f32;
            }
        }
        Ok(fill)
    }

    fn run(
        &self,
        manifest: &Manifest,
        steps: usize,
        condition: &[f32],
        seed: u64,
    ) -> Result<Vec<f64>, ModelError> {
        let [width, height] = manifest.resolution;
        let n = 6 * width * height;
        let entry = &self.entry;
        let (sample, time) = (&entry.inputs["sample"], &entry.inputs["time"]);
        let (given, prediction) = (&entry.inputs["condition"], &entry.outputs["prediction"]);
        let mut sampler = Sampler::new(&manifest.schedule, manifest.solver, steps);
        let mut rng = Rng::stream(seed, 0x7061_6e6f);
        let mut x: Vec<f64> = (0..n).map(|_| f64::from(rng.normal())).collect();
        let total = manifest.schedule.timesteps;
        let mut codes = Vec::new();
        for i in 0..sampler.steps().len() {
            let t = sampler.steps()[i];
            let last = t + 1 == total && self.space.zeros_at_last_step;
            let shown: Vec<f32> = if last { vec![0.0; n] } else { x.iter().map(|&v| v as f32).collect() };
            let inputs = [
                (sample.name.as_str(), Tensor::f32(&sample.shape, shown)),
                (time.name.as_str(), Tensor::f32(&time.shape, vec![(t + 1) as f32 / total as f32])),
                (given.name.as_str(), Tensor::f32(&given.shape, condition.to_vec())),
            ];
            let output = super::finite(&*self.graph, &inputs, &prediction.name, n)?;
            codes = sampler.split(i, &x, &output).0;
            x = sampler.step(i, &x, &output);
        }
        // What the last step predicts, without what noise its rounding left.
        Ok(codes)
    }

    /// The condition's planes, one after the other.
    fn condition(&self, view: &View, level: f64) -> Vec<f32> {
        let (width, height) = (view.width, view.height);
        let n = width * height;
        let mut condition = Vec::new();
        for group in &self.space.condition {
            let from = condition.len();
            condition.resize(from + group.count() * n, 0.0f32);
            let plane = &mut condition[from..];
            for i in 0..n {
                let mut put = |values: [f32; 3]| (0..3).for_each(|c| plane[c * n + i] = values[c]);
                match group {
                    Channels::Reinhard | Channels::Log => {
                        if view.given[i] {
                            let k = usize::from(*group == Channels::Log);
                            put([0, 1, 2].map(|c| {
                                self.space.codes.encode(f64::from(view.rgb.data[3 * i + c]) / level)[k] as f32
                            }));
                        }
                    }
                    Channels::Known => plane[i] = f32::from(u8::from(view.given[i] && !view.clipped[i])),
                    Channels::Clipped => plane[i] = f32::from(u8::from(view.clipped[i])),
                    Channels::Normal => {
                        if let Some(normal) = &view.normal {
                            put([0, 1, 2].map(|c| normal.data[3 * i + c]));
                        }
                    }
                    Channels::Direction => {
                        put(equirect::texel_direction(i % width, i / width, width, height).to_array());
                    }
                }
            }
        }
        condition
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
