//! The monotonic rational-quadratic spline (Gregory & Delbourgo 1982; as a learnable function Durkan et al. 2019,
//! "Neural Spline Flows", Eq. 4–5) from [0, 1] onto [0, 1].
//!
//! Within a bin of width w and height h, with ξ = (x − x₀)/w, s = h/w and slopes d₀, d₁ at its ends,
//!
//! ```text
//! y = y₀ + h (s ξ² + d₀ ξ(1−ξ)) / (s + (d₁ + d₀ − 2s) ξ(1−ξ))
//! ```
//!
//! which rises for any positive h, d₀ and d₁. Widths and heights are softmaxes of parameters, slopes exponentials, so
//! every parameter vector is a monotonic curve, and the zero vector is the identity.

/// Bins K_s (DiPIR Sec. 4.1).
pub const BINS: usize = 5;

/// Parameters of a curve: widths, heights, and the slopes at all knots.
pub const PARAMETERS: usize = 3 * BINS + 1;

/// Least width and height of a bin: a flatter one could hide all of its input in one output.
const LEAST: f32 = 1e-2;

/// A curve, tabulated from its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Spline {
    /// Abscissae of the knots, from 0 to 1.
    pub x: [f32; BINS + 1],
    /// Ordinates of the knots, from 0 to 1.
    pub y: [f32; BINS + 1],
    /// Slopes at the knots, > 0.
    pub slope: [f32; BINS + 1],
    width_share: [f32; BINS],
    height_share: [f32; BINS],
}

/// Sums of the gradient with respect to widths, heights and slopes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplineGradient {
    /// By bin width.
    pub width: [f32; BINS],
    /// By bin height.
    pub height: [f32; BINS],
    /// By slope.
    pub slope: [f32; BINS + 1],
}

impl SplineGradient {
    /// Adds another sum.
    pub fn add(&mut self, other: &Self) {
        for k in 0..BINS {
            self.width[k] += other.width[k];
            self.height[k] += other.height[k];
        }
        for k in 0..=BINS {
            self.slope[k] += other.slope[k];
        }
    }
}

fn softmax(raw: &[f32]) -> [f32; BINS] {
    let largest = raw.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut out = [0.0; BINS];
    for (o, r) in out.iter_mut().zip(raw) {
        *o = (r - largest).exp();
    }
    let sum: f32 = out.iter().sum();
    out.map(|v| v / sum)
}

/// Knots from shares, ending with exactly 1.
fn knots(shares: &[f32; BINS]) -> [f32; BINS + 1] {
    let mut out = [0.0; BINS + 1];
    for k in 0..BINS {
        out[k + 1] = out[k] + LEAST + (1.0 - BINS as f32 * LEAST) * shares[k];
    }
    out[BINS] = 1.0;
    out
}

/// What one evaluation and its gradient share.
struct Bin {
    k: usize,
    width: f32,
    height: f32,
    s: f32,
    xi: f32,
    /// ξ(1 − ξ).
    b: f32,
    numerator: f32,
    denominator: f32,
}

impl Spline {
    /// The curve of `[widths; heights; slopes]`, each as it enters its softmax or exponential.
    #[must_use]
    pub fn new(parameters: &[f32; PARAMETERS]) -> Self {
        let width_share = softmax(&parameters[..BINS]);
        let height_share = softmax(&parameters[BINS..2 * BINS]);
        let mut slope = [1.0; BINS + 1];
        for (s, p) in slope.iter_mut().zip(&parameters[2 * BINS..]) {
            // Bounded, so that a step too far does not overflow.
            *s = p.clamp(-8.0, 8.0).exp();
        }
        Self { x: knots(&width_share), y: knots(&height_share), slope, width_share, height_share }
    }

    fn bin(&self, x: f32) -> Bin {
        let x = x.clamp(0.0, 1.0);
        let k = self.x[1..BINS].partition_point(|&knot| knot <= x);
        let (width, height) = (self.x[k + 1] - self.x[k], self.y[k + 1] - self.y[k]);
        let (d0, d1) = (self.slope[k], self.slope[k + 1]);
        let s = height / width;
        let xi = ((x - self.x[k]) / width).clamp(0.0, 1.0);
        let b = xi * (1.0 - xi);
        let (numerator, denominator) = (s * xi * xi + d0 * b, s + (d1 + d0 - 2.0 * s) * b);
        Bin { k, width, height, s, xi, b, numerator, denominator }
    }

    /// y in [0, 1]; x is clamped to [0, 1].
    #[must_use]
    pub fn value(&self, x: f32) -> f32 {
        let bin = self.bin(x);
        (self.y[bin.k] + bin.height * bin.numerator / bin.denominator).min(self.y[bin.k + 1])
    }

    /// dy/dx > 0, inside [0, 1]:
    /// `s² (d₁ ξ² + 2 s ξ(1−ξ) + d₀ (1−ξ)²) / (s + (d₁ + d₀ − 2s) ξ(1−ξ))²`.
    #[must_use]
    pub fn derivative(&self, x: f32) -> f32 {
        self.derivative_in(&self.bin(x))
    }

    fn derivative_in(&self, bin: &Bin) -> f32 {
        let (d0, d1) = (self.slope[bin.k], self.slope[bin.k + 1]);
        let rest = 1.0 - bin.xi;
        bin.s * bin.s * (d1 * bin.xi * bin.xi + 2.0 * bin.s * bin.b + d0 * rest * rest)
            / (bin.denominator * bin.denominator)
    }

    /// Gradient with respect to x for `grad` with respect to y; that with respect to the curve is added to `out`.
    /// Differentiable in x on (0, 1); 0 outside, where x is clamped.
    pub fn vjp(&self, x: f32, grad: f32, out: &mut SplineGradient) -> f32 {
        let bin = self.bin(x);
        let Bin { k, width, height, s, xi, b, numerator, denominator } = bin;
        let slope = self.derivative_in(&bin);
        let per = height / (denominator * denominator);
        let by_s = per * (xi * xi * denominator - numerator * (1.0 - 2.0 * b));
        out.slope[k] += grad * per * b * (denominator - numerator);
        out.slope[k + 1] -= grad * per * b * numerator;
        // A knot's place is the sum of the widths (heights) before it.
        for j in 0..k {
            out.width[j] -= grad * slope;
            out.height[j] += grad;
        }
        out.width[k] -= grad * (by_s * s / width + slope * xi);
        out.height[k] += grad * (numerator / denominator + by_s / width);
        if (0.0..=1.0).contains(&x) { grad * slope } else { 0.0 }
    }

    /// Gradient with respect to the parameters from that with respect to widths, heights and slopes.
    #[must_use]
    pub fn parameter_gradient(&self, grad: &SplineGradient) -> [f32; PARAMETERS] {
        let mut out = [0.0; PARAMETERS];
        let shares = [(&self.width_share, &grad.width), (&self.height_share, &grad.height)];
        for (part, (share, grad)) in shares.into_iter().enumerate() {
            let mean: f32 = share.iter().zip(grad).map(|(p, g)| p * g).sum();
            for k in 0..BINS {
                out[part * BINS + k] = (1.0 - BINS as f32 * LEAST) * share[k] * (grad[k] - mean);
            }
        }
        for k in 0..=BINS {
            out[2 * BINS + k] = grad.slope[k] * self.slope[k];
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use comgs_geom::Rng;

    fn wild(rng: &mut Rng) -> [f32; PARAMETERS] {
        std::array::from_fn(|_| 1.5 * rng.normal())
    }

    /// Goal: the zero vector is the identity, with slope 1 everywhere.
    #[test]
    fn zero_is_identity() {
        let curve = Spline::new(&[0.0; PARAMETERS]);
        for i in 0..=1000 {
            let x = i as f32 / 1000.0;
            assert!((curve.value(x) - x).abs() < 1e-6 && (curve.derivative(x) - 1.0).abs() < 1e-5);
        }
    }

    /// Goal: any parameters give a curve from 0 to 1 that rises, with the derivative of finite differences.
    #[test]
    fn every_curve_rises() {
        let mut rng = Rng::new(6);
        for _ in 0..200 {
            let curve = Spline::new(&wild(&mut rng));
            assert_eq!((curve.value(0.0), curve.value(1.0)), (0.0, 1.0));
            let mut last = 0.0;
            for i in 1..=2000 {
                let x = i as f32 / 2000.0;
                let y = curve.value(x);
                assert!(y >= last && curve.derivative(x) > 0.0, "{y} after {last} at {x}");
                last = y;
            }
        }
    }

    /// Goal: value, derivative in x and the gradient in all sixteen parameters agree with the f64 reference.
    #[test]
    fn gradient_by_finite_differences() {
        let mut rng = Rng::new(7);
        for round in 0..8 {
            let parameters = wild(&mut rng).map(|p| 0.5 * p);
            let curve = Spline::new(&parameters);
            let points: Vec<(f32, f32)> = (0..40).map(|_| (rng.uniform(), rng.normal())).collect();
            let mut sums = SplineGradient::default();
            let p: Vec<f64> = parameters.iter().map(|&p| f64::from(p)).collect();
            for &(x, g) in &points {
                let dx = curve.vjp(x, g, &mut sums);
                let (x, g) = (f64::from(x), f64::from(g));
                assert!((reference::spline(&p, x) - f64::from(curve.value(x as f32))).abs() < 1e-5);
                let d = 1e-6;
                let difference =
                    g * (reference::spline(&p, x + d) - reference::spline(&p, x - d)) / (2.0 * d);
                assert!(
                    (difference - f64::from(dx)).abs() < 2e-3 * difference.abs().max(1.0),
                    "round {round} at {x}: {dx} {difference}"
                );
            }
            let loss = |p: &[f64]| {
                points.iter().map(|&(x, g)| f64::from(g) * reference::spline(p, f64::from(x))).sum()
            };
            reference::assert_gradient(&p, &curve.parameter_gradient(&sums), loss, 2e-3);
        }
    }

    /// Goal: what is not in [0, 1], NaN and infinities included, gives a value in [0, 1] or NaN for NaN, and no panic.
    #[test]
    fn poison() {
        let curve = Spline::new(&wild(&mut Rng::new(8)));
        for x in [f32::NEG_INFINITY, -1.0, -0.0, 1.5, f32::MAX, f32::INFINITY, f32::MIN_POSITIVE] {
            assert!((0.0..=1.0).contains(&curve.value(x)), "{x}");
        }
        let _ = curve.value(f32::NAN);
        let far = Spline::new(&[1e30; PARAMETERS]);
        assert!((0.0..=1.0).contains(&far.value(0.3)));
    }
}
