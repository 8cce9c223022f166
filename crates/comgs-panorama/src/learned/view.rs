//! A panorama as a model sees it: at the model's size and turned to a canonical yaw.

use crate::CompletionError;
use crate::partial::{Partial, resized, roll};
use crate::simple::known_mean;
use comgs_geom::equirect;
use comgs_image::Image;
use std::f64::consts::TAU;

/// Texels that are known at least this much count as known.
pub(super) const KNOWN: f32 = 0.5;
/// A texel is clipped when this share of what is known of it was.
const CLIPPED: f32 = 0.25;
/// Radiance below this part of the mean counts as that in the geometric mean.
const DARKEST: f64 = 1e-3;

/// The panorama, turned so that the brighter side of what is known is in the middle.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub width: usize,
    pub height: usize,
    /// Mean of what is known, 0 elsewhere; linear radiance.
    pub rgb: Image,
    /// Whether a texel counts as known (clipped ones as well).
    pub given: Vec<bool>,
    /// Whether a known texel is only a lower bound.
    pub clipped: Vec<bool>,
    /// Normals where known, else 0; turned along.
    pub normal: Option<Image>,
    /// Geometric mean of the known radiance (mean of the channels).
    pub geometric_mean: f64,
    /// Texels by which it was turned to the right.
    pub shift: usize,
}

impl View {
    /// * `middle`: what the geometric mean becomes before bright parts are compressed, for finding the bright side
    pub fn new(partial: &Partial, [width, height]: [usize; 2], middle: f64) -> Result<Self, CompletionError> {
        let alpha = resized(&partial.alpha, width, height);
        let rgb = known_mean(partial, width, height);
        let clipped = partial.clipped.as_ref().map(|c| resized(c, width, height));
        let n = width * height;
        let given: Vec<bool> = (0..n).map(|i| alpha.data[i] > KNOWN).collect();
        let is_clipped =
            |i: usize| given[i] && clipped.as_ref().is_some_and(|c| c.data[i] > CLIPPED * alpha.data[i]);
        let clipped: Vec<bool> = (0..n).map(is_clipped).collect();
        let value = |i: usize| rgb.data[3 * i..3 * i + 3].iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0;
        let omega = |i: usize| f64::from(equirect::texel_solid_angle(i / width, width, height));
        let (mut total, mut sum) = (0.0, 0.0);
        for i in (0..n).filter(|&i| given[i]) {
            total += omega(i);
            sum += omega(i) * value(i);
        }
        if total <= 0.0 {
            let largest = partial.alpha.data.iter().copied().fold(0.0, f32::max);
            return Err(CompletionError::NothingSeen { largest });
        }
        let floor = DARKEST * sum / total + 1e-12;
        let logs: f64 = (0..n).filter(|&i| given[i]).map(|i| omega(i) * value(i).max(floor).ln()).sum();
        let geometric_mean = (logs / total).exp();
        let level = geometric_mean / middle;
        let (mut along_x, mut along_y) = (0.0, 0.0);
        for i in (0..n).filter(|&i| given[i]) {
            let d = equirect::texel_direction(i % width, i / width, width, height);
            let soft = omega(i) * (value(i) / level) / (1.0 + value(i) / level);
            along_x += soft * f64::from(d.x);
            along_y += soft * f64::from(d.y);
        }
        let turns = along_y.atan2(along_x) / TAU * width as f64;
        let shift = (turns + 0.5).floor().rem_euclid(width as f64) as usize % width;
        let rolled = Partial {
            rgb,
            alpha,
            normal: partial.normal.as_ref().map(|n| resized(n, width, height)),
            clipped: None,
        }
        .rolled(shift);
        let turned = |flags: &[bool]| -> Vec<bool> {
            (0..n).map(|i| flags[i / width * width + (i % width + width - shift) % width]).collect()
        };
        let (given, clipped) = (turned(&given), turned(&clipped));
        let normal = rolled.normal.map(|mut normal| {
            for (v, &given) in normal.data.chunks_exact_mut(3).zip(&given) {
                let unit = glam::Vec3::from_slice(v).normalize_or_zero();
                v.copy_from_slice(&if given { unit } else { glam::Vec3::ZERO }.to_array());
            }
            normal
        });
        Ok(Self { width, height, rgb: rolled.rgb, given, clipped, normal, geometric_mean, shift })
    }

    /// A map of the model turned back to where the panorama was.
    pub fn back(&self, map: &Image) -> Image {
        roll(map, (self.width - self.shift) % self.width)
    }
}
