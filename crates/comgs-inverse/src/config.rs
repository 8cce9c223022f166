//! Every knob of a reconstruction, with unit, range and default.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// What is captured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// One thing, cut out by masks; cameras around it.
    Object,
    /// A place that fills the frames.
    Scene,
}

/// Points on the curve of time against quality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// A look at the result in about a minute.
    Draft,
    /// The default.
    Balanced,
    /// As good as it gets on this machine.
    Reference,
}

/// Configuration of [`crate::train()`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainConfig {
    /// What is captured.
    pub kind: Kind,
    /// Number of optimisation steps, > 0.
    pub iterations: u32,
    /// Hard limit on the number of surfels.
    pub max_surfels: usize,
    /// Surfels to start with, at most `max_surfels`.
    pub initial_surfels: usize,
    /// Highest degree of the harmonics, 0 to 3.
    pub sh_degree: usize,
    /// Weight of 1 − SSIM (Eq. 2: 0.2).
    pub ssim_weight: f32,
    /// Weight of depth-normal consistency (Eq. 3), a mean over the part of the frame that is trained on: the whole frame for
    /// scenes (the paper's 0.05), the box around the mask for objects, of which they fill about a half.
    pub depth_normal_weight: f32,
    /// Weight of the mask cross-entropy (Eq. 4; paper: 0.05).
    pub mask_weight: f32,
    /// Steps between rounds of growth and pruning.
    pub density_interval: u32,
    /// Fractions of the steps after which training runs at 1/2 and at full resolution (it starts at 1/4).
    pub resolution_steps: [f32; 2],
    /// Growth ends after this fraction of the steps.
    pub density_end: f32,
    /// Learning rate of positions at the start, in units of the cameras' spread.
    pub position_rate: f32,
    /// Learning rate of log scales.
    pub scale_rate: f32,
    /// Learning rate of quaternions.
    pub rotation_rate: f32,
    /// Learning rate of opacity logits.
    pub opacity_rate: f32,
    /// Learning rate of the constant harmonic; the others get a tenth.
    pub color_rate: f32,
    /// Stop after this time with what there is; schedules follow the clock then.
    pub time_budget: Option<Duration>,
    /// Seed of everything random.
    pub seed: u64,
}

impl TrainConfig {
    /// Defaults for a kind and a quality. The numbers are points on the curves of `docs/cost-of-accuracy.md`.
    #[must_use]
    pub fn preset(kind: Kind, quality: Quality) -> Self {
        let (iterations, max_surfels, sh_degree) = match (kind, quality) {
            (Kind::Object, Quality::Draft) => (700, 12_000, 1),
            (Kind::Object, Quality::Balanced) => (4_000, 30_000, 3),
            (Kind::Object, Quality::Reference) => (12_000, 60_000, 3),
            (Kind::Scene, Quality::Draft) => (700, 30_000, 1),
            (Kind::Scene, Quality::Balanced) => (4_500, 70_000, 2),
            (Kind::Scene, Quality::Reference) => (15_000, 150_000, 3),
        };
        Self {
            kind,
            iterations,
            max_surfels,
            initial_surfels: max_surfels * 6 / 10,
            sh_degree,
            ssim_weight: 0.2,
            depth_normal_weight: match kind {
                Kind::Object => 0.3,
                Kind::Scene => 0.05,
            },
            mask_weight: 0.05,
            density_interval: (iterations / 24).max(50),
            resolution_steps: [0.12, 0.35],
            density_end: 0.7,
            position_rate: 3e-4,
            scale_rate: 0.008,
            rotation_rate: 0.002,
            opacity_rate: 0.05,
            color_rate: 0.005,
            time_budget: None,
            seed: 0,
        }
    }

    /// Problems with the values; empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut require = |ok: bool, text: String| {
            if !ok {
                problems.push(text);
            }
        };
        require(self.iterations > 0, "iterations is 0, expected > 0".into());
        require(self.max_surfels >= 16, format!("max_surfels is {}, expected ≥ 16", self.max_surfels));
        require(self.sh_degree <= 3, format!("sh_degree is {}, expected 0 to 3", self.sh_degree));
        for (name, v) in [
            ("ssim_weight", self.ssim_weight),
            ("depth_normal_weight", self.depth_normal_weight),
            ("mask_weight", self.mask_weight),
        ] {
            require(v >= 0.0 && v.is_finite(), format!("{name} is {v}, expected ≥ 0"));
        }
        problems
    }
}
