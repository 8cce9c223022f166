//! High dynamic range in codes that a network can hold: a Reinhard-like one that is fine in the dark and a logarithmic
//! one that reaches the sun, and the closed rule that fuses them.

use serde::{Deserialize, Serialize};

/// The two encodings of a pixel-space model. `x` is radiance over its level, 0 or more:
///
/// ```text
/// reinhard = (x / (1 + x)             − offset) / scale
/// log      = (ln(1 + x) / ln(1 + max) − offset) / scale
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Codes {
    /// Radiance is divided so that the geometric mean of what is known becomes this.
    pub middle: f64,
    /// Where the log code reaches 1 (before offset and scale).
    pub brightest: f64,
    /// Offset and scale of the Reinhard code.
    pub reinhard: [f64; 2],
    /// Offset and scale of the log code.
    pub log: [f64; 2],
    /// Below the first the Reinhard code counts, above the second the log code; linear in between.
    pub fuse: [f64; 2],
    /// Reinhard codes (x / (1 + x)) are cut here before they are inverted.
    pub largest_reinhard: f64,
}

impl Codes {
    /// The Reinhard and the log code of `x`.
    #[must_use]
    pub fn encode(&self, x: f64) -> [f64; 2] {
        let x = x.max(0.0);
        [
            (x / (1.0 + x) - self.reinhard[0]) / self.reinhard[1],
            (x.ln_1p() / self.brightest.ln_1p() - self.log[0]) / self.log[1],
        ]
    }

    /// Radiance over its level from the two codes: inverse Reinhard below `fuse[0]` (as the log code tells), the log code
    /// above `fuse[1]`. Inverse of [`Codes::encode`] for x ≤ `brightest`. Continuous; NaN stays NaN.
    #[must_use]
    pub fn decode(&self, [reinhard, log]: [f64; 2]) -> f64 {
        let r = (reinhard * self.reinhard[1] + self.reinhard[0]).clamp(0.0, self.largest_reinhard);
        let l = (log * self.log[1] + self.log[0]).clamp(0.0, 1.0);
        let low = r / (1.0 - r);
        let high = (l * self.brightest.ln_1p()).exp_m1();
        let weight = ((high - self.fuse[0]) / (self.fuse[1] - self.fuse[0])).clamp(0.0, 1.0);
        low + weight * (high - low)
    }

    /// Problems of values read from a file.
    pub(crate) fn problems(&self, out: &mut Vec<String>) {
        let mut check = |fine: bool, what: &str| {
            if !fine {
                out.push(format!("codes.{what}"));
            }
        };
        check(self.middle > 0.0, "middle: expected a positive number");
        check(self.brightest > 1.0, "brightest: expected more than 1");
        check(self.reinhard[1] > 0.0 && self.log[1] > 0.0, "reinhard, log: expected a positive scale");
        check(
            0.0 < self.fuse[0] && self.fuse[0] < self.fuse[1],
            "fuse: expected two rising positive numbers",
        );
        let top = self.largest_reinhard;
        check(0.0 < top && top < 1.0, "largest_reinhard: expected a number between 0 and 1");
        check(self.fuse[1] <= self.brightest, "fuse: expected at most brightest");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CODES: Codes = Codes {
        middle: 0.25,
        brightest: 65536.0,
        reinhard: [0.3, 0.25],
        log: [0.06, 0.1],
        fuse: [8.0, 16.0],
        largest_reinhard: 0.95,
    };

    /// Goal: decoding inverts encoding over ten decades, through the blend as well.
    #[test]
    fn round_trip() {
        for i in 0..200 {
            let x = 10f64.powf(-5.0 + 9.8 * f64::from(i) / 200.0);
            let y = CODES.decode(CODES.encode(x));
            assert!((y - x).abs() < 1e-9 * x.max(1e-3), "{x} became {y}");
        }
        assert!(CODES.decode(CODES.encode(0.0)).abs() < 1e-12);
    }

    /// Goal: codes beyond their range are cut, not extrapolated; NaN is not hidden.
    #[test]
    fn wild_codes() {
        assert!(CODES.decode([100.0, -100.0]) <= 0.95 / 0.05 + 1e-9);
        assert!((CODES.decode([0.0, 100.0]) - 65536.0).abs() < 1e-6 * 65536.0);
        assert!(CODES.decode([f64::NAN, 0.0]).is_nan());
    }
}
