//! The shadow ratio where the frames need it, worked out once for a placement and read while frames are made.
//!
//! The ratio is a property of a point of the scene and its normal, not of the camera that looks at it. [`ReceiverCloud`]
//! holds the points that a set of cameras sees; [`ShadowCache::build`] covers them with cells that shrink where the ratio
//! is not linear (contact, shadow edges) and stay large where it is (open floor), down to what the cameras resolve; a frame
//! reads a cell a pixel.
//!
//! A cell is a cube of one of six classes of normals (±x, ±y, ±z, by the largest component). Its surface is taken for a
//! plane over the two other axes, so it has four corners instead of eight, and a floor and a wall in one cube do not mix.
//! Corners are shared between neighbours, so the ratio is continuous where the surface is; between a fine cell and a coarse
//! one it may jump by the tolerance.

mod build;
mod cells;
mod receiver_cloud;

pub use receiver_cloud::ReceiverCloud;

use crate::field_shadow::ShadowRatios;
use crate::receivers::Receivers;
use cells::{Cells, Found};
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;

/// How fine a cache is.
#[derive(Clone, Debug, PartialEq)]
pub struct CacheConfig {
    /// Error of the ratio within a cell from which on it is cut, linear; above 0. A ratio of 0.01 is about one code value
    /// of 8 bit in a light grey.
    pub tolerance: f32,
    /// Cells are not cut below this many pixels of the camera that is nearest; above 0.
    pub pixels: f32,
    /// Largest cells, in radii of the object's bounding sphere; above 0.
    pub largest: f32,
}

impl Default for CacheConfig {
    fn default() -> Self {
        Self { tolerance: 0.01, pixels: 2.0, largest: 1.0 }
    }
}

impl CacheConfig {
    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        [("tolerance", self.tolerance), ("pixels", self.pixels), ("largest", self.largest)]
            .into_iter()
            .filter(|(_, v)| !(*v > 0.0 && v.is_finite()))
            .map(|(name, v)| format!("{name} is {v}, expected a finite value above 0"))
            .collect()
    }
}

/// Cached shadow ratios of a placement.
#[derive(Clone, Debug)]
pub struct ShadowCache {
    cells: Cells,
    ratios: Vec<Vec3>,
    statistics: CacheStatistics,
}

/// What a cache took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CacheStatistics {
    /// Points of the scene it was built for.
    pub points: usize,
    /// Cells that are read.
    pub cells: usize,
    /// Points whose ratio was worked out, corners and trials.
    pub evaluated: usize,
    /// Bytes.
    pub bytes: usize,
    /// Seconds.
    pub seconds: f64,
}

/// A frame's shadow, read.
#[derive(Clone, Debug)]
pub struct CachedShadow {
    /// Ratio, three channels in [0, 1].
    pub ratio: Image,
    /// Pixels that the cache did not know and that were worked out.
    pub missed: usize,
}

impl ShadowCache {
    /// What it took.
    #[must_use]
    pub fn statistics(&self) -> CacheStatistics {
        self.statistics
    }

    /// Mean side of the cells that are read, world units, and of the smallest; for reports.
    #[must_use]
    pub fn cell_sizes(&self) -> (f32, f32) {
        self.cells.sizes()
    }

    /// The shadow on a frame's receivers. Pixels that no cell covers (another camera, a surface seen for the first time)
    /// are worked out by `exact`, so a frame is never wrong for being new. Deterministic.
    ///
    /// Not differentiable. Reference: `exact` for every pixel.
    #[must_use]
    pub fn read(&self, receivers: &Receivers, exact: &dyn ShadowRatios) -> CachedShadow {
        let (width, height) = (receivers.width, receivers.height);
        let mut ratio = Image::filled(width, height, 3, 1.0);
        let missed: Vec<usize> = ratio
            .data
            .par_chunks_exact_mut(3 * width)
            .enumerate()
            .flat_map_iter(|(y, row)| {
                let mut missed = Vec::new();
                let mut last = Found::default();
                for x in 0..width {
                    let i = y * width + x;
                    if !receivers.is_surface(i) {
                        continue;
                    }
                    match self.cells.find(receivers.points[i], receivers.normals[i], &mut last) {
                        Some(cell) => {
                            let value = cell.interpolate(receivers.points[i], &self.ratios);
                            row[3 * x..3 * x + 3].copy_from_slice(&value.to_array());
                        }
                        None => missed.push(i),
                    }
                }
                missed
            })
            .collect();
        let points: Vec<Vec3> = missed.iter().map(|&i| receivers.points[i]).collect();
        let normals: Vec<Vec3> = missed.iter().map(|&i| receivers.normals[i]).collect();
        for (i, value) in missed.iter().zip(exact.ratios(&points, &normals)) {
            ratio.data[3 * i..3 * i + 3].copy_from_slice(&value.to_array());
        }
        CachedShadow { ratio, missed: missed.len() }
    }
}

#[cfg(test)]
mod tests;
