//! One ray against eight boxes, and against eight discs.

use crate::{
    TraceConfig,
    bvh::{Block, Node, WIDTH},
    tracer::Ray,
};
use fearless_simd::{Simd, f32x8, i32x8, mask32x8, prelude::*, u32x8};
use glam::Vec3;

/// Boxes are entered a little earlier and left a little later than computed, relative to the distance: rounding of
/// `(bound − origin) / direction` is below 2 ulp a side (Ize 2013, "Robust BVH ray traversal").
pub(crate) const SLACK: f32 = 1.0 + 4.0 * f32::EPSILON;
/// Reciprocals are clamped here, so that `0 · ∞` cannot arise; the product with any coordinate is then merely large.
const LARGEST_INVERSE: f32 = 1e30;

/// The thresholds in the form that the kernel wants.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub log_alpha_min: f32,
    pub alpha_max: f32,
    pub transmittance_min: f32,
}

impl Limits {
    pub fn new(config: &TraceConfig) -> Self {
        Self {
            log_alpha_min: config.alpha_min.ln(),
            alpha_max: config.alpha_max,
            transmittance_min: config.transmittance_min,
        }
    }
}

/// A ray spread over the lanes.
#[derive(Clone, Copy)]
pub(crate) struct RayLanes<S: Simd> {
    origin: [f32x8<S>; 3],
    direction: [f32x8<S>; 3],
    inverse: [f32x8<S>; 3],
    /// Rows of [`Node::bounds`] that the ray meets first, by axis.
    near: [usize; 3],
    t_min: f32x8<S>,
}

impl<S: Simd> RayLanes<S> {
    #[inline(always)]
    pub fn new(simd: S, ray: &Ray) -> Self {
        let inverse = Vec3::ONE / ray.direction;
        let inverse = inverse.clamp(Vec3::splat(-LARGEST_INVERSE), Vec3::splat(LARGEST_INVERSE));
        let near = |axis: usize| if inverse[axis] < 0.0 { axis + 3 } else { axis };
        Self {
            origin: splat(simd, ray.origin),
            direction: splat(simd, ray.direction),
            inverse: splat(simd, inverse),
            near: [near(0), near(1), near(2)],
            t_min: f32x8::splat(simd, ray.t_min),
        }
    }

    /// Where the ray enters the eight boxes, and which of them it passes through in `[t_min, t_max)`.
    #[inline(always)]
    pub fn enter(&self, simd: S, node: &Node, t_max: f32) -> (f32x8<S>, mask32x8<S>) {
        let mut near = self.t_min;
        let mut far = f32x8::splat(simd, t_max);
        for axis in 0..3 {
            let row = self.near[axis];
            let opposite = if row >= 3 { row - 3 } else { row + 3 };
            let low = f32x8::load_array_ref(simd, &node.bounds[row]);
            let high = f32x8::load_array_ref(simd, &node.bounds[opposite]);
            near = near.max((low - self.origin[axis]) * self.inverse[axis]);
            far = far.min((high - self.origin[axis]) * self.inverse[axis]);
        }
        (near, near.simd_le(far * SLACK))
    }

    /// Distance, log of opacity times falloff, and which of the eight discs are hit in `[t_min, t_max)`.
    ///
    /// A ray parallel to a plane divides by 0: the distance is then ±∞ or NaN, and every comparison fails.
    #[inline(always)]
    pub fn meet(&self, simd: S, block: &Block, t_max: f32, limits: &Limits) -> Met<S> {
        let centre = load(simd, &block.centre);
        let normal = load(simd, &block.normal);
        let offset = [centre[0] - self.origin[0], centre[1] - self.origin[1], centre[2] - self.origin[2]];
        let t = dot(normal, offset) / dot(normal, self.direction);
        let hit = [
            t.mul_sub(self.direction[0], offset[0]),
            t.mul_sub(self.direction[1], offset[1]),
            t.mul_sub(self.direction[2], offset[2]),
        ];
        let u = dot(load(simd, &block.tangent_u), hit);
        let v = dot(load(simd, &block.tangent_v), hit);
        let square = u.mul_add(u, v * v);
        let log_opacity = f32x8::load_array_ref(simd, &block.log_opacity);
        let log_alpha = square.mul_add(f32x8::splat(simd, -0.5), log_opacity);
        let mask = log_alpha.simd_ge(f32x8::splat(simd, limits.log_alpha_min))
            & t.simd_ge(self.t_min)
            & t.simd_lt(f32x8::splat(simd, t_max));
        Met { t, log_alpha, mask }
    }
}

/// What [`RayLanes::meet`] found.
#[derive(Clone, Copy)]
pub(crate) struct Met<S: Simd> {
    pub t: f32x8<S>,
    pub log_alpha: f32x8<S>,
    pub mask: mask32x8<S>,
}

impl<S: Simd> Met<S> {
    /// Opacities of the lanes that are hit, 0 in the others.
    #[inline(always)]
    pub fn alpha(&self, simd: S, limits: &Limits) -> f32x8<S> {
        let zero = f32x8::splat(simd, 0.0);
        let alpha =
            exp(simd, self.mask.select(self.log_alpha, zero)).min(f32x8::splat(simd, limits.alpha_max));
        self.mask.select(alpha, zero)
    }
}

// Spelled out: `array::map` is not always inlined, and a call leaves the function that may use wide registers.
// Measured: half the speed.
#[inline(always)]
fn splat<S: Simd>(simd: S, v: Vec3) -> [f32x8<S>; 3] {
    [f32x8::splat(simd, v.x), f32x8::splat(simd, v.y), f32x8::splat(simd, v.z)]
}

#[inline(always)]
fn load<S: Simd>(simd: S, rows: &[[f32; WIDTH]; 3]) -> [f32x8<S>; 3] {
    [
        f32x8::load_array_ref(simd, &rows[0]),
        f32x8::load_array_ref(simd, &rows[1]),
        f32x8::load_array_ref(simd, &rows[2]),
    ]
}

#[inline(always)]
fn dot<S: Simd>(a: [f32x8<S>; 3], b: [f32x8<S>; 3]) -> f32x8<S> {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

/// `eˣ` for x in [−80, 80]: argument reduction to `2ⁿ · eʳ` with |r| ≤ ½ ln 2 and the Taylor polynomial of degree 7,
/// whose remainder is below 6e-9 there. Relative error below 2e-7 in all.
#[inline(always)]
pub(crate) fn exp<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    // ln 2 in two parts, so that n · high is exact.
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    const C: [f32; 8] = [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5040.0];
    let n = (x * std::f32::consts::LOG2_E).round_ties_even();
    let r = n.mul_add(f32x8::splat(simd, -LN2_LOW), n.mul_add(f32x8::splat(simd, -LN2_HIGH), x));
    let mut p = f32x8::splat(simd, C[7]);
    for k in (0..7).rev() {
        p = p.mul_add(r, f32x8::splat(simd, C[k]));
    }
    let exponent: i32x8<S> = (n.to_int::<i32x8<S>>() + 127) << 23;
    p * f32x8::from_bits(exponent.bitcast::<u32x8<S>>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[inline(always)]
    fn exp_array<S: Simd>(simd: S, x: [f32; 8]) -> [f32; 8] {
        exp(simd, f32x8::simd_from(simd, x)).to_array()
    }

    /// Goal: the vector exponential is within 2.5e-7 of the f64 one over the range it is used in, at every level
    /// that this machine has.
    #[test]
    fn exponential() {
        for level in [Level::new(), Level::baseline()] {
            for i in 0..20_000 {
                let x = -79.0 + i as f32 * (80.0 / 20_000.0);
                let got = dispatch!(level, simd => exp_array(simd, [x; 8]));
                let exact = f64::from(x).exp();
                assert!((f64::from(got[3]) / exact - 1.0).abs() < 2.5e-7, "{x}: {} {exact}", got[3]);
            }
            assert_eq!(dispatch!(level, simd => exp_array(simd, [0.0; 8])), [1.0; 8]);
        }
    }
}
