//! The stage: reading, rendering, writing, recording.

use super::{Ground, Known, Renderer, Seen, cache_json};
use crate::stages::editing::{Composition, OwnLight, Settings, Shadow, bake};
use crate::stages::plan::{Made, Plan};
use crate::{Context, PipelineError, Run, RunRecord, Status, output};
use comgs_compose::{ComposedFrame, layers::write_frame_layers};
use comgs_image::write_png;
use comgs_light::EnvironmentSampler;
use comgs_scene::write_cameras;
use comgs_trace::{TraceConfig, Tracer};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Share of the sphere that the scene must cover around the light's centre for a near field to make sense.
const LEAST_SEEN: f32 = 0.05;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// `composition.json`.
    pub composition: PathBuf,
    /// Cameras instead of the composition's.
    pub cameras: Option<PathBuf>,
    /// Photos of the scene whose defocus and noise frames are to have: any capture.
    pub photos: Option<PathBuf>,
    /// Folder of occlusion fields (made by `comgs shadow`); what is missing there is baked and kept.
    pub cache: Option<PathBuf>,
    /// Output folder.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Config {
    /// What is simulated and how finely.
    pub settings: Settings,
    /// One multilayer EXR a frame.
    pub layers: bool,
    /// The plan that the settings come from; recorded, so that estimate and outcome stand beside each other.
    #[serde(skip)]
    pub plan: Option<Plan>,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// Folder of the frames.
    pub frames: PathBuf,
    /// Mean seconds of a frame.
    pub frame_s: f64,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// Renders a composition: `frames/<camera>.png`, `empty/<camera>.png`, with `layers` also `layers/<camera>.exr`.
///
/// # Errors
/// [`PipelineError`]: a composition that cannot be read, lamps that are none, objects that cast no shadow.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    run_planned(input, config, None, context)
}

/// [`run`], with what the plan has made of the same composition and cameras.
///
/// # Errors
/// Those of [`run`].
pub fn run_planned(
    input: &Input,
    config: &Config,
    made: Option<Made>,
    context: &Context<'_>,
) -> Result<Output, PipelineError> {
    context.progress.begin("render the composition");
    let mut run = Run::in_folder("render", &input.output);
    run.check_output()?;
    if let Some(cache) = &input.cache {
        output::check_folder(cache)?;
    }
    let settings = &config.settings;
    let start = Instant::now();
    let (composition, made, load_s) = match made {
        Some(Made { composition, scene_tracer, scenes, read_s, warnings }) => {
            warnings.into_iter().for_each(|text| run.warn(context, text));
            (composition, Some((scene_tracer, scenes, read_s.1)), read_s.0)
        }
        None => {
            let warn = |text| run.warn(context, text);
            let mut read = Composition::load(&input.composition, input.cameras.as_deref(), warn)?;
            read.match_photos(input.photos.as_deref(), context)?;
            (read, None, start.elapsed().as_secs_f64())
        }
    };
    let mut fingerprint = composition.fingerprint("render")?;
    fingerprint.config("cameras", &composition.cameras)?;
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    let frames_folder = input.output.join("frames");
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        let frame_s = record.results["frame_ms"].as_f64().unwrap_or(0.0) / 1e3;
        return Ok(Output { frames: frames_folder, frame_s, reused: true, record });
    }
    let inputs = json!({"composition": input.composition, "cameras": input.cameras, "cache": input.cache,
        "photos": input.photos});
    run.describe(fingerprint, inputs, config, Some(settings.seed))?;
    run.invalidate()?;

    run.add_time("read", load_s, false);
    let (scene_tracer, scenes) = match made {
        Some((tracer, scenes, seconds)) => {
            run.add_time("trees", seconds, false);
            (tracer, scenes)
        }
        None => {
            let build = || Tracer::new(&composition.scene.surfels, &TraceConfig::default());
            (run.time("trees", build)?, Vec::new())
        }
    };
    for warning in composition.placement_warnings(&scene_tracer) {
        run.warn(context, warning);
    }
    if let Some(shortfall) = config.plan.as_ref().and_then(|p| p.shortfall.clone()) {
        run.warn(context, shortfall);
    }
    let shadow = if composition.wants_shadow() { settings.shadow } else { Shadow::None };
    let baked = match shadow {
        Shadow::Auto => {
            Some(run.time("occlusion", || bake(&composition, settings, input.cache.as_deref(), context))?)
        }
        _ => None,
    };
    let sampler = EnvironmentSampler::new(&composition.map);
    let ground = Ground::new(&composition, &scene_tracer, &sampler, settings)?;
    let start = Instant::now();
    let mut seen = match shadow {
        Shadow::Auto | Shadow::Probes => Seen::new(&ground.composer, &composition.cameras, scenes, context)?,
        _ => Seen::default(),
    };
    let receivers_s = start.elapsed().as_secs_f64();
    let own = run.time("self-occlusion", || OwnLight::new(&composition, settings))?;
    let renderer = Renderer::new(&composition, &ground, baked.as_ref(), own.as_ref(), &seen.cloud, settings)?;
    let p = renderer.prepared;
    for (stage, seconds) in [
        ("light", p.light_s),
        ("merge", p.merge_s),
        ("receivers", receivers_s),
        ("scene probes", p.probes_s),
        ("shadow cache", p.cache_s),
        ("bounce", p.bounce_s),
        ("prepare relighting", p.relight_s),
    ] {
        run.add_time(stage, seconds, false);
    }
    if ground.near.as_ref().is_some_and(|(near, _)| near.coverage() < LEAST_SEEN) {
        let text = "hardly anything of the scene is seen from where the light was taken (`light_at`): it comes from infinitely \
                    far away, near field or not";
        run.warn(context, text.to_owned());
    }
    if !renderer.is_relit() && settings.relight != crate::stages::editing::Relight::Off {
        let text = "an object has no material: the objects keep the light they were captured under";
        context.progress.note(text);
    }
    let mut totals = Totals::default();
    for (i, camera) in composition.cameras.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(i as f64 / composition.cameras.len() as f64),
            message: format!("frame {}", camera.name),
            remaining: None,
        });
        let start = Instant::now();
        let frame = match seen.take(i) {
            Some(scene) => renderer.frame_over(&scene, Known::default()),
            None => renderer.frame(camera),
        };
        totals.add(&frame, start.elapsed().as_secs_f64());
        let start = Instant::now();
        let file = |folder: &str, extension: &str| {
            input.output.join(folder).join(format!("{}.{extension}", camera.name))
        };
        let mut files = vec![file("frames", "png"), file("empty", "png")];
        write_png(&files[0], &frame.beauty)?;
        write_png(&files[1], &frame.empty)?;
        if config.layers {
            files.push(file("layers", "exr"));
            write_frame_layers(&files[2], &frame)?;
        }
        for file in &files {
            run.output(file)?;
        }
        totals.write_s += start.elapsed().as_secs_f64();
    }
    let list = input.output.join("cameras.json");
    write_cameras(&list, &composition.cameras)?;
    run.output(&list)?;
    if totals.object_px > 0.0 && totals.visible_px < (0.05 * totals.object_px).max(1.0) {
        run.warn(context, "the objects are hidden behind the scene in every frame".to_owned());
    } else if totals.object_px < 1.0 {
        run.warn(context, "no camera sees the objects".to_owned());
    }
    let n = totals.frames.max(1) as f64;
    for (stage, seconds) in [
        ("rasterise", totals.raster_s),
        ("order", totals.order_s),
        ("relight", totals.relight_s),
        ("shadow", totals.shadow_s),
        ("write", totals.write_s),
    ] {
        run.add_time(stage, seconds, false);
    }
    let cache = renderer.cache();
    let spent = run.timings().iter().map(|t| t.seconds).sum::<f64>();
    let planned = config.plan.as_ref().map(|plan| {
        json!({
            "lines": plan.lines,
            "quality": plan.settings.quality,
            "qualities": plan.qualities,
            "estimated_s": plan.seconds,
            "outcome_s": spent,
            "read_s": plan.read_s,
            "plan_s": plan.plan_s,
            "shortfall": plan.shortfall,
        })
    });
    run.results(json!({
        "plan": planned,
        "frames": totals.frames,
        "frame_ms": 1e3 * totals.seconds / n,
        "raster_ms": 1e3 * totals.raster_s / n,
        "order_ms": 1e3 * totals.order_s / n,
        "relight_ms": 1e3 * totals.relight_s / n,
        "shadow_ms": 1e3 * totals.shadow_s / n,
        "missed_pixels": totals.missed,
        "relit": renderer.is_relit(),
        "own_light_bytes": own.as_ref().map_or(0, OwnLight::bytes),
        "shadow": renderer.shadow(),
        "look": composition.look,
        "light_directions": ground.light.directions.len(),
        "strong_lights": ground.light.beams.len(),
        "strong_share": ground.light.strong_share(),
        "occlusion_bytes": baked.as_ref().map_or(0, |b| b.bytes()),
        "occlusion_read": baked.as_ref().map_or(0, |b| b.read),
        "receivers": seen.cloud.len(),
        "cache": cache_json(&settings.cache()),
        "cells": cache.map_or(0, |c| c.cells),
        "cache_evaluated": cache.map_or(0, |c| c.evaluated),
        "cache_bytes": cache.map_or(0, |c| c.bytes),
    }));
    let record = run.finish()?;
    let text = format!("{} frames, {:.0} ms each", totals.frames, 1e3 * totals.seconds / n);
    context.progress.end(&text);
    Ok(Output { frames: frames_folder, frame_s: totals.seconds / n, reused: false, record })
}

#[derive(Default)]
struct Totals {
    frames: usize,
    seconds: f64,
    raster_s: f64,
    order_s: f64,
    relight_s: f64,
    shadow_s: f64,
    write_s: f64,
    missed: usize,
    object_px: f64,
    visible_px: f64,
}

impl Totals {
    fn add(&mut self, frame: &ComposedFrame, seconds: f64) {
        let s = &frame.stats;
        self.frames += 1;
        self.seconds += seconds;
        self.raster_s += s.raster_s;
        self.order_s += s.order_s;
        self.relight_s += s.relight_s;
        self.shadow_s += s.shadow_s;
        self.missed += s.shadow_missed;
        self.object_px += s.object_px;
        self.visible_px += s.visible_px;
    }
}
