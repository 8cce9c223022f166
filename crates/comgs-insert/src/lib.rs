//! Insertion of an object into one photo by differentiable light (DiPIR: Liang et al. 2024, "Photorealistic Object
//! Insertion with Diffusion-Guided Inverse Rendering").
//!
//! Modules in the order of the work: the virtual scene ([`ground`], [`object`]), the light and the tone that are
//! optimised ([`light`], [`tone`]), what they are seen through ([`transport`]).

pub mod ground;
pub mod light;
pub mod object;
#[cfg(test)]
mod reference;
pub mod tone;
pub mod transport;
