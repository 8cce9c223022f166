//! The path tracer: unidirectional, next-event estimation and BRDF sampling joined by multiple importance sampling
//! (Veach 1997, power heuristic), Russian roulette without a depth limit. Unbiased: no clamping, no cut-off,
//! no denoising.

use crate::brdf::Brdf;
use crate::sequence::Sequence;
use crate::world::{Surface, World};
use comgs_geom::frame::world_from_tangent;
use glam::{Mat3, Vec3};

/// What a camera ray found.
#[derive(Clone, Copy, Debug)]
pub struct FirstHit {
    /// Base colour.
    pub brdf: Brdf,
    /// Unit shading normal in world space, facing the viewer.
    pub normal: Vec3,
    /// Distance along the ray.
    pub distance: f32,
    /// Whether it belongs to an inserted object.
    pub inserted: bool,
}

/// One sample of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct PathSample {
    /// Linear radiance towards the viewer. Where nothing was hit, the environment.
    pub radiance: Vec3,
    /// The surface seen, if any.
    pub first: Option<FirstHit>,
}

/// Bounces before Russian roulette begins.
const CERTAIN_BOUNCES: u32 = 2;

/// Largest chance to go on afterwards, so that every path ends.
const LARGEST_SURVIVAL: f32 = 0.95;

/// Follows one path from `origin` along the unit `direction`.
#[must_use]
pub(crate) fn trace(world: &World, origin: Vec3, direction: Vec3, numbers: &mut Sequence) -> PathSample {
    let (mut origin, mut direction) = (origin, direction);
    let (mut radiance, mut throughput) = (Vec3::ZERO, Vec3::ONE);
    let mut first = None;
    // Density of the last direction; none for the camera's, which no light sample could have chosen.
    let mut last_pdf: Option<f32> = None;
    for bounce in 0u32.. {
        let Some(surface) = world.intersect(origin, direction) else {
            let weight = last_pdf.map_or(1.0, |p| power_heuristic(p, world.environment_pdf(direction)));
            radiance += throughput * world.environment().radiance(direction) * weight;
            break;
        };
        let brdf = world.brdf(&surface);
        if bounce == 0 {
            first = Some(FirstHit {
                brdf,
                normal: surface.normal,
                distance: surface.distance,
                inserted: world.inserted(&surface),
            });
        }
        let emission = world.emission(&surface);
        if emission != Vec3::ZERO {
            let weight = last_pdf.map_or(1.0, |p| power_heuristic(p, world.lamp_pdf(&surface, direction)));
            radiance += throughput * emission * weight;
        }
        let local = Local::at(&surface, -direction);
        radiance += throughput * direct(world, &surface, &brdf, &local, numbers);

        let choice = numbers.next_1d();
        let Some(sample) = brdf.sample(local.out, choice, numbers.next_2d()) else { break };
        let next = local.world_from_local * sample.direction;
        // Light through the back of the triangle would leak.
        if next.dot(surface.face_normal) <= 0.0 {
            break;
        }
        throughput *= sample.weight;
        if bounce >= CERTAIN_BOUNCES {
            let survival = throughput.max_element().min(LARGEST_SURVIVAL);
            if numbers.next_1d() >= survival {
                break;
            }
            throughput /= survival;
        }
        if throughput == Vec3::ZERO {
            break;
        }
        origin = World::leave(&surface, next);
        direction = next.normalize();
        last_pdf = Some(sample.pdf);
    }
    PathSample { radiance, first }
}

/// The shading frame at a surface point.
struct Local {
    world_from_local: Mat3,
    out: Vec3,
}

impl Local {
    fn at(surface: &Surface, out: Vec3) -> Self {
        let world_from_local = world_from_tangent(surface.shading_normal);
        Self { world_from_local, out: world_from_local.transpose() * out }
    }
}

/// Light that comes straight from a lamp or the sky, weighted against finding it by BRDF sampling.
fn direct(world: &World, surface: &Surface, brdf: &Brdf, local: &Local, numbers: &mut Sequence) -> Vec3 {
    let choice = numbers.next_1d();
    let Some(light) = world.sample_light(surface.position, choice, numbers.next_2d()) else {
        return Vec3::ZERO;
    };
    if light.direction.dot(surface.face_normal) <= 0.0 {
        return Vec3::ZERO;
    }
    let towards = local.world_from_local.transpose() * light.direction;
    let f = brdf.eval(local.out, towards);
    if f == Vec3::ZERO || light.radiance == Vec3::ZERO {
        return Vec3::ZERO;
    }
    if !world.visible(World::leave(surface, light.direction), light.direction, light.distance) {
        return Vec3::ZERO;
    }
    let weight = power_heuristic(light.pdf, brdf.pdf(local.out, towards));
    f * light.radiance * (towards.z / light.pdf * weight)
}

fn power_heuristic(own: f32, other: f32) -> f32 {
    // As a ratio, so that a huge density does not overflow when squared.
    let r = other / own;
    1.0 / (1.0 + r * r)
}
