//! Knobs that the editing and rendering stages share.

use comgs_compose::{CacheConfig, FieldConfig, ShadowLightConfig};
use comgs_inverse::Quality;
use serde::Serialize;

/// Where shadows on the scene come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Shadow {
    /// Occlusion fields for the smooth light and rays to strong ones, cached where the frames need it.
    Auto,
    /// Probes in the scene, as in the paper, and rays to strong lights; cached alike.
    Probes,
    /// Rays for every pixel of every frame.
    Trace,
    /// No shadow.
    None,
}

/// Whether objects are shown under the scene's light.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Relight {
    /// Yes, where all objects have material.
    Auto,
    /// No: they keep the light they were captured under.
    Off,
}

/// How objects under the scene's light are shaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Shading {
    /// Cached, and sampled at `reference`.
    Auto,
    /// The matte part kept on the surfels, the highlight from few directions.
    Cached,
    /// Samples of light and reflectance at every pixel of every frame.
    Sampled,
}

/// What is simulated and how finely.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Point on the curve of time against error.
    pub quality: Quality,
    /// Shadows on the scene.
    pub shadow: Shadow,
    /// The objects' light.
    pub relight: Relight,
    /// How that light is worked out.
    pub shading: Shading,
    /// Samples a pixel of the objects' shading instead of the quality's.
    pub rays: Option<u32>,
    /// What the objects hide from themselves and each other.
    pub self_occlusion: bool,
    /// Light from the scene's surfaces where they are, instead of infinitely far away.
    pub near_field: bool,
    /// Light that bounces between the objects' surfaces.
    pub indirect: bool,
    /// Light that the objects throw back on the scene.
    pub bounce: bool,
    /// The photos' defocus on the objects.
    pub defocus: bool,
    /// The photos' noise on the frames.
    pub noise: bool,
    /// Leave out shadows beyond a few radii of the objects.
    pub near_only: bool,
    /// Seed.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            quality: Quality::Balanced,
            shadow: Shadow::Auto,
            relight: Relight::Auto,
            shading: Shading::Auto,
            rays: None,
            self_occlusion: true,
            near_field: false,
            indirect: false,
            bounce: false,
            defocus: false,
            noise: false,
            near_only: false,
            seed: 0,
        }
    }
}

impl Settings {
    /// Resolutions of the occlusion fields.
    pub(crate) fn field(&self) -> FieldConfig {
        match self.quality {
            Quality::Draft => FieldConfig { directions: 12, resolution: 48 },
            Quality::Balanced => FieldConfig::default(),
            Quality::Reference => FieldConfig { directions: 16, resolution: 96 },
        }
    }

    /// How the light is cut.
    pub(crate) fn light(&self) -> ShadowLightConfig {
        let (directions, beam_rays) = match self.quality {
            Quality::Draft => (128, 8),
            Quality::Balanced => (256, 16),
            Quality::Reference => (1024, 64),
        };
        ShadowLightConfig { directions, beam_rays, ..ShadowLightConfig::default() }
    }

    /// How finely the ratio is cached.
    pub(crate) fn cache(&self) -> CacheConfig {
        let (tolerance, pixels) = match self.quality {
            Quality::Draft => (0.05, 4.0),
            Quality::Balanced => (0.01, 2.0),
            Quality::Reference => (0.005, 1.0),
        };
        CacheConfig { tolerance, pixels, ..CacheConfig::default() }
    }

    /// Rays a pixel of a traced shadow.
    pub(crate) fn shadow_rays(&self) -> u32 {
        match self.quality {
            Quality::Draft => 64,
            Quality::Balanced => 256,
            Quality::Reference => 1024,
        }
    }
}
