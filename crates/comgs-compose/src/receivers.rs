//! Points of the scene that receive light, from the planes of a rendering.

use comgs_geom::Camera;
use comgs_image::Image;
use glam::Vec3;

/// What the camera sees of the scene, as points that receive light.
#[derive(Clone, Debug)]
pub struct Receivers {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// World points, one a pixel; the camera's centre where there is no surface.
    pub points: Vec<Vec3>,
    /// Unit world normals facing the camera; zero where there is no surface.
    pub normals: Vec<Vec3>,
}

impl Receivers {
    /// Unprojects a scene's planes.
    ///
    /// * `depth`: unbiased z-depth, one channel, 0 where undefined
    /// * `normal`: accumulated world normals, three channels, any length
    ///
    /// A pixel whose accumulated normal is too short to have a direction takes the direction to the camera.
    ///
    /// # Panics
    /// When the planes differ from the camera in size.
    #[must_use]
    pub fn from_planes(camera: &Camera, depth: &Image, normal: &Image) -> Self {
        let (width, height) = (camera.width, camera.height);
        assert_eq!((depth.width, depth.height), (width, height), "depth plane and camera differ in size");
        assert_eq!((normal.width, normal.height), (width, height), "normal plane and camera differ in size");
        let centre = camera.centre().as_vec3();
        let mut points = vec![centre; width * height];
        let mut normals = vec![Vec3::ZERO; width * height];
        for y in 0..height {
            for x in 0..width {
                let d = depth.pixel(x, y)[0];
                if !(d > 0.0) || !d.is_finite() {
                    continue;
                }
                let i = y * width + x;
                let p = camera.unproject(x as f64 + 0.5, y as f64 + 0.5, f64::from(d));
                points[i] = p.as_vec3();
                let to_camera = (camera.centre() - p).normalize_or_zero().as_vec3();
                let n = Vec3::from_slice(normal.pixel(x, y));
                let n = if n.is_finite() && n.length() > 1e-3 { n.normalize() } else { to_camera };
                normals[i] = if n.dot(to_camera) < 0.0 { -n } else { n };
            }
        }
        Self { width, height, points, normals }
    }

    /// Whether pixel `i` shows a surface.
    #[must_use]
    pub fn is_surface(&self, i: usize) -> bool {
        self.normals[i] != Vec3::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: receivers come from depth along the camera's axis, face the camera, and pixels without depth are none.
    #[test]
    fn receivers_unproject_depth() {
        use glam::DVec3;
        let camera = Camera::look_at("a", 8, 6, 1.0, DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y);
        let mut depth = Image::filled(8, 6, 1, 5.0);
        depth.pixel_mut(2, 2)[0] = 0.0;
        let mut normal = Image::zeros(8, 6, 3);
        for p in normal.data.chunks_exact_mut(3) {
            p[2] = -0.4;
        }
        let receivers = Receivers::from_planes(&camera, &depth, &normal);
        assert!(!receivers.is_surface(2 * 8 + 2));
        for i in 0..48 {
            if i != 18 {
                assert!(receivers.points[i].z.abs() < 1e-5, "a plane of constant z-depth is flat");
                assert_eq!(receivers.normals[i], Vec3::Z);
            }
        }
    }
}
