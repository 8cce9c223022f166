//! What `model.json` declares, and whether it can be true.

use crate::codes::Codes;
use crate::schedule::{Schedule, Solver};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What `model.json` holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// `comgs-model`.
    pub format: String,
    /// Version of this format: 1.
    pub version: u32,
    /// Name of the model.
    pub name: String,
    /// What it is and how it came about.
    pub about: String,
    /// Licence of its weights (SPDX, or a sentence).
    pub licence: String,
    /// Width and height of the panoramas that it works at.
    pub resolution: [usize; 2],
    /// What is denoised, and how a panorama becomes that.
    pub space: Space,
    /// How noise was added in training.
    pub schedule: Schedule,
    /// The sampler to use.
    #[serde(default)]
    pub solver: Solver,
    /// Steps to take when the user says nothing.
    pub steps: usize,
    /// Its graphs by role; [`Space`] says which.
    pub graphs: BTreeMap<String, GraphEntry>,
}

/// What a model denoises.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Space {
    /// Codes of high dynamic range, texel by texel.
    Codes(CodesSpace),
    /// Latents of a picture autoencoder; high dynamic range from several exposures.
    Latent(LatentSpace),
}

/// A pixel-space model of high dynamic range. Graph `denoiser`: inputs `sample` `[1, 6, H, W]`, `time` `[1]`, the training step
/// over their number, in (0, 1], and `condition` `[1, C, H, W]`; output `prediction` `[1, 6, H, W]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CodesSpace {
    /// Channels of the condition, in order.
    pub condition: Vec<Channels>,
    /// The encodings of radiance.
    pub codes: Codes,
    /// Whether the network was trained with zeros instead of noise at the last training step, so that a single step gives
    /// the mean.
    #[serde(default)]
    pub zeros_at_last_step: bool,
}

/// A group of channels of a pixel-space condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Channels {
    /// Reinhard codes of what is known or clipped, else 0; 3.
    Reinhard,
    /// Log codes of the same; 3.
    Log,
    /// 1 = known; 1.
    Known,
    /// 1 = at least this bright; 1.
    Clipped,
    /// Normals of what was seen, 0 where unknown; 3.
    Normal,
    /// Directions of the texels; 3.
    Direction,
}

impl Channels {
    /// How many.
    #[must_use]
    pub fn count(self) -> usize {
        match self {
            Self::Known | Self::Clipped => 1,
            _ => 3,
        }
    }
}

/// A latent diffusion model such as Stable Diffusion, which paints pictures of low dynamic range. With `h = H / factor`,
/// `w = W / factor` and `c` latent channels:
///
/// * graph `encoder`: `picture` `[1, 3, H, W]` in [−1, 1] to `latent` `[1, c, h, w]` (the mean, without `scaling`)
/// * graph `decoder`: `latent` (divided by `scaling`) to `picture`
/// * graph `denoiser`, or `denoiser_0`, `denoiser_1` … where every exposure has a network of its own: `sample`
///   `[1, C, h, w]`, the groups of `condition` one after the other; `time` `[1]`, the training step from 0 on; `text`
///   `[1, tokens, width]` where there are prompts; `image` `[1, C′, H, W]`, the groups of `image`, where an adapter at full
///   size (T2I) is part of the graph; `exposure` `[1]`, EV, where exposure is a scalar. Output `prediction` `[1, c, h, w]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LatentSpace {
    /// Channels of a latent.
    pub channels: usize,
    /// Texels of the panorama along each side of a latent's texel.
    pub factor: usize,
    /// What the encoder's mean is multiplied by (0.18215 in Stable Diffusion 1 and 2).
    pub scaling: f64,
    /// Groups of the denoiser's `sample`, in order; exactly one is `sample`.
    pub condition: Vec<LatentChannels>,
    /// Groups of its `image` input, in order; none when empty.
    #[serde(default)]
    pub image: Vec<ImageChannels>,
    /// What 1 means in a mask.
    pub mask: MaskMeaning,
    /// Which of our axes each component of a normal is, from 1, negative when it points the other way. Ours: x to the panorama's
    /// middle, y to its left half, z up. `[-2, 3, -1]`: x right, y up, z towards the viewer.
    #[serde(default = "own_axes")]
    pub normal_axes: [i8; 3],
    /// What unknown texels are in the picture that is encoded, in [−1, 1].
    pub unknown: f64,
    /// How a picture's codes follow from linear light.
    pub tone: Tone,
    /// Which radiance is how bright in the picture of EV 0.
    pub white: White,
    /// The exposures that are painted, and how the model is told.
    pub exposures: Exposures,
    /// Whether the known part is shown at the exposure that is painted (true) or always at EV 0.
    #[serde(default)]
    pub shown_at_exposure: bool,
    /// Embeddings of prompts.
    #[serde(default)]
    pub prompts: Option<Prompts>,
    /// Weight of classifier-free guidance; 1 = none. More needs `prompts.unconditional`.
    #[serde(default = "one")]
    pub guidance_scale: f64,
}

fn own_axes() -> [i8; 3] {
    [1, 2, 3]
}

fn one() -> f64 {
    1.0
}

/// A group of channels at a latent's size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LatentChannels {
    /// The noisy latent.
    Sample,
    /// The latent of the picture whose unknown part is [`LatentSpace::unknown`].
    MaskedLatent,
    /// The mask's texel at the upper left corner of each latent texel; 1.
    Mask,
    /// Normals in [−1, 1], area means; 3.
    Normal,
    /// The latent of the normals as a picture.
    NormalLatent,
}

/// A group of channels at the panorama's size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageChannels {
    /// The picture in [−1, 1], unknown texels as [`LatentSpace::unknown`]; 3.
    Picture,
    /// The mask; 1.
    Mask,
    /// Normals in [−1, 1], 0 where unknown; 3.
    Normal,
}

/// What 1 means in a mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskMeaning {
    /// Known.
    Known,
    /// To be painted.
    ToPaint,
}

/// Codes in [0, 1] from linear light.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Tone {
    /// IEC 61966-2-1.
    Srgb,
    /// `x^(1/exponent)`.
    Gamma {
        /// The exponent, 1 to 4.
        exponent: f64,
    },
}

/// At EV 0 the quantile `quantile` of the known radiance (by solid angle, mean of the channels) is linear `value`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct White {
    /// In (0, 1].
    pub quantile: f64,
    /// In (0, 1].
    pub value: f64,
}

/// The exposures that a model paints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exposures {
    /// Exposure values, from 0 falling.
    pub ev: Vec<f64>,
    /// How the model is told.
    pub by: HowExposed,
}

/// How a model is told an exposure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum HowExposed {
    /// By its prompt: `ξ = ξ_b + (EV / EV_min)(ξ_d − ξ_b)` (Phongthawee et al. 2024; ComGS appendix D.3).
    Prompt {
        /// EV of the dark prompt, below 0.
        ev_min: f64,
        /// Name of the embedding at EV 0.
        bright: String,
        /// Name of the embedding at `ev_min`.
        dark: String,
    },
    /// By a network of its own for each; with the same prompt where there are prompts.
    Network {
        /// Name of the embedding.
        #[serde(default)]
        prompt: Option<String>,
    },
    /// By an input of the denoiser; with the same prompt where there are prompts.
    Scalar {
        /// Name of the embedding.
        #[serde(default)]
        prompt: Option<String>,
    },
}

/// Embeddings of prompts: a safetensors file of `float32` tensors `[1, tokens, width]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prompts {
    /// The file in the bundle.
    pub file: String,
    /// Its BLAKE3, hexadecimal.
    pub blake3: String,
    /// Name of the embedding of no prompt, for classifier-free guidance.
    #[serde(default)]
    pub unconditional: Option<String>,
}

/// One graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraphEntry {
    /// Its file in the bundle.
    pub file: String,
    /// BLAKE3 of the file, hexadecimal.
    pub blake3: String,
    /// Inputs by role: name and shape.
    pub inputs: BTreeMap<String, PortEntry>,
    /// Outputs by role.
    pub outputs: BTreeMap<String, PortEntry>,
}

/// A declared input or output; `float32`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PortEntry {
    /// Name in the graph.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
}

impl LatentSpace {
    /// Channels of a group.
    #[must_use]
    pub fn count(&self, group: LatentChannels) -> usize {
        match group {
            LatentChannels::Sample | LatentChannels::MaskedLatent | LatentChannels::NormalLatent => {
                self.channels
            }
            LatentChannels::Mask => 1,
            LatentChannels::Normal => 3,
        }
    }

    /// Role of the denoiser of an exposure.
    #[must_use]
    pub fn denoiser(&self, exposure: usize) -> String {
        match self.exposures.by {
            HowExposed::Network { .. } => format!("denoiser_{exposure}"),
            _ => "denoiser".into(),
        }
    }

    fn problems(&self, width: usize, height: usize, out: &mut Vec<String>) {
        let mut check = |fine: bool, what: String| {
            if !fine {
                out.push(format!("space.{what}"));
            }
        };
        let fits =
            self.factor >= 1 && height.is_multiple_of(self.factor) && width.is_multiple_of(self.factor);
        check(fits, format!("factor: expected a divisor of the resolution, got {}", self.factor));
        check(
            (1..=64).contains(&self.channels),
            format!("channels: expected 1 to 64, got {}", self.channels),
        );
        let positive = |v: f64| v > 0.0 && v.is_finite();
        check(positive(self.scaling), format!("scaling: expected a positive number, got {}", self.scaling));
        let samples = self.condition.iter().filter(|c| **c == LatentChannels::Sample).count();
        check(samples == 1, format!("condition: expected \"sample\" once, got it {samples} times"));
        let axes = self.normal_axes;
        let mut sorted = axes.map(i8::unsigned_abs);
        sorted.sort_unstable();
        check(
            sorted == [1, 2, 3],
            format!("normal_axes: expected 1, 2, 3 in any order and sign, got {axes:?}"),
        );
        check(
            (-1.0..=1.0).contains(&self.unknown),
            format!("unknown: expected −1 to 1, got {}", self.unknown),
        );
        if let Tone::Gamma { exponent } = self.tone {
            check((1.0..=4.0).contains(&exponent), format!("tone.exponent: expected 1 to 4, got {exponent}"));
        }
        let White { quantile, value } = self.white;
        let share = |v: f64| v > 0.0 && v <= 1.0;
        check(share(quantile) && share(value), "white: expected numbers over 0, at most 1".into());
        let ev = &self.exposures.ev;
        let falling = ev.windows(2).all(|w| w[1] < w[0]) && ev.iter().all(|v| (-20.0..=0.0).contains(v));
        check(
            ev.first() == Some(&0.0) && falling,
            format!("exposures.ev: expected 0 and falling values down to −20, got {ev:?}"),
        );
        let named = match &self.exposures.by {
            HowExposed::Prompt { ev_min, .. } => {
                check(*ev_min < 0.0, format!("exposures.by.ev_min: expected less than 0, got {ev_min}"));
                true
            }
            HowExposed::Network { prompt } | HowExposed::Scalar { prompt } => prompt.is_some(),
        };
        check(
            named == self.prompts.is_some(),
            "prompts: expected where exposures.by names an embedding, and only there".into(),
        );
        check(
            self.guidance_scale >= 1.0,
            format!("guidance_scale: expected 1 or more, got {}", self.guidance_scale),
        );
        let free = self.prompts.as_ref().is_some_and(|p| p.unconditional.is_some());
        check(
            !(self.guidance_scale > 1.0) || free,
            "guidance_scale: more than 1 needs prompts.unconditional".into(),
        );
    }
}

/// Ports that a graph must have: `(inputs or outputs, role, shape)`; `None` for a size that the manifest need not state.
type Needed = Vec<(&'static str, &'static str, Vec<Option<usize>>)>;

impl Manifest {
    /// The file of embeddings, where there is one.
    #[must_use]
    pub fn prompts(&self) -> Option<&Prompts> {
        match &self.space {
            Space::Latent(latent) => latent.prompts.as_ref(),
            Space::Codes(_) => None,
        }
    }

    /// Every problem, each with its field.
    pub(super) fn problems(&self) -> Vec<String> {
        let mut out = Vec::new();
        if self.format != "comgs-model" {
            out.push(format!("format: expected \"comgs-model\", got {:?}", self.format));
        }
        if self.version != 1 {
            out.push(format!("version: this program reads 1, got {}", self.version));
        }
        let [width, height] = self.resolution;
        if width != 2 * height || !(8..=4096).contains(&height) {
            out.push(format!("resolution: expected [2n, n] with n from 8 to 4096, got [{width}, {height}]"));
        }
        if !(1..=self.schedule.timesteps.max(1)).contains(&self.steps) {
            out.push(format!("steps: expected 1 to {}, got {}", self.schedule.timesteps, self.steps));
        }
        match &self.space {
            Space::Codes(space) => space.codes.problems(&mut out),
            Space::Latent(latent) => latent.problems(width, height, &mut out),
        }
        self.schedule.problems(&mut out);
        for (role, needed) in self.needed() {
            let Some(graph) = self.graphs.get(&role) else {
                out.push(format!("graphs.{role}: missing"));
                continue;
            };
            for (what, port, shape) in needed {
                let at = format!("graphs.{role}.{what}.{port}");
                let ports = if what == "inputs" { &graph.inputs } else { &graph.outputs };
                match ports.get(port) {
                    None => out.push(format!("{at}: missing")),
                    Some(p)
                        if p.shape.len() != shape.len()
                            || p.shape.iter().zip(&shape).any(|(a, b)| b.is_some_and(|b| b != *a)) =>
                    {
                        let expected: Vec<String> =
                            shape.iter().map(|n| n.map_or("any".into(), |n| n.to_string())).collect();
                        out.push(format!(
                            "{at}.shape: expected [{}], got {:?}",
                            expected.join(", "),
                            p.shape
                        ));
                    }
                    Some(_) => {}
                }
            }
        }
        let files = self.graphs.iter().map(|(role, g)| (format!("graphs.{role}.file"), &g.file));
        for (at, file) in files.chain(self.prompts().map(|p| ("space.prompts.file".into(), &p.file))) {
            let plain = Path::new(file).components().count() == 1 && !file.contains("..");
            if !plain || file.is_empty() {
                out.push(format!("{at}: expected a file in the bundle, got {file:?}"));
            }
        }
        out
    }

    /// The graphs that the space needs, and their ports.
    fn needed(&self) -> Vec<(String, Needed)> {
        let [width, height] = self.resolution;
        let sized = |c: usize, h: usize, w: usize| vec![Some(1), Some(c), Some(h), Some(w)];
        match &self.space {
            Space::Codes(space) => {
                let condition = space.condition.iter().map(|c| c.count()).sum();
                let ports = vec![
                    ("inputs", "sample", sized(6, height, width)),
                    ("inputs", "time", vec![Some(1)]),
                    ("inputs", "condition", sized(condition, height, width)),
                    ("outputs", "prediction", sized(6, height, width)),
                ];
                vec![("denoiser".into(), ports)]
            }
            Space::Latent(space) => {
                let (w, h, c) = (width / space.factor.max(1), height / space.factor.max(1), space.channels);
                let (picture, latent) = (sized(3, height, width), sized(c, h, w));
                let mut graphs = vec![
                    (
                        "encoder".to_owned(),
                        vec![("inputs", "picture", picture.clone()), ("outputs", "latent", latent.clone())],
                    ),
                    (
                        "decoder".to_owned(),
                        vec![("inputs", "latent", latent.clone()), ("outputs", "picture", picture)],
                    ),
                ];
                let sample = space.condition.iter().map(|&g| space.count(g)).sum();
                let mut ports = vec![
                    ("inputs", "sample", sized(sample, h, w)),
                    ("inputs", "time", vec![Some(1)]),
                    ("outputs", "prediction", latent),
                ];
                if space.prompts.is_some() {
                    ports.push(("inputs", "text", vec![Some(1), None, None]));
                }
                if !space.image.is_empty() {
                    let count = |g: &ImageChannels| if *g == ImageChannels::Mask { 1 } else { 3 };
                    let channels = space.image.iter().map(count).sum();
                    ports.push(("inputs", "image", sized(channels, height, width)));
                }
                let networks = match space.exposures.by {
                    HowExposed::Network { .. } => space.exposures.ev.len(),
                    HowExposed::Prompt { .. } => 1,
                    HowExposed::Scalar { .. } => {
                        ports.push(("inputs", "exposure", vec![Some(1)]));
                        1
                    }
                };
                graphs.extend((0..networks).map(|k| (space.denoiser(k), ports.clone())));
                graphs
            }
        }
    }
}
