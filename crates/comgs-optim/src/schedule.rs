//! Schedules over the progress of a training, `progress` ∈ [0, 1].

/// Log-linear interpolation from `start` to `end` (both > 0): the usual decay of a position learning rate.
#[must_use]
pub fn log_linear(start: f32, end: f32, progress: f32) -> f32 {
    let t = progress.clamp(0.0, 1.0);
    (start.ln() * (1.0 - t) + end.ln() * t).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: ends are met, the middle is the geometric mean, and progress beyond the ends is clamped.
    #[test]
    fn ends_and_middle() {
        assert!((log_linear(1e-2, 1e-4, 0.0) - 1e-2).abs() < 1e-8);
        assert!((log_linear(1e-2, 1e-4, 0.5) - 1e-3).abs() < 1e-8);
        assert!((log_linear(1e-2, 1e-4, 7.0) - 1e-4).abs() < 1e-9);
    }
}
