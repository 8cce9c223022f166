//! The object's radiance as matrices that a part's material is not in yet.
//!
//! Direct light on a surface is linear in what its material says at fixed roughness: with albedo a, metalness m and
//! `F₀ = 0.04 + m (a − 0.04)`
//!
//! ```text
//! radiance = (1 − m) a · D L + F₀ · S L + G L + emission
//! ```
//!
//! where D is the diffuse lobe, S the highlight's part that F₀ multiplies and G the rest of Schlick's term. The three are the same in all channels.
//! Between two roughnesses S and G are interpolated. What is not linear is light that meets the object twice: it is
//! traced at the material of the moment, kept with the other parts' light, and traced again when the material has moved
//! ([`crate::material`]).

use super::foreground::{Apart, Walk, visible};
use super::{Foreground, ForegroundConfig, Grid, Matrix, look};
use crate::light::LightMap;
use crate::object::Object;
use comgs_geom::Camera;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// RGB of five lobes: D, then S and G at the lower and at the upper roughness.
pub type LobeRow = [[f32; 3]; 5];

/// What of a part is in a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartShare {
    /// Its share of the covered part of the pixel.
    pub share: f32,
    /// Mean base colour that its factor multiplies.
    pub tint: Vec3,
    /// Mean metalness that its factor multiplies.
    pub metallic: f32,
}

/// Traced transport with one part's direct light apart.
#[derive(Clone, Debug)]
pub struct Lobes {
    /// The matrix of what does not follow the part's material, and what the camera sees.
    pub foreground: Foreground,
    /// The part in every row.
    pub rows: Vec<PartShare>,
    /// Factors on the part's roughness at which highlights were traced; equal where the roughness is fixed.
    pub roughness: [f32; 2],
    /// Share of the object's radiance under even light that met it more than once: what is not linear in the material.
    pub indirect: f32,
    /// Three or five lobes.
    lobes: Matrix,
}

/// Channels of the lobes' matrix.
#[must_use]
pub fn lobe_channels(roughness: [f32; 2]) -> usize {
    if roughness[0] == roughness[1] { 3 } else { 5 }
}

/// Units of the sums of light that threads share: integers add up to the same in any order.
const UNIT: f64 = (1u64 << 24) as f64;

/// Traces the matrices as [`super::trace_foreground`] does, with the direct light of `part` kept apart at two factors on its
/// roughness, joined by the same samples. Where a part's texture varies within a pixel its mean is taken.
pub fn trace_lobes(
    object: &Object,
    camera: &Camera,
    config: &ForegroundConfig,
    part: usize,
    roughness: [f32; 2],
    check: impl Fn(usize) -> bool + Sync,
) -> Option<Lobes> {
    assert!(config.height.is_multiple_of(2) && config.grid > 0 && config.depth > 0);
    let grid = Grid::new(config.height);
    let v = visible(object, camera, config.grid, config.seed);
    let part = part as u32;
    let channels = lobe_channels(roughness);
    let factors = if channels == 3 { &roughness[..1] } else { &roughness[..] };
    let rows: Vec<PartShare> = v
        .pixels
        .par_iter()
        .map(|&pixel| {
            let (seen, _) = look(object, camera, pixel as usize, config.grid, config.seed);
            let mut row = PartShare::default();
            for s in seen.iter().filter(|s| s.surface.part == part) {
                row.share += s.weight;
                row.tint += s.surface.texel.albedo * s.weight;
                row.metallic += s.surface.texel.metallic * s.weight;
            }
            if row.share > 0.0 {
                row.tint /= row.share;
                row.metallic /= row.share;
            }
            row
        })
        .collect();
    let sums = [const { AtomicU64::new(0) }; 2];
    let fill = |row: usize, dense: &mut [Vec<f32>; 2], constant: &mut [f32; 3]| {
        let pixel = v.pixels[row] as usize;
        let (seen, _) = look(object, camera, pixel, config.grid, config.seed);
        let [rest, lobes] = dense;
        let apart = Apart { part, roughness: factors, dense: lobes };
        let mut walk = Walk::new(object, &grid, config, pixel, rest, Some(apart));
        walk.pixel(&seen);
        *constant = walk.constant.to_array();
        for (sum, value) in sums.iter().zip([walk.total, walk.indirect]) {
            sum.fetch_add((f64::from(value) * UNIT) as u64, Ordering::Relaxed);
        }
    };
    let [matrix, lobes] = Matrix::build_each(v.pixels.len(), config.height, [3, channels], fill, check)?;
    let [total, indirect] = sums.map(|s| s.into_inner() as f64);
    let indirect = if total > 0.0 { (indirect / total) as f32 } else { 0.0 };
    Some(Lobes { foreground: v.with(matrix), rows, roughness, indirect, lobes })
}

impl Lobes {
    /// Every lobe under a map, by row; 0 for rows that are not wanted. Gradient: [`Lobes::transposed`].
    #[must_use]
    pub fn times(&self, map: &LightMap, wanted: impl Fn(usize) -> bool + Sync) -> Vec<LobeRow> {
        if lobe_channels(self.roughness) == 5 {
            return self.lobes.lobes::<5>(map, wanted);
        }
        let three = self.lobes.lobes::<3>(map, wanted);
        three.into_iter().map(|[d, s, g]| [d, s, g, [0.0; 3], [0.0; 3]]).collect()
    }

    /// Gradient with respect to the map for gradients with respect to the lobes, added to `grad`.
    pub fn transposed(&self, by_lobes: &[LobeRow], grad: &mut LightMap) {
        if lobe_channels(self.roughness) == 5 {
            return self.lobes.lobes_transposed(by_lobes, grad);
        }
        let three: Vec<[[f32; 3]; 3]> = by_lobes.iter().map(|r| [r[0], r[1], r[2]]).collect();
        self.lobes.lobes_transposed(&three, grad);
    }

    /// Memory of the numbers in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.foreground.matrix.bytes() + self.lobes.bytes()
    }
}
