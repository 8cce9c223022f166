//! Parallel projections of an object along a direction and against it.

use super::{DEPTH_REACH, FieldDirection, depth_code};
use comgs_surfel::{SurfelCloud, activation::sigmoid};
use glam::{Vec2, Vec3};

/// Response below which a surfel is nothing, and largest opacity of one surfel: the tracer's and the rasteriser's.
const ALPHA_MIN: f32 = 1.0 / 255.0;
const ALPHA_MAX: f32 = 0.99;
/// Opacity from which on a surfel widens the window: a faint floater far out must not.
const WINDOW_OPACITY: f32 = 0.1;
/// Standard deviations of a surfel that the window holds.
const WINDOW_SIGMAS: f32 = 2.5;
/// Area of a disc's projection over its own below which it is seen edge-on and hides nothing.
const EDGE_ON: f32 = 1e-4;

/// A surfel in radii of the object's sphere about its centre.
pub(super) struct Disc {
    centre: Vec3,
    /// One standard deviation along its two axes.
    a: Vec3,
    b: Vec3,
    opacity: f32,
    /// Standard deviations at which its response ends.
    cutoff: f32,
}

/// The surfels that can hide anything.
pub(super) fn discs(cloud: &SurfelCloud, centre: Vec3, radius: f32) -> Vec<Disc> {
    (0..cloud.len())
        .filter_map(|i| {
            let opacity = sigmoid(cloud.opacity_logits[i]);
            let [a, b] = cloud.log_scales[i].map(|s| s.exp() / radius);
            let axes = cloud.rotation(i);
            let disc = Disc {
                centre: (Vec3::from_array(cloud.positions[i]) - centre) / radius,
                a: a * axes.x_axis,
                b: b * axes.y_axis,
                opacity,
                cutoff: (2.0 * (opacity / ALPHA_MIN).ln()).max(0.0).sqrt(),
            };
            let sound = disc.centre.is_finite() && disc.a.is_finite() && disc.b.is_finite();
            (sound && opacity > ALPHA_MIN).then_some(disc)
        })
        .collect()
}

/// The rectangle of a projection that the object fills, in radii of the sphere about its centre: pixels are not spent on the
/// air around a long thing. Both directions of a line have the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    /// Middle along the two axes.
    pub middle: [f32; 2],
    /// Half of the extent along the two axes, above 0.
    pub half: [f32; 2],
}

/// The rectangle that discs fill along a direction, a hundredth wider.
pub(super) fn window(discs: &[Disc], direction: &FieldDirection) -> Window {
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for disc in discs.iter().filter(|d| d.opacity > WINDOW_OPACITY) {
        let spread = |axis: Vec3| WINDOW_SIGMAS * disc.a.dot(axis).hypot(disc.b.dot(axis));
        let middle = Vec2::new(direction.u.dot(disc.centre), direction.v.dot(disc.centre));
        let reach = Vec2::new(spread(direction.u), spread(direction.v));
        low = low.min(middle - reach);
        high = high.max(middle + reach);
    }
    if !(low.is_finite() && high.is_finite()) {
        return Window { middle: [0.0; 2], half: [1.0; 2] };
    }
    let (low, high) = (low.max(Vec2::NEG_ONE), high.min(Vec2::ONE));
    let half = (0.505 * (high - low)).max(Vec2::splat(1e-3));
    Window { middle: (0.5 * (low + high)).to_array(), half: half.to_array() }
}

/// Opacity and depth of every pixel, along a direction and against it.
///
/// The ray through a pixel's centre meets a disc's plane where `q − c = x a + y b` in the projection, at depth
/// `c + x a + y b` along the direction, with opacity `o exp(−(x² + y²)/2)`.
pub(super) fn project(
    discs: &[Disc],
    direction: &FieldDirection,
    window: &Window,
    res: usize,
) -> (Vec<[u16; 2]>, Vec<[u16; 2]>) {
    let (middle, half) = (Vec2::from_array(window.middle), Vec2::from_array(window.half));
    // Pixel centres: q = middle + half ((k + ½) 2 / res − 1).
    let pixel = 2.0 * half / res as f32;
    let origin = middle - half + 0.5 * pixel;
    let mut hits: Vec<(u32, f32, f32)> = Vec::new();
    for disc in discs {
        let flat = |v: Vec3| Vec2::new(direction.u.dot(v), direction.v.dot(v));
        let (c, a, b) = (flat(disc.centre), flat(disc.a), flat(disc.b));
        let along = |v: Vec3| direction.towards.dot(v);
        let (ct, at, bt) = (along(disc.centre), along(disc.a), along(disc.b));
        let area = a.perp_dot(b);
        if !(area.abs() > EDGE_ON * disc.a.length() * disc.b.length()) {
            continue;
        }
        let reach = disc.cutoff * Vec2::new(a.x.hypot(b.x), a.y.hypot(b.y));
        let first = ((c - reach - origin) / pixel).ceil().max(Vec2::ZERO);
        let last = ((c + reach - origin) / pixel).floor().min(Vec2::splat(res as f32 - 1.0));
        for row in first.y as i64..=last.y as i64 {
            for column in first.x as i64..=last.x as i64 {
                let d = origin + pixel * Vec2::new(column as f32, row as f32) - c;
                let (x, y) = (d.perp_dot(b) / area, a.perp_dot(d) / area);
                let alpha = disc.opacity * (-0.5 * (x * x + y * y)).exp();
                if alpha >= ALPHA_MIN {
                    let place = (row as usize * res + column as usize) as u32;
                    hits.push((place, ct + x * at + y * bt, alpha.min(ALPHA_MAX)));
                }
            }
        }
    }
    hits.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2)));
    let mut forth = vec![[0u16; 2]; res * res];
    let mut back = forth.clone();
    for ray in hits.chunk_by(|a, b| a.0 == b.0) {
        let opacity = 1.0 - ray.iter().map(|h| 1.0 - h.2).product::<f32>();
        let alpha = (opacity * f32::from(u16::MAX)).round() as u16;
        // A light towards +direction meets the last hit first.
        let lit = half_depth(ray.iter().rev().map(|h| (h.1, h.2)), opacity);
        let dark = half_depth(ray.iter().map(|h| (h.1, h.2)), opacity);
        let place = ray[0].0 as usize;
        forth[place] = [alpha, depth_code(lit.clamp(-DEPTH_REACH, DEPTH_REACH))];
        back[place] = [alpha, depth_code((-dark).clamp(-DEPTH_REACH, DEPTH_REACH))];
    }
    (forth, back)
}

/// Depth at which half of the opacity is reached.
fn half_depth(hits: impl Iterator<Item = (f32, f32)>, opacity: f32) -> f32 {
    let mut through = 1.0;
    let mut at = 0.0;
    for (t, alpha) in hits {
        through *= 1.0 - alpha;
        at = t;
        if 1.0 - through >= 0.5 * opacity {
            break;
        }
    }
    at
}
