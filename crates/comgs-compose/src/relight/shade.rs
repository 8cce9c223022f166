//! The estimator: light that leaves a point towards the eye, and light that falls on a surfel.

use super::light_sets::LightSets;
use super::surroundings::Around;
use super::{Heuristic, Point, RelightConfig};
use comgs_geom::Rng;
use comgs_geom::frame::world_from_tangent;
use comgs_geom::sampling::{cosine_hemisphere, cosine_hemisphere_pdf, hammersley};
use comgs_light::brdf::Reflection;
use comgs_light::{EnvironmentSampler, Shading};
use glam::{Vec2, Vec3};

/// Radiance that leaves a point towards the eye, by its way. [`Lit::total`] is L_o of ComGS Eq. 6.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lit {
    /// Of the light, by the matte term.
    pub diffuse: Vec3,
    /// Of the light, by the highlight.
    pub specular: Vec3,
    /// Of the object itself, by both.
    pub indirect: Vec3,
}

impl Lit {
    /// L_o.
    #[must_use]
    pub fn total(&self) -> Vec3 {
        self.diffuse + self.specular + self.indirect
    }

    /// A sample of light of `radiance`, of which the share `open` arrives, and of `incoming` from the object.
    fn add(&mut self, reflection: &Reflection, scale: f32, radiance: Vec3, (open, incoming): (f32, Vec3)) {
        let direct = scale * open * radiance;
        self.diffuse += reflection.diffuse * direct;
        self.specular += reflection.specular * direct;
        self.indirect += scale * reflection.value() * incoming;
    }
}

/// Random streams of a seed. A pixel's shading has the pixel's number.
pub(super) mod streams {
    /// Rotations of the light's samples for pixels.
    pub const LIGHT: u64 = 1 << 40;
    /// Rotations of the light's samples for surfels.
    pub const BOUNCE: u64 = LIGHT + 1;
    /// Of the first pixel's mean visibility.
    pub const VISIBILITY: u64 = 1 << 41;
    /// Of the first surfel.
    pub const SURFELS: u64 = 1 << 42;
}

/// ∫ f ((1 − O) L + L_in) cos θ dω by multiple importance sampling; `around` is at the point.
///
/// A sample drawn by the light (`n` of density p) or by the BRDF (`m` of density q) adds `w f L_i cos θ / (n p)` or
/// `w f L_i cos θ / (m q)`, with the weights of [`Heuristic`]. Both sets are Hammersley's, each under a random rotation of
/// stream `stream`; `sets` holds those of the light.
pub(super) fn shade(
    point: &Point,
    stream: u64,
    light: &EnvironmentSampler,
    sets: &LightSets,
    around: &Around<'_>,
    config: &RelightConfig,
) -> Lit {
    let shading = Shading::new(point.material, point.normal, point.view);
    let mut rng = Rng::stream(config.seed, stream);
    let by_brdf = Vec2::new(rng.uniform(), rng.uniform());
    let (n, m) = (config.light_rays as f32, config.brdf_rays as f32);
    let mut lit = Lit::default();
    for sample in sets.choose(&mut rng) {
        let Some(reflection) = shading.reflect(sample.direction) else { continue };
        let scale = scale(config.heuristic, n * sample.pdf, m * shading.pdf(sample.direction));
        lit.add(&reflection, scale, sample.radiance, around.look_at_light(sample.direction));
    }
    for s in 0..config.brdf_rays {
        let Some(direction) = shading.sample_stretched(hammersley(s, config.brdf_rays, by_brdf)) else {
            continue;
        };
        let Some(reflection) = shading.reflect(direction) else { continue };
        let (radiance, pdf) = light.evaluate(direction);
        let scale = scale(config.heuristic, m * shading.pdf(direction), n * pdf);
        lit.add(&reflection, scale, radiance, around.look(direction));
    }
    lit
}

/// Weight of a sample over its density and number, from the density times number of its own proposal and of the other;
/// 0 for a sample that its own proposal cannot have drawn.
fn scale(heuristic: Heuristic, own: f32, other: f32) -> f32 {
    let scale = match heuristic {
        Heuristic::Balance => 1.0 / (own + other),
        Heuristic::Power => own / (own * own + other * other),
    };
    if own > 0.0 && scale.is_finite() { scale } else { 0.0 }
}

/// Irradiance ∫ (1 − O) L cos θ dω of a surface with a unit normal, `around` being there: samples by the light
/// (`sets`) and as many by the cosine, with the balance heuristic.
pub(super) fn irradiance(
    normal: Vec3,
    stream: u64,
    light: &EnvironmentSampler,
    sets: &LightSets,
    around: &Around<'_>,
    seed: u64,
) -> Vec3 {
    let mut rng = Rng::stream(seed, stream);
    let by_cosine = Vec2::new(rng.uniform(), rng.uniform());
    let by_light = sets.choose(&mut rng);
    let each = by_light.len() as u32;
    let mut sum = Vec3::ZERO;
    let weight = |cosine: f32, pdf: f32| cosine / (pdf + cosine_hemisphere_pdf(cosine));
    for sample in by_light {
        let cosine = normal.dot(sample.direction);
        if cosine > 0.0 {
            let (open, _) = around.look_at_light(sample.direction);
            sum += open * weight(cosine, sample.pdf) * sample.radiance;
        }
    }
    let frame = world_from_tangent(normal);
    for s in 0..each {
        let direction = frame * cosine_hemisphere(hammersley(s, each, by_cosine));
        let cosine = normal.dot(direction);
        if cosine > 0.0 {
            let (radiance, pdf) = light.evaluate(direction);
            sum += around.look(direction).0 * weight(cosine, pdf) * radiance;
        }
    }
    sum / each as f32
}

/// Cosine-weighted mean of 1 − O over the hemisphere, 1/π ∫ (1 − O) cos θ dω, by `rays` samples of the cosine.
pub(super) fn visibility(normal: Vec3, stream: u64, around: &Around<'_>, rays: u32, seed: u64) -> f32 {
    let mut rng = Rng::stream(seed, stream);
    let shift = Vec2::new(rng.uniform(), rng.uniform());
    let frame = world_from_tangent(normal);
    let rays = rays.max(1);
    let look = |s| around.look(frame * cosine_hemisphere(hammersley(s, rays, shift))).0;
    (0..rays).map(look).sum::<f32>() / rays as f32
}
