//! The few vector functions that the kernels need beyond the SIMD crate.

use fearless_simd::prelude::*;

/// The native vector of f32 of a SIMD level.
pub(crate) type V<S> = <S as Simd>::f32s;

/// `exp(x)` for x in [−80, 0]: 2^(round) times a degree-6 Taylor polynomial of 2^f, |f| ≤ ½. Relative error below
/// 3e-7 + 6e-8·|x|.
#[inline(always)]
pub(crate) fn exp_nonpositive<S: Simd>(simd: S, x: V<S>) -> V<S> {
    let t = x * V::<S>::splat(simd, std::f32::consts::LOG2_E);
    let whole = t.round_ties_even();
    let f = t - whole;
    let c = |v: f32| V::<S>::splat(simd, v);
    let mut p = c(1.540_353e-4);
    p = p.mul_add(f, c(1.333_355_8e-3));
    p = p.mul_add(f, c(9.618_129e-3));
    p = p.mul_add(f, c(5.550_411e-2));
    p = p.mul_add(f, c(2.402_265e-1));
    p = p.mul_add(f, c(std::f32::consts::LN_2));
    p = p.mul_add(f, c(1.0));
    let exponent: S::i32s = whole.to_int::<S::i32s>();
    let bits = (exponent + S::i32s::splat(simd, 127)) << 23;
    let scale: V<S> = bits.bitcast();
    p * scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[inline(always)]
    fn run<S: Simd>(simd: S, x: &[f32], out: &mut [f32]) {
        for (x, o) in x.chunks_exact(V::<S>::LEN).zip(out.chunks_exact_mut(V::<S>::LEN)) {
            exp_nonpositive(simd, V::<S>::from_slice(simd, x)).store_slice(o);
        }
    }

    /// Goal: agrees with f64 exp over the whole range, at every level this machine has.
    #[test]
    fn matches_f64() {
        let x: Vec<f32> = (0..16_384).map(|i| -80.0 * i as f32 / 16_384.0).collect();
        for level in [Level::new(), Level::fallback(), Level::baseline()] {
            let mut out = vec![0.0; x.len()];
            dispatch!(level, simd => run(simd, &x, &mut out));
            for (x, y) in x.iter().zip(&out) {
                let exact = f64::from(*x).exp();
                let relative = (f64::from(*y) / exact - 1.0).abs();
                assert!(relative < 4e-7 + 7e-8 * f64::from(x.abs()), "{x}: {relative}");
            }
        }
    }
}
