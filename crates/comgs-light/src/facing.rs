//! Normals that can be shaded with.

use glam::Vec3;

/// Least cosine between a shading normal and the view.
pub const LEAST_FACING: f32 = 0.02;

/// A unit normal bent towards the eye where it faces away from it or nearly so (hard case 27), as blended and measured
/// normals do along silhouettes, where a BRDF would otherwise be black: `n′ = n + max(0, ε − n·v) v`, normalised; v is the unit
/// direction towards the eye, ε is [`LEAST_FACING`].
///
/// The normal itself where it faces the eye. Straight away from the eye, where the bend has no side, some perpendicular
/// normal. Gradient: [`facing_normal_vjp`]; it kinks where the bend begins.
#[inline]
#[must_use]
pub fn facing_normal(normal: Vec3, view: Vec3) -> Vec3 {
    let lack = LEAST_FACING - normal.dot(view);
    if lack > 0.0 {
        (normal + lack * view).try_normalize().unwrap_or_else(|| view.any_orthonormal_vector())
    } else {
        normal
    }
}

/// Gradient of [`facing_normal`] with respect to `normal`.
#[inline]
#[must_use]
pub fn facing_normal_vjp(normal: Vec3, view: Vec3, grad: Vec3) -> Vec3 {
    let lack = LEAST_FACING - normal.dot(view);
    if lack > 0.0 {
        let bent = normal + lack * view;
        let length = bent.length().max(f32::MIN_POSITIVE);
        let unit = bent / length;
        let grad = (grad - unit * unit.dot(grad)) / length;
        grad - view * view.dot(grad)
    } else {
        grad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the bent normal faces the eye (hard case 27), is the normal itself where that faces it already, and its gradient
    /// agrees with central differences on both sides of the bend.
    #[test]
    fn normals_face_the_eye() {
        let view = Vec3::new(0.1, -0.3, 0.9).normalize();
        let up = Vec3::new(0.4, 0.7, -0.2);
        for sum in [Vec3::new(0.3, 0.2, 0.5), Vec3::new(0.8, 0.1, -0.3), Vec3::new(0.6, 0.2, 0.02)] {
            let normal = sum.normalize();
            let n = facing_normal(normal, view);
            assert!(n.dot(view) > 0.0 && (n.length() - 1.0).abs() < 1e-5);
            if normal.dot(view) > LEAST_FACING {
                assert_eq!(n, normal);
            }
            let g = facing_normal_vjp(normal, view, up);
            for k in 0..3 {
                let step = 2e-3;
                let mut d = Vec3::ZERO;
                d[k] = step;
                let value = |s: Vec3| facing_normal(s, view).dot(up);
                let slope = (value(normal + d) - value(normal - d)) / (2.0 * step);
                assert!((g[k] - slope).abs() < 5e-3 * (1.0 + slope.abs()), "{sum} {k}: {} {slope}", g[k]);
            }
            assert!(g.length() > 0.0);
        }
        assert!(facing_normal(-view, view).is_finite());
    }
}
