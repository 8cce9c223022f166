//! The shadow ratio of Eq. 15–17: how much of its light a scene point keeps once the object stands there.
//!
//! The scene is taken as Lambertian, so its albedo cancels: `S = ∫ L (1 − O′) cos⁺ / ∫ L cos⁺`, with `O′` what
//! the object alone occludes. Numerator and denominator use the same light samples, so the ratio never leaves
//! [0, 1] whatever the light is, and a light that no sample sees can neither brighten nor darken anything.

use crate::receivers::Receivers;
use comgs_geom::Rng;
use comgs_geom::frame::world_from_tangent;
use comgs_geom::sampling::{cosine_hemisphere, cosine_hemisphere_pdf, hammersley};
use comgs_image::Image;
use comgs_light::EnvironmentSampler;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Irradiance (linear, per channel) under which a ratio has no meaning: such channels keep their radiance.
pub const DARK: f32 = 1e-6;

/// One importance sample of the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit direction towards the light, world space.
    pub direction: Vec3,
    /// Linear radiance from there.
    pub radiance: Vec3,
    /// Density per steradian with which the direction was drawn; 0 marks an unusable sample.
    pub pdf: f32,
}

/// Something that light comes from, drawn by importance.
pub trait LightSource: Sync {
    /// The sample at `u` in `[0, 1)²`.
    fn sample(&self, u: Vec2) -> LightSample;

    /// Radiance from a unit direction, and the density per steradian with which [`LightSource::sample`] draws it.
    fn evaluate(&self, direction: Vec3) -> (Vec3, f32);
}

impl LightSource for EnvironmentSampler {
    fn sample(&self, u: Vec2) -> LightSample {
        let s = EnvironmentSampler::sample(self, u);
        LightSample { direction: s.direction, radiance: s.radiance, pdf: s.pdf }
    }

    fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
        EnvironmentSampler::evaluate(self, direction)
    }
}

/// Something that takes light away.
pub trait Occluder: Sync {
    /// Transmittance in [0, 1] of the segment from `origin` along the unit `direction`, distances 0 to `t_max`.
    fn transmittance(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32;

    /// Centre and radius of a sphere that holds all of it; rays that miss it are not traced.
    fn bounding_sphere(&self) -> (Vec3, f32);
}

/// Knobs of the shadow.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowConfig {
    /// Light samples a pixel, at least 2: half of them by the light, half by the receiver's cosine. 64 is a draft,
    /// 128 the default, 256 the paper's count.
    pub rays: u32,
    /// Seed of the sample sets.
    pub seed: u64,
    /// Unshadowed irradiance under which a channel's ratio is exactly 1.
    pub dark: f32,
    /// Scene weight under which a pixel has no surface to receive a shadow.
    pub min_weight: f32,
    /// Smoothing of the ratio.
    pub denoise: crate::denoise::Denoise,
}

impl Default for ShadowConfig {
    fn default() -> Self {
        Self { rays: 128, seed: 0, dark: DARK, min_weight: 0.5, denoise: crate::denoise::Denoise::default() }
    }
}

/// Shadow ratio of a Lambertian receiver: radiance with the object over radiance without (ComGS Eq. 15–17).
///
/// * `normal`: unit, world space, towards the side that is lit
/// * `light`: importance samples
/// * `visibility`: one value in [0, 1] per sample, object only
/// * `dark`: see [`DARK`]
///
/// Returns RGB in [0, 1]: `Σ w v / Σ w` with `w = L cos⁺ / pdf`; exactly 1 where `Σ w / n` is below `dark`,
/// because the ratio has no meaning there (an all-black light gives 1, not NaN). Linear in `visibility`.
#[must_use]
pub fn shadow_ratio(normal: Vec3, light: &[LightSample], visibility: &[f32], dark: f32) -> Vec3 {
    let mut estimate = RatioEstimate::default();
    for (sample, &v) in light.iter().zip(visibility) {
        estimate.add(weight(normal, sample), v);
    }
    estimate.ratio(light.len(), dark)
}

/// `L cos⁺ / pdf`; zero below the horizon and for unusable samples.
fn weight(normal: Vec3, sample: &LightSample) -> Vec3 {
    let cosine = normal.dot(sample.direction);
    if cosine <= 0.0 || !(sample.pdf > 0.0) {
        return Vec3::ZERO;
    }
    let w = sample.radiance.max(Vec3::ZERO) * (cosine / sample.pdf);
    if w.is_finite() { w } else { Vec3::ZERO }
}

/// Running sums of a ratio estimator and of its variance.
#[derive(Clone, Copy, Debug, Default)]
struct RatioEstimate {
    lit: Vec3,
    kept: Vec3,
    /// Σ w², Σ w² v, Σ w² v² of the luminance weight, for the variance of the ratio.
    moments: [f32; 3],
}

impl RatioEstimate {
    fn add(&mut self, w: Vec3, visibility: f32) {
        let v = visibility.clamp(0.0, 1.0);
        self.lit += w;
        self.kept += w * v;
        let square = luminance(w) * luminance(w);
        self.moments[0] += square;
        self.moments[1] += square * v;
        self.moments[2] += square * v * v;
    }

    fn ratio(&self, samples: usize, dark: f32) -> Vec3 {
        let n = samples.max(1) as f32;
        let channel = |kept: f32, lit: f32| if lit / n < dark { 1.0 } else { (kept / lit).min(1.0) };
        Vec3::new(
            channel(self.kept.x, self.lit.x),
            channel(self.kept.y, self.lit.y),
            channel(self.kept.z, self.lit.z),
        )
    }

    /// Variance of the luminance ratio by linearisation: `Σ w² (v − S)² / (Σ w)²`.
    fn variance(&self) -> f32 {
        let lit = luminance(self.lit);
        if lit <= 0.0 {
            return 0.0;
        }
        let s = (luminance(self.kept) / lit).min(1.0);
        let [a, b, c] = self.moments;
        ((c - 2.0 * s * b + s * s * a) / (lit * lit)).max(0.0)
    }
}

fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// A shadow as traced, before smoothing.
#[derive(Clone, Debug)]
pub struct TracedShadow {
    /// Ratio, three channels in [0, 1]; exactly 1 where nothing can be in shadow.
    pub ratio: Image,
    /// Estimated variance of the luminance ratio, one channel.
    pub variance: Image,
    /// Rays that were traced (those that met the bounding sphere above the horizon).
    pub rays_traced: u64,
}

/// Rotated copies of the sample sets; every pixel takes one of them at random. Drawing 64 light samples a pixel afresh
/// took four times as long as tracing them.
const ROTATIONS: u32 = 256;

/// Both sample sets in all their rotations. Half of a map's light usually lies below a receiver's horizon, where
/// samples are lost; and a receiver that faces away from the brightest light still needs samples of what it does see.
/// So half of the samples follow the receiver's cosine, and both halves are weighted by the density of the mixture.
struct SampleSets {
    each: usize,
    /// `[rotation][sample]`.
    light: Vec<LightSample>,
    /// Directions about +z, `[rotation][sample]`.
    cosine: Vec<Vec3>,
}

impl SampleSets {
    fn new(light: &dyn LightSource, config: &ShadowConfig) -> Self {
        let each = config.rays.div_ceil(2).max(1);
        let mut sets = Self { each: each as usize, light: Vec::new(), cosine: Vec::new() };
        for rotation in 0..ROTATIONS {
            let mut rng = Rng::stream(config.seed, u64::from(rotation));
            let shifts = [(); 2].map(|()| Vec2::new(rng.uniform(), rng.uniform()));
            for k in 0..each {
                sets.light.push(light.sample(hammersley(k, each, shifts[0])));
                sets.cosine.push(cosine_hemisphere(hammersley(k, each, shifts[1])));
            }
        }
        sets
    }
}

/// Traces the shadow ratio of every receiver.
///
/// Every pixel takes one of `ROTATIONS` rotations of the same Hammersley sets, chosen by a stream of `config.seed`,
/// so the noise is white, the result does not depend on the thread count, and the same seed gives the same picture. Two
/// exact short cuts keep most pixels from tracing anything: a receiver under whose horizon the whole bounding sphere
/// lies is 1, and so is one none of whose samples meets the sphere.
#[must_use]
pub fn trace_shadow(
    receivers: &Receivers,
    light: &dyn LightSource,
    occluder: &dyn Occluder,
    config: &ShadowConfig,
) -> TracedShadow {
    let (width, height) = (receivers.width, receivers.height);
    let sphere = occluder.bounding_sphere();
    let sets = SampleSets::new(light, config);
    let rows: Vec<(Vec<f32>, Vec<f32>, u64)> = (0..height)
        .into_par_iter()
        .map(|y| {
            let mut ratio = vec![1.0f32; width * 3];
            let mut variance = vec![0.0f32; width];
            let mut traced = 0u64;
            let mut rays = Vec::with_capacity(2 * sets.each);
            for x in 0..width {
                let i = y * width + x;
                if !receivers.is_surface(i) {
                    continue;
                }
                let rotation = Rng::stream(config.seed, (1 << 32) | i as u64).below(ROTATIONS as usize);
                let receiver = (receivers.points[i], receivers.normals[i]);
                if !candidates(receiver, sphere, &sets, rotation, &mut rays) {
                    continue;
                }
                let estimate = estimate(receiver, &rays, light, occluder, &mut traced);
                ratio[x * 3..x * 3 + 3]
                    .copy_from_slice(&estimate.ratio(2 * sets.each, config.dark).to_array());
                variance[x] = estimate.variance();
            }
            (ratio, variance, traced)
        })
        .collect();
    let mut shadow = TracedShadow {
        ratio: Image::filled(width, height, 3, 1.0),
        variance: Image::zeros(width, height, 1),
        rays_traced: 0,
    };
    for (y, (ratio, variance, traced)) in rows.into_iter().enumerate() {
        shadow.ratio.data[y * width * 3..(y + 1) * width * 3].copy_from_slice(&ratio);
        shadow.variance.data[y * width..(y + 1) * width].copy_from_slice(&variance);
        shadow.rays_traced += traced;
    }
    shadow
}

/// A sample of one pixel.
#[derive(Clone, Copy)]
struct Candidate {
    direction: Vec3,
    /// Radiance and density of the light, where the sample came from the light.
    light: Option<(Vec3, f32)>,
    /// Where the ray leaves the bounding sphere; 0 when it misses.
    exit: f32,
}

/// Fills `rays` with a pixel's samples above its horizon; `false` when none of them meets the sphere (and `rays` is then
/// not complete).
fn candidates(
    (point, normal): (Vec3, Vec3),
    (centre, radius): (Vec3, f32),
    sets: &SampleSets,
    rotation: usize,
    rays: &mut Vec<Candidate>,
) -> bool {
    rays.clear();
    if sphere_is_below_horizon(point, normal, centre, radius) {
        return false;
    }
    let range = rotation * sets.each..(rotation + 1) * sets.each;
    let mut meets = false;
    let mut push = |direction: Vec3, light: Option<(Vec3, f32)>| {
        let exit = sphere_exit(point, direction, centre, radius);
        meets |= exit > 0.0;
        rays.push(Candidate { direction, light, exit });
    };
    for sample in &sets.light[range.clone()] {
        if normal.dot(sample.direction) > 0.0 && sample.pdf > 0.0 {
            push(sample.direction, Some((sample.radiance, sample.pdf)));
        }
    }
    let world_from_tangent = world_from_tangent(normal);
    for direction in &sets.cosine[range] {
        push(world_from_tangent * *direction, None);
    }
    meets
}

/// Traces the rays that meet the sphere and sums all of them up.
fn estimate(
    (point, normal): (Vec3, Vec3),
    rays: &[Candidate],
    light: &dyn LightSource,
    occluder: &dyn Occluder,
    traced: &mut u64,
) -> RatioEstimate {
    let mut estimate = RatioEstimate::default();
    for ray in rays {
        let (radiance, light_pdf) = ray.light.unwrap_or_else(|| light.evaluate(ray.direction));
        let pdf = 0.5 * (light_pdf + cosine_hemisphere_pdf(normal.dot(ray.direction)));
        let w = weight(normal, &LightSample { direction: ray.direction, radiance, pdf });
        if w == Vec3::ZERO {
            continue;
        }
        let visibility = if ray.exit > 0.0 {
            *traced += 1;
            occluder.transmittance(point, ray.direction, ray.exit)
        } else {
            1.0
        };
        estimate.add(w, visibility);
    }
    estimate
}

/// Whether no direction above the receiver's horizon meets the sphere.
fn sphere_is_below_horizon(point: Vec3, normal: Vec3, centre: Vec3, radius: f32) -> bool {
    normal.dot(centre - point) <= -radius
}

/// Distance at which a ray leaves the sphere; 0 when it never meets it in front of the origin.
fn sphere_exit(origin: Vec3, direction: Vec3, centre: Vec3, radius: f32) -> f32 {
    let to_centre = centre - origin;
    let along = to_centre.dot(direction);
    let closest = to_centre.length_squared() - along * along;
    let inside = radius * radius - closest;
    if inside < 0.0 {
        return 0.0;
    }
    (along + inside.sqrt()).max(0.0)
}

#[cfg(test)]
mod tests;
