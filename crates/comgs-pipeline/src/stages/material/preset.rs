//! Materials with a name.

use serde::Serialize;

/// A material with a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Brushed copper.
    Copper,
    /// Polished silver.
    Silver,
    /// Grey stone that keeps the light and dark pattern of the object.
    Stone,
    /// Red paint without a gloss.
    RedMatte,
    /// Red lacquer.
    RedGlossy,
}

/// What a [`Preset`] stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PresetValues {
    /// Name on the command line.
    pub name: &'static str,
    /// Linear Rec.709; the reflectance at normal incidence (F0) of metals.
    pub albedo: [f64; 3],
    /// Roughness in [0, 1].
    pub roughness: f64,
    /// Metallic in [0, 1].
    pub metallic: f64,
    /// Whether the object's pattern shows through; see [`PATTERN_RANGE`].
    pub pattern: bool,
    /// Where the colour comes from. Roughnesses are chosen to look as the name says.
    pub source: &'static str,
}

/// With a pattern, the albedo is the preset's times `clamp(Y / median Y, ½, 2)`, `Y` the luminance of a surfel's old
/// albedo: stone stays stone, without the black and white that paint may have.
pub const PATTERN_RANGE: [f64; 2] = [0.5, 2.0];

/// F0 of metals: Adobe, "Metal material references" of the Standard Material (measured spectra as linear Rec.709),
/// rounded to two digits.
const METAL_SOURCE: &str = "F0 from measured spectra, Adobe Standard Material metal references, rounded";

/// The presets.
pub const PRESETS: [(Preset, PresetValues); 5] = [
    (
        Preset::Copper,
        PresetValues {
            name: "copper",
            albedo: [1.0, 0.65, 0.53],
            roughness: 0.3,
            metallic: 1.0,
            pattern: false,
            source: METAL_SOURCE,
        },
    ),
    (
        Preset::Silver,
        PresetValues {
            name: "silver",
            albedo: [0.99, 0.98, 0.97],
            roughness: 0.15,
            metallic: 1.0,
            pattern: false,
            source: METAL_SOURCE,
        },
    ),
    (
        Preset::Stone,
        PresetValues {
            name: "stone",
            albedo: [0.3, 0.28, 0.25],
            roughness: 0.9,
            metallic: 0.0,
            pattern: true,
            source: "chosen: a warm grey in the middle of what natural stone reflects",
        },
    ),
    (
        Preset::RedMatte,
        PresetValues {
            name: "red-matte",
            albedo: [0.6, 0.04, 0.03],
            roughness: 0.85,
            metallic: 0.0,
            pattern: false,
            source: "chosen: a saturated red paint",
        },
    ),
    (
        Preset::RedGlossy,
        PresetValues {
            name: "red-glossy",
            albedo: [0.6, 0.04, 0.03],
            roughness: 0.12,
            metallic: 0.0,
            pattern: false,
            source: "chosen: the paint of red-matte under a clear coat",
        },
    ),
];

impl Preset {
    /// What it stands for.
    #[must_use]
    pub fn values(self) -> PresetValues {
        let [(_, first), ..] = PRESETS;
        PRESETS.iter().find(|(preset, _)| *preset == self).map_or(first, |(_, values)| *values)
    }
}
