//! The shadow ratio of Eq. 15–17 from occlusion fields and a prepared light: no sampling noise, no re-baking when an object
//! moves.
//!
//! ```text
//! S = (Σ_k E_k cos⁺_k Π_j (1 − O_j(p, ω_k)) + Σ_b traced) / (Σ_k E_k cos⁺_k + Σ_b E_b cos⁺_b)
//! ```
//!
//! with `E_k` the light's energy on the grid of directions, `O_j` the field of object j (their visibilities multiply), and
//! b the small strong lights and lamps, to which a few rays are traced. Numerator and denominator use the same terms, so S
//! is in [0, 1] whatever the light.

use crate::occlusion_field::{FieldConfig, FieldError, OcclusionField, grid};
use crate::shadow::DARK;
use crate::shadow_light::{Beam, ShadowLight};
use comgs_geom::{Similarity, octahedral};
use comgs_surfel::SurfelCloud;
use comgs_trace::{TraceConfig, Tracer};
use glam::{DQuat, Vec3};
use rayon::prelude::*;

/// Something that knows the shadow ratio of any point of the scene.
pub trait ShadowRatios: Sync {
    /// The ratio in [0, 1] of every point, with its unit normal (world). Deterministic at any thread count.
    fn ratios(&self, points: &[Vec3], normals: &[Vec3]) -> Vec<Vec3>;

    /// Spheres around what casts shadows, world.
    fn spheres(&self) -> Vec<(Vec3, f32)>;

    /// Unit directions of parallel strong lights, and positions of near ones: where sharp shadows fall.
    fn strong(&self) -> Vec<StrongFrom>;
}

/// Where a strong light is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StrongFrom {
    /// Unit direction towards it, world.
    Direction(Vec3),
    /// Position, world.
    Position(Vec3),
}

/// An object that casts shadows: its field for smooth light, its tracer for strong lights, both in its own space, where
/// they are made once.
#[derive(Clone, Debug)]
pub struct Caster {
    /// What it occludes.
    pub field: OcclusionField,
    /// The object itself.
    pub tracer: Tracer,
}

impl Caster {
    /// Bakes an object, or takes a field that was baked before.
    ///
    /// # Errors
    /// [`FieldError`].
    pub fn new(
        cloud: &SurfelCloud,
        config: FieldConfig,
        baked: Option<OcclusionField>,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, FieldError> {
        let field = match baked {
            Some(field) => field,
            None => OcclusionField::bake(cloud, config, cancelled)?,
        };
        Ok(Self { field, tracer: Tracer::new(cloud, &TraceConfig::occlusion())? })
    }
}

/// A field where its object stands, with what a lookup needs for every direction of a light's grid.
struct PlacedField<'a> {
    field: &'a OcclusionField,
    tracer: &'a Tracer,
    object_from_world: Similarity,
    centre: Vec3,
    radius: f32,
    directions: Vec<Lookup>,
}

/// Axes of a projection in world space, in radii of the sphere, and its number in the field.
#[derive(Clone, Copy)]
struct Lookup {
    towards: Vec3,
    u: Vec3,
    v: Vec3,
    projection: usize,
}

impl<'a> PlacedField<'a> {
    fn new(caster: &'a Caster, world_from_object: &Similarity, light: &ShadowLight) -> Self {
        let field = &caster.field;
        let (centre, radius) = field.sphere();
        let centre = world_from_object.transform_point(centre.as_dvec3()).as_vec3();
        let radius = radius * world_from_object.scale as f32;
        let side = field.config().directions;
        let own = grid(side);
        let turn = world_from_object.rotation;
        let object_from_world = turn.inverse().as_quat();
        let directions = light
            .directions()
            .into_iter()
            .map(|d| {
                let projection = octahedral::texel_of(object_from_world * d, side);
                let own = own[projection];
                let to_world = |v: Vec3| turn.as_quat() * v / radius;
                Lookup { towards: to_world(own.towards), u: to_world(own.u), v: to_world(own.v), projection }
            })
            .collect();
        let object_from_world = world_from_object.inverse();
        Self { field, tracer: &caster.tracer, object_from_world, centre, radius, directions }
    }

    /// Traced transmittance of a world ray with unit direction. Its parameter scales with the object.
    fn transmittance(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        if !meets(origin, direction, self.centre, self.radius, t_max) {
            return 1.0;
        }
        let s = &self.object_from_world;
        let own = s.transform_point(origin.as_dvec3()).as_vec3();
        let direction = s.rotation.as_quat() * direction;
        self.tracer.transmittance(own, direction, 0.0, t_max * s.scale as f32)
    }
}

/// Shadow ratios from fields and a prepared light.
pub struct FieldShadow<'a> {
    light: &'a ShadowLight,
    objects: Vec<PlacedField<'a>>,
    /// World directions of the grid with some energy, and their numbers.
    directions: Vec<(usize, Vec3, Vec3)>,
}

/// Points that are evaluated together, so that a projection that one of them has brought into the cache serves all.
const CHUNK: usize = 64;

impl<'a> FieldShadow<'a> {
    /// * `light`: its grid should be turned with the first object ([`grid_turn`]) and have the side of its field
    /// * `objects`: what casts shadows and where it stands
    #[must_use]
    pub fn new(light: &'a ShadowLight, objects: &[(&'a Caster, Similarity)]) -> Self {
        let directions = light
            .directions()
            .into_iter()
            .zip(&light.energy)
            .enumerate()
            .filter(|(_, (_, e))| **e != Vec3::ZERO)
            .map(|(k, (d, e))| (k, d, *e))
            .collect();
        let objects = objects.iter().map(|(f, s)| PlacedField::new(f, s, light)).collect();
        Self { light, objects, directions }
    }

    /// Light that arrives without objects, and with them, of the smooth grid.
    fn smooth(&self, points: &[Vec3], normals: &[Vec3], sums: &mut [(Vec3, Vec3)]) {
        for (lit, _) in sums.iter_mut() {
            *lit = Vec3::ZERO;
        }
        let res: Vec<usize> = self.objects.iter().map(|o| o.field.config().resolution).collect();
        for &(k, towards, energy) in &self.directions {
            for (i, (lit, kept)) in sums.iter_mut().enumerate() {
                let cosine = normals[i].dot(towards);
                if cosine <= 0.0 {
                    continue;
                }
                let light = energy * cosine;
                *lit += light;
                let mut visible = 1.0f32;
                for (object, &res) in self.objects.iter().zip(&res) {
                    let lookup = &object.directions[k];
                    let p = points[i] - object.centre;
                    let (x, y) = (lookup.u.dot(p), lookup.v.dot(p));
                    let t = lookup.towards.dot(p);
                    if x * x + y * y < 1.1 && t < 1.0 {
                        let projection = object.field.projection(lookup.projection);
                        visible *= 1.0 - OcclusionField::occlusion_at(projection, res, x, y, t);
                    }
                }
                *kept += light * visible;
            }
        }
    }

    /// The same of strong lights, by rays, added.
    fn strong_light(&self, point: Vec3, normal: Vec3, (lit, kept): &mut (Vec3, Vec3)) {
        let mut add = |towards: Vec3, light: Vec3, t_max: f32| {
            let cosine = normal.dot(towards);
            if cosine <= 0.0 {
                return;
            }
            *lit += light * cosine;
            let t: f32 = self.objects.iter().map(|o| o.transmittance(point, towards, t_max)).product();
            *kept += light * cosine * t;
        };
        for beam in &self.light.beams {
            match beam {
                Beam::Parallel { directions, irradiance } => {
                    let each = *irradiance / directions.len().max(1) as f32;
                    for &d in directions {
                        add(d, each, f32::INFINITY);
                    }
                }
                Beam::Points { positions, intensity } => {
                    let each = *intensity / positions.len().max(1) as f32;
                    for &at in positions {
                        let d = at - point;
                        let distance = d.length();
                        // At the lamp itself the irradiance has no bound; nothing of the scene is there.
                        if distance > 1e-6 {
                            add(d / distance, each / (distance * distance), distance);
                        }
                    }
                }
            }
        }
    }
}

/// Rotation that a light's grid should have: the first object's.
#[must_use]
pub fn grid_turn(objects: &[Similarity]) -> DQuat {
    objects.first().map_or(DQuat::IDENTITY, |s| s.rotation)
}

/// Whether a ray meets a sphere within `t_max`.
fn meets(origin: Vec3, direction: Vec3, centre: Vec3, radius: f32, t_max: f32) -> bool {
    let to_centre = centre - origin;
    let along = to_centre.dot(direction);
    let closest = to_centre.length_squared() - along * along;
    let inside = radius * radius - closest;
    inside >= 0.0 && along + inside.sqrt() > 0.0 && along - inside.sqrt() < t_max
}

impl ShadowRatios for FieldShadow<'_> {
    fn ratios(&self, points: &[Vec3], normals: &[Vec3]) -> Vec<Vec3> {
        let mut out = vec![Vec3::ONE; points.len()];
        out.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK).zip(normals.par_chunks(CHUNK))).for_each(
            |(out, (points, normals))| {
                let mut sums = [(Vec3::ZERO, Vec3::ZERO); CHUNK];
                let sums = &mut sums[..points.len()];
                self.smooth(points, normals, sums);
                for (i, sums) in sums.iter_mut().enumerate() {
                    self.strong_light(points[i], normals[i], sums);
                    let (lit, kept) = *sums;
                    let channel =
                        |kept: f32, lit: f32| if lit < DARK { 1.0 } else { (kept / lit).clamp(0.0, 1.0) };
                    out[i] =
                        Vec3::new(channel(kept.x, lit.x), channel(kept.y, lit.y), channel(kept.z, lit.z));
                }
            },
        );
        out
    }

    fn spheres(&self) -> Vec<(Vec3, f32)> {
        self.objects.iter().map(|o| (o.centre, o.radius)).collect()
    }

    fn strong(&self) -> Vec<StrongFrom> {
        let mean = |list: &[Vec3]| list.iter().sum::<Vec3>() / list.len().max(1) as f32;
        self.light
            .beams
            .iter()
            .map(|b| match b {
                Beam::Parallel { directions, .. } => {
                    StrongFrom::Direction(mean(directions).normalize_or(Vec3::Z))
                }
                Beam::Points { positions, .. } => StrongFrom::Position(mean(positions)),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests;
