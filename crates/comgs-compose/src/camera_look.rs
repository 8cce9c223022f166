//! What a camera adds to what it sees: defocus and noise, estimated from photos and given to composed frames.
//!
//! A scene that was reconstructed from photos has their defocus in its colours already, but for their noise, which
//! reconstruction averages out. A placed object has neither: it comes from other photos, near and sharp. So defocus is given
//! to the object alone, and noise to the whole frame.

mod defocus;
mod noise;

pub use defocus::Defocus;
pub use noise::Noise;

use crate::ComposedFrame;
use serde::Serialize;

/// Defocus and noise of one camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CameraLook {
    /// `None` where the photos are sharp at all depths.
    pub defocus: Option<Defocus>,
    /// `None` where the photos have less noise than 8 bit show.
    pub noise: Option<Noise>,
}

impl CameraLook {
    /// Blurs the object by its depth, then adds noise to `beauty`; the other layers stay free of noise. `stream` tells the
    /// frames of one seed apart.
    pub fn apply(&self, frame: &mut ComposedFrame, seed: u64, stream: u64) {
        if let Some(defocus) = &self.defocus {
            defocus.blur_object(frame);
        }
        if let Some(noise) = &self.noise {
            noise.add(&mut frame.beauty, seed, stream);
        }
    }
}
