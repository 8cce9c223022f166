//! The shadow ratio of Eq. 15–17 from occlusion fields and a prepared light: no sampling noise, no re-baking when an object
//! moves.
//!
//! ```text
//! S = 1 − (Σ_k E_k cos⁺_k (1 − Π_j (1 − O_j(p, ω_k))) + Σ_b hidden) / (Σ_k E_k cos⁺_k + Σ_b E_b cos⁺_b)
//! ```
//!
//! with `E_k` the energy of the smooth light's directions, `O_j` the field of object j (their visibilities multiply), and
//! b the small strong lights and lamps, to which a few rays are traced, past the scene too where that is given. Numerator and denominator use the same terms, so S
//! is in [0, 1] whatever the light.

use crate::occlusion_field::{FieldConfig, FieldError, OcclusionField, grid};
use crate::shadow::DARK;
pub use crate::shadow_light::StrongFrom;
use crate::shadow_light::{Beam, ShadowLight};
use comgs_geom::{Similarity, octahedral};
use comgs_surfel::SurfelCloud;
use comgs_trace::{TraceConfig, Tracer};
use glam::{Vec2, Vec3};
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

/// The projection nearest to a direction of the light: axes in world space, in halves of its window, and its number.
#[derive(Clone, Copy)]
struct Lookup {
    towards: Vec3,
    u: Vec3,
    v: Vec3,
    /// Middle of its window along the axes.
    middle: Vec2,
    /// How far the light's direction leans against the projection's, along its axes, per depth.
    lean: Vec2,
    projection: usize,
}

/// Least distance, in radii, at which an occluder is expected in front of a point within the object's sphere.
const NEAREST: f32 = 0.2;

impl Lookup {
    /// Place in the projection and depth of a point relative to the sphere's centre.
    ///
    /// The light's direction and the projection's differ by up to half a texel of the grid. A ray of the light is
    /// therefore followed to the plane through the object's middle and looked up there: what is left of the difference acts
    /// over the object's own depth, not over the distance between object and receiver (two-plane light fields, Levoy and
    /// Hanrahan 1996).
    #[inline]
    fn place(&self, p: Vec3) -> (f32, f32, f32) {
        let t = self.towards.dot(p);
        let ahead = (-t).max(NEAREST);
        let place = Vec2::new(self.u.dot(p), self.v.dot(p)) + ahead * self.lean - self.middle;
        (place.x, place.y, t)
    }
}

impl<'a> PlacedField<'a> {
    fn new(caster: &'a Caster, world_from_object: &Similarity, light: &ShadowLight) -> Self {
        let field = &caster.field;
        let (centre, radius) = field.sphere();
        let centre = world_from_object.transform_point(centre.as_dvec3()).as_vec3();
        let radius = radius * world_from_object.scale as f32;
        let side = field.config().directions;
        let own = grid(side);
        let turn = world_from_object.rotation.as_quat();
        let object_from_world = turn.inverse();
        let directions = light
            .directions
            .iter()
            .map(|&light| {
                let light = object_from_world * light;
                let projection = octahedral::texel_of(light, side);
                let own = own[projection];
                let along = own.towards.dot(light).max(0.1);
                let to_world = |v: Vec3| turn * v / radius;
                let window = field.window(projection);
                let half = Vec2::from_array(window.half);
                Lookup {
                    towards: to_world(own.towards),
                    u: to_world(own.u) / half.x,
                    v: to_world(own.v) / half.y,
                    middle: Vec2::from_array(window.middle) / half,
                    lean: Vec2::new(own.u.dot(light), own.v.dot(light)) / (along * half),
                    projection,
                }
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
    /// `[object][direction]`: mean radiance of the object as it is seen in that direction; empty without bounced light.
    radiance: Vec<Vec<Vec3>>,
    /// The scene, and how far its own surface is left before it counts, world units.
    scene: Option<(&'a Tracer, f32)>,
}

/// Rays to a strong light by which the scene's own shadow is found.
const SCENE_RAYS: usize = 4;
/// Transmittance from which on (one minus it: up to which) two of them stand for all.
const AGREED: f32 = 0.98;
/// Share of the smooth light that must be hidden for it to matter whether the scene hides a strong light too.
const MATTERS: f32 = 0.03;

/// Largest ratio where objects light the scene: a bright thing in a dark corner.
const MAX_RATIO: f32 = 8.0;

/// Points that are evaluated together: a projection that one of them has brought into the cache serves all, and directions
/// from which nothing can hide any of them are passed over once.
const CHUNK: usize = 64;

impl<'a> FieldShadow<'a> {
    /// * `objects`: what casts shadows and where it stands
    #[must_use]
    pub fn new(light: &'a ShadowLight, objects: &[(&'a Caster, Similarity)]) -> Self {
        let objects = objects.iter().map(|(f, s)| PlacedField::new(f, s, light)).collect();
        Self { light, objects, radiance: Vec::new(), scene: None }
    }

    /// With the light that the objects throw back on the scene: where an object hides light, it is seen instead, with its
    /// mean radiance in that direction (`radiance(object, direction)`, linear, direction from the receiver). Ratios may then
    /// exceed 1. The mean stands for the object's whole outline: a highlight of a pot becomes an even glow, not a patch.
    #[must_use]
    pub fn with_bounce(mut self, radiance: impl Fn(usize, Vec3) -> Vec3) -> Self {
        let directions = &self.light.directions;
        self.radiance =
            (0..self.objects.len()).map(|j| directions.iter().map(|&d| radiance(j, d)).collect()).collect();
        self
    }

    /// With the shadows that the scene casts on itself: a strong light that the scene hides from a point (by rays that start
    /// `clearance` away from it) cannot be hidden once more. Smooth light is taken to reach every point.
    #[must_use]
    pub fn with_scene(mut self, scene: &'a Tracer, clearance: f32) -> Self {
        self.scene = Some((scene, clearance));
        self
    }

    /// Share of a strong light that the scene lets through to a point.
    fn past_scene(&self, point: Vec3, normal: Vec3, beam: &Beam) -> f32 {
        let Some((scene, clearance)) = self.scene else { return 1.0 };
        if beam.is_empty() {
            return 1.0;
        }
        let (Beam::Parallel { directions: list, .. } | Beam::Points { positions: list, .. }) = beam;
        let rays = list.len().min(SCENE_RAYS);
        let origin = point + 0.25 * clearance * normal;
        let through = |k: usize| {
            let to = list[k * list.len() / rays];
            let (direction, distance) = match beam {
                Beam::Parallel { .. } => (to, f32::INFINITY),
                // A lamp that is part of the scene does not hide itself.
                Beam::Points { .. } => {
                    ((to - origin).normalize_or(normal), (to - origin).length() - clearance)
                }
            };
            if distance > clearance {
                scene.transmittance(origin, direction, clearance, distance)
            } else {
                1.0
            }
        };
        // Most points see all of it or nothing.
        let first = [through(0), through(rays - 1)];
        if first.iter().all(|t| *t > AGREED) || first.iter().all(|t| *t < 1.0 - AGREED) {
            return 0.5 * (first[0] + first[1]);
        }
        (0..rays).map(through).sum::<f32>() / rays as f32
    }

    /// Smooth light that is hidden from every point of a chunk.
    fn smooth_hidden(&self, points: &[Vec3], normals: &[Vec3], hidden: &mut [Vec3]) {
        let middle = points.iter().sum::<Vec3>() / points.len() as f32;
        let extent = points.iter().map(|p| (*p - middle).length()).fold(0.0, f32::max);
        let mut near: Vec<(usize, &PlacedField<'_>)> = Vec::with_capacity(self.objects.len());
        for (k, (&towards, &energy)) in self.light.directions.iter().zip(&self.light.energy).enumerate() {
            near.clear();
            near.extend(self.objects.iter().enumerate().filter(|(_, o)| {
                let p = middle - o.centre;
                let along = p.dot(towards);
                // Slack for the half texel that the nearest projection may be off.
                let reach = 1.1 * o.radius + extent;
                along < reach && p.length_squared() - along * along < reach * reach
            }));
            if near.is_empty() {
                continue;
            }
            for (i, hidden) in hidden.iter_mut().enumerate() {
                let cosine = normals[i].dot(towards);
                if cosine <= 0.0 {
                    continue;
                }
                let mut visible = 1.0f32;
                let mut seen = Vec3::ZERO;
                for (j, object) in &near {
                    let lookup = &object.directions[k];
                    let (x, y, t) = lookup.place(points[i] - object.centre);
                    if x.abs() < 1.1 && y.abs() < 1.1 && t < 1.0 {
                        let projection = object.field.projection(lookup.projection);
                        let res = object.field.config().resolution;
                        let occlusion = OcclusionField::occlusion_at(projection, res, x, y, t);
                        if let Some(radiance) = self.radiance.get(*j) {
                            // Of several objects in one direction the first in the list counts as the nearest.
                            seen += radiance[k] * (visible * occlusion);
                        }
                        visible *= 1.0 - occlusion;
                    }
                }
                *hidden += (energy * (1.0 - visible) - seen * self.light.solid_angles[k]) * cosine;
            }
        }
    }

    /// Smooth light that a surface receives where nothing hides it.
    fn smooth_irradiance(&self, normal: Vec3) -> Vec3 {
        let light = self.light.directions.iter().zip(&self.light.energy);
        light.map(|(d, &e)| e * normal.dot(*d).max(0.0)).sum()
    }

    /// Light of the strong lights that would arrive, and what of it is hidden, by rays. Whether the scene itself hides it is
    /// asked where anything at all is hidden (`any`, or here); elsewhere it makes no difference.
    fn strong_light(&self, point: Vec3, normal: Vec3, any: bool) -> (Vec3, Vec3) {
        let (mut lit, mut hidden) = (Vec3::ZERO, Vec3::ZERO);
        for beam in &self.light.beams {
            let (mut beam_lit, mut beam_hidden) = (Vec3::ZERO, Vec3::ZERO);
            let mut add = |towards: Vec3, light: Vec3, t_max: f32| {
                let cosine = normal.dot(towards);
                if cosine > 0.0 {
                    beam_lit += light * cosine;
                    beam_hidden += light * (cosine * (1.0 - self.transmittance(point, towards, t_max)));
                }
            };
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
            if beam_lit != Vec3::ZERO && (any || beam_hidden != Vec3::ZERO) {
                let open = self.past_scene(point, normal, beam);
                beam_lit *= open;
                beam_hidden *= open;
            }
            lit += beam_lit;
            hidden += beam_hidden;
        }
        (lit, hidden)
    }
}

/// What the objects hide of single lights, for whoever sums them otherwise.
impl FieldShadow<'_> {
    /// `[point][direction]`: share in 255ths of the smooth light's directions that reaches a point past all objects.
    #[must_use]
    pub fn open(&self, points: &[Vec3]) -> Vec<u8> {
        let count = self.light.directions.len();
        let mut out = vec![255; points.len() * count];
        if count == 0 {
            return out;
        }
        out.par_chunks_mut(count).zip(points).with_min_len(CHUNK).for_each(|(out, point)| {
            for object in &self.objects {
                let p = *point - object.centre;
                for ((k, out), towards) in out.iter_mut().enumerate().zip(&self.light.directions) {
                    let along = p.dot(*towards);
                    let reach = 1.1 * object.radius;
                    if along >= reach || p.length_squared() - along * along >= reach * reach {
                        continue;
                    }
                    let lookup = &object.directions[k];
                    let (x, y, t) = lookup.place(p);
                    if x.abs() < 1.1 && y.abs() < 1.1 && t < 1.0 {
                        let projection = object.field.projection(lookup.projection);
                        let res = object.field.config().resolution;
                        let visible = 1.0 - OcclusionField::occlusion_at(projection, res, x, y, t);
                        *out = (f32::from(*out) * visible.clamp(0.0, 1.0)).round() as u8;
                    }
                }
            }
        });
        out
    }

    /// Traced transmittance of a world ray of unit direction past all objects.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        self.objects.iter().map(|o| o.transmittance(origin, direction, t_max)).product()
    }
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
                let mut hidden = [Vec3::ZERO; CHUNK];
                self.smooth_hidden(points, normals, &mut hidden[..points.len()]);
                for (i, out) in out.iter_mut().enumerate() {
                    let smooth = self.smooth_irradiance(normals[i]);
                    let any = (hidden[i].abs() - MATTERS * smooth).max_element() > 0.0;
                    let (strong, strong_hidden) = self.strong_light(points[i], normals[i], any);
                    let hidden = hidden[i] + strong_hidden;
                    if hidden == Vec3::ZERO {
                        continue;
                    }
                    let lit = smooth + strong;
                    let most = if self.radiance.is_empty() { 1.0 } else { MAX_RATIO };
                    let channel = |hidden: f32, lit: f32| {
                        if lit < DARK { 1.0 } else { (1.0 - hidden / lit).clamp(0.0, most) }
                    };
                    *out = Vec3::new(
                        channel(hidden.x, lit.x),
                        channel(hidden.y, lit.y),
                        channel(hidden.z, lit.z),
                    );
                }
            },
        );
        out
    }

    fn spheres(&self) -> Vec<(Vec3, f32)> {
        self.objects.iter().map(|o| (o.centre, o.radius)).collect()
    }

    fn strong(&self) -> Vec<StrongFrom> {
        self.light.strong()
    }
}

#[cfg(test)]
mod tests;
