//! A model bundle: a folder with ONNX graphs and a `model.json` that declares all there is to know to run them.
//!
//! Nothing is guessed from names or shapes: graphs with checksums, the roles of their inputs and outputs, the channels of
//! the condition and their order, encodings, schedule, licence. `docs/formats.md` lists the fields.

use crate::codes::Codes;
use crate::onnx::{Graph, OnnxError, Runtime};
use crate::schedule::{Schedule, Solver};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a bundle cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ModelError {
    /// A file of it cannot be read.
    #[error("model bundle: cannot be read: {reason}: {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// `model.json` is not what it should be; every problem at once.
    #[error("model bundle: {}: {}", problems.join("; "), path.display())]
    Manifest {
        /// The manifest.
        path: PathBuf,
        /// What is wrong, each with its field.
        problems: Vec<String>,
    },
    /// A file is not the one that the manifest was written for.
    #[error(
        "model bundle: checksum of {graph}: expected {expected}, got {got}: the file is damaged or another one"
    )]
    Checksum {
        /// Which graph.
        graph: String,
        /// BLAKE3 in the manifest.
        expected: String,
        /// BLAKE3 of the file.
        got: String,
    },
    /// A graph cannot be loaded or run.
    #[error(transparent)]
    Onnx(#[from] OnnxError),
    /// The network gave no usable sample.
    #[error("the model gave values that are no numbers in all of {tried} samples")]
    NotFinite {
        /// Samples tried.
        tried: usize,
    },
}

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
    /// Width and height it works at.
    pub resolution: [usize; 2],
    /// Channels of the condition, in order.
    pub condition: Vec<Channels>,
    /// The encodings of radiance.
    pub codes: Codes,
    /// How noise was added in training.
    pub schedule: Schedule,
    /// The sampler to use.
    #[serde(default)]
    pub solver: Solver,
    /// Steps to take when the user says nothing.
    pub steps: usize,
    /// Whether the network was trained with zeros instead of noise at the last training step, so that a single step gives
    /// the mean.
    #[serde(default)]
    pub zeros_at_last_step: bool,
    /// Its graphs by role: `denoiser`.
    pub graphs: BTreeMap<String, GraphEntry>,
}

/// A group of channels of the condition.
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

/// A declared input or output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PortEntry {
    /// Name in the graph.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
}

/// A bundle that was read: the manifest and the bytes of its graphs, whose checksums are right.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// The manifest.
    pub manifest: Manifest,
    /// Where it came from; for reports.
    pub origin: String,
    files: BTreeMap<String, std::borrow::Cow<'static, [u8]>>,
}

const SHIPPED_MANIFEST: &[u8] = include_bytes!("../../../assets/panorama/model.json");
const SHIPPED_GRAPH: &[u8] = include_bytes!("../../../assets/panorama/completer.onnx");

impl Bundle {
    /// The small model that is part of this program (`assets/panorama`).
    ///
    /// # Errors
    /// [`ModelError`]; never, unless the files were changed without their manifest, which a test watches.
    pub fn shipped() -> Result<Self, ModelError> {
        Self::assemble(
            SHIPPED_MANIFEST,
            Path::new("assets/panorama/model.json"),
            "shipped with comgs",
            &|_| Ok(SHIPPED_GRAPH.into()),
        )
    }

    /// A bundle from its manifest and what reads its files, checked: fields, checksums, that declared files are there.
    ///
    /// * `manifest`: the bytes of `model.json`
    /// * `path`: where that is; for errors, and its folder for reports
    /// * `read`: the content of a file of the bundle, by its name
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn from_parts(
        manifest: &[u8],
        path: &Path,
        read: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
    ) -> Result<Self, ModelError> {
        let folder = path.parent().unwrap_or(path);
        Self::assemble(manifest, path, &folder.display().to_string(), &|entry| {
            let failed = |e: std::io::Error| ModelError::Read {
                path: folder.join(&entry.file),
                reason: e.to_string(),
            };
            read(&entry.file).map(Into::into).map_err(failed)
        })
    }

    fn assemble(
        text: &[u8],
        path: &Path,
        origin: &str,
        read: &dyn Fn(&GraphEntry) -> Result<std::borrow::Cow<'static, [u8]>, ModelError>,
    ) -> Result<Self, ModelError> {
        let broken = |problems: Vec<String>| ModelError::Manifest { path: path.to_owned(), problems };
        let manifest: Manifest = serde_json::from_slice(text).map_err(|e| broken(vec![e.to_string()]))?;
        let problems = manifest.problems();
        if !problems.is_empty() {
            return Err(broken(problems));
        }
        let mut files = BTreeMap::new();
        for (role, entry) in &manifest.graphs {
            let bytes = read(entry)?;
            let got = blake3::hash(&bytes).to_hex().to_string();
            if got != entry.blake3 {
                return Err(ModelError::Checksum {
                    graph: entry.file.clone(),
                    expected: entry.blake3.clone(),
                    got,
                });
            }
            files.insert(role.clone(), bytes);
        }
        Ok(Self { manifest, origin: origin.to_owned(), files })
    }

    /// Loads a graph and compares its ports with what the manifest declares.
    ///
    /// # Errors
    /// [`ModelError::Onnx`] from the runtime; [`ModelError::Manifest`] when names or shapes differ.
    pub fn load(&self, role: &str, runtime: &Runtime, threads: usize) -> Result<Box<dyn Graph>, ModelError> {
        let path = PathBuf::from(&self.origin);
        let (Some(entry), Some(bytes)) = (self.manifest.graphs.get(role), self.files.get(role)) else {
            return Err(ModelError::Manifest { path, problems: vec![format!("graphs.{role}: missing")] });
        };
        let graph = runtime.load(bytes, &entry.file, threads)?;
        let mut problems = Vec::new();
        for (what, declared, has) in
            [("inputs", &entry.inputs, graph.inputs()), ("outputs", &entry.outputs, graph.outputs())]
        {
            for (port_role, port) in declared {
                let at = format!("graphs.{role}.{what}.{port_role}");
                let Some(found) = has.iter().find(|p| p.name == port.name) else {
                    let names: Vec<&str> = has.iter().map(|p| p.name.as_str()).collect();
                    problems.push(format!(
                        "{at}: the graph has no {:?}; it has {}",
                        port.name,
                        names.join(", ")
                    ));
                    continue;
                };
                let same = found.shape.len() == port.shape.len()
                    && found.shape.iter().zip(&port.shape).all(|(a, b)| a.is_none_or(|a| a == *b));
                // Runtimes that do not infer an output's shape give none.
                if !same && !found.shape.is_empty() {
                    let shape: Vec<String> =
                        found.shape.iter().map(|n| n.map_or("?".into(), |n| n.to_string())).collect();
                    problems.push(format!(
                        "{at}: declared as {:?}, the graph has [{}]",
                        port.shape,
                        shape.join(", ")
                    ));
                }
            }
        }
        if problems.is_empty() { Ok(graph) } else { Err(ModelError::Manifest { path, problems }) }
    }

    /// Size of its graphs in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.files.values().map(|f| f.len()).sum()
    }
}

impl Manifest {
    fn problems(&self) -> Vec<String> {
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
        self.codes.problems(&mut out);
        self.schedule.problems(&mut out);
        let condition: usize = self.condition.iter().map(|c| c.count()).sum();
        match self.graphs.get("denoiser") {
            None => out.push("graphs.denoiser: missing".into()),
            Some(graph) => {
                let mut port =
                    |what: &str, ports: &BTreeMap<String, PortEntry>, role: &str, shape: &[usize]| {
                        let at = format!("graphs.denoiser.{what}.{role}");
                        match ports.get(role) {
                            None => out.push(format!("{at}: missing")),
                            Some(p) if p.shape != shape => {
                                out.push(format!("{at}.shape: expected {shape:?}, got {:?}", p.shape));
                            }
                            Some(_) => {}
                        }
                    };
                port("inputs", &graph.inputs, "sample", &[1, 6, height, width]);
                port("inputs", &graph.inputs, "time", &[1]);
                port("inputs", &graph.inputs, "condition", &[1, condition, height, width]);
                port("outputs", &graph.outputs, "prediction", &[1, 6, height, width]);
            }
        }
        for (role, graph) in &self.graphs {
            let plain = Path::new(&graph.file).components().count() == 1 && !graph.file.contains("..");
            if !plain || graph.file.is_empty() {
                out.push(format!("graphs.{role}.file: expected a file in the bundle, got {:?}", graph.file));
            }
        }
        out
    }
}
