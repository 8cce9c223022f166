//! Object and shadow under a light that is known, at any size of image and map: the final picture, where a matrix of
//! transport would be too large and the light's own importance makes few samples enough.

use crate::object::{Object, Surface};
use crate::transport::{DARK, look};
use comgs_geom::{Camera, Rng, sampling::hammersley};
use comgs_image::Image;
use comgs_light::{EnvironmentSampler, Shading};
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use serde::Serialize;

/// How much is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Samples {
    /// Camera rays a pixel along each side.
    pub grid: usize,
    /// Light samples and BSDF samples a pixel, each; shared out over its camera rays.
    pub light: usize,
    /// Shadow rays a pixel of the ground.
    pub shadow: usize,
    /// Interactions along a path.
    pub depth: usize,
}

impl Default for Samples {
    /// 128 samples a pixel as in DiPIR, three interactions.
    fn default() -> Self {
        Self { grid: 4, light: 128, shadow: 128, depth: 3 }
    }
}

/// The layers of an insertion, of the camera's size.
#[derive(Clone, Debug)]
pub struct Layers {
    /// Radiance of the object, straight, before tone (3 channels).
    pub radiance: Image,
    /// V, the object's share of the pixel (1 channel).
    pub coverage: Image,
    /// β before tone, 1 where there is no ground or no shadow (3 channels).
    pub ratio: Image,
    /// Base colour, straight (3 channels).
    pub albedo: Image,
    /// Unit shading normal, world (3 channels).
    pub normal: Image,
    /// z-depth of the object, 0 where it is not (1 channel).
    pub depth: Image,
}

/// Channels of all layers together.
const CHANNELS: usize = 15;

/// Share of the ground's samples that goes to the cosine lobe; the rest to the light.
const COSINE_SHARE: f32 = 0.3;

/// Share of the light that a pixel of the ground must be able to lose to be sampled at all.
const LEAST_SHARE: f32 = 1e-4;

/// Renders the layers. Light and BSDF samples are joined by the balance heuristic; every pixel has its own random stream,
/// so the same seed gives the same bytes at any thread count. `check` is asked with numbers of pixels done, in any
/// order, and stops the work (`None`) when it says `false`.
pub fn render(
    object: &Object,
    camera: &Camera,
    light: &EnvironmentSampler,
    samples: &Samples,
    seed: u64,
    check: impl Fn(usize) -> bool + Sync,
) -> Option<Layers> {
    let (w, h) = (camera.width, camera.height);
    let mut data = vec![0.0f32; w * h * CHANNELS];
    data.par_chunks_mut(w * CHANNELS)
        .enumerate()
        .map(|(y, line)| {
            if !check(w) {
                return None;
            }
            for (x, out) in line.chunks_exact_mut(CHANNELS).enumerate() {
                pixel(object, camera, light, samples, seed, y * w + x, out);
            }
            Some(())
        })
        .collect::<Option<()>>()?;
    let all = Image::from_data(w, h, CHANNELS, data);
    Some(Layers {
        radiance: all.select(&[0, 1, 2]),
        coverage: all.select(&[3]),
        ratio: all.select(&[4, 5, 6]),
        albedo: all.select(&[7, 8, 9]),
        normal: all.select(&[10, 11, 12]),
        depth: all.select(&[13]),
    })
}

fn pixel(
    object: &Object,
    camera: &Camera,
    light: &EnvironmentSampler,
    samples: &Samples,
    seed: u64,
    index: usize,
    out: &mut [f32],
) {
    let (seen, coverage) = look(object, camera, index, samples.grid, seed);
    let mut rng = Rng::stream(seed ^ LIGHT_STREAM, index as u64);
    out[3] = coverage;
    if !seen.is_empty() {
        let n = samples.light.div_ceil(seen.len());
        let (mut radiance, mut albedo, mut normal, mut depth) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, 0.0);
        for s in &seen {
            let path = Path { object, light, n, depth: samples.depth };
            radiance += path.radiance(&s.surface, s.view, &mut rng, 1) * s.weight;
            albedo += s.surface.material.albedo * s.weight;
            normal += s.surface.normal * s.weight;
            depth += -s.view.dot(camera.forward().as_vec3()) * s.surface.distance * s.weight;
        }
        out[..3].copy_from_slice(&radiance.to_array());
        out[7..10].copy_from_slice(&albedo.to_array());
        out[10..13].copy_from_slice(&normal.normalize_or_zero().to_array());
        out[13] = depth;
    }
    let ratio = if coverage < 1.0 {
        shadow_ratio(object, camera, light, samples, &mut rng, index)
    } else {
        Vec3::ONE
    };
    out[4..7].copy_from_slice(&ratio.to_array());
}

/// Sets the random numbers of light apart from those of camera rays.
const LIGHT_STREAM: u64 = 0x6c69_6768_7400_0000;

/// β of the ground in a pixel: light with the object over light without, by the same samples (Eq. 5).
fn shadow_ratio(
    object: &Object,
    camera: &Camera,
    light: &EnvironmentSampler,
    samples: &Samples,
    rng: &mut Rng,
    index: usize,
) -> Vec3 {
    let (x, y) = ((index % camera.width) as f64, (index / camera.width) as f64);
    let ground = |dx: f32, dy: f32| -> Option<Vec3> {
        let ray = camera.ray_world(x + f64::from(dx), y + f64::from(dy));
        let origin = camera.centre();
        (ray.z < -1e-9).then(|| {
            let mut p = (origin - ray * (origin.z / ray.z)).as_vec3();
            p.z = 1e-4 * object.radius;
            p
        })
    };
    let Some(middle) = ground(0.5, 0.5) else { return Vec3::ONE };
    let sine = (object.radius / object.centre.distance(middle)).min(1.0);
    if sine * sine < LEAST_SHARE {
        return Vec3::ONE;
    }
    let (mut all, mut taken) = (Vec3::ZERO, Vec3::ZERO);
    let shift = Vec2::new(rng.uniform(), rng.uniform());
    for k in 0..samples.shadow {
        let place = ground(rng.uniform(), rng.uniform()).unwrap_or(middle);
        let u = hammersley(k as u32, samples.shadow as u32, shift);
        let s = light.sample_defensive(Vec3::Z, COSINE_SHARE, u);
        if !(s.direction.z > 0.0 && s.pdf > 0.0) {
            continue;
        }
        let value = s.radiance * (s.direction.z / s.pdf);
        all += value;
        if object.may_meet(place, s.direction, 0.0) {
            taken += value * (1.0 - object.transmittance(place, s.direction));
        }
    }
    let ratio = |taken: f32, all: f32| if all > DARK { (1.0 - taken / all).clamp(0.0, 1.0) } else { 1.0 };
    Vec3::new(ratio(taken.x, all.x), ratio(taken.y, all.y), ratio(taken.z, all.z))
}

struct Path<'a> {
    object: &'a Object,
    light: &'a EnvironmentSampler,
    /// Samples of each kind at the first point; further points take one of each.
    n: usize,
    depth: usize,
}

impl Path<'_> {
    /// Radiance from a surface towards `view`.
    fn radiance(&self, at: &Surface, view: Vec3, rng: &mut Rng, depth: usize) -> Vec3 {
        let shading = Shading::new(at.material, at.normal, view);
        let n = if depth == 1 { self.n } else { 1 };
        let origin = self.object.leave(at);
        let mut sum = at.emission;
        // Evenly spread points, shifted by chance: half the noise of independent ones for the same rays.
        let shifts = [(); 2].map(|()| Vec2::new(rng.uniform(), rng.uniform()));
        for k in 0..n as u32 {
            let s = self.light.sample(hammersley(k, n as u32, shifts[0]));
            if s.direction.dot(at.face_normal) > 0.0 {
                let f = shading.eval_cosine(s.direction);
                if f != Vec3::ZERO && s.radiance != Vec3::ZERO {
                    let passed = self.object.transmittance(origin, s.direction);
                    let density = n as f32 * (s.pdf + shading.pdf(s.direction));
                    sum += f * s.radiance * (passed / density);
                }
            }
            let choice = rng.uniform();
            let Some(d) = shading.sample(choice, hammersley(k, n as u32, shifts[1])) else { continue };
            if d.dot(at.face_normal) <= 0.0 {
                continue;
            }
            let f = shading.eval_cosine(d);
            let hit = self.object.surface(origin, d);
            let passed = 1.0 - hit.map_or(0.0, |s| s.coverage);
            if passed > 0.0 {
                let (radiance, pdf) = self.light.evaluate(d);
                sum += f * radiance * (passed / (n as f32 * (pdf + shading.pdf(d))));
            }
            if let Some(next) = hit {
                let reflected =
                    if depth < self.depth { self.radiance(&next, -d, rng, depth + 1) } else { next.emission };
                sum += f * reflected * (next.coverage / (n as f32 * shading.pdf(d)));
            }
        }
        sum
    }
}
