//! Seconds that a run would take, from what small frames and one frame of full size took on this machine, now.
//!
//! What is measured is scaled by what it grows with: pixels, surfels, directions of the light, lines of a field. How much finer the
//! presets are than the draft that pilots are rendered at is written down here, as it was measured once (study + cow and garden +
//! teapot, `comgs render --composition c.json --quality draft|balanced|reference`): these are ratios, not times.

use crate::stages::editing::{Composition, Settings, is_baked, is_cached};
use comgs_compose::{FieldConfig, RelightConfig};
use comgs_inverse::Quality;
use std::path::Path;

/// The presets, cheapest first.
pub(super) const QUALITIES: [Quality; 3] = [Quality::Draft, Quality::Balanced, Quality::Reference];

/// What the objects' part of a pilot took, seconds.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ObjectWork {
    pub own_s: f64,
    pub prepare_s: f64,
    pub shade_s: f64,
    pub is_relit: bool,
}

/// What its shadow took, seconds.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ShadowWork {
    pub casts: bool,
    pub cloud_s: f64,
    pub cache_s: f64,
    pub bounce_s: f64,
    pub read_s: f64,
}

/// What a pilot took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Work {
    pub objects: ObjectWork,
    pub shadow: ShadowWork,
}

/// What does not depend on effects, and how pilots are scaled.
#[derive(Clone, Copy)]
pub(super) struct Cost<'a> {
    pub composition: &'a Composition,
    /// Folder of fields that are there already.
    pub cache: Option<&'a Path>,
    /// Reading, trees, merging the objects.
    pub fixed_s: f64,
    /// A frame of full size without any effect.
    pub frame_s: f64,
    /// Pixels of the run over the pilots'.
    pub pixels: f64,
    /// Surfels of the objects over the stand-ins'.
    pub surfels: f64,
    /// Surfels of the stand-ins, the pilots' field, and seconds of baking it; 0 where no pilot casts a shadow.
    pub bake: (usize, FieldConfig, f64),
}

/// Shadow's cells of a preset over the pilots', whose cache is the balanced one.
const CELLS: [f64; 3] = [0.67, 1.0, 1.6];
/// Preparing the objects' light: the part that grows with surfels and directions; the rest are tables.
const SUMS: f64 = 0.5;
/// Writing a pixel of a picture, seconds; two pictures a frame.
const WRITE_S: f64 = 6e-8;
/// What a pixel's shading costs besides its directions, in directions.
const SHADE: f64 = 6.0;

impl Cost<'_> {
    /// Seconds of preparation and all frames at a quality.
    pub fn seconds(&self, settings: &Settings, work: &Work, quality: Quality) -> f64 {
        let settings = Settings { quality, ..settings.clone() };
        let draft = Settings { quality: Quality::Draft, ..settings.clone() };
        let frames = self.composition.cameras.len() as f64;
        let run_pixels: usize = self.composition.cameras.iter().map(|c| c.width * c.height).sum();
        let finer = settings.light().directions as f64 / draft.light().directions as f64;

        let mut seconds = self.fixed_s + frames * self.frame_s + WRITE_S * 2.0 * run_pixels as f64;
        let objects = &work.objects;
        if objects.is_relit {
            let cached = is_cached(self.composition, &settings);
            let units = |settings: &Settings| {
                let preset = match settings.quality {
                    Quality::Draft => RelightConfig::draft(),
                    Quality::Balanced => RelightConfig::balanced(),
                    Quality::Reference => RelightConfig::reference(),
                };
                match is_cached(self.composition, settings) {
                    true => SHADE + f64::from(settings.rays.unwrap_or(preset.highlight_rays)),
                    false => f64::from(settings.rays.unwrap_or(preset.light_rays + preset.brdf_rays)),
                }
            };
            if cached {
                let sums = SUMS * self.surfels * finer.sqrt();
                seconds += objects.own_s * self.surfels + objects.prepare_s * (1.0 - SUMS + sums);
            }
            seconds += objects.shade_s * self.pixels * units(&settings) / units(&draft);
        }
        let shadow = &work.shadow;
        if shadow.casts {
            let there = self.cache.is_some_and(|cache| is_baked(self.composition, &settings, cache));
            if !there {
                let all = self.composition.objects.iter().map(|o| o.subject.asset.surfels.len()).sum();
                let (stand_ins, field, bake_s) = self.bake;
                seconds += bake_s * lines(all, &settings.field()) / lines(stand_ins, &field);
            }
            // Covered in two dimensions, a shadow's edges grow with the square root.
            let k = QUALITIES.iter().position(|q| *q == quality).unwrap_or(1);
            seconds += shadow.cache_s * self.pixels.sqrt() * finer * CELLS[k];
            seconds += (shadow.cloud_s + shadow.read_s) * self.pixels + shadow.bounce_s * self.surfels;
        }
        seconds
    }
}

/// Work of baking a field: lines, each with its pixels and with the discs that are laid flat for it, 30 to a pixel.
fn lines(surfels: usize, field: &FieldConfig) -> f64 {
    let lines = (field.directions * field.directions / 2) as f64;
    lines * ((field.resolution * field.resolution) as f64 + surfels as f64 / 30.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the work of baking follows what was measured (CPU-seconds of `comgs shadow` for the cow's 29,000 surfels: 0.65,
    /// 1.95, 4.0; reading taken off) within a quarter.
    #[test]
    fn baking_grows_as_it_was_measured() {
        let of = |quality| lines(29_000, &Settings { quality, ..Settings::default() }.field());
        let [draft, balanced, reference] = QUALITIES.map(of);
        for (got, measured) in [(balanced / draft, 1.95 / 0.65), (reference / balanced, 4.0 / 1.95)] {
            assert!((got / measured - 1.0).abs() < 0.25, "{got} {measured}");
        }
    }
}
