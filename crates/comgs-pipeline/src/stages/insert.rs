//! `insert`: an object into one photo, under a light that the photo, a reference or a file tells of.

mod fill;
mod guided;
mod outputs;
mod place;

use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, Status, source};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_insert::light::LightMap;
use comgs_insert::object::Object;
use comgs_insert::optimise::{Curves, Losses};
use comgs_insert::panorama::{GroundMeter, Partial, project, surroundings};
use comgs_insert::render::{Samples, render};
use comgs_insert::session::{self, LightKind, TransportConfig};
use comgs_insert::tone::{Response, Tone};
use comgs_insert::{InsertError, Settings};
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_scene::mesh::Up;
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

pub use fill::Filled;
pub(crate) use fill::completer;
pub use guided::MaterialChoice;
pub(crate) use guided::read_bundle;
pub use place::{At, CameraFrom, GroundFrom};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// The photo.
    pub image: PathBuf,
    /// The object: a mesh (`.glb`, `.gltf`, `.obj`) or a relightable asset.
    pub object: PathBuf,
    /// Camera file, for [`CameraFrom::File`].
    pub camera: Option<PathBuf>,
    /// The composite to match, for [`GuidedBy::Reference`].
    pub reference: Option<PathBuf>,
    /// Environment map. For [`GuidedBy::None`] the light (even light of the photo's mean when absent); beside a guidance that
    /// looks at the composite it stays as it is, and tone and material alone are optimised.
    pub light: Option<PathBuf>,
    /// Folder of the guidance bundle, for [`GuidedBy::Lds`].
    pub model: Option<PathBuf>,
    /// Output folder.
    pub output: PathBuf,
}

/// What says how it should look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GuidedBy {
    /// The photo's own pixels, completed to a panorama, to which the light is fitted.
    Panorama,
    /// A composite that is given.
    Reference,
    /// Two denoisers (score distillation).
    Lds,
    /// Nothing: the light is taken as it is.
    None,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Where the field of view comes from.
    pub camera: CameraFrom,
    /// Where the ground comes from.
    pub ground: GroundFrom,
    /// Where the object stands.
    pub at: At,
    /// Factor on the object's size; what is taken when absent is said.
    pub scale: Option<f64>,
    /// Turn about the ground's normal in degrees, counter-clockwise from above.
    pub yaw_deg: f64,
    /// Which axis of an OBJ points up.
    pub obj_z_up: bool,
    /// What guides.
    pub guidance: GuidedBy,
    /// What the personalised model of `Lds` is told, one of the bundle's prompts; its own when absent.
    pub prompt: Option<String>,
    /// What of the object's material is optimised, where the guidance looks at the composite.
    pub material: Option<MaterialChoice>,
    /// What fills the sphere around the photo for [`GuidedBy::Panorama`].
    pub fill: Filled,
    /// How light is described.
    pub light: LightKind,
    /// Response of the camera before the learnt correction.
    pub response: Response,
    /// Iterations of the optimisation.
    pub iterations: usize,
    /// Whether the tone curves are optimised, where the guidance looks at the composite.
    pub curves: Curves,
    /// Width in pixels of the picture that is optimised over.
    pub width: usize,
    /// Rows of the map that is optimised.
    pub light_height: usize,
    /// Bytes that the matrix of transport may take.
    pub memory: usize,
    /// Samples of the final picture.
    pub samples: Samples,
    /// Only the preview: the ground as a grid and the object on it.
    pub preview_only: bool,
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            camera: CameraFrom::Photo,
            ground: GroundFrom::Photo { height: HEIGHT },
            at: At::Auto,
            scale: None,
            yaw_deg: 0.0,
            obj_z_up: false,
            guidance: GuidedBy::Panorama,
            prompt: None,
            material: None,
            fill: Filled::Harmonic,
            light: LightKind::Gaussians(LOBES),
            response: Response::Reinhard,
            iterations: Settings::dipir().iterations,
            curves: Curves::Free,
            width: 384,
            light_height: 32,
            memory: TransportConfig::default().memory,
            samples: Samples::default(),
            preview_only: false,
            seed: 0,
        }
    }
}

/// Height of a camera of which nothing is known, metres: a person's eyes.
pub const HEIGHT: f64 = 1.6;

/// Spherical Gaussians by default: with 24 a sun's energy came out 19 % low, with 64 5 % (`tests/optimise.rs` of
/// `comgs-insert`).
pub const LOBES: usize = 64;

/// Photo value above which a photo is taken to be cut off: the inverse of Reinhard's response at it is 9, about the ratio of
/// white to middle grey.
pub const MOST: f32 = 0.9;

/// Rows of the panorama that the photo is projected to and completed at.
const PANORAMA_HEIGHT: usize = 64;

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The composite.
    pub composite: PathBuf,
    /// The folder with everything.
    pub folder: PathBuf,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// What light was found, and how.
pub(crate) struct Found {
    pub light: EnvironmentMap,
    pub tone: Tone,
    pub losses: Vec<Losses>,
    pub partial: Option<Partial>,
    pub material: Option<guided::FoundMaterial>,
}

/// The virtual scene.
pub(crate) struct Scene {
    pub photo: Image,
    /// At the photo's size, above the plane z = 0.
    pub camera: Camera,
    pub object: Object,
    pub facts: place::Facts,
}

/// Inserts the object: `composite.png`, `layers.exr`, `env.exr`, `tone.json`, `tone.svg`, `camera.json`, `scene.gltf`,
/// `preview.png`, `report.html`.
///
/// # Errors
/// [`PipelineError`]: inputs that are not what is needed, an object out of the frame, a matrix that does not fit into memory.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    let what = format!("insert {} into {}", source::name_of(&input.object), source::name_of(&input.image));
    context.progress.begin(&what);
    let mut run = Run::in_folder("insert", &input.output);
    check(input, config)?;
    let fingerprint = fingerprint(input, config)?;
    let composite = input.output.join("composite.png");
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        return Ok(Output { composite, folder: input.output.clone(), reused: true, record });
    }
    run.check_output()?;
    let inputs = json!({
        "image": input.image, "object": input.object, "camera": input.camera,
        "reference": input.reference, "light": input.light, "model": input.model,
    });
    run.describe(fingerprint, inputs, config, Some(config.seed))?;
    let mut scene = run.time("load", || place::scene(input, config))?;
    for remark in &scene.facts.remarks {
        run.warn(context, remark.clone());
    }
    let preview = run.time("preview", || {
        Ok::<_, PipelineError>(comgs_insert::preview::preview(&scene.photo, &scene.camera, &scene.object))
    })?;
    if config.preview_only {
        run.invalidate()?;
        let path = input.output.join("preview.png");
        comgs_image::write_png(&path, &preview)?;
        run.output(&path)?;
        run.results(json!({"scene": scene.facts}));
        let record = run.finish()?;
        context.progress.end(&format!("{}: {}", path.display(), scene.facts.summary()));
        return Ok(Output { composite: path, folder: input.output.clone(), reused: false, record });
    }
    context.check()?;
    let found = find(input, config, &mut scene, &mut run, context)?;
    context.check()?;
    let sampler = EnvironmentSampler::new(&found.light);
    let layers = run.time("render", || {
        let rows = scene.camera.width * scene.camera.height;
        let check = watch(context, "final picture", rows);
        render(&scene.object, &scene.camera, &sampler, &config.samples, config.seed, check)
            .ok_or(PipelineError::Cancelled { kept: None })
    })?;
    if layers.coverage.data.iter().all(|v| *v == 0.0) {
        return Err(session::out_of_frame(&scene.object, &scene.camera).into());
    }
    let image = session::compose_layers(&scene.photo, &layers, &found.tone.curves());
    run.invalidate()?;
    let made =
        outputs::Made { scene: &scene, found: &found, layers: &layers, composite: &image, preview: &preview };
    outputs::write(&input.output, &what, config, &made, &mut run)?;
    let record = run.finish()?;
    context.progress.end(&format!("{}: {}", composite.display(), scene.facts.summary()));
    Ok(Output { composite, folder: input.output.clone(), reused: false, record })
}

/// Arguments that contradict each other or make no sense.
fn check(input: &Input, config: &Config) -> Result<(), PipelineError> {
    let wrong = |what: &str, expected: &str, got: String| Err(PipelineError::input(what, expected, got));
    match (config.guidance, &input.reference, &input.light) {
        (GuidedBy::Reference, None, _) => return wrong("--guidance", "reference=IMAGE", "no image".into()),
        (GuidedBy::Panorama, _, Some(_)) => {
            return wrong("--light", "--guidance none, reference or lds beside it", "panorama".into());
        }
        (GuidedBy::Lds, _, _) if input.model.is_none() => {
            return wrong("--guidance lds", "--model DIR, a guidance bundle", "none".into());
        }
        (GuidedBy::Panorama | GuidedBy::None, _, _) if config.material.is_some() => {
            let expected = "--guidance reference or lds, which look at the composite";
            return wrong("--material", expected, format!("{:?}", config.guidance).to_lowercase());
        }
        _ => {}
    }
    if !(4..=128).contains(&config.light_height) || !config.light_height.is_multiple_of(2) {
        return wrong("--light-height", "an even number from 4 to 128", config.light_height.to_string());
    }
    if !(16..=2048).contains(&config.width) {
        return wrong("--width", "16 to 2048 pixels", config.width.to_string());
    }
    if config.iterations == 0 {
        return wrong("--iterations", "at least 1", "0".into());
    }
    if matches!(config.light, LightKind::Gaussians(n) if !(1..=4096).contains(&n)) {
        return wrong("--lobes", "1 to 4096", format!("{:?}", config.light));
    }
    Ok(())
}

fn fingerprint(input: &Input, config: &Config) -> Result<String, PipelineError> {
    let mut fingerprint = Fingerprint::new("insert");
    fingerprint.path("image", &input.image)?;
    if comgs_scene::mesh::is_mesh(&input.object) {
        // Materials and textures lie beside a mesh; the folder would hold too much, so the mesh as read counts.
        fingerprint.path("object", &input.object)?;
        let up = if config.obj_z_up { Up::Z } else { Up::Y };
        let mesh = comgs_scene::read_mesh(&input.object, up)?;
        for material in &mesh.materials {
            for map in [&material.albedo_map, &material.surface_map].into_iter().flatten() {
                let bytes: Vec<u8> = map.data.iter().flat_map(|v| v.to_le_bytes()).collect();
                fingerprint.entry("texture", &bytes);
            }
            let m = material;
            let numbers = format!("{:?} {} {} {:?}", m.albedo, m.roughness, m.metallic, m.emission);
            fingerprint.entry("material", numbers.as_bytes());
        }
    } else {
        fingerprint.surfels("object", &input.object)?;
    }
    let model = input.model.as_ref().map(|folder| folder.join("model.json"));
    let files = [("camera", &input.camera), ("reference", &input.reference), ("light", &input.light)];
    for (name, path) in files.into_iter().chain([("model", &model)]) {
        if let Some(path) = path {
            fingerprint.path(name, path)?;
        }
    }
    fingerprint.config("config", config)?;
    Ok(fingerprint.finish())
}

/// Says how far a loop over `all` items is, and whether it should go on.
fn watch<'a>(context: &'a Context<'_>, doing: &'a str, all: usize) -> impl Fn(usize) -> bool + Sync + 'a {
    let done = AtomicUsize::new(0);
    move |items| {
        let before = done.fetch_add(items, Ordering::Relaxed);
        let (last, now) = (100 * before / all.max(1), 100 * (before + items) / all.max(1));
        if now > last {
            let fraction = Some((now as f64 / 100.0).min(1.0));
            context.progress.update(&Status { fraction, message: doing.to_owned(), remaining: None });
        }
        !context.cancel.is_cancelled()
    }
}

/// Finds the light.
fn find(
    input: &Input,
    config: &Config,
    scene: &mut Scene,
    run: &mut Run,
    context: &Context<'_>,
) -> Result<Found, PipelineError> {
    let tone = Tone::identity(config.response);
    match config.guidance {
        GuidedBy::None => {
            let light = match &input.light {
                Some(path) => super::relight::subject::read_light(path, |text| run.warn(context, text))?,
                None => EnvironmentMap::constant(session::mean_radiance(&scene.photo, config.response, MOST)),
            };
            Ok(Found { light, tone, losses: Vec::new(), partial: None, material: None })
        }
        GuidedBy::Panorama => {
            let partial = run.time("project", || {
                let response = config.response;
                let (photo, camera) = (&scene.photo, &scene.camera);
                Ok::<_, PipelineError>(project(photo, camera, response, MOST, PANORAMA_HEIGHT))
            })?;
            let completer = completer(config.fill, config.response.invert(MOST, MOST))?;
            context.progress.note(&format!("the rest of the sphere is completed: {}", completer.name()));
            let (target, added) = run.time("complete", || {
                let meter = GroundMeter::default();
                surroundings(&partial, &scene.camera, &*completer, Some(&meter), config.light_height)
            })?;
            if added > 0.0 {
                context.progress.note(&format!(
                    "the ground is {:.1} times as bright as the sky seen makes it: light from outside the frame is added",
                    1.0 + added
                ));
            }
            let check = |i: usize| iterate(context, config, i);
            let outcome =
                run.time("optimise", || session::fit(&target, config.light, config.iterations, check))?;
            let light = outcome.light.to_environment();
            Ok(Found { light, tone, losses: outcome.losses, partial: Some(partial), material: None })
        }
        GuidedBy::Reference | GuidedBy::Lds => guided::find(input, config, scene, run, context),
    }
}

fn iterate(context: &Context<'_>, config: &Config, i: usize) -> bool {
    if i.is_multiple_of(10) {
        let fraction = Some(i as f64 / config.iterations as f64);
        let message = format!("light, iteration {i}/{}", config.iterations);
        context.progress.update(&Status { fraction, message, remaining: None });
    }
    !context.cancel.is_cancelled()
}

/// A map of light as the picture that reports show: its mean brought to middle grey.
pub(crate) fn shown(map: &EnvironmentMap) -> Image {
    let height = map.height().clamp(64, 256);
    let map = if map.height() < height {
        LightMap::from_environment(map, map.height()).to_image()
    } else {
        map.image().clone()
    };
    let mean = map.data.iter().sum::<f32>() / map.data.len() as f32;
    let scale = if mean > 0.0 { 0.25 / mean } else { 1.0 };
    map.map(|v| v * scale).resized(2 * height, height)
}

impl From<InsertError> for PipelineError {
    fn from(error: InsertError) -> Self {
        match error {
            InsertError::Stopped => Self::Cancelled { kept: None },
            other => Self::Insert(other),
        }
    }
}
