//! Why probes could not be made, baked or read.

use crate::FusionReport;
use thiserror::Error;

/// What this crate refuses.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ProbeError {
    /// A configuration is out of range; all problems.
    #[error("unusable probe configuration: {}", .0.join("; "))]
    Config(Vec<String>),
    /// A view of the fusion cannot be used; all its problems.
    #[error("view {index} ({name}) cannot be fused: {}", .problems.join("; "))]
    View {
        /// Number of the view.
        index: usize,
        /// Name of its camera.
        name: String,
        /// What is wrong with it.
        problems: Vec<String>,
    },
    /// Depth fusion found no point that enough views agree on.
    #[error("depth fusion found no consistent point: {}", .0.explanation())]
    NoConsistentPoints(Box<FusionReport>),
    /// Probes were to be placed on nothing.
    #[error("no probe can be placed: none of the {0} points is finite and has a normal")]
    NoPoints(usize),
    /// The object's size is no length.
    #[error("the object's size is {0}, expected a finite length above 0")]
    Size(f32),
    /// A probe set contradicts itself; all problems.
    #[error("unusable probe set: {}", .0.join("; "))]
    Set(Vec<String>),
    /// The caller asked to stop.
    #[error("baking was stopped after {done} of {total} probes; the set is unchanged")]
    Cancelled {
        /// Probes that were finished.
        done: usize,
        /// Probes in the set.
        total: usize,
    },
    /// Bytes that are no probe file.
    #[error("not a readable probe file: {0}")]
    Format(String),
}
