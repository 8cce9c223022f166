//! `demo`: two small captures become composed frames, with every stage on the way.

use crate::stages::editing::Settings;
use crate::stages::{compose, decompose, eval, place, reconstruct, render_composition};
use crate::{Context, PipelineError, Run, RunRecord, source};
use comgs_geom::Similarity;
use comgs_image::Image;
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
    /// The composition, the object in the light of its capture.
    pub compose: compose::Output,
    /// The same frames with the object in the scene's light.
    pub relit: render_composition::Output,
    /// One view four times: the empty scene, pasted, relit, ground truth.
    pub hero: PathBuf,
    /// Scores of the object's reconstruction.
    pub object: eval::Evaluation,
    /// Scores of the scene's reconstruction.
    pub scene: eval::Evaluation,
    /// Scores of the relit frames.
    pub relit_scores: eval::Evaluation,
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

/// Runs everything: reconstruct both, decompose the object, place, light, compose, relight, score.
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

    // Of the same name, because transforms name their objects.
    let with_material = input.output.join("material").join(format!("{}.asset", source::name_of(&object)));
    let decompose_input =
        decompose::Input { asset: object, capture: object_capture, output: Some(with_material.clone()) };
    let mut decompose_config = decompose::Config::preset(config.quality);
    decompose_config.decompose.seed = config.seed;
    decompose_config.resume = reconstruct::Resume::IfThere;
    let decomposed = decompose::run(&decompose_input, &decompose_config, context)?;
    run.add_time("decompose", decomposed.record.seconds, decomposed.reused);

    let transform = composition.join("transform.json");
    let truth = TransformFile::read(&transform)?;
    let (_, truth) = truth.objects[0];
    let placed = run.time("place", || place_like(&truth, &scene, &with_material, input, context))?;
    let placement_error = placed.translation.distance(truth.translation);
    context.progress.note(&format!("place lands {placement_error:.3} scene units from the true position"));

    let compose_input = compose::Input {
        scene,
        objects: vec![with_material],
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

    let relit_input = render_composition::Input {
        composition: input.output.join("composed").join("composition.json"),
        cameras: None,
        photos: None,
        cache: Some(input.output.join("cache")),
        output: input.output.join("relit"),
    };
    let settings = Settings { near_field: true, bounce: true, seed: config.seed, ..Settings::default() };
    let relit_config =
        render_composition::Config { settings, layers: true, ..render_composition::Config::default() };
    let relit = run.time("relight", || render_composition::run(&relit_input, &relit_config, context))?;
    let relit_scores = run.time("score relit", || score(&relit_input.output, &composition))?;

    let hero = run.time("hero", || write_hero(&composed, &composition, &input.output))?;

    run.describe(String::new(), json!({"assets": input.assets}), config, Some(config.seed))?;
    run.invalidate()?;
    run.output(&hero)?;
    run.results(json!({
        "object": object_scores.sections,
        "scene": scene_scores.sections,
        "composed": composed.evaluation.as_ref().map(|e| &e.sections),
        "relit": relit_scores.sections,
        "placement_error": placement_error,
    }));
    let record = run.finish()?;
    Ok(Output {
        compose: composed,
        relit,
        relit_scores,
        hero,
        object: object_scores,
        scene: scene_scores,
        placement_error,
        record,
    })
}

/// Pixels between the pictures of the hero.
const HERO_GAP: usize = 4;

/// Writes `hero.png`: one view as the empty scene, pasted, relit, and ground truth, side by side.
fn write_hero(composed: &compose::Output, truth: &Path, output: &Path) -> Result<PathBuf, PipelineError> {
    let name =
        best_view(composed).ok_or_else(|| PipelineError::input("composition", "a scored view", "none"))?;
    let file = format!("{name}.png");
    let pictures =
        ["composed/empty", "composed/frames", "relit/frames"].map(|folder| output.join(folder).join(&file));
    let mut images = Vec::new();
    for path in pictures.into_iter().chain([truth.join("images").join(&file)]) {
        images.push(comgs_image::read(&path)?.color);
    }
    let hero = output.join("hero.png");
    comgs_image::write_png(&hero, &side_by_side(&images, HERO_GAP))?;
    Ok(hero)
}

/// The view that gains most over the empty scene inside the true shadow: the shadow is what the picture is to show. The
/// first view where nothing is scored there.
fn best_view(composed: &compose::Output) -> Option<String> {
    let evaluation = composed.evaluation.as_ref()?;
    let scores = |section: &str| -> Vec<(String, Option<f64>)> {
        let Some(table) = evaluation.section(section).map(|s| &s.table) else { return Vec::new() };
        let column = table.columns.iter().position(|c| c.key == "shadow.psnr_db");
        table.rows.iter().map(|(name, row)| (name.clone(), column.and_then(|c| row[c]))).collect()
    };
    let empty = scores("empty");
    let gain = |(name, score): &(String, Option<f64>)| {
        let before = empty.iter().find(|(other, _)| other == name).and_then(|(_, score)| *score);
        score.zip(before).map_or(f64::NEG_INFINITY, |(after, before)| after - before)
    };
    let views = scores("composed");
    let best = views.iter().reduce(|best, next| if gain(next) > gain(best) { next } else { best });
    best.map(|(name, _)| name.clone())
}

/// Pictures of three channels in a row, brought to the first one's size, white between them.
fn side_by_side(images: &[Image], gap: usize) -> Image {
    let Some(first) = images.first() else { return Image::zeros(0, 0, 3) };
    let (width, height) = (first.width, first.height);
    let mut strip = Image::filled(images.len() * (width + gap) - gap, height, 3, 1.0);
    for (i, image) in images.iter().enumerate() {
        let resized = ((image.width, image.height) != (width, height)).then(|| image.resized(width, height));
        let image = resized.as_ref().unwrap_or(image);
        for y in 0..height {
            for x in 0..width {
                strip.pixel_mut(i * (width + gap) + x, y).copy_from_slice(image.pixel(x, y));
            }
        }
    }
    strip
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: pictures stand in order, of one height, with white between them.
    #[test]
    fn pictures_stand_side_by_side() {
        let images = [Image::filled(4, 3, 3, 0.1), Image::filled(4, 3, 3, 0.2), Image::filled(8, 6, 3, 0.3)];
        let strip = side_by_side(&images, 2);
        assert_eq!((strip.width, strip.height, strip.channels), (16, 3, 3));
        for (x, value) in [(0, 0.1), (4, 1.0), (6, 0.2), (11, 1.0), (12, 0.3), (15, 0.3)] {
            assert!((strip.pixel(x, 1)[0] - value).abs() < 1e-6, "column {x}");
        }
    }
}
