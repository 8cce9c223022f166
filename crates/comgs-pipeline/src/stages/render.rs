//! `render`: an asset as cameras see it.

use crate::stages::frames;
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, Status, source};
use comgs_geom::Camera;
use comgs_image::{Image, Layer, write_layers, write_png};
use comgs_raster::{Frame, Planes, surface_normals};
use comgs_scene::{Asset, AssetKind};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Asset or PLY.
    pub asset: PathBuf,
    /// Any camera file or capture.
    pub cameras: PathBuf,
    /// Output folder.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Config {
    /// Also write one multilayer EXR a frame.
    pub layers: bool,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// Names of the frames.
    pub frames: Vec<String>,
    /// The record.
    pub record: RunRecord,
}

/// Renders every camera to `<output>/frames/<name>.png` (linear radiance over black, sRGB), with `layers` also to
/// `<output>/layers/<name>.exr`.
///
/// # Errors
/// [`PipelineError`].
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("render");
    let mut run = Run::in_folder("render", &input.output);
    let cameras = frames::read_cameras(&input.cameras)?;
    let names: Vec<String> = cameras.iter().map(|c| c.name.clone()).collect();
    let mut fingerprint = Fingerprint::new("render");
    fingerprint.surfels("asset", &input.asset)?;
    fingerprint.config("cameras", &cameras)?;
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        return Ok(Output { frames: names, record });
    }
    run.check_output()?;
    let inputs = json!({"asset": input.asset, "cameras": input.cameras});
    run.describe(fingerprint, inputs, config, None)?;
    let asset = run.time("load", || source::load_surfels(&input.asset, AssetKind::Scene))?;
    run.invalidate()?;
    let mut seconds = 0.0;
    for (i, camera) in cameras.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(i as f64 / cameras.len() as f64),
            message: format!("view {}", camera.name),
            remaining: None,
        });
        let start = std::time::Instant::now();
        let frame = render(&asset, camera);
        seconds += start.elapsed().as_secs_f64();
        let path = input.output.join("frames").join(format!("{}.png", camera.name));
        write_png(&path, color(&frame))?;
        run.output(&path)?;
        if config.layers {
            let path = input.output.join("layers").join(format!("{}.exr", camera.name));
            write_frame(&path, &frame, camera)?;
            run.output(&path)?;
        }
    }
    run.add_time("rasterise", seconds, false);
    run.results(json!({"frames": names.len(), "surfels": asset.surfels.len()}));
    let record = run.finish()?;
    context.progress.end(&format!("{} frames in {}", names.len(), input.output.join("frames").display()));
    Ok(Output { frames: names, record })
}

/// Colour, weight, depth and normal, and material when the cloud has it.
pub(crate) fn render(asset: &Asset, camera: &Camera) -> Frame {
    let cloud = &asset.surfels;
    let planes = if cloud.material.is_some() { Planes::ALL } else { Planes::GEOMETRY };
    comgs_raster::render(cloud, camera, planes, &source::raster_config(asset))
}

/// The colour plane, which is always asked for here.
pub(crate) fn color(frame: &Frame) -> &Image {
    frame.color.as_ref().unwrap_or(&frame.weight)
}

/// Writes the planes of a rendering as one multilayer EXR: beauty RGBA (premultiplied), depth Z (unbiased, 0 where
/// nothing), normal XYZ (unit, of the surface that the depths show), and albedo, roughness, metallic where there is material.
fn write_frame(path: &Path, frame: &Frame, camera: &Camera) -> Result<(), PipelineError> {
    let depth = frame.unbiased_depth(f32::MIN_POSITIVE);
    let normal = unit_normals(frame, camera);
    let half = |name, channels, image| Layer { name, channels, image, full_float: false };
    let mut layers = vec![
        half("", &["R", "G", "B"], color(frame)),
        half("", &["A"], &frame.weight),
        Layer { name: "depth", channels: &["Z"], image: &depth, full_float: true },
        half("normal", &["X", "Y", "Z"], &normal),
    ];
    if let Some(material) = &frame.material {
        layers.push(half("material", &["R", "G", "B", "roughness", "metallic"], material));
    }
    Ok(write_layers(path, &layers)?)
}

/// Unit normals of the surface that a frame shows, zero where there is nothing.
pub(crate) fn unit_normals(frame: &Frame, camera: &Camera) -> Image {
    surface_normals(frame, camera).unwrap_or_else(|| Image::zeros(frame.weight.width, frame.weight.height, 3))
}
