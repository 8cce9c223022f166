//! What the tracer is told, and what it refuses.

use comgs_geom::sh;
use thiserror::Error;

/// Thresholds of the surfel response. The defaults are the rasteriser's.
#[derive(Clone, Debug, PartialEq)]
pub struct TraceConfig {
    /// A surfel's contribution below this opacity is nothing; in (0, 1). It bounds every surfel to a disc.
    pub alpha_min: f32,
    /// No single hit is more opaque than this; in (0, 1].
    pub alpha_max: f32,
    /// A ray whose transmittance has fallen below this is taken to be stopped; in [0, 1). 0 never stops early.
    pub transmittance_min: f32,
    /// Highest degree of the harmonics that is evaluated (and kept in memory), 0 to 3: 0 is the mean colour.
    pub sh_degree: usize,
}

impl Default for TraceConfig {
    fn default() -> Self {
        Self { alpha_min: 1.0 / 255.0, alpha_max: 0.99, transmittance_min: 1e-4, sh_degree: sh::MAX_DEGREE }
    }
}

impl TraceConfig {
    /// For rays that only ask for transmittance: no harmonics are kept beyond the mean colour.
    #[must_use]
    pub fn occlusion() -> Self {
        Self { sh_degree: 0, ..Self::default() }
    }

    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut expect = |name: &str, value: f32, sound: bool, range: &str| {
            if !sound {
                problems.push(format!("{name} is {value}, expected a value in {range}"));
            }
        };
        let (low, high, stop) = (self.alpha_min, self.alpha_max, self.transmittance_min);
        // The lower bound keeps discs finite: at 1e-6 their radius is 5.3 standard deviations.
        expect("alpha_min", low, (1e-6..1.0).contains(&low), "[1e-6, 1)");
        expect("alpha_max", high, high > 0.0 && high <= 1.0, "(0, 1]");
        expect("transmittance_min", stop, (0.0..1.0).contains(&stop), "[0, 1)");
        if self.sh_degree > sh::MAX_DEGREE {
            problems.push(format!("sh_degree is {}, expected 0 to {}", self.sh_degree, sh::MAX_DEGREE));
        }
        problems
    }
}

/// Why a tracer could not be built.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TraceError {
    /// The configuration is out of range; all problems.
    #[error("unusable trace configuration: {}", .0.join("; "))]
    Config(Vec<String>),
    /// Columns of the cloud disagree in length; all problems.
    #[error("unusable surfel cloud: {}", .0.join("; "))]
    Cloud(Vec<String>),
    /// More surfels than the tree can address.
    #[error("{got} surfels are more than the tracer's limit of {limit}")]
    TooMany {
        /// Surfels in the cloud.
        got: usize,
        /// Most that are accepted.
        limit: usize,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every value out of range is named, NaN included, and the presets are sound.
    #[test]
    fn ranges() {
        assert!(TraceConfig::default().problems().is_empty());
        assert!(TraceConfig::occlusion().problems().is_empty());
        let bad = TraceConfig { alpha_min: 0.0, alpha_max: f32::NAN, transmittance_min: 1.0, sh_degree: 4 }
            .problems();
        assert_eq!(bad.len(), 4, "{bad:?}");
        for (problem, name) in bad.iter().zip(["alpha_min", "alpha_max", "transmittance_min", "sh_degree"]) {
            assert!(problem.contains(name), "{problem}");
        }
    }
}
