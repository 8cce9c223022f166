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
    /// Four pixels that are the corners of a rectangle of the ground, in order around it: a rug, a tile, a sheet of paper, a
    /// doorstep. Its two pairs of parallel sides meet the horizon in two points, and those are the plane's direction.
    Rectangle {
        /// The corners.
        corners: [[f64; 2]; 4],
        /// How large it is, or how high the camera.
        size: Size,
    },
    /// A level camera at a height: the horizon through the principal point. A guess, and reported as one.
    Level {
        /// The camera's height.
        height: f64,
    },
}

/// What gives a rectangle of the ground its size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Size {
    /// Length of the side from the first to the second corner.
    Side(f64),
    /// The camera's height.
    Height(f64),
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
        Ground::Rectangle { corners, size } => {
            let found = rectangle(intrinsics, &corners)?;
            let height = match size {
                Size::Height(height) => height,
                // The corners of a plane at height 1 are as much too large as that is too high.
                Size::Side(side) => side / found.side,
            };
            (found.normal, height)
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

/// What four corners tell of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Normal of its plane in camera space, towards the camera.
    pub normal: DVec3,
    /// First side over the camera's height.
    pub side: f64,
    /// Second side over the camera's height.
    pub other: f64,
    /// Angle between the sides in degrees: 90 where the field of view is right and the corners are a rectangle's.
    pub angle_deg: f64,
}

/// The plane of four pixels that are the corners of a rectangle, in order: with `r` the corners' directions, the sides run along
/// `(r₀ × r₁) × (r₂ × r₃)` and `(r₁ × r₂) × (r₃ × r₀)`, also where they are parallel in the picture.
///
/// # Errors
/// [`GroundError::Plane`] where two corners are one, three lie on a line, or they are not in order around.
pub fn rectangle(intrinsics: &Camera, corners: &[[f64; 2]; 4]) -> Result<Rectangle, GroundError> {
    let wrong = |expected| GroundError::Plane { expected, got: format!("{corners:?}") };
    if corners.iter().flatten().any(|v| !v.is_finite()) {
        return Err(wrong("four corners with finite positions"));
    }
    let r = corners.map(|[x, y]| intrinsics.ray_camera(x, y));
    // Convex, and the same way around at every corner.
    let bends: [f64; 4] = std::array::from_fn(|k| {
        let [a, b, c] = [k, k + 1, k + 2].map(|i| DVec2::from_array(corners[i % 4]));
        (b - a).perp_dot(c - b)
    });
    if !(bends.iter().all(|b| *b > 1e-6) || bends.iter().all(|b| *b < -1e-6)) {
        return Err(wrong("the corners of a rectangle in order around it, no three on a line"));
    }
    let line = |a: usize, b: usize| r[a].cross(r[b]).normalize();
    let along = |a: DVec3, b: DVec3| a.cross(b).try_normalize();
    let sides = (along(line(0, 1), line(2, 3)), along(line(1, 2), line(3, 0)));
    let (Some(first), Some(second)) = sides else {
        return Err(wrong("corners that are apart"));
    };
    let Some(n) = first.cross(second).try_normalize() else {
        return Err(wrong("sides of two directions"));
    };
    let n = if n.dot(r[0]) > 0.0 { -n } else { n };
    if !r.iter().all(|r| n.dot(*r) < -1e-9) {
        return Err(wrong("four corners on one side of their horizon"));
    }
    let p = r.map(|r| r / -n.dot(r));
    let angle = (p[1] - p[0]).angle_between(p[3] - p[0]);
    Ok(Rectangle {
        normal: n,
        side: p[0].distance(p[1]),
        other: p[1].distance(p[2]),
        angle_deg: angle.to_degrees(),
    })
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

    /// Goal: the corners of a rectangle of known size give back the camera's pose, also where two sides are parallel in the picture;
    /// a wrong field of view shows in their angle, and a square that is crossed, flat or above the horizon is refused.
    #[test]
    fn a_rectangle_of_the_ground() {
        let eye = DVec3::new(0.0, 0.0, 1.4);
        for (roll, turn) in [(0.0, 0.0f64), (0.12, 0.5), (-0.2, 1.1)] {
            let mut truth =
                Camera::look_at("photo", 320, 240, 1.0, eye, DVec3::new(4.0, 0.0, -0.3), DVec3::Z);
            truth.world_from_camera.matrix3 *= DMat3::from_rotation_z(roll);
            let (s, c) = turn.sin_cos();
            let corner = |a: f64, b: f64| DVec3::new(4.0 + c * a - s * b, s * a + c * b, 0.0);
            let corners = [corner(-0.6, -0.5), corner(0.6, -0.5), corner(0.6, 0.5), corner(-0.6, 0.5)]
                .map(|p| truth.project(p).unwrap().0.to_array());
            let found = rectangle(&intrinsics(), &corners).unwrap();
            assert!((found.angle_deg - 90.0).abs() < 1e-6, "{found:?}");
            let known = Ground::Rectangle { corners, size: Size::Side(1.2) };
            let camera = above(&intrinsics(), &known).unwrap();
            assert!((camera.centre().z - 1.4).abs() < 1e-9);
            let up = truth.camera_from_world().transform_vector3(DVec3::Z);
            assert!(found.normal.distance(up) < 1e-9);
            let high = Ground::Rectangle { corners, size: Size::Height(2.0) };
            assert!((above(&intrinsics(), &high).unwrap().centre().z - 2.0).abs() < 1e-9);
            let [a, b, c, d] = corners;
            assert!(rectangle(&intrinsics(), &[a, c, b, d]).is_err());
            assert!(rectangle(&intrinsics(), &[a, a, c, d]).is_err());
        }
        let wide = Camera::look_at("photo", 320, 240, 1.5, DVec3::ZERO, DVec3::X, DVec3::Z);
        let truth = Camera::look_at("photo", 320, 240, 1.0, eye, DVec3::new(4.0, 0.0, -0.3), DVec3::Z);
        let corners = [[4.0, -0.7], [4.8, 0.0], [4.0, 0.7], [3.2, 0.0]]
            .map(|[x, y]| truth.project(DVec3::new(x, y, 0.0)).unwrap().0.to_array());
        assert!((rectangle(&wide, &corners).unwrap().angle_deg - 90.0).abs() > 10.0);
        let ceiling = Ground::Rectangle { corners: [[0.0; 2]; 4], size: Size::Height(1.0) };
        assert!(matches!(above(&intrinsics(), &ceiling), Err(GroundError::Plane { .. })));
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
