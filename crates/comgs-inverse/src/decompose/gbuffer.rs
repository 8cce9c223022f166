//! From G-buffers to shading points, and from gradients of points back to the planes.

use super::shade::{Point, PointGradient};
use comgs_geom::Camera;
use comgs_light::brdf::Material;
use comgs_light::{facing_normal, facing_normal_vjp};
use comgs_raster::{Frame, FrameGradient, surface_normals};
use glam::Vec3;

/// Weight of a pixel below which it is not shaded: there is no depth to speak of.
const MIN_WEIGHT: f32 = 0.05;

/// Shading points of a G-buffer, one a pixel that has a surface (weight above 0.05 and a normal); their
/// pixels are returned. Material and depth are the planes over the weight (ComGS §3.1: unbiased), normals those of the surface
/// that the depths show ([`surface_normals`]), turned to the eye ([`facing_normal`]).
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
        let Some(n) = Vec3::from_slice(&normal.data[3 * i..]).try_normalize() else { continue };
        let position = (camera.centre() + ray * f64::from(depth.data[i] / w)).as_vec3();
        let m = &material.data[5 * i..5 * i + 5];
        points.push(Point {
            position,
            normal: facing_normal(n, view),
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

/// Carries gradients of shading points to the premultiplied planes: `m = M/W`; that of the normal goes to the blended
/// normal N/|N| as if it were the surface's, to which the depth-normal term (Eq. 3) binds it.
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
        let sum = Vec3::from_slice(&normal.data[3 * i..]);
        let g_n = sum.try_normalize().map_or(Vec3::ZERO, |unit| {
            let along = facing_normal_vjp(unit, point.view, g.normal);
            (along - unit * unit.dot(along)) / sum.length()
        });
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
