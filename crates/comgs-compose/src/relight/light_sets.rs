//! Samples of the light, drawn beforehand.

use comgs_geom::Rng;
use comgs_geom::sampling::hammersley;
use comgs_light::{EnvSample, EnvironmentSampler};
use glam::Vec2;

/// Samples of all rotations together; there are at most [`MOST`] rotations and at least [`LEAST`].
const SAMPLES: usize = 1 << 16;
/// Most rotations.
const MOST: usize = 256;
/// Least.
const LEAST: usize = 16;

/// One Hammersley set of a light under many random rotations (modulo 1 in both dimensions). Points choose a rotation by
/// their own random stream. Samples of a light do not depend on the point, and to draw them afresh for each took half of
/// the time of a frame (64 of 128 samples, a map of 512 × 256).
pub(super) struct LightSets {
    each: usize,
    /// `[rotation][sample]`.
    samples: Vec<EnvSample>,
}

impl LightSets {
    /// `each` samples a set, which may be 0; rotations from `stream` of `seed`.
    pub fn new(light: &EnvironmentSampler, each: u32, seed: u64, stream: u64) -> Self {
        let rotations = (SAMPLES / each.max(1) as usize).clamp(LEAST, MOST);
        let mut rng = Rng::stream(seed, stream);
        let mut samples = Vec::with_capacity(rotations * each as usize);
        for _ in 0..rotations {
            let shift = Vec2::new(rng.uniform(), rng.uniform());
            samples.extend((0..each).map(|k| light.sample(hammersley(k, each, shift))));
        }
        Self { each: each as usize, samples }
    }

    /// The set of a random rotation.
    pub fn choose(&self, rng: &mut Rng) -> &[EnvSample] {
        let rotation = rng.below(self.samples.len().checked_div(self.each).unwrap_or(1));
        &self.samples[rotation * self.each..(rotation + 1) * self.each]
    }
}
