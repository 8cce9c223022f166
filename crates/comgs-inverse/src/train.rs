//! The training loop.

use crate::checkpoint;
use crate::config::{Kind, TrainConfig};
use crate::density::{self, DensityConfig, Evidence};
use crate::geometry_loss::{depth_normal, mask_cross_entropy};
use crate::init::sweep::{SweepConfig, plane_sweep};
use crate::init::{self, SurfacePoint, background, hull};
use crate::view::{LevelView, Rig, TrainView};
use comgs_geom::{Rng, sh};
use comgs_image::Image;
use comgs_optim::{Adam, AdamConfig, Photometric, schedule};
use comgs_raster::{
    FrameGradient, Planes, RasterConfig, SurfelGradients, Workspace, backward, forward, render,
};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use glam::Vec3;
use rayon::prelude::*;
use std::time::Instant;
use thiserror::Error;

/// What a progress bar shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainStatus {
    /// What is going on: "matching views", "training at 1/2 resolution", …
    pub phase: &'static str,
    /// Steps done.
    pub iteration: u32,
    /// Steps to do.
    pub iterations: u32,
    /// Fraction of the whole done, in [0, 1] (by the clock when there is a time budget).
    pub fraction: f32,
    /// Running mean of the training views' PSNR in dB (clipped sRGB).
    pub psnr_db: f32,
    /// Surfels now.
    pub surfels: usize,
    /// Seconds since the start (of this run).
    pub elapsed_s: f64,
    /// Estimated seconds to go.
    pub remaining_s: f64,
}

/// Whoever watches a training. All methods have defaults that do nothing.
pub trait Observer: Sync {
    /// Called a few times a second.
    fn progress(&mut self, _status: &TrainStatus) {}
    /// Called about twenty times a training with a view's name and its linear rendering.
    fn preview(&mut self, _view: &str, _rendering: &Image) {}
    /// Called now and then with a resumable state; the observer may store it.
    fn checkpoint(&mut self, _bytes: Vec<u8>) {}
    /// Whether [`Observer::checkpoint`] wants one now (asked between steps).
    fn wants_checkpoint(&mut self) -> bool {
        false
    }
    /// Whether to stop at the next step; the state is handed to [`Observer::checkpoint`] first.
    fn cancelled(&self) -> bool {
        false
    }
}

/// An observer that does nothing.
pub struct Silent;
impl Observer for Silent {}

/// Why a training did not produce a cloud.
#[derive(Debug, Error, PartialEq)]
pub enum TrainError {
    /// Fewer views than a reconstruction can be made of.
    #[error("{0} usable views, expected at least {MIN_VIEWS} from different places")]
    TooFewViews(usize),
    /// All cameras stand in one place.
    #[error("all {0} cameras stand at the same place: depth cannot be told without parallax")]
    NoParallax(usize),
    /// The images hold nothing.
    #[error("all images are black")]
    Black,
    /// An object capture without masks.
    #[error(
        "{missing} of {total} views of the object have no mask (alpha channel or mask image); masks say what belongs \
         to it"
    )]
    NoMasks {
        /// Views without a mask.
        missing: usize,
        /// All views.
        total: usize,
    },
    /// The masks contradict each other.
    #[error(
        "the masks have no volume in common: poses and masks do not fit together, or the cameras do not surround \
             the object"
    )]
    EmptyHull,
    /// A configuration value is out of range.
    #[error("configuration: {0}")]
    Config(String),
    /// A view does not fit together.
    #[error("view {name}: {problem}")]
    View {
        /// Name of the view.
        name: String,
        /// What is wrong.
        problem: String,
    },
    /// The observer asked to stop; the state went to [`Observer::checkpoint`].
    #[error("stopped on request after {0} steps; the state was saved")]
    Cancelled(u32),
    /// A checkpoint that cannot be continued.
    #[error("cannot resume from the checkpoint: {0}")]
    Checkpoint(String),
    /// Probes cannot be placed on the object.
    #[error("probes: {0}")]
    Probes(String),
    /// Nothing is left to train.
    #[error("no surfel survived: the views do not agree on any surface")]
    Vanished,
}

/// Fewest views.
pub const MIN_VIEWS: usize = 3;

/// How a training went.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainReport {
    /// Steps done.
    pub iterations: u32,
    /// Seconds for the initialisation.
    pub init_seconds: f64,
    /// Seconds for everything.
    pub seconds: f64,
    /// Surfels at the start.
    pub initial_surfels: usize,
    /// Surfels at the end.
    pub surfels: usize,
    /// Running mean of the training views' PSNR in dB.
    pub train_psnr_db: f32,
    /// Non-finite gradient entries that were dropped.
    pub dropped_gradients: u64,
    /// Near plane that was used, world units; render with the same.
    pub near: f32,
    /// Things the user should know.
    pub warnings: Vec<String>,
}

/// A trained cloud.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The surfels.
    pub cloud: SurfelCloud,
    /// How it went.
    pub report: TrainReport,
}

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

/// What tells one set of views from another, for checkpoints.
fn identity(views: &[TrainView]) -> String {
    let mut sum = 0.0f64;
    for v in views {
        sum +=
            v.color.data.iter().step_by(97).map(|&x| f64::from(x)).sum::<f64>() + v.camera.centre().length();
    }
    format!("{} views, {}×{}, {sum:.6e}", views.len(), views[0].camera.width, views[0].camera.height)
}

fn check(views: &[TrainView], config: &TrainConfig, warnings: &mut Vec<String>) -> Result<Rig, TrainError> {
    if let Some(problem) = config.check().into_iter().next() {
        return Err(TrainError::Config(problem));
    }
    if views.len() < MIN_VIEWS {
        return Err(TrainError::TooFewViews(views.len()));
    }
    for v in views {
        let problem = |problem: String| Err(TrainError::View { name: v.camera.name.clone(), problem });
        if let Some(p) = v.camera.problems().into_iter().next() {
            return problem(p);
        }
        if (v.color.width, v.color.height, v.color.channels) != (v.camera.width, v.camera.height, 3) {
            return problem(format!(
                "image is {}×{}×{}, expected {}×{}×3",
                v.color.width, v.color.height, v.color.channels, v.camera.width, v.camera.height
            ));
        }
        let bad = v.color.non_finite();
        if bad > 0 {
            return problem(format!("{bad} samples are not finite"));
        }
    }
    let cameras: Vec<_> = views.iter().map(|v| &v.camera).collect();
    let first = cameras[0].centre();
    let farthest = cameras.iter().map(|c| c.centre().distance(first)).fold(0.0, f64::max);
    let rig = Rig::new(&cameras).ok_or(TrainError::TooFewViews(0))?;
    if farthest < 1e-6 * rig.distance.max(first.length()).max(1e-9) {
        return Err(TrainError::NoParallax(views.len()));
    }
    if views.iter().all(|v| v.color.data.iter().all(|x| *x <= 1e-4)) {
        return Err(TrainError::Black);
    }
    if config.kind == Kind::Object {
        let missing = views.iter().filter(|v| v.mask.is_none()).count();
        if missing > 0 {
            return Err(TrainError::NoMasks { missing, total: views.len() });
        }
    }
    let saturated = views
        .iter()
        .filter(|v| !v.hdr && v.color.data.iter().filter(|x| **x >= 0.99).count() * 2 > v.color.data.len())
        .count();
    if saturated > 0 {
        warnings.push(format!("{saturated} views are clipped in more than half of their samples"));
    }
    Ok(rig)
}

fn initialise(
    views: &[TrainView],
    points: Option<(&[Vec3], &[Vec3])>,
    rig: &Rig,
    config: &TrainConfig,
    warnings: &mut Vec<String>,
    observer: &dyn Observer,
) -> Result<SurfelCloud, TrainError> {
    let start = config.initial_surfels.min(config.max_surfels);
    let cancelled = || observer.cancelled();
    let mut surface: Vec<SurfacePoint> = match config.kind {
        Kind::Object => {
            let mut hull = hull::visual_hull(views, rig, start);
            if hull.is_empty() {
                return Err(TrainError::EmptyHull);
            }
            thin_to(&mut hull, start);
            hull
        }
        Kind::Scene => {
            let shell_count = (start / 8).min(6_000);
            let room = start - shell_count;
            let mut found = plane_sweep(views, rig, &SweepConfig::default(), room, &cancelled);
            if observer.cancelled() {
                return Err(TrainError::Cancelled(0));
            }
            if let Some((positions, radiance)) = points {
                let mut sfm =
                    init::from_points(positions, radiance, rig.focus.as_vec3(), rig.distance as f32);
                thin_to(&mut sfm, room.saturating_sub(found.len()));
                found.extend(sfm);
            }
            if found.len() < room / 20 {
                warnings.push(format!(
                    "only {} surface points were found by matching: little texture or little overlap",
                    found.len()
                ));
            }
            found.extend(background::shell(views, rig, 10.0, shell_count * 2));
            found
        }
    };
    surface.retain(|p| p.position.is_finite() && p.radiance.is_finite() && p.spacing.is_finite());
    thin_to(&mut surface, config.max_surfels);
    if surface.is_empty() {
        return Err(TrainError::Vanished);
    }
    Ok(init::surfels(&surface, ColorEncoding::Srgb))
}

/// Keeps `count` entries evenly spread over the list; spacings grow to fill the gaps.
fn thin_to(points: &mut Vec<SurfacePoint>, count: usize) {
    let n = points.len();
    if n <= count {
        return;
    }
    let widen = (n as f32 / count.max(1) as f32).sqrt();
    let mut i = 0;
    points.retain(|_| {
        let keep = (i * count) / n != ((i + 1) * count) / n;
        i += 1;
        keep
    });
    points.iter_mut().for_each(|p| p.spacing *= widen);
}

/// Fraction of the training after which depth-normal consistency acts: before, depths are still moving.
const DEPTH_NORMAL_START: f32 = 0.1;

struct Trainer<'a> {
    views: &'a [TrainView],
    /// What is trained on of each view.
    cropped: Vec<TrainView>,
    config: &'a TrainConfig,
    rig: Rig,
    raster: RasterConfig,
    level: usize,
    level_views: Vec<LevelView>,
    workspace: Workspace,
    gradients: SurfelGradients,
    photometric: Photometric,
    steps_at_full: (u32, f64),
}

impl<'a> Trainer<'a> {
    fn new(views: &'a [TrainView], config: &'a TrainConfig, rig: &Rig, raster: RasterConfig) -> Self {
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

    fn phase(&self) -> &'static str {
        match self.level {
            1 => "training at full resolution",
            2 => "training at half resolution",
            _ => "training at quarter resolution",
        }
    }

    /// Seconds to go: by the clock's budget, or from the time that steps take at full resolution once known.
    fn remaining(&self, state: &State, progress: f32, elapsed_s: f64) -> f64 {
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

    fn step(&mut self, state: &mut State, progress: f32) -> Result<usize, TrainError> {
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
