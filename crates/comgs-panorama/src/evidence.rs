//! Evidence from the scene: a lit scene itself says how bright its lights are, and where.
//!
//! Surfaces near the placement were photographed under the light that is sought. A point of albedo ρ reflects
//!
//! ```text
//! r = ρ/π ( K + Σ_b e_b G_b ),   K = ∫ L_scene V̄ cos dω,   G_b = cos ω_b · V(ω_b) · Δω
//! ```
//!
//! where K is what reaches it from surfaces and sky that the scene's radiance field knows, and e_b the unknown radiance of
//! direction bin b of the part that was completed or clipped, seen with visibility V traced through the scene's own surfels.
//! Points of like albedo that see more or less of a bin differ by what that bin adds: a shadow on the floor tells the sun's
//! direction and energy although no photo shows the sun.
//!
//! [`refine`] solves for the e_b ≥ 0 by robust (Huber) non-negative least squares with the completion as prior, alternating
//! with the albedos of clusters of alike points, then looks closer at the bins that gained most. A fifth of the points has no
//! say and judges: when their residual does not fall by [`Config::least_gain`], the completion is left as it was.

mod directions;
mod receivers;
mod solve;

use crate::{Partial, Sweep};
use comgs_geom::equirect;
use comgs_image::Image;
use comgs_trace::Tracer;
use directions::Bins;
use glam::{DVec3, Vec3};
use receivers::Receivers;
use solve::{Problem, Solution};

/// Knobs.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Surface points that are looked at.
    pub points: usize,
    /// Direction bins over the whole sphere.
    pub bins: usize,
    /// Clusters of like albedo.
    pub clusters: usize,
    /// Weight of the completion as a prior: how many points' worth of evidence a bin needs to leave it.
    pub prior: f64,
    /// How far the residual of the points without a say must fall, as a share, for the evidence to count.
    pub least_gain: f64,
    /// Seed of the choice of points.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self { points: 1500, bins: 400, clusters: 10, prior: 2.0, least_gain: 0.03, seed: 0 }
    }
}

/// What the scene says.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// The completion, with the unseen and clipped part changed where the evidence is strong.
    pub environment: Image,
    /// Whether it was changed.
    pub used: bool,
    /// Points that could be used.
    pub points: usize,
    /// Bins whose radiance was asked for.
    pub bins: usize,
    /// Robust residual of the judging points, as a share of their radiance: under the completion, and under the result.
    pub residual: [f64; 2],
    /// The strongest light that was added, if any: direction and irradiance (RGB) on a surface that faces it.
    pub strongest: Option<(Vec3, [f32; 3])>,
}

/// A bin is fixed when more than this share of it was seen and not clipped.
const SEEN: f64 = 0.5;
/// Bins that are looked at closer, and how many pieces each falls into.
const CLOSER: usize = 6;
const PIECES: usize = 16;
/// Points fewer than this say nothing.
const FEWEST: usize = 60;

/// Changes a completion to what the scene's lit surfaces say.
///
/// * `tracer`: the scene
/// * `seen`: the sweep around `centre`, any size
/// * `partial`: what was given to the completer, of the completion's size
/// * `completed`: the completion, linear radiance
///
/// Deterministic for a seed, at any thread count. Not differentiable. Light is taken to come from infinitely far, which holds
/// for points near the placement; the scene is taken to be Lambertian, which the robust loss forgives where it is not.
#[must_use]
pub fn refine(
    tracer: &Tracer,
    seen: &Sweep,
    centre: Vec3,
    partial: &Partial,
    completed: &Image,
    config: &Config,
) -> Evidence {
    let unchanged = |points, bins, residual| Evidence {
        environment: completed.clone(),
        used: false,
        points,
        bins,
        residual,
        strongest: None,
    };
    let bins = Bins::of(config.bins, partial, completed, SEEN);
    let unknown: Vec<usize> = (0..bins.len()).filter(|&b| bins.is_unknown(b)).collect();
    let receivers = Receivers::choose(seen, centre, config);
    if receivers.len() < FEWEST || unknown.is_empty() {
        return unchanged(receivers.len(), unknown.len(), [0.0; 2]);
    }
    let problem = Problem::trace(tracer, &receivers, &bins, &unknown, config);
    let prior: Vec<DVec3> = unknown.iter().map(|&b| bins.radiance(b)).collect();
    let before = problem.residual(&problem.fit_albedo(&prior), &prior);
    let first = problem.solve(&prior);
    // Closer: the bins with the most light beyond the completion fall into pieces.
    let mut order: Vec<usize> = (0..unknown.len()).collect();
    let gain = |k: &usize| (first.radiance[*k] - prior[*k]).element_sum();
    order.sort_by(|a, b| gain(b).total_cmp(&gain(a)).then(a.cmp(b)));
    order.retain(|k| gain(k) > 0.0);
    order.truncate(CLOSER);
    let split: Vec<usize> = order.iter().map(|&k| unknown[k]).collect();
    let pieces = bins.pieces(&split, PIECES);
    let closer = Problem::trace_closer(tracer, &receivers, &problem, &order, &pieces, config);
    let mut piece_prior: Vec<DVec3> = first.radiance.clone();
    for &k in &order {
        piece_prior[k] = prior[k];
    }
    piece_prior.extend(std::iter::repeat_n(DVec3::ZERO, pieces.len()));
    let Solution { radiance, albedo } = closer.solve(&piece_prior);
    let after = closer.residual(&albedo, &radiance);
    if after > before * (1.0 - config.least_gain) || !after.is_finite() {
        return unchanged(receivers.len(), unknown.len(), [before, after]);
    }
    let (environment, strongest) = paint(completed, partial, &bins, &unknown, &prior, &radiance, &pieces);
    Evidence {
        environment,
        used: true,
        points: receivers.len(),
        bins: unknown.len(),
        residual: [before, after],
        strongest,
    }
}

/// The completion with bins scaled or raised to their solved radiance and pieces painted as small discs.
fn paint(
    completed: &Image,
    partial: &Partial,
    bins: &Bins,
    unknown: &[usize],
    prior: &[DVec3],
    radiance: &[DVec3],
    pieces: &directions::Pieces,
) -> (Image, Option<(Vec3, [f32; 3])>) {
    let mut out = completed.clone();
    let (width, height) = (out.width, out.height);
    let mut index = vec![usize::MAX; bins.len()];
    for (k, &b) in unknown.iter().enumerate() {
        index[b] = k;
    }
    let free =
        |i: usize| partial.alpha.data[i] < 0.5 || partial.clipped.as_ref().is_some_and(|c| c.data[i] > 0.5);
    let mut inside = vec![0.0f64; pieces.len()];
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            let d = equirect::texel_direction(x, y, width, height);
            if !free(i) {
                continue;
            }
            // Neighbouring bins blend, so that no bin has an edge.
            let (mut factor, mut added, mut weights) = (DVec3::ZERO, DVec3::ZERO, 0.0);
            for (b, w) in bins.near(d) {
                let k = index[b];
                weights += w;
                if k == usize::MAX {
                    factor += w * DVec3::ONE;
                    continue;
                }
                let (m, e) = (prior[k], radiance[k]);
                // Less light than the completion says scales it; more is added, so that a dark map can become bright.
                for c in 0..3 {
                    factor[c] += w * if e[c] < m[c] { e[c] / m[c] } else { 1.0 };
                    added[c] += w * (e[c] - m[c]).max(0.0);
                }
            }
            if weights > 0.0 {
                let pixel = &mut out.data[3 * i..3 * i + 3];
                for (c, v) in pixel.iter_mut().enumerate() {
                    *v = (f64::from(*v) * factor[c] / weights + added[c] / weights) as f32;
                }
            }
            let omega = f64::from(equirect::texel_solid_angle(y, width, height));
            for (p, sum) in inside.iter_mut().enumerate() {
                *sum += omega * pieces.weight(p, d);
            }
        }
    }
    let mut strongest: Option<(Vec3, [f32; 3])> = None;
    for (p, &solid) in inside.iter().enumerate() {
        let energy = radiance[unknown.len() + p] * pieces.solid_angle();
        if energy.max_element() <= 0.0 || solid <= 0.0 {
            continue;
        }
        let irradiance = energy.as_vec3().to_array();
        let total = |v: &[f32; 3]| v.iter().sum::<f32>();
        if strongest.as_ref().is_none_or(|(_, s)| total(&irradiance) > total(s)) {
            strongest = Some((pieces.direction(p), irradiance));
        }
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let w = pieces.weight(p, equirect::texel_direction(x, y, width, height));
                if w > 0.0 && free(i) {
                    for c in 0..3 {
                        out.data[3 * i + c] += (w * energy[c] / solid) as f32;
                    }
                }
            }
        }
    }
    (out, strongest)
}
