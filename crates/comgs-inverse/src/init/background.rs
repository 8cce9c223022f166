//! A far shell of surfels behind everything, so that sky and what no match was found for have something to become.

use super::SurfacePoint;
use crate::view::{Rig, TrainView};
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;

/// Points on a sphere of `radius` rig distances around the focus, where at least one view sees them; colours are the mean
/// of the views that do. About `count` for the whole sphere.
#[must_use]
pub fn shell(views: &[TrainView], rig: &Rig, radius: f32, count: usize) -> Vec<SurfacePoint> {
    let small: Vec<(comgs_geom::Camera, Image)> = views
        .par_iter()
        .map(|v| {
            let w = v.camera.width.min(64);
            let h = (v.camera.height * w / v.camera.width).max(1);
            (v.camera.resized(w, h), v.premultiplied().resized(w, h))
        })
        .collect();
    let focus = rig.focus.as_vec3();
    let distance = radius * rig.distance as f32;
    let spacing = distance * (4.0 * std::f32::consts::PI / count.max(1) as f32).sqrt();
    (0..count)
        .into_par_iter()
        .filter_map(|i| {
            // Fibonacci lattice.
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let r = (1.0 - z * z).max(0.0).sqrt();
            let a = i as f32 * 2.399_963_2;
            let direction = Vec3::new(r * a.cos(), r * a.sin(), z);
            let position = focus + direction * distance;
            let (mut sum, mut seen) = (Vec3::ZERO, 0.0);
            for (camera, image) in &small {
                let Some((p, _)) = camera.project(position.as_dvec3()) else { continue };
                if p.x >= 0.0 && p.y >= 0.0 && p.x < camera.width as f64 && p.y < camera.height as f64 {
                    sum += Vec3::from_array(image.rgb(p.x as usize, p.y as usize));
                    seen += 1.0;
                }
            }
            (seen > 0.0).then(|| SurfacePoint { position, normal: -direction, radiance: sum / seen, spacing })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Camera;
    use glam::DVec3;

    /// Goal: only what a camera sees is filled, with the colour it sees, facing inwards.
    #[test]
    fn shell_is_where_cameras_look() {
        let views: Vec<TrainView> = [-0.2, 0.2]
            .iter()
            .map(|&y| {
                let eye = DVec3::new(-1.0, y, 0.0);
                let camera = Camera::look_at("a", 40, 30, 0.9, eye, DVec3::ZERO, DVec3::Z);
                TrainView {
                    camera,
                    color: Image::filled(40, 30, 3, 0.25),
                    mask: None,
                    valid: None,
                    hdr: false,
                }
            })
            .collect();
        let rig = Rig::new(&views.iter().map(|v| &v.camera).collect::<Vec<_>>()).unwrap();
        let points = shell(&views, &rig, 8.0, 2000);
        assert!(points.len() > 20 && points.len() < 400, "{}", points.len());
        for p in points {
            assert!(p.position.x > 0.0 && p.normal.x < 0.0);
            assert!((p.radiance.x - 0.25).abs() < 1e-4);
        }
    }
}
