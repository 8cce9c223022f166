//! From raw parameters to what they mean.

/// Logistic sigmoid, finite for every finite input and for ±∞. Inverse: [`logit`].
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Inverse of [`sigmoid`]; the argument is clamped to `[1e-6, 1 − 1e-6]`.
#[must_use]
pub fn logit(p: f32) -> f32 {
    let p = p.clamp(1e-6, 1.0 - 1e-6);
    (p / (1.0 - p)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: inverse pair, and no NaN at the ends.
    #[test]
    fn sigmoid_and_logit() {
        for p in [0.001f32, 0.3, 0.999] {
            assert!((sigmoid(logit(p)) - p).abs() < 1e-6);
        }
        assert_eq!(sigmoid(f32::INFINITY), 1.0);
        assert_eq!(sigmoid(f32::NEG_INFINITY), 0.0);
        assert!(logit(0.0).is_finite() && logit(1.0).is_finite());
    }
}
