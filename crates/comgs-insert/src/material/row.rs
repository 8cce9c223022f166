//! One row's radiance from a part's material, and its gradient.

use super::PARAMETERS;
use crate::object::Factors;
use crate::transport::{LobeRow, PartShare};
use comgs_light::brdf::DIELECTRIC_F0;

/// One row's radiance for a material, before tone; `roughness` is the place between the two traced ones, in [0, 1]:
///
/// ```text
/// (1 − m) a D + F₀ (S₀ + τ (S₁ − S₀)) + G₀ + τ (G₁ − G₀) + share · e + rest
/// ```
///
/// a is the colour's factor times the row's tint and m the metalness' times the row's, each cut at 1. Gradient:
/// [`row_vjp`].
#[must_use]
pub fn row(lobes: &LobeRow, part: &PartShare, rest: [f32; 3], factors: &Factors, tau: f32) -> [f32; 3] {
    let m = (factors.metallic * part.metallic).min(1.0);
    std::array::from_fn(|c| {
        let a = (factors.albedo[c] * part.tint[c]).min(1.0);
        let f0 = DIELECTRIC_F0 + m * (a - DIELECTRIC_F0);
        let s = lobes[1][c] + tau * (lobes[3][c] - lobes[1][c]);
        let g = lobes[2][c] + tau * (lobes[4][c] - lobes[2][c]);
        (1.0 - m) * a * lobes[0][c] + f0 * s + g + part.share * factors.emission[c] + rest[c]
    })
}

/// Gradients of [`row`] for `grad` with respect to it: those with respect to the parameters are added to `by_parameters`
/// (colour, τ, metalness, emission; 0 where the cut at 1 bites), those with respect to the lobes are returned.
pub fn row_vjp(
    lobes: &LobeRow,
    part: &PartShare,
    factors: &Factors,
    tau: f32,
    grad: [f32; 3],
    by_parameters: &mut [f64; PARAMETERS],
) -> LobeRow {
    let raw_m = factors.metallic * part.metallic;
    let m = raw_m.min(1.0);
    let mut by_m = 0.0;
    let mut out = [[0.0; 3]; 5];
    for c in 0..3 {
        let g = grad[c];
        let raw_a = factors.albedo[c] * part.tint[c];
        let a = raw_a.min(1.0);
        let f0 = DIELECTRIC_F0 + m * (a - DIELECTRIC_F0);
        let s = lobes[1][c] + tau * (lobes[3][c] - lobes[1][c]);
        let by_a = g * ((1.0 - m) * lobes[0][c] + m * s);
        if raw_a < 1.0 {
            by_parameters[c] += f64::from(by_a * part.tint[c]);
        }
        by_m += g * ((a - DIELECTRIC_F0) * s - a * lobes[0][c]);
        let along = f0 * (lobes[3][c] - lobes[1][c]) + lobes[4][c] - lobes[2][c];
        by_parameters[3] += f64::from(g * along);
        by_parameters[5 + c] += f64::from(g * part.share);
        out[0][c] = g * (1.0 - m) * a;
        out[1][c] = g * f0 * (1.0 - tau);
        out[2][c] = g * (1.0 - tau);
        out[3][c] = g * f0 * tau;
        out[4][c] = g * tau;
    }
    if raw_m < 1.0 {
        by_parameters[4] += f64::from(by_m * part.metallic);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use comgs_geom::Rng;
    use glam::Vec3;

    /// Goal: a row is its formula in f64, and its gradients with respect to colour, roughness, metalness and emission and to
    /// the lobes agree with differences.
    #[test]
    fn gradient_by_finite_differences() {
        let mut rng = Rng::new(41);
        let lobes: LobeRow = std::array::from_fn(|_| std::array::from_fn(|_| rng.range(0.1, 2.0)));
        let part = PartShare { share: 0.7, tint: Vec3::new(0.9, 0.5, 0.3), metallic: 0.8 };
        let factors = Factors {
            albedo: Vec3::new(0.6, 0.8, 0.4),
            roughness: 0.4,
            metallic: 0.35,
            emission: Vec3::new(0.1, 0.2, 0.05),
        };
        let rest = [0.3, 0.2, 0.1];
        let grad = [1.0, -0.6, 0.4];
        let tau = 0.3;
        let x: Vec<f64> = [0.6, 0.8, 0.4, tau, 0.35, 0.1, 0.2, 0.05f32]
            .iter()
            .chain(lobes.iter().flatten())
            .map(|&v| f64::from(v))
            .collect();
        let value = |x: &[f64]| reference::part_row(x, 0.7, [0.9, 0.5, 0.3], 0.8, rest.map(f64::from));
        for (ours, truth) in row(&lobes, &part, rest, &factors, tau).iter().zip(value(&x)) {
            assert!((f64::from(*ours) - truth).abs() < 1e-6, "{ours} {truth}");
        }
        let mut by_parameters = [0.0; PARAMETERS];
        let by_lobes = row_vjp(&lobes, &part, &factors, tau, grad, &mut by_parameters);
        let gradient: Vec<f32> =
            by_parameters.iter().map(|g| *g as f32).chain(by_lobes.into_iter().flatten()).collect();
        let loss = |x: &[f64]| value(x).iter().zip(grad).map(|(v, g)| v * f64::from(g)).sum::<f64>();
        reference::assert_gradient(&x, &gradient, loss, 1e-4);
    }

    /// Goal: beyond white there is no colour and beyond metal no metalness to pull on.
    #[test]
    fn cuts_have_no_gradient() {
        let lobes = [[1.0; 3]; 5];
        let part = PartShare { share: 1.0, tint: Vec3::ONE, metallic: 1.0 };
        let factors =
            Factors { albedo: Vec3::splat(2.0), roughness: 0.5, metallic: 3.0, emission: Vec3::ZERO };
        let mut by = [0.0; PARAMETERS];
        row_vjp(&lobes, &part, &factors, 0.5, [1.0; 3], &mut by);
        assert_eq!(by[..5], [0.0; 5]);
        assert_eq!(row(&lobes, &part, [0.0; 3], &factors, 0.5), [2.0; 3]);
    }
}
