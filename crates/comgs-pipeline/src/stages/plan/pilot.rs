//! Small frames of a composition.

use crate::stages::editing::{Baked, Composition, OwnLight, Settings, Shadow};
use crate::stages::render_composition::{Ground, Renderer, receivers};
use crate::{Context, PipelineError};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_light::EnvironmentSampler;
use comgs_trace::Tracer;
use std::time::Instant;

/// Width of a pilot frame.
const WIDTH: usize = 128;
/// Most pilot frames.
const FRAMES: usize = 3;

/// Pilots of one composition.
pub(super) struct Pilots<'a> {
    composition: &'a Composition,
    tracer: &'a Tracer,
    sampler: &'a EnvironmentSampler,
    baked: &'a Baked,
    cameras: Vec<Camera>,
}

/// A pilot.
pub(super) struct Pilot {
    pub frames: Vec<Image>,
    /// Estimated seconds for preparation and all frames at full size.
    pub seconds: f64,
}

impl<'a> Pilots<'a> {
    pub fn new(
        composition: &'a Composition,
        tracer: &'a Tracer,
        sampler: &'a EnvironmentSampler,
        baked: &'a Baked,
    ) -> Self {
        let all = &composition.cameras;
        let n = all.len().min(FRAMES);
        let cameras = (0..n)
            .map(|k| {
                let camera = &all[k * all.len() / n];
                let width = camera.width.min(WIDTH);
                camera.resized(width, (camera.height * width).div_ceil(camera.width).max(1))
            })
            .collect();
        Self { composition, tracer, sampler, baked, cameras }
    }

    /// Renders the small frames with some settings.
    pub fn render(&self, settings: &Settings, context: &Context<'_>) -> Result<Pilot, PipelineError> {
        context.check()?;
        let start = Instant::now();
        let ground = Ground::new(self.composition, self.tracer, self.sampler, settings)?;
        let seen = match settings.shadow {
            Shadow::Auto | Shadow::Probes => receivers(&ground.composer, &self.cameras, context)?,
            _ => comgs_compose::ReceiverCloud::default(),
        };
        let own = OwnLight::new(self.composition, settings)?;
        let renderer =
            Renderer::new(self.composition, &ground, Some(self.baked), own.as_ref(), &seen, settings)?;
        let prepare_s = start.elapsed().as_secs_f64() - renderer.prepared.cache_s;
        let start = Instant::now();
        let frames: Vec<Image> = self.cameras.iter().map(|c| renderer.frame(c).beauty).collect();
        let frames_s = start.elapsed().as_secs_f64();
        // Frames and the cells of the cache grow with the pixels.
        let pixels = |cameras: &[Camera]| cameras.iter().map(|c| c.width * c.height).sum::<usize>() as f64;
        let scale = pixels(&self.composition.cameras) / pixels(&self.cameras).max(1.0);
        // Covered in two dimensions, a shadow's edges grow with the square root.
        let seconds = prepare_s + renderer.prepared.cache_s * scale.sqrt() + frames_s * scale;
        Ok(Pilot { frames, seconds })
    }
}
