//! One map of the benchmark: its photo, what is put into it, the light that a method finds, the picture under it, its scores.

use super::{
    Config, EXPOSED, Estimate, HORIZON, METERED, Method, PANORAMA_HEIGHT, Scores, maps::Chosen, objects,
};
use crate::stages::completers::ModelConfig;
use crate::stages::insert::{LOBES, MOST, completer};
use crate::{Context, PipelineError};
use comgs_geom::{Camera, Similarity, equirect};
use comgs_image::Image;
use comgs_image::transfer::{linear_from_srgb, srgb_from_linear, srgb8_from_linear};
use comgs_insert::composite::Crop;
use comgs_insert::ground::{Ground, above};
use comgs_insert::guidance::Guidance;
use comgs_insert::lds::{Distillation, GuidanceBundle};
use comgs_insert::object::{Object, stand};
use comgs_insert::optimise::Curves;
use comgs_insert::panorama::{GroundMeter, project, surroundings};
use comgs_insert::render::{Layers, render};
use comgs_insert::session::{self, LightKind, TransportConfig, compose_layers, fit};
use comgs_insert::tone::{Response, Tone};
use comgs_insert::{InsertError, Outcome, Problem, Settings, State, light::LightMap, optimise};
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_metrics::{MetricError, PixelWeights, rmse, si_rmse, ssim};
use glam::{DVec3, Vec3};
use std::path::PathBuf;

/// One map's photo and what is put into it.
pub(super) struct Case {
    pub name: String,
    /// The map, turned to the camera and exposed as the photo is.
    pub light: EnvironmentMap,
    pub photo: Image,
    pub camera: Camera,
    pub object: Object,
    pub object_name: &'static str,
}

/// Cuts the photo and places the object.
pub(super) fn case(chosen: &Chosen, config: &Config) -> Result<Case, PipelineError> {
    let k = chosen.number;
    let map = crate::stages::relight::subject::read_light(&chosen.path, |_| {})?;
    // Golden-angle headings: not all photos look at what the photographer put into the map's middle.
    let map = map.turned((k as f32 * 137.5).to_radians());
    let [w, h] = config.size;
    let fov = config.fov_deg.to_radians();
    let intrinsics = Camera::look_at("photo", w, h, fov, DVec3::ZERO, DVec3::X, DVec3::Z);
    let ground = Ground::Horizon { row: HORIZON * h as f64, height: config.height };
    let camera = above(&intrinsics, &ground).map_err(InsertError::from)?;
    let mut raw = Image::zeros(w, h, 3);
    for y in 0..h {
        for x in 0..w {
            let mut sum = Vec3::ZERO;
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                sum += map.lookup(camera.ray_world(x as f64 + dx, y as f64 + dy).as_vec3());
            }
            raw.pixel_mut(x, y).copy_from_slice(&(0.25 * sum).to_array());
        }
    }
    let mut luminances: Vec<f32> =
        (0..w * h).map(|i| comgs_light::luminance(Vec3::from_slice(&raw.data[3 * i..3 * i + 3]))).collect();
    luminances.sort_by(f32::total_cmp);
    let metered = luminances[((luminances.len() - 1) as f64 * METERED) as usize].max(1e-9);
    let exposure = EXPOSED / metered;
    // As a photo is stored.
    let photo = raw.map(|v| linear_from_srgb(f32::from(srgb8_from_linear(v * exposure)) / 255.0));
    let (object_name, mesh) = objects::object(k);
    let bounds = mesh.bounds().ok_or_else(|| PipelineError::Internal("an empty object".into()))?;
    let transform: Similarity = stand(bounds, [config.distance, 0.0], 1.0, k as f64);
    let object =
        Object::mesh(&mesh, &transform).ok_or_else(|| PipelineError::Internal("an empty object".into()))?;
    Ok(Case { name: chosen.name.clone(), light: map.scaled(exposure), photo, camera, object, object_name })
}

/// The light that a method finds, in units of the photo.
pub(super) fn estimate(
    case: &Case,
    method: Method,
    bundle: Option<&GuidanceBundle>,
    config: &Config,
    context: &Context<'_>,
) -> Result<EnvironmentMap, PipelineError> {
    let most = if method.response == Response::Clip { 1.0 } else { MOST };
    match method.light {
        Estimate::Even => {
            Ok(EnvironmentMap::constant(session::mean_radiance(&case.photo, method.response, most)))
        }
        Estimate::Panorama(kind, meter, fill) => {
            let partial = project(&case.photo, &case.camera, method.response, most, PANORAMA_HEIGHT);
            let completer = completer(fill, method.response.invert(most, most))?;
            let (target, _) =
                surroundings(&partial, &case.camera, &*completer, meter.as_ref(), config.light_height)?;
            Ok(fit(&target, kind, config.iterations, |_| !context.cancel.is_cancelled())?
                .light
                .to_environment())
        }
        Estimate::Distilled => {
            let bundle =
                bundle.ok_or_else(|| PipelineError::Internal("a guidance without its bundle".into()))?;
            distilled(case, method.response, most, bundle, config, context)
        }
        Estimate::True => {
            // Looked up texel by texel, because the map is turned, and reduced from there by solid angle.
            let (h, w) = (case.light.height(), case.light.width());
            let mut image = Image::zeros(w, h, 3);
            for y in 0..h {
                for x in 0..w {
                    let d = equirect::texel_direction(x, y, w, h);
                    image.pixel_mut(x, y).copy_from_slice(&case.light.radiance(d).to_array());
                }
            }
            let reason = |reason| PipelineError::Light { path: PathBuf::from(&case.name), reason };
            Ok(LightMap::from_image(&image, config.light_height).map_err(reason)?.to_environment())
        }
    }
}

/// Score distillation from the panorama's light on, tone curves fixed.
fn distilled(
    case: &Case,
    response: Response,
    most: f32,
    bundle: &GuidanceBundle,
    config: &Config,
    context: &Context<'_>,
) -> Result<EnvironmentMap, PipelineError> {
    let on = |_: usize| !context.cancel.is_cancelled();
    let partial = project(&case.photo, &case.camera, response, most, PANORAMA_HEIGHT);
    let completer = completer(Default::default(), response.invert(most, most))?;
    let (target, _) =
        surroundings(&partial, &case.camera, &*completer, Some(&GroundMeter::TUNED), config.light_height)?;
    let start = fit(&target, LightKind::Gaussians(LOBES), config.iterations, on)?.state;
    let transport =
        TransportConfig { height: config.light_height, seed: config.seed, ..TransportConfig::default() };
    let traced = session::trace(&case.object, &case.camera, &transport, on)?;
    let problem = Problem { photo: &case.photo, foreground: &traced.foreground, shadow: &traced.shadow };
    let runtime = ModelConfig::shipped().runtime();
    let mut guidance: Box<dyn Guidance + '_> = Box::new(
        Distillation::new(bundle, &runtime, None, &case.photo, problem.foreground, config.seed)
            .map_err(InsertError::from)?,
    );
    let state = State { tone: Tone::identity(response), ..start };
    let settings = Settings {
        iterations: config.iterations,
        curves: Curves::Fixed,
        seed: config.seed,
        ..Settings::dipir()
    };
    let Outcome { light, .. } = optimise(Some(&problem), state, &mut *guidance, &settings, on)?;
    Ok(light.to_environment())
}

/// The insertion under a light, 8-bit as the photo is, and its layers.
pub(super) fn picture(
    case: &Case,
    light: &EnvironmentMap,
    response: Response,
    config: &Config,
    context: &Context<'_>,
) -> Result<(Image, Layers), PipelineError> {
    let sampler = EnvironmentSampler::new(light);
    let check = |_: usize| !context.cancel.is_cancelled();
    let layers = render(&case.object, &case.camera, &sampler, &config.samples, config.seed, check)
        .ok_or(PipelineError::Cancelled { kept: None })?;
    let image = compose_layers(&case.photo, &layers, &Tone::identity(response).curves());
    Ok((image.map(|v| linear_from_srgb(f32::from(srgb8_from_linear(v)) / 255.0)), layers))
}

/// Differences over the whole of two pictures.
pub(super) fn scores(image: &Image, truth: &Image) -> Result<Scores, MetricError> {
    let coded = |im: &Image| im.map(|v| srgb_from_linear(v.clamp(0.0, 1.0)));
    let (a, b) = (coded(image), coded(truth));
    let even = PixelWeights::Uniform;
    Ok(Scores {
        rmse_srgb: rmse(&a, &b, even, None)?,
        si_rmse_srgb: si_rmse(&a, &b, even, None)?,
        rmse_linear: rmse(image, truth, even, None)?,
        si_rmse_linear: si_rmse(image, truth, even, None)?,
        ssim: ssim(image, truth, comgs_metrics::Border::Valid, None)?.mean,
    })
}

/// A part of a picture.
pub(super) fn cropped(image: &Image, crop: Crop) -> Image {
    let mut out = Image::zeros(crop.x1 - crop.x0, crop.y1 - crop.y0, 3);
    for y in 0..out.height {
        for x in 0..out.width {
            let value = image.rgb(crop.x0 + x, crop.y0 + y);
            out.pixel_mut(x, y).copy_from_slice(&value);
        }
    }
    out
}
