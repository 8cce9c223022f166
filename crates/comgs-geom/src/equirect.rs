//! Equirectangular maps, z up: the image's centre looks along +x, its left quarter along +y, row 0 is the
//! zenith. `u` and `v` are continuous image coordinates in `[0, 1]`; texel `(i, j)` has its centre at
//! `((i + ½)/width, (j + ½)/height)`.

use glam::Vec3;
use std::f32::consts::PI;

/// Direction of `(u, v)`: azimuth θ = π − 2πu, polar angle φ = πv, direction
/// `(sin φ cos θ, sin φ sin θ, cos φ)`. Inverse: [`uv_from_direction`].
#[must_use]
pub fn direction(u: f32, v: f32) -> Vec3 {
    let theta = PI - 2.0 * PI * u;
    let phi = PI * v;
    let (sin_theta, cos_theta) = theta.sin_cos();
    let (sin_phi, cos_phi) = phi.sin_cos();
    Vec3::new(sin_phi * cos_theta, sin_phi * sin_theta, cos_phi)
}

/// Direction of the centre of texel `(column, row)` of a `width × height` map.
#[must_use]
pub fn texel_direction(column: usize, row: usize, width: usize, height: usize) -> Vec3 {
    direction((column as f32 + 0.5) / width as f32, (row as f32 + 0.5) / height as f32)
}

/// `(u, v)` in `[0, 1)²` of a direction of any length. Inverse of [`direction`]; the azimuth of an exact pole
/// is 0 (u = ½).
#[must_use]
pub fn uv_from_direction(d: Vec3) -> (f32, f32) {
    let horizontal = d.x.hypot(d.y);
    let theta = if horizontal > 0.0 { d.y.atan2(d.x) } else { 0.0 };
    let phi = horizontal.atan2(d.z);
    let u = ((PI - theta) / (2.0 * PI)).rem_euclid(1.0);
    (if u >= 1.0 { 0.0 } else { u }, (phi / PI).clamp(0.0, 1.0))
}

/// Solid angle in steradian of a texel in `row`: `2π/width · (cos φ₀ − cos φ₁)`. Over the map they sum to 4π.
#[must_use]
pub fn texel_solid_angle(row: usize, width: usize, height: usize) -> f32 {
    use std::f64::consts::PI;
    let top = PI * row as f64 / height as f64;
    let bottom = PI * (row + 1) as f64 / height as f64;
    (2.0 * PI / width as f64 * (top.cos() - bottom.cos())) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the convention stated in the README of the data: column w/2 is +x, w/4 is +y, row 0 is +z.
    #[test]
    fn axes_are_where_the_convention_says() {
        assert!((direction(0.5, 0.5) - Vec3::X).length() < 1e-6);
        assert!((direction(0.25, 0.5) - Vec3::Y).length() < 1e-6);
        assert!((direction(0.0, 0.5) + Vec3::X).length() < 1e-6);
        assert!((direction(0.3, 0.0) - Vec3::Z).length() < 1e-6);
    }

    /// Goal: direction → (u, v) → direction is the identity, and texel centres come back exactly.
    #[test]
    fn round_trip() {
        for row in 0..16 {
            for column in 0..32 {
                let d = texel_direction(column, row, 32, 16);
                let (u, v) = uv_from_direction(d * 3.0);
                assert_eq!(((u * 32.0) as usize, (v * 16.0) as usize), (column, row));
                assert!((direction(u, v) - d).length() < 1e-5);
            }
        }
        for d in [Vec3::Z, -Vec3::Z, Vec3::new(-1.0, -0.0, 0.0), Vec3::new(-1.0, 0.0, 0.0)] {
            let (u, v) = uv_from_direction(d);
            assert!((0.0..1.0).contains(&u) && (0.0..=1.0).contains(&v));
            assert!((direction(u, v) - d).length() < 1e-5);
        }
    }

    /// Goal: the texels' solid angles cover the sphere.
    #[test]
    fn solid_angles_sum_to_the_sphere() {
        let sum: f64 = (0..64).map(|row| 128.0 * f64::from(texel_solid_angle(row, 128, 64))).sum();
        assert!((sum - 4.0 * std::f64::consts::PI).abs() < 1e-5);
    }
}
