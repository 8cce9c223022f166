//! `relight`: a decomposed object under another light.

pub(crate) mod subject;
mod turntable;

pub use turntable::turntable;

use crate::stages::{decompose, frames};
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, Status, source};
use comgs_compose::relight::{self, write_relit_layers};
use comgs_compose::{Indirect, RelightConfig, Relighter, RelitFrame, SelfOcclusion};
use comgs_geom::Camera;
use comgs_image::{Image, write_png};
use comgs_inverse::Quality;
use comgs_light::EnvironmentMap;
use comgs_probe::BakeObserver;
use comgs_scene::write_cameras;
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use subject::{Subject, read_light, refused};

/// Where the object is seen from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Views {
    /// The cameras of any camera file or capture.
    Cameras(PathBuf),
    /// So many around it ([`turntable`]).
    Turntable(usize),
}

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Decomposed asset, or a PLY with material.
    pub asset: PathBuf,
    /// Environment map, equirectangular; the light of the object's own capture when absent.
    pub light: Option<PathBuf>,
    /// Cameras.
    pub views: Views,
    /// Output folder.
    pub output: PathBuf,
}

/// Where self-occlusion comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Visibility {
    /// Probes, and a ray for every sample that the light proposes: small lights cast sharp shadows.
    Mixed,
    /// Probes alone.
    Probes,
    /// A ray for every sample.
    Trace,
    /// Nothing is hidden.
    None,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Point on the curve of time against noise.
    pub quality: Quality,
    /// Samples a pixel instead of the quality's, half by the light, half by the BRDF.
    pub rays: Option<u32>,
    /// Where self-occlusion comes from; an object without probes is traced instead of what needs them.
    pub visibility: Visibility,
    /// Light that is scattered once on the object itself.
    pub indirect: bool,
    /// Also write one multilayer EXR a frame.
    pub layers: bool,
    /// Show the light behind the object.
    pub background: bool,
    /// Width and height of turntable frames in pixels.
    pub size: [usize; 2],
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            quality: Quality::Balanced,
            rays: None,
            visibility: Visibility::Mixed,
            indirect: false,
            layers: false,
            background: false,
            size: [512, 512],
            seed: 0,
        }
    }
}

impl Config {
    /// The relighter's configuration for an object: with the lookup that its probes were learnt with, and the near plane
    /// that it was trained with.
    pub(crate) fn for_subject(&self, subject: &Subject) -> RelightConfig {
        let preset = match self.quality {
            Quality::Draft => RelightConfig::draft(),
            Quality::Balanced => RelightConfig::balanced(),
            Quality::Reference => RelightConfig::reference(),
        };
        let preset = match self.rays {
            Some(rays) => preset.with_rays(rays),
            None => preset,
        };
        let preset = match &subject.probes {
            Some((_, lookup)) => preset.with_lookup(lookup),
            None => preset,
        };
        let self_occlusion = match self.visibility {
            Visibility::Mixed if subject.probes.is_some() => SelfOcclusion::Mixed,
            Visibility::Probes if subject.probes.is_some() => SelfOcclusion::Probes,
            Visibility::Mixed | Visibility::Probes | Visibility::Trace => SelfOcclusion::Trace,
            Visibility::None => SelfOcclusion::None,
        };
        RelightConfig {
            self_occlusion,
            indirect: if self.indirect { Indirect::OneBounce } else { Indirect::None },
            layers: self.layers,
            seed: self.seed,
            raster: source::raster_config(&subject.asset),
            ..preset
        }
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// Folder of the frames (`<camera>.png`).
    pub frames: PathBuf,
    /// Moving picture of a turntable.
    pub preview: Option<PathBuf>,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// Relights an object: `<output>/frames/<camera>.png` (sRGB over black, or over the light), with `layers` also
/// `<output>/layers/<camera>.exr` ([`write_relit_layers`]), for a turntable also `cameras.json` and `preview.gif`. Frames
/// that an interrupted run had finished are kept.
///
/// # Errors
/// [`PipelineError`]: an object without material, a light that is none, settings out of range.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin(&format!("relight {}", source::name_of(&input.asset)));
    let mut run = Run::in_folder("relight", &input.output);
    let subject = Subject::load(&input.asset)?;
    let light = light_path(input, &subject)?;
    let cameras = cameras(input, config, &subject)?;
    let mut fingerprint = Fingerprint::new("relight");
    fingerprint.surfels("asset", &input.asset)?;
    fingerprint.path("light", &light)?;
    fingerprint.config("cameras", &cameras)?;
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    let frames_folder = input.output.join("frames");
    let spins = matches!(input.views, Views::Turntable(_));
    let preview = spins.then(|| input.output.join("preview.gif"));
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        return Ok(Output { frames: frames_folder, preview, reused: true, record });
    }
    run.check_output()?;
    let inputs = json!({"asset": input.asset, "light": light, "views": views_json(&input.views)});
    run.describe(fingerprint, inputs, config, Some(config.seed))?;
    let settings = config.for_subject(&subject);
    if matches!(config.visibility, Visibility::Mixed | Visibility::Probes) && subject.probes.is_none() {
        context.progress.note("the object has no probes: its self-occlusion is traced");
    }
    let map = read_light(&light, |text| run.warn(context, text))?;
    let relighter = prepare(&subject, &map, settings, context)?;
    run.add_time("prepare", relighter.preparation().seconds(), false);

    run.invalidate()?;
    let done = run.resume();
    if !done.is_empty() {
        context.progress.note(&format!("{} files of an interrupted run are kept", done.len()));
    }
    let totals = render(&cameras, &relighter, &map, config, &done, &mut run, context)?;
    for (stage, seconds) in
        [("rasterise", totals.raster_s), ("shade", totals.shade_s), ("write", totals.write_s)]
    {
        run.add_time(stage, seconds, false);
    }
    if totals.rendered > 0 && totals.points == 0 {
        run.warn(context, "no camera sees the object: the frames are empty".to_owned());
    }
    if let Some(preview) = &preview {
        run.time("preview", || write_preview(preview, &frames_folder, &cameras))?;
        run.output(preview)?;
        let list = input.output.join("cameras.json");
        write_cameras(&list, &cameras)?;
        run.output(&list)?;
    }
    let (used, spent) = (relighter.config(), relighter.preparation());
    run.results(json!({
        "frames": cameras.len(),
        "surfels": subject.asset.surfels.len(),
        "probes": subject.probe_set().map_or(0, comgs_probe::ProbeSet::len),
        "self_occlusion": format!("{:?}", used.self_occlusion).to_lowercase(),
        "rays": used.light_rays + used.brdf_rays,
        "shaded_pixels": totals.points,
        "bounce_seconds": spent.bounce_s,
        "bake_seconds": spent.bake_s,
    }));
    let record = run.finish()?;
    context.progress.end(&format!(
        "{} frames in {}, {:.2} s each",
        cameras.len(),
        frames_folder.display(),
        (totals.raster_s + totals.shade_s) / totals.rendered.max(1) as f64
    ));
    Ok(Output { frames: frames_folder, preview, reused: false, record })
}

/// The map that was given, or the one that came with the object.
fn light_path(input: &Input, subject: &Subject) -> Result<PathBuf, PipelineError> {
    match &input.light {
        Some(path) => Ok(path.clone()),
        None => subject.asset.file(decompose::LIGHT_FILE).ok_or_else(|| {
            let what = format!("the light for {}", input.asset.display());
            PipelineError::input(what, "--env, or an asset with the light of its capture", "neither")
        }),
    }
}

fn cameras(input: &Input, config: &Config, subject: &Subject) -> Result<Vec<Camera>, PipelineError> {
    let count = match &input.views {
        Views::Cameras(path) => return frames::read_cameras(path),
        Views::Turntable(count) => *count,
    };
    let [width, height] = config.size;
    if count == 0 || width == 0 || height == 0 {
        let got = format!("{count} of {width}×{height} pixels");
        return Err(PipelineError::input("the turntable", "at least one frame of at least one pixel", got));
    }
    turntable(&subject.asset, count, config.size).ok_or_else(|| {
        let nothing = comgs_compose::RelightError::Invisible(subject.asset.surfels.len());
        refused(&input.asset, &nothing)
    })
}

fn views_json(views: &Views) -> serde_json::Value {
    match views {
        Views::Cameras(path) => json!({"cameras": path}),
        Views::Turntable(count) => json!({"turntable": count}),
    }
}

/// Builds the relighter, saying how far its probes are; a stop is heard there.
pub(crate) fn prepare<'a>(
    subject: &'a Subject,
    map: &EnvironmentMap,
    settings: RelightConfig,
    context: &Context<'_>,
) -> Result<Relighter<'a>, PipelineError> {
    let total = subject.probe_set().map_or(0, comgs_probe::ProbeSet::len);
    let progress = |probes: usize| {
        let message = format!("light between its own surfaces: {probes} of {total} probes");
        context.progress.update(&Status { fraction: None, message, remaining: None });
    };
    let cancelled = || context.cancel.is_cancelled();
    let observer = BakeObserver { cancelled: &cancelled, progress: &progress };
    Relighter::prepare(&subject.asset.surfels, subject.probe_set(), map, settings, observer)
        .map_err(|e| refused(&subject.path, &e))
}

/// Sums over the frames that were rendered.
#[derive(Default)]
struct Totals {
    rendered: usize,
    points: usize,
    raster_s: f64,
    shade_s: f64,
    write_s: f64,
}

/// The files of one frame, with their names relative to the output.
fn files(output: &Path, name: &str, layers: bool) -> Vec<(PathBuf, String)> {
    let mut files = vec![format!("frames/{name}.png")];
    if layers {
        files.push(format!("layers/{name}.exr"));
    }
    files.into_iter().map(|relative| (output.join(&relative), relative)).collect()
}

fn render(
    cameras: &[Camera],
    relighter: &Relighter<'_>,
    map: &EnvironmentMap,
    config: &Config,
    done: &[String],
    run: &mut Run,
    context: &Context<'_>,
) -> Result<Totals, PipelineError> {
    let mut totals = Totals::default();
    let output = run.folder().to_owned();
    let start = Instant::now();
    for (i, camera) in cameras.iter().enumerate() {
        if context.cancel.is_cancelled() {
            let kept = format!("{i} of {} frames are done; the same command continues", cameras.len());
            return Err(PipelineError::Cancelled { kept: Some(kept) });
        }
        let files = files(&output, &camera.name, config.layers);
        if files.iter().all(|(_, relative)| done.contains(relative)) {
            continue;
        }
        let remaining = (totals.rendered > 0).then(|| {
            let each = start.elapsed().as_secs_f64() / totals.rendered as f64;
            Duration::from_secs_f64(each * (cameras.len() - i) as f64)
        });
        context.progress.update(&Status {
            fraction: Some(i as f64 / cameras.len() as f64),
            message: format!("frame {}", camera.name),
            remaining,
        });
        let frame = relighter.render(camera);
        let writing = Instant::now();
        write(&frame, camera, map, config, &files)?;
        for (path, relative) in &files {
            if !done.contains(relative) {
                run.output(path)?;
            }
        }
        run.keep()?;
        totals.write_s += writing.elapsed().as_secs_f64();
        totals.rendered += 1;
        totals.points += frame.stats.points;
        totals.raster_s += frame.stats.raster_s;
        totals.shade_s += frame.stats.shade_s;
    }
    Ok(totals)
}

fn write(
    frame: &RelitFrame,
    camera: &Camera,
    map: &EnvironmentMap,
    config: &Config,
    files: &[(PathBuf, String)],
) -> Result<(), PipelineError> {
    if config.background {
        write_png(&files[0].0, &frame.over(&relight::background(map, camera)))?;
    } else {
        write_png(&files[0].0, &frame.radiance)?;
    }
    if let Some((path, _)) = files.get(1) {
        write_relit_layers(path, frame)?;
    }
    Ok(())
}

/// Milliseconds of a whole turn in the preview.
const TURN_MS: u32 = 6000;
/// Most frames of the preview.
const PREVIEW_FRAMES: usize = 96;

/// A turn as an animated GIF, from the frames on disk.
fn write_preview(path: &Path, folder: &Path, cameras: &[Camera]) -> Result<(), PipelineError> {
    let shown = cameras.len().min(PREVIEW_FRAMES);
    let pictures: Vec<Image> = (0..shown)
        .map(|k| {
            let name = &cameras[k * cameras.len() / shown].name;
            Ok(comgs_image::read(&folder.join(format!("{name}.png")))?.color)
        })
        .collect::<Result<_, PipelineError>>()?;
    // Players slow down what is faster than 20 ms.
    let milliseconds = (TURN_MS / shown as u32).clamp(20, 500);
    frames::write_gif(path, &pictures.iter().collect::<Vec<_>>(), milliseconds)
}
