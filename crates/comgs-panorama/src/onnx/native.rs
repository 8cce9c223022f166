//! The native runtime.

use super::{Data, Graph, OnnxError, Port, Tensor, find};
use ort::environment::Environment;
use ort::session::{Session, SessionInputValue};
use ort::value::{Outlet, ValueType};
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

/// A process can load one library once.
static LOADED: OnceLock<Result<(PathBuf, Environment), String>> = OnceLock::new();

fn environment(library: &Path) -> Result<&'static Environment, OnnxError> {
    let failed = |reason: String| OnnxError::Library { library: library.to_owned(), reason };
    let loaded = LOADED.get_or_init(|| {
        // `init_from` reports what is wrong; the automatic look-up would panic.
        let builder = ort::init_from(library).map_err(|e| e.to_string())?;
        let environment =
            builder.with_name("comgs").with_telemetry(false).build().map_err(|e| e.to_string())?;
        Ok((library.to_owned(), environment))
    });
    match loaded {
        Ok((path, environment)) if path == library => Ok(environment),
        Ok((path, _)) => Err(failed(format!("another one is in use already: {}", path.display()))),
        Err(reason) => Err(failed(reason.clone())),
    }
}

pub(super) struct Native {
    /// Running needs exclusive access.
    session: Mutex<Session>,
    label: String,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
}

impl Native {
    pub(super) fn load(library: &Path, bytes: &[u8], label: &str, threads: usize) -> Result<Self, OnnxError> {
        let environment = environment(library)?;
        let session = session(environment, bytes, threads)
            .map_err(|reason| OnnxError::Read { graph: label.to_owned(), reason })?;
        let port = |outlet: &Outlet| {
            let shape = match outlet.dtype() {
                ValueType::Tensor { shape, .. } => shape.iter().map(|&n| usize::try_from(n).ok()).collect(),
                _ => Vec::new(),
            };
            Port { name: outlet.name().to_owned(), shape }
        };
        let inputs = session.inputs().iter().map(port).collect();
        let outputs = session.outputs().iter().map(port).collect();
        Ok(Self { session: Mutex::new(session), label: label.to_owned(), inputs, outputs })
    }

    fn failed(&self, reason: impl ToString) -> OnnxError {
        OnnxError::Run { graph: self.label.clone(), reason: reason.to_string() }
    }
}

fn session(environment: &Environment, bytes: &[u8], threads: usize) -> Result<Session, String> {
    let mut builder = Session::builder(environment).map_err(|e| e.to_string())?;
    if threads > 0 {
        builder = builder.with_intra_threads(threads).map_err(|e| e.to_string())?;
    }
    builder.commit_from_memory(bytes).map_err(|e| e.to_string())
}

impl Graph for Native {
    fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    fn run(&self, inputs: &[(&str, Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, OnnxError> {
        for name in outputs {
            find(&self.outputs, name, &self.label, "output")?;
        }
        let mut values: Vec<(Cow<'_, str>, SessionInputValue<'_>)> = Vec::new();
        for (name, tensor) in inputs {
            find(&self.inputs, name, &self.label, "input")?;
            let shape: Vec<i64> = tensor.shape.iter().map(|&n| n as i64).collect();
            let value = match &tensor.data {
                Data::F32(v) => ort::value::Tensor::from_array((shape, v.clone())).map(|t| t.upcast()),
                Data::I64(v) => ort::value::Tensor::from_array((shape, v.clone())).map(|t| t.upcast()),
            };
            values.push((Cow::from(*name), value.map_err(|e| self.failed(e))?.into()));
        }
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let results = session.run(values).map_err(|e| self.failed(e))?;
        outputs
            .iter()
            .map(|name| {
                let value = &results[*name];
                if let Ok((shape, data)) = value.try_extract_tensor::<f32>() {
                    let shape: Vec<usize> = shape.iter().map(|&n| n as usize).collect();
                    return Ok(Tensor::f32(&shape, data.to_vec()));
                }
                let (shape, data) = value.try_extract_tensor::<i64>().map_err(|e| self.failed(e))?;
                let shape: Vec<usize> = shape.iter().map(|&n| n as usize).collect();
                Ok(Tensor::i64(&shape, data.to_vec()))
            })
            .collect()
    }
}
