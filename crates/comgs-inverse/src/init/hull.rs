//! The visual hull: surface points of an object from its masks alone.

use super::SurfacePoint;
use crate::view::{Rig, TrainView};
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;

/// A mask with its projection in f32.
struct Silhouette<'a> {
    mask: &'a Image,
    color: &'a Image,
    rotation: glam::Mat3,
    centre: Vec3,
    focal: [f32; 2],
    principal: [f32; 2],
}

impl Silhouette<'_> {
    /// Pixel position of a world point; `None` behind the camera or outside the image.
    fn pixel(&self, p: Vec3) -> Option<(usize, usize)> {
        let q = self.rotation * (p - self.centre);
        if q.z <= 0.0 {
            return None;
        }
        let x = self.principal[0] + self.focal[0] * q.x / q.z;
        let y = self.principal[1] + self.focal[1] * q.y / q.z;
        let inside = x >= 0.0 && y >= 0.0 && x < self.mask.width as f32 && y < self.mask.height as f32;
        inside.then_some((x as usize, y as usize))
    }
}

/// Carves a grid of `resolution`³ cells inside the box by all masks: a cell is kept when at most `misses` of the views
/// that see it have background there.
fn carve(
    silhouettes: &[Silhouette<'_>],
    low: Vec3,
    cell: f32,
    resolution: usize,
    misses: usize,
) -> Vec<bool> {
    let mut grid = vec![false; resolution * resolution * resolution];
    grid.par_chunks_mut(resolution * resolution).enumerate().for_each(|(z, slice)| {
        for y in 0..resolution {
            for x in 0..resolution {
                let p = low + (Vec3::new(x as f32, y as f32, z as f32) + 0.5) * cell;
                let (mut outside, mut seen) = (0, 0);
                for s in silhouettes {
                    if let Some((px, py)) = s.pixel(p) {
                        seen += 1;
                        outside += usize::from(s.mask.data[py * s.mask.width + px] < 0.5);
                        if outside > misses {
                            break;
                        }
                    }
                }
                slice[y * resolution + x] = outside <= misses && seen * 2 > silhouettes.len();
            }
        }
    });
    grid
}

/// Points on the visual hull, about `count` of them; empty when the masks have no common volume.
///
/// The box comes from a first coarse carving around the point the cameras look at, so the object's size need not be known.
#[must_use]
pub fn visual_hull(views: &[TrainView], rig: &Rig, count: usize) -> Vec<SurfacePoint> {
    let premultiplied: Vec<Image> = views.par_iter().map(TrainView::premultiplied).collect();
    let silhouettes: Vec<Silhouette<'_>> = views
        .iter()
        .zip(&premultiplied)
        .filter_map(|(v, color)| {
            Some(Silhouette {
                mask: v.mask.as_ref()?,
                color,
                rotation: v.camera.world_from_camera.matrix3.transpose().as_mat3(),
                centre: v.camera.centre().as_vec3(),
                focal: [v.camera.fx as f32, v.camera.fy as f32],
                principal: [v.camera.cx as f32, v.camera.cy as f32],
            })
        })
        .collect();
    if silhouettes.is_empty() {
        return Vec::new();
    }
    // A few views may have a bad mask.
    let misses = silhouettes.len() / 25;
    let focus = rig.focus.as_vec3();
    let mut half = 0.9 * rig.distance as f32;
    let mut low = focus - half;
    const COARSE: usize = 56;
    for _ in 0..3 {
        let cell = 2.0 * half / COARSE as f32;
        let grid = carve(&silhouettes, low, cell, COARSE, misses);
        let mut bounds: Option<(Vec3, Vec3)> = None;
        for (i, _) in grid.iter().enumerate().filter(|(_, full)| **full) {
            let p =
                Vec3::new((i % COARSE) as f32, (i / COARSE % COARSE) as f32, (i / COARSE / COARSE) as f32);
            bounds = Some(bounds.map_or((p, p), |(l, h)| (l.min(p), h.max(p))));
        }
        let Some((first, last)) = bounds else { return Vec::new() };
        let (near, far) = (low + (first - 1.0) * cell, low + (last + 2.0) * cell);
        let centre = 0.5 * (near + far);
        let tight = 0.5 * (far - near).max_element();
        let settled = tight > 0.6 * half;
        half = tight;
        low = centre - half;
        if settled {
            break;
        }
    }
    // The surface of a compact body crosses about 2.5 resolution² cells of its box.
    let resolution = ((count as f32 / 2.2).sqrt() as usize).clamp(24, 220);
    let cell = 2.0 * half / resolution as f32;
    let grid = carve(&silhouettes, low, cell, resolution, misses);
    surface(&silhouettes, &grid, low, cell, resolution)
}

/// Boundary cells with normals from the smoothed occupancy and colours from the views that face them.
fn surface(
    silhouettes: &[Silhouette<'_>],
    grid: &[bool],
    low: Vec3,
    cell: f32,
    resolution: usize,
) -> Vec<SurfacePoint> {
    let r = resolution as isize;
    let at = |x: isize, y: isize, z: isize| {
        let inside = (0..r).contains(&x) && (0..r).contains(&y) && (0..r).contains(&z);
        inside && grid[((z * r + y) * r + x) as usize]
    };
    (0..grid.len())
        .into_par_iter()
        .filter_map(|i| {
            if !grid[i] {
                return None;
            }
            let (x, y, z) = (i as isize % r, i as isize / r % r, i as isize / r / r);
            let open = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
                .iter()
                .any(|(dx, dy, dz)| !at(x + dx, y + dy, z + dz));
            if !open {
                return None;
            }
            let mut normal = Vec3::ZERO;
            for dz in -2..=2 {
                for dy in -2..=2 {
                    for dx in -2..=2 {
                        if !at(x + dx, y + dy, z + dz) {
                            normal += Vec3::new(dx as f32, dy as f32, dz as f32);
                        }
                    }
                }
            }
            let normal = normal.normalize_or(Vec3::Z);
            let position = low + (Vec3::new(x as f32, y as f32, z as f32) + 0.5) * cell;
            let mut sum = Vec3::ZERO;
            let mut total = 0.0;
            for s in silhouettes {
                let facing = normal.dot((s.centre - position).normalize_or(Vec3::Z));
                if facing < 0.3 {
                    continue;
                }
                if let Some((px, py)) = s.pixel(position) {
                    let weight = facing * facing * s.mask.data[py * s.mask.width + px];
                    sum += weight * Vec3::from_array(s.color.rgb(px, py)).min(Vec3::splat(4.0));
                    total += weight;
                }
            }
            let radiance = if total > 0.0 { sum / total } else { Vec3::splat(0.2) };
            Some(SurfacePoint { position, normal, radiance, spacing: cell })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Camera;
    use glam::DVec3;

    /// Goal: the hull of a sphere seen from all sides is that sphere, with outward normals and its colour, for an object
    /// whose size and place are unknown.
    #[test]
    fn hull_of_a_sphere() {
        let centre = DVec3::new(2.0, -1.0, 0.5);
        let radius = 0.31;
        let views: Vec<TrainView> = (0..26)
            .map(|i| {
                let a = f64::from(i) * 2.399_963;
                let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 26.0;
                let s = (1.0 - z * z).sqrt();
                let eye = centre + 2.5 * DVec3::new(s * a.cos(), s * a.sin(), z);
                let camera = Camera::look_at("a", 120, 120, 0.5, eye, centre, DVec3::Z);
                let mut mask = Image::zeros(120, 120, 1);
                for y in 0..120 {
                    for x in 0..120 {
                        let d = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5).normalize();
                        let to = centre - eye;
                        let miss = (to - d * to.dot(d)).length();
                        mask.data[y * 120 + x] = f32::from(miss < radius);
                    }
                }
                let color = Image::filled(120, 120, 3, 0.7);
                TrainView { camera, color, mask: Some(mask), valid: None, hdr: true }
            })
            .collect();
        let rig = Rig::new(&views.iter().map(|v| &v.camera).collect::<Vec<_>>()).unwrap();
        let points = visual_hull(&views, &rig, 4000);
        assert!((1500..9000).contains(&points.len()), "{}", points.len());
        let mut alignment = 0.0;
        for p in &points {
            let offset = p.position.as_dvec3() - centre;
            assert!((offset.length() - radius).abs() < 0.05, "{}", offset.length());
            alignment += offset.normalize().dot(p.normal.as_dvec3());
            assert!((p.radiance - Vec3::splat(0.7)).length() < 0.1);
        }
        assert!(alignment / points.len() as f64 > 0.97);
    }
}
