//! Light from everywhere: equirectangular environment maps of linear radiance, and importance sampling of them.
//!
//! For every integral (sampling, [`EnvironmentMap::irradiance`], [`EnvironmentMap::integral`]) a map is piecewise
//! constant: the radiance from a direction is its texel's value ([`EnvironmentMap::radiance`]). The smooth, bilinear
//! [`EnvironmentMap::lookup`] is for looking at a map. The distinction matters: a sun of one texel at 10⁵ bleeds
//! half its radiance into neighbours that a sampler of texels visits a hundred million times less often, and each
//! such visit is a firefly.

pub mod environment;
pub mod sampler;

pub use environment::{EnvError, EnvReport, EnvironmentMap};
pub use sampler::{EnvSample, EnvironmentSampler};

/// Luminance of linear Rec.709 radiance.
#[must_use]
pub fn luminance(rgb: glam::Vec3) -> f32 {
    rgb.dot(glam::Vec3::new(0.2126, 0.7152, 0.0722))
}
