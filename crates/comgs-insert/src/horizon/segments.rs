//! Straight edges of a picture: regions of pixels whose level lines run alike, each fitted by its axis of inertia (the idea of
//! LSD, Grompone von Gioi et al. 2010, without its a-contrario test: what follows votes, and a few wrong lines do not matter).

use comgs_image::Image;
use comgs_image::transfer::srgb_from_linear;
use glam::DVec2;
use std::f64::consts::TAU;

/// A straight edge, pixels; x right, y down, pixel centres at halves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// One end.
    pub from: DVec2,
    /// The other.
    pub to: DVec2,
}

impl Segment {
    /// Pixels.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.from.distance(self.to)
    }

    /// Half way.
    #[must_use]
    pub fn middle(&self) -> DVec2 {
        0.5 * (self.from + self.to)
    }
}

/// How far the level line of a pixel may be off its region's: 22.5°, as in LSD.
const TOLERANCE: f64 = TAU / 16.0;

/// Least slope between neighbouring pixels, of sRGB codes in [0, 1]: two 8-bit steps bend the angle by less than the tolerance.
const SLOPE: f64 = 2.0 / 255.0 / 0.3827;

/// Least share of its box that a region fills: what bends or frays is no line.
const DENSITY: f64 = 0.55;

/// Least pixels of a region.
const FEWEST: usize = 12;

/// Slopes of a picture.
struct Slopes {
    width: usize,
    height: usize,
    size: Vec<f64>,
    /// Direction of the level line, brighter side to the right.
    angle: Vec<f64>,
}

impl Slopes {
    /// Between the four pixels around each corner, of the picture smoothed by a 3×3 binomial.
    fn new(photo: &Image) -> Self {
        let (w, h) = (photo.width, photo.height);
        let grey: Vec<f64> = (0..w * h)
            .map(|i| {
                let v = &photo.data[photo.channels * i..photo.channels * (i + 1)];
                f64::from(v.iter().map(|v| srgb_from_linear(v.clamp(0.0, 1.0))).sum::<f32>()) / v.len() as f64
            })
            .collect();
        let at =
            |x: i64, y: i64| grey[y.clamp(0, h as i64 - 1) as usize * w + x.clamp(0, w as i64 - 1) as usize];
        let smooth: Vec<f64> = (0..w * h)
            .map(|i| {
                let (x, y) = ((i % w) as i64, (i / w) as i64);
                let row = |y| at(x - 1, y) + 2.0 * at(x, y) + at(x + 1, y);
                (row(y - 1) + 2.0 * row(y) + row(y + 1)) / 16.0
            })
            .collect();
        let (mut size, mut angle) = (vec![0.0; w * h], vec![0.0; w * h]);
        for y in 0..h.saturating_sub(1) {
            for x in 0..w.saturating_sub(1) {
                let i = y * w + x;
                let (a, b, c, d) = (smooth[i], smooth[i + 1], smooth[i + w], smooth[i + w + 1]);
                let (gx, gy) = (0.5 * (b + d - a - c), 0.5 * (c + d - a - b));
                size[i] = gx.hypot(gy);
                angle[i] = gx.atan2(-gy);
            }
        }
        Self { width: w, height: h, size, angle }
    }
}

/// Least turn between two angles.
fn turn(a: f64, b: f64) -> f64 {
    let d = (a - b).rem_euclid(TAU);
    d.min(TAU - d)
}

/// A region that grows from a seed over neighbours whose level lines are within `tolerance` of its mean.
fn grow(slopes: &Slopes, taken: &[bool], seed: usize, tolerance: f64) -> Vec<usize> {
    let (w, h) = (slopes.width as i64, slopes.height as i64);
    let mut region = vec![seed];
    let mut inside = std::collections::HashSet::from([seed]);
    let (mut sin, mut cos) = slopes.angle[seed].sin_cos();
    let mut next = 0;
    while next < region.len() {
        let (x, y) = ((region[next] as i64) % w, (region[next] as i64) / w);
        next += 1;
        for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
            let (u, v) = (x + dx, y + dy);
            if !((0..w).contains(&u) && (0..h).contains(&v)) {
                continue;
            }
            let i = (v * w + u) as usize;
            let fits = slopes.size[i] >= SLOPE && turn(slopes.angle[i], sin.atan2(cos)) <= tolerance;
            if fits && !taken[i] && inside.insert(i) {
                let (s, c) = slopes.angle[i].sin_cos();
                (sin, cos) = (sin + s, cos + c);
                region.push(i);
            }
        }
    }
    region
}

/// The segment along a region's axis of inertia, and the share of its box that the region fills.
fn fitted(slopes: &Slopes, region: &[usize]) -> (Segment, f64) {
    let place = |i: usize| {
        // A slope belongs to the corner between four pixels.
        DVec2::new((i % slopes.width) as f64 + 1.0, (i / slopes.width) as f64 + 1.0)
    };
    let total: f64 = region.iter().map(|i| slopes.size[*i]).sum();
    let middle = region.iter().map(|i| place(*i) * slopes.size[*i]).sum::<DVec2>() / total;
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for &i in region {
        let d = place(i) - middle;
        let m = slopes.size[i] / total;
        (xx, xy, yy) = (xx + m * d.x * d.x, xy + m * d.x * d.y, yy + m * d.y * d.y);
    }
    let axis = DVec2::from_angle(0.5 * (2.0 * xy).atan2(xx - yy));
    let (mut low, mut high, mut wide) = (f64::MAX, f64::MIN, 0.0f64);
    for &i in region {
        let d = place(i) - middle;
        let along = d.dot(axis);
        (low, high) = (low.min(along), high.max(along));
        wide = wide.max(d.perp_dot(axis).abs());
    }
    let segment = Segment { from: middle + axis * low, to: middle + axis * high };
    let filled = region.len() as f64 / ((high - low + 1.0) * (2.0 * wide + 1.0));
    (segment, filled)
}

/// Straight edges of at least `shortest` pixels, the steepest first.
#[must_use]
pub fn segments(photo: &Image, shortest: f64) -> Vec<Segment> {
    let slopes = Slopes::new(photo);
    let mut order: Vec<usize> = (0..slopes.size.len()).filter(|i| slopes.size[*i] >= SLOPE).collect();
    order.sort_by(|a, b| slopes.size[*b].total_cmp(&slopes.size[*a]).then(a.cmp(b)));
    let mut taken = vec![false; slopes.size.len()];
    let mut out = Vec::new();
    for seed in order {
        if taken[seed] {
            continue;
        }
        // A region that is no line is tried once more with less tolerance.
        for tolerance in [TOLERANCE, 0.5 * TOLERANCE] {
            let region = grow(&slopes, &taken, seed, tolerance);
            if region.len() < FEWEST {
                taken[seed] = true;
                break;
            }
            let (segment, filled) = fitted(&slopes, &region);
            let line = filled >= DENSITY;
            if line || tolerance < TOLERANCE {
                region.iter().for_each(|i| taken[*i] = true);
            }
            if line {
                if segment.length() >= shortest {
                    out.push(segment);
                }
                break;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the edges of a turned square are found, each once, to a fifth of a pixel and of a degree; a smooth picture and noise
    /// below a step have none.
    #[test]
    fn edges_of_a_square() {
        let (w, h) = (160, 120);
        let angle = 0.3f64;
        let (axis, centre) = (DVec2::from_angle(angle), DVec2::new(80.0, 60.0));
        let mut photo = Image::zeros(w, h, 3);
        for y in 0..h {
            for x in 0..w {
                let mut sum = 0.0;
                for k in 0..16 {
                    let p = DVec2::new(
                        x as f64 + (k % 4) as f64 / 4.0 + 0.125,
                        y as f64 + (k / 4) as f64 / 4.0 + 0.125,
                    );
                    let d = p - centre;
                    let inside = d.dot(axis).abs() < 35.0 && d.perp_dot(axis).abs() < 35.0;
                    sum += if inside { 0.6 } else { 0.2 };
                }
                photo.pixel_mut(x, y).copy_from_slice(&[sum as f32 / 16.0; 3]);
            }
        }
        let found = segments(&photo, 20.0);
        assert_eq!(found.len(), 4, "{found:?}");
        for s in &found {
            let direction = (s.to - s.from).normalize();
            let off = direction.perp_dot(axis).abs().min(direction.dot(axis).abs());
            let d = s.middle() - centre;
            let distance = d.dot(axis).abs().max(d.perp_dot(axis).abs());
            assert!(off < 0.2f64.to_radians(), "{off}");
            assert!((distance - 35.0).abs() < 0.2 && (s.length() - 70.0).abs() < 6.0, "{distance} {s:?}");
        }
        let smooth = Image::from_data(40, 40, 1, (0..1600).map(|i| 0.3 + 1e-4 * (i / 40) as f32).collect());
        assert!(segments(&smooth, 5.0).is_empty());
    }
}
