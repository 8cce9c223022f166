//! Guidances that look at the composite: a reference, or denoisers. Light, tone and material in one loop.

use super::{Config, Found, GuidedBy, Input, MOST, Scene, iterate, place, watch};
use crate::stages::completers::ModelConfig;
use crate::{Context, PipelineError, Run};
use comgs_image::Image;
use comgs_insert::guidance::{Guidance, Reference};
use comgs_insert::lds::{Distillation, GuidanceBundle, GuidanceError};
use comgs_insert::light::{Light, LightMap, Texels};
use comgs_insert::material::{MaterialSettings, Property, Search, Summary};
use comgs_insert::object::Object;
use comgs_insert::optimise::{Curves, Lights};
use comgs_insert::session::{self, TransportConfig};
use comgs_insert::tone::Tone;
use comgs_insert::transport::{Foreground, ForegroundConfig, Shadow, ShadowConfig, trace_shadow};
use comgs_insert::{InsertError, Outcome, Problem, Settings, State, optimise_with};
use serde::Serialize;
use std::path::Path;

/// What of the object's material is optimised.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MaterialChoice {
    /// The part by its name; may be left out for an object of one part.
    pub part: Option<String>,
    /// Which properties.
    pub free: Vec<Property>,
}

/// The material that was found.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct FoundMaterial {
    /// The part's name.
    pub part: String,
    #[serde(flatten)]
    pub summary: Summary,
}

/// Transport, with or without a material to look for.
struct Ready<'a> {
    foreground: Foreground,
    shadow: Shadow,
    height: usize,
    search: Option<Search<'a>>,
}

/// The photo that is optimised over, and what it is compared with.
struct Pictures {
    photo: Image,
    reference: Option<Image>,
}

/// Light, tone and material that the guidance leads to.
pub(super) fn find(
    input: &Input,
    config: &Config,
    scene: &mut Scene,
    run: &mut Run,
    context: &Context<'_>,
) -> Result<Found, PipelineError> {
    let pictures = pictures(input, config, scene)?;
    let (w, h) = (pictures.photo.width, pictures.photo.height);
    let bundle = input.model.as_deref().map(read_bundle).transpose()?;
    let given = match &input.light {
        Some(path) => {
            let map = crate::stages::relight::subject::read_light(path, |text| run.warn(context, text))?;
            Some(map)
        }
        None => None,
    };
    let camera = scene.camera.resized(w, h);
    let part = config.material.as_ref().map(|choice| named(choice, &scene.object)).transpose()?;
    if part.is_some() && config.curves == Curves::Free {
        run.warn(
            context,
            "the tone curves are optimised beside the material: the object's brightness is shared between them \
             (--fixed-tone leaves it to the material)"
                .to_owned(),
        );
    }
    let name = part.map(|k| scene.object.parts()[k].clone());
    let transport_config = TransportConfig {
        height: config.light_height,
        memory: config.memory,
        depth: config.samples.depth,
        seed: config.seed,
    };
    let on = |_: usize| !context.cancel.is_cancelled();
    let object = &mut scene.object;
    let mut ready = run.time("transport", || match (part, &config.material) {
        (Some(part), Some(choice)) => {
            let settings = MaterialSettings::new(part, choice.free.clone(), config.iterations);
            let fg = ForegroundConfig {
                height: config.light_height,
                depth: config.samples.depth,
                seed: config.seed,
                ..ForegroundConfig::default()
            };
            let search = Search::new(object, &camera, &fg, config.memory, settings, &on)?;
            let height = search.height();
            let foreground = search.lobes().foreground.outline();
            let sh = ShadowConfig { height, seed: config.seed, ..ShadowConfig::default() };
            let shadow = trace_shadow(search.object(), &camera, &foreground.coverage.data, &sh, on)
                .ok_or(InsertError::Stopped)?;
            Ok(Ready { foreground, shadow, height, search: Some(search) })
        }
        _ => {
            // Rows of object and ground are counted together; how many there are is known to a factor of two.
            let check = watch(context, "tracing of light", w * h);
            let t = session::trace(object, &camera, &transport_config, check)?;
            Ok::<_, InsertError>(Ready {
                foreground: t.foreground,
                shadow: t.shadow,
                height: t.height,
                search: None,
            })
        }
    })?;
    if ready.height < config.light_height {
        run.warn(
            context,
            format!(
                "the map is optimised with {} rows instead of {}: the matrix of transport would take more than --memory",
                ready.height, config.light_height
            ),
        );
    }
    let light = match &given {
        Some(map) => Light::Texels(Texels::from_map(&LightMap::from_environment(map, ready.height))),
        None => {
            let radiance = session::mean_radiance(&pictures.photo, config.response, MOST);
            config.light.even(ready.height, radiance)
        }
    };
    let state = State { foreground: light.clone(), shadow: light, tone: Tone::identity(config.response) };
    let settings = Settings {
        iterations: config.iterations,
        curves: config.curves,
        lights: if given.is_some() { Lights::Fixed } else { Lights::Free },
        seed: config.seed,
        ..Settings::dipir()
    };
    let Ready { foreground, shadow, search, .. } = &mut ready;
    let problem = Problem { photo: &pictures.photo, foreground, shadow };
    let mut guidance: Box<dyn Guidance + '_> = match (&bundle, &pictures.reference, config.guidance) {
        (Some(bundle), _, GuidedBy::Lds) => {
            let runtime = ModelConfig::shipped().runtime();
            let prompt = config.prompt.as_deref();
            let lds =
                Distillation::new(bundle, &runtime, prompt, &pictures.photo, problem.foreground, config.seed);
            Box::new(lds.map_err(InsertError::from)?)
        }
        (_, Some(target), _) => Box::new(Reference::new(target, problem.foreground.pixels.len())),
        _ => return Err(PipelineError::Internal("a guidance without what it looks at".into())),
    };
    let Outcome { light, state, losses, .. } = run.time("optimise", || {
        optimise_with(Some(&problem), state, &mut *guidance, &settings, search.as_mut(), |i| {
            iterate(context, config, i)
        })
    })?;
    drop(guidance);
    let material = match (ready.search, name) {
        (Some(search), Some(part)) => {
            let summary = search.finish();
            context.progress.note(&format!("the material of {part:?}: {}", summary.why));
            Some(FoundMaterial { part, summary })
        }
        _ => None,
    };
    // A light that was given lights the final picture as it was given, not as coarsely as it was traced.
    let light = given.unwrap_or_else(|| light.to_environment());
    Ok(Found { light, tone: state.tone, losses, partial: None, material })
}

/// Photo and reference at the size that is optimised over.
fn pictures(input: &Input, config: &Config, scene: &Scene) -> Result<Pictures, PipelineError> {
    let (w, h) = place::working_size(&scene.photo, config.width);
    let reference = match (config.guidance, &input.reference) {
        (GuidedBy::Reference, Some(path)) => {
            let target = place::read_photo(path)?;
            if (target.width, target.height) != (scene.photo.width, scene.photo.height) {
                return Err(PipelineError::input(
                    path.display().to_string(),
                    format!("the photo's size, {}×{}", scene.photo.width, scene.photo.height),
                    format!("{}×{}", target.width, target.height),
                ));
            }
            Some(target.resized(w, h))
        }
        _ => None,
    };
    Ok(Pictures { photo: scene.photo.resized(w, h), reference })
}

/// Manifests are small.
const LARGEST_MANIFEST: u64 = 1 << 20;

/// Reads a guidance bundle from its folder.
pub(crate) fn read_bundle(folder: &Path) -> Result<GuidanceBundle, PipelineError> {
    let path = folder.join("model.json");
    let size = std::fs::metadata(&path).map_err(|e| PipelineError::io(&path, e))?.len();
    if size > LARGEST_MANIFEST {
        let expected = format!("a manifest of at most {LARGEST_MANIFEST} bytes");
        return Err(PipelineError::input(path.display().to_string(), expected, format!("{size} bytes")));
    }
    let manifest = std::fs::read(&path).map_err(|e| PipelineError::io(&path, e))?;
    GuidanceBundle::from_parts(&manifest, &|file| std::fs::read(folder.join(file)))
        .map_err(|e: GuidanceError| InsertError::from(e).into())
}

/// The part that is meant.
fn named(choice: &MaterialChoice, object: &Object) -> Result<usize, PipelineError> {
    let parts = object.parts();
    let there: Vec<usize> = (0..parts.len()).filter(|k| object.has_part(*k)).collect();
    let list = there.iter().map(|k| parts[*k].as_str()).collect::<Vec<_>>().join(", ");
    match (&choice.part, there.as_slice()) {
        (None, [only]) => Ok(*only),
        (None, _) => Err(PipelineError::input("--material", format!("PART:…, a part of {list}"), "no part")),
        (Some(name), _) => there
            .iter()
            .copied()
            .find(|k| parts[*k] == *name)
            .ok_or_else(|| PipelineError::input("--material", format!("a part of {list}"), name.clone())),
    }
}
