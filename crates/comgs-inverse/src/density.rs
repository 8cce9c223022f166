//! Growth and pruning by multi-view error.
//!
//! Between two rounds every training step adds, for each surfel, the blend-weighted image error it was part of and its
//! blend weight (both come out of the rasteriser's gradient pass at no extra cost). Surfels that carry much error in the
//! views that see them are split; those that no view needs are removed (after FastGS, which scores by multi-view
//! error instead of by gradient norm). The total never exceeds the budget.

use comgs_surfel::SurfelCloud;
use comgs_surfel::activation::{logit, sigmoid};
use glam::Vec3;

/// Sums since the last round, one entry a surfel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Σ over views and pixels of weight · error.
    pub error: Vec<f32>,
    /// Σ over views and pixels of weight.
    pub weight: Vec<f32>,
    /// Number of views that saw the surfel.
    pub views: Vec<f32>,
}

impl Evidence {
    /// No evidence yet for `n` surfels.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { error: vec![0.0; n], weight: vec![0.0; n], views: vec![0.0; n] }
    }

    /// Adds one view's sums; `scale` is the area of a full-resolution pixel in pixels of that view's level.
    pub fn add(&mut self, error: &[f32], weight: &[f32], scale: f32) {
        for i in 0..error.len() {
            if weight[i] > 0.0 {
                self.error[i] += error[i] * scale;
                self.weight[i] += weight[i] * scale;
                self.views[i] += 1.0;
            }
        }
    }
}

/// Settings of a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityConfig {
    /// Surfels fainter than this are removed.
    pub min_opacity: f32,
    /// Surfels whose mean weight (in full-resolution pixels) over the views that see them is below this are removed.
    pub min_weight: f32,
    /// At most this fraction of the surfels is split in one round.
    pub max_growth: f32,
    /// Never more surfels than this.
    pub budget: usize,
}

/// What a round did: the new cloud is `order` of the old one, with changed rows flagged.
#[derive(Clone, Debug)]
pub struct Round {
    /// The new cloud.
    pub cloud: SurfelCloud,
    /// For each new surfel the old one it comes from.
    pub order: Vec<u32>,
    /// Whether its optimiser state starts afresh.
    pub fresh: Vec<bool>,
    /// Surfels removed.
    pub removed: usize,
    /// Surfels split in two.
    pub split: usize,
}

/// One round of pruning and, when `grow`, splitting.
///
/// A split surfel becomes two along its longer axis, half a standard deviation to either side, with 0.65 of the length
/// along it, and the opacity that keeps what both let through equal to what the one did. Deterministic.
#[must_use]
pub fn round(cloud: &SurfelCloud, evidence: &Evidence, config: &DensityConfig, grow: bool) -> Round {
    let n = cloud.len();
    let keep: Vec<bool> = (0..n)
        .map(|i| {
            let needed = evidence.weight[i] >= config.min_weight * evidence.views[i].max(1.0);
            needed && sigmoid(cloud.opacity_logits[i]) >= config.min_opacity
        })
        .collect();
    let kept = keep.iter().filter(|k| **k).count();
    let mut split = vec![false; n];
    let mut splits = 0;
    if grow {
        let room = config.budget.saturating_sub(kept).min((config.max_growth * kept as f32) as usize);
        // Error a view: a surfel seen twice as often is not twice as wrong.
        let score = |i: usize| evidence.error[i] / evidence.views[i].max(1.0);
        let mut candidates: Vec<u32> =
            (0..n as u32).filter(|&i| keep[i as usize] && score(i as usize) > 0.0).collect();
        candidates.sort_by(|&a, &b| score(b as usize).total_cmp(&score(a as usize)).then(a.cmp(&b)));
        candidates.truncate(room);
        for &i in &candidates {
            split[i as usize] = true;
        }
        splits = candidates.len();
    }
    let mut order = Vec::with_capacity(kept + splits);
    let mut fresh = Vec::with_capacity(kept + splits);
    let mut side = Vec::with_capacity(kept + splits);
    for i in 0..n {
        if !keep[i] {
            continue;
        }
        let sides: &[f32] = if split[i] { &[1.0, -1.0] } else { &[0.0] };
        for &s in sides {
            order.push(i as u32);
            fresh.push(split[i]);
            side.push(s);
        }
    }
    let mut out = cloud.gathered(&order);
    for (k, &s) in side.iter().enumerate() {
        if s == 0.0 {
            continue;
        }
        let axis = usize::from(out.log_scales[k][1] > out.log_scales[k][0]);
        let direction = out.rotation(k).col(axis);
        let length = out.log_scales[k][axis].exp();
        let moved = Vec3::from_array(out.positions[k]) + direction * (0.5 * s * length);
        if moved.is_finite() {
            out.positions[k] = moved.to_array();
        }
        out.log_scales[k][axis] += 0.65f32.ln();
        let opacity = sigmoid(out.opacity_logits[k]).min(0.995);
        out.opacity_logits[k] = logit(1.0 - (1.0 - opacity).powf(0.75));
    }
    Round { cloud: out, order, fresh, removed: n - kept, split: splits }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_surfel::ColorEncoding;

    fn cloud(n: usize) -> SurfelCloud {
        let mut cloud = SurfelCloud::empty(0, ColorEncoding::Srgb);
        for i in 0..n {
            cloud.positions.push([i as f32, 0.0, 0.0]);
            cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
            cloud.log_scales.push([0.0, -1.0]);
            cloud.opacity_logits.push(1.0);
            cloud.sh.extend([0.1, 0.2, 0.3]);
        }
        cloud
    }

    const CONFIG: DensityConfig =
        DensityConfig { min_opacity: 0.05, min_weight: 0.01, max_growth: 0.5, budget: 12 };

    /// Goal: the worst surfels are split within budget and growth limits, the useless ones are removed, rows stay together.
    #[test]
    fn splits_the_worst_and_removes_the_useless() {
        let mut c = cloud(10);
        c.opacity_logits[4] = -6.0;
        let mut e = Evidence::new(10);
        let error: Vec<f32> = (0..10).map(|i| i as f32).collect();
        let mut weight = vec![1.0; 10];
        weight[5] = 1e-4;
        e.add(&error, &weight, 1.0);
        let r = round(&c, &e, &CONFIG, true);
        assert_eq!((r.removed, r.split), (2, 4));
        assert_eq!(r.cloud.len(), 12);
        assert_eq!(r.order, [0, 1, 2, 3, 6, 6, 7, 7, 8, 8, 9, 9]);
        assert!(r.cloud.problems().is_empty());
        // Two halves around the old centre.
        assert!((r.cloud.positions[4][0] + r.cloud.positions[5][0] - 12.0).abs() < 1e-5);
        assert!(!r.fresh[0] && r.fresh[4]);
        assert_eq!(round(&c, &e, &CONFIG, false).split, 0);
    }

    /// Goal: a full budget never grows.
    #[test]
    fn budget_is_hard() {
        let c = cloud(12);
        let mut e = Evidence::new(12);
        e.add(&[1.0; 12], &[1.0; 12], 1.0);
        assert_eq!(round(&c, &e, &CONFIG, true).cloud.len(), 12);
    }
}
