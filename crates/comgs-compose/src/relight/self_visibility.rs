//! What an object hides from its own surfels, kept in the object's own space.
//!
//! It belongs to the object as its occlusion field does: made once, it serves any place, turn and size and any light, whose
//! sums ([`SelfVisibility::light`]) cost neither a ray (but for small strong lights) nor a lookup of probes.

use super::strong::Strong;
use super::surroundings::{Around, Probes, Surroundings};
use super::{NearField, RelightConfig, RelightError};
use crate::FieldShadow;
use crate::objects::bounding_sphere;
use crate::shadow_light::ShadowLight;
use comgs_geom::sampling::{cosine_hemisphere, hammersley};
use comgs_geom::{Similarity, frame, octahedral};
use comgs_light::MipLight;
use comgs_probe::{Neighbours, ProbeSet};
use comgs_surfel::{SurfelCloud, activation::sigmoid};
use comgs_trace::Tracer;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Texels along a side where the object is traced instead of read from probes: 12² are 72 rays a surfel.
const TRACED_SIDE: usize = 12;
/// Opacity below which nobody sees what a surfel is lit by.
const FAINT: f32 = 0.02;
/// Rays of a probe that find what it is lit by.
const BOUNCE_RAYS: u32 = 16;
/// Largest ratio: near a lamp, or beside a bright part of the object in a dark place.
const MAX_RATIO: f32 = 16.0;

/// Self-occlusion of every surfel.
#[derive(Clone, Debug)]
pub struct SelfVisibility {
    /// Texels along a side of the octahedral textures.
    side: usize,
    /// Height above the surface at which rays start, object units.
    offset: f32,
    /// Unit, outwards, object space.
    normals: Vec<Vec3>,
    /// `[surfel][texel]`: 1 − O in 255ths; empty for a surfel that is not seen.
    open: Vec<u8>,
    bounces: Option<Bounces>,
}

/// What probes see of the object.
#[derive(Clone, Debug)]
struct Bounces {
    /// `[probe][ray]`: the surfel that stops most of the ray, and how much of the ray the object stops.
    hits: Vec<(u32, f32)>,
    /// Of every surfel.
    neighbours: Vec<Neighbours>,
}

/// A surfel's light, as [`SelfVisibility::light`] finds it.
#[derive(Clone, Debug, Default)]
pub struct SurfelLight {
    /// Irradiance over that of the same surface in the open, RGB; 1 where nothing is hidden or there is no light.
    pub ratios: Vec<Vec3>,
    /// Mean radiance of what of the object each probe sees; empty without bounced light.
    pub glow: Vec<Vec3>,
}

/// Where an object stands, for its light.
#[derive(Clone, Copy)]
pub struct Standing<'a> {
    /// Its surfels, own space.
    pub cloud: &'a SurfelCloud,
    /// Its tracer, own space.
    pub tracer: &'a Tracer,
    /// Its place.
    pub world_from_object: Similarity,
}

impl SelfVisibility {
    /// From the object's probes where it has some, else from rays. `tracer` is of `cloud`; all in the object's own space.
    /// With `bounced`, what the probes see of the object is found too, for light that is scattered once; this needs probes.
    ///
    /// # Errors
    /// [`RelightError::Invisible`].
    pub fn new(
        cloud: &SurfelCloud,
        probes: Option<&ProbeSet>,
        tracer: &Tracer,
        bounced: bool,
        config: &RelightConfig,
    ) -> Result<Self, RelightError> {
        let (_, radius) = bounding_sphere(cloud).ok_or(RelightError::Invisible(cloud.len()))?;
        let offset = config.trace_offset * 2.0 * radius;
        let probes = probes.filter(|set| !set.is_empty()).map(|set| Probes::new(set, config));
        let neighbours = |probes: &Probes<'_>| -> Vec<Neighbours> {
            let near = |i: usize| probes.near(Vec3::from_array(cloud.positions[i]), Vec3::ZERO);
            (0..cloud.len()).into_par_iter().with_min_len(256).map(near).collect()
        };
        let bounces = probes.as_ref().filter(|_| bounced).map(|probes| Bounces {
            hits: bounce_hits(&probes.set, tracer, offset),
            neighbours: neighbours(probes),
        });
        let (side, surroundings) = match probes {
            Some(probes) => (probes.set.resolution, Surroundings::Probes(probes)),
            None => (TRACED_SIDE, Surroundings::Trace { tracer: tracer.clone(), offset, glowing: false }),
        };
        let sides: Vec<Vec3> =
            (0..16).map(|s| cosine_hemisphere(hammersley(s, 16, Vec2::splat(0.5)))).collect();
        let directions: Vec<Vec3> =
            (0..side * side).map(|t| octahedral::texel_direction(t % side, t / side, side)).collect();
        let made: Vec<(Vec3, Vec<u8>)> = (0..cloud.len())
            .into_par_iter()
            .with_min_len(64)
            .map_init(
                || Around::new(&surroundings),
                |around, i| {
                    let axis = cloud.rotation(i).z_axis;
                    if sigmoid(cloud.opacity_logits[i]) < FAINT {
                        return (axis, vec![255; side * side]);
                    }
                    let position = Vec3::from_array(cloud.positions[i]);
                    let normal = surroundings.outward(position, axis, &sides);
                    around.go_to(position, normal);
                    (normal, around.open_texels(&directions, normal))
                },
            )
            .collect();
        let mut out = Self { side, offset, normals: Vec::new(), open: Vec::new(), bounces };
        for (normal, texels) in made {
            out.normals.push(normal);
            out.open.extend(texels);
        }
        Ok(out)
    }

    /// Bytes of it.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        let bounces =
            self.bounces.as_ref().map_or(0, |b| size_of_val(&b.hits[..]) + size_of_val(&b.neighbours[..]));
        size_of_val(&self.normals[..]) + self.open.len() + bounces
    }

    /// The light of every surfel where the object stands:
    ///
    /// ```text
    /// ratio = (N Σ_k E_k cos⁺_k (1 − O_k) + Σ_b E_b cos⁺_b T_b) / (Σ_k E_k cos⁺_k + Σ_b E′_b cos⁺_b) + E_bounced / E_open
    /// ```
    ///
    /// with the smooth light's directions k, strong lights b (T traced; E′ of a lamp as `middle` sees it, so that the ratio
    /// carries how near it is), and the irradiance `base` of the open surface. `others` hides light too: visibilities
    /// multiply direction by direction. N is what the near field makes of the smooth light
    /// ([`NearField`], 1 without). Nothing but sums when the light changes.
    ///
    /// Deterministic at any thread count. Not differentiable. Reference: [`super::Relighter`] at many samples.
    #[must_use]
    pub fn light(
        &self,
        standing: &Standing<'_>,
        light: &ShadowLight,
        base: &MipLight,
        middle: Vec3,
        others: Option<&FieldShadow<'_>>,
        near: Option<&NearField>,
    ) -> SurfelLight {
        let to_own = standing.world_from_object.rotation.inverse().as_quat();
        let smooth: Vec<(Vec3, Vec3, octahedral::Footprint)> = light
            .directions
            .iter()
            .zip(&light.energy)
            .map(|(d, e)| (to_own * *d, *e, octahedral::footprint(to_own * *d, self.side)))
            .collect();
        let strong = Strong::new(light, standing, middle, others);
        let texels = self.side * self.side;
        let points = standing.points();
        // What the other objects leave open, `[surfel][direction]`.
        let left = others.map(|others| others.open(&points)).unwrap_or_default();
        let count = smooth.len();
        let to_world = standing.world_from_object.rotation.as_quat();
        let near = near.map(|near| (near, near.grid(self.side, to_world)));
        let mut ratios: Vec<Vec3> = self
            .open
            .par_chunks_exact(texels)
            .enumerate()
            .with_min_len(64)
            .map(|(i, open)| {
                if sigmoid(standing.cloud.opacity_logits[i]) < FAINT {
                    return Vec3::ONE;
                }
                let normal = self.normals[i];
                let (mut lit, mut all) = (Vec3::ZERO, Vec3::ZERO);
                let left = left.get(i * count..(i + 1) * count);
                for (k, (direction, energy, footprint)) in smooth.iter().enumerate() {
                    let cosine = normal.dot(*direction);
                    if cosine > 0.0 {
                        let tap =
                            |k: usize| footprint.weights[k] * f32::from(open[footprint.texels[k] as usize]);
                        let own = ((tap(0) + tap(1)) + (tap(2) + tap(3))) * (1.0 / 255.0);
                        let visible = left.map_or(own, |left| own * f32::from(left[k]) * (1.0 / 255.0));
                        all += cosine * *energy;
                        lit += (visible * cosine) * *energy;
                    }
                }
                if let Some((near, grid)) = &near {
                    lit *= near.factor(points[i], to_world * normal, grid, |t| f32::from(open[t]));
                }
                let point = Vec3::from_array(standing.cloud.positions[i]);
                let (strong_lit, strong_all) = strong.at(point, normal, self.offset);
                ratio(lit + strong_lit, all + strong_all)
            })
            .collect();
        let glow = self.bounced(standing, base, &mut ratios);
        SurfelLight { ratios, glow }
    }

    /// Adds what is scattered once on the object; the mean radiance that each probe sees of it.
    fn bounced(&self, standing: &Standing<'_>, base: &MipLight, ratios: &mut [Vec3]) -> Vec<Vec3> {
        let (Some(bounces), Some(material)) = (&self.bounces, &standing.cloud.material) else {
            return Vec::new();
        };
        let to_world = standing.world_from_object.rotation.as_quat();
        let open: Vec<Vec3> = self.normals.par_iter().map(|n| base.irradiance(to_world * *n)).collect();
        // All that a surface reflects, as if evenly, as in [`super::bounce`].
        let radiance: Vec<Vec3> = (0..ratios.len())
            .into_par_iter()
            .map(|i| Vec3::from_array(material.albedo_logits[i].map(sigmoid)) / PI * open[i] * ratios[i])
            .collect();
        let seen: Vec<(Vec3, f32)> = bounces
            .hits
            .par_chunks_exact(BOUNCE_RAYS as usize)
            .map(|rays| {
                let sum = |(sum, weight): (Vec3, f32), &(surfel, alpha): &(u32, f32)| {
                    (sum + alpha * radiance[surfel as usize], weight + alpha)
                };
                rays.iter().fold((Vec3::ZERO, 0.0), sum)
            })
            .collect();
        let floor = 1e-3 * base.mean_irradiance();
        ratios.par_iter_mut().enumerate().for_each(|(i, ratio)| {
            // Rays by the cosine: the irradiance is π times the mean.
            let irradiance: Vec3 = bounces.neighbours[i]
                .iter()
                .map(|(probe, weight)| weight * PI / BOUNCE_RAYS as f32 * seen[probe].0)
                .sum();
            let over = |light: f32, open: f32, floor: f32| if open > floor { light / open } else { 0.0 };
            let more = Vec3::new(
                over(irradiance.x, open[i].x, floor.x),
                over(irradiance.y, open[i].y, floor.y),
                over(irradiance.z, open[i].z, floor.z),
            );
            *ratio = (*ratio + more).min(Vec3::splat(MAX_RATIO));
        });
        seen.iter().map(|(sum, weight)| if *weight > 0.0 { *sum / *weight } else { Vec3::ZERO }).collect()
    }
}

/// Light over light; 1 where there is none.
fn ratio(lit: Vec3, all: Vec3) -> Vec3 {
    let channel =
        |lit: f32, all: f32| if all > crate::DARK { (lit / all).clamp(0.0, MAX_RATIO) } else { 1.0 };
    Vec3::new(channel(lit.x, all.x), channel(lit.y, all.y), channel(lit.z, all.z))
}

/// For every ray of every probe, by the cosine about its normal: the surfel that stops most of it, and how much is stopped.
fn bounce_hits(set: &ProbeSet, tracer: &Tracer, offset: f32) -> Vec<(u32, f32)> {
    (0..set.len())
        .into_par_iter()
        .flat_map_iter(|probe| {
            let axes = frame::world_from_tangent(set.normals[probe]);
            let origin = set.positions[probe];
            // Every probe turns the set, so that neighbours do not look in the same directions.
            let shift = Vec2::new(0.754_877_7, 0.569_840_3) * (probe as f32 % 1024.0);
            (0..BOUNCE_RAYS).map(move |ray| {
                let direction = axes * cosine_hemisphere(hammersley(ray, BOUNCE_RAYS, shift.fract()));
                let (mut through, mut most) = (1.0f32, (0u32, 0.0f32));
                for hit in tracer.hits(origin, direction, 0.25 * offset, f32::INFINITY) {
                    let weight = through * hit.alpha;
                    if weight > most.1 {
                        most = (hit.surfel, weight);
                    }
                    through *= 1.0 - hit.alpha;
                    if through < 0.01 {
                        break;
                    }
                }
                (most.0, 1.0 - through)
            })
        })
        .collect()
}
