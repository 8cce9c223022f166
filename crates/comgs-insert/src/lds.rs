//! Score distillation with two denoisers (DiPIR Eq. 8), through ONNX graphs alone.
//!
//! ```text
//! ∇ = E[ w(t) (ε_personalised(z_t, t, c) − ε_base(z_t, t, ∅)) ∂z_t/∂φ ],   z_t = √ᾱ z + √(1−ᾱ) ε,   w = 1 − ᾱ
//! ```
//!
//! z is the crop of the composite, at the models' size and coded as they expect it; for a latent model what the encoder makes of it, whose
//! vector–Jacobian product is a graph of its own. The strength t/T is uniform up to a bound that falls from 0.6 to 0.3 over the optimisation.

mod manifest;

pub use manifest::{
    ContextEntry, GuidanceBundle, GuidanceError, GuidanceManifest, Latent, Plane, PortSpec, Term,
};

use crate::composite::Crop;
use crate::error::InsertError;
use crate::guidance::{Guidance, Pull, View};
use crate::transport::Foreground;
use comgs_geom::Rng;
use comgs_image::Image;
use comgs_image::transfer::{srgb_from_linear, srgb_slope};
use comgs_panorama::onnx::{Graph, OnnxError, Runtime, Tensor};
use comgs_panorama::schedule::Prediction;

/// Strength of the noise at the first and at the last iteration, at most (DiPIR, "Training details").
const STRONGEST: [f32; 2] = [0.6, 0.3];
/// And at least: below it there is nothing to denoise.
const WEAKEST: f32 = 0.02;

/// Weight of the guidance against the regularisers, as that of [`crate::guidance::Reference`] by pixel of the models.
const WEIGHT: f32 = 300.0;

/// Guidance by score distillation.
pub struct Distillation<'a> {
    manifest: GuidanceManifest,
    graphs: Vec<Box<dyn Graph>>,
    base: Side,
    personalised: Side,
    encoder: Option<[usize; 2]>,
    /// √ᾱ² by step.
    signal: Vec<f64>,
    photo: &'a Image,
    foreground: &'a Foreground,
    seed: u64,
}

/// One of the two terms: which graph, and what it is told.
struct Side {
    graph: usize,
    term: Term,
    context: Option<Tensor>,
}

impl<'a> Distillation<'a> {
    /// Loads the graphs of a bundle.
    ///
    /// * `prompt`: which of the bundle's contexts the personalised model is told; its own choice when `None`
    /// * `photo`, `foreground`: what conditions are made from; linear
    ///
    /// # Errors
    /// [`GuidanceError`]: a graph that is missing, damaged or not as declared, a prompt that the bundle does not have.
    pub fn new(
        bundle: &GuidanceBundle,
        runtime: &Runtime,
        prompt: Option<&str>,
        photo: &'a Image,
        foreground: &'a Foreground,
        seed: u64,
    ) -> Result<Self, GuidanceError> {
        let mut loaded: Vec<(String, Box<dyn Graph>)> = Vec::new();
        let mut graph = |role: &str| -> Result<usize, GuidanceError> {
            if let Some(k) = loaded.iter().position(|(name, _)| name == role) {
                return Ok(k);
            }
            loaded.push((role.to_owned(), bundle.load(role, runtime)?));
            Ok(loaded.len() - 1)
        };
        let manifest = bundle.manifest.clone();
        let mut side = |term: &Term, context: Option<&str>| -> Result<Side, GuidanceError> {
            let context = context.map(|name| bundle.context(name)).transpose()?;
            Ok(Side { graph: graph(&term.graph)?, term: term.clone(), context })
        };
        let chosen = match prompt {
            None => manifest.personalised.context.clone(),
            Some(text) => Some(bundle.context_of(text)?),
        };
        let base = side(&manifest.base, manifest.base.context.as_deref())?;
        let personalised = side(&manifest.personalised, chosen.as_deref())?;
        let encoder = match manifest.latent {
            Some(_) => Some([graph("encoder")?, graph("encoder_vjp")?]),
            None => None,
        };
        let signal = manifest.schedule.alphas_bar();
        let graphs = loaded.into_iter().map(|(_, g)| g).collect();
        Ok(Self { manifest, graphs, base, personalised, encoder, signal, photo, foreground, seed })
    }

    /// ε of one of the terms for a noisy sample at a step.
    fn noise(
        &self,
        side: &Side,
        noisy: &[f32],
        step: usize,
        condition: Option<&Tensor>,
    ) -> Result<Vec<f64>, OnnxError> {
        let term = &side.term;
        let mut inputs = vec![
            (term.sample.name.as_str(), Tensor::f32(&term.sample.shape, noisy.to_vec())),
            (
                term.time.name.as_str(),
                Tensor::f32(&term.time.shape, vec![step as f32 * self.manifest.time_scale]),
            ),
        ];
        if let (Some(port), Some(condition)) = (&term.condition, condition) {
            inputs.push((port.name.as_str(), condition.clone()));
        }
        if let (Some(port), Some(context)) = (&term.told, &side.context) {
            inputs.push((port.name.as_str(), context.clone()));
        }
        let out = self.graphs[side.graph].run(&inputs, &[term.prediction.name.as_str()])?;
        let bar = self.signal[step].max(1e-12);
        let (a, s) = (bar.sqrt(), (1.0 - bar).max(1e-12).sqrt());
        Ok(out[0]
            .to_f32()
            .iter()
            .zip(noisy)
            .map(|(&p, &z)| {
                let (p, z) = (f64::from(p), f64::from(z));
                match self.manifest.schedule.prediction {
                    Prediction::Epsilon => p,
                    Prediction::X0 => (z - a * p) / s,
                    Prediction::V => a * p + s * z,
                }
            })
            .collect())
    }

    /// The planes that the models are given beside the noisy sample.
    fn condition(&self, crop: Crop) -> Option<Tensor> {
        let [w, h] = self.manifest.resolution;
        let port = self.personalised.term.condition.as_ref()?;
        let mut data = Vec::new();
        for plane in &self.manifest.condition {
            match plane {
                Plane::Photo => {
                    let small = Resampling::new(crop, self.photo, w, h).shrink(self.photo);
                    data.extend(planar(&small.map(coded)));
                }
                Plane::Mask => {
                    let mask = &self.foreground.coverage;
                    data.extend(planar(&Resampling::new(crop, mask, w, h).shrink(mask)));
                }
                Plane::Normal => {
                    let normal = &self.foreground.normal;
                    data.extend(planar(&Resampling::new(crop, normal, w, h).shrink(normal)));
                }
                Plane::Albedo => {
                    let albedo = &self.foreground.albedo;
                    data.extend(planar(&Resampling::new(crop, albedo, w, h).shrink(albedo).map(coded)));
                }
            }
        }
        Some(Tensor::f32(&port.shape, data))
    }
}

/// sRGB in [−1, 1] of a linear value.
fn coded(v: f32) -> f32 {
    2.0 * srgb_from_linear(v.clamp(0.0, 1.0)) - 1.0
}

/// Channel after channel.
fn planar(image: &Image) -> Vec<f32> {
    let n = image.channels;
    (0..n).flat_map(|c| image.data.iter().skip(c).step_by(n).copied()).collect()
}

/// A crop at another size: means of what a target pixel covers, bilinear where it covers less than a pixel. Linear, with its
/// transpose.
struct Resampling {
    columns: Vec<Vec<(usize, f32)>>,
    rows: Vec<Vec<(usize, f32)>>,
}

impl Resampling {
    fn new(crop: Crop, image: &Image, width: usize, height: usize) -> Self {
        let axis = |from: usize, to: usize, n: usize, most: usize| -> Vec<Vec<(usize, f32)>> {
            let scale = (to - from) as f32 / n as f32;
            // A tent at least a pixel wide to each side.
            let reach = scale.max(1.0);
            (0..n)
                .map(|k| {
                    let middle = from as f32 + (k as f32 + 0.5) * scale;
                    let first = (middle - reach - 0.5).floor().max(from as f32) as usize;
                    let last = ((middle + reach + 0.5).ceil() as usize).min(to).min(most);
                    let mut taps: Vec<(usize, f32)> = (first..last)
                        .map(|i| (i, 1.0 - (i as f32 + 0.5 - middle).abs() / reach))
                        .filter(|t| t.1 > 0.0)
                        .collect();
                    let sum: f32 = taps.iter().map(|t| t.1).sum();
                    taps.iter_mut().for_each(|t| t.1 /= sum);
                    taps
                })
                .collect()
        };
        Self {
            columns: axis(crop.x0, crop.x1, width, image.width),
            rows: axis(crop.y0, crop.y1, height, image.height),
        }
    }

    fn each(&self, mut f: impl FnMut(usize, usize, usize, usize, f32)) {
        for (v, rows) in self.rows.iter().enumerate() {
            for (u, columns) in self.columns.iter().enumerate() {
                for &(y, wy) in rows {
                    for &(x, wx) in columns {
                        f(u, v, x, y, wx * wy);
                    }
                }
            }
        }
    }

    fn shrink(&self, image: &Image) -> Image {
        let n = image.channels;
        let mut out = Image::zeros(self.columns.len(), self.rows.len(), n);
        let width = out.width;
        self.each(|u, v, x, y, w| {
            for c in 0..n {
                out.data[n * (v * width + u) + c] += w * image.data[n * (y * image.width + x) + c];
            }
        });
        out
    }

    fn transposed(&self, grad: &Image, out: &mut Image) {
        let n = grad.channels;
        let width = out.width;
        self.each(|u, v, x, y, w| {
            for c in 0..n {
                out.data[n * (y * width + x) + c] += w * grad.data[n * (v * grad.width + u) + c];
            }
        });
    }
}

impl Guidance for Distillation<'_> {
    fn name(&self) -> &'static str {
        "lds"
    }

    fn looks_at_composite(&self) -> bool {
        true
    }

    fn pull(&mut self, view: &View<'_>) -> Result<Pull, InsertError> {
        let composite = view.composite.expect("a composite was asked for");
        let failed = |e: OnnxError| InsertError::Guidance(GuidanceError::Onnx(e));
        let [w, h] = self.manifest.resolution;
        let resampling = Resampling::new(view.crop, composite, w, h);
        let small = resampling.shrink(composite);
        let picture = planar(&small.map(coded));
        let shape = [1, 3, h, w];
        let z = match self.encoder {
            None => picture.clone(),
            Some([encoder, _]) => {
                let input = Tensor::f32(&shape, picture.clone());
                let out = self.graphs[encoder].run(&[("picture", input)], &["latent"]).map_err(failed)?;
                out[0].to_f32()
            }
        };
        let mut rng = Rng::stream(self.seed ^ NOISE_STREAM, view.iteration as u64);
        let strongest = STRONGEST[0] + (STRONGEST[1] - STRONGEST[0]) * view.progress;
        let last = self.signal.len() - 1;
        let step = ((rng.range(WEAKEST, strongest) * self.signal.len() as f32) as usize).min(last);
        let bar = self.signal[step];
        let (a, s) = (bar.sqrt() as f32, (1.0 - bar).sqrt() as f32);
        let noisy: Vec<f32> = z.iter().map(|z| a * z + s * rng.normal()).collect();
        let condition = self.condition(view.crop);
        let personalised =
            self.noise(&self.personalised, &noisy, step, condition.as_ref()).map_err(failed)?;
        let base = self.noise(&self.base, &noisy, step, condition.as_ref()).map_err(failed)?;
        // w(t) ∂z_t/∂z; by pixel, so that a model's size does not matter.
        let scale = f64::from(WEIGHT * s * s * a) / z.len() as f64;
        let mut square = 0.0f64;
        let by_z: Vec<f32> = personalised
            .iter()
            .zip(&base)
            .map(|(p, b)| {
                square += (p - b) * (p - b);
                (scale * (p - b)) as f32
            })
            .collect();
        if by_z.iter().any(|g| !g.is_finite()) {
            return Err(InsertError::Guidance(GuidanceError::NotFinite { step }));
        }
        let by_picture = match (self.encoder, &self.manifest.latent) {
            (Some([_, vjp]), Some(latent)) => {
                let inputs = [
                    ("picture", Tensor::f32(&shape, picture)),
                    ("grad_latent", Tensor::f32(&latent.shape, by_z)),
                ];
                self.graphs[vjp].run(&inputs, &["grad_picture"]).map_err(failed)?[0].to_f32()
            }
            _ => by_z,
        };
        let mut by_small = Image::zeros(w, h, 3);
        for (i, v) in small.data.iter().enumerate() {
            let g = by_picture[(i % 3) * w * h + i / 3];
            // Beyond white there is nothing to see; what is beyond may only be pulled back.
            if *v <= 1.0 || g > 0.0 {
                by_small.data[i] = 2.0 * g * srgb_slope(v.clamp(0.0, 1.0));
            }
        }
        let mut grad = Image::zeros(composite.width, composite.height, 3);
        resampling.transposed(&by_small, &mut grad);
        let loss = (0.5 * f64::from(WEIGHT) * square * f64::from(s * s) / z.len() as f64) as f32;
        Ok(Pull { loss, composite: Some(grad), light: None })
    }
}

/// Sets the random numbers of the noise apart from others.
const NOISE_STREAM: u64 = 0x6c64_735f_6e6f_6973;

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: a crop that is shrunk or enlarged keeps a constant, and its transpose is adjoint to it and stays inside the crop.
    #[test]
    fn resampling_and_its_transpose() {
        let mut rng = Rng::new(5);
        let image = Image::from_data(20, 14, 3, (0..840).map(|_| rng.uniform()).collect());
        for crop in [Crop { x0: 3, y0: 2, x1: 19, y1: 14 }, Crop { x0: 8, y0: 5, x1: 11, y1: 9 }] {
            let r = Resampling::new(crop, &image, 8, 8);
            let even = r.shrink(&Image::filled(20, 14, 3, 0.7));
            assert!(even.data.iter().all(|v| (v - 0.7).abs() < 1e-6));
            let grad = Image::from_data(8, 8, 3, (0..192).map(|_| rng.normal()).collect());
            let mut back = Image::zeros(20, 14, 3);
            r.transposed(&grad, &mut back);
            let dot = |a: &Image, b: &Image| -> f64 {
                a.data.iter().zip(&b.data).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
            };
            assert!((dot(&r.shrink(&image), &grad) - dot(&image, &back)).abs() < 1e-4);
            for (i, g) in back.data.iter().enumerate() {
                assert!(*g == 0.0 || crop.contains(i / 3, 20));
            }
        }
    }
}
