//! The lookup once more as a specification: all probes, no index, octahedral mapping included, f64. A judge for tests
//! and for whoever doubts; slow.

use crate::{LookupConfig, ProbeSet, VisibilityWeight};
use glam::{DVec2, DVec3};

/// What [`crate::ProbeIndex::query`] chooses, nearest first, with weights of sum 1.
#[must_use]
pub fn neighbours(
    set: &ProbeSet,
    radius: f64,
    config: &LookupConfig,
    x: DVec3,
    normal: DVec3,
) -> Vec<(usize, f64)> {
    let mut all: Vec<(usize, f64)> = set
        .positions
        .iter()
        .map(|p| p.as_dvec3().distance(x))
        .enumerate()
        .filter(|(_, r)| r.is_finite())
        .collect();
    all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    let within = all.iter().take_while(|(_, r)| *r <= radius).count().min(config.neighbours);
    all.truncate(within.max(1));
    if all.len() == 1 {
        return vec![(all[0].0, 1.0)];
    }
    let weights: Vec<f64> = all.iter().map(|&(probe, r)| weight(set, config, probe, r, x, normal)).collect();
    let sum: f64 = weights.iter().sum();
    all.iter().zip(weights).map(|(&(probe, _), w)| (probe, w / sum)).collect()
}

/// `w_s · w_b · w_v` of ComGS Eq. 10, 11 and DDGI.
fn weight(set: &ProbeSet, config: &LookupConfig, probe: usize, r: f64, x: DVec3, normal: DVec3) -> f64 {
    let position = set.positions[probe].as_dvec3();
    let bounded = r.max(f64::from(config.min_distance));
    let spatial = 1.0 / bounded;
    let back_face = 0.5 * (1.0 + ((position - x) / bounded).dot(normal)) + 0.01;
    let way = x + f64::from(config.normal_bias) * normal - position;
    let visible = match config.visibility {
        VisibilityWeight::None => 1.0,
        VisibilityWeight::Chebyshev => visibility(set, config, probe, way),
    };
    spatial * back_face * visible
}

fn visibility(set: &ProbeSet, config: &LookupConfig, probe: usize, way: DVec3) -> f64 {
    let moment = |c: usize| bilinear(set.resolution, way, |t| f64::from(set.moments_of(probe)[t][c]));
    let (mean, square, distance) = (moment(0), moment(1), way.length());
    if distance <= mean || distance >= f64::from(set.far_distance) {
        return 1.0;
    }
    let variance = (square - mean * mean).max(f64::from(config.min_deviation).powi(2));
    let bound = variance / (variance + (distance - mean).powi(2));
    bound.powi(3).max(f64::from(config.visibility_floor))
}

/// What [`ProbeSet::lookup`] gives, from neighbours as [`neighbours`] returns them.
#[must_use]
pub fn lookup(set: &ProbeSet, neighbours: &[(usize, f64)], direction: DVec3) -> [f64; 4] {
    std::array::from_fn(|c| {
        neighbours
            .iter()
            .map(|&(probe, w)| {
                w * bilinear(set.resolution, direction, |t| f64::from(set.texture(probe)[t][c]))
            })
            .sum()
    })
}

/// Bilinear interpolation of an octahedral map, `texel(row · size + column)`, continued across the folds.
#[must_use]
pub fn bilinear(size: usize, direction: DVec3, texel: impl Fn(usize) -> f64) -> f64 {
    let place = uv(direction) * size as f64 - 0.5;
    let first = place.floor();
    let mut sum = 0.0;
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let corner = first + DVec2::new(dx, dy);
        let weight = (1.0 - (place - corner).abs()).x * (1.0 - (place - corner).abs()).y;
        sum += weight * texel(folded(corner, size));
    }
    sum
}

/// Texel under a centre that may lie up to one texel outside: the map's edges are glued to themselves, turned about
/// their middles.
fn folded(corner: DVec2, size: usize) -> usize {
    let n = size as f64;
    let (mut x, mut y) = (corner.x, corner.y);
    if x < 0.0 || x >= n {
        x = if x < 0.0 { -1.0 - x } else { 2.0 * n - 1.0 - x };
        y = n - 1.0 - y;
    }
    if y < 0.0 || y >= n {
        y = if y < 0.0 { -1.0 - y } else { 2.0 * n - 1.0 - y };
        x = n - 1.0 - x;
    }
    y as usize * size + x as usize
}

/// Praun & Hoppe 2003: centre +z, corners −z, zero counts as positive.
fn uv(direction: DVec3) -> DVec2 {
    let norm = direction.x.abs() + direction.y.abs() + direction.z.abs();
    let d = if norm > 0.0 && norm.is_finite() { direction / norm } else { DVec3::Z };
    let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
    let p = if d.z < 0.0 {
        DVec2::new((1.0 - d.y.abs()) * sign(d.x), (1.0 - d.x.abs()) * sign(d.y))
    } else {
        DVec2::new(d.x, d.y)
    };
    p * 0.5 + 0.5
}
