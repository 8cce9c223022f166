//! What probes see, by ray tracing.

use crate::{ProbeError, ProbeSet};
use comgs_geom::{octahedral, sampling};
use comgs_trace::{RadianceHit, Ray, Tracer};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Probes that a thread bakes in one go.
const CHUNK: usize = 8;

/// Hears of the progress of a bake and may stop it; called from all threads.
#[derive(Clone, Copy)]
pub struct BakeObserver<'a> {
    /// Asked before every few probes; true stops the bake.
    pub cancelled: &'a (dyn Fn() -> bool + Sync),
    /// Told how many probes are finished.
    pub progress: &'a (dyn Fn(usize) + Sync),
}

impl BakeObserver<'_> {
    /// Never stops and tells nobody.
    #[must_use]
    pub fn silent() -> Self {
        Self { cancelled: &|| false, progress: &|_| {} }
    }
}

/// Traces the textures of all probes: radiance and occlusion `[L_in, O]`, and distance moments. Parallel, the same
/// bytes at any thread count.
///
/// A texel is the mean over its solid angle, taken with `rays_per_texel` rays (0 is taken as 1): one through its centre,
/// or a Hammersley set over its area in the map, each ray with the solid angle that this area has there. L_in is the
/// radiance of the surfels on the ray, Σ w c, and O their opacity, Σ w. A ray of which more than half is stopped
/// travels the mean depth of what it meets, cut off at the set's `far_distance`; any other one travels `far_distance`.
/// Of this the first two moments are stored. (Counting the two with O and 1 − O instead lets the 3 % that pass a wall
/// of surfels dominate the variance: behind such a wall a probe kept 75 % of its weight instead of 1 %.)
///
/// # Errors
/// [`ProbeError::Set`] when the set contradicts itself; [`ProbeError::Cancelled`], in which case the set is unchanged.
pub fn bake(
    tracer: &Tracer,
    set: &mut ProbeSet,
    rays_per_texel: usize,
    observer: BakeObserver<'_>,
) -> Result<(), ProbeError> {
    let far = set.far_distance;
    let baked = trace(set, rays_per_texel, observer, |origin, directions| {
        // A view works out the colour of every surfel once, a ray that of every surfel that it meets.
        let view = (VIEW_PAYS * directions.len() > tracer.len()).then(|| tracer.view(origin));
        let shoot = |d: Vec3| match &view {
            Some(view) => view.radiance(d, 0.0, f32::INFINITY),
            None => tracer.radiance(origin, d, 0.0, f32::INFINITY),
        };
        directions.iter().map(|&d| texel(&shoot(d), far)).collect()
    })?;
    set.texels = baked.iter().map(|t| [t[0], t[1], t[2], t[3]]).collect();
    set.moments = baked.iter().map(|t| [t[4], t[5]]).collect();
    Ok(())
}

/// Surfels for each ray of a probe up to which [`Tracer::view`] is faster than one ray at a time. Measured with 50,000
/// surfels (`examples/probe_cost.rs`): a view costs 0.37 µs a surfel and saves 2.4 µs a ray.
const VIEW_PAYS: usize = 6;

/// Traces only the occlusion of all probes: `[0, 0, 0, O]`, with O = 1 − transmittance; the moments stay. For the
/// occlusion O′ that an object adds to the scene around it (ComGS § 3.2.2), with the object's tracer. Otherwise as
/// [`bake`], and cheaper by what sorting and colours cost.
///
/// # Errors
/// As [`bake`].
pub fn bake_occlusion(
    tracer: &Tracer,
    set: &mut ProbeSet,
    rays_per_texel: usize,
    observer: BakeObserver<'_>,
) -> Result<(), ProbeError> {
    let baked = trace(set, rays_per_texel, observer, |origin, directions| {
        let rays: Vec<Ray> = directions.iter().map(|&d| Ray::new(origin, d)).collect();
        let occlusion = |t: f32| [0.0, 0.0, 0.0, 1.0 - t, 0.0, 0.0];
        tracer.transmittance_batch(&rays).into_iter().map(occlusion).collect()
    })?;
    set.texels = baked.iter().map(|t| [t[0], t[1], t[2], t[3]]).collect();
    Ok(())
}

/// Radiance, occlusion and distance moments of a ray.
fn texel(hit: &RadianceHit, far: f32) -> [f32; 6] {
    let distance = if hit.alpha > 0.5 { (hit.depth / hit.alpha).clamp(0.0, far) } else { far };
    [hit.radiance.x, hit.radiance.y, hit.radiance.z, hit.alpha, distance, distance * distance]
}

/// Directions of all rays of a probe, texel by texel.
fn directions(resolution: usize, rays_per_texel: usize) -> Vec<Vec3> {
    let n = u32::try_from(rays_per_texel).unwrap_or(u32::MAX);
    // The shift centres the set: its second coordinate starts at 0. A single ray goes through the middle.
    let shift = Vec2::new(0.0, 0.5 / n as f32);
    let inside: Vec<Vec2> = (0..n).map(|i| sampling::hammersley(i, n, shift)).collect();
    let corner = |t: usize| Vec2::new((t % resolution) as f32, (t / resolution) as f32);
    (0..resolution * resolution)
        .flat_map(|t| inside.iter().map(move |p| octahedral::direction((corner(t) + *p) / resolution as f32)))
        .collect()
}

/// What each ray counts for in its texel: solid angles per area of the map, sum 1 a texel.
fn weights(directions: &[Vec3], rays_per_texel: usize) -> Vec<f32> {
    let mut weights: Vec<f32> = directions.iter().map(|&d| octahedral::jacobian(d)).collect();
    for texel in weights.chunks_exact_mut(rays_per_texel) {
        let sum: f32 = texel.iter().sum();
        texel.iter_mut().for_each(|w| *w /= sum);
    }
    weights
}

/// Bakes every probe with `shoot`, which gives the values of all rays from an origin, and averages them over texels.
fn trace(
    set: &ProbeSet,
    rays_per_texel: usize,
    observer: BakeObserver<'_>,
    shoot: impl Fn(Vec3, &[Vec3]) -> Vec<[f32; 6]> + Sync,
) -> Result<Vec<[f32; 6]>, ProbeError> {
    let problems = set.problems();
    if !problems.is_empty() {
        return Err(ProbeError::Set(problems));
    }
    let rays = rays_per_texel.max(1);
    let directions = directions(set.resolution, rays);
    let weights = weights(&directions, rays);
    let texture = set.texture_len();
    let mut baked = vec![[0.0f32; 6]; set.len() * texture];
    let (done, stopped) = (AtomicUsize::new(0), AtomicBool::new(false));
    baked.par_chunks_mut(CHUNK * texture).zip(set.positions.par_chunks(CHUNK)).for_each(|(out, origins)| {
        if stopped.load(Ordering::Relaxed) || (observer.cancelled)() {
            stopped.store(true, Ordering::Relaxed);
            return;
        }
        for (out, &origin) in out.chunks_exact_mut(texture).zip(origins) {
            let values = shoot(origin, &directions);
            for (t, out) in out.iter_mut().enumerate() {
                for ray in t * rays..(t + 1) * rays {
                    for c in 0..6 {
                        out[c] += weights[ray] * values[ray][c];
                    }
                }
                out[3] = out[3].min(1.0);
            }
        }
        let finished = done.fetch_add(origins.len(), Ordering::Relaxed) + origins.len();
        (observer.progress)(finished);
    });
    if stopped.into_inner() {
        return Err(ProbeError::Cancelled { done: done.into_inner(), total: set.len() });
    }
    Ok(baked)
}
