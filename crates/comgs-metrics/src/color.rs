//! Colour in f64, written apart from `comgs_image::transfer` on purpose.

use comgs_image::Image;

/// sRGB code value (IEC 61966-2-1) of a linear value clipped to [0, 1].
pub(crate) fn srgb_clipped(linear: f64) -> f64 {
    let x = linear.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Rec.709 luminance.
pub(crate) fn luminance(rgb: [f64; 3]) -> f64 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// One channel of an image, sRGB-encoded and clipped.
pub(crate) fn srgb_channel(image: &Image, channel: usize) -> Vec<f64> {
    image.data.iter().skip(channel).step_by(image.channels).map(|&v| srgb_clipped(f64::from(v))).collect()
}

/// A pixel's colour; grey for one channel.
pub(crate) fn rgb(image: &Image, i: usize) -> [f64; 3] {
    let p = &image.data[i * image.channels..];
    if image.channels >= 3 {
        [f64::from(p[0]), f64::from(p[1]), f64::from(p[2])]
    } else {
        [f64::from(p[0]); 3]
    }
}
