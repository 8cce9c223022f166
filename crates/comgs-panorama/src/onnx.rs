//! Running ONNX graphs: one trait, two runtimes, chosen at run time.
//!
//! * *embedded*: `rten`, pure Rust, needs nothing but cargo. The default.
//! * *native*: Microsoft's ONNX Runtime through `ort`, about twice as fast, when its shared library is at hand, for
//!   example the one inside the Python wheel `onnxruntime`. It is loaded when asked for; nothing is linked or downloaded.
//!
//! Both give the same numbers to 1e-4 (`tests/backends.rs`). A graph's inputs and outputs go by name.

mod embedded;
mod native;

use std::path::PathBuf;
use thiserror::Error;

/// Where graphs are run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Runtime {
    /// In this program, on `rten`.
    #[default]
    Embedded,
    /// By the ONNX Runtime whose shared library this is (version 1.24 or later).
    Native(PathBuf),
}

impl Runtime {
    /// Name for reports.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Embedded => "embedded (rten)",
            Self::Native(_) => "native (ONNX Runtime)",
        }
    }

    /// Reads a graph.
    ///
    /// * `bytes`: an ONNX file
    /// * `label`: what errors call it
    /// * `threads`: how many to use; all cores when 0
    ///
    /// # Errors
    /// [`OnnxError`] when it is no ONNX graph, when an operator is unknown to this runtime, or when the native library
    /// cannot be loaded.
    pub fn load(&self, bytes: &[u8], label: &str, threads: usize) -> Result<Box<dyn Graph>, OnnxError> {
        match self {
            Self::Embedded => Ok(Box::new(embedded::Embedded::load(bytes, label, threads)?)),
            Self::Native(library) => Ok(Box::new(native::Native::load(library, bytes, label, threads)?)),
        }
    }
}

/// Why a graph could not be read or run.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum OnnxError {
    /// No ONNX graph, or a damaged one.
    #[error("{graph}: cannot be read as an ONNX graph: {reason}")]
    Read {
        /// Which graph.
        graph: String,
        /// What the runtime said.
        reason: String,
    },
    /// The embedded runtime lacks an operator.
    #[error(
        "{graph}: the embedded runtime cannot run it: {reason}; ONNX Runtime may (--onnxruntime PATH or ORT_DYLIB_PATH, \
         for example the library inside the Python wheel onnxruntime)"
    )]
    Unsupported {
        /// Which graph.
        graph: String,
        /// What the runtime said; names the operator.
        reason: String,
    },
    /// The native library cannot be used.
    #[error("ONNX Runtime cannot be loaded: {reason}: {}", library.display())]
    Library {
        /// Its path.
        library: PathBuf,
        /// Why.
        reason: String,
    },
    /// An input or output that the graph does not have.
    #[error("{graph}: has no {what} {name:?}; it has {has}")]
    Name {
        /// Which graph.
        graph: String,
        /// `input` or `output`.
        what: &'static str,
        /// The name asked for.
        name: String,
        /// Names that it has.
        has: String,
    },
    /// Running it failed, mostly because of a shape.
    #[error("{graph}: {reason}")]
    Run {
        /// Which graph.
        graph: String,
        /// What the runtime said.
        reason: String,
    },
}

/// Numbers with a shape, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Sizes, slowest first.
    pub shape: Vec<usize>,
    /// As many as the product of the sizes.
    pub data: Data,
}

/// Element types that graphs here take.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    /// `float32`.
    F32(Vec<f32>),
    /// `int64`; the embedded runtime holds it in 32 bits.
    I64(Vec<i64>),
}

impl Tensor {
    /// Of `float32`.
    ///
    /// # Panics
    /// When the shape does not have as many elements as the data.
    #[must_use]
    pub fn f32(shape: &[usize], data: Vec<f32>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "shape {shape:?}");
        Self { shape: shape.to_vec(), data: Data::F32(data) }
    }

    /// Of `int64`.
    ///
    /// # Panics
    /// When the shape does not have as many elements as the data.
    #[must_use]
    pub fn i64(shape: &[usize], data: Vec<i64>) -> Self {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "shape {shape:?}");
        Self { shape: shape.to_vec(), data: Data::I64(data) }
    }

    /// Its numbers as `float32`.
    #[must_use]
    pub fn to_f32(&self) -> Vec<f32> {
        match &self.data {
            Data::F32(v) => v.clone(),
            Data::I64(v) => v.iter().map(|&x| x as f32).collect(),
        }
    }
}

/// An input or output: name and sizes, `None` where a size is free.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Its name in the graph.
    pub name: String,
    /// Its shape.
    pub shape: Vec<Option<usize>>,
}

/// A graph that can be run.
pub trait Graph: Send + Sync {
    /// What it takes.
    fn inputs(&self) -> &[Port];

    /// What it gives.
    fn outputs(&self) -> &[Port];

    /// Runs it: inputs by name, the outputs asked for in their order. The same inputs give the same bytes on one machine.
    ///
    /// # Errors
    /// [`OnnxError::Name`] and [`OnnxError::Run`].
    fn run(&self, inputs: &[(&str, Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, OnnxError>;
}

/// The port of that name, or an error that lists what there is.
fn find<'p>(ports: &'p [Port], name: &str, graph: &str, what: &'static str) -> Result<&'p Port, OnnxError> {
    ports.iter().find(|p| p.name == name).ok_or_else(|| OnnxError::Name {
        graph: graph.to_owned(),
        what,
        name: name.to_owned(),
        has: ports.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", "),
    })
}
