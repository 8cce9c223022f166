//! Defocus of photos by depth.
//!
//! A thin lens shows a point at depth z as a disc of radius `r(z) = a |1/z − 1/z_f|` pixels: a the aperture times the focal length over
//! the pixel's size, z_f the depth in focus. An edge in its picture has σ = r/2, but blurred once more by less than r it loses as
//! much in its middle as a Gaussian edge of σ = r: both have the curvature 1/r² there.

use crate::ComposedFrame;
use comgs_image::Image;
use comgs_image::transfer::srgb_from_linear;
use rayon::prelude::*;
use serde::Serialize;

/// Defocus of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Defocus {
    /// a: radius of the disc in pixels for a difference of 1 of the inverse depths, world units.
    pub aperture: f32,
    /// 1/z_f.
    pub focus: f32,
    /// Width of the photos in pixels that `aperture` is for.
    pub width: usize,
}

/// Standard deviation of the blur by which edges are blurred once more.
const AGAIN: f32 = 1.0;
/// Least gradient of an edge, coded values a pixel.
const EDGE: f32 = 0.03;
/// Variance of the central difference, pixels²: that of a box of two pixels.
const DIFFERENCE: f32 = 1.0 / 3.0;
/// Bins of inverse depth; fewest edges of one; fewest bins.
const BINS: usize = 12;
const LEAST: usize = 20;
const LEAST_BINS: usize = 5;
/// Radius of the largest disc in the photos below which nobody sees defocus, pixels.
const VISIBLE: f64 = 0.75;
/// Share of the edges' variation from depth to depth that a thin lens must explain.
const EXPLAINED: f64 = 0.6;
/// Largest disc that is drawn, pixels.
const LARGEST: f32 = 24.0;

impl Defocus {
    /// From photos (linear RGB) and their z-depths (0 where unknown), all of one width; `None` where width of edges does not follow
    /// a thin lens or stays below what is seen.
    ///
    /// The width of an edge is taken from how much it loses when it is blurred once more: with gradients g and g′,
    /// `σ² = σ′² / (g²/g′² − 1)` less that of the difference itself (Zhuo and Sim 2011). Only edges within a surface count. At every
    /// inverse depth u the sharper quarter is used, because an edge can be soft by itself but not sharper than its focus;
    /// `σ² = s² + a² (u − u_f)²` is fitted to these.
    #[must_use]
    pub fn estimate(photos: &[(Image, Image)]) -> Option<Self> {
        let width = photos.first()?.0.width;
        let mut edges: Vec<(f64, f64)> = photos.par_iter().flat_map_iter(|(c, z)| edges(c, z)).collect();
        edges.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (low, high) = (edges.get(edges.len() / 50)?.0, edges.get(edges.len() * 49 / 50)?.0);
        let span = high - low;
        if !(span > 1e-3 * high) {
            return None;
        }
        let mut bins: Vec<Vec<f64>> = vec![Vec::new(); BINS];
        for (u, variance) in edges {
            let k = ((u - low) / span * BINS as f64).floor();
            if (0.0..BINS as f64).contains(&k) {
                bins[k as usize].push(variance);
            }
        }
        let mut samples = Vec::new();
        for (k, variances) in bins.iter_mut().enumerate().filter(|(_, v)| v.len() >= LEAST) {
            variances.sort_by(f64::total_cmp);
            samples.push(((k as f64 + 0.5) / BINS as f64, variances[variances.len() / 4]));
        }
        if samples.len() < LEAST_BINS {
            return None;
        }
        let [c0, c1, c2] = parabola(&samples)?;
        let fit = |t: f64| c0 + c1 * t + c2 * t * t;
        let mean = samples.iter().map(|s| s.1).sum::<f64>() / samples.len() as f64;
        let all: f64 = samples.iter().map(|s| (s.1 - mean).powi(2)).sum();
        let left: f64 = samples.iter().map(|s| (s.1 - fit(s.0)).powi(2)).sum();
        // In focus at t_f = −c1 / 2 c2; a parabola that opens downwards is no lens.
        let focus = -c1 / (2.0 * c2);
        if !(c2 > 0.0) || left > (1.0 - EXPLAINED) * all || !(-1.0..=2.0).contains(&focus) {
            return None;
        }
        let aperture = c2.sqrt() / span;
        let largest = aperture * span * focus.abs().max((1.0 - focus).abs());
        (largest >= VISIBLE).then_some(Self {
            aperture: aperture as f32,
            focus: (low + focus * span) as f32,
            width,
        })
    }

    /// Radius in pixels of the disc of a point at a z-depth in a picture of some width; 0 where the depth is unknown.
    #[must_use]
    pub fn radius(&self, depth: f32, width: usize) -> f32 {
        if !(depth > 0.0) {
            return 0.0;
        }
        let r = self.aperture * (1.0 / depth - self.focus).abs() * width as f32 / self.width.max(1) as f32;
        r.min(LARGEST)
    }

    /// Draws every pixel of the object as its disc, and what is behind it as far as it is uncovered. `beauty = object + scene · shadow`
    /// holds afterwards as before; the object's light is kept but for what leaves the picture.
    pub fn blur_object(&self, frame: &mut ComposedFrame) {
        let (w, h) = (frame.mask.width, frame.mask.height);
        let discs: Vec<f32> = (0..w * h)
            .map(|i| if frame.mask.data[i] > 0.0 { self.radius(frame.depth.data[i], w) } else { 0.0 })
            .collect();
        let reach = discs.iter().fold(0.0f32, |a, b| a.max(*b)).ceil() as usize;
        if reach == 0 || discs.iter().all(|r| *r < 0.3) {
            return;
        }
        let area: Vec<f32> = discs.iter().map(|r| 1.0 / disc_sum(*r)).collect();
        let object = &frame.object;
        let mut blurred = Image::zeros(w, h, 4);
        blurred.data.par_chunks_mut(4 * w).enumerate().for_each(|(y, row)| {
            for (x, out) in row.chunks_exact_mut(4).enumerate() {
                for v in y.saturating_sub(reach + 1)..(y + reach + 2).min(h) {
                    for u in x.saturating_sub(reach + 1)..(x + reach + 2).min(w) {
                        let i = v * w + u;
                        let from = &object.data[4 * i..4 * i + 4];
                        if from[3] <= 0.0 {
                            continue;
                        }
                        let distance = ((u.abs_diff(x).pow(2) + v.abs_diff(y).pow(2)) as f32).sqrt();
                        let weight = cover(discs[i], distance) * area[i];
                        if weight > 0.0 {
                            for c in 0..4 {
                                out[c] += weight * from[c];
                            }
                        }
                    }
                }
                out[3] = out[3].min(1.0);
            }
        });
        for i in 0..w * h {
            let (before, after) = (frame.mask.data[i], blurred.data[4 * i + 3]);
            for c in 0..3 {
                let k = 3 * i + c;
                let scene = (frame.scene.data[k] + frame.empty.data[k] * (before - after)).max(0.0);
                frame.scene.data[k] = scene;
                frame.beauty.data[k] = blurred.data[4 * i + c] + scene * frame.shadow.data[k];
            }
            frame.mask.data[i] = after;
        }
        frame.object = blurred;
    }
}

/// Share of a pixel at a distance from the middle of a disc that it covers, with an edge one pixel wide.
fn cover(radius: f32, distance: f32) -> f32 {
    if distance == 0.0 { 1.0 } else { (radius - distance + 0.5).clamp(0.0, 1.0) }
}

/// Sum of a disc over the pixels.
fn disc_sum(radius: f32) -> f32 {
    let n = radius.ceil() as i32 + 1;
    let row = |y: i32| (-n..=n).map(|x| cover(radius, ((x * x + y * y) as f32).sqrt())).sum::<f32>();
    (-n..=n).map(row).sum()
}

/// Inverse depth and squared width of the edges of a photo.
fn edges(color: &Image, depth: &Image) -> Vec<(f64, f64)> {
    let (w, h) = (color.width, color.height);
    let sharp: Vec<f32> = color
        .data
        .chunks_exact(color.channels)
        .map(|c| (0..3).map(|k| srgb_from_linear(c[k].clamp(0.0, 1.0))).sum::<f32>() / 3.0)
        .collect();
    let soft = blurred(&sharp, w, h);
    let gradient = |v: &[f32], x: usize, y: usize| {
        let i = y * w + x;
        (0.5 * (v[i + 1] - v[i - 1]), 0.5 * (v[i + w] - v[i - w]))
    };
    let length = |(x, y): (f32, f32)| x.hypot(y);
    let mut out = Vec::new();
    for y in 3..h.saturating_sub(3) {
        for x in 3..w.saturating_sub(3) {
            let g = gradient(&sharp, x, y);
            let size = length(g);
            if size < EDGE {
                continue;
            }
            // The middle of the edge, across it.
            let (dx, dy) = ((g.0 / size).round() as isize, (g.1 / size).round() as isize);
            let at = |k: isize| {
                let (x, y) = (x.wrapping_add_signed(k * dx), y.wrapping_add_signed(k * dy));
                length(gradient(&sharp, x, y))
            };
            if at(1) > size || at(-1) > size {
                continue;
            }
            let around = (0..25).map(|k| depth.data[(y + k / 5 - 2) * w + x + k % 5 - 2]);
            let (near, far) = around.fold((f32::INFINITY, 0.0f32), |(a, b), z| (a.min(z), b.max(z)));
            if !(near > 0.0 && far < 1.05 * near) {
                continue;
            }
            let ratio = size / length(gradient(&soft, x, y)).max(1e-6);
            let variance = AGAIN * AGAIN / (ratio * ratio - 1.0).max(1e-3) - DIFFERENCE;
            out.push((f64::from(1.0 / depth.data[y * w + x]), f64::from(variance.max(0.0))));
        }
    }
    out
}

/// Blurred with a Gaussian of [`AGAIN`].
fn blurred(v: &[f32], w: usize, h: usize) -> Vec<f32> {
    let weights: Vec<f32> = (-4..=4).map(|k| (-0.5 * (k as f32 / AGAIN).powi(2)).exp()).collect();
    let sum: f32 = weights.iter().sum();
    let along = |v: &[f32], step: usize, last: usize, position: usize, i: usize| {
        let tap = |k: usize| {
            let to = (position + k).saturating_sub(4).min(last);
            v[i - position * step + to * step]
        };
        weights.iter().enumerate().map(|(k, weight)| weight * tap(k)).sum::<f32>() / sum
    };
    let rows: Vec<f32> = (0..w * h).map(|i| along(v, 1, w - 1, i % w, i)).collect();
    (0..w * h).map(|i| along(&rows, w, h - 1, i / w, i)).collect()
}

/// Least-squares coefficients of `c0 + c1 t + c2 t²`; `None` for too few different t.
fn parabola(samples: &[(f64, f64)]) -> Option<[f64; 3]> {
    let mut normal = glam::DMat3::ZERO;
    let mut right = glam::DVec3::ZERO;
    for &(t, y) in samples {
        let row = glam::DVec3::new(1.0, t, t * t);
        normal += glam::DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        right += y * row;
    }
    (normal.determinant().abs() > 1e-12).then(|| (normal.inverse() * right).to_array())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::FrameStats;

    /// Stripes on a plane that leans away, through a thin lens: every edge is that of a half plane behind a disc, on paper.
    fn stripes(aperture: f32, focus: f32) -> (Image, Image) {
        let (w, h) = (320, 240);
        let (mut color, mut depth) = (Image::zeros(w, h, 3), Image::zeros(w, h, 1));
        for y in 0..h {
            let z = 1.0 / (0.3 + 0.9 * y as f32 / h as f32);
            let r = (aperture * (1.0 / z - focus).abs()).max(0.5);
            for x in 0..w {
                // Edges every 40 pixels, leaning a little so that they fall on all parts of a pixel.
                let p = x as f32 + 0.13 * y as f32;
                let k = (p / 40.0).round();
                let t = ((p - 40.0 * k) / r).clamp(-1.0, 1.0);
                let part = 0.5 + (t * (1.0 - t * t).sqrt() + t.asin()) / std::f32::consts::PI;
                let part = if (k as i32).rem_euclid(2) == 0 { part } else { 1.0 - part };
                let linear = comgs_image::transfer::linear_from_srgb(0.2 + 0.6 * part);
                color.pixel_mut(x, y).copy_from_slice(&[linear; 3]);
                depth.pixel_mut(x, y)[0] = z;
            }
        }
        (color, depth)
    }

    /// Goal: aperture and depth in focus of a thin lens are found again from its pictures of known depth (to 15 % and 10 % of the range of depths); a sharp
    /// picture has no defocus.
    #[test]
    fn a_lens_is_found_again() {
        for (aperture, focus) in [(8.0, 0.5), (6.0, 1.0), (12.0, 0.75)] {
            let found = Defocus::estimate(&[stripes(aperture, focus)]).unwrap();
            assert!((found.aperture / aperture - 1.0).abs() < 0.15, "{found:?}, lens {aperture}");
            assert!((found.focus - focus).abs() < 0.09, "{found:?}, focus {focus}");
        }
        assert_eq!(Defocus::estimate(&[stripes(0.0, 0.5)]), None);
        assert_eq!(Defocus::estimate(&[]), None);
        let flat = (Image::filled(64, 64, 3, 0.5), Image::filled(64, 64, 1, 2.0));
        assert_eq!(Defocus::estimate(&[flat]), None);
    }

    fn frame(depth: f32) -> ComposedFrame {
        let (w, h) = (48, 40);
        let inside = |x: usize, y: usize| (16..32).contains(&x) && (12..28).contains(&y);
        let (mut object, mut mask) = (Image::zeros(w, h, 4), Image::zeros(w, h, 1));
        let (mut scene, mut beauty) = (Image::filled(w, h, 3, 0.5), Image::filled(w, h, 3, 0.5));
        for y in 0..h {
            for x in 0..w {
                if inside(x, y) {
                    object.pixel_mut(x, y).copy_from_slice(&[0.8, 0.4, 0.2, 1.0]);
                    mask.pixel_mut(x, y)[0] = 1.0;
                    scene.pixel_mut(x, y).fill(0.0);
                    beauty.pixel_mut(x, y).copy_from_slice(&[0.8, 0.4, 0.2]);
                }
            }
        }
        ComposedFrame {
            beauty,
            weight: Image::filled(w, h, 1, 1.0),
            object,
            scene,
            empty: Image::filled(w, h, 3, 0.5),
            shadow: Image::filled(w, h, 3, 1.0),
            depth: Image::filled(w, h, 1, depth),
            normal: Image::zeros(w, h, 3),
            mask,
            stats: FrameStats::default(),
        }
    }

    /// Goal: a blurred object keeps its light and its cover, an edge becomes as wide as the disc says, beauty stays the sum of its layers, and in focus
    /// nothing changes.
    #[test]
    fn an_object_out_of_focus() {
        let lens = Defocus { aperture: 4.0, focus: 0.5, width: 48 };
        let mut sharp = frame(2.0);
        lens.blur_object(&mut sharp);
        assert_eq!(sharp.beauty, frame(2.0).beauty);
        let mut soft = frame(0.8);
        lens.blur_object(&mut soft);
        assert!((lens.radius(0.8, 48) - 3.0).abs() < 1e-4 && (lens.radius(0.8, 96) - 6.0).abs() < 1e-4);
        let sum = |image: &Image, c: usize| image.data.iter().skip(c).step_by(image.channels).sum::<f32>();
        let before = frame(0.8);
        assert!((sum(&soft.object, 0) / sum(&before.object, 0) - 1.0).abs() < 1e-3);
        assert!((sum(&soft.mask, 0) / sum(&before.mask, 0) - 1.0).abs() < 1e-3);
        // The edge of a half plane: σ = r / 2.
        let edge: Vec<f32> = (8..24).map(|x| soft.mask.pixel(x, 20)[0]).collect();
        let slopes: Vec<f32> = edge.windows(2).map(|p| p[1] - p[0]).collect();
        let middle = slopes.iter().enumerate().map(|(k, s)| k as f32 * s).sum::<f32>();
        let variance = slopes.iter().enumerate().map(|(k, s)| (k as f32 - middle).powi(2) * s).sum::<f32>();
        assert!((variance.sqrt() - 1.5).abs() < 0.15, "σ {}", variance.sqrt());
        for i in 0..soft.mask.data.len() {
            for c in 0..3 {
                let parts =
                    soft.object.data[4 * i + c] + soft.scene.data[3 * i + c] * soft.shadow.data[3 * i + c];
                assert!((soft.beauty.data[3 * i + c] - parts).abs() < 1e-6);
            }
        }
        assert_eq!(soft.first_non_finite(), None);
    }
}
