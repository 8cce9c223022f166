//! Light transport as matrices: with geometry, camera and material fixed, the object's radiance (DiPIR Eq. 4) and the
//! light that it keeps from the ground (Eq. 5) are linear in the map. Traced once; afterwards an image is a matrix times
//! the map, and a gradient its transpose.
//!
//! A row is a pixel, a column a texel. Rows are sparse: what lies behind the surface or is hidden is left out, in spans of
//! consecutive texels, so that a product runs over slices.

mod foreground;
mod lobes;
mod matrix;
mod shadow;

pub(crate) use foreground::look;
pub use foreground::{Foreground, ForegroundConfig, count_pixels, trace_foreground};
pub use lobes::{LobeRow, Lobes, PartShare, lobe_channels, trace_lobes};
pub use matrix::{Matrix, Row};
pub use shadow::{DARK, Ratios, Shadow, ShadowConfig, trace_shadow};

use comgs_geom::Rng;
use glam::Vec3;
use std::f32::consts::PI;

/// Bytes that a foreground matrix of `rows` pixels under a map of `height` rows may take at most.
#[must_use]
pub fn most_bytes(rows: usize, height: usize, channels: usize) -> usize {
    rows * (2 * height * height * channels * size_of::<f32>() + size_of::<Row>())
}

/// Texels of the map and directions inside them.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    pub height: usize,
    pub width: usize,
    /// Cosine of the polar angle at the edges of rows.
    edges: Vec<f32>,
    /// Sine and cosine of the azimuth at the edges of columns.
    azimuths: Vec<Vec3>,
    /// Solid angle of a texel by row.
    pub omega: Vec<f32>,
}

/// Pieces that a column is cut into for the table of azimuths.
const AZIMUTH_PIECES: usize = 16;

impl Grid {
    pub fn new(height: usize) -> Self {
        let width = 2 * height;
        let edges = (0..=height).map(|r| (PI * r as f32 / height as f32).cos()).collect();
        let pieces = width * AZIMUTH_PIECES;
        let azimuths = (0..pieces)
            .map(|k| {
                let theta = PI - 2.0 * PI * (k as f32 + 0.5) / pieces as f32;
                Vec3::new(theta.cos(), theta.sin(), 0.0)
            })
            .collect();
        let omega = (0..height).map(|r| comgs_geom::equirect::texel_solid_angle(r, width, height)).collect();
        Self { height, width, edges, azimuths, omega }
    }

    pub fn texels(&self) -> usize {
        self.width * self.height
    }

    /// A direction in a texel, uniform by solid angle (the azimuth to a sixteenth of a texel).
    pub fn inside(&self, texel: usize, rng: &mut Rng) -> Vec3 {
        let row = texel / self.width;
        let bits = rng.next_u32();
        let z = self.edges[row]
            + (bits >> 8) as f32 * (1.0 / 16_777_216.0) * (self.edges[row + 1] - self.edges[row]);
        self.at(texel % self.width, bits, z)
    }

    /// A direction in a texel, with density proportional to |cos φ| (`∫ cos φ sin φ dφ` is a quarter of the change of
    /// `−cos 2φ`).
    pub fn inside_cosine(&self, texel: usize, rng: &mut Rng) -> Vec3 {
        let row = texel / self.width;
        let bits = rng.next_u32();
        let (a, b) = (self.edges[row], self.edges[row + 1]);
        let u = (bits >> 8) as f32 * (1.0 / 16_777_216.0);
        let z = (a * a + u * (b * b - a * a)).max(0.0).sqrt().copysign(a + b);
        self.at(texel % self.width, bits, z)
    }

    fn at(&self, column: usize, bits: u32, z: f32) -> Vec3 {
        let piece = column * AZIMUTH_PIECES + (bits as usize & (AZIMUTH_PIECES - 1));
        let r = (1.0 - z * z).max(0.0).sqrt();
        let mut direction = self.azimuths[piece] * r;
        direction.z = z;
        direction
    }

    /// Texel of a unit direction.
    pub fn texel_of(&self, direction: Vec3) -> usize {
        let (u, v) = comgs_geom::equirect::uv_from_direction(direction);
        let column = ((u * self.width as f32) as usize).min(self.width - 1);
        let row = ((v * self.height as f32) as usize).min(self.height - 1);
        row * self.width + column
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: directions drawn in a texel fall into it, and their means are those of the densities: of cos φ under uniform
    /// solid angle the middle of the edges' cosines, under the cosine density `⅔ (b³ − a³)/(b² − a²)`.
    #[test]
    fn directions_inside_texels() {
        let grid = Grid::new(16);
        let mut rng = Rng::new(2);
        for texel in [5, 16 * 32 / 2 - 3, 16 * 32 / 2 + 9, 500, 37] {
            let (mut mean, mut cosine_mean) = (0.0f64, 0.0f64);
            for _ in 0..4000 {
                let d = grid.inside(texel, &mut rng);
                assert!((d.length() - 1.0).abs() < 1e-5);
                assert_eq!(grid.texel_of(d), texel);
                mean += f64::from(d.z) / 4000.0;
                let d = grid.inside_cosine(texel, &mut rng);
                cosine_mean += f64::from(d.z) / 4000.0;
            }
            let row = texel / 32;
            let (a, b) = (f64::from(grid.edges[row]), f64::from(grid.edges[row + 1]));
            assert!((mean - 0.5 * (a + b)).abs() < 3e-3, "{mean}");
            let paper = 2.0 / 3.0 * (b.powi(3) - a.powi(3)) / (b * b - a * a);
            assert!((cosine_mean - paper).abs() < 3e-3, "{cosine_mean} {paper}");
        }
    }
}
