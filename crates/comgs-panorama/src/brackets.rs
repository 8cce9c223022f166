//! High dynamic range from pictures of low dynamic range at several exposures.
//!
//! What models that paint pictures give (Phongthawee et al. 2024; ComGS appendix D): the panorama at EV 0, −2.5, −5. Where a
//! picture reaches white, the next darker one says how bright the light is.

use comgs_image::Image;

/// From this luminance on, a picture gives way to the next darker one; at 1 only that counts.
pub const THRESHOLD: f64 = 0.9;

/// Rec. 709.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Linear radiance from pictures in linear light in [0, 1], brightest exposure first: `(EV, picture)`, EV falling. 1 is the white of
/// EV 0; the result ends at `2^−EV` of the darkest.
///
/// Luminance is merged and colour is that of the first picture, so exposures whose colours disagree give no fringes:
///
/// ```text
/// Y ← Y_n / 2^EV_n;  for k = n − 1 … 0:  L = Y_k / 2^EV_k,  w = (Y_k − 0.9) / 0.1 in [0, 1],  Y ← (1 − w) L + w max(Y, L)
/// ```
///
/// The maximum: a picture that is white says "at least this". Pictures that are exact give the exact luminance below the end.
/// Not differentiable where `w` is 0 or 1 or the maximum changes.
///
/// # Panics
/// Without pictures, or with pictures of different sizes.
#[must_use]
pub fn merge(exposures: &[(f64, Image)]) -> Image {
    let (first_ev, first) = &exposures[0];
    let mut out = first.clone();
    for i in 0..first.pixels() {
        let y = |image: &Image| (0..3).map(|c| LUMINANCE[c] * f64::from(image.data[3 * i + c])).sum::<f64>();
        let mut merged = None::<f64>;
        for (ev, image) in exposures.iter().rev() {
            assert_eq!((image.width, image.height), (first.width, first.height), "exposures of one size");
            let own = y(image);
            let here = own * (-ev).exp2();
            let darker = ((own - THRESHOLD) / (1.0 - THRESHOLD)).clamp(0.0, 1.0);
            merged = Some(merged.map_or(here, |before| (1.0 - darker) * here + darker * before.max(here)));
        }
        let (own, merged) = (y(first), merged.unwrap_or(0.0));
        let gain = if own > 1e-6 { merged / own } else { (-first_ev).exp2() };
        out.data[3 * i..3 * i + 3].iter_mut().for_each(|v| *v = (f64::from(*v) * gain) as f32);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const EV: [f64; 3] = [0.0, -2.5, -5.0];

    fn photographed(radiance: &Image) -> Vec<(f64, Image)> {
        EV.iter().map(|&ev| (ev, radiance.map(|v| (f64::from(v) * ev.exp2()).min(1.0) as f32))).collect()
    }

    /// Goal: exact exposures give the luminance back up to 2⁵, and 2⁵ above; colour is that of EV 0.
    #[test]
    fn exact_exposures_give_the_luminance() {
        let values: Vec<f32> = (0..200).flat_map(|i| [10f32.powf(-3.0 + 0.025 * i as f32); 3]).collect();
        let radiance = Image::from_data(20, 10, 3, values);
        let merged = merge(&photographed(&radiance));
        for (a, b) in merged.data.iter().zip(&radiance.data) {
            assert!((a - b.min(32.0)).abs() < 1e-4 * b.min(32.0), "{b} became {a}");
        }
        let warm = Image::from_data(1, 1, 3, vec![0.4, 0.2, 0.1]);
        let merged = merge(&photographed(&warm));
        assert!(merged.data.iter().zip(&warm.data).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    /// Goal: an exposure that contradicts a white one (a network forgot the lamp) does not make it darker than white.
    #[test]
    fn white_is_a_lower_bound() {
        let white = Image::from_data(1, 1, 3, vec![1.0; 3]);
        let black = Image::zeros(1, 1, 3);
        let merged = merge(&[(0.0, white), (-2.5, black.clone()), (-5.0, black)]);
        assert!((merged.data[0] - 1.0).abs() < 1e-6);
        let nothing = Image::zeros(1, 1, 3);
        assert_eq!(merge(&[(0.0, nothing)]).data, [0.0; 3]);
    }
}
