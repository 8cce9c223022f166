//! Insertion of an object into one photo by differentiable light (DiPIR: Liang et al. 2024, "Photorealistic Object
//! Insertion with Diffusion-Guided Inverse Rendering").
//!
//! Modules in the order of the work: the virtual scene ([`mod@horizon`], [`ground`], [`object`]), what light does in it ([`transport`]), the
//! light, the tone and the material that are optimised ([`light`], [`tone`], [`fusion`], [`material`]), the picture ([`mod@composite`]), and the
//! optimisation under a guidance ([`guidance`], [`lds`], [`mod@optimise`]).
//! [`preview`](mod@preview) shows the scene beforehand, [`panorama`] says what light a photo itself tells of, and
//! [`render`](mod@render) makes the final picture at full size. [`session`] has the steps that
//! the stage and the benchmark share.

pub mod composite;
mod error;
pub mod fusion;
pub mod ground;
pub mod guidance;
pub mod horizon;
pub mod lds;
pub mod light;
pub mod material;
pub mod object;
pub mod optimise;
pub mod panorama;
pub mod preview;
#[cfg(test)]
mod reference;
pub mod render;
pub mod session;
pub mod tone;
pub mod transport;

pub use error::InsertError;
pub use optimise::{Outcome, Problem, Settings, State, optimise, optimise_with};
