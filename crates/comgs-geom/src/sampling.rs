//! Sampling warps from the unit square, each with its density.

use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Radical inverse in base 2 (van der Corput), in `[0, 1)`.
#[must_use]
pub fn radical_inverse_2(i: u32) -> f32 {
    (i.reverse_bits() >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Point `i` of the `n`-point Hammersley set, rotated (modulo 1) by `shift`.
#[must_use]
pub fn hammersley(i: u32, n: u32, shift: Vec2) -> Vec2 {
    let p = Vec2::new((i as f32 + 0.5) / n as f32 + shift.x, radical_inverse_2(i) + shift.y);
    (p - p.floor()).min(Vec2::splat(1.0 - f32::EPSILON / 2.0))
}

/// Uniform direction on the sphere; density 1/4π.
#[must_use]
pub fn uniform_sphere(u: Vec2) -> Vec3 {
    let z = 1.0 - 2.0 * u.x;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (s, c) = (2.0 * PI * u.y).sin_cos();
    Vec3::new(r * c, r * s, z)
}

/// Cosine-distributed direction around +z; density [`cosine_hemisphere_pdf`].
#[must_use]
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let r = u.x.sqrt();
    let (s, c) = (2.0 * PI * u.y).sin_cos();
    Vec3::new(r * c, r * s, (1.0 - u.x).max(0.0).sqrt())
}

/// Density per steradian of [`cosine_hemisphere`]: `cos θ / π` above the horizon, 0 below.
#[must_use]
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) / PI
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: sample means of cos θ match the integrals (2/3 for the cosine lobe, 0 for the sphere).
    #[test]
    fn means_match_the_densities() {
        let n = 4096;
        let (mut cosine, mut sphere) = (0.0f64, Vec3::ZERO);
        for i in 0..n {
            let u = hammersley(i, n, Vec2::new(0.3, 0.8));
            cosine += f64::from(cosine_hemisphere(u).z);
            sphere += uniform_sphere(u);
        }
        assert!((cosine / f64::from(n) - 2.0 / 3.0).abs() < 1e-3);
        assert!((sphere / n as f32).length() < 1e-3);
    }

    /// Goal: all points stay in [0, 1) whatever the shift.
    #[test]
    fn hammersley_stays_inside() {
        for i in 0..64 {
            for shift in [Vec2::ZERO, Vec2::splat(0.999_999_9), Vec2::new(1.0, 0.5)] {
                let p = hammersley(i, 64, shift);
                assert!(p.x >= 0.0 && p.x < 1.0 && p.y >= 0.0 && p.y < 1.0, "{p}");
            }
        }
    }
}
