//! `place`: from "there" to a similarity transform, with a look at what the object would stand on.

use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, source};
use comgs_compose::{PlacementConfig, PlacementReport, check_placement, objects};
use comgs_geom::{Camera, Similarity};
use comgs_raster::Planes;
use comgs_scene::{Asset, AssetKind, TransformFile, asset::Unit};
use comgs_trace::{TraceConfig, Tracer};
use glam::DVec3;
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;

/// Where the object's base goes.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum At {
    /// A point in the scene's world.
    Point([f64; 3]),
    /// What a view shows at a pixel position (x right, y down; pixel centres at +½).
    Pixel {
        /// Name of the view.
        view: String,
        /// Pixels from the left.
        x: f64,
        /// Pixels from the top.
        y: f64,
    },
}

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Scene asset or PLY.
    pub scene: PathBuf,
    /// Object asset or PLY.
    pub object: PathBuf,
    /// Cameras for [`At::Pixel`] and the default size; the scene asset's own when absent.
    pub cameras: Option<PathBuf>,
    /// The `transform.json` to write.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Where the base goes.
    pub at: At,
    /// Largest extent in scene units; when absent, see [`Output::size_reason`].
    pub size: Option<f64>,
    /// Turn about up in degrees, counter-clockwise from above.
    pub yaw_deg: f64,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// From the object's space to the scene's world.
    pub world_from_object: Similarity,
    /// Where the base stands.
    pub base: DVec3,
    /// Largest extent in scene units.
    pub size: f64,
    /// Why that size.
    pub size_reason: String,
    /// The ground, and warnings.
    pub report: PlacementReport,
    /// The record.
    pub record: RunRecord,
}

/// Share of the median camera distance that an object takes by default.
const DEFAULT_SHARE: f64 = 0.15;
/// Weight from which a pixel shows a surface.
const SURFACE_WEIGHT: f32 = 0.5;

/// Places the object.
///
/// # Errors
/// [`PipelineError`] when inputs cannot be loaded, the view is unknown, or nothing was reconstructed at the pixel.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("place");
    let mut run = Run::for_file("place", &input.output);
    if !config.yaw_deg.is_finite() {
        return Err(PipelineError::input("--yaw", "a finite number of degrees", config.yaw_deg.to_string()));
    }
    if let Some(size) = config.size
        && !(size > 0.0 && size.is_finite())
    {
        return Err(PipelineError::input("--size", "a positive number of scene units", size.to_string()));
    }
    run.check_output()?;
    let scene = run.time("load", || source::load_surfels(&input.scene, AssetKind::Scene))?;
    let object = run.time("load", || source::load_surfels(&input.object, AssetKind::Object))?;
    let cameras = scene_cameras(input)?;
    let up = DVec3::from_array(scene.record.up);

    let extent = objects::extent(&object.surfels, DVec3::from_array(object.record.up)).ok_or_else(|| {
        PipelineError::input(
            input.object.display().to_string(),
            "visible surfels",
            "none with opacity over 0.1",
        )
    })?;
    let base = match &config.at {
        At::Point(p) => DVec3::from_array(*p),
        At::Pixel { view, x, y } => run.time("pixel", || unproject(&scene, &cameras, view, *x, *y))?,
    };
    if !base.is_finite() {
        return Err(PipelineError::input("--at", "three finite numbers", format!("{base}")));
    }
    let (size, size_reason) = match config.size {
        Some(size) => (size, "as given".to_owned()),
        None => default_size(&scene, &object, extent.largest(), &cameras, base),
    };
    let world_from_object = extent.stand(base, up, size, config.yaw_deg.to_radians());
    let tracer = run.time("tree", || Tracer::new(&scene.surfels, &TraceConfig::occlusion()))?;
    let dimensions = (extent.high - extent.low) * world_from_object.scale;
    let report = check_placement(
        &tracer,
        base,
        up,
        0.5 * dimensions.x.min(dimensions.y),
        dimensions.z,
        None,
        &PlacementConfig::default(),
    );
    for warning in &report.warnings {
        run.warn(context, warning.clone());
    }

    let mut fingerprint = Fingerprint::new("place");
    fingerprint.surfels("scene", &input.scene)?;
    fingerprint.surfels("object", &input.object)?;
    fingerprint.config("config", config)?;
    let inputs = json!({"scene": input.scene, "object": input.object, "cameras": input.cameras});
    run.describe(fingerprint.finish(), inputs, config, None)?;
    run.invalidate()?;
    TransformFile::single(&source::name_of(&input.object), world_from_object).write(&input.output)?;
    run.output(&input.output)?;
    run.results(json!({
        "base": base.to_array(),
        "size": size,
        "size_reason": size_reason,
        "gap": report.gap,
        "ground_normal": report.ground_normal.map(|n| n.to_array()),
        "ground_coverage": report.ground_coverage,
    }));
    let record = run.finish()?;
    context
        .progress
        .end(&format!("{}: base at {base:.3}, {size:.3} large ({size_reason})", input.output.display()));
    Ok(Output { world_from_object, base, size, size_reason, report, record })
}

/// The cameras given, or those the scene asset was trained on; none when there are none.
fn scene_cameras(input: &Input) -> Result<Vec<Camera>, PipelineError> {
    if let Some(path) = &input.cameras {
        return Ok(comgs_scene::read_cameras(path)?);
    }
    let own = input.scene.join("cameras.json");
    if own.is_file() { Ok(comgs_scene::read_cameras(&own)?) } else { Ok(Vec::new()) }
}

/// The world point that a view shows at a pixel position, by the scene's rendered unbiased depth (median of 3×3).
fn unproject(scene: &Asset, cameras: &[Camera], view: &str, x: f64, y: f64) -> Result<DVec3, PipelineError> {
    let camera = find_camera(cameras, view)?;
    let (w, h) = (camera.width, camera.height);
    if !(x >= 0.0 && y >= 0.0 && x < w as f64 && y < h as f64) {
        let expected = format!("a position inside view {view} ({w}×{h} pixels)");
        return Err(PipelineError::input("--pixel", expected, format!("({x}, {y})")));
    }
    let planes = Planes { color: false, depth: true, normal: false, material: false };
    let frame = comgs_raster::render(&scene.surfels, camera, planes, &source::raster_config(scene));
    let depth = frame.unbiased_depth(SURFACE_WEIGHT);
    let (column, row) = (x as usize, y as usize);
    let mut depths = Vec::new();
    for j in row.saturating_sub(1)..(row + 2).min(h) {
        for i in column.saturating_sub(1)..(column + 2).min(w) {
            depths.extend(Some(depth.pixel(i, j)[0]).filter(|d| *d > 0.0));
        }
    }
    if depth.pixel(column, row)[0] <= 0.0 || depths.is_empty() {
        let weight = frame.weight.pixel(column, row)[0];
        return Err(PipelineError::input(
            format!("--pixel {view},{x},{y}"),
            format!("a reconstructed surface (weight at least {SURFACE_WEIGHT})"),
            format!("weight {weight:.2}: sky, or never seen"),
        ));
    }
    depths.sort_by(f32::total_cmp);
    Ok(camera.unproject(x, y, f64::from(depths[depths.len() / 2])))
}

/// A camera by name.
///
/// # Errors
/// [`PipelineError::Input`] that lists some of the names there are.
pub fn find_camera<'a>(cameras: &'a [Camera], name: &str) -> Result<&'a Camera, PipelineError> {
    cameras.iter().find(|c| c.name == name).ok_or_else(|| {
        let names: Vec<&str> = cameras.iter().take(8).map(|c| c.name.as_str()).collect();
        let expected = match (names.len(), cameras.len()) {
            (0, _) => "a scene that knows its cameras, or --cameras FILE".to_owned(),
            (shown, all) if shown < all => format!("one of {} … ({all} views)", names.join(", ")),
            _ => format!("one of {}", names.join(", ")),
        };
        PipelineError::input("view", expected, format!("{name:?}"))
    })
}

/// A size when none is given: the object's own when both sides are in metres, else a share of how far the cameras are
/// from the placement, else a share of the scene's middle half.
fn default_size(scene: &Asset, object: &Asset, own: f64, cameras: &[Camera], base: DVec3) -> (f64, String) {
    if scene.record.unit == Unit::Metre && object.record.unit == Unit::Metre {
        return (own, "the object's own size in metres".to_owned());
    }
    let percent = DEFAULT_SHARE * 100.0;
    let mut distances: Vec<f64> = cameras.iter().map(|c| c.centre().distance(base)).collect();
    if !distances.is_empty() {
        distances.sort_by(f64::total_cmp);
        let median = distances[distances.len() / 2];
        return (
            DEFAULT_SHARE * median,
            format!("{percent} % of the cameras' median distance; --size sets it"),
        );
    }
    let middle_half = (0..3)
        .map(|axis| {
            let mut values: Vec<f32> = scene.surfels.positions.iter().map(|p| p[axis]).collect();
            values.sort_by(f32::total_cmp);
            f64::from(values[values.len() * 3 / 4] - values[values.len() / 4])
        })
        .fold(0.0, f64::max);
    let size = if middle_half > 0.0 { DEFAULT_SHARE * middle_half } else { own };
    (size, format!("{percent} % of the scene's middle half; --size sets it"))
}
