//! An asset against a capture's held-out views.

use crate::stages::eval::table::{Column, Section, Table};
use crate::stages::{eval::Evaluation, render};
use crate::{Context, PipelineError, Status, source};
use comgs_image::Image;
use comgs_metrics::{MetricError, normal_error, psnr_srgb, score, unbiased_depth_error};
use comgs_scene::{Asset, AssetKind, Capture, LoadOptions, Split, View, ViewRecord};
use std::path::{Path, PathBuf};

/// Weight under which a rendered pixel has no depth.
const MIN_WEIGHT: f64 = 0.5;

fn columns() -> Vec<Column> {
    let column = |key, label, digits| Column { key, label, digits };
    vec![
        column("psnr_db", "PSNR dB", 2),
        column("ssim", "SSIM", 4),
        column("flip", "ꟻLIP", 4),
        column("masked.psnr_db", "PSNR in mask", 2),
        column("normal.mean_deg", "normal °", 2),
        column("depth.mae", "depth MAE", 4),
        column("depth.abs_rel", "depth rel", 4),
    ]
}

/// Renders every test view and compares.
///
/// Pictures are compared as a viewer sees them (sRGB, clipped to [0, 1]), both over black: a capture with masks is
/// multiplied by its alpha. Normals and depths are compared where the capture has them (`normal/`, `depth/` beside
/// `images/`), inside the mask.
pub(super) fn evaluate(
    subject: &Path,
    against: &Path,
    context: &Context<'_>,
) -> Result<Evaluation, PipelineError> {
    let asset = source::load_surfels(subject, AssetKind::Scene)?;
    let capture = Capture::open(against, Split::Test)?;
    let mut table = Table { columns: columns(), rows: Vec::new() };
    let mut masked = false;
    for (i, record) in capture.views.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(i as f64 / capture.views.len() as f64),
            message: format!("view {}", record.camera.name),
            remaining: None,
        });
        let view = record.load(&LoadOptions::default())?;
        masked |= view.alpha.is_some();
        let row = compare(&asset, &view, record)?;
        table.rows.push((view.camera.name.clone(), row));
    }
    let mut remarks = Vec::new();
    if capture.held_out {
        remarks.push(format!(
            "the capture has no test split of its own; every {}th view was held out of training",
            comgs_scene::capture::HOLD_OUT_EVERY
        ));
    }
    for name in &capture.report.left_out {
        remarks.push(format!("view {name} is listed but has no image; left out"));
    }
    let what = format!(
        "{} test views, sRGB clipped to [0, 1]{}",
        table.rows.len(),
        if masked { ", over black" } else { "" }
    );
    let section = Section { name: "test".into(), what, table: table.without_empty_columns() };
    Ok(Evaluation {
        subject: subject.display().to_string(),
        against: against.display().to_string(),
        sections: vec![section],
        remarks,
    })
}

fn compare(asset: &Asset, view: &View, record: &ViewRecord) -> Result<Vec<Option<f64>>, PipelineError> {
    let frame = render::render(asset, &view.camera);
    let truth = over_black(view);
    let name = &view.camera.name;
    let failed =
        |e: MetricError| PipelineError::input(format!("view {name}"), "comparable pictures", e.to_string());
    let scores = score(render::color(&frame), &truth, view.valid.as_ref()).map_err(failed)?;
    let in_mask = match &view.alpha {
        Some(alpha) => optional(psnr_srgb(render::color(&frame), &truth, Some(alpha))).map_err(failed)?,
        None => None,
    };
    let mask = view.alpha.as_ref();
    let normal = match plane(record, "normal", &view.camera)? {
        Some(truth) => optional(normal_error(&render::unit_normals(&frame), &truth, mask)).map_err(failed)?,
        None => None,
    };
    let depth = match (plane(record, "depth", &view.camera)?, &frame.depth) {
        (Some(truth), Some(depth)) => {
            let truth = truth.select(&[0]);
            optional(unbiased_depth_error(depth, &frame.weight, &truth, MIN_WEIGHT, mask)).map_err(failed)?
        }
        _ => None,
    };
    Ok(vec![
        Some(scores.psnr_db),
        scores.ssim,
        Some(scores.flip),
        in_mask.map(|p| p.db),
        normal.map(|n| n.mean_deg),
        depth.map(|d| d.mae),
        depth.map(|d| d.abs_rel),
    ])
}

/// A metric that finds nothing to measure has no value; other failures are errors.
fn optional<T>(result: Result<T, MetricError>) -> Result<Option<T>, MetricError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(MetricError::NothingToMeasure { .. }) => Ok(None),
        Err(other) => Err(other),
    }
}

/// The photograph, multiplied by its alpha.
pub(super) fn over_black(view: &View) -> Image {
    let mut color = view.color.clone();
    if let Some(alpha) = &view.alpha {
        for (pixel, a) in color.data.chunks_exact_mut(3).zip(&alpha.data) {
            pixel.iter_mut().for_each(|v| *v *= a);
        }
    }
    color
}

/// A ground-truth plane of a view: `<folder>/<name>.exr` beside the folder of its image.
fn plane(
    record: &ViewRecord,
    folder: &str,
    camera: &comgs_geom::Camera,
) -> Result<Option<Image>, PipelineError> {
    let beside = record.image.parent().and_then(Path::parent);
    let path: Option<PathBuf> =
        beside.map(|p| p.join(folder).join(format!("{}.exr", camera.name))).filter(|p| p.is_file());
    let Some(path) = path else { return Ok(None) };
    let image = comgs_image::read(&path)?.color;
    let fits = (image.width, image.height) == (camera.width, camera.height);
    // A straightened photograph is no longer the picture that the plane belongs to.
    Ok((fits && record.lens.is_pinhole()).then_some(image))
}
