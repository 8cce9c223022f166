//! Orthonormal frames around a direction.

use glam::{Mat3, Vec3};

/// A rotation whose z axis is the unit vector `n`: columns are tangent, bitangent, normal. Continuous except at
/// n = −z (Duff et al. 2017, "Building an orthonormal basis, revisited").
#[must_use]
pub fn world_from_tangent(n: Vec3) -> Mat3 {
    let sign = 1.0f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    Mat3::from_cols(
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
        n,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: orthonormal and right-handed for all directions, the poles included.
    #[test]
    fn frames_are_rotations() {
        let axes = [-1.0f32, -0.3, 0.0, 0.7, 1.0];
        for x in axes {
            for y in axes {
                for z in axes {
                    let n = Vec3::new(x, y, z);
                    if n.length() == 0.0 {
                        continue;
                    }
                    let m = world_from_tangent(n.normalize());
                    let error = (m.transpose() * m - Mat3::IDENTITY).to_cols_array();
                    assert!(error.iter().all(|e| e.abs() < 1e-5), "{n}: {m}");
                    assert!(m.determinant() > 0.99);
                }
            }
        }
    }
}
