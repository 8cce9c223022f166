//! What leaves a point, by brute force over all texels of a map in f64: the judge of the estimator. The reflectance is
//! written once more, from the textbook, with angles.

use super::Point;
use comgs_light::EnvironmentMap;
use comgs_light::brdf::{DIELECTRIC_F0, LEAST_ROUGHNESS};
use glam::DVec3;
use std::f64::consts::PI;

/// Radiance by its way; see [`super::Lit`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Of the light, by the matte term.
    pub diffuse: DVec3,
    /// Of the light, by the highlight.
    pub specular: DVec3,
    /// Of the object itself.
    pub indirect: DVec3,
}

/// ∫ f ((1 − O) L + L_in) cos θ dω by the midpoint rule: every texel of the map, which is constant over it, is cut into
/// `parts × parts` cells. `surroundings` gives 1 − O and L_in from a unit direction.
#[must_use]
pub fn radiance(
    point: &Point,
    map: &EnvironmentMap,
    parts: usize,
    surroundings: impl Fn(DVec3) -> (f64, DVec3),
) -> Reference {
    let (columns, rows) = (map.width() * parts, map.height() * parts);
    let turn = f64::from(map.turn());
    let mut sum = Reference::default();
    for row in 0..rows {
        let polar = |row: f64| PI * row / rows as f64;
        let omega = 2.0 * PI / columns as f64 * (polar(row as f64).cos() - polar(row as f64 + 1.0).cos());
        let (sin, cos) = polar(row as f64 + 0.5).sin_cos();
        for column in 0..columns {
            let azimuth = PI * (1.0 - 2.0 * (column as f64 + 0.5) / columns as f64) + turn;
            let direction = DVec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos);
            let [diffuse, specular] = reflectance(point, direction);
            if diffuse + specular == DVec3::ZERO {
                continue;
            }
            let light = map.texel(column / parts, row / parts).as_dvec3();
            let (open, incoming) = surroundings(direction);
            sum.diffuse += omega * open * diffuse * light;
            sum.specular += omega * open * specular * light;
            sum.indirect += omega * (diffuse + specular) * incoming;
        }
    }
    sum
}

/// f · cos θ towards a light, matte and highlight; the model of [`comgs_light::brdf`].
#[must_use]
pub fn reflectance(point: &Point, light: DVec3) -> [DVec3; 2] {
    let (normal, view) = (point.normal.as_dvec3(), point.view.as_dvec3());
    let (n_l, n_v) = (normal.dot(light), normal.dot(view));
    if n_l <= 0.0 || n_v <= 0.0 {
        return [DVec3::ZERO; 2];
    }
    let material = point.material;
    let (albedo, metallic) = (material.albedo.as_dvec3(), f64::from(material.metallic));
    let alpha = f64::from(material.roughness.clamp(LEAST_ROUGHNESS, 1.0)).powi(2);
    let half = (view + light).normalize();
    let tan2 = |cosine: f64| (1.0 - cosine * cosine) / (cosine * cosine);
    // GGX by the angle between normal and half vector; Smith's Λ.
    let n_h = normal.dot(half);
    let distribution = alpha * alpha / (PI * n_h.powi(4) * (alpha * alpha + tan2(n_h)).powi(2));
    let lambda = |cosine: f64| 0.5 * ((1.0 + alpha * alpha * tan2(cosine)).sqrt() - 1.0);
    let masking = 1.0 / (1.0 + lambda(n_v) + lambda(n_l));
    let f0 = DVec3::splat(f64::from(DIELECTRIC_F0)).lerp(albedo, metallic);
    let fresnel = f0 + (1.0 - f0) * (1.0 - view.dot(half)).powi(5);
    [(1.0 - metallic) * albedo / PI * n_l, fresnel * (distribution * masking / (4.0 * n_v))]
}
