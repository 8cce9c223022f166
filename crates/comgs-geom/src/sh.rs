//! Real spherical harmonics to degree 3 with the signs and order that 3DGS-family PLY files use
//! (Sloan 2008, "Stupid spherical harmonics tricks", with the Condon–Shortley phase).

use glam::Vec3;

/// Highest supported degree.
pub const MAX_DEGREE: usize = 3;
/// Number of coefficients at [`MAX_DEGREE`].
pub const MAX_COEFFICIENTS: usize = 16;
/// Value of the constant basis function, 1/(2√π).
pub const C0: f32 = 0.282_094_79;
const C1: f32 = 0.488_602_51;
const C2: [f32; 5] = [1.092_548_4, -1.092_548_4, 0.315_391_57, -1.092_548_4, 0.546_274_2];
const C3: [f32; 7] =
    [-0.590_043_6, 2.890_611_4, -0.457_045_8, 0.373_176_33, -0.457_045_8, 1.445_305_7, -0.590_043_6];

/// Coefficients of a degree: `(degree + 1)²`.
#[must_use]
pub const fn coefficient_count(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// The basis functions at unit direction `d`, up to `degree`; entries above are 0.
///
/// Differentiable; gradient: [`basis_gradient`].
#[must_use]
pub fn basis(degree: usize, d: Vec3) -> [f32; MAX_COEFFICIENTS] {
    let mut b = [0.0; MAX_COEFFICIENTS];
    b[0] = C0;
    if degree >= 1 {
        b[1] = -C1 * d.y;
        b[2] = C1 * d.z;
        b[3] = -C1 * d.x;
    }
    if degree >= 2 {
        let (x, y, z) = (d.x, d.y, d.z);
        b[4] = C2[0] * x * y;
        b[5] = C2[1] * y * z;
        b[6] = C2[2] * (2.0 * z * z - x * x - y * y);
        b[7] = C2[3] * x * z;
        b[8] = C2[4] * (x * x - y * y);
        if degree >= 3 {
            b[9] = C3[0] * y * (3.0 * x * x - y * y);
            b[10] = C3[1] * x * y * z;
            b[11] = C3[2] * y * (4.0 * z * z - x * x - y * y);
            b[12] = C3[3] * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y);
            b[13] = C3[4] * x * (4.0 * z * z - x * x - y * y);
            b[14] = C3[5] * z * (x * x - y * y);
            b[15] = C3[6] * x * (x * x - 3.0 * y * y);
        }
    }
    b
}

/// Derivatives of [`basis`] with respect to `d` (treated as a free vector; project onto the tangent
/// plane when `d` is a normalised difference).
#[must_use]
pub fn basis_gradient(degree: usize, d: Vec3) -> [Vec3; MAX_COEFFICIENTS] {
    let mut g = [Vec3::ZERO; MAX_COEFFICIENTS];
    if degree >= 1 {
        g[1] = Vec3::new(0.0, -C1, 0.0);
        g[2] = Vec3::new(0.0, 0.0, C1);
        g[3] = Vec3::new(-C1, 0.0, 0.0);
    }
    if degree >= 2 {
        let (x, y, z) = (d.x, d.y, d.z);
        g[4] = C2[0] * Vec3::new(y, x, 0.0);
        g[5] = C2[1] * Vec3::new(0.0, z, y);
        g[6] = C2[2] * Vec3::new(-2.0 * x, -2.0 * y, 4.0 * z);
        g[7] = C2[3] * Vec3::new(z, 0.0, x);
        g[8] = C2[4] * Vec3::new(2.0 * x, -2.0 * y, 0.0);
        if degree >= 3 {
            let (xx, yy, zz) = (x * x, y * y, z * z);
            g[9] = C3[0] * Vec3::new(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0);
            g[10] = C3[1] * Vec3::new(y * z, x * z, x * y);
            g[11] = C3[2] * Vec3::new(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
            g[12] = C3[3] * Vec3::new(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
            g[13] = C3[4] * Vec3::new(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
            g[14] = C3[5] * Vec3::new(2.0 * x * z, -2.0 * y * z, xx - yy);
            g[15] = C3[6] * Vec3::new(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0);
        }
    }
    g
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling;
    use glam::Vec2;

    /// Goal: the basis is orthonormal over the sphere, by quadrature that shares nothing with the formulas.
    #[test]
    fn orthonormal() {
        let n = 1 << 14;
        let mut gram = [[0.0f64; 16]; 16];
        for i in 0..n {
            let b = basis(3, sampling::uniform_sphere(sampling::hammersley(i, n, Vec2::ZERO)));
            for j in 0..16 {
                for k in 0..16 {
                    gram[j][k] += f64::from(b[j]) * f64::from(b[k]);
                }
            }
        }
        let scale = 4.0 * std::f64::consts::PI / f64::from(n);
        for j in 0..16 {
            for k in 0..16 {
                let expected = if j == k { 1.0 } else { 0.0 };
                assert!((gram[j][k] * scale - expected).abs() < 5e-3, "{j} {k} {}", gram[j][k] * scale);
            }
        }
    }

    /// Goal: the gradient matches central differences of the same polynomial.
    #[test]
    fn gradient_matches_finite_differences() {
        let d = Vec3::new(0.3, -0.5, 0.8);
        let g = basis_gradient(3, d);
        let h = 1e-2;
        for axis in 0..3 {
            let mut e = Vec3::ZERO;
            e[axis] = h;
            let (plus, minus) = (basis(3, d + e), basis(3, d - e));
            for k in 0..16 {
                let numeric = (plus[k] - minus[k]) / (2.0 * h);
                assert!((numeric - g[k][axis]).abs() < 2e-3, "{k} {axis}: {numeric} {}", g[k][axis]);
            }
        }
    }
}
