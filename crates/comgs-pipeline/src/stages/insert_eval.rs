//! `insert-eval`: how well the light of one photo is found, on the benchmark of DiPIR's Table 2 made from HDR maps.
//!
//! From each map a photo is cut (clipped to white, 8-bit sRGB), an object is put on a known ground plane, and the reference is
//! the same insertion under the map itself. Methods see the photo alone. The reference and every method are rendered by
//! [`comgs_insert::render`], which two other renderers judge (`comgs-synth` in tests, Mitsuba 3 by script), so the
//! differences here are those of light and tone alone.

mod objects;
mod table;

use super::insert::{Filled, completer, watch};
use crate::stages::insert::{LOBES, MOST};
use crate::{Context, PipelineError, Run, RunRecord, Status};
use comgs_geom::{Camera, Similarity, equirect};
use comgs_image::transfer::{linear_from_srgb, srgb_from_linear, srgb8_from_linear};
use comgs_image::{Image, write_png};
use comgs_insert::ground::{Ground, above};
use comgs_insert::object::{Object, stand};
use comgs_insert::panorama::{GroundMeter, project, surroundings};
use comgs_insert::render::{Samples, render};
use comgs_insert::session::{self, LightKind, compose_layers, fit, touched};
use comgs_insert::tone::{Response, Tone};
use comgs_insert::{InsertError, light::LightMap};
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_metrics::{MetricError, PixelWeights, rmse, si_rmse, ssim};
use glam::{DVec3, Vec3};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

pub use table::{Row, Scores, markdown};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Folder of environment maps (`.exr`, `.hdr`), or one map.
    pub maps: PathBuf,
    /// Output folder.
    pub output: PathBuf,
    /// The command, for the table's caption.
    pub command: String,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Maps taken, evenly spread over the sorted folder; the paper has 11.
    pub count: usize,
    /// Size of the photos in pixels.
    pub size: [usize; 2],
    /// Horizontal field of view in degrees.
    pub fov_deg: f64,
    /// Camera above the ground, metres.
    pub height: f64,
    /// Where the object stands ahead of the camera, metres.
    pub distance: f64,
    /// Samples of every rendering.
    pub samples: Samples,
    /// Iterations of a fit.
    pub iterations: usize,
    /// Rows of the fitted maps.
    pub light_height: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            count: 11,
            size: [384, 256],
            fov_deg: 60.0,
            height: 1.5,
            distance: 4.2,
            samples: Samples { grid: 2, light: 128, shadow: 128, depth: 3 },
            iterations: 600,
            light_height: 32,
            seed: 0,
        }
    }
}

/// Share of the photo's luminance below [`EXPOSED`]: exposure as a camera's meter would have it.
const METERED: f64 = 0.9;
/// Linear value that the [`METERED`] quantile is brought to.
const EXPOSED: f32 = 0.7;
/// Row of the horizon as a share of the height.
const HORIZON: f64 = 0.36;
/// Rows of the panorama that is completed.
const PANORAMA_HEIGHT: usize = 64;

/// A method.
#[derive(Clone, Copy, Debug)]
struct Method {
    name: &'static str,
    light: Estimate,
    response: Response,
}

/// Where a method's light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Estimate {
    /// Even light of the photo's mean.
    Even,
    /// The completed panorama, described as it says.
    Panorama(LightKind, Option<GroundMeter>, Filled),
    /// The true map reduced to what the optimised maps hold: what the description alone costs.
    True,
}

/// Methods in the order of the table. The photos' own response is [`Response::Clip`].
const METHODS: [Method; 8] = [
    Method { name: "even light", light: Estimate::Even, response: Response::Clip },
    Method {
        name: "panorama without the ground",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), None, Filled::Harmonic),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), Some(GroundMeter::TUNED), Filled::Harmonic),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama, clipped response",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), Some(GroundMeter::TUNED), Filled::Harmonic),
        response: Response::Clip,
    },
    Method {
        name: "panorama, texels",
        light: Estimate::Panorama(LightKind::Texels, Some(GroundMeter::TUNED), Filled::Harmonic),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama, learned completion",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), Some(GroundMeter::TUNED), Filled::Learned),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama, learned, without the ground",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), None, Filled::Learned),
        response: Response::Reinhard,
    },
    Method { name: "true map at the fit's resolution", light: Estimate::True, response: Response::Clip },
];

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The table as Markdown.
    pub table: PathBuf,
    /// All scores.
    pub rows: Vec<Row>,
    /// The record.
    pub record: RunRecord,
}

/// One map's photo and what is put into it.
struct Case {
    name: String,
    /// The map, turned to the camera and exposed as the photo is.
    light: EnvironmentMap,
    photo: Image,
    camera: Camera,
    object: Object,
    object_name: &'static str,
}

/// Runs the benchmark: `insert_eval.{csv,md}`, and for every map `<map>_{photo,reference}.png`, `<map>_<method>.png`,
/// `sheet.png` with all of them.
///
/// # Errors
/// [`PipelineError`] when there are no maps, or one cannot be read.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("insert-eval");
    let mut run = Run::in_folder("insert-eval", &input.output);
    run.check_output()?;
    let maps = chosen(&input.maps, config.count)?;
    run.describe(String::new(), json!({"maps": input.maps}), config, Some(config.seed))?;
    run.invalidate()?;
    let mut rows = Vec::new();
    let mut sheet = Vec::new();
    for (k, path) in maps.iter().enumerate() {
        context.check()?;
        let case = case(path, k, config)?;
        let fraction = Some(k as f64 / maps.len() as f64);
        let message = format!("{}, map {}/{}", case.name, k + 1, maps.len());
        context.progress.update(&Status { fraction, message, remaining: None });
        let started = std::time::Instant::now();
        let truth = picture(&case, &case.light, Response::Clip, config, context)?;
        run.add_time("reference", started.elapsed().as_secs_f64(), false);
        let crop = touched(&truth.1);
        let file = |what: &str| {
            input.output.join(format!(
                "{}_{}.png",
                case.name,
                what.replace(", ", "_").replace([' ', '\''], "_")
            ))
        };
        let mut strip = vec![case.photo.clone(), truth.0.clone()];
        for (what, image) in [("photo", &case.photo), ("reference", &truth.0)] {
            write_png(&file(what), image)?;
            run.output(&file(what))?;
        }
        for method in METHODS {
            context.check()?;
            let started = std::time::Instant::now();
            let light = estimate(&case, method, config, context)?;
            let seconds = started.elapsed().as_secs_f64();
            let (image, _) = picture(&case, &light, method.response, config, context)?;
            run.add_time(method.name, seconds, false);
            let cut = |im: &Image| cropped(im, crop);
            let failed = |e: MetricError| PipelineError::Internal(e.to_string());
            rows.push(Row {
                map: case.name.clone(),
                object: case.object_name,
                method: method.name,
                seconds,
                whole: scores(&image, &truth.0).map_err(failed)?,
                touched: scores(&cut(&image), &cut(&truth.0)).map_err(failed)?,
            });
            write_png(&file(method.name), &image)?;
            run.output(&file(method.name))?;
            strip.push(image);
        }
        sheet.push(strip);
    }
    let (md, csv) = (input.output.join("insert_eval.md"), input.output.join("insert_eval.csv"));
    let names: Vec<&str> = METHODS.iter().map(|m| m.name).collect();
    write_text(&md, &markdown(&rows, &names, &input.command))?;
    write_text(&csv, &table::csv(&rows))?;
    let sheet_path = input.output.join("sheet.png");
    write_png(&sheet_path, &contact_sheet(&sheet))?;
    for path in [&md, &csv, &sheet_path] {
        run.output(path)?;
    }
    run.results(json!({"means": table::means(&rows, &names)}));
    let record = run.finish()?;
    context.progress.end(&format!("{} maps: {}", maps.len(), md.display()));
    Ok(Output { table: md, rows, record })
}

fn write_text(path: &Path, text: &str) -> Result<(), PipelineError> {
    comgs_image::atomic::write_file(path, |w| w.write_all(text.as_bytes()))
        .map_err(|e| PipelineError::io(path, e))
}

/// `count` maps spread evenly over a folder's sorted maps; the file itself for a file.
fn chosen(path: &Path, count: usize) -> Result<Vec<PathBuf>, PipelineError> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = std::fs::read_dir(path).map_err(|e| PipelineError::io(path, e))?;
    let mut maps: Vec<PathBuf> = entries
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| matches!(crate::source::extension(p).as_str(), "exr" | "hdr"))
        .collect();
    maps.sort();
    if maps.is_empty() || count == 0 {
        return Err(PipelineError::input(
            path.display().to_string(),
            "environment maps (.exr, .hdr)",
            "none",
        ));
    }
    let count = count.min(maps.len());
    Ok((0..count).map(|k| maps[k * maps.len() / count].clone()).collect())
}

/// Cuts the photo and places the object.
fn case(path: &Path, k: usize, config: &Config) -> Result<Case, PipelineError> {
    let map = super::relight::subject::read_light(path, |_| {})?;
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
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Case { name, light: map.scaled(exposure), photo, camera, object, object_name })
}

/// The light that a method finds, in units of the photo.
fn estimate(
    case: &Case,
    method: Method,
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
            let check = |_: usize| !context.cancel.is_cancelled();
            Ok(fit(&target, kind, config.iterations, check)?.light.to_environment())
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

/// The insertion under a light, 8-bit as the photo is, and its layers.
fn picture(
    case: &Case,
    light: &EnvironmentMap,
    response: Response,
    config: &Config,
    context: &Context<'_>,
) -> Result<(Image, comgs_insert::render::Layers), PipelineError> {
    let sampler = EnvironmentSampler::new(light);
    let all = case.camera.width * case.camera.height;
    let check = watch(context, &case.name, all);
    let layers = render(&case.object, &case.camera, &sampler, &config.samples, config.seed, check)
        .ok_or(PipelineError::Cancelled { kept: None })?;
    let image = compose_layers(&case.photo, &layers, &Tone::identity(response).curves());
    Ok((image.map(|v| linear_from_srgb(f32::from(srgb8_from_linear(v)) / 255.0)), layers))
}

fn scores(image: &Image, truth: &Image) -> Result<Scores, MetricError> {
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

fn cropped(image: &Image, crop: comgs_insert::composite::Crop) -> Image {
    let mut out = Image::zeros(crop.x1 - crop.x0, crop.y1 - crop.y0, 3);
    for y in 0..out.height {
        for x in 0..out.width {
            let value = image.rgb(crop.x0 + x, crop.y0 + y);
            out.pixel_mut(x, y).copy_from_slice(&value);
        }
    }
    out
}

/// Pictures of a sheet are reduced to this width.
const SHEET_WIDTH: usize = 192;

/// One row a map: photo, reference, methods.
fn contact_sheet(strips: &[Vec<Image>]) -> Image {
    let columns = strips.first().map_or(0, Vec::len);
    let Some(first) = strips.first().and_then(|s| s.first()) else { return Image::zeros(1, 1, 3) };
    let (w, h) = (SHEET_WIDTH, first.height * SHEET_WIDTH / first.width);
    let mut out = Image::zeros(columns * w, strips.len() * h, 3);
    for (row, strip) in strips.iter().enumerate() {
        for (column, image) in strip.iter().enumerate() {
            let small = image.resized(w, h);
            for y in 0..h {
                for x in 0..w {
                    let value = small.rgb(x, y);
                    out.pixel_mut(column * w + x, row * h + y).copy_from_slice(&value);
                }
            }
        }
    }
    out
}
