//! Insertion of an object into one photo by differentiable light (DiPIR: Liang et al. 2024, "Photorealistic Object
//! Insertion with Diffusion-Guided Inverse Rendering").
//!
//! Modules in the order of the work: the virtual scene ([`ground`], [`object`]), what light does in it ([`transport`]), the
//! light and the tone that are optimised ([`light`], [`tone`], [`fusion`]), the picture ([`mod@composite`]), and the
//! optimisation under a guidance ([`guidance`], [`mod@optimise`]).

pub mod composite;
mod error;
pub mod fusion;
pub mod ground;
pub mod guidance;
pub mod light;
pub mod object;
pub mod optimise;
#[cfg(test)]
mod reference;
pub mod tone;
pub mod transport;

pub use error::InsertError;
pub use optimise::{Outcome, Problem, Settings, State, optimise};
