//! Light that is scattered once on the object before it arrives.
//!
//! The paper leaves it out of rendering for its cost (§ 3.3). Here it is one more colour of the surfels: the light that
//! each scatters under the new map is worked out once, then whatever sees surfels sees it.
//!
//! ```text
//! B = albedo / π · ∫ (1 − O) L cos θ dω    at the surfel's centre, on its outer side
//! ```
//!
//! For a dielectric (metallic 0) this is its matte term; its highlight, about 4 % of the light, is not passed on. A metal
//! (metallic 1) has no matte term; what it reflects is passed on as if scattered evenly with reflectance `albedo`: right
//! in sum (but for what the model of the highlight loses at high roughness), without the caustics. In between,
//! `(1 − metallic) albedo + metallic albedo = albedo`.
//!
//! B is constant over directions: a surfel has one colour for both of its sides. On the inner side of a closed object no
//! one looks; of a sheet that is seen from both sides, the side away from the probes shows the colour of the other.

use super::RelightConfig;
use super::light_sets::LightSets;
use super::shade::{irradiance, streams};
use super::surroundings::{Around, Surroundings};
use comgs_geom::sampling::{cosine_hemisphere, hammersley};
use comgs_geom::sh;
use comgs_light::EnvironmentSampler;
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud, activation::sigmoid};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// Rays to each side that tell the outside of a surfel where there are no probes.
const SIDE_RAYS: u32 = 16;

/// The cloud with the light that it scatters as its only colour. Parallel, the same bytes at any thread count.
pub(super) fn glowing(
    cloud: &SurfelCloud,
    material: &MaterialColumns,
    surroundings: &Surroundings<'_>,
    light: &EnvironmentSampler,
    config: &RelightConfig,
) -> SurfelCloud {
    let sides: Vec<Vec3> =
        (0..SIDE_RAYS).map(|s| cosine_hemisphere(hammersley(s, SIDE_RAYS, Vec2::splat(0.5)))).collect();
    let sets = LightSets::new(light, config.bounce_rays / 2, config.seed, streams::BOUNCE);
    let radiance: Vec<Vec3> = (0..cloud.len())
        .into_par_iter()
        .with_min_len(64)
        .map_init(
            || Around::new(surroundings),
            |around, i| {
                let position = Vec3::from_array(cloud.positions[i]);
                let normal = surroundings.outward(position, cloud.rotation(i).z_axis, &sides);
                around.go_to(position, normal);
                let stream = streams::SURFELS + i as u64;
                let irradiance = irradiance(normal, stream, light, &sets, around, config.seed);
                let albedo = Vec3::from_array(material.albedo_logits[i].map(sigmoid));
                albedo * FRAC_1_PI * irradiance
            },
        )
        .collect();
    let constant = sh::basis(0, Vec3::Z)[0];
    SurfelCloud {
        sh: radiance.iter().flat_map(|c| c.to_array().map(|v| (v - 0.5) / constant)).collect(),
        sh_degree: 0,
        color_encoding: ColorEncoding::Linear,
        material: None,
        ..cloud.clone()
    }
}
