//! What cameras see of a scene.

use crate::{Context, PipelineError, Status};
use comgs_compose::{Composer, ReceiverCloud, SceneFrame};
use comgs_geom::Camera;

/// What cameras see of the scene: does not change when objects move.
#[derive(Default)]
pub(crate) struct Seen {
    /// The points of all of them.
    pub cloud: ReceiverCloud,
    /// The frame of every camera, as far as memory goes.
    frames: Vec<Option<SceneFrame>>,
}

/// Memory for frames of the scene.
const KEPT_BYTES: usize = 256 << 20;

impl Seen {
    /// Looks through every camera. `known` are frames that are there already.
    ///
    /// # Errors
    /// [`PipelineError::Cancelled`].
    pub fn new(
        composer: &Composer<'_>,
        cameras: &[Camera],
        mut known: Vec<SceneFrame>,
        context: &Context<'_>,
    ) -> Result<Self, PipelineError> {
        let (mut seen, mut bytes) = (Self::default(), 0);
        for (i, camera) in cameras.iter().enumerate() {
            context.check()?;
            context.progress.update(&Status {
                fraction: Some(i as f64 / cameras.len() as f64),
                message: format!("what camera {} sees", camera.name),
                remaining: None,
            });
            let frame = match known.iter().position(|f| f.camera() == camera) {
                Some(k) => known.swap_remove(k),
                None => composer.scene_frame(camera),
            };
            seen.cloud.add(camera, frame.receivers());
            bytes += frame.memory_bytes();
            seen.frames.push((bytes <= KEPT_BYTES).then_some(frame));
        }
        Ok(seen)
    }

    /// The frame of a camera, by its number, where it was kept; only once.
    pub fn take(&mut self, camera: usize) -> Option<SceneFrame> {
        self.frames.get_mut(camera).and_then(Option::take)
    }

    /// The same, to be used again.
    pub fn frame(&self, camera: usize) -> Option<&SceneFrame> {
        self.frames.get(camera).and_then(Option::as_ref)
    }
}
