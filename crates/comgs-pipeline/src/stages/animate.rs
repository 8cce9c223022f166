//! `animate`: a composition whose objects move along a path of poses.

use crate::stages::editing::{Composition, OwnLight, Settings, Shadow, bake};
use crate::stages::frames::write_gif;
use crate::stages::render_composition::{Ground, Known, Renderer, Seen};
use crate::{Context, PipelineError, Run, RunRecord, Status};
use comgs_geom::Similarity;
use comgs_image::{Image, write_png};
use comgs_light::EnvironmentSampler;
use comgs_scene::TransformFile;
use comgs_trace::{TraceConfig, Tracer};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// `composition.json`.
    pub composition: PathBuf,
    /// Poses: files of transforms (as `transform.json`), one a step, in the order of their names.
    pub path: PathBuf,
    /// Cameras instead of the composition's: one for all steps, or one a step.
    pub cameras: Option<PathBuf>,
    /// Photos of the scene whose defocus and noise frames are to have.
    pub photos: Option<PathBuf>,
    /// Folder of occlusion fields.
    pub cache: Option<PathBuf>,
    /// Output folder.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Config {
    /// What is simulated and how finely.
    pub settings: Settings,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// Moving picture.
    pub preview: PathBuf,
    /// Mean seconds of an edit: from new poses to a shadow that can be read.
    pub edit_s: f64,
    /// The record.
    pub record: RunRecord,
}

/// Milliseconds a step in the preview.
const STEP_MS: u32 = 80;

/// Renders every step of a path: `frames/<step>.png`, `preview.gif`. Nothing is baked anew between the steps.
///
/// # Errors
/// [`PipelineError`]: a pose that is no similarity, a path without poses, objects that no pose names.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("animate");
    let mut run = Run::in_folder("animate", &input.output);
    run.check_output()?;
    let settings = &config.settings;
    let mut composition =
        Composition::load(&input.composition, input.cameras.as_deref(), |text| run.warn(context, text))?;
    composition.match_photos(input.photos.as_deref(), context)?;
    let poses = poses(input, &composition)?;
    let cameras = std::mem::take(&mut composition.cameras);
    if cameras.len() != 1 && cameras.len() != poses.len() {
        let expected = format!("one camera, or one for each of {} poses", poses.len());
        return Err(PipelineError::input("the cameras", expected, cameras.len().to_string()));
    }
    let mut fingerprint = composition.fingerprint("animate")?;
    fingerprint.config("poses", &poses)?;
    fingerprint.config("cameras", &cameras)?;
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    let preview = input.output.join("preview.gif");
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        let edit_s = record.results["edit_ms"].as_f64().unwrap_or(0.0) / 1e3;
        return Ok(Output { preview, edit_s, record });
    }
    run.describe(
        fingerprint,
        json!({"composition": input.composition, "path": input.path, "cameras": input.cameras}),
        config,
        Some(settings.seed),
    )?;
    run.invalidate()?;
    let scene_tracer =
        run.time("trees", || Tracer::new(&composition.scene.surfels, &TraceConfig::default()))?;
    let baked = match settings.shadow {
        Shadow::Auto => {
            Some(run.time("occlusion", || bake(&composition, settings, input.cache.as_deref(), context))?)
        }
        _ => None,
    };
    let own = run.time("self-occlusion", || OwnLight::new(&composition, settings))?;
    let sampler = EnvironmentSampler::new(&composition.map);
    let (mut seen, mut near) = (None, None);
    let mut pictures: Vec<Image> = Vec::new();
    let (mut edit_s, mut frame_s) = (0.0, 0.0);
    for (i, pose) in poses.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(i as f64 / poses.len() as f64),
            message: format!("step {} of {}", i + 1, poses.len()),
            remaining: None,
        });
        for (object, place) in composition.objects.iter_mut().zip(pose) {
            object.world_from_object = *place;
        }
        let camera = &cameras[i.min(cameras.len() - 1)];
        let start = Instant::now();
        let ground = Ground::with_near(&composition, &scene_tracer, &sampler, settings, near.take())?;
        let mut spent = start.elapsed().as_secs_f64();
        // What one camera sees stays through the whole path.
        if cameras.len() > 1 || seen.is_none() {
            let all = Seen::new(&ground.composer, std::slice::from_ref(camera), Vec::new(), context)?;
            seen = Some(all);
        }
        let Some(seen) = &seen else { continue };
        let start = Instant::now();
        let mut renderer =
            Renderer::new(&composition, &ground, baked.as_ref(), own.as_ref(), &seen.cloud, settings)?;
        renderer.step = i as u64;
        spent += start.elapsed().as_secs_f64();
        edit_s += spent;
        let start = Instant::now();
        let frame = match seen.frame(0) {
            Some(scene) => renderer.frame_over(scene, Known::default()),
            None => renderer.frame(camera),
        };
        frame_s += start.elapsed().as_secs_f64();
        let path = input.output.join("frames").join(format!("{i:05}.png"));
        write_png(&path, &frame.beauty)?;
        run.output(&path)?;
        pictures.push(frame.beauty);
        drop(renderer);
        near = ground.near.map(|(near, _)| near);
    }
    write_gif(&preview, &pictures.iter().collect::<Vec<_>>(), STEP_MS)?;
    run.output(&preview)?;
    let n = poses.len() as f64;
    run.add_time("edit", edit_s, false);
    run.add_time("frames", frame_s, false);
    run.results(json!({"steps": poses.len(), "edit_ms": 1e3 * edit_s / n, "frame_ms": 1e3 * frame_s / n}));
    let record = run.finish()?;
    context.progress.end(&format!(
        "{} steps, {:.0} ms an edit, {:.0} ms a frame",
        poses.len(),
        1e3 * edit_s / n,
        1e3 * frame_s / n
    ));
    Ok(Output { preview, edit_s: edit_s / n, record })
}

/// The poses of all objects, step by step; an object that a step does not name stays where the composition has it.
fn poses(input: &Input, composition: &Composition) -> Result<Vec<Vec<Similarity>>, PipelineError> {
    let folder = &input.path;
    let mut files: Vec<PathBuf> = if folder.is_dir() {
        let entries = std::fs::read_dir(folder).map_err(|e| PipelineError::io(folder, e))?;
        entries.flatten().map(|e| e.path()).filter(|p| p.extension().is_some_and(|e| e == "json")).collect()
    } else {
        vec![folder.clone()]
    };
    files.sort();
    if files.is_empty() {
        return Err(PipelineError::input(
            folder.display().to_string(),
            "files of transforms (*.json)",
            "none",
        ));
    }
    let mut steps = Vec::new();
    for file in &files {
        let transforms = TransformFile::read(file)?;
        let single = transforms.objects.len() == 1 && composition.objects.len() == 1;
        let named = |name: &str| transforms.objects.iter().find(|(n, _)| n == name).map(|(_, s)| *s);
        let known = transforms.objects.iter().any(|(n, _)| composition.objects.iter().any(|o| o.name == *n));
        if !known && !single {
            let names: Vec<&str> = composition.objects.iter().map(|o| o.name.as_str()).collect();
            let got: Vec<&str> = transforms.objects.iter().map(|(n, _)| n.as_str()).collect();
            return Err(PipelineError::input(
                file.display().to_string(),
                format!("a transform for one of {}", names.join(", ")),
                got.join(", "),
            ));
        }
        let of = |o: &crate::stages::editing::Placed| {
            if single { transforms.objects[0].1 } else { named(&o.name).unwrap_or(o.world_from_object) }
        };
        steps.push(composition.objects.iter().map(of).collect());
    }
    Ok(steps)
}
