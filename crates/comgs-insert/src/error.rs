//! What can go wrong.

use crate::ground::GroundError;
use thiserror::Error;

/// Why an object cannot be inserted.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InsertError {
    /// The ground.
    #[error(transparent)]
    Ground(#[from] GroundError),
    /// Something that is not what is needed.
    #[error("{what}: expected {expected}, got {got}")]
    Input {
        /// Which.
        what: &'static str,
        /// What it should be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// The matrix of transport does not fit.
    #[error(
        "transport of {pixels} pixels under a map of {height} rows may take {needed} bytes, the limit is {limit}; a \
         smaller --width, a smaller object or a larger --memory helps"
    )]
    Memory {
        /// Pixels of the object.
        pixels: usize,
        /// Rows of the smallest map that was tried.
        height: usize,
        /// Bytes that it may take.
        needed: usize,
        /// Bytes allowed.
        limit: usize,
    },
    /// The models of the guidance.
    #[error(transparent)]
    Guidance(#[from] crate::lds::GuidanceError),
    /// A parameter became NaN or infinite.
    #[error("the optimisation diverged at iteration {iteration}")]
    Diverged {
        /// From 0.
        iteration: usize,
    },
    /// Asked to stop.
    #[error("stopped")]
    Stopped,
}
