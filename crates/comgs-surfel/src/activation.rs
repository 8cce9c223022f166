//! From raw parameters to what they mean.

use std::fmt;

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

/// Largest magnitude of a logit that [`ScaledSigmoid::to_logit`] returns: its sigmoid is 1e-6 away from 0 or 1.
pub const MAX_LOGIT: f32 = 13.8155;

/// `value = scale · sigmoid(x) + offset`, the form in which splatting programs bound what they store. `scale` and
/// `offset` are not negative and their sum is at most 1, so values lie in [0, 1]. It is written as its formula.
///
/// Kinks: none; [`ScaledSigmoid::to_logit`] is clamped at ±[`MAX_LOGIT`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScaledSigmoid {
    /// Width of the range of values.
    pub scale: f64,
    /// Least value.
    pub offset: f64,
}

impl ScaledSigmoid {
    /// The sigmoid itself, as comgs stores material.
    pub const PLAIN: Self = Self { scale: 1.0, offset: 0.0 };

    /// What the raw number `x` means.
    #[must_use]
    pub fn value(self, x: f32) -> f64 {
        self.scale / (1.0 + f64::from(-x).exp()) + self.offset
    }

    /// The logit whose plain [`sigmoid`] is [`ScaledSigmoid::value`], within 1e-6 of it, clamped to ±[`MAX_LOGIT`].
    /// The plain sigmoid keeps raw numbers in this range as they are. NaN stays NaN.
    #[must_use]
    pub fn to_logit(self, x: f32) -> f32 {
        let raw = if self == Self::PLAIN {
            x
        } else {
            let p = self.value(x);
            (p / (1.0 - p)).ln() as f32
        };
        raw.clamp(-MAX_LOGIT, MAX_LOGIT)
    }
}

impl fmt::Display for ScaledSigmoid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.scale != 1.0 {
            write!(f, "{}·", self.scale)?;
        }
        f.write_str("sigmoid(x)")?;
        if self.offset != 0.0 {
            write!(f, " + {}", self.offset)?;
        }
        Ok(())
    }
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

    /// Goal: the logit of a scaled sigmoid means the same under the plain one, to 1e-6 and f32 rounding, over all raw
    /// numbers and at ±∞; the middle is known on paper.
    #[test]
    fn scaled_sigmoids_become_logits() {
        let base = ScaledSigmoid { scale: 0.77, offset: 0.03 };
        assert!((base.value(0.0) - 0.415).abs() < 1e-12);
        assert_eq!(base.value(f32::INFINITY), 0.77 + 0.03);
        for activation in [base, ScaledSigmoid { scale: 0.9, offset: 0.09 }, ScaledSigmoid::PLAIN] {
            let raw = (-400..=400).map(|i| 0.1 * i as f32);
            for x in raw.chain([f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, 1e-40]) {
                let y = activation.to_logit(x);
                assert!(y.abs() <= MAX_LOGIT, "{activation} at {x}: {y}");
                let off = (f64::from(sigmoid(y)) - activation.value(x)).abs();
                assert!(off < 1.2e-6, "{activation} at {x}: off by {off}");
            }
            assert!(activation.to_logit(f32::NAN).is_nan());
        }
        assert_eq!(ScaledSigmoid::PLAIN.to_logit(-2.5), -2.5);
        assert_eq!(base.to_string(), "0.77·sigmoid(x) + 0.03");
        assert_eq!(ScaledSigmoid::PLAIN.to_string(), "sigmoid(x)");
    }
}
