//! How probes are made and how they are looked up.

use crate::{MAX_NEIGHBOURS, MAX_RESOLUTION, ProbeSet};

/// Whether a probe counts that cannot see the shading point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VisibilityWeight {
    /// It counts in full, as in ComGS. Light leaks through walls thinner than the spacing of the probes.
    None,
    /// Its weight is multiplied by Chebyshev's bound on the probability that it sees the point, from the mean and
    /// mean square of the distances it sees in that direction, as in DDGI.
    Chebyshev,
}

/// How many probes there are, where they stand and how they are used.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeConfig {
    /// Probes; at least 1. Fewer are placed when there are not so many distinct surface points.
    pub count: usize,
    /// Side of the octahedral textures in texels, 2 to 128.
    pub resolution: usize,
    /// Distance of a probe from the surface along its normal, as a share of the object's size; 0 to 1.
    pub offset: f32,
    /// Probes that are interpolated at most, 1 to 16.
    pub neighbours: usize,
    /// Radius within which probes are interpolated, in units of [`ProbeSet::spacing`]; above 0. On an even surface
    /// about 3 r² probes are nearer than r spacings.
    pub radius: f32,
    /// Distance at which a ray counts as escaped for the distance moments, in units of the radius: at least 1,
    /// because a probe is looked up from as far as that. More lets far hits blur the nearby ones.
    pub far: f32,
    /// Whether hidden probes count.
    pub visibility: VisibilityWeight,
}

impl Default for ProbeConfig {
    /// Of an object (ComGS § 4 "Reconstruction Details"), with hidden probes suppressed, which the paper has not.
    fn default() -> Self {
        Self {
            count: 5000,
            resolution: 16,
            offset: 0.01,
            neighbours: 8,
            radius: 2.5,
            far: 1.5,
            visibility: VisibilityWeight::Chebyshev,
        }
    }
}

impl ProbeConfig {
    /// The probes of ComGS: hidden ones count in full.
    #[must_use]
    pub fn paper() -> Self {
        Self { visibility: VisibilityWeight::None, ..Self::default() }
    }

    /// The probes around a placed object that cache its shadow (ComGS § 4 "Editing and Rendering Details").
    #[must_use]
    pub fn shadow() -> Self {
        Self { count: 10_000, ..Self::default() }
    }

    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut require = |sound: bool, text: String| {
            if !sound {
                problems.push(text);
            }
        };
        require(
            self.count >= 1 && u32::try_from(self.count).is_ok(),
            format!("count is {}, expected 1 to {}", self.count, u32::MAX),
        );
        require(
            (2..=MAX_RESOLUTION).contains(&self.resolution),
            format!("resolution is {}, expected 2 to {MAX_RESOLUTION}", self.resolution),
        );
        require((0.0..=1.0).contains(&self.offset), format!("offset is {}, expected 0 to 1", self.offset));
        require(
            (1..=MAX_NEIGHBOURS).contains(&self.neighbours),
            format!("neighbours is {}, expected 1 to {MAX_NEIGHBOURS}", self.neighbours),
        );
        require(
            self.radius > 0.0 && self.radius.is_finite(),
            format!("radius is {}, expected a finite value above 0", self.radius),
        );
        require(
            self.far >= 1.0 && self.far.is_finite(),
            format!("far is {}, expected a finite value of at least 1", self.far),
        );
        problems
    }
}

/// How the probes around a shading point are weighted. All lengths are in world units.
#[derive(Clone, Debug, PartialEq)]
pub struct LookupConfig {
    /// Probes that are interpolated at most, 1 to 16.
    pub neighbours: usize,
    /// Bounds the spatial weight: `w_s = 1 / max(‖d‖, min_distance)`; above 0.
    pub min_distance: f32,
    /// Whether hidden probes count. What follows is for [`VisibilityWeight::Chebyshev`].
    pub visibility: VisibilityWeight,
    /// Least standard deviation of the distances seen; stands for what a texel cannot resolve. Above 0.
    pub min_deviation: f32,
    /// The shading point is moved by this along its normal before its distance is compared.
    pub normal_bias: f32,
    /// A hidden probe keeps at least this share of its weight, so that a point that no probe sees is still lit;
    /// above 0, at most 1.
    pub visibility_floor: f32,
}

impl LookupConfig {
    /// The lookup that a configuration asks for, with lengths in proportion to the set's spacing.
    #[must_use]
    pub fn new(set: &ProbeSet, config: &ProbeConfig) -> Self {
        Self {
            neighbours: config.neighbours,
            min_distance: 1e-3 * set.spacing,
            visibility: config.visibility,
            min_deviation: 0.1 * set.spacing,
            normal_bias: 0.2 * set.spacing,
            visibility_floor: 1e-3,
        }
    }

    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut require = |sound: bool, text: String| {
            if !sound {
                problems.push(text);
            }
        };
        require(
            (1..=MAX_NEIGHBOURS).contains(&self.neighbours),
            format!("neighbours is {}, expected 1 to {MAX_NEIGHBOURS}", self.neighbours),
        );
        for (name, v) in [("min_distance", self.min_distance), ("min_deviation", self.min_deviation)] {
            require(v > 0.0 && v.is_finite(), format!("{name} is {v}, expected a finite value above 0"));
        }
        let (bias, floor) = (self.normal_bias, self.visibility_floor);
        require(
            bias >= 0.0 && bias.is_finite(),
            format!("normal_bias is {bias}, expected a finite value of at least 0"),
        );
        require(
            floor > 0.0 && floor <= 1.0,
            format!("visibility_floor is {floor}, expected a value in (0, 1]"),
        );
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every value out of range is named, NaN included, and the presets are sound.
    #[test]
    fn ranges() {
        for preset in [ProbeConfig::default(), ProbeConfig::paper(), ProbeConfig::shadow()] {
            assert!(preset.check().is_empty());
        }
        let bad = ProbeConfig {
            count: 0,
            resolution: 1,
            offset: f32::NAN,
            neighbours: 17,
            radius: 0.0,
            far: 0.5,
            visibility: VisibilityWeight::None,
        };
        let problems = bad.check();
        let names = ["count", "resolution", "offset", "neighbours", "radius", "far"];
        assert_eq!(problems.len(), names.len(), "{problems:?}");
        assert!(problems.iter().zip(names).all(|(p, name)| p.starts_with(name)), "{problems:?}");
        let bad = LookupConfig {
            neighbours: 0,
            min_distance: 0.0,
            visibility: VisibilityWeight::Chebyshev,
            min_deviation: f32::INFINITY,
            normal_bias: -1.0,
            visibility_floor: 0.0,
        };
        assert_eq!(bad.check().len(), 5, "{:?}", bad.check());
    }
}
