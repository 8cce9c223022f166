//! The scale that photographs cannot tell: a matte surface twice as bright under half the light looks the same.
//!
//! A stated prior pulls gently during the optimisation: the mean albedo (luminance, over the pixels of a step) is near a
//! given value, and the light's mean over the sphere is neutral. Where a dielectric's highlight is in the photos it says
//! more, because its reflectance at normal incidence is 4 % whatever the albedo, and outweighs the prior. In the end
//! an explicit factor or a grey card fixes the scale exactly ([`rescale`]).

use comgs_geom::octahedral;
use comgs_light::{OctahedralLight, luminance};
use comgs_surfel::MaterialColumns;
use comgs_surfel::activation::{logit, sigmoid};
use glam::Vec3;

/// Largest albedo that is stored: logits stay finite and light never vanishes.
pub const MAX_ALBEDO: f32 = 0.98;
/// Least albedo that is stored.
pub const MIN_ALBEDO: f32 = 0.002;

/// Prior on the albedo: `w (ln ā − ln goal)²`, ā the weighted mean luminance of the points' albedos. Returns the value and
/// the gradient with respect to ā's sum, to be multiplied by a point's share of it: ∂/∂albedo_i = g · share_i · (luminance
/// weights).
#[must_use]
pub fn albedo_prior(mean: f32, goal: f32, weight: f32) -> (f32, f32) {
    if !(mean > 0.0) {
        return (0.0, 0.0);
    }
    let d = (mean / goal).ln();
    (weight * d * d, 2.0 * weight * d / mean)
}

/// Luminance weights, as [`comgs_light::luminance`] has them.
pub const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// Share of the sphere of every texel of an octahedral map, for [`neutral_prior`]: its solid angle
/// ([`octahedral::solid_angles`]) over 4π. This is where a texel lies, not what it weighs in an interpolated light; that is
/// [`OctahedralLight::integral`]'s business.
#[must_use]
pub fn texel_shares(size: usize) -> Vec<f32> {
    octahedral::solid_angles(size).iter().map(|angle| angle / (4.0 * std::f32::consts::PI)).collect()
}

/// Prior on the light: `w Σ_c (ln m_c − mean_c ln m_c)²`, m the mean radiance over the sphere by the texels' `shares`.
/// Returns the value and adds the gradient with respect to the texels.
pub fn neutral_prior(light: &OctahedralLight, shares: &[f32], weight: f32, grad_texels: &mut [f32]) -> f32 {
    let mut mean = [0.0f64; 3];
    for (texel, share) in light.texels().chunks_exact(3).zip(shares) {
        for c in 0..3 {
            mean[c] += f64::from(share * texel[c]);
        }
    }
    if mean.iter().any(|m| !(*m > 0.0)) {
        return 0.0;
    }
    let logs = mean.map(f64::ln);
    let middle = logs.iter().sum::<f64>() / 3.0;
    // The derivative of Σ (l_c − l̄)² with respect to l_c is 2 (l_c − l̄): the mean's own part cancels.
    let g: [f32; 3] =
        std::array::from_fn(|c| (2.0 * f64::from(weight) * (logs[c] - middle) / mean[c]) as f32);
    for (grad, share) in grad_texels.chunks_exact_mut(3).zip(shares) {
        for c in 0..3 {
            grad[c] += share * g[c];
        }
    }
    weight * logs.iter().map(|l| (l - middle).powi(2)).sum::<f64>() as f32
}

/// Multiplies albedo by a factor a channel; the light is divided by it elsewhere ([`OctahedralLight::scaled`]). Albedo that would leave its range is clamped; returns how
/// many surfels that touched.
///
/// For a matte surface this leaves every picture as it is. A dielectric's highlight and a metal's colour change with it, as
/// they must when the light was another.
pub fn rescale(material: &mut MaterialColumns, factor: [f32; 3]) -> usize {
    let mut clamped = 0;
    for albedo in &mut material.albedo_logits {
        let scaled: [f32; 3] = std::array::from_fn(|c| sigmoid(albedo[c]) * factor[c]);
        let inside = scaled.map(|a| a.clamp(MIN_ALBEDO, MAX_ALBEDO));
        clamped += usize::from(inside.iter().zip(&scaled).any(|(a, b)| a < b));
        *albedo = inside.map(logit);
    }
    clamped
}

/// Radiance of a constant light under which a surface of the prior's mean albedo is as bright as the photos on average,
/// given the mean radiance of the object.
#[must_use]
pub fn initial_light(mean_radiance: Vec3, albedo_mean: f32) -> f32 {
    (luminance(mean_radiance) / albedo_mean).max(1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the priors' gradients are right (central differences), zero at the goal, and not zero elsewhere.
    #[test]
    fn priors_have_the_right_slope() {
        let (_, g) = albedo_prior(0.5, 0.3, 0.7);
        let slope = (albedo_prior(0.501, 0.3, 0.7).0 - albedo_prior(0.499, 0.3, 0.7).0) / 0.002;
        assert!(g != 0.0 && (g / slope - 1.0).abs() < 1e-3, "{g} {slope}");
        assert!(albedo_prior(0.3, 0.3, 0.7).1.abs() < 1e-6);

        let mut texels = OctahedralLight::constant(16, Vec3::new(1.0, 2.0, 0.7)).texels().to_vec();
        texels[31] = 40.0;
        let with = |i: usize, d: f32| {
            let mut moved = texels.clone();
            moved[i] += d;
            OctahedralLight::from_texels(16, moved).expect("sound texels")
        };
        let light = with(0, 0.0);
        let value = |l: &OctahedralLight| {
            let mut grad = vec![0.0; l.texels().len()];
            (neutral_prior(l, &texel_shares(16), 3.0, &mut grad), grad)
        };
        let (_, grad) = value(&light);
        for i in [0, 31, 100, 301] {
            let step = 0.05;
            let slope = (value(&with(i, step)).0 - value(&with(i, -step)).0) / (2.0 * step);
            // f32 values of about 3 leave 1e-6 of noise in a difference.
            assert!((grad[i] - slope).abs() < 0.05 * slope.abs() + 1e-5, "{i}: {} {slope}", grad[i]);
        }
        let (neutral, grad) = value(&OctahedralLight::constant(16, Vec3::splat(2.0)));
        assert!(neutral.abs() < 1e-9 && grad.iter().all(|g| g.abs() < 1e-6));
    }

    /// Goal: albedos are multiplied, and those that would leave their range are clamped and counted.
    #[test]
    fn rescaling_clamps_and_counts() {
        let mut material = MaterialColumns {
            albedo_logits: vec![[0.2, 0.4, 0.3].map(logit), [0.9; 3].map(logit)],
            metallic_logits: vec![-5.0; 2],
            roughness_logits: vec![0.0; 2],
        };
        let clamped = rescale(&mut material, [2.0, 1.5, 1.0]);
        assert_eq!(clamped, 1);
        let albedo = |i: usize| material.albedo_logits[i].map(sigmoid);
        for (got, expected) in albedo(0).into_iter().zip([0.4, 0.6, 0.3]) {
            assert!((got - expected).abs() < 1e-5);
        }
        for (got, expected) in albedo(1).into_iter().zip([MAX_ALBEDO, MAX_ALBEDO, 0.9]) {
            assert!((got - expected).abs() < 1e-5);
        }
    }
}
