//! Deferred physically based shading (ComGS Eq. 6–8) of shading points, and its exact gradient.
//!
//! ```text
//! L_o = 1/S Σ_s f(v, ω_s) max(0, n·ω_s) L_i(ω_s) / p(ω_s),    L_i = (1 − O) L_dir + L_in
//! ```
//!
//! The paper draws ω uniformly over the hemisphere (Eq. 7: p = 1/2π). Here a point's samples come from two proposals, the
//! BRDF and a coarse table of the light ([`Proposal`]), and p is the density of their mixture (the balance heuristic of Veach 1997),
//! so that neither a polished surface nor a small lamp drowns in noise. The BRDF's are a Hammersley set, turned by a random
//! rotation a point; the light's are an even share of a stratified pool.
//!
//! Directions and densities are drawn from the current state but held fixed in the gradient: the estimator is unbiased for
//! any fixed proposal, so the gradient of the sum is an unbiased estimate of the gradient of the integral. The shading
//! point's position enters only through the incident light and is held fixed too.

use super::proposal::Proposal;
use comgs_geom::octahedral::footprint;
use comgs_geom::{Rng, sampling};
use comgs_light::OctahedralLight;
use comgs_light::brdf::{Material, MaterialGradient, Shading};
use comgs_probe::{LookupConfig, Neighbours, ProbeIndex, ProbeSet};
use comgs_trace::Tracer;
use fearless_simd::{Level, Simd, dispatch};
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// What is shaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// World position.
    pub position: Vec3,
    /// Unit shading normal, world.
    pub normal: Vec3,
    /// Unit direction towards the eye, world.
    pub view: Vec3,
    /// Surface.
    pub material: Material,
}

/// Where occlusion O and indirect radiance L_in of Eq. 8 come from.
#[derive(Clone, Copy, Debug)]
pub enum Incident<'a> {
    /// O = 0, L_in = 0.
    Open,
    /// Interpolated probe textures (Eq. 9–11).
    Probes {
        /// The textures.
        set: &'a ProbeSet,
        /// Who is near.
        index: &'a ProbeIndex,
        /// How many, and with which weights.
        lookup: &'a LookupConfig,
    },
    /// A ray for every sample, from `offset` (world units) above the surface.
    Trace {
        /// The object's surfels, with the radiance of step 1.
        tracer: &'a Tracer,
        /// Height above the surface at which rays start.
        offset: f32,
    },
}

/// Light, proposals and random numbers of one step.
#[derive(Clone, Copy, Debug)]
pub struct Lighting<'a> {
    /// L_dir.
    pub light: &'a OctahedralLight,
    /// Directions that the light proposes.
    pub proposal: &'a Proposal,
    /// O and L_in.
    pub incident: Incident<'a>,
    /// Samples a point, S.
    pub rays: u32,
    /// Seed of the rotations; another one each step.
    pub seed: u64,
}

/// Share of the samples that the light proposes.
const LIGHT_SHARE: f32 = 0.25;

/// A sample, with what the gradient needs of it.
#[derive(Clone, Copy, Debug, Default)]
struct Sample {
    direction: Vec3,
    /// 1 / (S p).
    scale: f32,
    /// L_i.
    incoming: Vec3,
    /// L_dir.
    direct: Vec3,
    /// 1 − O.
    open: f32,
}

/// Shaded points and what their gradient needs.
#[derive(Debug, Default)]
pub struct Shaded {
    /// L_o, linear, one a point.
    pub radiance: Vec<Vec3>,
    samples: Vec<Sample>,
    counts: Vec<u32>,
    neighbours: Vec<Neighbours>,
    stride: usize,
}

/// Gradient of a loss with respect to a [`Point`].
pub type PointGradient = MaterialGradient;

/// Points that one thread shades in a go; also the unit of the random streams' order.
const CHUNK: usize = 32;
/// Parts into which the points are cut for the sums over the light's texels: fixed, so that the sums do not depend on the
/// threads.
const PARTS: usize = 16;

/// Shades points; `shaded` keeps what [`shade_vjp`] needs and lends its memory to the next call.
pub fn shade(points: &[Point], lighting: &Lighting<'_>, shaded: &mut Shaded) {
    let level = Level::new();
    let stride = lighting.rays as usize;
    shaded.stride = stride;
    shaded.radiance.resize(points.len(), Vec3::ZERO);
    shaded.counts.resize(points.len(), 0);
    shaded.samples.resize(points.len() * stride, Sample::default());
    let with_probes = matches!(lighting.incident, Incident::Probes { .. });
    shaded.neighbours.resize(if with_probes { points.len() } else { 0 }, Neighbours::default());
    let mut neighbours = shaded.neighbours.chunks_mut(CHUNK);
    let work: Vec<_> = shaded
        .radiance
        .chunks_mut(CHUNK)
        .zip(shaded.counts.chunks_mut(CHUNK))
        .zip(shaded.samples.chunks_mut(CHUNK * stride))
        .map(|columns| (columns, neighbours.next()))
        .collect();
    work.into_par_iter().enumerate().for_each(|(chunk, (((radiance, counts), samples), mut neighbours))| {
        let mut texture = texture_of(lighting);
        for (k, out) in radiance.iter_mut().enumerate() {
            let i = chunk * CHUNK + k;
            let near = neighbours.as_mut().map(|n| &mut n[k]);
            let own = &mut samples[k * stride..(k + 1) * stride];
            (*out, counts[k]) = dispatch!(level, simd => simd.vectorize(
                #[inline(always)]
                || shade_point(&points[i], i, lighting, &mut texture, near, own)
            ));
        }
    });
}

/// Room for one blended probe texture; empty without probes.
fn texture_of(lighting: &Lighting<'_>) -> Vec<[f32; 4]> {
    match lighting.incident {
        Incident::Probes { set, .. } => vec![[0.0; 4]; set.resolution * set.resolution],
        _ => Vec::new(),
    }
}

#[inline(always)]
fn shade_point(
    point: &Point,
    index: usize,
    lighting: &Lighting<'_>,
    texture: &mut [[f32; 4]],
    near: Option<&mut Neighbours>,
    samples: &mut [Sample],
) -> (Vec3, u32) {
    let shading = Shading::new(point.material, point.normal, point.view);
    let mut rng = Rng::stream(lighting.seed, index as u64);
    let (shift, start) = (Vec2::new(rng.uniform(), rng.uniform()), rng.uniform());
    let by_light = light_samples(lighting.rays);
    let by_brdf = lighting.rays - by_light;
    let mut resolution = 0;
    if let (Incident::Probes { set, index, lookup }, Some(near)) = (lighting.incident, near) {
        *near = index.query(point.position, point.normal, set, lookup);
        set.blend(near, texture);
        resolution = set.resolution;
    }
    let mut sum = Vec3::ZERO;
    let mut count = 0;
    for s in 0..lighting.rays {
        let (direction, pdf, direct) = if s < by_light {
            let p = lighting.proposal.sample(s, by_light, start);
            (p.direction, p.pdf, p.radiance)
        } else {
            let u = sampling::hammersley(s - by_light, by_brdf, shift);
            let Some(direction) = shading.sample_stretched(u) else { continue };
            (direction, lighting.proposal.pdf(direction), lighting.light.radiance(direction))
        };
        let Some(reflection) = shading.reflect(direction) else { continue };
        let density = by_brdf as f32 * shading.pdf(direction) + by_light as f32 * pdf;
        if !(density > 0.0) {
            continue;
        }
        let [r, g, b, occlusion] = match lighting.incident {
            Incident::Open => [0.0; 4],
            Incident::Probes { .. } => comgs_probe::sample(texture, resolution, direction),
            Incident::Trace { tracer, offset } => {
                let origin = point.position + offset * point.normal;
                let hit = tracer.radiance(origin, direction, 0.0, f32::INFINITY);
                [hit.radiance.x, hit.radiance.y, hit.radiance.z, hit.alpha]
            }
        };
        let open = 1.0 - occlusion;
        let sample = Sample {
            direction,
            scale: 1.0 / density,
            incoming: open * direct + Vec3::new(r, g, b),
            direct,
            open,
        };
        sum += sample.scale * reflection.value() * sample.incoming;
        samples[count as usize] = sample;
        count += 1;
    }
    (sum, count)
}

/// Samples that the light proposes, of `rays`.
fn light_samples(rays: u32) -> u32 {
    ((rays as f32 * LIGHT_SHARE) as u32).clamp(1, rays - 1)
}

/// Gradient of [`shade`]: given the gradient with respect to `shaded.radiance`, returns that with respect to the points and
/// adds those with respect to the light's texels (`[texel][rgb]`) and, with probes, to their textures
/// (`[probe][texel]`, when given).
///
/// Exact for the samples that were drawn; see the module's note on what is held fixed.
pub fn shade_vjp(
    points: &[Point],
    lighting: &Lighting<'_>,
    shaded: &Shaded,
    grad_radiance: &[Vec3],
    grad_light: &mut [f32],
    grad_probes: Option<&mut [[f32; 4]]>,
) -> Vec<PointGradient> {
    let level = Level::new();
    let probes = match (lighting.incident, grad_probes) {
        (Incident::Probes { set, .. }, Some(grad)) => Some((set, grad)),
        _ => None,
    };
    let texels = probes.as_ref().map_or(0, |(set, _)| set.resolution * set.resolution);
    let resolution = probes.as_ref().map_or(0, |(set, _)| set.resolution);
    let mut grad_points = vec![PointGradient::default(); points.len()];
    let mut grad_textures = vec![[0.0f32; 4]; points.len() * texels];
    let part = points.len().div_ceil(PARTS).max(1);
    let mut textures = grad_textures.chunks_mut((part * texels).max(1));
    let work: Vec<_> = grad_points.chunks_mut(part).map(|p| (p, textures.next())).collect();
    let sums: Vec<Vec<f32>> = work
        .into_par_iter()
        .enumerate()
        .map(|(k, (grad_points, mut textures))| {
            let mut sum = vec![0.0f32; grad_light.len()];
            for (j, out) in grad_points.iter_mut().enumerate() {
                let i = k * part + j;
                let texture = textures.as_mut().map(|t| &mut t[j * texels..(j + 1) * texels]);
                let texture = texture.filter(|t| !t.is_empty());
                dispatch!(level, simd => simd.vectorize(
                    #[inline(always)]
                    || point_vjp(&points[i], i, lighting, shaded, grad_radiance[i], resolution, out, &mut sum, texture)
                ));
            }
            sum
        })
        .collect();
    grad_light.par_chunks_mut(1 << 12).enumerate().for_each(|(k, out)| {
        let first = k << 12;
        for sum in &sums {
            for (o, s) in out.iter_mut().zip(&sum[first..]) {
                *o += s;
            }
        }
    });
    if let Some((set, grad)) = probes {
        set.blend_vjp(&shaded.neighbours, &grad_textures, grad);
    }
    grad_points
}

#[inline(always)]
fn point_vjp(
    point: &Point,
    index: usize,
    lighting: &Lighting<'_>,
    shaded: &Shaded,
    grad: Vec3,
    resolution: usize,
    out: &mut PointGradient,
    grad_light: &mut [f32],
    mut grad_texture: Option<&mut [[f32; 4]]>,
) {
    if grad == Vec3::ZERO {
        return;
    }
    let shading = Shading::new(point.material, point.normal, point.view);
    let first = index * shaded.stride;
    for sample in &shaded.samples[first..first + shaded.counts[index] as usize] {
        let weighted = sample.scale * grad;
        let Some(reflection) = shading.reflect(sample.direction) else { continue };
        shading.accumulate(&reflection, weighted * sample.incoming, out);
        let grad_incoming = weighted * reflection.value();
        let grad_direct = sample.open * grad_incoming;
        let foot = footprint(sample.direction, lighting.light.size());
        for (texel, weight) in foot.texels.iter().zip(foot.weights) {
            let at = *texel as usize * 3;
            let texel = &mut grad_light[at..at + 3];
            texel[0] += weight * grad_direct.x;
            texel[1] += weight * grad_direct.y;
            texel[2] += weight * grad_direct.z;
        }
        if let Some(texture) = grad_texture.as_deref_mut() {
            let grad_occlusion = -grad_incoming.dot(sample.direct);
            let g = [grad_incoming.x, grad_incoming.y, grad_incoming.z, grad_occlusion];
            comgs_probe::sample_vjp(resolution, sample.direction, g, texture);
        }
    }
}

#[cfg(test)]
mod tests;
