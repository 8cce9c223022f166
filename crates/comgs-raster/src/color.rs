//! A surfel's radiance towards the camera from its spherical harmonics, and its gradient.

use comgs_geom::sh;
use comgs_image::transfer;
use comgs_surfel::ColorEncoding;
use glam::Vec3;

/// Radiance (linear RGB, ≥ 0) along the unit direction `d` from the eye to the surfel.
///
/// `Σ_k Y_k(d) h_k + ½`, clamped at 0, through the EOTF when the encoding is sRGB. Differentiable except where the
/// clamp begins; gradient: [`radiance_vjp`].
#[must_use]
#[inline]
pub fn radiance(harmonics: &[f32], degree: usize, encoding: ColorEncoding, d: Vec3) -> [f32; 3] {
    let sum = harmonic_sum(harmonics, &sh::basis(degree, d));
    sum.map(|s| {
        let positive = s.max(0.0);
        match encoding {
            ColorEncoding::Linear => positive,
            ColorEncoding::Srgb => transfer::linear_from_srgb(positive),
        }
    })
}

#[inline]
fn harmonic_sum(harmonics: &[f32], basis: &[f32; sh::MAX_COEFFICIENTS]) -> [f32; 3] {
    let mut sum = [0.5f32; 3];
    for (k, h) in harmonics.chunks_exact(3).enumerate() {
        for c in 0..3 {
            sum[c] += basis[k] * h[c];
        }
    }
    sum
}

/// Gradient of [`radiance`]: adds to `grad_harmonics` and returns the gradient with respect to the offset
/// `position − eye`, of which `d` is the direction and `distance` the length.
#[must_use]
#[inline]
pub fn radiance_vjp(
    harmonics: &[f32],
    degree: usize,
    encoding: ColorEncoding,
    d: Vec3,
    distance: f32,
    grad_radiance: [f32; 3],
    grad_harmonics: &mut [f32],
) -> Vec3 {
    let basis = sh::basis(degree, d);
    let sum = harmonic_sum(harmonics, &basis);
    let mut g = [0.0f32; 3];
    for c in 0..3 {
        // The clamp passes the gradient only where it does not bite.
        if sum[c] > 0.0 {
            g[c] = grad_radiance[c]
                * match encoding {
                    ColorEncoding::Linear => 1.0,
                    ColorEncoding::Srgb => transfer::linear_slope(sum[c]),
                };
        }
    }
    for (k, out) in grad_harmonics.chunks_exact_mut(3).enumerate() {
        for c in 0..3 {
            out[c] += basis[k] * g[c];
        }
    }
    if degree == 0 {
        return Vec3::ZERO;
    }
    let slopes = sh::basis_gradient(degree, d);
    let mut grad_d = Vec3::ZERO;
    for (k, h) in harmonics.chunks_exact(3).enumerate().skip(1) {
        grad_d += slopes[k] * (h[0] * g[0] + h[1] * g[1] + h[2] * g[2]);
    }
    // d = offset / |offset|: only the part across the direction survives.
    (grad_d - d * d.dot(grad_d)) / distance.max(1e-20)
}
