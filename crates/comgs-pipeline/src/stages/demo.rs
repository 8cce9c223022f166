//! `demo`: two small captures become composed frames, with every stage on the way.

use crate::stages::{compose, eval, place, reconstruct};
use crate::{Context, PipelineError, Run, RunRecord, source};
use comgs_geom::Similarity;
use comgs_inverse::{Kind, Quality};
use comgs_scene::TransformFile;
use glam::DVec3;
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// The demo's captures: `object/NAME`, `scene/NAME`, `composition/SCENE_with_OBJECT`, one of each.
    pub assets: PathBuf,
    /// Output folder.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Quality of both reconstructions.
    pub quality: Quality,
    /// Light samples a pixel for the shadow.
    pub shadow_rays: u32,
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self { quality: Quality::Draft, shadow_rays: 128, seed: 0 }
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The composition.
    pub compose: compose::Output,
    /// Scores of the object's reconstruction.
    pub object: eval::Evaluation,
    /// Scores of the scene's reconstruction.
    pub scene: eval::Evaluation,
    /// Where `place` put the object, against where the truth has it, in scene units.
    pub placement_error: f64,
    /// The record.
    pub record: RunRecord,
}

/// Finds the captures that ship with the source: `assets/demo` in the working folder or above it, or above the
/// executable.
#[must_use]
pub fn find_assets() -> Option<PathBuf> {
    let starts = [std::env::current_dir().ok(), std::env::current_exe().ok()];
    starts
        .iter()
        .flatten()
        .flat_map(|start| start.ancestors())
        .map(|folder| folder.join("assets").join("demo"))
        .find(|candidate| candidate.join("composition").is_dir())
}

/// Runs everything: reconstruct both, place, light, compose, score.
///
/// The frames are composed with the transform that the ground truth was rendered with, so that they can be scored;
/// `place` is run on the same spot and its distance from that transform reported.
///
/// # Errors
/// [`PipelineError`]; what is finished stays, and the next run goes on from there.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    let mut run = Run::in_folder("demo", &input.output);
    run.check_output()?;
    let (object_capture, scene_capture) = (only(&input.assets, "object")?, only(&input.assets, "scene")?);
    let composition = only(&input.assets, "composition")?;
    let settings = reconstruct::Config {
        quality: config.quality,
        seed: config.seed,
        resume: reconstruct::Resume::IfThere,
        ..reconstruct::Config::default()
    };
    let mut reconstruct = |capture: &Path, kind: Kind| -> Result<PathBuf, PipelineError> {
        let output = input.output.join(format!("{}.asset", source::name_of(capture)));
        let reconstruct_input = reconstruct::Input { capture: capture.to_owned(), output };
        let settings = reconstruct::Config { kind: Some(kind), ..settings.clone() };
        let made = reconstruct::run(&reconstruct_input, &settings, context)?;
        run.add_time(&format!("reconstruct {}", source::name_of(capture)), made.record.seconds, made.reused);
        Ok(made.asset)
    };
    let object = reconstruct(&object_capture, Kind::Object)?;
    let scene = reconstruct(&scene_capture, Kind::Scene)?;

    let score = |asset: &Path, capture: &Path| {
        let against = capture.to_owned();
        eval::run(&eval::Input { subject: asset.to_owned(), against, relit: None, json: None }, context)
    };
    let object_scores = run.time("score object", || score(&object, &object_capture))?;
    let scene_scores = run.time("score scene", || score(&scene, &scene_capture))?;

    let transform = composition.join("transform.json");
    let truth = TransformFile::read(&transform)?;
    let (_, truth) = truth.objects[0];
    let placed = run.time("place", || place_like(&truth, &scene, &object, input, context))?;
    let placement_error = placed.translation.distance(truth.translation);
    context.progress.note(&format!("place lands {placement_error:.3} scene units from the true position"));

    let compose_input = compose::Input {
        scene,
        objects: vec![object],
        cameras: composition.join("cameras.json"),
        light: None,
        truth: Some(composition.clone()),
        output: input.output.join("composed"),
        transform,
    };
    let compose_config = compose::Config {
        layers: true,
        shadow_rays: config.shadow_rays,
        seed: config.seed,
        ..compose::Config::default()
    };
    let composed = run.time("compose", || compose::run(&compose_input, &compose_config, context))?;

    run.describe(String::new(), json!({"assets": input.assets}), config, Some(config.seed))?;
    run.results(json!({
        "object": object_scores.sections,
        "scene": scene_scores.sections,
        "composed": composed.evaluation.as_ref().map(|e| &e.sections),
        "placement_error": placement_error,
    }));
    let record = run.finish()?;
    Ok(Output { compose: composed, object: object_scores, scene: scene_scores, placement_error, record })
}

/// The one folder in `assets/<kind>`.
fn only(assets: &Path, kind: &str) -> Result<PathBuf, PipelineError> {
    let folder = assets.join(kind);
    let entries = std::fs::read_dir(&folder).map_err(|e| PipelineError::io(&folder, e))?;
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| p.is_dir()).collect();
    found.sort();
    match found.as_slice() {
        [one] => Ok(one.clone()),
        other => Err(PipelineError::input(
            folder.display().to_string(),
            "exactly one folder",
            format!("{} folders", other.len()),
        )),
    }
}

/// Runs `place` at the point where the true object's base stands, with its size and yaw.
fn place_like(
    truth: &Similarity,
    scene: &Path,
    object: &Path,
    input: &Input,
    context: &Context<'_>,
) -> Result<Similarity, PipelineError> {
    let asset = source::load_surfels(object, comgs_scene::AssetKind::Object)?;
    let up = DVec3::from_array(asset.record.up);
    let extent = comgs_compose::objects::extent(&asset.surfels, up)
        .ok_or_else(|| PipelineError::input("object", "visible surfels", "none"))?;
    let base = truth.transform_point(extent.upright_from_object.inverse() * extent.base());
    let turned = truth.rotation * DVec3::X;
    let place_config = place::Config {
        at: place::At::Point(base.to_array()),
        size: Some(extent.largest() * truth.scale),
        yaw_deg: turned.y.atan2(turned.x).to_degrees(),
    };
    let place_input = place::Input {
        scene: scene.to_owned(),
        object: object.to_owned(),
        cameras: None,
        output: input.output.join("placed.json"),
    };
    Ok(place::run(&place_input, &place_config, context)?.world_from_object)
}
