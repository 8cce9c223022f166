//! Everything a composition needs, resolved: assets, transforms, cameras, light.

use crate::record::StageTime;
use crate::source::Source;
use crate::stages::{editing, light, reconstruct};
use crate::{Context, Fingerprint, PipelineError, source};
use comgs_compose::{ComposeConfig, Denoise, Ordering, ShadowConfig, objects};
use comgs_geom::{Camera, Similarity};
use comgs_inverse::Kind;
use comgs_raster::RasterConfig;
use comgs_scene::{Asset, AssetKind, TransformFile};
use comgs_trace::Tracer;
use glam::DVec3;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Capture, asset or PLY of the scene.
    pub scene: PathBuf,
    /// Captures, assets or PLYs of the objects; the same one may be named several times.
    pub objects: Vec<PathBuf>,
    /// `transform.json` with a similarity for every object.
    pub transform: PathBuf,
    /// Any camera file or capture.
    pub cameras: PathBuf,
    /// Environment map; swept at the placement when absent.
    pub light: Option<PathBuf>,
    /// Ground truth to score the frames against.
    pub truth: Option<PathBuf>,
    /// Output folder.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// One multilayer EXR a frame.
    pub layers: bool,
    /// Whether the objects shadow the scene.
    pub shadow: bool,
    /// Light samples a pixel for the shadow.
    pub shadow_rays: u32,
    /// Whether the shadow is smoothed.
    pub denoise: bool,
    /// Whether scene and object are ordered by splitting the scene (exact) or by a depth test (fast).
    pub split_order: bool,
    /// Seed of the shadow's sampling.
    pub seed: u64,
    /// How captures are reconstructed. Not part of the result, which depends on the assets.
    #[serde(skip)]
    pub reconstruct: reconstruct::Config,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            layers: false,
            shadow: true,
            shadow_rays: 128,
            denoise: true,
            split_order: true,
            seed: 0,
            reconstruct: reconstruct::Config::default(),
        }
    }
}

impl Config {
    /// The composer's knobs.
    pub(super) fn compose_config(&self, raster: RasterConfig) -> ComposeConfig {
        let denoise = if self.denoise { Denoise::default() } else { Denoise::Off };
        let shadow = ShadowConfig {
            rays: self.shadow_rays.max(1),
            seed: self.seed,
            denoise,
            ..ShadowConfig::default()
        };
        ComposeConfig {
            raster,
            ordering: if self.split_order { Ordering::Split } else { Ordering::DepthTest },
            shadow: self.shadow.then_some(shadow),
            ..ComposeConfig::default()
        }
    }
}

/// A loaded object and its place.
pub(super) struct PlannedObject {
    pub name: String,
    pub path: PathBuf,
    pub asset: Asset,
    pub world_from_object: Similarity,
}

/// Everything resolved.
pub(super) struct Plan {
    pub scene: Asset,
    pub scene_path: PathBuf,
    pub objects: Vec<PlannedObject>,
    pub cameras: Vec<Camera>,
    pub environment: PathBuf,
    /// Where the light was swept, when it was swept here.
    pub light_at: Option<DVec3>,
    /// Pictures of the light, when it was swept here.
    pub light_pictures: Option<light::Pictures>,
    /// Share of the sphere around the placement that the scene covers, when it was swept here.
    pub coverage: Option<f64>,
    pub timings: Vec<StageTime>,
}

impl Plan {
    pub(super) fn new(input: &Input, config: &Config, context: &Context<'_>) -> Result<Self, PipelineError> {
        // What is cheap to get wrong is read before anything is reconstructed.
        let transforms = TransformFile::read(&input.transform)?;
        let cameras = super::cameras(&input.cameras)?;
        if input.objects.is_empty() {
            return Err(PipelineError::input("--object", "at least one object", "none"));
        }
        let names: Vec<String> = input.objects.iter().map(|p| source::name_of(p)).collect();
        let placements = assign(&names, &transforms, &input.transform)?;
        if let Some(note) = unused(&transforms, &placements, &input.transform) {
            context.progress.note(&note);
        }

        let mut timings = Vec::new();
        let scene_path = resolve(&input.scene, "scene", Kind::Scene, input, config, context, &mut timings)?;
        let scene = source::load_surfels(&scene_path, AssetKind::Scene)?;
        let mut objects = Vec::new();
        for (i, (path, (name, world_from_object))) in input.objects.iter().zip(placements).enumerate() {
            // One reconstruction for an object that stands in several places.
            let first = input.objects.iter().position(|p| p == path).unwrap_or(i);
            let folder = if first == 0 { "object".to_owned() } else { format!("object{}", first + 1) };
            let path = resolve(path, &folder, Kind::Object, input, config, context, &mut timings)?;
            let asset = source::load_surfels(&path, AssetKind::Object)?;
            objects.push(PlannedObject { name, path, asset, world_from_object });
        }
        let mut plan = Self {
            scene,
            scene_path,
            objects,
            cameras,
            environment: PathBuf::new(),
            light_at: None,
            light_pictures: None,
            coverage: None,
            timings,
        };
        plan.find_light(input, context)?;
        Ok(plan)
    }

    /// The given light, or a sweep around the middle of the objects.
    fn find_light(&mut self, input: &Input, context: &Context<'_>) -> Result<(), PipelineError> {
        if let Some(path) = &input.light {
            self.environment = path.clone();
            return Ok(());
        }
        let (mut centre, mut radius) = (DVec3::ZERO, 0.0);
        for object in &self.objects {
            if let Some((c, r)) = objects::bounding_sphere(&object.asset.surfels) {
                centre += object.world_from_object.transform_point(c.as_dvec3()) / self.objects.len() as f64;
                radius += object.world_from_object.scale * f64::from(r) / self.objects.len() as f64;
            }
        }
        let light_input = light::Input {
            scene: self.scene_path.clone(),
            output: input.output.join("env.exr"),
            report: None,
        };
        let output = light::run(&light_input, &super::light_config(centre, radius), context)?;
        for t in &output.record.timings {
            let stage = format!("light: {}", t.stage);
            self.timings.push(StageTime { stage, seconds: t.seconds, reused: output.reused });
        }
        self.environment = output.environment;
        self.light_at = Some(centre);
        self.light_pictures = Some(output.pictures);
        self.coverage = Some(output.coverage);
        Ok(())
    }

    pub(super) fn fingerprint(&self, input: &Input, config: &Config) -> Result<String, PipelineError> {
        let mut fingerprint = Fingerprint::new("compose");
        fingerprint.surfels("scene", &self.scene_path)?;
        for object in &self.objects {
            fingerprint.surfels(&object.name, &object.path)?;
            fingerprint.config("transform", &object.world_from_object)?;
        }
        fingerprint.config("cameras", &self.cameras)?;
        fingerprint.path("light", &self.environment)?;
        fingerprint.config("config", config)?;
        if let Some(truth) = &input.truth {
            fingerprint.path("truth", truth)?;
        }
        Ok(fingerprint.finish())
    }

    pub(super) fn inputs_json(&self, input: &Input) -> Value {
        json!({
            "scene": input.scene,
            "objects": input.objects,
            "transform": input.transform,
            "cameras": input.cameras,
            "light": input.light,
            "truth": input.truth,
        })
    }

    /// What is odd about the placements (hard case 33).
    pub(super) fn placement_warnings(&self, scene: &Tracer) -> Vec<String> {
        let placed = self.objects.iter().map(|o| (o.name.as_str(), &o.asset, o.world_from_object));
        editing::placement_warnings(&self.scene, scene, placed, self.coverage)
    }
}

/// A similarity for every object: by name, or by order where there are as many as objects.
fn assign(
    names: &[String],
    transforms: &TransformFile,
    path: &Path,
) -> Result<Vec<(String, Similarity)>, PipelineError> {
    let unique = |name: &String| names.iter().filter(|n| *n == name).count() == 1;
    let by_name: Option<Vec<_>> = names
        .iter()
        .map(|name| transforms.get(Some(name)).filter(|_| unique(name)).map(|s| (name.clone(), *s)))
        .collect();
    if let Some(found) = by_name {
        return Ok(found);
    }
    if transforms.objects.len() == names.len() {
        return Ok(transforms.objects.clone());
    }
    let listed: Vec<&str> = transforms.objects.iter().map(|(n, _)| n.as_str()).collect();
    Err(PipelineError::input(
        path.display().to_string(),
        format!("a transform for each of {} object(s): {}", names.len(), names.join(", ")),
        format!("{} for {}", listed.len(), listed.join(", ")),
    ))
}

/// What to say of transforms whose objects are not given: a forgotten `--object`, perhaps.
fn unused(transforms: &TransformFile, placed: &[(String, Similarity)], path: &Path) -> Option<String> {
    let without: Vec<&str> = transforms
        .objects
        .iter()
        .map(|(name, _)| name.as_str())
        .filter(|name| !placed.iter().any(|(placed, _)| placed == name))
        .collect();
    (!without.is_empty()).then(|| {
        format!("{} also places {}, for which no --object is given", path.display(), without.join(", "))
    })
}

/// The asset or PLY at a path; a capture is reconstructed into the output folder.
fn resolve(
    path: &Path,
    folder: &str,
    kind: Kind,
    input: &Input,
    config: &Config,
    context: &Context<'_>,
    timings: &mut Vec<StageTime>,
) -> Result<PathBuf, PipelineError> {
    let Source::Capture(capture) = Source::of(path)? else { return Ok(path.to_owned()) };
    let output = input.output.join(format!("{folder}.asset"));
    // A checkpoint of an interrupted composition is always the right one to go on from.
    let settings = reconstruct::Config {
        kind: Some(kind),
        resume: reconstruct::Resume::IfThere,
        ..config.reconstruct.clone()
    };
    let made = reconstruct::run(&reconstruct::Input { capture, output: output.clone() }, &settings, context)?;
    for t in &made.record.timings {
        let stage = format!("{folder}: {}", t.stage);
        if !timings.iter().any(|known| known.stage == stage) {
            timings.push(StageTime { stage, seconds: t.seconds, reused: made.reused });
        }
    }
    Ok(output)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> Similarity {
        Similarity { translation: DVec3::new(x, 0.0, 0.0), ..Similarity::IDENTITY }
    }

    /// Goal: objects find their transform by name; the same object twice, or a single one under another name, by order;
    /// anything else names both sides.
    #[test]
    fn transforms_find_their_objects() {
        let file = TransformFile { objects: vec![("cow".into(), at(1.0)), ("pot".into(), at(2.0))] };
        let names = |list: &[&str]| list.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        let path = Path::new("t.json");
        let swapped = assign(&names(&["pot", "cow"]), &file, path).unwrap();
        assert_eq!((swapped[0].1, swapped[1].1), (at(2.0), at(1.0)));
        let twice = assign(&names(&["cow", "cow"]), &file, path).unwrap();
        assert_eq!((twice[0].1, twice[1].1), (at(1.0), at(2.0)));
        assert_ne!(twice[0].0, twice[1].0, "names stay unique");
        let single = TransformFile::single("spot", at(3.0));
        assert_eq!(assign(&names(&["object"]), &single, path).unwrap()[0].1, at(3.0));
        let error = assign(&names(&["vase"]), &file, path).unwrap_err().to_string();
        assert!(error.contains("vase") && error.contains("cow, pot"), "{error}");
    }

    /// Goal: a transform whose object is not given is named, and nothing is said where all are used.
    #[test]
    fn transforms_without_objects_are_told() {
        let file = TransformFile { objects: vec![("cow".into(), at(1.0)), ("pot".into(), at(2.0))] };
        let path = Path::new("t.json");
        let note = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|s| (*s).to_owned()).collect();
            unused(&file, &assign(&names, &file, path).unwrap(), path)
        };
        let told = note(&["pot"]).unwrap();
        assert!(told.contains("places cow,") && told.contains("t.json"), "{told}");
        assert_eq!(note(&["pot", "cow"]), None);
        assert_eq!(note(&["cow", "cow"]), None);
    }
}
