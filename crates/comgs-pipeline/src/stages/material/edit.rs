//! What becomes of the material columns.

use super::{Config, PATTERN_RANGE, Preset, PresetValues};
use comgs_surfel::MaterialColumns;
use comgs_surfel::activation::{logit, sigmoid};
use serde::Serialize;
use std::str::FromStr;

/// What becomes of the albedo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum AlbedoEdit {
    /// The same linear Rec.709 colour everywhere, each channel in [0, 1].
    Set([f64; 3]),
    /// The old colour times this factor, clamped to [0, 1].
    Scale(f64),
}

impl FromStr for AlbedoEdit {
    type Err = String;

    /// `r,g,b` sets, one number scales.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| format!("{part:?} is not a number")))
            .collect::<Result<_, _>>()?;
        let edit = match numbers[..] {
            [scale] => Self::Scale(scale),
            [r, g, b] => Self::Set([r, g, b]),
            _ => {
                return Err(format!(
                    "expected a linear colour r,g,b or one factor, got {} numbers",
                    numbers.len()
                ));
            }
        };
        edit.check().map(|()| edit)
    }
}

impl AlbedoEdit {
    /// Whether it is a colour or a factor.
    pub(super) fn check(self) -> Result<(), String> {
        match self {
            Self::Set(rgb) if rgb.iter().all(|v| (0.0..=1.0).contains(v)) => Ok(()),
            Self::Set(rgb) => Err(format!("expected a linear colour with channels from 0 to 1, got {rgb:?}")),
            Self::Scale(s) if s.is_finite() && s >= 0.0 => Ok(()),
            Self::Scale(s) => Err(format!("expected a factor that is not negative, got {s}")),
        }
    }
}

/// The edited material, and how many surfels had an albedo above 1 that was clamped.
#[must_use]
pub fn edit(old: &MaterialColumns, config: &Config) -> (MaterialColumns, usize) {
    let mut new = old.clone();
    let preset = config.preset.map(Preset::values);
    let mut clamped = 0;
    if preset.is_some() || config.albedo.is_some() {
        let colors: Vec<[f64; 3]> =
            old.albedo_logits.iter().map(|a| a.map(|x| f64::from(sigmoid(x)))).collect();
        let middle = median(colors.iter().map(luminance).collect());
        for (logits, color) in new.albedo_logits.iter_mut().zip(&colors) {
            let edited = edited_albedo(*color, middle, preset.as_ref(), config.albedo);
            clamped += usize::from(edited.iter().any(|v| *v > 1.0));
            *logits = edited.map(|v| logit(v.clamp(0.0, 1.0) as f32));
        }
    }
    if let Some(roughness) = config.roughness.or(preset.map(|p| p.roughness)) {
        new.roughness_logits.fill(logit(roughness as f32));
    }
    if let Some(metallic) = config.metallic.or(preset.map(|p| p.metallic)) {
        new.metallic_logits.fill(logit(metallic as f32));
    }
    (new, clamped)
}

/// A surfel's albedo after preset and edit, not clamped; `middle` is the median luminance.
fn edited_albedo(
    color: [f64; 3],
    middle: f64,
    preset: Option<&PresetValues>,
    edit: Option<AlbedoEdit>,
) -> [f64; 3] {
    let [low, high] = PATTERN_RANGE;
    let base = match preset {
        None => color,
        Some(p) if p.pattern && middle > 0.0 => {
            p.albedo.map(|v| v * (luminance(&color) / middle).clamp(low, high))
        }
        Some(p) => p.albedo,
    };
    match edit {
        None => base,
        Some(AlbedoEdit::Set(rgb)) => rgb,
        Some(AlbedoEdit::Scale(s)) => base.map(|v| s * v),
    }
}

/// Rec.709 luminance.
fn luminance(rgb: &[f64; 3]) -> f64 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// Middle value; the upper one of two; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
