//! A parameterisation of an octahedral light for optimisation.

use crate::OctahedralLight;
use comgs_geom::octahedral;
use glam::Vec3;
use rayon::prelude::*;

/// The logarithm of radiance as a sum over octahedral maps of rising resolution, each interpolated to the next:
/// `S₀ = level₀`, `S_k = up(S_{k−1}) + level_k`, `radiance = exp(S_last)`, where `up` doubles the resolution, bilinear
/// and across the map's edges. `S_last` is held to [[`LightPyramid::LEAST_LOG`], [`LightPyramid::GREATEST_LOG`]]; beyond
/// there is no gradient.
///
/// It conditions the optimisation: a step that moves every parameter equally far (Adam's) moves broad light by as many
/// steps as there are levels at once, and detail by one. Radiance is positive without a constraint.
#[derive(Clone, Debug, PartialEq)]
pub struct LightPyramid {
    /// Side in texels of every level, each twice the one before.
    pub sizes: Vec<usize>,
    /// Values of every level, `size · size · 3`, `[texel][rgb]`, coarse first.
    pub levels: Vec<Vec<f32>>,
}

/// Weights of the four fine texels along one axis, beginning one before the first half of a coarse texel, that take from
/// it when the resolution doubles: centres lie at ±¼ and ±¾ of it.
const TAPS: [f32; 4] = [0.25, 0.75, 0.75, 0.25];

/// Rows of a map that one task takes.
const ROWS: usize = 16;

impl LightPyramid {
    /// Least logarithm of radiance: 6.1 · 10⁻⁶.
    pub const LEAST_LOG: f32 = -12.0;
    /// Greatest logarithm of radiance: 1.6 · 10⁵.
    pub const GREATEST_LOG: f32 = 12.0;
    /// Side that levels are not halved below.
    pub const COARSEST: usize = 8;

    /// A light of the same radiance from everywhere (held to the range of radiance), with levels of `size`, `size/2`, …
    /// as long as they are even and at least 8 is left: all in the coarsest, so that the others start at 0.
    #[must_use]
    pub fn constant(size: usize, radiance: Vec3) -> Self {
        let mut sizes = vec![size.max(1)];
        while sizes[0].is_multiple_of(2) && sizes[0] / 2 >= Self::COARSEST {
            sizes.insert(0, sizes[0] / 2);
        }
        let mut levels: Vec<Vec<f32>> = sizes.iter().map(|s| vec![0.0; 3 * s * s]).collect();
        let log = radiance.to_array().map(|v| held(v.ln()));
        levels[0].chunks_exact_mut(3).for_each(|t| t.copy_from_slice(&log));
        Self { sizes, levels }
    }

    /// Side of the light in texels.
    #[must_use]
    pub fn size(&self) -> usize {
        self.sizes[self.sizes.len() - 1]
    }

    /// Number of parameters.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.levels.iter().map(Vec::len).sum()
    }

    /// The light. A sum that is NaN gives the least radiance. Gradient: [`LightPyramid::vjp`].
    #[must_use]
    pub fn to_light(&self) -> OctahedralLight {
        let mut sum = self.levels[0].clone();
        for (level, &size) in self.levels.iter().zip(&self.sizes).skip(1) {
            sum = doubled(&sum, level, size);
        }
        sum.par_iter_mut().with_min_len(ROWS * 1024).for_each(|v| *v = held(*v).exp());
        OctahedralLight::from_sound(self.size(), sum)
    }

    /// Adds to `grad_levels` the gradient with respect to the levels, given the light that [`LightPyramid::to_light`]
    /// returned and the gradient with respect to its texels. The same bytes at any number of threads.
    ///
    /// # Panics
    /// When an array has another shape than what it is the gradient of.
    pub fn vjp(&self, light: &OctahedralLight, grad_texels: &[f32], grad_levels: &mut [Vec<f32>]) {
        assert_eq!(light.size(), self.size(), "a light of another size");
        assert_eq!(grad_texels.len(), light.texels().len(), "a gradient of another light");
        let (least, greatest) = (Self::LEAST_LOG.exp(), Self::GREATEST_LOG.exp());
        let mut grad: Vec<f32> = light
            .texels()
            .iter()
            .zip(grad_texels)
            .map(|(&v, &g)| if v > least && v < greatest { v * g } else { 0.0 })
            .collect();
        for k in (0..self.levels.len()).rev() {
            assert_eq!(grad_levels[k].len(), grad.len(), "a gradient of another pyramid");
            grad_levels[k].iter_mut().zip(&grad).for_each(|(a, b)| *a += b);
            if k > 0 {
                grad = doubled_vjp(&grad, self.sizes[k - 1]);
            }
        }
    }
}

/// A logarithm of radiance held to the range; NaN (of a negative radiance) is the least.
fn held(log: f32) -> f32 {
    if log.is_nan() {
        LightPyramid::LEAST_LOG
    } else {
        log.clamp(LightPyramid::LEAST_LOG, LightPyramid::GREATEST_LOG)
    }
}

/// `level + up(coarse)` for a level of side `size`.
fn doubled(coarse: &[f32], level: &[f32], size: usize) -> Vec<f32> {
    let half = size / 2;
    let mut out = level.to_vec();
    out.par_chunks_mut(3 * size * ROWS).enumerate().for_each(|(chunk, rows)| {
        for (i, texel) in rows.chunks_exact_mut(3).enumerate() {
            let (column, row) = (i % size, chunk * ROWS + i / size);
            let (x, y) = ((column / 2) as isize, (row / 2) as isize);
            // The nearer coarse centre weighs ¾, the one on the fine texel's other side ¼.
            let x_far = if column % 2 == 0 { x - 1 } else { x + 1 };
            let y_far = if row % 2 == 0 { y - 1 } else { y + 1 };
            for (x, y, weight) in
                [(x, y, 0.5625), (x_far, y, 0.1875), (x, y_far, 0.1875), (x_far, y_far, 0.0625)]
            {
                let from = 3 * octahedral::neighbour(x, y, half);
                for c in 0..3 {
                    texel[c] += weight * coarse[from + c];
                }
            }
        }
    });
    out
}

/// Gradient of [`doubled`] with respect to the coarse map of side `half`: what every coarse texel gave, gathered from
/// where it went. Across an edge the map is continued by itself in both directions, so the fine texels past the edge of
/// the fine map are those that took from there.
fn doubled_vjp(grad: &[f32], half: usize) -> Vec<f32> {
    let mut out = vec![0.0; 3 * half * half];
    out.par_chunks_mut(3 * half * ROWS).enumerate().for_each(|(chunk, rows)| {
        for (i, texel) in rows.chunks_exact_mut(3).enumerate() {
            let (column, row) = ((2 * (i % half)) as isize, (2 * (chunk * ROWS + i / half)) as isize);
            for (y, weight_y) in TAPS.into_iter().enumerate() {
                for (x, weight_x) in TAPS.into_iter().enumerate() {
                    let (x, y) = (column + x as isize - 1, row + y as isize - 1);
                    let from = 3 * octahedral::neighbour(x, y, 2 * half);
                    for c in 0..3 {
                        texel[c] += weight_x * weight_y * grad[from + c];
                    }
                }
            }
        }
    });
    out
}
