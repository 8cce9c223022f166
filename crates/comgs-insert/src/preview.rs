//! The ground as a grid over the photo, with the object's footprint: to see before anything is optimised whether camera and
//! plane are right.

use crate::object::Object;
use comgs_geom::Camera;
use comgs_image::Image;
use glam::Vec3;

/// Colours, linear.
const GRID: Vec3 = Vec3::new(0.05, 0.6, 0.9);
const AXIS: Vec3 = Vec3::new(0.9, 0.15, 0.05);
const FOOTPRINT: Vec3 = Vec3::new(0.95, 0.7, 0.05);

/// Lines across the object's footprint.
const LINES: f64 = 4.0;

/// Width of a line in pixels.
const WIDTH: f64 = 1.2;

/// The photo with lines `spacing` apart on the plane z = 0, the lines through the point under the object's centre in another
/// colour, the object's outline filled lightly, and the box that it stands on.
#[must_use]
pub fn preview(photo: &Image, camera: &Camera, object: &Object) -> Image {
    let spacing = spacing(object);
    let mut out = photo.clone();
    let eye = camera.centre();
    let ground = |x: f64, y: f64| {
        let ray = camera.ray_world(x, y);
        (ray.z < -1e-9).then(|| eye - ray * (eye.z / ray.z))
    };
    let (low, high) = object.bounds;
    for y in 0..camera.height {
        for x in 0..camera.width {
            let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
            let pixel = out.pixel_mut(x, y);
            let mut paint = |color: Vec3, alpha: f64| {
                for c in 0..3 {
                    pixel[c] += alpha.clamp(0.0, 1.0) as f32 * (color[c] - pixel[c]);
                }
            };
            if let (Some(p), Some(right), Some(down)) =
                (ground(px, py), ground(px + 1.0, py), ground(px, py + 1.0))
            {
                for axis in 0..2 {
                    // What one pixel spans of this coordinate; where lines are closer than a few pixels they fade.
                    let span = (right[axis] - p[axis]).abs() + (down[axis] - p[axis]).abs();
                    let from = p[axis] - f64::from(object.centre[axis]);
                    let off = (from / spacing - (from / spacing).round()).abs() * spacing;
                    let fade = 1.0 - 4.0 * span / spacing;
                    let line = WIDTH - off / span.max(1e-12);
                    let middle = from.abs() < 0.5 * spacing;
                    paint(if middle { AXIS } else { GRID }, 0.8 * line.min(fade));
                }
                let inside = (f64::from(low.x)..f64::from(high.x)).contains(&p.x)
                    && (f64::from(low.y)..f64::from(high.y)).contains(&p.y);
                if inside {
                    paint(FOOTPRINT, 0.35);
                }
            }
            let direction = camera.ray_world(px, py).normalize().as_vec3();
            if object.may_meet(eye.as_vec3(), direction, 0.0)
                && let Some(surface) = object.surface(eye.as_vec3(), direction)
            {
                let shade = 0.25 + 0.5 * surface.normal.dot(-direction).max(0.0);
                paint(Vec3::splat(shade), 0.75 * f64::from(surface.coverage));
            }
        }
    }
    out
}

/// Distance of the lines in metres: a round number (1, 2 or 5 times a power of ten) near a quarter of the footprint, and so
/// many to each side.
#[must_use]
pub fn spacing(object: &Object) -> f64 {
    let (low, high) = object.bounds;
    let wanted = f64::from((high - low).truncate().max_element()) / LINES;
    let power = 10f64.powf(wanted.max(1e-9).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0];
    power * steps.into_iter().find(|s| s * power >= wanted).unwrap_or(10.0)
}
