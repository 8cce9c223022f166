//! Which points are worth their time.

use super::Better;

/// Indices of the points that no other point beats: nothing is as good in less time, nothing is better in as little.
///
/// - `points`: (seconds, value); points with a coordinate that is not finite take no part.
/// - Result: in order of growing seconds, hence of strictly improving value. Of equal points the first is kept.
///
/// Point a dominates b when a is no slower and no worse, and differs. The front is the set without a dominator,
/// found by one sweep in order of time, O(n log n).
#[must_use]
pub fn pareto_front(points: &[(f64, f64)], better: Better) -> Vec<usize> {
    let gain = |index: usize| better.sign() * points[index].1;
    let mut order: Vec<usize> =
        (0..points.len()).filter(|&i| points[i].0.is_finite() && points[i].1.is_finite()).collect();
    order.sort_by(|&a, &b| {
        points[a].0.total_cmp(&points[b].0).then(gain(b).total_cmp(&gain(a))).then(a.cmp(&b))
    });
    let mut best = f64::NEG_INFINITY;
    order.retain(|&i| {
        let improves = gain(i) > best;
        best = best.max(gain(i));
        improves
    });
    order
}
