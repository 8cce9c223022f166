//! Shading points of a G-buffer.

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_light::{Material, facing_normal};
use comgs_raster::Frame;
use glam::Vec3;

/// Weight of a pixel from which on it has a surface to shade; below there is no depth to speak of.
pub const MIN_WEIGHT: f32 = 0.05;

/// A surface point that is shaded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// World position.
    pub position: Vec3,
    /// Unit shading normal, world.
    pub normal: Vec3,
    /// Unit direction towards the eye, world.
    pub view: Vec3,
    /// Surface.
    pub material: Material,
}

/// The points of a G-buffer with depth, normals and material, row by row, with their pixels: one where the weight is
/// above [`MIN_WEIGHT`] and there is a normal. Depth (unbiased, ComGS § 3.1) and material are the planes over the
/// weight; `normals` are those of the surface ([`comgs_raster::surface_normals`]), turned to the eye
/// ([`facing_normal`]).
#[must_use]
pub fn points(frame: &Frame, camera: &Camera, normals: Option<&Image>) -> Vec<(u32, Point)> {
    let (Some(depth), Some(normal), Some(material)) = (&frame.depth, normals, &frame.material) else {
        return Vec::new();
    };
    let width = frame.weight.width;
    let mut out = Vec::new();
    for (i, &weight) in frame.weight.data.iter().enumerate() {
        if !(weight > MIN_WEIGHT) {
            continue;
        }
        let Some(normal) = Vec3::from_slice(&normal.data[3 * i..]).try_normalize() else { continue };
        let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let mean = |c: usize| material.data[5 * i + c] / weight;
        let material =
            Material { albedo: Vec3::new(mean(0), mean(1), mean(2)), roughness: mean(3), metallic: mean(4) };
        let position = camera.unproject(x, y, f64::from(depth.data[i] / weight)).as_vec3();
        let view = -camera.ray_world(x, y).normalize().as_vec3();
        let normal = facing_normal(normal, view);
        out.push((i as u32, Point { position, normal, view, material }));
    }
    out
}
