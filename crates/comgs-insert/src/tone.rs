//! From radiance to the photo's values: a fixed response, then learned corrections (DiPIR Sec. 4.1, "Tone-mapping").

mod spline;

pub use spline::{BINS, PARAMETERS, Spline, SplineGradient};

use comgs_optim::{Adam, AdamConfig};
use serde::{Deserialize, Serialize};

/// The camera's response before correction. The photo's values are linear (sRGB undone), in [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Response {
    /// Reinhard's `x / (1 + x)`, as the paper has it.
    #[default]
    Reinhard,
    /// `min(x, 1)`: a camera whose highlights are cut off.
    Clip,
}

impl Response {
    /// The response to a radiance ≥ 0, in [0, 1].
    #[must_use]
    pub fn apply(self, x: f32) -> f32 {
        match self {
            Self::Reinhard => x / (1.0 + x),
            Self::Clip => x.min(1.0),
        }
    }

    /// Its slope; 0 where highlights are cut off.
    #[must_use]
    pub fn slope(self, x: f32) -> f32 {
        match self {
            Self::Reinhard => 1.0 / ((1.0 + x) * (1.0 + x)),
            Self::Clip => f32::from(u8::from(x < 1.0)),
        }
    }

    /// The radiance that gives a value in [0, 1]: what a photo says of the light it shows. Values above `most` are taken
    /// as that, because the inverse has no bound (Reinhard) or is unknown above it.
    #[must_use]
    pub fn invert(self, y: f32, most: f32) -> f32 {
        let y = y.clamp(0.0, most);
        match self {
            Self::Reinhard => y / (1.0 - y),
            Self::Clip => y,
        }
    }
}

/// Response and corrections of a photo: one curve for the object, one a channel for the shadow ratio, which is multiplied
/// onto values that are tone-mapped already.
#[derive(Clone, Debug, PartialEq)]
pub struct Tone {
    /// Response to the object's radiance.
    pub response: Response,
    /// Parameters of the object's curve.
    pub foreground: [f32; PARAMETERS],
    /// Parameters of the shadow ratio's curves, by channel.
    pub shadow: [[f32; PARAMETERS]; 3],
}

impl Tone {
    /// No correction: every curve is the identity.
    #[must_use]
    pub fn identity(response: Response) -> Self {
        Self { response, foreground: [0.0; PARAMETERS], shadow: [[0.0; PARAMETERS]; 3] }
    }

    /// The curves, ready to be evaluated.
    #[must_use]
    pub fn curves(&self) -> Curves {
        Curves {
            response: self.response,
            foreground: Spline::new(&self.foreground),
            shadow: self.shadow.map(|p| Spline::new(&p)),
        }
    }

    /// One step of Adam on all four curves (`step` counts from 1); columns in the order of [`CurveGradient::flat`].
    pub fn step(&mut self, adam: &mut Adam, grad: &[f32], rate: f32, step: u32) -> usize {
        let mut all: Vec<f32> = self.foreground.iter().chain(self.shadow.iter().flatten()).copied().collect();
        let dropped = adam.step(&mut all, grad, rate, step, &AdamConfig::default());
        self.foreground.copy_from_slice(&all[..PARAMETERS]);
        for (c, curve) in self.shadow.iter_mut().enumerate() {
            curve.copy_from_slice(&all[(c + 1) * PARAMETERS..(c + 2) * PARAMETERS]);
        }
        dropped
    }
}

/// A [`Tone`] with its curves tabulated.
#[derive(Clone, Debug)]
pub struct Curves {
    /// Response to the object's radiance.
    pub response: Response,
    /// The object's curve.
    pub foreground: Spline,
    /// The shadow ratio's curves.
    pub shadow: [Spline; 3],
}

/// Sums of the gradient with respect to the curves' knots.
#[derive(Clone, Debug, Default)]
pub struct CurveGradient {
    /// Of the object's curve.
    pub foreground: SplineGradient,
    /// Of the shadow ratio's curves.
    pub shadow: [SplineGradient; 3],
}

impl Curves {
    /// The object's value for a radiance.
    #[must_use]
    pub fn object(&self, radiance: f32) -> f32 {
        self.foreground.value(self.response.apply(radiance.max(0.0)))
    }

    /// Gradient with respect to the radiance; that of the curve is added to `out`.
    pub fn object_vjp(&self, radiance: f32, grad: f32, out: &mut SplineGradient) -> f32 {
        let x = radiance.max(0.0);
        let by_value = self.foreground.vjp(self.response.apply(x), grad, out);
        if radiance < 0.0 { 0.0 } else { by_value * self.response.slope(x) }
    }

    /// The corrected shadow ratio of a channel.
    #[must_use]
    pub fn ratio(&self, channel: usize, ratio: f32) -> f32 {
        self.shadow[channel].value(ratio)
    }
}

impl CurveGradient {
    /// Adds another sum.
    pub fn add(&mut self, other: &Self) {
        self.foreground.add(&other.foreground);
        for (a, b) in self.shadow.iter_mut().zip(&other.shadow) {
            a.add(b);
        }
    }

    /// Gradient with respect to the parameters: the object's curve, then the shadow's three.
    #[must_use]
    pub fn flat(&self, curves: &Curves) -> Vec<f32> {
        let mut out = curves.foreground.parameter_gradient(&self.foreground).to_vec();
        for (curve, grad) in curves.shadow.iter().zip(&self.shadow) {
            out.extend(curve.parameter_gradient(grad));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: both responses and their inverses agree, and the slopes are those of differences.
    #[test]
    fn responses_invert() {
        for response in [Response::Reinhard, Response::Clip] {
            for i in 0..95 {
                let y = i as f32 / 100.0;
                assert!((response.apply(response.invert(y, 0.99)) - y).abs() < 1e-6);
            }
            for x in [0.0f32, 0.3, 0.9, 2.0, 50.0] {
                let d = 1e-3 * x.max(0.1);
                let slope = (response.apply(x + d) - response.apply((x - d).max(0.0))) / (d + d.min(x));
                assert!((slope - response.slope(x)).abs() < 2e-3, "{response:?} {x}");
            }
            assert!(response.invert(1.0, 0.95).is_finite());
        }
    }

    /// Goal: uncorrected curves leave the response and the ratio as they are (their gradient is tested with the composite's).
    #[test]
    fn tone_is_identity_at_first() {
        let curves = Tone::identity(Response::Reinhard).curves();
        for x in [0.0f32, 0.2, 1.0, 7.0] {
            assert!((curves.object(x) - x / (1.0 + x)).abs() < 1e-6);
        }
        for c in 0..3 {
            for k in 0..=10 {
                assert!((curves.ratio(c, k as f32 / 10.0) - k as f32 / 10.0).abs() < 1e-6);
            }
        }
    }
}
