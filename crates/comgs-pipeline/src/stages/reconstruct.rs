//! `reconstruct`: a capture becomes an asset (step 1 of the paper: radiance and geometry).

use crate::progress::human_count;
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, Status, output, source};
use comgs_image::{Encoding, Image, atomic, write_png};
use comgs_inverse::{Kind, Observer, Quality, TrainConfig, TrainError, TrainStatus, TrainView, Trained};
use comgs_scene::asset::{CaptureRecord, TrainingRecord};
use comgs_scene::{Asset, AssetKind, Capture, LoadOptions, Size, Split, View, write_cameras};
use glam::Vec3;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Any capture.
    pub capture: PathBuf,
    /// The asset's folder.
    pub output: PathBuf,
}

/// What to do about the checkpoint of an interrupted run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resume {
    /// Start over, and say that it is there.
    #[default]
    Never,
    /// Continue from it.
    IfThere,
    /// Continue from it, and say so when there is none: somebody expects one.
    Expected,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Object or scene; when absent, a capture whose photos all have masks is an object.
    pub kind: Option<Kind>,
    /// Point on the curve of time against quality.
    pub quality: Quality,
    /// Wall-clock seconds for the whole stage, loading included; the best model so far is the result.
    pub time_budget_s: Option<f64>,
    /// Seed.
    pub seed: u64,
    /// Steps of the training instead of the quality's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<u32>,
    /// Hard limit on surfels instead of the quality's.
    pub max_surfels: Option<usize>,
    /// Photographs are reduced to this width.
    pub max_width: usize,
    /// What to do about the checkpoint of an interrupted run. Not part of the result.
    #[serde(skip)]
    pub resume: Resume,
    /// Seconds between checkpoints. Not part of the result.
    #[serde(skip)]
    pub checkpoint_interval_s: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            kind: None,
            quality: Quality::Balanced,
            time_budget_s: None,
            seed: 0,
            iterations: None,
            max_surfels: None,
            max_width: 1600,
            resume: Resume::Never,
            checkpoint_interval_s: 60.0,
        }
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The asset's folder.
    pub asset: PathBuf,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// Name of the checkpoint in the asset's folder. Names that begin with a dot are no part of an asset.
const CHECKPOINT: &str = ".checkpoint";

/// What is said when the time was over before the training began.
const NO_STEP: &str =
    "no training step fitted into the time budget: the asset is the first surface, not trained";

/// Reconstructs a capture into an asset: `asset.json`, `surfels.ply`, `cameras.json` (the capture's cameras),
/// `preview.png`, `run.json`.
///
/// # Errors
/// [`PipelineError`] when the capture has problems (all of them), training refuses it, or the asset cannot be written.
/// [`PipelineError::Cancelled`] leaves a checkpoint from which `resume` continues.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    let started = Instant::now();
    let name = source::name_of(&input.output);
    context.progress.begin(&format!("reconstruct {name}"));
    let mut run = Run::in_folder("reconstruct", &input.output);
    let capture = Capture::open(&input.capture, Split::Train)?;
    let fingerprint = fingerprint(&capture, config)?;
    if let Some(record) = run.reusable(&fingerprint) {
        context
            .progress
            .end(&format!("{}: unchanged since the last run; nothing to do", input.output.display()));
        return Ok(Output { asset: input.output.clone(), reused: true, record });
    }
    output::refuse_input(&input.output, "capture", &input.capture)?;
    run.check_output()?;
    run.describe(fingerprint, json!({"capture": input.capture}), config, Some(config.seed))?;
    for problem in capture.report.problems.iter().filter(|p| !p.path.as_os_str().is_empty()) {
        run.warn(context, problem.to_string());
    }
    let views = run.time("load", || load(&capture, config.max_width, context))?;
    let hdr = views.iter().all(|v| v.encoding == Encoding::Linear);
    let repaired: usize = views.iter().map(|v| v.repaired).sum();
    if repaired > 0 {
        run.warn(context, format!("{repaired} non-finite pixels of the photographs are ignored"));
    }
    let kind = config.kind.unwrap_or_else(|| guess_kind(&views));
    let mut train_config = TrainConfig::preset(kind, config.quality);
    train_config.seed = config.seed;
    if let Some(iterations) = config.iterations {
        train_config.iterations = iterations;
        train_config.density_interval = (iterations / 24).max(50);
    }
    if let Some(limit) = config.max_surfels {
        train_config.max_surfels = limit;
        train_config.initial_surfels = train_config.initial_surfels.min(limit * 6 / 10);
    }
    train_config.time_budget = config.time_budget_s.map(|budget| {
        // Loading has been paid from the budget already.
        Duration::from_secs_f64((budget - started.elapsed().as_secs_f64()).max(0.01))
    });
    let points = initial_points(&capture, &mut run, context)?;
    let image_size = [views[0].camera.width, views[0].camera.height];
    let trained = train(&views, points.as_ref(), &train_config, input, config, context, &mut run)?;

    let mut asset = Asset::new(asset_kind(kind), trained.cloud);
    asset.record.up = capture.up.to_array();
    asset.record.capture = Some(CaptureRecord {
        name: source::name_of(&input.capture),
        format: capture.format,
        views: capture.views.len(),
        image_size,
        hdr,
        left_out: capture.report.left_out.clone(),
    });
    let report = &trained.report;
    let mut metrics = BTreeMap::from([(source::NEAR_METRIC.to_owned(), f64::from(report.near))]);
    if report.iterations > 0 {
        metrics.insert("train_psnr_db".to_owned(), f64::from(report.train_psnr_db));
    } else {
        run.warn(context, NO_STEP.to_owned());
    }
    asset.record.training = Some(TrainingRecord {
        program: format!("comgs {}", crate::VERSION),
        seed: config.seed,
        iterations: u64::from(report.iterations),
        seconds: report.seconds,
        config: serde_json::to_value(&train_config)
            .map_err(|e| PipelineError::Internal(format!("training configuration: {e}")))?,
        metrics,
    });
    run.time("save", || save(&mut asset, input))?;
    for file in ["asset.json", "surfels.ply", "cameras.json", "preview.png"] {
        let path = input.output.join(file);
        if path.is_file() {
            run.output(&path)?;
        }
    }
    let _ = std::fs::remove_file(input.output.join(CHECKPOINT));
    run.results(json!({
        "kind": kind,
        "surfels": asset.surfels.len(),
        "training": report,
        "resolved": train_config,
    }));
    let record = run.finish()?;
    let quality = if report.iterations > 0 {
        format!("{} steps, {:.2} dB on the training views", report.iterations, report.train_psnr_db)
    } else {
        "not trained".to_owned()
    };
    context.progress.end(&format!("{}: {} surfels, {quality}", input.output.display(), asset.surfels.len()));
    Ok(Output { asset: input.output.clone(), reused: false, record })
}

/// Everything that is read of a capture, and the configuration.
fn fingerprint(capture: &Capture, config: &Config) -> Result<String, PipelineError> {
    let mut fingerprint = Fingerprint::new("reconstruct");
    fingerprint.config("config", config)?;
    add_capture(&mut fingerprint, capture)?;
    Ok(fingerprint.finish())
}

/// Adds everything that is read of a capture.
pub(super) fn add_capture(fingerprint: &mut Fingerprint, capture: &Capture) -> Result<(), PipelineError> {
    let mut files: Vec<(String, PathBuf)> = Vec::new();
    for view in &capture.views {
        files.push((format!("{} {}", view.camera.name, view.location), view.image.clone()));
        files.extend(view.mask.iter().map(|m| ("mask".to_owned(), m.clone())));
    }
    let mut lists: Vec<&PathBuf> = capture.views.iter().map(|v| &v.list).collect();
    lists.dedup();
    for list in lists {
        // A COLMAP list is its model's folder.
        fingerprint.path("list", list)?;
    }
    files.extend(capture.points_path.iter().map(|p| ("points".to_owned(), p.clone())));
    fingerprint.files("capture", &files)
}

pub(super) fn load(
    capture: &Capture,
    max_width: usize,
    context: &Context<'_>,
) -> Result<Vec<View>, PipelineError> {
    context.check()?;
    let options = LoadOptions { size: Size::MaxWidth(max_width) };
    Ok(capture.load_with(&options, &|p| {
        context.progress.update(&Status {
            fraction: None,
            message: format!("loading photo {} of {}", p.done, p.total),
            remaining: None,
        });
    })?)
}

/// An object when every photo has a mask that cuts something away.
fn guess_kind(views: &[View]) -> Kind {
    let cut_out = |v: &View| v.alpha.as_ref().is_some_and(|a| a.data.iter().any(|x| *x < 0.5));
    if views.iter().all(cut_out) { Kind::Object } else { Kind::Scene }
}

fn asset_kind(kind: Kind) -> AssetKind {
    match kind {
        Kind::Object => AssetKind::Object,
        Kind::Scene => AssetKind::Scene,
    }
}

/// Positions and linear radiance of structure-from-motion points.
type Points = (Vec<Vec3>, Vec<Vec3>);

fn initial_points(
    capture: &Capture,
    run: &mut Run,
    context: &Context<'_>,
) -> Result<Option<Points>, PipelineError> {
    let Some(points) = capture.points()? else { return Ok(None) };
    if points.duplicates + points.at_cameras > 0 {
        run.warn(
            context,
            format!(
                "of the capture's points, {} are exact duplicates and {} lie in a camera; left out",
                points.duplicates, points.at_cameras
            ),
        );
    }
    let positions: Vec<Vec3> = points.cloud.positions.iter().map(|p| Vec3::from_array(*p)).collect();
    let radiance = match &points.cloud.colors {
        Some(colors) => colors.iter().map(|c| Vec3::from_array(*c)).collect(),
        None => vec![Vec3::splat(0.2); positions.len()],
    };
    Ok((!positions.is_empty()).then_some((positions, radiance)))
}

/// The checkpoint of an interrupted run, when it is wanted; says what is there and what is done with it.
pub(super) fn read_checkpoint(checkpoint: &Path, resume: Resume, context: &Context<'_>) -> Option<Vec<u8>> {
    match (resume, std::fs::read(checkpoint)) {
        (Resume::IfThere | Resume::Expected, Ok(bytes)) => {
            context.progress.note(&format!("continuing from {}", checkpoint.display()));
            Some(bytes)
        }
        (Resume::Expected, Err(_)) => {
            context.progress.note("there is no checkpoint to continue from; starting at the beginning");
            None
        }
        (Resume::Never, Ok(_)) => {
            context.progress.note("an interrupted run left a checkpoint; --resume would continue it");
            None
        }
        (Resume::Never | Resume::IfThere, Err(_)) => None,
    }
}

/// Photos as the optimisations take them.
pub(super) fn train_views(views: &[View]) -> Vec<TrainView> {
    let of = |v: &View| TrainView {
        camera: v.camera.clone(),
        color: v.color.clone(),
        mask: v.alpha.clone(),
        valid: v.valid.clone(),
        hdr: v.encoding == Encoding::Linear,
    };
    views.iter().map(of).collect()
}

fn train(
    views: &[View],
    points: Option<&Points>,
    train_config: &TrainConfig,
    input: &Input,
    config: &Config,
    context: &Context<'_>,
    run: &mut Run,
) -> Result<Trained, PipelineError> {
    let train_views = train_views(views);
    let checkpoint = input.output.join(CHECKPOINT);
    let resume = read_checkpoint(&checkpoint, config.resume, context);
    run.invalidate()?;
    let mut watcher = Watcher::new(
        context,
        input.output.join("preview.png"),
        checkpoint.clone(),
        config.checkpoint_interval_s,
    );
    let points = points.map(|(p, c)| (p.as_slice(), c.as_slice()));
    let start = Instant::now();
    let result = comgs_inverse::train(&train_views, points, train_config, resume.as_deref(), &mut watcher);
    let (saved, failure) = (watcher.saved, watcher.failure.take());
    if let Some(failure) = failure {
        run.warn(context, failure);
    }
    let trained = result.map_err(|e| match e {
        TrainError::Cancelled(steps) => PipelineError::Cancelled {
            kept: saved.then(|| {
                format!("the state after {steps} steps is in {}; --resume continues", checkpoint.display())
            }),
        },
        TrainError::Checkpoint(reason) => PipelineError::input(
            checkpoint.display().to_string(),
            "the checkpoint of this capture and configuration (without --resume training starts over)",
            reason,
        ),
        other => PipelineError::Train { capture: input.capture.clone(), reason: other },
    })?;
    run.add_time("first surface", trained.report.init_seconds, false);
    run.add_time("train", start.elapsed().as_secs_f64() - trained.report.init_seconds, false);
    for warning in &trained.report.warnings {
        run.warn(context, warning.clone());
    }
    Ok(trained)
}

/// Cameras first: the asset is whole once `asset.json` is there.
fn save(asset: &mut Asset, input: &Input) -> Result<(), PipelineError> {
    let cameras = comgs_scene::read_cameras(&input.capture)?;
    write_cameras(input.output.join("cameras.json"), &cameras)?;
    Ok(asset.save(&input.output)?)
}

/// Passes on what training says, and stores its state.
pub(super) struct Watcher<'a, 'b> {
    context: &'a Context<'b>,
    preview: PathBuf,
    checkpoint: PathBuf,
    interval: Duration,
    last: Instant,
    /// Whether a checkpoint was stored.
    pub saved: bool,
    /// The first file that could not be written.
    pub failure: Option<String>,
}

impl<'a, 'b> Watcher<'a, 'b> {
    pub(super) fn new(
        context: &'a Context<'b>,
        preview: PathBuf,
        checkpoint: PathBuf,
        interval_s: f64,
    ) -> Self {
        let interval = Duration::from_secs_f64(interval_s.max(1.0));
        Self { context, preview, checkpoint, interval, last: Instant::now(), saved: false, failure: None }
    }
}

impl Observer for Watcher<'_, '_> {
    fn progress(&mut self, status: &TrainStatus) {
        let message = if status.iteration == 0 {
            status.phase.to_owned()
        } else {
            format!(
                "{:.1} dB, {} surfels, step {}/{}, {}",
                status.psnr_db,
                human_count(status.surfels),
                status.iteration,
                status.iterations,
                status.phase.trim_start_matches("training at ")
            )
        };
        let known = status.iteration > 0 && status.remaining_s.is_finite() && status.remaining_s >= 0.0;
        self.context.progress.update(&Status {
            fraction: Some(f64::from(status.fraction)),
            message,
            remaining: known.then(|| Duration::from_secs_f64(status.remaining_s.min(1e6))),
        });
    }

    fn preview(&mut self, _view: &str, rendering: &Image) {
        // A preview that cannot be written is no reason to stop.
        if let Err(e) = write_png(&self.preview, rendering) {
            self.failure.get_or_insert(format!("the preview could not be written: {e}"));
        }
    }

    fn checkpoint(&mut self, bytes: Vec<u8>) {
        match store(&self.checkpoint, &bytes) {
            Ok(()) => self.saved = true,
            Err(e) => {
                self.failure.get_or_insert(format!("a checkpoint could not be written: {e}"));
            }
        }
        self.last = Instant::now();
    }

    fn wants_checkpoint(&mut self) -> bool {
        self.last.elapsed() >= self.interval
    }

    fn cancelled(&self) -> bool {
        self.context.cancel.is_cancelled()
    }
}

fn store(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    atomic::write_file(path, |w| w.write_all(bytes))
}
