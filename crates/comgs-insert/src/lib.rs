//! Insertion of an object into one photo by differentiable light (DiPIR: Liang et al. 2024, "Photorealistic Object
//! Insertion with Diffusion-Guided Inverse Rendering").

pub mod light;
#[cfg(test)]
mod reference;
pub mod tone;
