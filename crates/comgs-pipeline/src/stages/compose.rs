//! `compose`: scene, objects and a transform become frames in which the objects stand there.

mod plan;
mod result;

pub use plan::{Config, Input};

use crate::stages::{eval, frames, light};
use crate::{Context, PipelineError, Run, RunRecord, Status, output, source};
use comgs_compose::{ComposedFrame, Composer, PlacedObject, layers::write_frame_layers};
use comgs_image::write_png;
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_trace::{TraceConfig, Tracer};
use plan::Plan;
use serde_json::json;
use std::path::{Path, PathBuf};

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// Folder of the frames (`<name>.png`).
    pub frames: PathBuf,
    /// The page to look at.
    pub report: PathBuf,
    /// Scores, where there is ground truth.
    pub evaluation: Option<eval::Evaluation>,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// Composes.
///
/// Captures are reconstructed first (into `<output>/scene.asset`, `<output>/object.asset`); the light is swept at the
/// placement unless one is given. Writes `frames/<camera>.png`, `empty/<camera>.png` (the scene alone),
/// `layers/<camera>.exr` on request, `env.exr`, `cameras.json`, `composition.json`, `preview.gif`, `report.html` and
/// `run.json`. Frames that an interrupted run had finished are kept.
///
/// # Errors
/// [`PipelineError`]; a transform that mirrors or shears is refused by name.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    let mut run = Run::in_folder("compose", &input.output);
    run.check_output()?;
    for (what, path) in [("scene", Some(&input.scene)), ("ground truth", input.truth.as_ref())] {
        path.map_or(Ok(()), |path| output::refuse_input(&input.output, what, path))?;
    }
    for path in &input.objects {
        output::refuse_input(&input.output, "object", path)?;
    }
    let plan = Plan::new(input, config, context)?;
    context.progress.begin("compose");
    let fingerprint = plan.fingerprint(input, config)?;
    let (frames_folder, report) = (input.output.join("frames"), input.output.join("report.html"));
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        let evaluation =
            evaluate(input, &Context { progress: &crate::Silent, cancel: context.cancel.clone() })?;
        return Ok(Output { frames: frames_folder, report, evaluation, reused: true, record });
    }
    run.describe(fingerprint, plan.inputs_json(input), config, Some(config.seed))?;
    for time in &plan.timings {
        run.add_time(&time.stage, time.seconds, time.reused);
    }
    run.invalidate()?;
    let done = run.resume();
    if !done.is_empty() {
        context.progress.note(&format!("{} files of an interrupted run are kept", done.len()));
    }

    let tracer = run.time("trees", || Tracer::new(&plan.scene.surfels, &TraceConfig::default()))?;
    for warning in plan.placement_warnings(&tracer) {
        run.warn(context, warning);
    }
    let environment = read_light(&plan.environment, &mut run, context)?;
    let sampler = EnvironmentSampler::new(&environment);
    let placed: Vec<PlacedObject<'_>> = plan
        .objects
        .iter()
        .map(|o| PlacedObject { cloud: &o.asset.surfels, world_from_object: o.world_from_object })
        .collect();
    let settings = config.compose_config(source::raster_config(&plan.scene));
    let composer = Composer::new(&plan.scene.surfels, &tracer, &placed, &sampler, settings)?;
    let totals = render(&plan, &composer, config, &done, &mut run, context)?;
    for (stage, seconds) in [
        ("rasterise", totals.raster_s),
        ("order", totals.order_s),
        ("shadow", totals.shadow_s),
        ("write", totals.write_s),
    ] {
        run.add_time(stage, seconds, false);
    }
    // Surfels let a little through everywhere; a twentieth of an object is not an object seen.
    if totals.rendered > 0 && totals.visible_px < (0.05 * totals.object_px).max(1.0) {
        let text = if totals.object_px < 1.0 {
            "no camera sees the object: it is outside every frame".to_owned()
        } else {
            let px = totals.object_px / totals.rendered as f64;
            format!("the object is hidden: it would cover {px:.0} px a frame, behind the scene")
        };
        run.warn(context, text);
    }

    result::write_composition(&plan, input, config, &mut run)?;
    let silent = Context { progress: &crate::Silent, cancel: context.cancel.clone() };
    let evaluation = run.time("eval", || evaluate(input, &silent))?;
    result::write_report(&plan, input, config, evaluation.clone(), &mut run)?;
    run.results(json!({
        "frames": plan.cameras.len(),
        "shadow_rays": totals.shadow_rays,
        "coverage": plan.coverage,
        "object_px": totals.object_px,
        "visible_px": totals.visible_px,
        "scores": evaluation.as_ref().map(|e| &e.sections),
    }));
    let record = run.finish()?;
    context.progress.end(&format!("{} frames in {}", plan.cameras.len(), frames_folder.display()));
    Ok(Output { frames: frames_folder, report, evaluation, reused: false, record })
}

/// Sums over the frames that were rendered.
#[derive(Default)]
struct Totals {
    rendered: usize,
    raster_s: f64,
    order_s: f64,
    shadow_s: f64,
    write_s: f64,
    shadow_rays: u64,
    object_px: f64,
    visible_px: f64,
}

/// The files of one frame.
fn files(output: &Path, name: &str, layers: bool) -> Vec<(PathBuf, String)> {
    let mut files = vec![format!("frames/{name}.png"), format!("empty/{name}.png")];
    if layers {
        files.push(format!("layers/{name}.exr"));
    }
    files.into_iter().map(|relative| (output.join(&relative), relative)).collect()
}

fn render(
    plan: &Plan,
    composer: &Composer<'_>,
    config: &Config,
    done: &[String],
    run: &mut Run,
    context: &Context<'_>,
) -> Result<Totals, PipelineError> {
    let mut totals = Totals::default();
    let output = run.folder().to_owned();
    let start = std::time::Instant::now();
    for (i, camera) in plan.cameras.iter().enumerate() {
        if context.cancel.is_cancelled() {
            let kept = format!("{i} of {} frames are done; the same command continues", plan.cameras.len());
            return Err(PipelineError::Cancelled { kept: Some(kept) });
        }
        let files = files(&output, &camera.name, config.layers);
        if files.iter().all(|(_, relative)| done.contains(relative)) {
            continue;
        }
        let remaining = (totals.rendered > 0).then(|| {
            let each = start.elapsed().as_secs_f64() / totals.rendered as f64;
            std::time::Duration::from_secs_f64(each * (plan.cameras.len() - i) as f64)
        });
        context.progress.update(&Status {
            fraction: Some(i as f64 / plan.cameras.len() as f64),
            message: format!("frame {}", camera.name),
            remaining,
        });
        let frame = composer.frame(camera);
        let writing = std::time::Instant::now();
        write(&frame, &files)?;
        for (path, relative) in &files {
            if !done.contains(relative) {
                run.output(path)?;
            }
        }
        run.keep()?;
        totals.write_s += writing.elapsed().as_secs_f64();
        totals.rendered += 1;
        totals.raster_s += frame.stats.raster_s;
        totals.order_s += frame.stats.order_s;
        totals.shadow_s += frame.stats.shadow_s;
        totals.shadow_rays += frame.stats.shadow_rays;
        totals.object_px += frame.stats.object_px;
        totals.visible_px += frame.stats.visible_px;
    }
    Ok(totals)
}

fn write(frame: &ComposedFrame, files: &[(PathBuf, String)]) -> Result<(), PipelineError> {
    write_png(&files[0].0, &frame.beauty)?;
    write_png(&files[1].0, &frame.empty)?;
    if let Some((path, _)) = files.get(2) {
        write_frame_layers(path, frame)?;
    }
    Ok(())
}

/// Reads a light; samples that are no radiance are repaired and said.
fn read_light(path: &Path, run: &mut Run, context: &Context<'_>) -> Result<EnvironmentMap, PipelineError> {
    let image = comgs_image::read(path)?.color;
    let (map, repaired) = EnvironmentMap::from_image_repaired(&image)
        .map_err(|reason| PipelineError::Light { path: path.to_owned(), reason })?;
    if !repaired.is_clean() {
        run.warn(context, format!("the light has unusable samples, which were repaired ({repaired})"));
    }
    if map.is_black() {
        run.warn(context, "the light is black: there is no shadow".to_owned());
    }
    Ok(map)
}

fn evaluate(input: &Input, context: &Context<'_>) -> Result<Option<eval::Evaluation>, PipelineError> {
    let Some(truth) = &input.truth else { return Ok(None) };
    let json = Some(input.output.join("scores.json"));
    let evaluation = eval::run(
        &eval::Input { subject: input.output.clone(), against: truth.clone(), relit: None, json },
        context,
    )?;
    Ok(Some(evaluation))
}

/// The light stage's configuration for an object's surroundings.
fn light_config(centre: glam::DVec3, radius: f64) -> light::Config {
    light::Config { near: 0.5 * radius, ..light::Config::at(centre) }
}

/// Reads cameras, refusing an empty list.
fn cameras(path: &Path) -> Result<Vec<comgs_geom::Camera>, PipelineError> {
    frames::read_cameras(path)
}
