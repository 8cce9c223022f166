//! The training loop: [`report`] (what it says), `check` (before any work), `start` (the first surfels), `step` (one step).

mod check;
pub mod report;
mod start;
mod step;

pub use report::{MIN_VIEWS, Observer, Silent, TrainError, TrainReport, TrainStatus, Trained};

use crate::checkpoint;
use crate::config::TrainConfig;
use crate::density::Evidence;
use crate::view::{Rig, TrainView};
use check::{check, identity};
use comgs_geom::Rng;
use comgs_optim::Adam;
use comgs_raster::{Planes, RasterConfig, render};
use comgs_surfel::SurfelCloud;
use glam::Vec3;
use start::initialise;
use std::time::Instant;
use step::Trainer;

/// Everything that a step changes.
pub(crate) struct State {
    pub iteration: u32,
    pub cloud: SurfelCloud,
    /// Moments of positions, rotations, log scales, opacities, harmonics.
    pub adam: [Adam; 5],
    pub evidence: Evidence,
    pub rng: Rng,
    pub queue: Vec<u32>,
    pub dropped_gradients: u64,
    pub psnr_db: f32,
    pub elapsed_s: f64,
}

impl State {
    fn new(cloud: SurfelCloud, seed: u64) -> Self {
        let n = cloud.len();
        let adam = [3 * n, 4 * n, 2 * n, n, cloud.sh.len()].map(Adam::new);
        Self {
            iteration: 0,
            adam,
            evidence: Evidence::new(n),
            cloud,
            rng: Rng::new(seed),
            queue: Vec::new(),
            dropped_gradients: 0,
            psnr_db: 0.0,
            elapsed_s: 0.0,
        }
    }
}

/// Near plane for a rig: a fiftieth of the distance at which it looks.
#[must_use]
pub fn near_plane(rig: &Rig) -> f32 {
    (0.02 * rig.distance) as f32
}

/// Reconstructs surfels from posed photos (ComGS §3.1.1).
///
/// * `points`: structure-from-motion points (position, linear radiance), if the capture has them
/// * `resume`: bytes that [`Observer::checkpoint`] got from the same views and configuration
///
/// The same inputs and seed give the same bytes at any thread count, unless there is a time budget (then the schedule
/// follows the clock).
///
/// # Errors
/// [`TrainError`]: captures that cannot work are refused before any work.
pub fn train(
    views: &[TrainView],
    points: Option<(&[Vec3], &[Vec3])>,
    config: &TrainConfig,
    resume: Option<&[u8]>,
    observer: &mut dyn Observer,
) -> Result<Trained, TrainError> {
    let start = Instant::now();
    let mut report = TrainReport::default();
    let rig = check(views, config, &mut report.warnings)?;
    // Training stops a pixel at a transmittance of 1e-3 instead of 1e-4: a tenth of a percent of a pixel's light for a
    // good part of its list. Rendering keeps the finer stop.
    let raster = RasterConfig { near: near_plane(&rig), transmittance_min: 1e-3, ..Default::default() };
    report.near = raster.near;
    let identity = identity(views);
    let mut state = match resume {
        Some(bytes) => checkpoint::from_bytes(bytes, config, &identity).map_err(TrainError::Checkpoint)?,
        None => {
            observer.progress(&TrainStatus {
                phase: "finding a first surface",
                iterations: config.iterations,
                ..Default::default()
            });
            let cloud = initialise(views, points, &rig, config, &mut report.warnings, observer)?;
            State::new(cloud, config.seed)
        }
    };
    report.init_seconds = start.elapsed().as_secs_f64();
    report.initial_surfels = state.cloud.len();

    let mut trainer = Trainer::new(views, config, &rig, raster);
    let already = state.elapsed_s;
    let mut last_report = Instant::now();
    let mut next_preview = 0.0f32;
    loop {
        state.elapsed_s = already + start.elapsed().as_secs_f64();
        let by_steps = state.iteration as f32 / config.iterations as f32;
        let by_clock =
            config.time_budget.map_or(0.0, |b| (state.elapsed_s / b.as_secs_f64().max(1e-3)) as f32);
        let progress = by_steps.max(by_clock);
        if progress >= 1.0 {
            break;
        }
        if observer.cancelled() {
            observer.checkpoint(checkpoint::to_bytes(&state, config, &identity));
            return Err(TrainError::Cancelled(state.iteration));
        }
        let index = trainer.step(&mut state, progress)?;
        if progress >= next_preview {
            let camera = &views[index].camera;
            let small =
                camera.resized((camera.width / trainer.level).max(1), (camera.height / trainer.level).max(1));
            let frame = render(&state.cloud, &small, Planes::COLOR, &raster);
            observer.preview(&camera.name, &frame.color.expect("colour plane"));
            next_preview = progress + 0.05;
        }
        if last_report.elapsed().as_secs_f64() > 0.2 {
            last_report = Instant::now();
            let elapsed_s = start.elapsed().as_secs_f64();
            observer.progress(&TrainStatus {
                phase: trainer.phase(),
                iteration: state.iteration,
                iterations: config.iterations,
                fraction: progress,
                psnr_db: state.psnr_db,
                surfels: state.cloud.len(),
                elapsed_s,
                remaining_s: trainer.remaining(&state, progress, elapsed_s),
            });
        }
        if observer.wants_checkpoint() {
            observer.checkpoint(checkpoint::to_bytes(&state, config, &identity));
        }
    }
    report.iterations = state.iteration;
    report.surfels = state.cloud.len();
    report.train_psnr_db = state.psnr_db;
    report.dropped_gradients = state.dropped_gradients;
    report.seconds = start.elapsed().as_secs_f64();
    if state.dropped_gradients > 0 {
        report.warnings.push(format!("{} non-finite gradient entries were dropped", state.dropped_gradients));
    }
    Ok(Trained { cloud: state.cloud, report })
}
