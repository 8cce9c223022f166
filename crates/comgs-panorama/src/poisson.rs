//! Laplace's equation with data on an equirectangular grid.
//!
//! Every cell of the grid is a patch of the sphere. Between neighbours flows `w · (x_i − x_j)` with w the length of
//! their common edge over the distance of their centres:
//!
//! ```text
//! along a row:  w = Δφ / (sin φ_centre · Δθ)        between rows:  w = sin φ_edge · Δθ / Δφ
//! ```
//!
//! and a cell's equation is `Σ_j w_ij (x_i − x_j) + W_i t / (1 − t) · (x_i − data_i) = 0` with `W_i = Σ_j w_ij`, that
//! is, `x_i = (1 − t) · (weighted mean of the neighbours) + t · data_i`. Cells with t = 1 are not unknowns.

use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// The problem: three right-hand sides that share one matrix.
pub(crate) struct Cells {
    pub width: usize,
    pub height: usize,
    /// In [0, 1] for each cell: 1 is fixed, 0 is free.
    pub trust: Vec<f64>,
    /// Value to agree with; means nothing where trust is 0.
    pub data: Vec<DVec3>,
}

/// Energy norm of the residual at which the solution is good, relative to the spread of the data.
const TOLERANCE: f64 = 1e-6;
/// Grids up to this height are solved without a coarser one before.
const COARSEST: usize = 8;

/// The solution, or the relative residual and iterations where it was given up.
///
/// Some trust must be above 0. The same bytes at any thread count: sums are taken row by row in order.
pub(crate) fn solve(cells: &Cells) -> Result<Vec<DVec3>, (f64, usize)> {
    if cells.data.len() == 1 {
        // The only cell without neighbours that there can be.
        return Ok(cells.data.clone());
    }
    let seen = |i: &usize| cells.trust[*i] > 0.0;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for i in (0..cells.data.len()).filter(seen) {
        low = low.min(cells.data[i]);
        high = high.max(cells.data[i]);
    }
    let start = match coarser(cells) {
        Some(coarse) => {
            let solution = solve(&coarse)?;
            (0..cells.data.len())
                .map(|i| refine(&solution, &coarse, i % cells.width, i / cells.width))
                .collect()
        }
        // The middle of the data: with constant data it is the solution already.
        None => vec![0.5 * (low + high); cells.data.len()],
    };
    conjugate_gradients(cells, start, (high - low).max_element())
}

/// The problem on half as many cells each way; `None` where that is not possible or not worth it.
fn coarser(cells: &Cells) -> Option<Cells> {
    let (w, h) = (cells.width, cells.height);
    if w % 2 == 1 || h % 2 == 1 || h <= COARSEST {
        return None;
    }
    let (width, height) = (w / 2, h / 2);
    let mut coarse =
        Cells { width, height, trust: vec![0.0; width * height], data: vec![DVec3::ZERO; width * height] };
    for i in 0..width * height {
        let (x, y) = (2 * (i % width), 2 * (i / width));
        let four = [y * w + x, y * w + x + 1, (y + 1) * w + x, (y + 1) * w + x + 1];
        let sum: f64 = four.iter().map(|&k| cells.trust[k]).sum();
        if sum > 0.0 {
            coarse.trust[i] = sum / 4.0;
            coarse.data[i] = four.iter().map(|&k| cells.trust[k] * cells.data[k]).sum::<DVec3>() / sum;
        }
    }
    Some(coarse)
}

/// Bilinear value of a coarse solution at the centre of fine cell `(x, y)`.
fn refine(solution: &[DVec3], coarse: &Cells, x: usize, y: usize) -> DVec3 {
    let (w, h) = (coarse.width, coarse.height);
    let (x0, y0) = (x / 2, y / 2);
    let x1 = if x.is_multiple_of(2) { (x0 + w - 1) % w } else { (x0 + 1) % w };
    let y1 = if y.is_multiple_of(2) { y0.saturating_sub(1) } else { (y0 + 1).min(h - 1) };
    let at = |x: usize, y: usize| solution[y * w + x];
    0.75 * (0.75 * at(x0, y0) + 0.25 * at(x1, y0)) + 0.25 * (0.75 * at(x0, y1) + 0.25 * at(x1, y1))
}

/// The matrix, row by row of the grid.
struct Matrix<'a> {
    cells: &'a Cells,
    /// Weight between neighbours in each row; 0 when a row has one cell.
    along: Vec<f64>,
    /// Weight between row y − 1 and row y, for y in 0..=height; 0 at both ends.
    across: Vec<f64>,
}

impl<'a> Matrix<'a> {
    fn new(cells: &'a Cells) -> Self {
        let (w, h) = (cells.width, cells.height);
        let (d_phi, d_theta) = (PI / h as f64, 2.0 * PI / w as f64);
        let along =
            |y: usize| if w > 1 { d_phi / ((PI * (y as f64 + 0.5) / h as f64).sin() * d_theta) } else { 0.0 };
        let across = |y: usize| {
            if y == 0 || y == h { 0.0 } else { (PI * y as f64 / h as f64).sin() * d_theta / d_phi }
        };
        Self { cells, along: (0..h).map(along).collect(), across: (0..=h).map(across).collect() }
    }

    fn diagonal(&self, i: usize) -> f64 {
        let y = i / self.cells.width;
        let neighbours = 2.0 * self.along[y] + self.across[y] + self.across[y + 1];
        neighbours / (1.0 - self.cells.trust[i])
    }

    fn fixed(&self, i: usize) -> bool {
        self.cells.trust[i] >= 1.0
    }

    /// Row y of `A v`, where fixed cells hold 0 in `v` and give 0; or of the residual `b − A v` where fixed cells
    /// hold their value.
    fn row(&self, v: &[DVec3], y: usize, out: &mut [DVec3], residual: bool) {
        let (w, h) = (self.cells.width, self.cells.height);
        for x in 0..w {
            let i = y * w + x;
            if self.fixed(i) {
                out[x] = DVec3::ZERO;
                continue;
            }
            let left = v[y * w + if x == 0 { w - 1 } else { x - 1 }];
            let right = v[y * w + if x + 1 == w { 0 } else { x + 1 }];
            let mut neighbours = self.along[y] * (left + right);
            if y > 0 {
                neighbours += self.across[y] * v[i - w];
            }
            if y + 1 < h {
                neighbours += self.across[y + 1] * v[i + w];
            }
            let diagonal = self.diagonal(i);
            let product = diagonal * v[i] - neighbours;
            out[x] = if residual {
                diagonal * self.cells.trust[i] * self.cells.data[i] - product
            } else {
                product
            };
        }
    }
}

/// Exact solver for the couplings within one row: a cyclic tridiagonal matrix, factorised once (Thomas, with
/// Sherman–Morrison for the corner). Near the poles these couplings are by far the strongest.
struct Row {
    /// Elimination factors and reciprocal pivots.
    upper: Vec<f64>,
    pivot: Vec<f64>,
    lower: Vec<f64>,
    /// Solution for the corner's column, and the corner's two weights.
    corner: Vec<f64>,
    first: f64,
    last: f64,
    denominator: f64,
}

impl Row {
    fn new(matrix: &Matrix<'_>, y: usize) -> Self {
        let w = matrix.cells.width;
        let coupling = |a: usize, b: usize| {
            if matrix.fixed(y * w + a) || matrix.fixed(y * w + b) { 0.0 } else { -matrix.along[y] }
        };
        let mut diagonal: Vec<f64> =
            (0..w).map(|x| if matrix.fixed(y * w + x) { 1.0 } else { matrix.diagonal(y * w + x) }).collect();
        // A row of two cells has its two edges between the same cells; of one cell, none.
        let off: Vec<f64> = (0..w.saturating_sub(1)).map(|x| coupling(x, x + 1)).collect();
        let corner = if w > 1 { coupling(w - 1, 0) } else { 0.0 };
        let first = -diagonal[0];
        let last = corner;
        if corner != 0.0 {
            diagonal[0] -= first;
            diagonal[w - 1] -= corner * corner / first;
        }
        let mut row = Self {
            upper: vec![0.0; w],
            pivot: vec![0.0; w],
            lower: vec![0.0; w],
            corner: Vec::new(),
            first,
            last,
            denominator: 1.0,
        };
        for x in 0..w {
            row.lower[x] = if x > 0 { off[x - 1] } else { 0.0 };
            let before = if x > 0 { row.upper[x - 1] } else { 0.0 };
            row.pivot[x] = 1.0 / (diagonal[x] - row.lower[x] * before);
            row.upper[x] = if x + 1 < w { off[x] * row.pivot[x] } else { 0.0 };
        }
        if corner != 0.0 {
            let mut column = vec![DVec3::ZERO; w];
            column[0].x = first;
            column[w - 1].x = corner;
            row.tridiagonal(&mut column);
            row.corner = column.iter().map(|v| v.x).collect();
            row.denominator = 1.0 + row.corner[0] + row.last / row.first * row.corner[w - 1];
        }
        row
    }

    fn tridiagonal(&self, v: &mut [DVec3]) {
        let w = v.len();
        v[0] *= self.pivot[0];
        for x in 1..w {
            v[x] = (v[x] - self.lower[x] * v[x - 1]) * self.pivot[x];
        }
        for x in (0..w - 1).rev() {
            let next = v[x + 1];
            v[x] -= self.upper[x] * next;
        }
    }

    fn solve(&self, v: &mut [DVec3]) {
        self.tridiagonal(v);
        if !self.corner.is_empty() {
            let factor = (v[0] + self.last / self.first * v[v.len() - 1]) / self.denominator;
            for (v, c) in v.iter_mut().zip(&self.corner) {
                *v -= factor * *c;
            }
        }
    }
}

/// Preconditioned conjugate gradients from a starting field; the three right-hand sides step apart from each other.
fn conjugate_gradients(cells: &Cells, start: Vec<DVec3>, spread: f64) -> Result<Vec<DVec3>, (f64, usize)> {
    let (w, n) = (cells.width, cells.data.len());
    let matrix = Matrix::new(cells);
    let rows: Vec<Row> = (0..cells.height).into_par_iter().map(|y| Row::new(&matrix, y)).collect();
    let mut x = start;
    for i in (0..n).filter(|&i| matrix.fixed(i)) {
        x[i] = cells.data[i];
    }
    let dot = |a: &[DVec3], b: &[DVec3]| -> DVec3 {
        let partial: Vec<DVec3> = a
            .par_chunks(w)
            .zip(b.par_chunks(w))
            .map(|(a, b)| a.iter().zip(b).map(|(&a, &b)| a * b).sum())
            .collect();
        partial.into_iter().sum()
    };
    let precondition = |r: &[DVec3], z: &mut Vec<DVec3>| {
        z.copy_from_slice(r);
        z.par_chunks_mut(w).zip(&rows).for_each(|(z, row)| row.solve(z));
    };
    let mut r = vec![DVec3::ZERO; n];
    r.par_chunks_mut(w).enumerate().for_each(|(y, out)| matrix.row(&x, y, out, true));
    let mut z = vec![DVec3::ZERO; n];
    precondition(&r, &mut z);
    let mut p = z.clone();
    let mut q = vec![DVec3::ZERO; n];
    let mut energy = dot(&r, &z);
    let good = (TOLERANCE * spread).powi(2);
    let limit = 1000 + 20 * (cells.width + cells.height);
    for _ in 0..limit {
        // The absolute bound (1e-10 in log radiance) is for constant data, whose residual is rounding alone.
        if energy.max_element() <= good.max(1e-20) {
            return Ok(x);
        }
        q.par_chunks_mut(w).enumerate().for_each(|(y, out)| matrix.row(&p, y, out, false));
        let curvature = dot(&p, &q);
        // A right-hand side that is solved already stands still instead of dividing 0 by 0.
        let ratio = |a: DVec3, b: DVec3| {
            DVec3::from_array([0, 1, 2].map(|c| if b[c] > 0.0 { a[c] / b[c] } else { 0.0 }))
        };
        let step = ratio(energy, curvature);
        x.par_chunks_mut(w)
            .zip(p.par_chunks(w))
            .for_each(|(x, p)| x.iter_mut().zip(p).for_each(|(x, &p)| *x += step * p));
        r.par_chunks_mut(w)
            .zip(q.par_chunks(w))
            .for_each(|(r, q)| r.iter_mut().zip(q).for_each(|(r, &q)| *r -= step * q));
        precondition(&r, &mut z);
        let next = dot(&r, &z);
        let growth = ratio(next, energy);
        energy = next;
        p.par_chunks_mut(w)
            .zip(z.par_chunks(w))
            .for_each(|(p, z)| p.iter_mut().zip(z).for_each(|(p, &z)| *p = z + growth * *p));
    }
    Err((energy.max_element().max(0.0).sqrt() / spread.max(f64::MIN_POSITIVE), limit))
}
