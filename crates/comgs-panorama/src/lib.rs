//! Light at a place: a 360° sweep of the scene's radiance field around it, and what to put where the scene was never
//! seen.
//!
//! [`sweep()`] traces an equirectangular panorama through the surfels; [`complete()`] fills its holes. The harmonic
//! completion is the baseline without learning that a learned one must beat: the smoothest field of log radiance on
//! the sphere that agrees with what was seen.

pub mod brackets;
pub mod bundle;
pub mod codes;
pub mod completion;
pub mod evidence;
pub mod learned;
pub mod onnx;
pub mod partial;
mod poisson;
pub mod schedule;
pub mod simple;
pub mod sweep;

pub use bundle::{Bundle, Manifest, ModelError};
pub use completion::{Completion, CompletionError, complete, complete_harmonic};
pub use learned::{Learned, Samples};
pub use onnx::{OnnxError, Runtime};
pub use partial::{Completer, Partial};
pub use simple::{Bank, Constant, Harmonic, Nothing, SphericalHarmonics};
pub use sweep::{Sweep, SweepConfig, sweep};
