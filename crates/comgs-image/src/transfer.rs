//! The sRGB transfer function, extended beyond [0, 1] so that it stays invertible for HDR values.

/// sRGB encoding of a linear value (IEC 61966-2-1), continued with the same power law above 1 and with the
/// linear segment below 0. Inverse: [`linear_from_srgb`]; derivative: [`srgb_slope`].
#[must_use]
pub fn srgb_from_linear(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Linear value of an sRGB-encoded one; extended like [`srgb_from_linear`]. Derivative: [`linear_slope`].
#[must_use]
pub fn linear_from_srgb(x: f32) -> f32 {
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Derivative of [`srgb_from_linear`].
#[must_use]
pub fn srgb_slope(x: f32) -> f32 {
    if x <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * x.powf(1.0 / 2.4 - 1.0) }
}

/// Derivative of [`linear_from_srgb`].
#[must_use]
pub fn linear_slope(x: f32) -> f32 {
    if x <= 0.040_45 { 1.0 / 12.92 } else { 2.4 / 1.055 * ((x + 0.055) / 1.055).powf(1.4) }
}

/// 8-bit sRGB code of a linear value, rounded, clipped to [0, 1]; NaN gives 0.
#[must_use]
pub fn srgb8_from_linear(x: f32) -> u8 {
    // `as` saturates and sends NaN to 0.
    (srgb_from_linear(x.clamp(0.0, 1.0)) * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the pair inverts itself on [-0.1, 50], all 8-bit codes round-trip, slopes match differences.
    #[test]
    fn round_trips_and_slopes() {
        for i in -10..5000 {
            let x = i as f32 * 0.01;
            let y = linear_from_srgb(srgb_from_linear(x));
            assert!((x - y).abs() <= 1e-5 * x.abs().max(1.0), "{x} {y}");
        }
        for code in 0..=255u8 {
            assert_eq!(srgb8_from_linear(linear_from_srgb(f32::from(code) / 255.0)), code);
        }
        for x in [0.001f32, 0.02, 0.5, 3.0] {
            let h = 1e-3 * x;
            let d = (srgb_from_linear(x + h) - srgb_from_linear(x - h)) / (2.0 * h);
            assert!((d / srgb_slope(x) - 1.0).abs() < 5e-3);
            let d = (linear_from_srgb(x + h) - linear_from_srgb(x - h)) / (2.0 * h);
            assert!((d / linear_slope(x) - 1.0).abs() < 5e-3);
        }
        assert_eq!(srgb8_from_linear(f32::NAN), 0);
    }
}
