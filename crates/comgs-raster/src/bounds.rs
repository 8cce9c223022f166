//! Which tiles a surfel can touch: the exact bounds of its cut-off ellipse on the screen.

use crate::config::RasterConfig;
use crate::project::{CameraSurfel, Projected, ScreenCamera};
use glam::Vec3;

/// Tiles are `TILE × TILE` pixels. 8 beats 16 here: a tile's accumulators stay in the first-level cache and
/// fewer pixels are tested in vain.
pub const TILE: usize = 8;

/// Slack in pixels added to every bound, for rounding.
const PAD: f32 = 0.02;

/// The image of the cut-off disc: an ellipse, or anything inside a rectangle.
#[derive(Clone, Copy, Debug)]
enum Shape {
    /// Centre and the entries xx, xy, yy of the shape matrix Σ: the ellipse is (x − c)ᵀ Σ⁻¹ (x − c) ≤ 1.
    Ellipse { centre: [f32; 2], xx: f32, xy: f32, yy: f32 },
    /// x_min, y_min, x_max, y_max.
    Rectangle([f32; 4]),
}

/// Calls `emit(tile)` for each tile (row-major index) that the surfel can touch, and returns its pixel rows.
/// `None` when there are none.
pub fn cover(
    camera: &ScreenCamera,
    config: &RasterConfig,
    projected: &Projected,
    geometry: &CameraSurfel,
    emit: &mut impl FnMut(u32),
) -> Option<[u16; 2]> {
    let shape = shape(camera, config, projected, geometry)?;
    // Radius of the low-pass disc, which the ellipse's centre is in only approximately.
    let radius = if projected.low_pass > 0.0 { (projected.cut / projected.low_pass).sqrt() } else { -1.0 };
    let [rx, ry] = projected.reference;
    let (mut x_min, mut y_min, mut x_max, mut y_max) = match shape {
        Shape::Rectangle([a, b, c, d]) => (a, b, c, d),
        Shape::Ellipse { centre, xx, yy, .. } => {
            let (hx, hy) = (xx.sqrt(), yy.sqrt());
            (centre[0] - hx, centre[1] - hy, centre[0] + hx, centre[1] + hy)
        }
    };
    if radius >= 0.0 {
        x_min = x_min.min(rx - radius);
        x_max = x_max.max(rx + radius);
        y_min = y_min.min(ry - radius);
        y_max = y_max.max(ry + radius);
    }
    let (column_first, column_last) = pixel_range(x_min, x_max, camera.width)?;
    let (row_first, row_last) = pixel_range(y_min, y_max, camera.height)?;
    let tiles_x = camera.width.div_ceil(TILE);
    let (tx0, tx1) = (column_first / TILE, column_last / TILE);
    let (ty0, ty1) = (row_first / TILE, row_last / TILE);
    let narrow = tx0 == tx1 || ty0 == ty1;
    for ty in ty0..=ty1 {
        let (mut first, mut last) = (tx0, tx1);
        if let (Shape::Ellipse { centre, xx, xy, yy }, false) = (shape, narrow) {
            let (top, bottom) = ((ty * TILE) as f32 + 0.5, (ty * TILE + TILE) as f32 - 0.5);
            let mut span = ellipse_span(centre, xx, xy, yy, top - PAD, bottom + PAD);
            if radius >= 0.0 {
                let dy = (top - ry).max(ry - bottom).max(0.0);
                if dy <= radius + PAD {
                    let half = (radius * radius - dy * dy).max(0.0).sqrt() + PAD;
                    span = Some(match span {
                        Some((a, b)) => (a.min(rx - half), b.max(rx + half)),
                        None => (rx - half, rx + half),
                    });
                }
            }
            let Some((a, b)) = span else { continue };
            let Some((a, b)) = pixel_range(a, b, camera.width) else { continue };
            first = a / TILE;
            last = b / TILE;
        }
        for tx in first..=last {
            emit((ty * tiles_x + tx) as u32);
        }
    }
    Some([row_first as u16, row_last as u16])
}

/// First and last pixel whose centre lies in `[low, high]` (with slack), clipped to the image.
fn pixel_range(low: f32, high: f32, size: usize) -> Option<(usize, usize)> {
    let first = (low - 0.5 - PAD).ceil().max(0.0);
    let last = (high - 0.5 + PAD).floor().min(size as f32 - 1.0);
    (first <= last).then_some((first as usize, last as usize))
}

/// Range of x that an ellipse has within the rows `y_low..=y_high`.
fn ellipse_span(c: [f32; 2], xx: f32, xy: f32, yy: f32, y_low: f32, y_high: f32) -> Option<(f32, f32)> {
    let half_height = yy.sqrt();
    let (low, high) = ((y_low - c[1]).max(-half_height), (y_high - c[1]).min(half_height));
    if !(low <= high) {
        return None;
    }
    let half_width = xx.sqrt();
    let slope = if yy > 0.0 { xy / yy } else { 0.0 };
    let rest = (xx - xy * slope).max(0.0);
    let edge = |t: f32| (rest * (1.0 - t * t / yy.max(1e-30)).max(0.0)).sqrt();
    // The rightmost point of the ellipse is at t = xy/√xx, the leftmost opposite.
    let t_right = if half_width > 0.0 { xy / half_width } else { 0.0 };
    let right = if (low..=high).contains(&t_right) {
        half_width
    } else {
        (slope * low + edge(low)).max(slope * high + edge(high))
    };
    let left = if (low..=high).contains(&-t_right) {
        -half_width
    } else {
        (slope * low - edge(low)).min(slope * high - edge(high))
    };
    Some((c[0] + left - PAD, c[0] + right + PAD))
}

fn shape(
    camera: &ScreenCamera,
    config: &RasterConfig,
    projected: &Projected,
    geometry: &CameraSurfel,
) -> Option<Shape> {
    let CameraSurfel { p, frame, scale } = *geometry;
    let cut = projected.cut.sqrt();
    let e1 = frame.x_axis * (cut * scale[0]);
    let e2 = frame.y_axis * (cut * scale[1]);
    let reach = e1.z.hypot(e2.z);
    if !(p.z + reach >= config.near) {
        return None;
    }
    // Wholly in front with some margin: the image is an ellipse. Otherwise the usual bounding formula fails (for a
    // disc that crosses the camera plane it returns the gap between two hyperbola branches), so the
    // disc's bounding square is clipped at the near plane instead.
    if p.z - reach > config.near.max(1e-3 * p.z) {
        let denominator = p.z * p.z - reach * reach;
        let f = [e1.x * p.z - e1.z * p.x, e2.x * p.z - e2.z * p.x];
        let g = [e1.y * p.z - e1.z * p.y, e2.y * p.z - e2.z * p.y];
        let (mx, my) = (e1.x * e2.z - e1.z * e2.x, e1.y * e2.z - e1.z * e2.y);
        let scale_x = camera.focal[0] / denominator;
        let scale_y = camera.focal[1] / denominator;
        let xx = (f[0] * f[0] + f[1] * f[1] - mx * mx).max(0.0) * scale_x * scale_x;
        let yy = (g[0] * g[0] + g[1] * g[1] - my * my).max(0.0) * scale_y * scale_y;
        let xy = (f[0] * g[0] + f[1] * g[1] - mx * my) * scale_x * scale_y;
        let cx = camera.principal[0] + scale_x * (p.x * p.z - e1.x * e1.z - e2.x * e2.z);
        let cy = camera.principal[1] + scale_y * (p.y * p.z - e1.y * e1.z - e2.y * e2.z);
        if [xx, yy, xy, cx, cy].iter().all(|v| v.is_finite()) {
            return Some(Shape::Ellipse { centre: [cx, cy], xx, xy, yy });
        }
    }
    Some(Shape::Rectangle(clipped_square(camera, config.near, p, e1, e2)))
}

/// Screen bounds of the part of the square p ± e1 ± e2 that lies beyond the near plane.
fn clipped_square(camera: &ScreenCamera, near: f32, p: Vec3, e1: Vec3, e2: Vec3) -> [f32; 4] {
    let corners = [p + e1 + e2, p + e1 - e2, p - e1 - e2, p - e1 + e2];
    let mut bounds = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];
    let mut add = |q: Vec3| {
        let x = camera.principal[0] + camera.focal[0] * q.x / q.z;
        let y = camera.principal[1] + camera.focal[1] * q.y / q.z;
        bounds[0] = bounds[0].min(x);
        bounds[1] = bounds[1].min(y);
        bounds[2] = bounds[2].max(x);
        bounds[3] = bounds[3].max(y);
        // Overflow leaves NaN, which min and max skip: then the whole image is the bound.
        x.is_finite() && y.is_finite()
    };
    let mut finite = true;
    for i in 0..4 {
        let (a, b) = (corners[i], corners[(i + 1) % 4]);
        if a.z >= near {
            finite &= add(a);
        }
        if (a.z >= near) != (b.z >= near) {
            let t = (near - a.z) / (b.z - a.z);
            let mut q = a + (b - a) * t;
            q.z = near;
            finite &= add(q);
        }
    }
    if finite { bounds } else { [0.0, 0.0, camera.width as f32, camera.height as f32] }
}
