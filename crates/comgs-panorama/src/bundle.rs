//! A model bundle: a folder with ONNX graphs and a `model.json` that declares all there is to know to run them.
//!
//! Nothing is guessed from names or shapes: graphs with checksums, the roles of their inputs and outputs, the channels of
//! the condition and their order, encodings, schedule, licence. `docs/formats.md` lists the fields.

mod manifest;

pub use manifest::{
    Channels, CodesSpace, Exposures, GraphEntry, HowExposed, ImageChannels, LatentChannels, LatentSpace,
    Manifest, MaskMeaning, PortEntry, Prompts, Space, Tone, White,
};

use crate::onnx::{Graph, OnnxError, Runtime, Tensor};
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

/// A bundle that was read: the manifest and the bytes of its graphs, whose checksums are right.
#[derive(Clone, Debug)]
pub struct Bundle {
    /// The manifest.
    pub manifest: Manifest,
    /// Where it came from; for reports.
    pub origin: String,
    files: BTreeMap<String, std::borrow::Cow<'static, [u8]>>,
}

/// What files that are no graphs go by in [`Bundle::files`].
const PROMPTS: &str = "prompts (embeddings)";

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
        Self::assemble(manifest, path, &folder.display().to_string(), &|file| {
            let failed =
                |e: std::io::Error| ModelError::Read { path: folder.join(file), reason: e.to_string() };
            read(file).map(Into::into).map_err(failed)
        })
    }

    fn assemble(
        text: &[u8],
        path: &Path,
        origin: &str,
        read: &dyn Fn(&str) -> Result<std::borrow::Cow<'static, [u8]>, ModelError>,
    ) -> Result<Self, ModelError> {
        let broken = |problems: Vec<String>| ModelError::Manifest { path: path.to_owned(), problems };
        let manifest: Manifest = serde_json::from_slice(text).map_err(|e| broken(vec![e.to_string()]))?;
        let problems = manifest.problems();
        if !problems.is_empty() {
            return Err(broken(problems));
        }
        let mut files = BTreeMap::new();
        let graphs = manifest.graphs.iter().map(|(role, g)| (role.as_str(), &g.file, &g.blake3));
        let prompts = manifest.prompts().map(|p| (PROMPTS, &p.file, &p.blake3));
        for (role, file, blake3) in graphs.chain(prompts) {
            let bytes = read(file)?;
            let got = blake3::hash(&bytes).to_hex().to_string();
            if got != *blake3 {
                return Err(ModelError::Checksum { graph: file.clone(), expected: blake3.clone(), got });
            }
            files.insert(role.to_owned(), bytes);
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

    /// A prompt's embedding by its name, `[1, tokens, width]`.
    ///
    /// # Errors
    /// [`ModelError::Manifest`] when the bundle has no such embedding, or its file is no safetensors of `float32`.
    pub fn embedding(&self, name: &str) -> Result<Tensor, ModelError> {
        let broken = |what: String| ModelError::Manifest {
            path: PathBuf::from(&self.origin),
            problems: vec![format!("space.prompts: {what}")],
        };
        let bytes = self.files.get(PROMPTS).ok_or_else(|| broken("missing".into()))?;
        let file = safetensors::SafeTensors::deserialize(bytes).map_err(|e| broken(e.to_string()))?;
        let tensor = file
            .tensor(name)
            .map_err(|_| broken(format!("no embedding {name:?}; it has {}", file.names().join(", "))))?;
        if tensor.dtype() != safetensors::Dtype::F32 || tensor.shape().len() != 3 || tensor.shape()[0] != 1 {
            let got = format!("{:?} of shape {:?}", tensor.dtype(), tensor.shape());
            return Err(broken(format!("{name}: expected float32 [1, tokens, width], got {got}")));
        }
        let values = tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Ok(Tensor::f32(tensor.shape(), values.collect()))
    }

    /// Size of its files in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.files.values().map(|f| f.len()).sum()
    }
}
