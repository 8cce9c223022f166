//! A guidance bundle: two denoisers, an encoder where they work on latents, and `model.json`, which declares all there is
//! to know to run them.

use comgs_panorama::onnx::{Graph, OnnxError, Runtime, Tensor};
use comgs_panorama::schedule::Schedule;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// Why a guidance bundle cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GuidanceError {
    /// A file of it cannot be read.
    #[error("guidance bundle: {file}: cannot be read: {reason}")]
    Read {
        /// Its name in the bundle.
        file: String,
        /// Why.
        reason: String,
    },
    /// `model.json` is not what it should be; every problem at once.
    #[error("guidance bundle: model.json: {}", problems.join("; "))]
    Manifest {
        /// What is wrong, each with its field.
        problems: Vec<String>,
    },
    /// A file is not the one that the manifest was written for.
    #[error(
        "guidance bundle: {file}: its checksum is {got}, declared is {expected}: damaged, or another file"
    )]
    Checksum {
        /// Its name in the bundle.
        file: String,
        /// BLAKE3 in the manifest.
        expected: String,
        /// BLAKE3 of the file.
        got: String,
    },
    /// A prompt that was not exported: text encoders are not run here.
    #[error("guidance bundle: no prompt {prompt:?}; it was exported with {}", has.join(", "))]
    Prompt {
        /// What was asked for.
        prompt: String,
        /// What there is, quoted.
        has: Vec<String>,
    },
    /// A graph cannot be loaded or run.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// A denoiser gave NaN or infinity.
    #[error("the denoisers gave values that are no numbers at step {step} of their noise")]
    NotFinite {
        /// Step of the schedule.
        step: usize,
    },
}

/// What `model.json` of a guidance bundle holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuidanceManifest {
    /// `comgs-guidance`.
    pub format: String,
    /// Version of this format: 1.
    pub version: u32,
    /// Name of the model.
    pub name: String,
    /// What it is and how it came about.
    pub about: String,
    /// Licence of its weights (SPDX, or a sentence).
    pub licence: String,
    /// Width and height of the picture that it sees: sRGB codes in [−1, 1], channel after channel.
    pub resolution: [usize; 2],
    /// For a model that works on latents: what the graph `encoder` (`picture` → `latent`) makes, scale included; its
    /// vector–Jacobian product is `encoder_vjp` (`picture`, `grad_latent` → `grad_picture`).
    #[serde(default)]
    pub latent: Option<Latent>,
    /// What the denoisers are given beside the noisy sample, channel after channel.
    #[serde(default)]
    pub condition: Vec<Plane>,
    /// How noise was added in training, and what is predicted.
    pub schedule: Schedule,
    /// What a step of the schedule is multiplied by before it goes into `time`: 1, or one over the number of steps.
    pub time_scale: f32,
    /// The second term of Eq. 8.
    pub base: Term,
    /// The first.
    pub personalised: Term,
    /// What denoisers are told, by name.
    #[serde(default)]
    pub contexts: BTreeMap<String, ContextEntry>,
    /// Graphs by name: file and checksum.
    pub graphs: BTreeMap<String, FileEntry>,
}

/// A latent.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Latent {
    /// Its shape, batch included.
    pub shape: Vec<usize>,
}

/// A group of channels that a denoiser is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Plane {
    /// The photo without the object, coded as the picture; 3.
    Photo,
    /// The object's share of a pixel; 1.
    Mask,
    /// Its normals, world space (x ahead, y left, z up), 0 where it is not; 3.
    Normal,
    /// Its base colour, coded as the picture, −1 where it is not; 3.
    Albedo,
}

impl Plane {
    fn count(self) -> usize {
        if self == Self::Mask { 1 } else { 3 }
    }
}

/// One of the two denoisers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Term {
    /// Which graph; both terms may share one.
    pub graph: String,
    /// What it is told, by its name in `contexts`.
    #[serde(default)]
    pub context: Option<String>,
    /// Input of the noisy sample.
    pub sample: PortSpec,
    /// Input of the time.
    pub time: PortSpec,
    /// Input of `condition`.
    #[serde(default)]
    pub condition: Option<PortSpec>,
    /// Input of the context.
    #[serde(default)]
    pub told: Option<PortSpec>,
    /// Output.
    pub prediction: PortSpec,
}

/// An input or output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PortSpec {
    /// Name in the graph.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
}

/// What a denoiser is told: the embedding of a prompt, or any numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContextEntry {
    /// The prompt.
    pub prompt: String,
    /// Shape, batch included.
    pub shape: Vec<usize>,
    /// The numbers themselves, for few.
    #[serde(default)]
    pub values: Option<Vec<f32>>,
    /// Or a file of little-endian `float32`.
    #[serde(default)]
    pub file: Option<FileEntry>,
}

/// A file of the bundle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Its name.
    pub file: String,
    /// BLAKE3, hexadecimal.
    pub blake3: String,
}

/// A bundle that was read: the manifest and its files, whose checksums are right.
#[derive(Clone, Debug)]
pub struct GuidanceBundle {
    /// The manifest.
    pub manifest: GuidanceManifest,
    files: BTreeMap<String, Vec<u8>>,
}

impl GuidanceBundle {
    /// A bundle from the bytes of its `model.json` and what reads its other files by name.
    ///
    /// # Errors
    /// [`GuidanceError`].
    pub fn from_parts(
        manifest: &[u8],
        read: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
    ) -> Result<Self, GuidanceError> {
        let broken = |problems: Vec<String>| GuidanceError::Manifest { problems };
        let manifest: GuidanceManifest =
            serde_json::from_slice(manifest).map_err(|e| broken(vec![e.to_string()]))?;
        let problems = manifest.problems();
        if !problems.is_empty() {
            return Err(broken(problems));
        }
        let mut files = BTreeMap::new();
        for entry in manifest.files() {
            if files.contains_key(&entry.file) {
                continue;
            }
            let failed =
                |e: std::io::Error| GuidanceError::Read { file: entry.file.clone(), reason: e.to_string() };
            let bytes = read(&entry.file).map_err(failed)?;
            let got = blake3::hash(&bytes).to_hex().to_string();
            if got != entry.blake3 {
                let (file, expected) = (entry.file.clone(), entry.blake3.clone());
                return Err(GuidanceError::Checksum { file, expected, got });
            }
            files.insert(entry.file.clone(), bytes);
        }
        Ok(Self { manifest, files })
    }

    /// Loads a graph by its name and compares its ports with what the manifest declares.
    ///
    /// # Errors
    /// [`GuidanceError`].
    pub fn load(&self, name: &str, runtime: &Runtime) -> Result<Box<dyn Graph>, GuidanceError> {
        let missing = || GuidanceError::Manifest { problems: vec![format!("graphs.{name}: missing")] };
        let entry = self.manifest.graphs.get(name).ok_or_else(missing)?;
        let graph = runtime.load(&self.files[&entry.file], &entry.file, 0)?;
        let mut problems = Vec::new();
        for (what, port, input) in self.manifest.ports(name) {
            let has = if input { graph.inputs() } else { graph.outputs() };
            let Some(found) = has.iter().find(|p| p.name == port.name) else {
                let names: Vec<&str> = has.iter().map(|p| p.name.as_str()).collect();
                problems.push(format!("{what}: {name} has no {:?}; it has {}", port.name, names.join(", ")));
                continue;
            };
            // Runtimes that do not infer an output's shape give none.
            let same = found.shape.len() == port.shape.len()
                && found.shape.iter().zip(&port.shape).all(|(a, b)| a.is_none_or(|a| a == *b));
            if !same && !found.shape.is_empty() {
                problems.push(format!(
                    "{what}: declared as {:?}, {name} has {:?} (None: any)",
                    port.shape, found.shape
                ));
            }
        }
        if problems.is_empty() { Ok(graph) } else { Err(GuidanceError::Manifest { problems }) }
    }

    /// Numbers of a context.
    ///
    /// # Errors
    /// [`GuidanceError::Manifest`] when it is missing or has another size than its shape.
    pub fn context(&self, name: &str) -> Result<Tensor, GuidanceError> {
        let broken = |what: String| GuidanceError::Manifest { problems: vec![what] };
        let entry =
            self.manifest.contexts.get(name).ok_or_else(|| broken(format!("contexts.{name}: missing")))?;
        let values = match (&entry.values, &entry.file) {
            (Some(values), _) => values.clone(),
            (None, Some(file)) => {
                self.files[&file.file].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
            }
            (None, None) => return Err(broken(format!("contexts.{name}: neither values nor file"))),
        };
        let expected: usize = entry.shape.iter().product();
        if values.len() != expected {
            return Err(broken(format!(
                "contexts.{name}: shape {:?} has {expected} values, there are {}",
                entry.shape,
                values.len()
            )));
        }
        Ok(Tensor::f32(&entry.shape, values))
    }

    /// The name of the context with a prompt.
    ///
    /// # Errors
    /// [`GuidanceError::Prompt`].
    pub fn context_of(&self, prompt: &str) -> Result<String, GuidanceError> {
        let contexts = &self.manifest.contexts;
        let found = contexts.iter().find(|(_, entry)| entry.prompt == prompt);
        found.map(|(name, _)| name.clone()).ok_or_else(|| GuidanceError::Prompt {
            prompt: prompt.to_owned(),
            has: contexts.values().map(|c| format!("{:?}", c.prompt)).collect(),
        })
    }
}

impl GuidanceManifest {
    fn files(&self) -> impl Iterator<Item = &FileEntry> {
        self.graphs.values().chain(self.contexts.values().filter_map(|c| c.file.as_ref()))
    }

    /// Declared ports of a graph: where, which, and whether it is an input.
    fn ports(&self, graph: &str) -> Vec<(String, PortSpec, bool)> {
        let mut out = Vec::new();
        for (what, term) in [("base", &self.base), ("personalised", &self.personalised)] {
            if term.graph != graph {
                continue;
            }
            let mut add = |role: &str, port: &PortSpec, input: bool| {
                out.push((format!("{what}.{role}"), port.clone(), input));
            };
            add("sample", &term.sample, true);
            add("time", &term.time, true);
            add("prediction", &term.prediction, false);
            for (role, port) in [("condition", &term.condition), ("told", &term.told)] {
                if let Some(port) = port {
                    add(role, port, true);
                }
            }
        }
        if let Some(latent) = &self.latent {
            let [w, h] = self.resolution;
            let picture = vec![1, 3, h, w];
            let port = |name: &str, shape: &[usize]| PortSpec { name: name.into(), shape: shape.to_vec() };
            match graph {
                "encoder" => {
                    out.push(("encoder".into(), port("picture", &picture), true));
                    out.push(("encoder".into(), port("latent", &latent.shape), false));
                }
                "encoder_vjp" => {
                    out.push(("encoder_vjp".into(), port("picture", &picture), true));
                    out.push(("encoder_vjp".into(), port("grad_latent", &latent.shape), true));
                    out.push(("encoder_vjp".into(), port("grad_picture", &picture), false));
                }
                _ => {}
            }
        }
        out
    }

    fn problems(&self) -> Vec<String> {
        let mut out = Vec::new();
        if self.format != "comgs-guidance" {
            out.push(format!("format: expected \"comgs-guidance\", got {:?}", self.format));
        }
        if self.version != 1 {
            out.push(format!("version: this program reads 1, got {}", self.version));
        }
        let [w, h] = self.resolution;
        if !(8..=2048).contains(&w) || !(8..=2048).contains(&h) {
            out.push(format!("resolution: expected 8 to 2048 each, got [{w}, {h}]"));
        }
        if !(1..=100_000).contains(&self.schedule.timesteps) {
            out.push(format!("schedule.timesteps: expected 1 to 100000, got {}", self.schedule.timesteps));
        }
        if !(self.time_scale.is_finite() && self.time_scale > 0.0) {
            out.push(format!("time_scale: expected a positive number, got {}", self.time_scale));
        }
        let sample = match &self.latent {
            Some(latent) => latent.shape.clone(),
            None => vec![1, 3, h, w],
        };
        let planes: usize = self.condition.iter().map(|p| p.count()).sum();
        for (what, term) in [("base", &self.base), ("personalised", &self.personalised)] {
            let mut shape = |role: &str, port: &PortSpec, expected: &[usize]| {
                if port.shape != expected {
                    out.push(format!("{what}.{role}.shape: expected {expected:?}, got {:?}", port.shape));
                }
            };
            shape("sample", &term.sample, &sample);
            shape("prediction", &term.prediction, &sample);
            shape("time", &term.time, &[1]);
            match (&term.condition, planes) {
                (Some(port), _) => shape("condition", port, &[1, planes, h, w]),
                (None, 0) => {}
                (None, _) => out.push(format!("{what}.condition: missing, {planes} channels are declared")),
            }
            if term.told.is_some() && term.context.is_none() {
                out.push(format!("{what}.context: missing, the graph is to be told something"));
            }
            if let (Some(port), Some(name)) = (&term.told, &term.context)
                && let Some(context) = self.contexts.get(name)
                && context.shape != port.shape
            {
                out.push(format!(
                    "{what}.told.shape: context {name:?} has {:?}, got {:?}",
                    context.shape, port.shape
                ));
            }
            if !self.graphs.contains_key(&term.graph) {
                out.push(format!("graphs.{}: missing", term.graph));
            }
        }
        for role in ["encoder", "encoder_vjp"] {
            if self.latent.is_some() && !self.graphs.contains_key(role) {
                out.push(format!("graphs.{role}: missing, a latent model needs it"));
            }
        }
        for entry in self.files() {
            // No path: a bundle reads nothing beside itself.
            if entry.file.is_empty() || entry.file.contains(['/', '\\']) || entry.file.contains("..") {
                out.push(format!("file: expected a file in the bundle, got {:?}", entry.file));
            }
        }
        out
    }
}
