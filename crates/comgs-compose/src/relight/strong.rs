//! Strong lights as an object's surfels see them, by rays.

use super::Standing;
use crate::FieldShadow;
use crate::shadow_light::{Beam, ShadowLight};
use comgs_geom::Similarity;
use comgs_trace::Tracer;
use glam::Vec3;

/// Rays to a strong light of which the rest are taken to do as they do, when these agree.
const FIRST_RAYS: usize = 4;
/// Transmittance from which on (one minus it: up to which) rays agree.
const AGREED: f32 = 0.98;

/// Strong lights in an object's own space.
pub(super) struct Strong<'a> {
    tracer: &'a Tracer,
    /// The other objects, world space.
    others: Option<&'a FieldShadow<'a>>,
    world_from_object: Similarity,
    beams: Vec<OwnBeam>,
}

struct OwnBeam {
    /// Unit directions, or positions, own space.
    towards: Vec<Vec3>,
    is_near: bool,
    /// Irradiance of a surface that faces it from the middle of the objects, per ray.
    each: Vec3,
    /// Unit directions to it from the middle.
    from_middle: Vec<Vec3>,
    /// Distance from the middle, own units; 1 for parallel light.
    distance: f32,
}

impl<'a> Strong<'a> {
    pub fn new(
        light: &ShadowLight,
        standing: &Standing<'a>,
        middle: Vec3,
        others: Option<&'a FieldShadow<'a>>,
    ) -> Self {
        let own = standing.world_from_object.inverse();
        let turn = own.rotation.as_quat();
        let middle_own = own.transform_point(middle.as_dvec3()).as_vec3();
        let beams = light.beams.iter().map(|beam| match beam {
            Beam::Parallel { directions, irradiance } => {
                let towards: Vec<Vec3> = directions.iter().map(|d| turn * *d).collect();
                let each = *irradiance / directions.len().max(1) as f32;
                OwnBeam { from_middle: towards.clone(), towards, is_near: false, each, distance: 1.0 }
            }
            Beam::Points { positions, intensity } => {
                let towards: Vec<Vec3> =
                    positions.iter().map(|p| own.transform_point(p.as_dvec3()).as_vec3()).collect();
                let mean = positions.iter().sum::<Vec3>() / positions.len().max(1) as f32;
                let world = (mean - middle).length().max(1e-6);
                let each = *intensity / (world * world * positions.len().max(1) as f32);
                OwnBeam {
                    from_middle: towards.iter().map(|p| (*p - middle_own).normalize_or(Vec3::Z)).collect(),
                    towards,
                    is_near: true,
                    each,
                    distance: world * own.scale as f32,
                }
            }
        });
        Self {
            tracer: standing.tracer,
            others,
            world_from_object: standing.world_from_object,
            beams: beams.collect(),
        }
    }

    /// Light that arrives, and light that would arrive from the middle's point of view if nothing were hidden.
    pub fn at(&self, point: Vec3, normal: Vec3, offset: f32) -> (Vec3, Vec3) {
        let (mut lit, mut all) = (Vec3::ZERO, Vec3::ZERO);
        let origin = point + offset * normal;
        for beam in &self.beams {
            all += beam.each * beam.from_middle.iter().map(|d| normal.dot(*d).max(0.0)).sum::<f32>();
            let ray = |towards: Vec3| -> Option<(f32, Vec3, f32)> {
                let (direction, distance) = if beam.is_near {
                    let way = towards - origin;
                    let length = way.length().max(1e-9);
                    (way / length, length)
                } else {
                    (towards, f32::INFINITY)
                };
                let near = if beam.is_near { (beam.distance / distance).powi(2) } else { 1.0 };
                let cosine = normal.dot(direction);
                (cosine > 0.0).then_some((near * cosine, direction, distance))
            };
            let trace = |(_, direction, distance): (f32, Vec3, f32)| {
                let own = self.tracer.transmittance(origin, direction, 0.0, distance);
                own * self.past_others(origin, direction, distance)
            };
            let rays: Vec<_> = beam.towards.iter().filter_map(|t| ray(*t)).collect();
            let first: Vec<f32> = (0..rays.len().min(FIRST_RAYS))
                .map(|k| trace(rays[k * rays.len() / FIRST_RAYS.min(rays.len())]))
                .collect();
            let agreed = rays.len() > FIRST_RAYS
                && (first.iter().all(|t| *t >= AGREED) || first.iter().all(|t| *t <= 1.0 - AGREED));
            let sum = if agreed {
                let mean = first.iter().sum::<f32>() / first.len() as f32;
                mean * rays.iter().map(|r| r.0).sum::<f32>()
            } else {
                rays.iter().map(|r| r.0 * trace(*r)).sum()
            };
            lit += sum * beam.each;
        }
        (lit, all)
    }

    /// What the other objects leave of a ray in own space.
    fn past_others(&self, origin: Vec3, direction: Vec3, distance: f32) -> f32 {
        let Some(others) = self.others else { return 1.0 };
        let s = &self.world_from_object;
        let from = s.transform_point(origin.as_dvec3()).as_vec3();
        others.transmittance(from, s.rotation.as_quat() * direction, distance * s.scale as f32)
    }
}
