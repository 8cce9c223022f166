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

/// A matrix whose entries have `channels` values: 3 for coloured transport, multiplied channel by channel, 1 for
/// transport that is the same in all, or more for lobes that are each the same in all ([`Matrix::lobes`]).
#[derive(Clone, Debug, Default, PartialEq)]
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
        let fill = |row: usize, dense: &mut [Vec<f32>; 1], constant: &mut [f32; 3]| {
            fill(row, &mut dense[0], constant);
        };
        Self::build_each(rows, height, [channels], fill, check).map(|[matrix]| matrix)
    }

    /// [`Matrix::build`] for several matrices of as many rows that are filled together; the constant is the first's.
    pub fn build_each<const N: usize>(
        rows: usize,
        height: usize,
        channels: [usize; N],
        fill: impl Fn(usize, &mut [Vec<f32>; N], &mut [f32; 3]) + Sync,
        check: impl Fn(usize) -> bool + Sync,
    ) -> Option<[Self; N]> {
        let texels = 2 * height * height;
        let made = (0..rows.div_ceil(BLOCK))
            .into_par_iter()
            .map(|b| {
                let range = b * BLOCK..((b + 1) * BLOCK).min(rows);
                if !check(range.len()) {
                    return None;
                }
                let mut blocks: [Block; N] = std::array::from_fn(|_| Block::default());
                let mut dense = channels.map(|n| vec![0.0f32; n * texels]);
                for row in range {
                    dense.iter_mut().for_each(|d| d.fill(0.0));
                    let mut constant = [0.0; 3];
                    fill(row, &mut dense, &mut constant);
                    for (k, (block, dense)) in blocks.iter_mut().zip(&dense).enumerate() {
                        block.push(dense, channels[k], if k == 0 { constant } else { [0.0; 3] });
                    }
                }
                for block in &mut blocks {
                    block.spans.shrink_to_fit();
                    block.values.shrink_to_fit();
                }
                Some(blocks)
            })
            .collect::<Option<Vec<_>>>()?;
        let mut parts: [Vec<Block>; N] = std::array::from_fn(|_| Vec::with_capacity(made.len()));
        for blocks in made {
            for (all, block) in parts.iter_mut().zip(blocks) {
                all.push(block);
            }
        }
        let mut parts = parts.into_iter().zip(channels);
        Some(std::array::from_fn(|_| {
            let (blocks, channels) = parts.next().expect("as many as there are channels");
            Self { channels, height, rows, blocks }
        }))
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

    /// Rows times map, every channel of the matrix by itself as a lobe: `L` RGBs a row. Rows for which `wanted` is false
    /// are 0. Gradient: [`Matrix::lobes_transposed`].
    #[must_use]
    pub fn lobes<const L: usize>(
        &self,
        map: &LightMap,
        wanted: impl Fn(usize) -> bool + Sync,
    ) -> Vec<[[f32; 3]; L]> {
        assert_eq!((map.height, self.channels), (self.height, L));
        let mut out = vec![[[0.0; 3]; L]; self.rows];
        out.par_chunks_mut(BLOCK).zip(&self.blocks).enumerate().for_each(|(b, (out, block))| {
            for (k, row) in block.rows.iter().enumerate().filter(|(k, _)| wanted(b * BLOCK + k)) {
                block.each_span(row, L, |start, n, values| {
                    for (lobe, sums) in out[k].iter_mut().enumerate() {
                        let values = &values[lobe * n..(lobe + 1) * n];
                        for (c, sum) in sums.iter_mut().enumerate() {
                            *sum += dot(values, &map.channel(c)[start..start + n]);
                        }
                    }
                });
            }
        });
        out
    }

    /// The transpose of [`Matrix::lobes`]: gradient with respect to the map, added to `grad`. Rows of zeros are skipped.
    pub fn lobes_transposed<const L: usize>(&self, grad_rows: &[[[f32; 3]; L]], grad: &mut LightMap) {
        assert_eq!((grad.height, grad_rows.len(), self.channels), (self.height, self.rows, L));
        self.spread(grad, |row| (grad_rows[row] != [[0.0; 3]; L]).then_some(&grad_rows[row][..]));
    }

    /// The transpose times an RGB a row: gradient with respect to the map, added to `grad`. Rows of zeros are skipped.
    pub fn transposed(&self, grad_rows: &[[f32; 3]], grad: &mut LightMap) {
        assert_eq!((grad.height, grad_rows.len()), (self.height, self.rows));
        self.spread(grad, |row| {
            (grad_rows[row] != [0.0; 3]).then_some(std::slice::from_ref(&grad_rows[row]))
        });
    }

    /// Adds every row times its weights to `grad`: one RGB for all channels of an entry (one or three, colour by colour), or
    /// one for each (lobes). Rows without weights are skipped.
    fn spread<'g>(&self, grad: &mut LightMap, weights: impl Fn(usize) -> Option<&'g [[f32; 3]]> + Sync) {
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
                        let Some(weights) = weights((p * share + b) * BLOCK + k) else { continue };
                        let coloured = weights.len() == 1 && self.channels == 3;
                        block.each_span(row, self.channels, |start, n, values| {
                            for (lobe, g) in weights.iter().enumerate() {
                                for c in 0..3 {
                                    let from = if coloured { c } else { lobe };
                                    let values = &values[from * n..(from + 1) * n];
                                    let out = &mut sum[c * texels + start..c * texels + start + n];
                                    for (o, v) in out.iter_mut().zip(values) {
                                        *o += g[c] * v;
                                    }
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

    /// Goal: two matrices that are filled together are those that are filled alone; lobes are the products of each channel,
    /// and their transpose is adjoint to them.
    #[test]
    fn lobes_are_channels() {
        let (rows, height) = (70, 4);
        let texels = 2 * height * height;
        let entry = |row: usize, i: usize| {
            if (row + i).is_multiple_of(3) { 0.0 } else { ((row * 31 + i * 17) % 101) as f32 / 100.0 }
        };
        let fill = |row: usize, dense: &mut [f32], _: &mut [f32; 3]| {
            dense.iter_mut().enumerate().for_each(|(i, v)| *v = entry(row, i));
        };
        let both = |row: usize, dense: &mut [Vec<f32>; 2], constant: &mut [f32; 3]| {
            dense.iter_mut().for_each(|d| fill(row, d, constant));
        };
        let [coloured, lobes] = Matrix::build_each(rows, height, [3, 5], both, |_| true).unwrap();
        assert!(coloured == Matrix::build(rows, height, 3, fill, |_| true).unwrap());
        let mut rng = Rng::new(3);
        let mut map = LightMap::zeros(height);
        map.data.iter_mut().for_each(|v| *v = rng.uniform());
        let out = lobes.lobes::<5>(&map, |row| row != 7);
        assert_eq!(out[7], [[0.0; 3]; 5]);
        let grad: Vec<[[f32; 3]; 5]> =
            (0..rows).map(|_| std::array::from_fn(|_| std::array::from_fn(|_| rng.normal()))).collect();
        let (mut forth, mut back) = (0.0f64, 0.0f64);
        for row in (0..rows).filter(|r| *r != 7) {
            for lobe in 0..5 {
                for c in 0..3 {
                    let exact: f64 = (0..texels)
                        .map(|t| f64::from(entry(row, lobe * texels + t)) * f64::from(map.channel(c)[t]))
                        .sum();
                    assert!((exact - f64::from(out[row][lobe][c])).abs() < 1e-4);
                    forth += exact * f64::from(grad[row][lobe][c]);
                }
            }
        }
        let mut skipped = grad.clone();
        skipped[7] = [[0.0; 3]; 5];
        let mut by_map = LightMap::zeros(height);
        lobes.lobes_transposed(&skipped, &mut by_map);
        for (g, l) in by_map.data.iter().zip(&map.data) {
            back += f64::from(*g) * f64::from(*l);
        }
        assert!((forth - back).abs() < 1e-3 * forth.abs().max(1.0), "{forth} {back}");
    }

    /// Goal: work that is stopped gives nothing.
    #[test]
    fn stopped_work() {
        assert!(Matrix::build(100, 2, 1, |_, _, _| {}, |_| false).is_none());
    }
}
