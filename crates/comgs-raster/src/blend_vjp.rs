//! The gradient of [`crate::blend`]: one more front-to-back pass.
//!
//! With g the gradient of the loss with respect to a pixel's planes, let q_i = g·b_i be what surfel i's
//! attributes are worth to the loss. Then
//!
//! ```text
//! ∂L/∂α_i = T_i q_i − (Σ_{j>i} T_j α_j q_j) / (1 − α_i),
//! ```
//!
//! and the sum over the surfels behind is the pixel's total g·B minus the running sum: no stored list and no
//! back-to-front pass is needed.

use crate::blend::{SurfelLanes, TILE_PIXELS, TileInput, groups, initial_transmittance};
use crate::simd::V;
use fearless_simd::Select;
use fearless_simd::prelude::*;

/// Gradient of the loss with respect to one tile's planes, and the totals g·B.
pub struct TileGradient<const CHANNELS: usize> {
    /// For each attribute plane.
    pub attributes: [[f32; TILE_PIXELS]; CHANNELS],
    /// For the weight.
    pub weight: [f32; TILE_PIXELS],
    /// For the premultiplied depth.
    pub depth: [f32; TILE_PIXELS],
    /// g·B: the inner product of gradient and rendered planes.
    pub total: [f32; TILE_PIXELS],
    /// Error image to be gathered by surfel.
    pub error: [f32; TILE_PIXELS],
}

/// Floats of a (tile, surfel) record before the attributes: the moments of form u, v, w (3 each), plane, centre x,
/// centre y, depth, opacity, Σ weight, Σ weight · error.
pub const RECORD_BASE: usize = 16;

/// Writes one record of `RECORD_BASE + CHANNELS` sums for each entry of the tile.
///
/// The sums run over the tile's pixels in a fixed order, so they do not depend on the number of threads.
#[inline(always)]
pub fn blend_tile_vjp<S: Simd, const CHANNELS: usize, const DEPTH: bool>(
    simd: S,
    input: &TileInput<'_>,
    gradient: &TileGradient<CHANNELS>,
    records: &mut [f32],
) {
    let stride = RECORD_BASE + CHANNELS;
    debug_assert_eq!(records.len(), input.entries.len() * stride);
    let mut transmittance = initial_transmittance(input.origin, input.image);
    let mut running = [0.0f32; TILE_PIXELS];
    let len = V::<S>::LEN;
    let zero = V::<S>::splat(simd, 0.0);
    let one = V::<S>::splat(simd, 1.0);
    let two = V::<S>::splat(simd, 2.0);
    let alpha_max = V::<S>::splat(simd, input.alpha_max);
    let stop_below = V::<S>::splat(simd, input.transmittance_min);
    let mut dead = false;
    for (entry, record) in input.entries.iter().zip(records.chunks_exact_mut(stride)) {
        if dead {
            record.fill(0.0);
            continue;
        }
        let k = *entry as usize;
        let p = &input.projected[k];
        let lanes = SurfelLanes::new(simd, p, input.origin, input.near);
        let values: &[f32; CHANNELS] =
            input.attributes[k * CHANNELS..(k + 1) * CHANNELS].try_into().expect("stride");
        let centre_depth = V::<S>::splat(simd, p.depth);
        let low_pass = V::<S>::splat(simd, -2.0 * p.low_pass);
        let mut sums = [zero; RECORD_BASE];
        let mut attribute_sums = [zero; CHANNELS];
        let mut touched = false;
        let mut stopped = false;
        for group in groups::<S>(p, input.origin[1]) {
            let range = group * len..(group + 1) * len;
            let load = |plane: &[f32; TILE_PIXELS]| V::<S>::from_slice(simd, &plane[range.clone()]);
            let t = load(&transmittance);
            let r = lanes.at(simd, range.start);
            let hit = lanes.inside(&r) & t.simd_gt(zero);
            if !hit.any_true() {
                continue;
            }
            touched = true;
            let (gaussian, unclamped) = lanes.alpha(simd, &r);
            let alpha = unclamped.min(alpha_max);
            let rest = one - alpha;
            let after = t * rest;
            let stop = hit & after.simd_lt(stop_below);
            let live = hit & !stop;
            hit.select(stop.select(zero, after), t).store_slice(&mut transmittance[range.clone()]);
            stopped |= stop.any_true();
            let weight = live.select(t * alpha, zero);

            // q, and the sums that need only the weight
            let mut q = load(&gradient.weight);
            for c in 0..CHANNELS {
                let g = load(&gradient.attributes[c]);
                q = V::<S>::splat(simd, values[c]).mul_add(g, q);
                attribute_sums[c] = weight.mul_add(g, attribute_sums[c]);
            }
            sums[14] += weight;
            sums[15] = weight.mul_add(load(&gradient.error), sums[15]);
            // Lanes that the intersection does not decide may hold infinities: they are zeroed before any product.
            let exact = live & r.exact;
            let inverse = exact.select(r.inverse, zero);
            let z = exact.select(r.z, zero);
            let mut weighted_depth = zero;
            if DEPTH {
                let g = load(&gradient.depth);
                q = r.exact.select(r.z, centre_depth).mul_add(g, q);
                weighted_depth = weight * g;
            }
            let before = load(&running);
            let now = weight.mul_add(q, before);
            now.store_slice(&mut running[range.clone()]);
            let behind = load(&gradient.total) - now;
            let grad_alpha = t * q - behind / rest;

            // α = o·exp(−ρ/2), flat where it is clamped
            let free = live & unclamped.simd_lt(alpha_max);
            let grad_alpha = free.select(grad_alpha, zero);
            sums[13] = grad_alpha.mul_add(gaussian, sums[13]);
            let grad_rho = grad_alpha * unclamped * V::<S>::splat(simd, -0.5);

            // ρ through the intersection
            let rho_exact = exact.select(grad_rho, zero);
            let u = exact.select(r.u, zero);
            let v = exact.select(r.v, zero);
            let scaled = two * rho_exact * inverse;
            let (form_u, form_v) = (scaled * u, scaled * v);
            let depth_exact = exact.select(weighted_depth, zero);
            let form_w = -inverse * z.mul_add(depth_exact, two * rho_exact * u.mul_add(u, v * v));
            for (first, g) in [(0, form_u), (3, form_v), (6, form_w)] {
                sums[first] = g.mul_add(r.dx, sums[first]);
                sums[first + 1] = g.mul_add(r.dy, sums[first + 1]);
                sums[first + 2] += g;
            }
            if DEPTH {
                sums[9] = depth_exact.mul_add(inverse, sums[9]);
                sums[12] += weighted_depth - depth_exact;
            }
            // ρ through the low-pass filter
            let rho_centre = low_pass * (grad_rho - rho_exact);
            sums[10] = rho_centre.mul_add(r.dx, sums[10]);
            sums[11] = rho_centre.mul_add(r.dy, sums[11]);
        }
        if touched {
            for (o, s) in record.iter_mut().zip(sums.iter().chain(&attribute_sums)) {
                *o = s.reduce_sum();
            }
        } else {
            record.fill(0.0);
        }
        dead = stopped && transmittance.iter().all(|t| *t <= 0.0);
    }
}
