//! Cumulative tables of discrete distributions, in f64.

/// Scales a cumulative table to end at exactly 1; a table of zeros becomes uniform.
pub(crate) fn normalise(cumulative: &mut [f64]) {
    let last = cumulative.len() - 1;
    let total = cumulative[last];
    for (i, value) in cumulative.iter_mut().enumerate() {
        *value = if total > 0.0 { *value / total } else { i as f64 / last as f64 };
    }
    cumulative[last] = 1.0;
}

/// Interval of a cumulative table that `u` in [0, 1) falls into, never an empty one, and where in it, in [0, 1].
pub(crate) fn invert(cumulative: &[f64], u: f32) -> (usize, f64) {
    let u = f64::from(u);
    let i = cumulative.partition_point(|&c| c <= u).clamp(1, cumulative.len() - 1) - 1;
    let width = cumulative[i + 1] - cumulative[i];
    (i, if width > 0.0 { ((u - cumulative[i]) / width).clamp(0.0, 1.0) } else { 0.5 })
}
