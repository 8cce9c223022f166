//! What the camera of a scene's photos adds to them.

use super::Composition;
use crate::{Context, PipelineError, Status};
use comgs_compose::{CameraLook, Defocus, Noise};
use comgs_image::{Encoding, Image};
use comgs_raster::Planes;
use comgs_scene::{Capture, LoadOptions, Split};
use std::path::Path;

/// Photos that are looked at, at most.
const PHOTOS: usize = 12;
/// Scene weight from which on a pixel has a depth.
const SOLID: f32 = 0.5;

impl Composition {
    /// Estimates noise and defocus of photos of the scene, at the depths that the scene has there. Nothing without photos.
    ///
    /// # Errors
    /// [`PipelineError`]: a capture that cannot be read.
    pub fn match_photos(
        &mut self,
        photos: Option<&Path>,
        context: &Context<'_>,
    ) -> Result<(), PipelineError> {
        let Some(path) = photos else { return Ok(()) };
        let capture = Capture::open(path, Split::All)?;
        let all = capture.views.len();
        let n = all.min(PHOTOS);
        let (mut noisy, mut deep): (Vec<Image>, Vec<(Image, Image)>) = Default::default();
        for k in 0..n {
            context.check()?;
            context.progress.update(&Status {
                fraction: Some(k as f64 / n as f64),
                message: "the photos' noise and focus".to_owned(),
                remaining: None,
            });
            let view = capture.views[k * all / n].load(&LoadOptions::default())?;
            let frame =
                comgs_raster::render(&self.scene.surfels, &view.camera, Planes::GEOMETRY, &self.raster());
            // Radiance that was not developed has another noise; straightened photos have theirs smoothed.
            if view.encoding == Encoding::Srgb {
                noisy.push(view.color.clone());
            }
            if deep.first().is_none_or(|d: &(Image, Image)| d.0.width == view.color.width) {
                deep.push((view.color, frame.unbiased_depth(SOLID)));
            }
        }
        self.look = Some(CameraLook { defocus: Defocus::estimate(&deep), noise: Noise::estimate(&noisy) });
        Ok(())
    }
}
