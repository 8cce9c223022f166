//! Lens models of photographs: how an ideal pinhole position is bent by the glass, and back.
//!
//! All models act on *normalised* image coordinates `(x, y) = (X/Z, Y/Z)` of the camera's OpenCV axes, so they do
//! not depend on the resolution. Renderers never see a lens: photographs are straightened on load.

use glam::{DMat2, DVec2};
use serde::{Deserialize, Serialize};

/// A lens model.
///
/// COLMAP's `SIMPLE_PINHOLE` and `PINHOLE` are [`Lens::Pinhole`]; `SIMPLE_RADIAL`, `RADIAL`, `OPENCV` and
/// `FULL_OPENCV` are [`Lens::OpenCv`] with the missing coefficients zero; `SIMPLE_RADIAL_FISHEYE`,
/// `RADIAL_FISHEYE` and `OPENCV_FISHEYE` are [`Lens::Fisheye`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Lens {
    /// No distortion.
    #[default]
    Pinhole,
    /// Radial and tangential distortion as OpenCV's `projectPoints` defines it:
    /// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, and
    /// `y'` likewise with `p1 (r² + 2 y²) + 2 p2 x y`.
    OpenCv {
        /// Radial coefficients k1 to k6.
        k: [f64; 6],
        /// Tangential coefficients p1 and p2.
        p: [f64; 2],
    },
    /// Equidistant fisheye as OpenCV's `fisheye` defines it: with `θ = atan r`, the distorted radius is
    /// `θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`.
    Fisheye {
        /// Coefficients k1 to k4.
        k: [f64; 4],
    },
}

/// Residual (in normalised coordinates) that Newton's method must reach.
const TOLERANCE: f64 = 1e-12;

impl Lens {
    /// An OpenCV lens; all coefficients zero give [`Lens::Pinhole`].
    #[must_use]
    pub fn open_cv(k: [f64; 6], p: [f64; 2]) -> Self {
        if k == [0.0; 6] && p == [0.0; 2] { Self::Pinhole } else { Self::OpenCv { k, p } }
    }

    /// Whether the lens bends nothing.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        *self == Self::Pinhole
    }

    /// Whether all coefficients are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        match self {
            Self::Pinhole => true,
            Self::OpenCv { k, p } => k.iter().chain(p).all(|v| v.is_finite()),
            Self::Fisheye { k } => k.iter().all(|v| v.is_finite()),
        }
    }

    /// Where the lens images the ideal (pinhole) position `ideal`. Normalised coordinates both.
    ///
    /// Beyond [`Lens::valid_radius`] the polynomial runs backwards and the result means nothing. Differentiable;
    /// derivative: [`Lens::jacobian`]. Inverse: [`Lens::undistort`].
    #[must_use]
    pub fn distort(&self, ideal: DVec2) -> DVec2 {
        match *self {
            Self::Pinhole => ideal,
            Self::OpenCv { k, p } => {
                let (x, y) = (ideal.x, ideal.y);
                let s = ideal.length_squared();
                let radial = open_cv_ratio(&k, s);
                DVec2::new(
                    x * radial + 2.0 * p[0] * x * y + p[1] * (s + 2.0 * x * x),
                    y * radial + p[0] * (s + 2.0 * y * y) + 2.0 * p[1] * x * y,
                )
            }
            Self::Fisheye { k } => {
                let r = ideal.length();
                if r < 1e-12 { ideal } else { ideal * (fisheye_radius(&k, r.atan()) / r) }
            }
        }
    }

    /// Derivative of [`Lens::distort`] at `ideal`; columns are ∂/∂x and ∂/∂y.
    #[must_use]
    pub fn jacobian(&self, ideal: DVec2) -> DMat2 {
        let (x, y) = (ideal.x, ideal.y);
        let s = ideal.length_squared();
        // For a purely radial map x ↦ x g(s): J = g I + 2 g' x xᵀ.
        let radial = |g: f64, slope: f64| {
            DMat2::from_cols(
                DVec2::new(g + 2.0 * slope * x * x, 2.0 * slope * x * y),
                DVec2::new(2.0 * slope * x * y, g + 2.0 * slope * y * y),
            )
        };
        match *self {
            Self::Pinhole => DMat2::IDENTITY,
            Self::OpenCv { k, p } => {
                let (n, dn) = cubic(&[k[0], k[1], k[2]], s);
                let (d, dd) = cubic(&[k[3], k[4], k[5]], s);
                let tangential = DMat2::from_cols(
                    DVec2::new(2.0 * p[0] * y + 6.0 * p[1] * x, 2.0 * p[0] * x + 2.0 * p[1] * y),
                    DVec2::new(2.0 * p[0] * x + 2.0 * p[1] * y, 6.0 * p[0] * y + 2.0 * p[1] * x),
                );
                radial(n / d, (dn * d - n * dd) / (d * d)) + tangential
            }
            Self::Fisheye { k } => {
                let r = s.sqrt();
                if r < 1e-6 {
                    return DMat2::IDENTITY;
                }
                let theta = r.atan();
                let g = fisheye_radius(&k, theta) / r;
                // g(s) = ρ(θ)/r, so dg/ds = (ρ'(θ) θ'(r) − g)/(2 s), with θ'(r) = 1/(1 + s).
                radial(g, (fisheye_slope(&k, theta) / (1.0 + s) - g) / (2.0 * s))
            }
        }
    }

    /// Ideal radius up to which the radial part is strictly increasing; infinite when it always is.
    ///
    /// Fitted polynomials often turn round outside the photograph they were fitted to. Positions beyond are
    /// imaged a second time *inside* the photograph, which would give ghost images when it is straightened.
    /// Exact for the radial part: the smallest positive root of its derivative (or pole).
    #[must_use]
    pub fn valid_radius(&self) -> f64 {
        match *self {
            Self::Pinhole => f64::INFINITY,
            Self::OpenCv { k, .. } => {
                // With s = r², f(r) = r N(s)/D(s): f' vanishes where N D + 2 s (N' D − N D') does.
                let n = [1.0, k[0], k[1], k[2]];
                let d = [1.0, k[3], k[4], k[5]];
                let mut derivative = [0.0; 7];
                for (i, a) in n.iter().enumerate() {
                    for (j, b) in d.iter().enumerate() {
                        derivative[i + j] += a * b * (1.0 + 2.0 * (i as f64 - j as f64));
                    }
                }
                first_positive_root(&derivative).min(first_positive_root(&d)).sqrt()
            }
            Self::Fisheye { k } => {
                let derivative = [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]];
                let theta = first_positive_root(&derivative).sqrt();
                if theta < std::f64::consts::FRAC_PI_2 { theta.tan() } else { f64::INFINITY }
            }
        }
    }

    /// The ideal position whose image is `distorted`; inverse of [`Lens::distort`].
    ///
    /// The radius is bracketed and found first, then Newton's method adds the tangential part.
    /// `None` where no ideal position on the near side of the fold ([`Lens::valid_radius`]) has this image: past the
    /// rim of the fold, for non-finite input, or (fisheye) at 90° and more from the axis, where a pinhole
    /// image has no place.
    #[must_use]
    pub fn undistort(&self, distorted: DVec2) -> Option<DVec2> {
        if !distorted.is_finite() || !self.is_finite() {
            return None;
        }
        if self.is_pinhole() {
            return Some(distorted);
        }
        let limit = self.valid_radius();
        let target = distorted.length();
        if target < 1e-12 && matches!(self, Self::Fisheye { .. }) {
            return Some(distorted);
        }
        let start = self.undistort_radius(target, limit)?;
        let mut ideal = if target > 0.0 { distorted * (start / target) } else { distorted };
        if matches!(self, Self::OpenCv { p, .. } if *p != [0.0; 2]) {
            for _ in 0..50 {
                let residual = self.distort(ideal) - distorted;
                if residual.length() <= TOLERANCE * (1.0 + target) {
                    break;
                }
                let jacobian = self.jacobian(ideal);
                if !(jacobian.determinant() > 1e-9) {
                    return None;
                }
                ideal -= jacobian.inverse() * residual;
            }
        }
        let good = ideal.is_finite()
            && ideal.length() < limit
            && self.jacobian(ideal).determinant() > 0.0
            && (self.distort(ideal) - distorted).length() <= 1e-9 * (1.0 + target);
        good.then_some(ideal)
    }

    /// Radial image of an ideal radius.
    fn distorted_radius(&self, r: f64) -> f64 {
        match self {
            Self::Pinhole => r,
            Self::OpenCv { k, .. } => r * open_cv_ratio(k, r * r),
            Self::Fisheye { k } => fisheye_radius(k, r.atan()),
        }
    }

    /// Ideal radius below `limit` whose radial image is `target`. Without a fold a purely radial target may still be
    /// out of reach (a fisheye's 90°, a rational model's asymptote); then, as for a target past the fold, `None`.
    /// A target slightly past the rim is given the rim, because the tangential part may bring it back.
    fn undistort_radius(&self, target: f64, limit: f64) -> Option<f64> {
        let mut high = limit;
        if !high.is_finite() {
            high = target.max(1.0);
            while self.distorted_radius(high) <= target {
                high *= 2.0;
                if high > 1e8 {
                    return None;
                }
            }
        }
        let rim = self.distorted_radius(high);
        if target >= rim {
            return (target < rim * 1.02 && limit.is_finite()).then_some(high * 0.99);
        }
        // Bisection to the last bit: monotone on the bracket, so it cannot leave it as Newton's method could.
        let mut low = 0.0;
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if self.distorted_radius(middle) < target { low = middle } else { high = middle }
        }
        Some(0.5 * (low + high))
    }
}

/// `1 + c₁ s + c₂ s² + c₃ s³` and its derivative.
fn cubic(c: &[f64; 3], s: f64) -> (f64, f64) {
    (1.0 + s * (c[0] + s * (c[1] + s * c[2])), c[0] + s * (2.0 * c[1] + s * 3.0 * c[2]))
}

fn open_cv_ratio(k: &[f64; 6], s: f64) -> f64 {
    cubic(&[k[0], k[1], k[2]], s).0 / cubic(&[k[3], k[4], k[5]], s).0
}

fn fisheye_radius(k: &[f64; 4], theta: f64) -> f64 {
    let s = theta * theta;
    theta * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
}

fn fisheye_slope(k: &[f64; 4], theta: f64) -> f64 {
    let s = theta * theta;
    1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))
}

/// Smallest positive root of `Σ c[i] xⁱ`; infinite when there is none.
fn first_positive_root(coefficients: &[f64]) -> f64 {
    positive_roots(coefficients).first().copied().unwrap_or(f64::INFINITY)
}

/// Positive roots at which a polynomial changes sign, ascending. Between two neighbouring roots of its derivative
/// a polynomial is monotone, so every root is bracketed by those of the derivative, found the same way.
fn positive_roots(coefficients: &[f64]) -> Vec<f64> {
    let degree = coefficients.iter().rposition(|&c| c != 0.0).unwrap_or(0);
    let coefficients = &coefficients[..=degree.min(coefficients.len() - 1)];
    if degree == 0 {
        return Vec::new();
    }
    let value = |x: f64| coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c);
    let derivative: Vec<f64> = coefficients.iter().enumerate().skip(1).map(|(i, c)| i as f64 * c).collect();
    // Cauchy's bound on the roots. A leading coefficient of almost nothing pushes it out; values stay comparable.
    let lead = coefficients[degree].abs();
    let bound = 1.0 + coefficients[..degree].iter().fold(0.0f64, |a, c| a.max(c.abs() / lead));
    let mut brackets = vec![0.0];
    brackets.extend(positive_roots(&derivative).into_iter().filter(|&r| r < bound));
    brackets.push(bound);
    let mut roots = Vec::new();
    for pair in brackets.windows(2) {
        let (mut low, mut high) = (pair[0], pair[1]);
        let rising = value(low) < 0.0;
        if rising == (value(high) < 0.0) {
            continue;
        }
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if (value(middle) < 0.0) == rising { low = middle } else { high = middle }
        }
        roots.push(0.5 * (low + high));
    }
    roots
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The phone lens of a real capture, a strong rational lens, a wide action camera, and a fisheye.
    fn lenses() -> [Lens; 4] {
        [
            Lens::open_cv([0.0578421, -0.0805099, 0.0, 0.0, 0.0, 0.0], [-0.000980296, 0.00015575]),
            Lens::open_cv([0.9, 0.4, 0.02, 1.2, 0.5, 0.05], [0.001, -0.002]),
            Lens::open_cv([-0.3, 0.11, -0.02, 0.0, 0.0, 0.0], [0.0, 0.0]),
            Lens::Fisheye { k: [-0.02, 0.004, -0.001, 0.0002] },
        ]
    }

    /// Goal: undistort inverts distort over the whole valid disc.
    #[test]
    fn undistort_inverts_distort() {
        for lens in lenses() {
            let limit = lens.valid_radius().min(1.2) * 0.97;
            for i in 0..40 {
                for a in 0..12 {
                    let (r, phi) = (limit * f64::from(i) / 40.0, 0.55 * f64::from(a));
                    let ideal = DVec2::new(r * phi.cos(), r * phi.sin());
                    if lens.jacobian(ideal).determinant() < 0.02 {
                        continue;
                    }
                    let back = lens.undistort(lens.distort(ideal)).expect("inside the valid radius");
                    assert!((back - ideal).length() < 1e-8, "{lens:?} at {ideal}: {back}");
                }
            }
        }
    }

    /// Goal: the Jacobian is the derivative, by central differences.
    #[test]
    fn jacobian_is_the_derivative() {
        let h = 1e-6;
        for lens in lenses() {
            for ideal in [DVec2::new(0.3, -0.2), DVec2::new(-0.5, 0.41), DVec2::new(1e-4, 0.0)] {
                let jacobian = lens.jacobian(ideal);
                for (axis, column) in [(DVec2::X, jacobian.x_axis), (DVec2::Y, jacobian.y_axis)] {
                    let difference =
                        (lens.distort(ideal + axis * h) - lens.distort(ideal - axis * h)) / (2.0 * h);
                    assert!((difference - column).length() < 1e-7, "{lens:?} {ideal} {difference} {column}");
                }
            }
        }
    }

    /// Goal: where the model folds over there is no answer, rather than one from beyond the fold. For
    /// `r(1 − 0.3 r²)` the fold is known on paper: r = √(1/0.9), image 2/3 of that.
    #[test]
    fn folded_positions_are_refused() {
        let lens = Lens::open_cv([-0.3, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]);
        let fold = (1.0f64 / 0.9).sqrt();
        assert!((lens.valid_radius() - fold).abs() < 1e-12);
        let rim = fold * 2.0 / 3.0;
        assert!(lens.undistort(DVec2::new(rim * 0.999, 0.0)).unwrap().x < fold);
        assert_eq!(lens.undistort(DVec2::new(rim * 1.001, 0.0)), None);
        assert_eq!(lens.undistort(DVec2::new(3.0, 3.0)), None);
        // The map rises again beyond this fold (k2 > 0): Newton's method alone would land on the far branch.
        let wavy = Lens::open_cv([-0.6, 0.15, 0.0, 0.0, 0.0, 0.0], [0.0; 2]);
        assert!(wavy.valid_radius() < 1.2);
        assert_eq!(wavy.undistort(DVec2::new(3.0, 0.0)), None);
        assert!(wavy.distort(DVec2::new(3.0, 0.0)).x > 3.0, "the far branch exists");
        assert_eq!(lens.undistort(DVec2::new(f64::NAN, 0.0)), None);
        assert_eq!(Lens::Fisheye { k: [f64::NAN; 4] }.undistort(DVec2::ZERO), None);
    }

    /// Goal: an ideal equidistant fisheye images 45° at radius π/4, and has no pinhole position at 90°.
    #[test]
    fn fisheye_on_paper() {
        let lens = Lens::Fisheye { k: [0.0; 4] };
        let quarter = std::f64::consts::FRAC_PI_4;
        assert!((lens.distort(DVec2::new(0.0, 1.0)) - DVec2::new(0.0, quarter)).length() < 1e-15);
        assert!((lens.undistort(DVec2::new(quarter, 0.0)).unwrap().x - 1.0).abs() < 1e-9);
        assert_eq!(lens.undistort(DVec2::new(1.6, 0.0)), None);
        assert_eq!(lens.valid_radius(), f64::INFINITY);
        assert!(lens.undistort(DVec2::ZERO).is_some());
    }

    /// Goal: root isolation on polynomials with known roots.
    #[test]
    fn roots_of_known_polynomials() {
        // (x − 0.5)(x − 2)(x + 3) = x³ + 0.5 x² − 6.5 x + 3
        let roots = positive_roots(&[3.0, -6.5, 0.5, 1.0]);
        assert_eq!(roots.len(), 2);
        assert!((roots[0] - 0.5).abs() < 1e-12 && (roots[1] - 2.0).abs() < 1e-12);
        assert_eq!(first_positive_root(&[1.0, 0.0, 1.0]), f64::INFINITY);
        assert_eq!(first_positive_root(&[1.0]), f64::INFINITY);
        assert_eq!(first_positive_root(&[0.0, 0.0]), f64::INFINITY);
    }
}
