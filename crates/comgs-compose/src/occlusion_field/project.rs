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

/// A disc as a projection sees it: `q − c = x a + y b` in the projection, depth `ct + x at + y bt` along the direction.
struct Flat {
    c: Vec2,
    a: Vec2,
    b: Vec2,
    depth: Vec3,
    inverse_area: f32,
    opacity: f32,
    first: [u16; 2],
    last: [u16; 2],
}

/// Opacity and depth of every pixel, along a direction and against it.
///
/// The ray through a pixel's centre meets a disc's plane where `q − c = x a + y b` in the projection, at depth
/// `c + x a + y b` along the direction, with opacity `o exp(−(x² + y²)/2)`. Opacity needs no order; depths are found from
/// either side, disc by disc in the order of their centres, and a pixel is done at half of its opacity. (Sorting the hits of
/// every pixel instead took twice as long, as long as tracing all rays.)
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
    let mut flats: Vec<Flat> = discs.iter().filter_map(|d| flat(d, direction, origin, pixel, res)).collect();
    flats.sort_unstable_by(|a, b| a.depth.x.total_cmp(&b.depth.x).then(a.opacity.total_cmp(&b.opacity)));
    let mut through = vec![1.0f32; res * res];
    for f in &flats {
        f.visit(
            origin,
            pixel,
            res,
            &mut through,
            |_, _| true,
            |through, alpha, _, _| *through *= 1.0 - alpha,
        );
    }
    // A light towards −direction meets the nearest discs first, one towards +direction the farthest.
    let dark = half_depths(flats.iter(), origin, pixel, res, &through);
    let lit = half_depths(flats.iter().rev(), origin, pixel, res, &through);
    let code = |depths: &[f32], sign: f32| {
        let texel = |(t, depth): (&f32, &f32)| {
            let alpha = ((1.0 - t) * f32::from(u16::MAX)).round() as u16;
            if alpha == 0 {
                [0, 0]
            } else {
                [alpha, depth_code((sign * depth).clamp(-DEPTH_REACH, DEPTH_REACH))]
            }
        };
        through.iter().zip(depths).map(texel).collect()
    };
    (code(&lit, 1.0), code(&dark, -1.0))
}

/// A disc in the projection; `None` where it is edge-on or outside.
fn flat(disc: &Disc, direction: &FieldDirection, origin: Vec2, pixel: Vec2, res: usize) -> Option<Flat> {
    let flat = |v: Vec3| Vec2::new(direction.u.dot(v), direction.v.dot(v));
    let (c, a, b) = (flat(disc.centre), flat(disc.a), flat(disc.b));
    let along = |v: Vec3| direction.towards.dot(v);
    let area = a.perp_dot(b);
    if !(area.abs() > EDGE_ON * disc.a.length() * disc.b.length()) {
        return None;
    }
    let reach = disc.cutoff * Vec2::new(a.x.hypot(b.x), a.y.hypot(b.y));
    let first = ((c - reach - origin) / pixel).ceil().max(Vec2::ZERO);
    let last = ((c + reach - origin) / pixel).floor().min(Vec2::splat(res as f32 - 1.0));
    (first.x <= last.x && first.y <= last.y).then(|| Flat {
        c,
        a,
        b,
        depth: Vec3::new(along(disc.centre), along(disc.a), along(disc.b)),
        inverse_area: 1.0 / area,
        opacity: disc.opacity,
        first: first.to_array().map(|v| v as u16),
        last: last.to_array().map(|v| v as u16),
    })
}

impl Flat {
    /// Changes the value of every `open` pixel that it covers, given opacity and tangent coordinates in standard deviations.
    #[inline]
    fn visit<T>(
        &self,
        origin: Vec2,
        pixel: Vec2,
        res: usize,
        values: &mut [T],
        open: impl Fn(usize, &T) -> bool,
        change: impl Fn(&mut T, f32, f32, f32),
    ) {
        for row in self.first[1]..=self.last[1] {
            for column in self.first[0]..=self.last[0] {
                let at = usize::from(row) * res + usize::from(column);
                if !open(at, &values[at]) {
                    continue;
                }
                let d = origin + pixel * Vec2::new(f32::from(column), f32::from(row)) - self.c;
                let (x, y) = (d.perp_dot(self.b) * self.inverse_area, self.a.perp_dot(d) * self.inverse_area);
                let alpha = self.opacity * (-0.5 * (x * x + y * y)).exp();
                if alpha >= ALPHA_MIN {
                    change(&mut values[at], alpha.min(ALPHA_MAX), x, y);
                }
            }
        }
    }
}

/// Depth at which every pixel has half of its opacity, discs in the order in which they are met.
fn half_depths<'a>(
    discs: impl Iterator<Item = &'a Flat>,
    origin: Vec2,
    pixel: Vec2,
    res: usize,
    through: &[f32],
) -> Vec<f32> {
    // What is left of the light, and the depth of the last disc that took some.
    let mut pixels = vec![(1.0f32, 0.0f32); res * res];
    let open = |at: usize, (left, _): &(f32, f32)| *left > 0.5 * (1.0 + through[at]);
    for f in discs {
        f.visit(origin, pixel, res, &mut pixels, open, |(left, depth), alpha, x, y| {
            *left *= 1.0 - alpha;
            *depth = f.depth.x + x * f.depth.y + y * f.depth.z;
        });
    }
    pixels.into_iter().map(|p| p.1).collect()
}
