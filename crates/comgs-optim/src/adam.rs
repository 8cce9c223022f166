//! Adam (Kingma & Ba 2015).

use fearless_simd::{Level, Simd, dispatch};
use rayon::prelude::*;

/// Hyper-parameters shared by all columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamConfig {
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
}

impl Default for AdamConfig {
    /// β = (0.9, 0.999), ε = 1e-15 as Gaussian splatting uses: gradients of a mean over all pixels are tiny.
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-15 }
    }
}

/// Moments of one parameter column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adam {
    /// First moments, one a parameter.
    pub first: Vec<f32>,
    /// Second moments, one a parameter.
    pub second: Vec<f32>,
}

/// Parameters of one parallel work item.
const CHUNK: usize = 1 << 14;

impl Adam {
    /// Zero moments for `n` parameters.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { first: vec![0.0; n], second: vec![0.0; n] }
    }

    /// One step: `p ← p − lr · m̂ / (√v̂ + ε)`, with bias correction for step number `step` (from 1).
    ///
    /// A non-finite gradient entry is dropped: its parameter and moments stay as they are. Returns how many were.
    ///
    /// # Panics
    /// When the lengths differ.
    pub fn step(
        &mut self,
        parameters: &mut [f32],
        gradients: &[f32],
        learning_rate: f32,
        step: u32,
        config: &AdamConfig,
    ) -> usize {
        assert_eq!(parameters.len(), gradients.len());
        assert_eq!(parameters.len(), self.first.len());
        let level = Level::new();
        let step = step.max(1) as i32;
        let constants = Constants {
            beta1: config.beta1,
            beta2: config.beta2,
            epsilon: config.epsilon,
            rate: learning_rate / (1.0 - config.beta1.powi(step)),
            correction: 1.0 / (1.0 - config.beta2.powi(step)),
        };
        parameters
            .par_chunks_mut(CHUNK)
            .zip(gradients.par_chunks(CHUNK))
            .zip(self.first.par_chunks_mut(CHUNK).zip(self.second.par_chunks_mut(CHUNK)))
            .map(|((p, g), (m, v))| dispatch!(level, simd => step_chunk(simd, p, g, m, v, constants)))
            .sum()
    }

    /// As [`Adam::step`] for rows of `rates.len()` parameters, where column `k` of every row has its own learning rate
    /// `rates[k]` (the harmonics of a surfel, for example).
    ///
    /// # Panics
    /// When the lengths differ or are no multiple of the row.
    pub fn step_rows(
        &mut self,
        parameters: &mut [f32],
        gradients: &[f32],
        rates: &[f32],
        step: u32,
        config: &AdamConfig,
    ) -> usize {
        assert_eq!(parameters.len(), gradients.len());
        assert_eq!(parameters.len(), self.first.len());
        let width = rates.len();
        assert!(width > 0 && parameters.len().is_multiple_of(width));
        let level = Level::new();
        let step = step.max(1) as i32;
        let constants = Constants {
            beta1: config.beta1,
            beta2: config.beta2,
            epsilon: config.epsilon,
            rate: 1.0 / (1.0 - config.beta1.powi(step)),
            correction: 1.0 / (1.0 - config.beta2.powi(step)),
        };
        let chunk = (CHUNK / width).max(1) * width;
        parameters
            .par_chunks_mut(chunk)
            .zip(gradients.par_chunks(chunk))
            .zip(self.first.par_chunks_mut(chunk).zip(self.second.par_chunks_mut(chunk)))
            .map(|((p, g), (m, v))| dispatch!(level, simd => step_chunk_rows(simd, p, g, m, v, rates, constants)))
            .sum()
    }

    /// Reorders the moments of `width`-wide rows along with their parameters; rows whose `fresh` flag is set start
    /// from zero.
    #[must_use]
    pub fn gathered(&self, order: &[u32], fresh: &[bool], width: usize) -> Self {
        let gather = |column: &[f32]| {
            let mut out = Vec::with_capacity(order.len() * width);
            for (&i, &is_fresh) in order.iter().zip(fresh) {
                if is_fresh {
                    out.extend(std::iter::repeat_n(0.0, width));
                } else {
                    out.extend_from_slice(&column[i as usize * width..(i as usize + 1) * width]);
                }
            }
            out
        };
        Self { first: gather(&self.first), second: gather(&self.second) }
    }
}

#[derive(Clone, Copy)]
struct Constants {
    beta1: f32,
    beta2: f32,
    epsilon: f32,
    rate: f32,
    correction: f32,
}

/// [`step_chunk`] for rows with a learning rate a column.
#[inline(always)]
fn step_chunk_rows<S: Simd>(
    simd: S,
    p: &mut [f32],
    g: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    rates: &[f32],
    c: Constants,
) -> usize {
    let width = rates.len();
    let mut dropped = 0;
    let rows = p.chunks_exact_mut(width).zip(g.chunks_exact(width));
    for ((p, g), (m, v)) in rows.zip(m.chunks_exact_mut(width).zip(v.chunks_exact_mut(width))) {
        // The first three columns (the constant harmonic) and the rest each share a rate in practice; runs of equal
        // rates are stepped as one vector loop.
        let mut start = 0;
        while start < width {
            let end = (start + 1..width).find(|&k| rates[k] != rates[start]).unwrap_or(width);
            let run = start..end;
            let c = Constants { rate: c.rate * rates[start], ..c };
            dropped +=
                step_chunk(simd, &mut p[run.clone()], &g[run.clone()], &mut m[run.clone()], &mut v[run], c);
            start = end;
        }
    }
    dropped
}

/// A plain loop that the compiler vectorises with the features of the dispatched level.
#[inline(always)]
fn step_chunk<S: Simd>(
    _simd: S,
    p: &mut [f32],
    g: &[f32],
    m: &mut [f32],
    v: &mut [f32],
    c: Constants,
) -> usize {
    let mut dropped = 0u32;
    for (((p, &g), m), v) in p.iter_mut().zip(g).zip(m.iter_mut()).zip(v.iter_mut()) {
        let finite = g.is_finite();
        let first = c.beta1 * *m + (1.0 - c.beta1) * g;
        let second = c.beta2 * *v + (1.0 - c.beta2) * g * g;
        let next = *p - c.rate * first / ((second * c.correction).sqrt() + c.epsilon);
        *m = if finite { first } else { *m };
        *v = if finite { second } else { *v };
        *p = if finite { next } else { *p };
        dropped += u32::from(!finite);
    }
    dropped as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the update of three steps equals the textbook formula in f64.
    #[test]
    fn matches_the_formula() {
        let config = AdamConfig { epsilon: 1e-8, ..Default::default() };
        let mut adam = Adam::new(2);
        let mut p = [1.0f32, -2.0];
        let (mut q, mut m, mut v) = ([1.0f64, -2.0], [0.0f64; 2], [0.0f64; 2]);
        for step in 1..=3 {
            let g = [0.5 * step as f32, -0.1];
            adam.step(&mut p, &g, 0.01, step, &config);
            for i in 0..2 {
                let g = f64::from(g[i]);
                m[i] = 0.9 * m[i] + 0.1 * g;
                v[i] = 0.999 * v[i] + 0.001 * g * g;
                let m_hat = m[i] / (1.0 - 0.9f64.powi(step as i32));
                let v_hat = v[i] / (1.0 - 0.999f64.powi(step as i32));
                q[i] -= 0.01 * m_hat / (v_hat.sqrt() + 1e-8);
            }
        }
        for i in 0..2 {
            assert!((f64::from(p[i]) - q[i]).abs() < 1e-5);
        }
    }

    /// Goal: stepping rows with a rate a column equals stepping each column by itself.
    #[test]
    fn rows_equal_columns() {
        let (rates, config) = ([0.1f32, 0.1, 0.01], AdamConfig::default());
        let g: Vec<f32> = (0..12).map(|i| (i as f32 - 5.0) * 0.3).collect();
        let mut rows = Adam::new(12);
        let mut p = vec![1.0f32; 12];
        for step in 1..=2 {
            rows.step_rows(&mut p, &g, &rates, step, &config);
        }
        for i in 0..12 {
            let mut one = Adam::new(1);
            let mut q = [1.0f32];
            for step in 1..=2 {
                one.step(&mut q, &g[i..=i], rates[i % 3], step, &config);
            }
            assert!((p[i] - q[0]).abs() < 1e-6);
        }
    }

    /// Hard case 13. Goal: a non-finite gradient is dropped and counted, its neighbours are stepped.
    #[test]
    fn non_finite_gradients_are_dropped() {
        let mut adam = Adam::new(4);
        let mut p = [1.0f32; 4];
        let dropped = adam.step(
            &mut p,
            &[f32::NAN, 1.0, f32::INFINITY, f32::NEG_INFINITY],
            0.1,
            1,
            &AdamConfig::default(),
        );
        assert_eq!(dropped, 3);
        assert_eq!([p[0], p[2], p[3]], [1.0; 3]);
        assert!((p[1] - 0.9).abs() < 1e-5);
        assert!(adam.first.iter().chain(&adam.second).all(|v| v.is_finite()));
    }
}
