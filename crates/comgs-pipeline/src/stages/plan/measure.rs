//! How much an effect changes pictures.

use comgs_image::{Image, transfer::srgb_from_linear};
use serde::{Deserialize, Serialize};

/// Change of pictures as a viewer sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Mean absolute difference of sRGB values, clipped to [0, 1], over the touched pixels; 0 where too few are.
    pub mean: f64,
    /// Share of pixels that are touched: that differ by half a code value of 8 bit or more.
    pub touched: f64,
}

/// Difference from which on a pixel is touched.
const TOUCHED: f32 = 0.5 / 255.0;
/// Share of pixels below which nobody looks.
const LEAST_TOUCHED: f64 = 1e-4;

/// Change from one set of pictures to another of the same cameras.
///
/// # Panics
/// When they differ in number or size.
#[must_use]
pub fn change(before: &[Image], after: &[Image]) -> Change {
    assert_eq!(before.len(), after.len(), "pictures of the same cameras");
    let (mut sum, mut touched, mut pixels) = (0.0f64, 0usize, 0usize);
    for (a, b) in before.iter().zip(after) {
        assert_eq!((a.width, a.height, a.channels), (b.width, b.height, b.channels), "pictures of one size");
        for (a, b) in a.data.chunks_exact(3).zip(b.data.chunks_exact(3)) {
            let code = |v: f32| srgb_from_linear(v.clamp(0.0, 1.0));
            let mean = (0..3).map(|c| (code(a[c]) - code(b[c])).abs()).sum::<f32>() / 3.0;
            pixels += 1;
            if mean >= TOUCHED {
                touched += 1;
                sum += f64::from(mean);
            }
        }
    }
    let share = touched as f64 / pixels.max(1) as f64;
    let mean = if share >= LEAST_TOUCHED { sum / touched as f64 } else { 0.0 };
    Change { mean, touched: share }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the mean is over touched pixels only, equal pictures change nothing, a single speck is nobody's effect, and
    /// what is clipped cannot change.
    #[test]
    fn change_is_over_what_is_touched() {
        let a = Image::filled(100, 100, 3, 0.25);
        assert_eq!(change(std::slice::from_ref(&a), std::slice::from_ref(&a)), Change::default());
        let mut b = a.clone();
        for x in 0..100 {
            b.pixel_mut(x, 7).copy_from_slice(&[0.5; 3]);
        }
        let c = change(std::slice::from_ref(&a), &[b]);
        let expected = f64::from(srgb_from_linear(0.5) - srgb_from_linear(0.25));
        assert!((c.touched - 0.01).abs() < 1e-9 && (c.mean - expected).abs() < 1e-6, "{c:?}");
        let mut speck = Image::filled(200, 100, 3, 0.25);
        let plain = speck.clone();
        speck.pixel_mut(3, 3).copy_from_slice(&[1.0; 3]);
        assert_eq!(change(&[plain], &[speck]).mean, 0.0);
        let (bright, brighter) = (Image::filled(4, 4, 3, 2.0), Image::filled(4, 4, 3, 5.0));
        assert_eq!(change(&[bright], &[brighter]), Change::default());
    }
}
