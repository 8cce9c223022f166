//! Front-to-back blending of one tile.

use crate::bounds::TILE;
use crate::project::Projected;
use crate::simd::{V, exp_nonpositive};
use fearless_simd::Select;
use fearless_simd::prelude::*;

/// Pixels of a tile.
pub const TILE_PIXELS: usize = TILE * TILE;

/// What one tile blends.
#[derive(Clone, Copy)]
pub struct TileInput<'a> {
    /// All projected surfels.
    pub projected: &'a [Projected],
    /// Blended attributes, `CHANNELS` for each projected surfel.
    pub attributes: &'a [f32],
    /// The tile's list: indices into `projected`, nearest first.
    pub entries: &'a [u32],
    /// Pixel of the tile's upper left corner.
    pub origin: [usize; 2],
    /// Size of the image; lanes beyond it are dead from the start.
    pub image: [usize; 2],
    /// Nearest drawn depth.
    pub near: f32,
    /// Clamp of the response.
    pub alpha_max: f32,
    /// Early stop.
    pub transmittance_min: f32,
}

/// Planes of one tile, pixel `(x, y)` at `y · TILE + x`.
pub struct TileOutput<const CHANNELS: usize> {
    /// Σ T α a for each attribute.
    pub attributes: [[f32; TILE_PIXELS]; CHANNELS],
    /// Σ T α.
    pub weight: [f32; TILE_PIXELS],
    /// Σ T α z.
    pub depth: [f32; TILE_PIXELS],
}

/// Offsets of the pixel centres from the tile's corner.
const X: [f32; TILE_PIXELS] = {
    let mut x = [0.0; TILE_PIXELS];
    let mut i = 0;
    while i < TILE_PIXELS {
        x[i] = (i % TILE) as f32 + 0.5;
        i += 1;
    }
    x
};
const Y: [f32; TILE_PIXELS] = {
    let mut y = [0.0; TILE_PIXELS];
    let mut i = 0;
    while i < TILE_PIXELS {
        y[i] = (i / TILE) as f32 + 0.5;
        i += 1;
    }
    y
};

/// 1 for pixels inside the image, 0 outside: the initial transmittance.
pub(crate) fn initial_transmittance(origin: [usize; 2], image: [usize; 2]) -> [f32; TILE_PIXELS] {
    std::array::from_fn(|i| {
        let inside = origin[0] + i % TILE < image[0] && origin[1] + i / TILE < image[1];
        if inside { 1.0 } else { 0.0 }
    })
}

/// A surfel's constants in vector registers, relative to a tile.
pub(crate) struct SurfelLanes<S: Simd> {
    u: [V<S>; 3],
    v: [V<S>; 3],
    w: [V<S>; 3],
    plane: V<S>,
    offset: [V<S>; 2],
    low_pass: V<S>,
    low_pass_bias: V<S>,
    cut: V<S>,
    opacity: V<S>,
    near: V<S>,
}

/// A surfel's response at one group of pixels.
pub(crate) struct Response<S: Simd> {
    /// Pixel offset from the surfel's reference.
    pub dx: V<S>,
    /// Pixel offset from the surfel's reference.
    pub dy: V<S>,
    /// 1 / (n·d).
    pub inverse: V<S>,
    /// Local coordinates in standard deviations.
    pub u: V<S>,
    /// Local coordinates in standard deviations.
    pub v: V<S>,
    /// Depth of the intersection.
    pub z: V<S>,
    /// The smaller of both ρ.
    pub rho: V<S>,
    /// Lanes where the intersection (not the low-pass filter) decides.
    pub exact: S::mask32s,
}

impl<S: Simd> SurfelLanes<S> {
    #[inline(always)]
    pub(crate) fn new(simd: S, p: &Projected, origin: [usize; 2], near: f32) -> Self {
        let splat = |x: f32| V::<S>::splat(simd, x);
        let form = |f: [f32; 3]| [splat(f[0]), splat(f[1]), splat(f[2])];
        Self {
            u: form(p.form_u),
            v: form(p.form_v),
            w: form(p.form_w),
            plane: splat(p.plane),
            offset: [splat(origin[0] as f32 - p.reference[0]), splat(origin[1] as f32 - p.reference[1])],
            low_pass: splat(p.low_pass),
            low_pass_bias: splat(if p.low_pass > 0.0 { 0.0 } else { 1e30 }),
            cut: splat(p.cut),
            opacity: splat(p.opacity),
            near: splat(near),
        }
    }

    /// Response at the pixels `first..first + LEN` of the tile.
    #[inline(always)]
    pub(crate) fn at(&self, simd: S, first: usize) -> Response<S> {
        let dx = V::<S>::from_slice(simd, &X[first..first + V::<S>::LEN]) + self.offset[0];
        let dy = V::<S>::from_slice(simd, &Y[first..first + V::<S>::LEN]) + self.offset[1];
        let form = |f: &[V<S>; 3]| f[0].mul_add(dx, f[1].mul_add(dy, f[2]));
        let inverse = V::<S>::splat(simd, 1.0) / form(&self.w);
        let u = form(&self.u) * inverse;
        let v = form(&self.v) * inverse;
        let z = self.plane * inverse;
        let rho_exact = u.mul_add(u, v * v);
        let rho_low_pass = self.low_pass.mul_add(dx.mul_add(dx, dy * dy), self.low_pass_bias);
        // A parallel ray divides by zero: z and ρ are then infinite or NaN, and both comparisons are false.
        let exact = z.simd_ge(self.near) & rho_exact.simd_le(rho_low_pass);
        let rho = exact.select(rho_exact, rho_low_pass);
        Response { dx, dy, inverse, u, v, z, rho, exact }
    }

    /// Lanes inside the cut-off.
    #[inline(always)]
    pub(crate) fn inside(&self, r: &Response<S>) -> S::mask32s {
        r.rho.simd_le(self.cut)
    }

    /// exp(−ρ/2) and the unclamped response.
    #[inline(always)]
    pub(crate) fn alpha(&self, simd: S, r: &Response<S>) -> (V<S>, V<S>) {
        let gaussian = exp_nonpositive(simd, r.rho.min(self.cut) * V::<S>::splat(simd, -0.5));
        (gaussian, gaussian * self.opacity)
    }
}

/// First and last pixel group of the tile that the surfel's rows touch.
#[inline(always)]
pub(crate) fn groups<S: Simd>(p: &Projected, origin_y: usize) -> std::ops::Range<usize> {
    let first_row = (p.rows[0] as usize).saturating_sub(origin_y).min(TILE - 1);
    let last_row = (p.rows[1] as usize).saturating_sub(origin_y).min(TILE - 1);
    let first = first_row * TILE / V::<S>::LEN;
    let last = (last_row * TILE + TILE - 1) / V::<S>::LEN;
    first..last + 1
}

/// Blends a tile (ComGS Eq. 1). `DEPTH` off leaves the depth plane 0.
#[inline(always)]
pub fn blend_tile<S: Simd, const CHANNELS: usize, const DEPTH: bool>(
    simd: S,
    input: &TileInput<'_>,
) -> TileOutput<CHANNELS> {
    let mut out = TileOutput {
        attributes: [[0.0; TILE_PIXELS]; CHANNELS],
        weight: [0.0; TILE_PIXELS],
        depth: [0.0; TILE_PIXELS],
    };
    let mut transmittance = initial_transmittance(input.origin, input.image);
    let len = V::<S>::LEN;
    let zero = V::<S>::splat(simd, 0.0);
    let one = V::<S>::splat(simd, 1.0);
    let alpha_max = V::<S>::splat(simd, input.alpha_max);
    let stop_below = V::<S>::splat(simd, input.transmittance_min);
    for &k in input.entries {
        let p = &input.projected[k as usize];
        let lanes = SurfelLanes::new(simd, p, input.origin, input.near);
        let values: &[f32; CHANNELS] =
            input.attributes[k as usize * CHANNELS..(k as usize + 1) * CHANNELS].try_into().expect("stride");
        let centre_depth = V::<S>::splat(simd, p.depth);
        let mut stopped = false;
        for group in groups::<S>(p, input.origin[1]) {
            let range = group * len..(group + 1) * len;
            let t = V::<S>::from_slice(simd, &transmittance[range.clone()]);
            let r = lanes.at(simd, range.start);
            let hit = lanes.inside(&r) & t.simd_gt(zero);
            if !hit.any_true() {
                continue;
            }
            let (_, unclamped) = lanes.alpha(simd, &r);
            let alpha = unclamped.min(alpha_max);
            let after = t * (one - alpha);
            let stop = hit & after.simd_lt(stop_below);
            let live = hit & !stop;
            let weight = live.select(t * alpha, zero);
            let next = hit.select(stop.select(zero, after), t);
            next.store_slice(&mut transmittance[range.clone()]);
            stopped |= stop.any_true();
            let add = |plane: &mut [f32; TILE_PIXELS], value: V<S>| {
                let sum = V::<S>::from_slice(simd, &plane[range.clone()]);
                weight.mul_add(value, sum).store_slice(&mut plane[range.clone()]);
            };
            add(&mut out.weight, one);
            for c in 0..CHANNELS {
                add(&mut out.attributes[c], V::<S>::splat(simd, values[c]));
            }
            if DEPTH {
                add(&mut out.depth, r.exact.select(r.z, centre_depth));
            }
        }
        if stopped && transmittance.iter().all(|t| *t <= 0.0) {
            break;
        }
    }
    out
}
