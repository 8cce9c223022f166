//! `light`: what shines on a place, as an HDR environment map.

mod report;

use super::completers;
pub use super::completers::{Fill, ModelConfig};
use crate::source::extension;
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, source};
use comgs_image::transfer::linear_from_srgb;
use comgs_image::{Image, write_exr, write_hdr, write_png};
use comgs_panorama::evidence::{self, refine};
use comgs_panorama::{SweepConfig, sweep};
use comgs_scene::AssetKind;
use comgs_trace::{TraceConfig, Tracer};
use glam::DVec3;
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Scene asset or PLY.
    pub scene: PathBuf,
    /// The environment map to write (`.exr` or `.hdr`); pictures go beside it.
    pub output: PathBuf,
    /// Folder for pictures of every step and of spheres under the light.
    pub report: Option<PathBuf>,
}

/// Share of the sphere under which a warning is due.
const LEAST_COVERAGE: f64 = 0.4;

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Where to look around from, scene world.
    pub at: [f64; 3],
    /// How holes are filled.
    pub completion: Fill,
    /// How a learned model is run.
    pub model: ModelConfig,
    /// Whether the scene's own lit surfaces are asked for strong lights and the scale of what was completed.
    pub evidence: bool,
    /// Height of the map in texels; it is twice as wide.
    pub height: usize,
    /// Rays a texel along each side.
    pub samples: usize,
    /// Surfels nearer than this are not seen, scene units; about half the size of the object that will stand there.
    pub near: f64,
}

impl Config {
    /// Around a point, 256×128 texels.
    #[must_use]
    pub fn at(at: DVec3) -> Self {
        Self {
            at: at.to_array(),
            completion: Fill::default(),
            model: ModelConfig::shipped(),
            evidence: false,
            height: 128,
            samples: 2,
            near: 0.0,
        }
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The map.
    pub environment: PathBuf,
    /// Pictures: the map, the sweep alone, its coverage.
    pub pictures: Pictures,
    /// Share of the sphere that was seen.
    pub coverage: f64,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// Where the pictures are.
#[derive(Clone, Debug)]
pub struct Pictures {
    /// The completed map, clipped sRGB.
    pub environment: PathBuf,
    /// What was seen, over black.
    pub sweep: PathBuf,
    /// How much was seen, grey.
    pub alpha: PathBuf,
}

impl Pictures {
    /// Beside `env.exr`: `env.png`, `env_sweep.png`, `env_alpha.png`. Two lights in one folder have pictures of their own.
    fn beside(environment: &Path) -> Self {
        let stem = environment.file_stem().unwrap_or_default().to_string_lossy();
        let named = |suffix: &str| environment.with_file_name(format!("{stem}{suffix}.png"));
        Self { environment: named(""), sweep: named("_sweep"), alpha: named("_alpha") }
    }
}

/// The middle of a placed object, scene world, and its radius; with no object the place of its origin, and 0.
///
/// # Errors
/// [`PipelineError`]: files that cannot be read, a transform file with several objects of which none has the asset's name.
pub fn placed(transform: &Path, object: Option<&Path>) -> Result<([f64; 3], f64), PipelineError> {
    let file = comgs_scene::TransformFile::read(transform)?;
    let name = object.map(source::name_of);
    let Some(similarity) = file.get(name.as_deref()).or_else(|| file.get(None)) else {
        let expected = "one object, or one of the --object's name";
        return Err(PipelineError::input("--transform", expected, transform.display().to_string()));
    };
    let Some(object) = object else { return Ok((similarity.translation.to_array(), 0.0)) };
    let asset = source::load_surfels(object, AssetKind::Object)?;
    let Some((centre, radius)) = comgs_compose::objects::bounding_sphere(&asset.surfels) else {
        return Err(PipelineError::input("--object", "an asset with surfels", object.display().to_string()));
    };
    let centre = similarity.transform_point(centre.as_dvec3());
    Ok((centre.to_array(), similarity.scale * f64::from(radius)))
}

/// Sweeps the scene's radiance field around a point, completes it, and writes it as `env.exr` (or `.hdr`) with pictures.
///
/// # Errors
/// [`PipelineError`]; an output of another type, which could not hold radiance, is refused. A point from which nothing at all was reconstructed is refused, because there is nothing to
/// complete.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("light");
    let mut run = Run::for_file("light", &input.output);
    if !matches!(extension(&input.output).as_str(), "exr" | "hdr") {
        let expected = "a name that ends in .exr or .hdr (a picture cannot hold the light)";
        return Err(PipelineError::input("-o", expected, input.output.display().to_string()));
    }
    if !config.at.iter().all(|v| v.is_finite()) {
        return Err(PipelineError::input("--at", "three finite numbers", format!("{:?}", config.at)));
    }
    let mut fingerprint = Fingerprint::new("light");
    fingerprint.surfels("scene", &input.scene)?;
    if let Some(model) = &config.model.model {
        fingerprint.path("model", model)?;
    }
    fingerprint.entry("report", format!("{:?}", input.report).as_bytes());
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    let pictures = Pictures::beside(&input.output);
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        let coverage = record.results["coverage"].as_f64().unwrap_or(0.0);
        return Ok(Output { environment: input.output.clone(), pictures, coverage, reused: true, record });
    }
    run.check_output()?;
    run.describe(fingerprint, json!({"scene": input.scene}), config, None)?;
    let asset = run.time("load", || source::load_surfels(&input.scene, AssetKind::Scene))?;
    let tracer = run.time("tree", || Tracer::new(&asset.surfels, &TraceConfig::default()))?;
    context.check()?;
    let height = config.height.max(2);
    let seen = run.time("sweep", || {
        let sweep_config =
            SweepConfig { t_min: config.near as f32, samples: config.samples, ..SweepConfig::default() };
        let centre = DVec3::from_array(config.at).as_vec3();
        Ok::<_, PipelineError>(sweep(&tracer, centre, 2 * height, height, &sweep_config))
    })?;
    context.check()?;
    // Photos in eight bits end at white; what reaches it may be a window or the sun.
    let clip = asset.record.capture.as_ref().is_none_or(|c| !c.hdr).then_some(1.0);
    let partial = seen.partial(clip);
    let coverage = f64::from(seen.coverage);
    if coverage < LEAST_COVERAGE {
        let text = format!(
            "only {:.0} % of the sphere around the placement was seen; most of its light is a guess",
            100.0 * coverage
        );
        run.warn(context, text);
    }
    let started = std::time::Instant::now();
    let completed = completers::complete(&partial, config.completion, &config.model, &mut run, context);
    let mut completed = completed.map_err(|e| match e {
        PipelineError::Panorama(comgs_panorama::CompletionError::NothingSeen { .. }) => {
            let at = config.at.map(|v| format!("{v:.3}")).join(", ");
            PipelineError::input(
                format!("light at ({at})"),
                "a place that the scene's cameras saw something of",
                e.to_string(),
            )
        }
        other => other,
    })?;
    run.add_time("complete", started.elapsed().as_secs_f64(), false);
    context.check()?;
    let evidence = if config.evidence && config.completion != Fill::None {
        let centre = DVec3::from_array(config.at).as_vec3();
        let settings = evidence::Config { seed: config.model.seed, clip, ..evidence::Config::default() };
        let found = run.time("evidence", || {
            Ok::<_, PipelineError>(refine(&tracer, &seen, centre, &partial, &completed.image, &settings))
        })?;
        completed.image = found.environment.clone();
        Some(found)
    } else {
        None
    };
    run.invalidate()?;
    run.time("save", || save(input, &pictures, &completed.image, &seen.rgb, &seen.alpha))?;
    for path in [&input.output, &pictures.environment, &pictures.sweep, &pictures.alpha] {
        run.output(path)?;
    }
    if let Some(folder) = &input.report {
        let files = run.time("report", || report::write(folder, &seen, &partial, &completed))?;
        for path in files {
            run.output(&path)?;
        }
    }
    run.results(json!({
        "coverage": coverage,
        "clipped": partial.clipped.as_ref().map(|c| f64::from(comgs_panorama::sweep::coverage(c))),
        "size": [2 * height, height],
        "completer": completed.by,
        "evidence": evidence.as_ref().map(|e| json!({
            "used": e.used,
            "points": e.points,
            "directions": e.directions,
            "loss_before_and_after": e.loss,
            "scale": e.scale,
            "lights": e.lights.iter().map(|l| json!({
                "direction": l.direction.to_array(), "irradiance": l.irradiance,
            })).collect::<Vec<_>>(),
        })),
        "runtime": completed.runtime,
    }));
    let record = run.finish()?;
    context.progress.end(&format!(
        "{}: {:.0} % of the sphere was seen, the rest is filled by {}{}",
        input.output.display(),
        100.0 * coverage,
        completed.by,
        evidence.as_ref().map_or_else(String::new, said)
    ));
    Ok(Output { environment: input.output.clone(), pictures, coverage, reused: false, record })
}

/// What the scene told of its light, for the log.
fn said(evidence: &evidence::Evidence) -> String {
    match (evidence.used, evidence.lights.first()) {
        (true, Some(light)) => {
            let height = light.direction.z.clamp(-1.0, 1.0).asin().to_degrees();
            format!(
                ", with {} strong light(s) that the scene's surfaces tell of (the first {height:.0}° over the horizon)",
                evidence.lights.len()
            )
        }
        (true, None) => ", scaled to what the scene's surfaces tell".into(),
        (false, _) => String::new(),
    }
}

fn save(
    input: &Input,
    pictures: &Pictures,
    completed: &Image,
    rgb: &Image,
    alpha: &Image,
) -> Result<(), PipelineError> {
    if extension(&input.output) == "hdr" {
        write_hdr(&input.output, completed)?;
    } else {
        write_exr(&input.output, completed)?;
    }
    write_png(&pictures.environment, completed)?;
    let mut over_black = rgb.clone();
    for (pixel, a) in over_black.data.chunks_exact_mut(3).zip(&alpha.data) {
        pixel.iter_mut().for_each(|v| *v *= a);
    }
    write_png(&pictures.sweep, &over_black)?;
    // Coverage is no light: its code values are stored as they are.
    write_png(&pictures.alpha, &alpha.map(|a| linear_from_srgb(a.clamp(0.0, 1.0))))?;
    Ok(())
}
