//! Small frames of a composition.

use crate::stages::editing::{Baked, Composition, OwnLight, Settings, Shadow};
use crate::stages::render_composition::{Ground, Renderer, receivers};
use crate::{Context, PipelineError};
use comgs_compose::ReceiverCloud;
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_light::EnvironmentSampler;
use comgs_trace::Tracer;
use std::cell::OnceCell;
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
    /// What the cameras see of the scene, and the seconds that it took; for all pilots with a shadow.
    seen: OnceCell<(ReceiverCloud, f64)>,
    /// What the objects hide from themselves, without and with what it shows of them, without and with a shadow (several
    /// objects need one), and the seconds.
    own: [OnceCell<(Option<OwnLight>, f64)>; 4],
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
        let (seen, own) = Default::default();
        Self { composition, tracer, sampler, baked, cameras, seen, own }
    }

    /// Renders the small frames with some settings.
    pub fn render(&self, settings: &Settings, context: &Context<'_>) -> Result<Pilot, PipelineError> {
        context.check()?;
        let start = Instant::now();
        let ground = Ground::new(self.composition, self.tracer, self.sampler, settings)?;
        let mut prepare_s = start.elapsed().as_secs_f64();
        // What pilots share is made once and counted for each.
        let nothing = ReceiverCloud::default();
        let seen = match settings.shadow {
            Shadow::Auto | Shadow::Probes => {
                let (seen, seconds) =
                    once(&self.seen, || receivers(&ground.composer, &self.cameras, context))?;
                prepare_s += seconds;
                seen
            }
            _ => &nothing,
        };
        let own =
            &self.own[usize::from(settings.indirect) + 2 * usize::from(settings.shadow == Shadow::Auto)];
        let own = if settings.self_occlusion || settings.indirect {
            let (own, seconds) = once(own, || OwnLight::new(self.composition, settings))?;
            prepare_s += seconds;
            own.as_ref()
        } else {
            None
        };
        let start = Instant::now();
        let renderer = Renderer::new(self.composition, &ground, Some(self.baked), own, seen, settings)?;
        prepare_s += start.elapsed().as_secs_f64() - renderer.prepared.cache_s;
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

/// What is in the cell, made if nothing is, with the seconds of making it.
fn once<T>(
    cell: &OnceCell<(T, f64)>,
    make: impl FnOnce() -> Result<T, PipelineError>,
) -> Result<&(T, f64), PipelineError> {
    if cell.get().is_none() {
        let start = Instant::now();
        let made = make()?;
        // Nothing else fills it meanwhile.
        let _ = cell.set((made, start.elapsed().as_secs_f64()));
    }
    cell.get().ok_or_else(|| PipelineError::Internal("a pilot lost what pilots share".into()))
}
