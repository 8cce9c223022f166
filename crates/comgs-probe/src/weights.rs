//! Which probes a shading point is interpolated from, and how much each counts.

use crate::{LookupConfig, MAX_NEIGHBOURS, ProbeIndex, ProbeSet, VisibilityWeight};
use comgs_geom::octahedral;
use glam::Vec3;
use rayon::prelude::*;

/// The probes around a shading point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbours {
    /// Numbers of the probes; the first `count` are used, nearest first.
    pub probes: [u32; MAX_NEIGHBOURS],
    /// Their weights: not negative, sum 1; 0 beyond `count`.
    pub weights: [f32; MAX_NEIGHBOURS],
    /// How many probes count; 0 only where nothing could be found at all.
    pub count: u32,
}

impl Default for Neighbours {
    /// None.
    fn default() -> Self {
        Self { probes: [0; MAX_NEIGHBOURS], weights: [0.0; MAX_NEIGHBOURS], count: 0 }
    }
}

impl Neighbours {
    /// Probes and their weights.
    pub fn iter(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        let count = self.count as usize;
        self.probes[..count].iter().zip(&self.weights[..count]).map(|(&p, &w)| (p as usize, w))
    }
}

impl ProbeIndex {
    /// The probes to interpolate at a shading point `x` (world) with unit normal `normal`, after ComGS Eq. 9–11: the
    /// `config.neighbours` nearest within the radius, with weights in proportion to `w_s · w_b · w_v`,
    ///
    /// ```text
    /// d = p − x,  r = ‖d‖,  r₀ = max(r, min_distance)
    /// w_s = 1 / r₀                             Eq. 10, bounded
    /// w_b = ½ (1 + (d / r₀) · n) + 0.01        Eq. 11; at r = 0, where d has no direction, 0.51
    /// w_v = 1, or with VisibilityWeight::Chebyshev
    ///       y = x + normal_bias n,  ρ = ‖y − p‖,  (μ, μ₂) = the probe's moments in the direction y − p
    ///       σ² = max(μ₂ − μ², min_deviation²)
    ///       w_v = max(visibility_floor, (σ² / (σ² + (ρ − μ)²))³) where ρ > μ, else 1
    /// ```
    ///
    /// w_v is that of DDGI (Majercik et al. 2019, § 4.2), with the one-sided Chebyshev inequality of variance shadow
    /// maps. Beyond `far_distance` moments say nothing, so w_v is 1 there.
    ///
    /// Fewer than `neighbours` probes in the radius are used as they are. Without any, the nearest probe is taken,
    /// however far, with weight 1. Count 0 means that the index is empty or `x` is not finite. A normal that is not
    /// finite is taken as 0, which makes w_b constant.
    ///
    /// The set must be the one that the index was made of. Weights are continuous in `x` and `normal` but for probes
    /// that enter and leave the choice; they are not differentiated here. Reference: [`crate::reference::neighbours`].
    #[must_use]
    pub fn query(&self, x: Vec3, normal: Vec3, set: &ProbeSet, config: &LookupConfig) -> Neighbours {
        let mut near = self.within_radius(x, config.neighbours);
        if near.count == 0 {
            near = self.nearest(x, 1);
        }
        let normal = if normal.is_finite() { normal } else { Vec3::ZERO };
        let mut out = Neighbours { count: near.count as u32, ..Neighbours::default() };
        let mut sum = 0.0;
        for k in 0..near.count {
            let (probe, position) = (near.probes[k], near.positions[k]);
            let d = position - x;
            let bounded = near.distance_squared[k].sqrt().max(config.min_distance);
            let spatial = 1.0 / bounded;
            let back_face = 0.5 * (1.0 + d.dot(normal) / bounded) + 0.01;
            let visible = match config.visibility {
                VisibilityWeight::None => 1.0,
                VisibilityWeight::Chebyshev => {
                    visibility(set, probe as usize, x + config.normal_bias * normal - position, config)
                }
            };
            // Rounding, or a normal that is too long, may make w_b negative.
            let weight = (spatial * back_face * visible).max(f32::MIN_POSITIVE);
            out.probes[k] = probe;
            out.weights[k] = weight;
            sum += weight;
        }
        if near.count == 1 {
            out.weights[0] = 1.0;
        } else {
            for weight in &mut out.weights[..near.count] {
                *weight /= sum;
            }
        }
        out
    }

    /// [`ProbeIndex::query`] of many points, in parallel; the same bytes at any thread count. Points and normals are
    /// taken in pairs.
    #[must_use]
    pub fn query_batch(
        &self,
        points: &[Vec3],
        normals: &[Vec3],
        set: &ProbeSet,
        config: &LookupConfig,
    ) -> Vec<Neighbours> {
        points
            .par_iter()
            .zip(normals)
            .with_min_len(64)
            .map(|(&x, &normal)| self.query(x, normal, set, config))
            .collect()
    }
}

/// Bound on the probability that the probe sees the end of `way`, which begins at the probe.
fn visibility(set: &ProbeSet, probe: usize, way: Vec3, config: &LookupConfig) -> f32 {
    let distance = way.length();
    if distance >= set.far_distance {
        return 1.0;
    }
    let moments = set.moments_of(probe);
    let footprint = octahedral::footprint(way, set.resolution);
    let [mut mean, mut square] = [0.0f32; 2];
    for (texel, weight) in footprint.texels.iter().zip(footprint.weights) {
        let m = moments[*texel as usize];
        mean += weight * m[0];
        square += weight * m[1];
    }
    if distance <= mean {
        return 1.0;
    }
    let variance = (square - mean * mean).max(config.min_deviation * config.min_deviation);
    let behind = distance - mean;
    let bound = variance / (variance + behind * behind);
    (bound * bound * bound).max(config.visibility_floor)
}
