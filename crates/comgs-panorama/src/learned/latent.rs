//! A latent diffusion model: pictures at several exposures, denoised in an autoencoder's latents.
//!
//! Networks that know no sphere show a seam where their picture ends. Two measures hide it: every step sees the panorama
//! turned by another yaw, and the decoder runs twice, half a turn apart, each counting where it is far from its own edge.

use super::view::View;
use crate::CompletionError;
use crate::brackets;
use crate::bundle::{
    Bundle, GraphEntry, HowExposed, ImageChannels, LatentChannels, LatentSpace, Manifest, MaskMeaning,
    ModelError, Space, Tone,
};
use crate::onnx::{Graph, Runtime, Tensor};
use crate::partial::{Partial, resized, roll};
use crate::schedule::Sampler;
use comgs_geom::{Rng, equirect};
use comgs_image::Image;
use comgs_image::transfer::{linear_from_srgb, srgb_from_linear};
use std::f64::consts::TAU;

/// The networks of a latent model, loaded.
pub struct Latent {
    manifest: Manifest,
    space: LatentSpace,
    encoder: Network,
    decoder: Network,
    denoisers: Vec<Network>,
    /// Embedding of every exposure, and of no prompt.
    texts: Vec<Option<Tensor>>,
    unconditional: Option<Tensor>,
}

struct Network {
    graph: Box<dyn Graph>,
    entry: GraphEntry,
}

impl Network {
    fn load(bundle: &Bundle, role: &str, runtime: &Runtime, threads: usize) -> Result<Self, ModelError> {
        let graph = bundle.load(role, runtime, threads)?;
        Ok(Self { graph, entry: bundle.manifest.graphs[role].clone() })
    }

    /// Runs it with inputs by role.
    fn run(&self, inputs: &[(&str, Vec<f32>)], output: &str, n: usize) -> Result<Vec<f64>, ModelError> {
        let inputs: Vec<(&str, Tensor)> = inputs
            .iter()
            .map(|(role, values)| {
                let port = &self.entry.inputs[*role];
                (port.name.as_str(), Tensor::f32(&port.shape, values.clone()))
            })
            .collect();
        super::finite(&*self.graph, &inputs, &self.entry.outputs[output].name, n)
    }
}

/// What a model is shown of a panorama, at its full size; maps are row-major, channels one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Picture in [−1, 1], `[3, H, W]`, unknown texels as the bundle says.
    pub picture: Vec<f32>,
    /// 1 = known, `[H, W]`.
    pub known: Vec<bool>,
    /// Normals, `[3, H, W]`, 0 where unknown: x to the panorama's middle, y to the left, z up.
    pub normal: Vec<f32>,
}

/// Conditions at the latents' size and, for adapters, at full size.
struct Conditions {
    groups: Vec<(LatentChannels, Vec<f32>)>,
    image: Vec<(ImageChannels, Vec<f32>)>,
}

impl Latent {
    /// Loads the graphs and embeddings of a bundle whose space is latent.
    ///
    /// # Errors
    /// [`ModelError`]; also when the bundle's space is not latent.
    pub fn load(bundle: &Bundle, runtime: &Runtime, threads: usize) -> Result<Self, ModelError> {
        let Space::Latent(space) = bundle.manifest.space.clone() else {
            let problems = vec!["space: expected the kind \"latent\"".to_owned()];
            return Err(ModelError::Manifest { path: bundle.origin.clone().into(), problems });
        };
        let network = |role: &str| Network::load(bundle, role, runtime, threads);
        let count = if matches!(space.exposures.by, HowExposed::Network { .. }) {
            space.exposures.ev.len()
        } else {
            1
        };
        let denoisers = (0..count).map(|k| network(&space.denoiser(k))).collect::<Result<_, _>>()?;
        let named = |name: &Option<String>| name.as_ref().map(|n| bundle.embedding(n)).transpose();
        let texts = space
            .exposures
            .ev
            .iter()
            .map(|&ev| match &space.exposures.by {
                HowExposed::Prompt { ev_min, bright, dark } => {
                    interpolated(&bundle.embedding(bright)?, &bundle.embedding(dark)?, ev / ev_min).map(Some)
                }
                HowExposed::Network { prompt } | HowExposed::Scalar { prompt } => named(prompt),
            })
            .collect::<Result<_, ModelError>>()?;
        let unconditional = match &space.prompts {
            Some(prompts) if space.guidance_scale > 1.0 => named(&prompts.unconditional)?,
            _ => None,
        };
        let (encoder, decoder) = (network("encoder")?, network("decoder")?);
        let manifest = bundle.manifest.clone();
        Ok(Self { manifest, space, encoder, decoder, denoisers, texts, unconditional })
    }

    /// Linear radiance of the whole sphere at the model's size, in the panorama's own yaw.
    pub(super) fn fill(
        &self,
        manifest: &Manifest,
        steps: usize,
        partial: &Partial,
        seed: u64,
    ) -> Result<Image, CompletionError> {
        let view = View::new(partial, manifest.resolution, MIDDLE)?;
        let scale = self.space.white.value / quantile(&view, self.space.white.quantile);
        let mut rng = Rng::stream(seed, 0x006c_6174);
        let noise: Vec<f64> = (0..self.latent_len()).map(|_| f64::from(rng.normal())).collect();
        let mut pictures = Vec::new();
        for (k, &ev) in self.space.exposures.ev.iter().enumerate() {
            let exposure = if self.space.shown_at_exposure { ev.exp2() } else { 1.0 };
            let shown = self.shown(&view, scale * exposure);
            let latent = self.denoise(&shown, k, steps, &noise, Some(seed))?;
            let picture = self.decode_round(&latent)?;
            pictures.push((ev, picture.map(|v| self.linear(0.5 + 0.5 * v))));
        }
        let merged = brackets::merge(&pictures);
        Ok(view.back(&merged.map(|v| (f64::from(v) / scale) as f32)))
    }

    /// The latent of a picture `[3, H, W]` in [−1, 1], scaled: `[c, h, w]`.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn encode(&self, picture: &[f32]) -> Result<Vec<f64>, ModelError> {
        let mean = self.encoder.run(&[("picture", picture.to_vec())], "latent", self.latent_len())?;
        Ok(mean.iter().map(|v| v * self.space.scaling).collect())
    }

    /// The picture of a scaled latent, in [−1, 1] (not cut), 3 channels.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn decode(&self, latent: &[f64]) -> Result<Image, ModelError> {
        let [width, height] = self.manifest.resolution;
        let n = width * height;
        let latent = latent.iter().map(|v| (v / self.space.scaling) as f32).collect();
        let planes = self.decoder.run(&[("latent", latent)], "picture", 3 * n)?;
        let data = (0..3 * n).map(|k| planes[k % 3 * n + k / 3] as f32).collect();
        Ok(Image::from_data(width, height, 3, data))
    }

    /// The picture of a scaled latent without a seam: twice, half a turn apart, blended.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn decode_round(&self, latent: &[f64]) -> Result<Image, ModelError> {
        let [w, h] = self.latent_size();
        let half = w / 2;
        let mut picture = self.decode(latent)?;
        let (width, height) = (picture.width, picture.height);
        let other = roll(&self.decode(&rolled(latent, w, h, half))?, width - half * self.space.factor);
        for y in 0..height {
            for x in 0..width {
                // 0 at the picture's edge, 1 in its middle, where the other one has its edge.
                let d = (x as f32 + 0.5).min(width as f32 - x as f32 - 0.5) / (0.5 * width as f32);
                let weight = d * d * (3.0 - 2.0 * d);
                for (a, b) in picture.pixel_mut(x, y).iter_mut().zip(other.pixel(x, y)) {
                    *a = weight * *a + (1.0 - weight) * b;
                }
            }
        }
        Ok(picture)
    }

    /// Denoises a latent.
    ///
    /// * `exposure`: index into the bundle's exposures
    /// * `noise`: unit normal numbers `[c, h, w]`
    /// * `turns`: seed of the yaw that each step sees the panorama in; the panorama as it is when `None`
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn denoise(
        &self,
        shown: &Shown,
        exposure: usize,
        steps: usize,
        noise: &[f64],
        turns: Option<u64>,
    ) -> Result<Vec<f64>, ModelError> {
        let [w, h] = self.latent_size();
        let conditions = self.conditions(shown)?;
        let network = &self.denoisers[if self.denoisers.len() > 1 { exposure } else { 0 }];
        let mut sampler = Sampler::new(&self.manifest.schedule, self.manifest.solver, steps);
        let mut rng = turns.map(|seed| Rng::stream(seed, 0x7475_726e));
        let mut x = noise.to_vec();
        for i in 0..sampler.steps().len() {
            let by = rng.as_mut().map_or(0, |rng| rng.below(w));
            let turned = rolled(&x, w, h, by);
            let mut sample = Vec::new();
            for (group, planes) in &conditions.groups {
                match group {
                    LatentChannels::Sample => sample.extend(turned.iter().map(|&v| v as f32)),
                    LatentChannels::Normal => sample.extend(self.turned_normals(planes, w, h, by)),
                    _ => sample.extend(rolled(planes, w, h, by)),
                }
            }
            let mut inputs = vec![("sample", sample), ("time", vec![sampler.steps()[i] as f32])];
            if !conditions.image.is_empty() {
                let [width, height] = self.manifest.resolution;
                let by = by * self.space.factor;
                let planes = conditions.image.iter().flat_map(|(group, planes)| match group {
                    ImageChannels::Normal => self.turned_normals(planes, width, height, by),
                    _ => rolled(planes, width, height, by),
                });
                inputs.push(("image", planes.collect()));
            }
            if matches!(self.space.exposures.by, HowExposed::Scalar { .. }) {
                inputs.push(("exposure", vec![self.space.exposures.ev[exposure] as f32]));
            }
            let predict = |text: Option<&Tensor>| {
                let mut inputs = inputs.clone();
                inputs.extend(text.map(|t| ("text", t.to_f32())));
                network.run(&inputs, "prediction", self.latent_len())
            };
            let mut output = predict(self.texts[exposure].as_ref())?;
            if let Some(free) = &self.unconditional {
                // Ho & Salimans 2022.
                for (o, f) in output.iter_mut().zip(predict(Some(free))?) {
                    *o = f + self.space.guidance_scale * (*o - f);
                }
            }
            x = sampler.step(i, &x, &rolled(&output, w, h, w - by));
        }
        Ok(x)
    }

    fn conditions(&self, shown: &Shown) -> Result<Conditions, ModelError> {
        let [width, height] = self.manifest.resolution;
        let n = width * height;
        let ([w, h], factor) = (self.latent_size(), self.space.factor);
        let mask = |known: bool| f32::from(u8::from(known == (self.space.mask == MaskMeaning::Known)));
        let mut groups = Vec::new();
        for &group in &self.space.condition {
            let planes = match group {
                LatentChannels::Sample => Vec::new(),
                LatentChannels::MaskedLatent => narrow(&self.encode(&shown.picture)?),
                LatentChannels::NormalLatent => narrow(&self.encode(&self.in_axes(&shown.normal))?),
                LatentChannels::Mask => {
                    (0..w * h).map(|i| mask(shown.known[i / w * factor * width + i % w * factor])).collect()
                }
                LatentChannels::Normal => (0..3)
                    .flat_map(|c| {
                        let plane = shown.normal[c * n..(c + 1) * n].to_vec();
                        resized(&Image::from_data(width, height, 1, plane), w, h).data
                    })
                    .collect(),
            };
            groups.push((group, planes));
        }
        let image = self.space.image.iter().map(|&group| {
            let planes = match group {
                ImageChannels::Picture => shown.picture.clone(),
                ImageChannels::Mask => shown.known.iter().map(|&k| mask(k)).collect(),
                ImageChannels::Normal => shown.normal.clone(),
            };
            (group, planes)
        });
        Ok(Conditions { groups, image: image.collect() })
    }

    /// What the model is shown of a view whose radiance times `scale` is 1 at the picture's white.
    fn shown(&self, view: &View, scale: f64) -> Shown {
        let n = view.width * view.height;
        let mut shown = Shown {
            picture: vec![self.space.unknown as f32; 3 * n],
            known: view.given.clone(),
            normal: vec![0.0; 3 * n],
        };
        for i in (0..n).filter(|&i| view.given[i]) {
            for c in 0..3 {
                let x = (f64::from(view.rgb.data[3 * i + c]) * scale).clamp(0.0, 1.0);
                shown.picture[c * n + i] = 2.0 * self.code(x) - 1.0;
                if let Some(normal) = &view.normal {
                    shown.normal[c * n + i] = normal.data[3 * i + c];
                }
            }
        }
        shown
    }

    /// The normals of a panorama that was turned to the right by `by` of its `w` texels, in the model's axes.
    fn turned_normals(&self, planes: &[f32], w: usize, h: usize, by: usize) -> Vec<f32> {
        let mut moved = rolled(planes, w, h, by);
        let (sin, cos) =
            ((-(by as f64) / w as f64 * TAU).sin() as f32, (-(by as f64) / w as f64 * TAU).cos() as f32);
        for i in 0..w * h {
            let (x, y) = (moved[i], moved[w * h + i]);
            (moved[i], moved[w * h + i]) = (cos * x - sin * y, sin * x + cos * y);
        }
        self.in_axes(&moved)
    }

    fn in_axes(&self, normal: &[f32]) -> Vec<f32> {
        let n = normal.len() / 3;
        let plane = |axis: i8| {
            let from = (axis.unsigned_abs() as usize - 1) * n;
            normal[from..from + n].iter().map(move |v| v * f32::from(axis.signum()))
        };
        self.space.normal_axes.iter().flat_map(|&axis| plane(axis)).collect()
    }

    fn code(&self, x: f64) -> f32 {
        match self.space.tone {
            Tone::Srgb => srgb_from_linear(x as f32),
            Tone::Gamma { exponent } => x.powf(1.0 / exponent) as f32,
        }
    }

    fn linear(&self, code: f32) -> f32 {
        let code = code.clamp(0.0, 1.0);
        match self.space.tone {
            Tone::Srgb => linear_from_srgb(code),
            Tone::Gamma { exponent } => f64::from(code).powf(exponent) as f32,
        }
    }

    fn latent_size(&self) -> [usize; 2] {
        self.manifest.resolution.map(|n| n / self.space.factor)
    }

    /// Numbers of a latent.
    #[must_use]
    pub fn latent_len(&self) -> usize {
        let [w, h] = self.latent_size();
        self.space.channels * w * h
    }
}

/// Where the known radiance's geometric mean goes before its bright side is looked for.
const MIDDLE: f64 = 0.25;

fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

/// Planes of `w × h` moved to the right by `by` texels around the azimuth.
fn rolled<T: Copy>(planes: &[T], w: usize, h: usize, by: usize) -> Vec<T> {
    debug_assert_eq!(planes.len() % (w * h), 0);
    let mut out = planes.to_vec();
    for row in out.chunks_exact_mut(w) {
        row.rotate_right(by % w);
    }
    out
}

fn interpolated(bright: &Tensor, dark: &Tensor, share: f64) -> Result<Tensor, ModelError> {
    if bright.shape != dark.shape {
        let what = format!("space.prompts: embeddings of shapes {:?} and {:?}", bright.shape, dark.shape);
        return Err(ModelError::Manifest { path: "model.json".into(), problems: vec![what] });
    }
    let (b, d) = (bright.to_f32(), dark.to_f32());
    let mixed = b.iter().zip(&d).map(|(&b, &d)| (f64::from(b) + share * f64::from(d - b)) as f32);
    Ok(Tensor::f32(&bright.shape, mixed.collect()))
}

/// The quantile of what is known, by solid angle; its mean where that is 0, so that a dark view with one lamp has a scale.
fn quantile(view: &View, share: f64) -> f64 {
    let omega = |i: usize| f64::from(equirect::texel_solid_angle(i / view.width, view.width, view.height));
    let mut values: Vec<(f64, f64)> = (0..view.given.len())
        .filter(|&i| view.given[i])
        .map(|i| (view.rgb.data[3 * i..3 * i + 3].iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0, omega(i)))
        .collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|v| v.1).sum();
    let mut sum = 0.0;
    let at = values.iter().find(|v| {
        sum += v.1;
        sum >= share * total * (1.0 - 1e-12)
    });
    let mean = values.iter().map(|v| v.0 * v.1).sum::<f64>() / total;
    let value = at.map_or(mean, |v| v.0);
    if value > 1e-9 * mean.max(1e-12) { value } else { mean.max(1e-12) }
}
