//! Cameras around an object.

use comgs_compose::objects::extent;
use comgs_geom::Camera;
use comgs_scene::Asset;
use glam::DVec3;

/// Horizontal field of view, radians: 30°, as the test views of the SynCom data.
const FIELD_OF_VIEW: f64 = std::f64::consts::PI / 6.0;
/// Height of the cameras above the object's middle, radians: 20°.
const ELEVATION: f64 = std::f64::consts::PI / 9.0;
/// Room around the object's bounding sphere, as a factor on the distance.
const MARGIN: f64 = 1.05;

/// `count` cameras on a circle around an object, evenly, counter-clockwise seen from above, that all hold its body;
/// `None` when nothing of it is visible. Named by number.
#[must_use]
pub fn turntable(asset: &Asset, count: usize, [width, height]: [usize; 2]) -> Option<Vec<Camera>> {
    let up = DVec3::from_array(asset.record.up);
    let extent = extent(&asset.surfels, up)?;
    let world_from_upright = extent.upright_from_object.inverse();
    let centre = world_from_upright * (0.5 * (extent.low + extent.high));
    let radius = 0.5 * (extent.high - extent.low).length();
    // The narrower side of the picture decides.
    let narrow = width.min(height) as f64 / width as f64;
    let half = (narrow * (0.5 * FIELD_OF_VIEW).tan()).atan();
    let distance = MARGIN * radius / half.sin();
    let camera = |i: usize| {
        let azimuth = std::f64::consts::TAU * i as f64 / count as f64;
        let level = ELEVATION.cos();
        let offset = DVec3::new(level * azimuth.cos(), level * azimuth.sin(), ELEVATION.sin());
        let eye = centre + distance * (world_from_upright * offset);
        Camera::look_at(&format!("{i:05}"), width, height, FIELD_OF_VIEW, eye, centre, up)
    };
    Some((0..count).map(camera).collect())
}
