//! `decompose`: a reconstructed object becomes relightable (step 2 of the paper: material, light and visibility).

use super::reconstruct::{Resume, Watcher, add_capture, load, read_checkpoint, train_views};
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, record, source};
use comgs_image::{Image, encode_exr, write_png};
use comgs_inverse::{AlbedoScale, DecomposeConfig, Decomposed, Quality, TrainError, TrainView};
use comgs_raster::{Planes, surface_normals};
use comgs_scene::{Asset, AssetKind, Capture, Split};
use comgs_surfel::{PlyStyle, SurfelCloud, ply};
use serde::Serialize;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Name of the light an object was captured under, in its asset.
pub const LIGHT_FILE: &str = "env.exr";
/// Name of the probes in an asset.
pub const PROBES_FILE: &str = "probes.safetensors";
/// Name of the surfels as `reconstruct` made them, in an asset that has been decomposed: another decomposition starts
/// from them.
pub const RADIANCE_FILE: &str = "radiance.ply";
/// Height of the light that is written, in texels.
const LIGHT_HEIGHT: usize = 256;
/// Name of the checkpoint in the asset's folder.
const CHECKPOINT: &str = ".decompose.checkpoint";

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Object asset.
    pub asset: PathBuf,
    /// The capture it was reconstructed from.
    pub capture: PathBuf,
    /// The asset to make; the same folder when absent.
    pub output: Option<PathBuf>,
}

/// A grey card in a training view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GreyCard {
    /// Name of the view.
    pub view: String,
    /// Pixel column.
    pub x: usize,
    /// Pixel row.
    pub y: usize,
    /// Its albedo.
    pub albedo: f32,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// The optimisation; its grey card, if any, is filled in from `grey_card`.
    pub decompose: DecomposeConfig,
    /// A grey card that fixes the scale of albedo and light.
    pub grey_card: Option<GreyCard>,
    /// Photographs are reduced to this width.
    pub max_width: usize,
    /// Wall-clock seconds for the whole stage.
    pub time_budget_s: Option<f64>,
    /// What to do about the checkpoint of an interrupted run. Not part of the result.
    #[serde(skip)]
    pub resume: Resume,
    /// Seconds between checkpoints. Not part of the result.
    #[serde(skip)]
    pub checkpoint_interval_s: f64,
}

impl Config {
    /// Settings for a point on the curve of time against quality (`docs/cost-of-accuracy.md`).
    #[must_use]
    pub fn preset(quality: Quality) -> Self {
        let mut decompose = DecomposeConfig::default();
        match quality {
            Quality::Draft => {
                decompose.iterations = 300;
                decompose.rays = 64;
                decompose.probes = 2000;
            }
            Quality::Balanced => {}
            Quality::Reference => {
                decompose.iterations *= 3;
                decompose.rays = 256;
                decompose.probes = 10_000;
            }
        }
        Self {
            decompose,
            grey_card: None,
            max_width: 1600,
            time_budget_s: None,
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

/// Decomposes an object asset: its surfels get material columns and refined geometry, and `env.exr` (the light of the
/// capture), `probes.safetensors` and `radiance.ply` (the surfels as they were) join it, with `decomposition.png` to look at.
///
/// In place, the record of the reconstruction is brought up to date, so that running both stages again finds nothing to do.
///
/// # Errors
/// [`PipelineError`]: an asset that is no object or has no surfels, a capture without masks, photos that agree on no
/// surface, an unwritable output. Nothing is replaced before the optimisation has ended.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    let started = Instant::now();
    let output = input.output.clone().unwrap_or_else(|| input.asset.clone());
    context.progress.begin(&format!("decompose {}", source::name_of(&output)));
    let mut asset = source::load_surfels(&input.asset, AssetKind::Object)?;
    if asset.record.kind != AssetKind::Object {
        return Err(PipelineError::input(
            input.asset.display().to_string(),
            "an object",
            "a scene; only objects can be decomposed",
        ));
    }
    let capture = Capture::open(&input.capture, Split::Train)?;
    let (cloud, base) = radiance_surfels(&asset, &input.asset)?;
    let mut run = Run::in_folder("decompose", &output);
    let mut fingerprint = Fingerprint::new("decompose");
    fingerprint.config("config", config)?;
    fingerprint.path("surfels", &base)?;
    add_capture(&mut fingerprint, &capture)?;
    let fingerprint = fingerprint.finish();
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end(&format!("{}: unchanged since the last run; nothing to do", output.display()));
        return Ok(Output { asset: output, reused: true, record });
    }
    run.check_output()?;
    let inputs = json!({"asset": input.asset, "capture": input.capture});
    run.describe(fingerprint, inputs, config, Some(config.decompose.seed))?;
    let views = run.time("load", || load(&capture, config.max_width, context))?;
    let mut settings = config.decompose.clone();
    if let Some(card) = &config.grey_card {
        let view = views.iter().position(|v| v.camera.name == card.view).ok_or_else(|| {
            PipelineError::input("--grey-card", "a training view of the capture", format!("{:?}", card.view))
        })?;
        settings.albedo_scale = AlbedoScale::GreyCard { view, x: card.x, y: card.y, albedo: card.albedo };
    }
    settings.time_budget = config
        .time_budget_s
        .map(|budget| Duration::from_secs_f64((budget - started.elapsed().as_secs_f64()).max(1.0)));
    let views = train_views(&views);
    let made = optimise(&views, &cloud, &settings, &output, config, context, &mut run)?;
    asset.surfels = made.cloud.clone();
    run.time("save", || save(&mut asset, &made, &cloud, &input.asset, &output))?;
    let sheet = output.join("decomposition.png");
    write_png(&sheet, &picture(&made, &asset, &views[views.len() / 2]))?;
    let light_png = output.join("env.png");
    write_png(&light_png, made.light.to_environment(LIGHT_HEIGHT).image())?;
    let files = ["asset.json", "surfels.ply", LIGHT_FILE, PROBES_FILE, RADIANCE_FILE];
    for path in files.map(|f| output.join(f)).iter().chain([&sheet, &light_png]) {
        if path.is_file() {
            run.output(path)?;
        }
    }
    let _ = std::fs::remove_file(output.join(CHECKPOINT));
    let report = &made.report;
    run.results(json!({"surfels": asset.surfels.len(), "decomposition": report, "resolved": settings}));
    let record = run.finish()?;
    if output == input.asset {
        record::refresh(&output.join("run.json"), "reconstruct", &["asset.json", "surfels.ply"])?;
    }
    context.progress.end(&format!(
        "{}: {} steps in {:.0} s ({:.0} ms each), {} probes, mean albedo {:.2}; scale by {}",
        output.display(),
        report.iterations,
        report.seconds,
        1e3 * report.step_seconds,
        report.probes,
        report.mean_albedo,
        report.scale
    ));
    Ok(Output { asset: output, reused: false, record })
}

/// The surfels as `reconstruct` made them, and their file.
fn radiance_surfels(asset: &Asset, path: &Path) -> Result<(SurfelCloud, PathBuf), PipelineError> {
    match asset.file(RADIANCE_FILE) {
        Some(file) => {
            let (cloud, _) = ply::read_surfels(&file).map_err(comgs_scene::SceneError::from)?;
            Ok((cloud, file))
        }
        None => {
            let file = if asset.root.as_os_str().is_empty() {
                path.to_owned()
            } else {
                asset.root.join("surfels.ply")
            };
            Ok((asset.surfels.clone(), file))
        }
    }
}

fn optimise(
    views: &[TrainView],
    cloud: &SurfelCloud,
    settings: &DecomposeConfig,
    output: &Path,
    config: &Config,
    context: &Context<'_>,
    run: &mut Run,
) -> Result<Decomposed, PipelineError> {
    let checkpoint = output.join(CHECKPOINT);
    let resume = read_checkpoint(&checkpoint, config.resume, context);
    run.invalidate()?;
    let preview = output.join("preview.png");
    let mut watcher = Watcher::new(context, preview, checkpoint.clone(), config.checkpoint_interval_s);
    let start = Instant::now();
    let result = comgs_inverse::decompose(views, cloud, settings, resume.as_deref(), &mut watcher);
    if let Some(failure) = watcher.failure.take() {
        run.warn(context, failure);
    }
    let made = result.map_err(|e| match e {
        TrainError::Cancelled(steps) => PipelineError::Cancelled {
            kept: watcher.saved.then(|| {
                format!("the state after {steps} steps is in {}; --resume continues", checkpoint.display())
            }),
        },
        TrainError::Checkpoint(reason) => PipelineError::input(
            checkpoint.display().to_string(),
            "the checkpoint of this object and configuration (without --resume the optimisation starts over)",
            reason,
        ),
        other => PipelineError::Train { capture: output.to_owned(), reason: other },
    })?;
    let report = &made.report;
    run.add_time("place probes", report.init_seconds - report.bake_seconds, false);
    run.add_time("bake probes", report.bake_seconds, false);
    run.add_time("optimise", start.elapsed().as_secs_f64() - report.init_seconds, false);
    for warning in &report.warnings {
        run.warn(context, warning.clone());
    }
    Ok(made)
}

fn save(
    asset: &mut Asset,
    made: &Decomposed,
    radiance: &SurfelCloud,
    from: &Path,
    output: &Path,
) -> Result<(), PipelineError> {
    let map = made.light.to_environment(LIGHT_HEIGHT);
    let light = encode_exr(&output.join(LIGHT_FILE), map.image())?;
    let internal = |e: comgs_probe::ProbeError| PipelineError::Internal(e.to_string());
    let probes = made.probes.as_ref().map(|set| comgs_probe::to_bytes(set, &made.probe_config));
    let probes = probes.transpose().map_err(internal)?;
    let write_light = |w: &mut dyn Write| w.write_all(&light);
    let write_radiance = |w: &mut dyn Write| ply::write_surfels_to(w, radiance, PlyStyle::Asset);
    let write_probes = |w: &mut dyn Write| w.write_all(probes.as_deref().unwrap_or_default());
    let mut extra: Vec<comgs_scene::asset::ExtraFile<'_>> =
        vec![(LIGHT_FILE, &write_light), (RADIANCE_FILE, &write_radiance)];
    if probes.is_some() {
        extra.push((PROBES_FILE, &write_probes));
    } else {
        asset.record.files.remove(PROBES_FILE);
    }
    asset.save_with(output, &extra)?;
    // The capture's cameras stand beside the record of the reconstruction.
    let (old, new) = (from.join("cameras.json"), output.join("cameras.json"));
    if old.is_file() && !new.exists() {
        std::fs::copy(&old, &new).map_err(|e| PipelineError::io(&new, e))?;
    }
    Ok(())
}

/// One view as photo, albedo, normals, and roughness (red) with metallic (green), side by side over black.
fn picture(made: &Decomposed, asset: &Asset, view: &TrainView) -> Image {
    let frame = comgs_raster::render(&made.cloud, &view.camera, Planes::ALL, &source::raster_config(asset));
    let (w, h) = (view.camera.width, view.camera.height);
    let mut out = Image::zeros(4 * w, h, 3);
    let (Some(material), Some(normal)) = (&frame.material, surface_normals(&frame, &view.camera)) else {
        return out;
    };
    for y in 0..h {
        for x in 0..w {
            let mask = view.mask.as_ref().map_or(1.0, |m| m.pixel(x, y)[0]);
            let m = material.pixel(x, y);
            let weight = frame.weight.pixel(x, y)[0];
            let n = normal.pixel(x, y);
            let tiles = [
                view.color.rgb(x, y).map(|v| v * mask),
                [m[0], m[1], m[2]],
                std::array::from_fn(|k| (0.5 * (n[k] + weight)).clamp(0.0, 1.0).powf(2.2)),
                [m[3], m[4], 0.0],
            ];
            for (k, tile) in tiles.iter().enumerate() {
                out.pixel_mut(k * w + x, y).copy_from_slice(tile);
            }
        }
    }
    out
}
