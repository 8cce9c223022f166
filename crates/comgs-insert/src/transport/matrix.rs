//! A sparse matrix of transport, and its two products.

use crate::light::LightMap;
use rayon::prelude::*;

/// Rows of one parallel work item.
const BLOCK: usize = 64;

/// Partial sums of the transposed product: few, because each is a whole map, and always as many, because the order of
/// sums is part of the result.
const PARTIAL_SUMS: usize = 8;

/// Gap between two spans up to which zeros are stored instead.
const GAP: usize = 8;

/// Consecutive texels, `start` and how many.
type Span = (u32, u32);

/// Where a row's numbers are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    first_span: u32,
    spans: u32,
    first_value: u32,
    /// What does not depend on the map: the surface's own emission.
    constant: [f32; 3],
}

/// Rows that were traced together.
#[derive(Clone, Debug, Default, PartialEq)]
struct Block {
    rows: Vec<Row>,
    spans: Vec<Span>,
    /// For every span, the values of its texels channel after channel.
    values: Vec<f32>,
}

/// A matrix whose entries have `channels` values: 3 for coloured transport, multiplied channel by channel, or 1 for
/// transport that is the same in all.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    channels: usize,
    /// Rows of the map.
    height: usize,
    rows: usize,
    blocks: Vec<Block>,
}

/// Sum of products in eight lanes, always the same ones.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let (ra, rb) = (a8.remainder(), b8.remainder());
    for (x, y) in a8.zip(b8) {
        for k in 0..8 {
            lanes[k] += x[k] * y[k];
        }
    }
    let mut sum =
        (lanes[0] + lanes[4]) + (lanes[1] + lanes[5]) + ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]));
    for (x, y) in ra.iter().zip(rb) {
        sum += x * y;
    }
    sum
}

impl Matrix {
    /// A matrix of `rows` rows, each filled by `fill(row, dense, constant)`: `dense` holds `channels · texels` zeros,
    /// channel after channel. In parallel; `fill` may be called in any order. `check` is asked before every block and
    /// stops the work when it says `false`, which gives `None`.
    pub fn build(
        rows: usize,
        height: usize,
        channels: usize,
        fill: impl Fn(usize, &mut [f32], &mut [f32; 3]) + Sync,
        check: impl Fn(usize) -> bool + Sync,
    ) -> Option<Self> {
        let texels = 2 * height * height;
        let blocks = (0..rows.div_ceil(BLOCK))
            .into_par_iter()
            .map(|b| {
                let range = b * BLOCK..((b + 1) * BLOCK).min(rows);
                if !check(range.len()) {
                    return None;
                }
                let mut block = Block::default();
                let mut dense = vec![0.0f32; channels * texels];
                for row in range {
                    dense.fill(0.0);
                    let mut constant = [0.0; 3];
                    fill(row, &mut dense, &mut constant);
                    block.push(&dense, channels, constant);
                }
                block.spans.shrink_to_fit();
                block.values.shrink_to_fit();
                Some(block)
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self { channels, height, rows, blocks })
    }

    /// Rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Memory of the numbers in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let block = |b: &Block| {
            b.rows.len() * size_of::<Row>() + b.spans.len() * size_of::<Span>() + 4 * b.values.len()
        };
        self.blocks.iter().map(block).sum()
    }

    /// Rows times map: RGB a row, constants included. Rows for which `wanted` is false are 0. Gradient:
    /// [`Matrix::transposed`].
    #[must_use]
    pub fn times(&self, map: &LightMap, wanted: impl Fn(usize) -> bool + Sync) -> Vec<[f32; 3]> {
        assert_eq!(map.height, self.height);
        let mut out = vec![[0.0; 3]; self.rows];
        out.par_chunks_mut(BLOCK).zip(&self.blocks).enumerate().for_each(|(b, (out, block))| {
            for (k, row) in block.rows.iter().enumerate() {
                if !wanted(b * BLOCK + k) {
                    continue;
                }
                let mut sums = row.constant;
                block.each_span(row, self.channels, |start, n, values| {
                    for (c, sum) in sums.iter_mut().enumerate() {
                        let values = if self.channels == 3 { &values[c * n..(c + 1) * n] } else { values };
                        *sum += dot(values, &map.channel(c)[start..start + n]);
                    }
                });
                out[k] = sums;
            }
        });
        out
    }

    /// The transpose times an RGB a row: gradient with respect to the map, added to `grad`. Rows of zeros are skipped.
    pub fn transposed(&self, grad_rows: &[[f32; 3]], grad: &mut LightMap) {
        assert_eq!((grad.height, grad_rows.len()), (self.height, self.rows));
        let texels = grad.texels();
        let share = self.blocks.len().div_ceil(PARTIAL_SUMS).max(1);
        let partial: Vec<Vec<f32>> = self
            .blocks
            .par_chunks(share)
            .enumerate()
            .map(|(p, blocks)| {
                let mut sum = vec![0.0f32; 3 * texels];
                for (b, block) in blocks.iter().enumerate() {
                    for (k, row) in block.rows.iter().enumerate() {
                        let g = grad_rows[(p * share + b) * BLOCK + k];
                        if g == [0.0; 3] {
                            continue;
                        }
                        block.each_span(row, self.channels, |start, n, values| {
                            for c in 0..3 {
                                let values =
                                    if self.channels == 3 { &values[c * n..(c + 1) * n] } else { values };
                                let out = &mut sum[c * texels + start..c * texels + start + n];
                                for (o, v) in out.iter_mut().zip(values) {
                                    *o += g[c] * v;
                                }
                            }
                        });
                    }
                }
                sum
            })
            .collect();
        for sum in &partial {
            for (o, v) in grad.data.iter_mut().zip(sum) {
                *o += v;
            }
        }
    }

    /// One row, dense, channel after channel; for tests and inspection.
    #[must_use]
    pub fn dense_row(&self, row: usize) -> Vec<f32> {
        let texels = 2 * self.height * self.height;
        let block = &self.blocks[row / BLOCK];
        let mut out = vec![0.0; self.channels * texels];
        block.each_span(&block.rows[row % BLOCK], self.channels, |start, n, values| {
            for c in 0..self.channels {
                out[c * texels + start..c * texels + start + n].copy_from_slice(&values[c * n..(c + 1) * n]);
            }
        });
        out
    }
}

impl Block {
    fn push(&mut self, dense: &[f32], channels: usize, constant: [f32; 3]) {
        let texels = dense.len() / channels;
        let (first_span, first_value) = (self.spans.len() as u32, self.values.len() as u32);
        let filled = |t: usize| (0..channels).any(|c| dense[c * texels + t] != 0.0);
        let mut t = 0;
        while t < texels {
            if !filled(t) {
                t += 1;
                continue;
            }
            let (start, mut end) = (t, t + 1);
            let mut look = end;
            while look < texels && look < end + GAP {
                if filled(look) {
                    end = look + 1;
                }
                look += 1;
            }
            self.spans.push((start as u32, (end - start) as u32));
            for c in 0..channels {
                self.values.extend_from_slice(&dense[c * texels + start..c * texels + end]);
            }
            t = end;
        }
        let spans = self.spans.len() as u32 - first_span;
        self.rows.push(Row { first_span, spans, first_value, constant });
    }

    fn each_span(&self, row: &Row, channels: usize, mut f: impl FnMut(usize, usize, &[f32])) {
        let mut at = row.first_value as usize;
        for &(start, n) in &self.spans[row.first_span as usize..(row.first_span + row.spans) as usize] {
            let (start, n) = (start as usize, n as usize);
            f(start, n, &self.values[at..at + channels * n]);
            at += channels * n;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;

    /// Goal: both products are those of the dense matrix in f64, and adjoint to each other; rows that are not wanted are 0;
    /// the sums are the same bytes on one thread.
    #[test]
    fn products_against_the_dense_matrix() {
        for channels in [1, 3] {
            let (rows, height) = (150, 8);
            let texels = 2 * height * height;
            let entry = |row: usize, i: usize| {
                let mut rng = Rng::stream(9, (row * 3 * texels + i) as u64);
                if rng.uniform() < 0.6 { 0.0 } else { rng.normal() }
            };
            let fill = |row: usize, dense: &mut [f32], constant: &mut [f32; 3]| {
                dense.iter_mut().enumerate().for_each(|(i, v)| *v = entry(row, i));
                constant[1] = row as f32;
            };
            let matrix = Matrix::build(rows, height, channels, fill, |_| true).unwrap();
            assert!(
                matrix.bytes() <= crate::transport::most_bytes(rows, height, channels) + 8 * rows * texels
            );
            let mut rng = Rng::new(1);
            let mut map = LightMap::zeros(height);
            map.data.iter_mut().for_each(|v| *v = rng.uniform());
            let out = matrix.times(&map, |row| row != 7);
            assert_eq!(out[7], [0.0; 3]);
            let grad_rows: Vec<[f32; 3]> = (0..rows).map(|_| std::array::from_fn(|_| rng.normal())).collect();
            let mut grad = LightMap::zeros(height);
            matrix.transposed(&grad_rows, &mut grad);
            let mut dense_grad = vec![0.0f64; 3 * texels];
            for row in 0..rows {
                for c in 0..3 {
                    let mut sum = if c == 1 { row as f64 } else { 0.0 };
                    for t in 0..texels {
                        let v = f64::from(entry(row, if channels == 3 { c * texels + t } else { t }));
                        sum += v * f64::from(map.channel(c)[t]);
                        dense_grad[c * texels + t] += v * f64::from(grad_rows[row][c]);
                    }
                    assert!(row == 7 || (sum - f64::from(out[row][c])).abs() < 1e-4 * sum.abs().max(1.0));
                }
            }
            for (a, b) in grad.data.iter().zip(&dense_grad) {
                assert!((f64::from(*a) - b).abs() < 1e-4 * b.abs().max(1.0));
            }
            let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
            let mut alone = LightMap::zeros(height);
            one.install(|| matrix.transposed(&grad_rows, &mut alone));
            assert_eq!(grad, alone);
        }
    }

    /// Goal: work that is stopped gives nothing.
    #[test]
    fn stopped_work() {
        assert!(Matrix::build(100, 2, 1, |_, _, _| {}, |_| false).is_none());
    }
}
