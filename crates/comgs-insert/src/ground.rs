//! The camera above the ground: from what is known of the ground to a world whose plane z = 0 it is.

use comgs_geom::Camera;
use glam::{DAffine3, DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What is known of the ground. Camera space is OpenCV's: x right, y down, z forward; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ground {
    /// The plane `n · p + d = 0` in camera space, n pointing up (towards the camera), d > 0 the camera's height.
    Plane {
        /// Its normal, of any length.
        normal: [f64; 3],
        /// The camera's height above it, for a normal of unit length.
        distance: f64,
    },
    /// Where the horizon crosses the image's middle column, for a camera without roll at a height.
    Horizon {
        /// Pixels from the top; may lie outside the image.
        row: f64,
        /// The camera's height.
        height: f64,
    },
    /// Three pixels of the ground, each with its depth (distance along the optical axis), in any order.
    Points([[f64; 3]; 3]),
    /// A level camera at a height: the horizon through the principal point. A guess, and reported as one.
    Level {
        /// The camera's height.
        height: f64,
    },
}

/// Why the ground is none.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum GroundError {
    /// Not a plane.
    #[error("the ground plane: expected {expected}, got {got}")]
    Plane {
        /// What is needed.
        expected: &'static str,
        /// What there is.
        got: String,
    },
    /// A pixel that does not see the ground.
    #[error(
        "pixel ({x}, {y}) does not look at the ground: the horizon is at row {horizon:.1} of that column"
    )]
    AboveHorizon {
        /// From the left.
        x: f64,
        /// From the top.
        y: f64,
        /// Where the horizon crosses its column; NaN where it does not.
        horizon: f64,
    },
}

/// Pose of a camera above the plane z = 0: z is the plane's normal, x the direction of sight along the plane, and the
/// origin lies under the camera. `intrinsics` gives focal lengths and principal point; its pose is ignored.
///
/// # Errors
/// [`GroundError::Plane`].
pub fn above(intrinsics: &Camera, ground: &Ground) -> Result<Camera, GroundError> {
    let plane = |expected, got: String| GroundError::Plane { expected, got };
    let (normal, height) = match *ground {
        Ground::Plane { normal, distance } => {
            let n = DVec3::from_array(normal);
            if !(n.is_finite() && n.length() > 1e-9) {
                return Err(plane("a normal of some length", format!("{normal:?}")));
            }
            (n.normalize(), distance / n.length())
        }
        Ground::Horizon { row, height } => (horizon_normal(intrinsics, row), height),
        Ground::Level { height } => (DVec3::NEG_Y, height),
        Ground::Points(points) => {
            let [a, b, c] = points.map(|[x, y, depth]| intrinsics.ray_camera(x, y) * depth);
            if points.iter().any(|p| !(p[2] > 0.0)) {
                return Err(plane("three positive depths", format!("{points:?}")));
            }
            let n = (b - a).cross(c - a);
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            if !(n.length() > 1e-6 * longest * longest) {
                return Err(plane("three points that are not on one line", format!("{points:?}")));
            }
            let n = n.normalize();
            let n = if n.dot(a) > 0.0 { -n } else { n };
            (n, -n.dot(a))
        }
    };
    if !(height > 0.0 && height.is_finite() && normal.is_finite()) {
        return Err(plane("a camera above it (a positive height)", format!("{height}")));
    }
    let forward = DVec3::Z - normal * normal.z;
    // Straight down, the image's upper edge is ahead.
    let ahead = if forward.length() > 1e-6 { forward } else { DVec3::NEG_Y - normal * -normal.y };
    let x = ahead.normalize();
    let y = normal.cross(x);
    // Rows of world-from-camera are the world's axes in camera space.
    let rotation = DMat3::from_cols(x, y, normal).transpose();
    let pose = DAffine3::from_mat3_translation(rotation, DVec3::new(0.0, 0.0, height));
    Ok(Camera { world_from_camera: pose, ..intrinsics.clone() })
}

/// Normal of the plane whose horizon is level and crosses the middle column at `row`.
fn horizon_normal(camera: &Camera, row: f64) -> DVec3 {
    DVec3::new(0.0, -1.0, (row - camera.cy) / camera.fy).normalize()
}

/// The point of the ground that a pixel position shows.
///
/// # Errors
/// [`GroundError::AboveHorizon`].
pub fn point_at(camera: &Camera, x: f64, y: f64) -> Result<DVec2, GroundError> {
    let ray = camera.ray_world(x, y);
    let height = camera.centre().z;
    if !(ray.z < -1e-9) {
        return Err(GroundError::AboveHorizon { x, y, horizon: horizon_row(camera, x) });
    }
    Ok((camera.centre() - ray * (height / ray.z)).truncate())
}

/// Row at which the horizon crosses a column; NaN where it does not.
#[must_use]
pub fn horizon_row(camera: &Camera, x: f64) -> f64 {
    // Rays change linearly down a column.
    let (top, next) = (camera.ray_world(x, 0.0).z, camera.ray_world(x, 1.0).z);
    if next == top { f64::NAN } else { top / (top - next) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intrinsics() -> Camera {
        Camera::look_at("photo", 320, 240, 1.0, DVec3::ZERO, DVec3::X, DVec3::Z)
    }

    /// Goal: a camera of known pose is found again from its plane, its horizon, and three of its ground pixels.
    #[test]
    fn four_ways_to_the_same_pose() {
        let eye = DVec3::new(0.0, 0.0, 1.7);
        let truth = Camera::look_at("photo", 320, 240, 1.0, eye, DVec3::new(4.0, 0.0, 0.2), DVec3::Z);
        let into = truth.camera_from_world();
        let normal = into.transform_vector3(DVec3::Z) * 2.0;
        let pixels = [DVec2::new(2.0, 0.5), DVec2::new(5.0, -1.0), DVec2::new(3.0, 1.5)].map(|p| {
            let (pixel, depth) = truth.project(p.extend(0.0)).unwrap();
            [pixel.x, pixel.y, depth]
        });
        let ways = [
            Ground::Plane { normal: normal.to_array(), distance: 3.4 },
            Ground::Horizon { row: horizon_row(&truth, 160.0), height: 1.7 },
            Ground::Points(pixels),
        ];
        for way in ways {
            let found = above(&intrinsics(), &way).unwrap();
            let (a, b) = (found.world_from_camera, truth.world_from_camera);
            assert!((a.translation - b.translation).length() < 1e-9, "{way:?}");
            for k in 0..3 {
                assert!((a.matrix3.col(k) - b.matrix3.col(k)).length() < 1e-9, "{way:?}");
            }
        }
        let level = above(&intrinsics(), &Ground::Level { height: 2.0 }).unwrap();
        assert!((level.forward() - DVec3::X).length() < 1e-12);
        assert!((horizon_row(&level, 10.0) - 120.0).abs() < 1e-9);
    }

    /// Goal: pixels of ground points lead back to them; the sky does not, and says where the horizon is.
    #[test]
    fn pixels_on_the_ground() {
        let camera = above(&intrinsics(), &Ground::Horizon { row: 90.0, height: 1.5 }).unwrap();
        let (pixel, _) = camera.project(DVec3::new(4.0, 1.0, 0.0)).unwrap();
        let found = point_at(&camera, pixel.x, pixel.y).unwrap();
        assert!((found - DVec2::new(4.0, 1.0)).length() < 1e-9);
        let error = point_at(&camera, 160.0, 60.0).unwrap_err().to_string();
        assert!(error.contains("row 90.0"), "{error}");
    }

    /// Goal: planes that are none are refused in words.
    #[test]
    fn no_ground() {
        let bad = [
            Ground::Plane { normal: [0.0; 3], distance: 1.0 },
            Ground::Plane { normal: [0.0, f64::NAN, 0.0], distance: 1.0 },
            Ground::Plane { normal: [0.0, -1.0, 0.0], distance: -1.0 },
            Ground::Horizon { row: f64::NAN, height: 1.0 },
            Ground::Level { height: 0.0 },
            Ground::Points([[10.0, 200.0, 3.0]; 3]),
            Ground::Points([[10.0, 200.0, 3.0], [50.0, 200.0, -3.0], [10.0, 230.0, 2.0]]),
        ];
        for ground in bad {
            assert!(matches!(above(&intrinsics(), &ground), Err(GroundError::Plane { .. })), "{ground:?}");
        }
    }
}
