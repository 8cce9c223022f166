//! One step: a view rendered and compared, gradients, Adam; growth and the schedule of resolutions.

use super::State;
use super::report::TrainError;
use crate::config::TrainConfig;
use crate::density::{self, DensityConfig, Evidence};
use crate::geometry_loss::{depth_normal, mask_cross_entropy};
use crate::view::{LevelView, Rig, TrainView};
use comgs_geom::sh;
use comgs_image::Image;
use comgs_optim::{Adam, AdamConfig, Photometric, schedule};
use comgs_raster::{FrameGradient, Planes, RasterConfig, SurfelGradients, Workspace, backward, forward};
use rayon::prelude::*;
use std::time::Instant;

/// Fraction of the training after which depth-normal consistency acts: before, depths are still moving.
const DEPTH_NORMAL_START: f32 = 0.1;

/// Everything that stays the same, and buffers.
pub(super) struct Trainer<'a> {
    views: &'a [TrainView],
    /// What is trained on of each view.
    cropped: Vec<TrainView>,
    config: &'a TrainConfig,
    rig: Rig,
    raster: RasterConfig,
    /// Divisor of the resolution now.
    pub(super) level: usize,
    level_views: Vec<LevelView>,
    workspace: Workspace,
    gradients: SurfelGradients,
    photometric: Photometric,
    steps_at_full: (u32, f64),
}

impl<'a> Trainer<'a> {
    pub(super) fn new(
        views: &'a [TrainView],
        config: &'a TrainConfig,
        rig: &Rig,
        raster: RasterConfig,
    ) -> Self {
        Self {
            views,
            cropped: views.par_iter().map(TrainView::cropped).collect(),
            config,
            rig: *rig,
            raster,
            level: usize::MAX,
            level_views: Vec::new(),
            workspace: Workspace::default(),
            gradients: SurfelGradients::default(),
            photometric: Photometric::default(),
            steps_at_full: (0, 0.0),
        }
    }

    pub(super) fn phase(&self) -> &'static str {
        match self.level {
            1 => "training at full resolution",
            2 => "training at half resolution",
            _ => "training at quarter resolution",
        }
    }

    /// Seconds to go: by the clock's budget, or from the time that steps take at full resolution once known.
    pub(super) fn remaining(&self, state: &State, progress: f32, elapsed_s: f64) -> f64 {
        let by_budget = self.config.time_budget.map(|b| (b.as_secs_f64() - state.elapsed_s).max(0.0));
        let steps_left = f64::from(self.config.iterations - state.iteration.min(self.config.iterations));
        let by_steps = if self.steps_at_full.0 > 20 {
            steps_left * self.steps_at_full.1 / f64::from(self.steps_at_full.0)
        } else {
            // Early steps are cheap; late ones cost up to four times as much.
            elapsed_s * f64::from((1.0 - progress) / progress.max(1e-3)) * 2.0
        };
        by_budget.map_or(by_steps, |b| b.min(by_steps))
    }

    /// Divisor of the resolution at this progress; small images are not divided below 64 pixels.
    fn wanted_level(&self, progress: f32) -> usize {
        let divisor = if progress < self.config.resolution_steps[0] {
            4
        } else if progress < self.config.resolution_steps[1] {
            2
        } else {
            1
        };
        let smallest = self.views.iter().map(|v| v.camera.width.min(v.camera.height)).min().unwrap_or(1);
        if smallest / divisor >= 64 {
            divisor
        } else if smallest >= 128 && divisor > 1 {
            2
        } else {
            1
        }
    }

    fn set_level(&mut self, level: usize) {
        if self.level == level {
            return;
        }
        self.level = level;
        self.level_views = self
            .cropped
            .par_iter()
            .map(|v| v.level((v.camera.width / level).max(1), (v.camera.height / level).max(1)))
            .collect();
    }

    /// One step on the next view of the queue; its index.
    pub(super) fn step(&mut self, state: &mut State, progress: f32) -> Result<usize, TrainError> {
        let step_start = Instant::now();
        self.set_level(self.wanted_level(progress));
        let wanted_degree = ((progress * 5.0) as usize).min(self.config.sh_degree);
        if state.cloud.sh_degree < wanted_degree {
            raise_degree(state);
        }
        if state.queue.is_empty() {
            state.queue = (0..self.views.len() as u32).collect();
            state.rng.shuffle(&mut state.queue);
        }
        let index = state.queue.pop().expect("just filled") as usize;
        let view = &self.level_views[index];
        let camera = &view.camera;
        let (width, height) = (camera.width, camera.height);

        let geometric = self.config.depth_normal_weight > 0.0 && progress >= DEPTH_NORMAL_START;
        let planes = if geometric { Planes::GEOMETRY } else { Planes::COLOR };
        let frame = forward(&state.cloud, camera, planes, &self.raster, &mut self.workspace);
        let zero = |c| Image::zeros(width, height, c);
        let (mut color, mut weight, mut error) = (zero(3), zero(1), zero(1));
        let rendering = frame.color.as_ref().expect("colour plane");
        let value = self.photometric.evaluate(
            rendering,
            &view.target,
            self.config.ssim_weight,
            &mut color,
            &mut error,
        );
        let (mut normal, mut depth) = (None, None);
        if geometric {
            let (mut n, mut d) = (zero(3), zero(1));
            depth_normal(&frame, camera, self.config.depth_normal_weight, &mut n, &mut d, &mut weight);
            (normal, depth) = (Some(n), Some(d));
        }
        if let Some(mask) = &view.mask {
            mask_cross_entropy(&frame.weight, mask, self.config.mask_weight, &mut weight);
        }
        let gradient = FrameGradient {
            color: Some(color),
            weight: Some(weight),
            depth,
            normal,
            material: None,
            error: Some(error),
        };
        self.gradients.reset(&state.cloud);
        backward(
            &state.cloud,
            camera,
            &frame,
            &gradient,
            &self.raster,
            &mut self.workspace,
            &mut self.gradients,
        );
        let area = (self.level * self.level) as f32;
        state.evidence.add(&self.gradients.error, &self.gradients.weight, area);
        state.iteration += 1;
        self.apply(state, progress);

        let psnr = value.psnr_db();
        let keep = if state.iteration <= 1 { 0.0 } else { 0.97 };
        state.psnr_db = keep * state.psnr_db + (1.0 - keep) * psnr;
        if state.iteration.is_multiple_of(self.config.density_interval) && progress < 0.95 {
            self.densify(state, progress)?;
        }
        if self.level == 1 {
            self.steps_at_full.0 += 1;
            self.steps_at_full.1 += step_start.elapsed().as_secs_f64();
        }
        Ok(index)
    }

    fn apply(&self, state: &mut State, progress: f32) {
        let c = self.config;
        let adam = AdamConfig::default();
        let t = state.iteration;
        let g = &self.gradients;
        let cloud = &mut state.cloud;
        let start = c.position_rate * self.rig.distance as f32;
        let position_rate = schedule::log_linear(start, 0.01 * start, progress);
        // Everything else ends at a fifth of its rate: the last steps average instead of jumping.
        let late = schedule::log_linear(1.0, 0.2, progress);
        let mut sh_rates = vec![c.color_rate * late / 10.0; cloud.sh_stride()];
        sh_rates[..3].fill(c.color_rate * late);
        let [positions, rotations, scales, opacities, harmonics] = &mut state.adam;
        let dropped =
            positions.step(
                cloud.positions.as_flattened_mut(),
                g.positions.as_flattened(),
                position_rate,
                t,
                &adam,
            ) + rotations.step(
                cloud.rotations.as_flattened_mut(),
                g.rotations.as_flattened(),
                c.rotation_rate * late,
                t,
                &adam,
            ) + scales.step(
                cloud.log_scales.as_flattened_mut(),
                g.log_scales.as_flattened(),
                c.scale_rate * late,
                t,
                &adam,
            ) + opacities.step(&mut cloud.opacity_logits, &g.opacity_logits, c.opacity_rate * late, t, &adam)
                + harmonics.step_rows(&mut cloud.sh, &g.sh, &sh_rates, t, &adam);
        state.dropped_gradients += dropped as u64;
    }

    fn densify(&self, state: &mut State, progress: f32) -> Result<(), TrainError> {
        let config = DensityConfig {
            min_opacity: 0.02,
            min_weight: 0.05,
            max_growth: 0.12,
            budget: self.config.max_surfels,
        };
        let grow = progress < self.config.density_end;
        let round = density::round(&state.cloud, &state.evidence, &config, grow);
        if round.cloud.is_empty() {
            return Err(TrainError::Vanished);
        }
        let widths = [3, 4, 2, 1, state.cloud.sh_stride()];
        for (adam, width) in state.adam.iter_mut().zip(widths) {
            *adam = adam.gathered(&round.order, &round.fresh, width);
        }
        state.evidence = Evidence::new(round.cloud.len());
        state.cloud = round.cloud;
        Ok(())
    }
}

/// Adds one degree of harmonics, at zero, to cloud and optimiser.
fn raise_degree(state: &mut State) {
    let degree = state.cloud.sh_degree + 1;
    let (old, new) = (state.cloud.sh_stride(), 3 * sh::coefficient_count(degree));
    let widen = |column: &[f32]| {
        let mut out = Vec::with_capacity(column.len() / old * new);
        for row in column.chunks_exact(old) {
            out.extend_from_slice(row);
            out.resize(out.len() + new - old, 0.0);
        }
        out
    };
    state.cloud.sh = widen(&state.cloud.sh);
    state.cloud.sh_degree = degree;
    let adam = &mut state.adam[4];
    *adam = Adam { first: widen(&adam.first), second: widen(&adam.second) };
}
