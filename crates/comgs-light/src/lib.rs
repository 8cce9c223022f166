//! Light from everywhere, and what surfaces make of it.
//!
//! * [`EnvironmentMap`], [`EnvironmentSampler`]: equirectangular maps of linear radiance, and importance sampling of them.
//! * [`LightSplit`]: the small strong lights of a map apart from its smooth rest.
//! * [`OctahedralLight`], [`OctahedralSampler`]: a learnable octahedral map with gradients, and its sampling;
//!   [`LightPyramid`] is the parameterisation that is optimised.
//! * [`MipLight`]: a map by means over cones and by irradiance, for shading with few lookups.
//! * [`brdf`]: the reflectance model, its sampling and its gradients.
//!
//! Two maps, two meanings of their texels. An octahedral light is bilinear for every purpose, and its sampler follows
//! the interpolation. An equirectangular map is for looking at and for sampling:
//!
//! For every integral (sampling, [`EnvironmentMap::irradiance`], [`EnvironmentMap::integral`]) a map is piecewise
//! constant: the radiance from a direction is its texel's value ([`EnvironmentMap::radiance`]). The smooth, bilinear
//! [`EnvironmentMap::lookup`] is for looking at a map. The distinction matters: a sun of one texel at 10⁵ bleeds
//! half its radiance into neighbours that a sampler of texels visits a hundred million times less often, and each
//! such visit is a firefly.

pub mod brdf;
mod cumulative;
pub mod environment;
pub mod facing;
pub mod light_pyramid;
pub mod mip_light;
pub mod octahedral_light;
pub mod octahedral_sampler;
pub mod sampler;
pub mod split;

pub use brdf::{Material, MaterialGradient, Shading};
pub use environment::{EnvError, EnvReport, EnvironmentMap};
pub use facing::{facing_normal, facing_normal_vjp};
pub use light_pyramid::LightPyramid;
pub use mip_light::MipLight;
pub use octahedral_light::{OctahedralError, OctahedralLight};
pub use octahedral_sampler::{Importance, OctahedralSampler};
pub use sampler::{EnvSample, EnvironmentSampler};
pub use split::{LightSplit, SplitConfig, StrongLight, StrongTexel};

/// Luminance of linear Rec.709 radiance.
#[must_use]
pub fn luminance(rgb: glam::Vec3) -> f32 {
    rgb.dot(glam::Vec3::new(0.2126, 0.7152, 0.0722))
}
