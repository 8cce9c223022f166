//! The embedded runtime.

use super::{Data, Graph, OnnxError, Port, Tensor, find};
use rten::{Dimension, Model, ModelOptions, NodeId, RunOptions, Value};
use rten_tensor::{AsView, Layout};
use std::sync::Arc;

pub(super) struct Embedded {
    model: Model,
    label: String,
    inputs: Vec<Port>,
    outputs: Vec<Port>,
    pool: Option<Arc<rten::ThreadPool>>,
}

impl Embedded {
    pub(super) fn load(bytes: &[u8], label: &str, threads: usize) -> Result<Self, OnnxError> {
        let model = ModelOptions::with_all_ops().prepack_weights(true).load(bytes.to_vec()).map_err(|e| {
            let reason = one_line(&e.to_string());
            let unknown = ["unsupported", "not supported", "unknown operator", "not enabled", "operator"];
            if unknown.iter().any(|w| reason.to_lowercase().contains(w)) {
                OnnxError::Unsupported { graph: label.to_owned(), reason }
            } else {
                OnnxError::Read { graph: label.to_owned(), reason }
            }
        })?;
        let port = |id: &NodeId| {
            let info = model.node_info(*id);
            let name = info.as_ref().and_then(|i| i.name()).unwrap_or_default().to_owned();
            let shape = info.as_ref().and_then(|i| i.shape()).unwrap_or_default();
            let size = |d: &Dimension| match d {
                Dimension::Fixed(n) => Some(*n),
                Dimension::Symbolic(_) => None,
            };
            Port { name, shape: shape.iter().map(size).collect() }
        };
        let inputs = model.input_ids().iter().map(port).collect();
        let outputs = model.output_ids().iter().map(port).collect();
        let pool = (threads > 0).then(|| Arc::new(rten::ThreadPool::with_num_threads(threads)));
        Ok(Self { model, label: label.to_owned(), inputs, outputs, pool })
    }

    fn node(&self, ports: &[Port], name: &str, what: &'static str) -> Result<NodeId, OnnxError> {
        find(ports, name, &self.label, what)?;
        self.model.node_id(name).map_err(|e| self.failed(&e.to_string()))
    }

    fn failed(&self, reason: &str) -> OnnxError {
        OnnxError::Run { graph: self.label.clone(), reason: one_line(reason) }
    }
}

impl Graph for Embedded {
    fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    fn run(&self, inputs: &[(&str, Tensor)], outputs: &[&str]) -> Result<Vec<Tensor>, OnnxError> {
        let mut values = Vec::new();
        for (name, tensor) in inputs {
            let unfit = |reason: &dyn std::fmt::Display| self.failed(&format!("input {name:?}: {reason}"));
            let value = match &tensor.data {
                Data::F32(v) => {
                    Value::from_shape(tensor.shape.as_slice(), v.clone()).map_err(|e| unfit(&e))?
                }
                Data::I64(v) => {
                    let narrow: Result<Vec<i32>, _> = v.iter().map(|&x| i32::try_from(x)).collect();
                    let narrow =
                        narrow.map_err(|_| unfit(&"the embedded runtime holds integers in 32 bits"))?;
                    Value::from_shape(tensor.shape.as_slice(), narrow).map_err(|e| unfit(&e))?
                }
            };
            values.push((self.node(&self.inputs, name, "input")?, value.into()));
        }
        let ids: Vec<NodeId> =
            outputs.iter().map(|name| self.node(&self.outputs, name, "output")).collect::<Result<_, _>>()?;
        let options = RunOptions::default().with_thread_pool(self.pool.clone());
        let results = self.model.run(values, &ids, Some(options)).map_err(|e| self.failed(&e.to_string()))?;
        results
            .into_iter()
            .map(|value| {
                if let Some(t) = value.as_tensor_view::<f32>() {
                    return Ok(Tensor::f32(t.shape(), t.to_vec()));
                }
                if let Some(t) = value.as_tensor_view::<i32>() {
                    return Ok(Tensor::i64(t.shape(), t.iter().map(|&x| i64::from(x)).collect()));
                }
                Err(self.failed("an output is neither float32 nor an integer"))
            })
            .collect()
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
