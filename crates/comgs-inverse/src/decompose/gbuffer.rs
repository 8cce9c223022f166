//! From G-buffers to shading points, and from gradients of points back to the planes.

use super::shade::{Point, PointGradient};
use comgs_geom::Camera;
use comgs_light::brdf::Material;
use comgs_raster::{Frame, FrameGradient, surface_normals};
use glam::Vec3;

/// Weight of a pixel below which it is not shaded: there is no depth to speak of.
const MIN_WEIGHT: f32 = 0.05;
/// Least cosine between the shading normal and the view.
const LEAST_FACING: f32 = 0.02;

/// Unit normal to shade with: the surface's ([`surface_normals`]) at unit length, bent towards the eye where it faces away from
/// it or nearly so (hard case 27), as it does along silhouettes: `n′ = n + max(0, ε − n·v) v`, normalised. `None` for a zero
/// normal. Gradient: [`shading_normal_vjp`]; it kinks where the bend begins.
fn shading_normal(sum: Vec3, view: Vec3) -> Option<Vec3> {
    let n = sum.try_normalize()?;
    let lack = LEAST_FACING - n.dot(view);
    if lack > 0.0 { (n + lack * view).try_normalize() } else { Some(n) }
}

/// Gradient of [`shading_normal`] with respect to `sum`.
fn shading_normal_vjp(sum: Vec3, view: Vec3, grad: Vec3) -> Vec3 {
    let length = sum.length();
    let n = sum / length;
    let lack = LEAST_FACING - n.dot(view);
    let grad = if lack > 0.0 {
        let bent = n + lack * view;
        let unit = bent.normalize();
        let grad = (grad - unit * unit.dot(grad)) / bent.length();
        grad - view * view.dot(grad)
    } else {
        grad
    };
    (grad - n * n.dot(grad)) / length
}

/// Shading points of a G-buffer, one a pixel that has a surface (weight above 0.05 and a normal towards the eye); their
/// pixels are returned. Material and depth are the planes over the weight (ComGS §3.1: unbiased), normals those of the surface
/// that the depths show ([`surface_normals`]).
pub fn shading_points(frame: &Frame, camera: &Camera, points: &mut Vec<Point>) -> Vec<u32> {
    let (Some(depth), Some(normal), Some(material)) =
        (&frame.depth, surface_normals(frame, camera), &frame.material)
    else {
        return Vec::new();
    };
    let mut pixels = Vec::new();
    for i in 0..frame.weight.data.len() {
        let w = frame.weight.data[i];
        if !(w > MIN_WEIGHT) {
            continue;
        }
        let (x, y) = (i % frame.weight.width, i / frame.weight.width);
        let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
        let view = -ray.normalize().as_vec3();
        let Some(n) = shading_normal(Vec3::from_slice(&normal.data[3 * i..]), view) else { continue };
        let position = (camera.centre() + ray * f64::from(depth.data[i] / w)).as_vec3();
        let m = &material.data[5 * i..5 * i + 5];
        points.push(Point {
            position,
            normal: n,
            view,
            material: Material {
                albedo: Vec3::new(m[0], m[1], m[2]) / w,
                roughness: m[3] / w,
                metallic: m[4] / w,
            },
        });
        pixels.push(i as u32);
    }
    pixels
}

/// Carries gradients of shading points to the premultiplied planes: `m = M/W`; that of the normal goes to the blended normal
/// N/|N| as if it were the surface's, to which the depth-normal term (Eq. 3) binds it.
pub(super) fn plane_gradients(
    frame: &Frame,
    pixels: &[u32],
    points: &[Point],
    grad_points: &[PointGradient],
    gradient: &mut FrameGradient,
) {
    let (Some(normal), Some(material)) = (&frame.normal, &frame.material) else { return };
    let FrameGradient { weight: Some(grad_w), normal: Some(grad_n), material: Some(grad_m), .. } = gradient
    else {
        return;
    };
    for ((&i, point), g) in pixels.iter().zip(points).zip(grad_points) {
        let i = i as usize;
        let w = frame.weight.data[i];
        let g_n = shading_normal_vjp(Vec3::from_slice(&normal.data[3 * i..]), point.view, g.normal);
        let g_m = [g.albedo.x, g.albedo.y, g.albedo.z, g.roughness, g.metallic];
        for k in 0..3 {
            grad_n.data[3 * i + k] += g_n[k];
        }
        for k in 0..5 {
            grad_m.data[5 * i + k] += g_m[k] / w;
            grad_w.data[i] -= g_m[k] * material.data[5 * i + k] / (w * w);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the bent normal faces the eye (hard case 27), is the normal itself where that faces it already, and its gradient
    /// agrees with central differences on both sides of the bend.
    #[test]
    fn shading_normal_faces_the_eye() {
        let view = Vec3::new(0.1, -0.3, 0.9).normalize();
        let up = Vec3::new(0.4, 0.7, -0.2);
        for sum in [Vec3::new(0.3, 0.2, 0.5), Vec3::new(0.8, 0.1, -0.3), Vec3::new(0.6, 0.2, 0.02)] {
            let n = shading_normal(sum, view).expect("a direction");
            assert!(n.dot(view) > 0.0 && (n.length() - 1.0).abs() < 1e-5);
            if sum.normalize().dot(view) > LEAST_FACING {
                assert!((n - sum.normalize()).length() < 1e-6);
            }
            let g = shading_normal_vjp(sum, view, up);
            for k in 0..3 {
                let step = 2e-3;
                let mut d = Vec3::ZERO;
                d[k] = step;
                let value = |s: Vec3| shading_normal(s, view).expect("a direction").dot(up);
                let slope = (value(sum + d) - value(sum - d)) / (2.0 * step);
                assert!((g[k] - slope).abs() < 5e-3 * (1.0 + slope.abs()), "{sum} {k}: {} {slope}", g[k]);
            }
            assert!(g.length() > 0.0);
        }
        assert!(shading_normal(Vec3::ZERO, view).is_none());
    }
}
