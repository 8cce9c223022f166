//! What fills the sphere around the photo.

use crate::PipelineError;
use crate::stages::completers::ModelConfig;
use comgs_image::Image;
use comgs_insert::panorama::{Completer, Harmonic};
use comgs_panorama::{CompletionError, Learned, Partial};
use serde::Serialize;

/// Completers of a photo's panorama.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Filled {
    /// The smoothest log radiance that agrees with what the photo shows.
    #[default]
    Harmonic,
    /// The model that ships with comgs.
    Learned,
}

/// A completer. `white`: radiance from which a texel is only a lower bound, because the photo was cut off there.
pub(crate) fn completer(fill: Filled, white: f32) -> Result<Box<dyn Completer>, PipelineError> {
    Ok(match fill {
        Filled::Harmonic => Box::new(Harmonic),
        Filled::Learned => {
            let model = ModelConfig::shipped().load().map_err(CompletionError::from)?;
            Box::new(ByModel { model, white })
        }
    })
}

struct ByModel {
    model: Learned,
    white: f32,
}

/// How near to white counts as white: 8-bit steps, and means over a texel.
const NEAR: f32 = 0.98;

impl Completer for ByModel {
    fn name(&self) -> &'static str {
        "learned"
    }

    fn complete(&self, rgb: &Image, alpha: &Image) -> Result<Image, String> {
        let clipped: Vec<f32> = rgb
            .data
            .chunks_exact(3)
            .map(|p| f32::from(u8::from(p.iter().any(|v| *v >= NEAR * self.white))))
            .collect();
        let clipped = Image::from_data(rgb.width, rgb.height, 1, clipped);
        let partial =
            Partial { rgb: rgb.clone(), alpha: alpha.clone(), normal: None, clipped: Some(clipped) };
        comgs_panorama::Completer::complete(&self.model, &partial, 0).map_err(|e| e.to_string())
    }
}
