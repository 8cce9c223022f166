//! The pinhole camera that all renderers use. Lens distortion is removed on load.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};

/// Largest accepted image size in pixels (8192×8192): a camera that asks for more is refused before memory is taken.
pub const MAX_PIXELS: usize = 1 << 26;

/// A pinhole camera with a pose.
///
/// The image plane spans `[0, width] × [0, height]` pixels. The principal point may lie anywhere, even outside
/// the image, and `fx ≠ fy` is allowed. Values are f64 at this border; kernels convert to f32 after they
/// have moved the origin near the camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Name of the view; frames are written as `<name>.png`.
    pub name: String,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Focal length along x in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Principal point x in pixels.
    pub cx: f64,
    /// Principal point y in pixels.
    pub cy: f64,
    /// Rigid pose, OpenCV axes: maps camera space to world space.
    pub world_from_camera: DAffine3,
}

impl Camera {
    /// A camera from a Blender/OpenGL camera-to-world matrix (looks along −z, y up), as SynCom and
    /// NeRF files store it.
    #[must_use]
    pub fn flip_opengl_axes(world_from_camera_gl: DAffine3) -> DAffine3 {
        world_from_camera_gl * DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)))
    }

    /// A camera at `eye` that looks at `target`, with `up` pointing up in the image and a horizontal field
    /// of view in radians.
    #[must_use]
    pub fn look_at(
        name: &str,
        width: usize,
        height: usize,
        hfov_rad: f64,
        eye: DVec3,
        target: DVec3,
        up: DVec3,
    ) -> Self {
        let forward = (target - eye).normalize();
        let side = forward.cross(up);
        let right =
            if side.length_squared() > 1e-20 { side.normalize() } else { forward.any_orthonormal_vector() };
        let down = forward.cross(right);
        let f = 0.5 * width as f64 / (0.5 * hfov_rad).tan();
        Self {
            name: name.to_owned(),
            width,
            height,
            fx: f,
            fy: f,
            cx: 0.5 * width as f64,
            cy: 0.5 * height as f64,
            world_from_camera: DAffine3::from_mat3_translation(DMat3::from_cols(right, down, forward), eye),
        }
    }

    /// World to camera. The pose is rigid, so this is its transpose; a general inverse is taken all the same.
    #[must_use]
    pub fn camera_from_world(&self) -> DAffine3 {
        self.world_from_camera.inverse()
    }

    /// The camera's centre in world space.
    #[must_use]
    pub fn centre(&self) -> DVec3 {
        self.world_from_camera.translation
    }

    /// Unit viewing direction (the optical axis) in world space.
    #[must_use]
    pub fn forward(&self) -> DVec3 {
        self.world_from_camera.matrix3.z_axis
    }

    /// Direction in camera space through pixel position `(x, y)`, with z = 1 (not normalised): a point at
    /// z-depth `d` is `d * ray`.
    #[must_use]
    pub fn ray_camera(&self, x: f64, y: f64) -> DVec3 {
        DVec3::new((x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0)
    }

    /// Direction in world space through pixel position `(x, y)`; a point at z-depth `d` is
    /// `centre + d * ray`. Not normalised.
    #[must_use]
    pub fn ray_world(&self, x: f64, y: f64) -> DVec3 {
        self.world_from_camera.transform_vector3(self.ray_camera(x, y))
    }

    /// World point at z-depth `depth` behind pixel position `(x, y)`.
    #[must_use]
    pub fn unproject(&self, x: f64, y: f64, depth: f64) -> DVec3 {
        self.centre() + self.ray_world(x, y) * depth
    }

    /// Pixel position and z-depth of a world point. `None` when the point is not in front of the camera.
    #[must_use]
    pub fn project(&self, p_world: DVec3) -> Option<(DVec2, f64)> {
        let p = self.camera_from_world().transform_point3(p_world);
        if !(p.z > 0.0) {
            return None;
        }
        Some((DVec2::new(self.cx + self.fx * p.x / p.z, self.cy + self.fy * p.y / p.z), p.z))
    }

    /// The same camera with an image of another size: pixels are rescaled, the field of view is kept.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: self.cx * sx,
            cy: self.cy * sy,
            ..self.clone()
        }
    }

    /// Problems that make a camera unusable: zero size or more than [`MAX_PIXELS`], a focal length that is not positive
    /// and finite, a pose that is not a rotation. Empty when the camera is sound.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if self.width == 0 || self.height == 0 {
            problems.push(format!("image size is {}×{}", self.width, self.height));
        } else if self.width.checked_mul(self.height).is_none_or(|n| n > MAX_PIXELS) {
            let (w, h) = (self.width, self.height);
            problems.push(format!("image size is {w}×{h}, more than the limit of {MAX_PIXELS} pixels"));
        }
        for (name, v) in [("fx", self.fx), ("fy", self.fy)] {
            if !(v > 0.0 && v.is_finite()) {
                problems.push(format!("{name} is {v}, expected a positive finite focal length in pixels"));
            }
        }
        for (name, v) in [("cx", self.cx), ("cy", self.cy)] {
            if !v.is_finite() {
                problems.push(format!("{name} is {v}, expected a finite principal point in pixels"));
            }
        }
        if !self.world_from_camera.is_finite() {
            problems.push("pose has non-finite entries".into());
        } else {
            let m = self.world_from_camera.matrix3;
            let det = m.determinant();
            let gram = m.transpose() * m;
            let deviation =
                (gram - DMat3::IDENTITY).to_cols_array().iter().fold(0.0f64, |a, v| a.max(v.abs()));
            if det.abs() < 1e-9 {
                problems.push(format!("pose is not invertible (determinant {det:.3e})"));
            } else if det < 0.0 {
                problems.push("pose mirrors space (negative determinant)".into());
            } else if deviation > 1e-2 {
                problems.push(format!("pose is not rigid (deviation from a rotation {deviation:.3e})"));
            }
        }
        problems
    }

    /// What is legal and hardly meant: a field of view below 1° or above 170° along a side, a principal point more than
    /// a whole image away from the image. Empty for a camera with [`Camera::problems`].
    #[must_use]
    pub fn oddities(&self) -> Vec<String> {
        let mut oddities = Vec::new();
        if !self.problems().is_empty() {
            return oddities;
        }
        let (w, h) = (self.width as f64, self.height as f64);
        for (side, size, f) in [("across", w, self.fx), ("upright", h, self.fy)] {
            let view = 2.0 * (0.5 * size / f).atan().to_degrees();
            if !(1.0..=170.0).contains(&view) {
                oddities
                    .push(format!("the field of view is {view:.2}° {side} (focal length {f} of {size} px)"));
            }
        }
        for (name, size, c) in [("cx", w, self.cx), ("cy", h, self.cy)] {
            if !(-size..=2.0 * size).contains(&c) {
                oddities.push(format!("{name} is {c}, far outside the image of {size} px"));
            }
        }
        oddities
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: projecting an unprojected pixel gives the pixel back, for an off-centre anisotropic camera.
    #[test]
    fn project_inverts_unproject() {
        let mut camera = Camera::look_at(
            "a",
            320,
            200,
            1.1,
            DVec3::new(3.0, -2.0, 1.5),
            DVec3::new(0.1, 0.2, 0.0),
            DVec3::Z,
        );
        camera.fy *= 1.3;
        camera.cx = -20.0;
        for (x, y, d) in [(0.5, 0.5, 0.3), (310.2, 14.0, 7.0), (-50.0, 400.0, 2.0)] {
            let (p, depth) = camera.project(camera.unproject(x, y, d)).unwrap();
            assert!((p - DVec2::new(x, y)).length() < 1e-9, "{p}");
            assert!((depth - d).abs() < 1e-12);
        }
        assert!(camera.problems().is_empty());
    }

    /// Goal: `look_at` puts the target in the image centre and the up vector upwards (smaller y).
    #[test]
    fn look_at_is_upright() {
        let camera = Camera::look_at("a", 64, 48, 1.0, DVec3::new(4.0, 0.0, 2.0), DVec3::ZERO, DVec3::Z);
        let (centre, _) = camera.project(DVec3::ZERO).unwrap();
        assert!((centre - DVec2::new(32.0, 24.0)).length() < 1e-9);
        let (above, _) = camera.project(DVec3::new(0.0, 0.0, 0.5)).unwrap();
        assert!(above.y < centre.y);
        assert!(camera.world_from_camera.matrix3.determinant() > 0.0);
    }

    /// Goal: every class of unusable camera is named.
    #[test]
    fn unusable_cameras_are_named() {
        let good = Camera::look_at("a", 64, 48, 1.0, DVec3::new(4.0, 0.0, 2.0), DVec3::ZERO, DVec3::Z);
        let mut bad = good.clone();
        bad.fx = f64::NAN;
        assert!(bad.problems()[0].contains("fx"));
        bad = good.clone();
        bad.world_from_camera.matrix3.x_axis *= -1.0;
        assert!(bad.problems()[0].contains("mirrors"));
        bad = good.clone();
        bad.world_from_camera.matrix3.x_axis = DVec3::ZERO;
        assert!(bad.problems()[0].contains("invertible"));
        bad = good.clone();
        bad.world_from_camera.translation.x = f64::INFINITY;
        assert!(bad.problems()[0].contains("non-finite"));
        for f in [0.0, -40.0, f64::INFINITY] {
            bad = Camera { fy: f, ..good.clone() };
            assert!(bad.problems()[0].contains("fy"), "{f}");
        }
        for (width, height) in [(0, 4), (8193, 8192), (usize::MAX, 2)] {
            bad = Camera { width, height, ..good.clone() };
            assert!(bad.problems()[0].contains("image size"), "{width}×{height}");
        }
    }

    /// Goal: cameras that nobody means are told; a shifted lens and a crop of a larger image are not.
    #[test]
    fn odd_cameras_are_told() {
        let good = Camera::look_at("a", 64, 48, 1.0, DVec3::new(4.0, 0.0, 2.0), DVec3::ZERO, DVec3::Z);
        assert!(good.problems().is_empty() && good.oddities().is_empty());
        assert!(Camera { cx: -40.0, cy: 90.0, ..good.clone() }.oddities().is_empty());
        for (odd, expected) in [
            (Camera { fx: 1e6, ..good.clone() }, "field of view"),
            (Camera { fy: 0.5, ..good.clone() }, "upright"),
            (Camera { cx: 1e5, ..good.clone() }, "cx"),
            (Camera { cy: -300.0, ..good.clone() }, "cy"),
        ] {
            assert!(odd.problems().is_empty() && odd.oddities()[0].contains(expected), "{odd:?}");
        }
    }
}
