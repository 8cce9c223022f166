//! How an object is relit, and what is refused.

use comgs_probe::{ProbeConfig, ProbeError, VisibilityWeight};
use comgs_raster::RasterConfig;
use comgs_trace::TraceError;
use thiserror::Error;

/// How samples of the light and of the BRDF share an integral (Veach 1997, § 9.2). With `n` samples of density `p` from
/// one and `m` of density `q` from the other, a sample of the first counts with
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Heuristic {
    /// `w = n p / (n p + m q)`: never far from the best of all.
    Balance,
    /// `w = (n p)² / ((n p)² + (m q)²)`: less noise where one of the two is nearly perfect.
    Power,
}

/// What the object hides from itself: O of ComGS Eq. 8.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SelfOcclusion {
    /// Interpolated probe textures (ComGS Eq. 9–11).
    Probes,
    /// Probes for the samples that the BRDF proposes, a ray for those that the light proposes: small strong lights, which
    /// only the light's samples find, cast sharp shadows, and the smooth rest costs no rays. With the weights `w` of the
    /// [`Heuristic`], `1 − O = w (1 − O_trace) + (1 − w) (1 − O_probes)`.
    Mixed,
    /// A ray for every sample: what the probes stand for, at its full price.
    Trace,
    /// Nothing.
    None,
}

/// Light that reaches a surface by way of the object itself: L_in of ComGS Eq. 8.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Indirect {
    /// None, as in the paper's rendering (§ 3.3).
    None,
    /// Light that was scattered once on the object; see [`crate::relight::bounce`].
    OneBounce,
}

/// Knobs of [`crate::relight::Relighter`].
#[derive(Clone, Debug)]
pub struct RelightConfig {
    /// Samples a pixel that the light proposes, 0 to 65536.
    pub light_rays: u32,
    /// Samples a pixel that the BRDF proposes, 0 to 65536; with `light_rays` at least 1. Without them dark parts of the
    /// map are seldom looked at, and mirrors are noisy.
    pub brdf_rays: u32,
    /// How the two are combined.
    pub heuristic: Heuristic,
    /// Where O comes from.
    pub self_occlusion: SelfOcclusion,
    /// Where L_in comes from; needs an O.
    pub indirect: Indirect,
    /// Samples a surfel for the light that it scatters, 2 to 65536.
    pub bounce_rays: u32,
    /// Directions a pixel of the highlight, where the matte part is cached ([`crate::relight::CachedRelighter`]); 1 to 1024.
    pub highlight_rays: u32,
    /// Probes that a point is interpolated from at most, 1 to 16.
    pub neighbours: usize,
    /// Radius within which probes are looked for, in units of the set's spacing; above 0.
    pub radius: f32,
    /// Whether probes count that do not see the point.
    pub hidden_probes: VisibilityWeight,
    /// Height above the surface at which traced rays start, as a share of the diameter of the object's bounding sphere;
    /// 0 to 0.1.
    pub trace_offset: f32,
    /// Whether frames come with their layers ([`crate::relight::RelitLayers`]).
    pub layers: bool,
    /// Seed of the sample sets' rotations.
    pub seed: u64,
    /// Rasterisation of the G-buffer.
    pub raster: RasterConfig,
}

impl Default for RelightConfig {
    /// [`RelightConfig::balanced`].
    fn default() -> Self {
        Self::balanced()
    }
}

/// Most samples of a kind.
const MAX_RAYS: u32 = 65_536;

impl RelightConfig {
    /// 128 samples a pixel, as many as the paper's training takes.
    #[must_use]
    pub fn balanced() -> Self {
        Self {
            light_rays: 64,
            brdf_rays: 64,
            heuristic: Heuristic::Balance,
            self_occlusion: SelfOcclusion::Probes,
            indirect: Indirect::None,
            bounce_rays: 64,
            highlight_rays: 8,
            neighbours: 8,
            radius: 2.5,
            hidden_probes: VisibilityWeight::None,
            trace_offset: 0.01,
            layers: false,
            seed: 0,
            raster: RasterConfig::default(),
        }
    }

    /// A look at the result: 32 samples a pixel.
    #[must_use]
    pub fn draft() -> Self {
        Self { bounce_rays: 16, highlight_rays: 4, ..Self::balanced().with_rays(32) }
    }

    /// 512 samples a pixel: what is left are the errors of geometry, material and probes.
    #[must_use]
    pub fn reference() -> Self {
        Self { bounce_rays: 256, highlight_rays: 32, ..Self::balanced().with_rays(512) }
    }

    /// With `rays` samples a pixel, half of them by the light.
    #[must_use]
    pub fn with_rays(self, rays: u32) -> Self {
        Self { light_rays: rays / 2, brdf_rays: rays - rays / 2, ..self }
    }

    /// With probes looked up as `probes` says: what was learnt through one lookup is read through the same.
    #[must_use]
    pub fn with_lookup(self, probes: &ProbeConfig) -> Self {
        let (neighbours, radius, hidden_probes) = (probes.neighbours, probes.radius, probes.visibility);
        Self { neighbours, radius, hidden_probes, ..self }
    }

    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = self.raster.check();
        let mut require = |sound: bool, text: String| {
            if !sound {
                problems.push(text);
            }
        };
        for (name, rays) in [("light_rays", self.light_rays), ("brdf_rays", self.brdf_rays)] {
            require(rays <= MAX_RAYS, format!("{name} is {rays}, expected 0 to {MAX_RAYS}"));
        }
        require(self.light_rays > 0 || self.brdf_rays > 0, "light_rays and brdf_rays are both 0".into());
        require(
            (2..=MAX_RAYS).contains(&self.bounce_rays),
            format!("bounce_rays is {}, expected 2 to {MAX_RAYS}", self.bounce_rays),
        );
        require(
            (1..=1024).contains(&self.highlight_rays),
            format!("highlight_rays is {}, expected 1 to 1024", self.highlight_rays),
        );
        require(
            (1..=comgs_probe::MAX_NEIGHBOURS).contains(&self.neighbours),
            format!("neighbours is {}, expected 1 to {}", self.neighbours, comgs_probe::MAX_NEIGHBOURS),
        );
        require(
            self.radius > 0.0 && self.radius.is_finite(),
            format!("radius is {}, expected a finite value above 0", self.radius),
        );
        require(
            (0.0..=0.1).contains(&self.trace_offset),
            format!("trace_offset is {}, expected 0 to 0.1", self.trace_offset),
        );
        require(
            self.indirect == Indirect::None || self.self_occlusion != SelfOcclusion::None,
            "indirect light needs self-occlusion by probes or by tracing: what the object scatters must not come on \
             top of light that it hides"
                .into(),
        );
        problems
    }
}

/// Why an object cannot be relit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RelightError {
    /// The configuration is out of range; all problems.
    #[error("unusable relighting configuration: {}", .0.join("; "))]
    Config(Vec<String>),
    /// Columns of the cloud contradict themselves; all problems.
    #[error("unusable surfels: {}", .0.join("; "))]
    Cloud(Vec<String>),
    /// All surfels are invisible, or there are none.
    #[error("the object has {0} surfels, none of them visible")]
    Invisible(usize),
    /// The surfels have no albedo, roughness and metallic.
    #[error("the object has no material: it was reconstructed but not decomposed")]
    NoMaterial,
    /// [`SelfOcclusion::Probes`] without probes.
    #[error("the object has no probes, which its self-occlusion was to come from")]
    NoProbes,
    /// Probes that contradict themselves, or baking that was stopped.
    #[error("the object's probes cannot be used")]
    Probes(#[source] ProbeError),
    /// The cloud cannot be traced.
    #[error("the object cannot be traced")]
    Trace(#[source] TraceError),
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: presets are sound and ordered by cost, and every value out of range is named, NaN included.
    #[test]
    fn ranges() {
        let presets = [RelightConfig::draft(), RelightConfig::balanced(), RelightConfig::reference()];
        assert!(presets.iter().all(|p| p.check().is_empty()));
        assert!(presets.is_sorted_by_key(|p| (p.light_rays + p.brdf_rays, p.bounce_rays)));
        let odd = RelightConfig::balanced().with_rays(1);
        assert_eq!((odd.light_rays, odd.brdf_rays, odd.check().len()), (0, 1, 0));
        let bad = RelightConfig {
            light_rays: 0,
            brdf_rays: 0,
            bounce_rays: 1,
            highlight_rays: 0,
            neighbours: 17,
            radius: 0.0,
            trace_offset: f32::NAN,
            self_occlusion: SelfOcclusion::None,
            indirect: Indirect::OneBounce,
            ..RelightConfig::balanced()
        };
        let problems = bad.check();
        let words =
            ["both 0", "bounce_rays", "highlight_rays", "neighbours", "radius", "trace_offset", "indirect"];
        assert_eq!(problems.len(), words.len(), "{problems:?}");
        assert!(problems.iter().zip(words).all(|(p, word)| p.contains(word)), "{problems:?}");
        assert_eq!(RelightConfig { light_rays: 65_537, ..RelightConfig::balanced() }.check().len(), 1);
    }
}
