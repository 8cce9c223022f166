//! An asset against a capture's held-out views.

use crate::stages::eval::table::{Column, Section, Table};
use crate::stages::{eval::Evaluation, render};
use crate::{Context, PipelineError, Status, source};
use comgs_image::Image;
use comgs_metrics::{
    MetricError, ScaleFit, material_error, normal_error, psnr_srgb, score, unbiased_depth_error,
    unbiased_plane_error,
};
use comgs_raster::Frame;
use comgs_scene::{Asset, AssetKind, Capture, LoadOptions, Split, View, ViewRecord};
use std::path::{Path, PathBuf};

/// Weight under which a rendered pixel has no depth, roughness or metallic.
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
        column(ALIGNED, "albedo dB (aligned)", 2),
        column(UNALIGNED, "albedo dB", 2),
        column("roughness.mae", "roughness MAE", 4),
        column("metallic.mae", "metallic MAE", 4),
    ]
}

const ALIGNED: &str = "albedo.aligned_psnr_db";
const UNALIGNED: &str = "albedo.psnr_db";

/// Renders every test view and compares.
///
/// Pictures are compared as a viewer sees them (sRGB, clipped to [0, 1]), both over black: a capture with masks is
/// multiplied by its alpha. Normals and depths are compared where the capture has them (`normal/`, `depth/` beside
/// `images/`), inside the mask.
///
/// Material is compared where the asset and the capture (`albedo/`, `roughness/`, `metallic/`) both have it. Albedo is
/// compared like the pictures, over black: the rendered plane as it is, Σ T α a, and the truth times its alpha; once as it is
/// and once after the least-squares scale a channel over the masked pixels of all views ([`ScaleFit`]). Roughness and
/// metallic are divided by the rendered weight and compared inside the mask.
pub(super) fn evaluate(
    subject: &Path,
    against: &Path,
    context: &Context<'_>,
) -> Result<Evaluation, PipelineError> {
    let asset = source::load_surfels(subject, AssetKind::Scene)?;
    let capture = Capture::open(against, Split::Test)?;
    let mut table = Table { columns: columns(), rows: Vec::new() };
    let mut masked = false;
    let mut albedo = ScaleFit::default();
    let mut with_albedo = Vec::new();
    for (i, record) in capture.views.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(i as f64 / capture.views.len() as f64),
            message: format!("view {}", record.camera.name),
            remaining: None,
        });
        let view = record.load(&LoadOptions::default())?;
        masked |= view.alpha.is_some();
        let frame = render::render(&asset, &view.camera);
        let mut row = compare(&frame, &view, record)?;
        row.extend([None, None]);
        row.extend(planes(&frame, &view, record)?);
        table.rows.push((view.camera.name.clone(), row));
        if let Some((estimate, truth)) = albedo_pair(&frame, &view, record)? {
            albedo.add(&estimate, &truth, view.alpha.as_ref()).map_err(failed(&view.camera.name))?;
            with_albedo.push(i);
        }
    }
    let mut remarks = Vec::new();
    remarks.extend(align(&asset, &capture, &albedo, &with_albedo, &mut table, context)?);
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

fn failed(view: &str) -> impl Fn(MetricError) -> PipelineError {
    move |e| PipelineError::input(format!("view {view}"), "comparable pictures", e.to_string())
}

/// Pictures, normals and depths.
fn compare(frame: &Frame, view: &View, record: &ViewRecord) -> Result<Vec<Option<f64>>, PipelineError> {
    let truth = over_black(view);
    let failed = failed(&view.camera.name);
    let scores = score(render::color(frame), &truth, view.valid.as_ref()).map_err(&failed)?;
    let in_mask = match &view.alpha {
        Some(alpha) => optional(psnr_srgb(render::color(frame), &truth, Some(alpha))).map_err(&failed)?,
        None => None,
    };
    let mask = view.alpha.as_ref();
    let normal = match plane(record, "normal", &view.camera)? {
        Some(truth) => optional(normal_error(&render::unit_normals(frame, &view.camera), &truth, mask))
            .map_err(&failed)?,
        None => None,
    };
    let depth = match (plane(record, "depth", &view.camera)?, &frame.depth) {
        (Some(truth), Some(depth)) => {
            let truth = truth.select(&[0]);
            optional(unbiased_depth_error(depth, &frame.weight, &truth, MIN_WEIGHT, mask)).map_err(&failed)?
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

/// Mean absolute errors of roughness and metallic.
fn planes(frame: &Frame, view: &View, record: &ViewRecord) -> Result<[Option<f64>; 2], PipelineError> {
    let mut errors = [None, None];
    let Some(material) = &frame.material else { return Ok(errors) };
    for (k, folder) in ["roughness", "metallic"].into_iter().enumerate() {
        if let Some(truth) = plane(record, folder, &view.camera)? {
            let (sum, truth) = (material.select(&[3 + k]), truth.select(&[0]));
            let mask = view.alpha.as_ref();
            let error = optional(unbiased_plane_error(&sum, &frame.weight, &truth, MIN_WEIGHT, mask));
            errors[k] = error.map_err(failed(&view.camera.name))?.map(|e| e.mae);
        }
    }
    Ok(errors)
}

/// Rendered and true albedo, both over black.
pub(super) fn albedo_pair(
    frame: &Frame,
    view: &View,
    record: &ViewRecord,
) -> Result<Option<(Image, Image)>, PipelineError> {
    let Some(material) = &frame.material else { return Ok(None) };
    let Some(truth) = plane(record, "albedo", &view.camera)? else { return Ok(None) };
    let truth = times_alpha(truth, view.alpha.as_ref());
    Ok(Some((material.select(&[0, 1, 2]), truth)))
}

/// Fills in the albedo columns, now that the scale of the whole set is known; says what it is. Views are rendered
/// again: keeping them all would need memory in proportion to their number.
fn align(
    asset: &Asset,
    capture: &Capture,
    fit: &ScaleFit,
    views: &[usize],
    table: &mut Table,
    context: &Context<'_>,
) -> Result<Option<String>, PipelineError> {
    // Without a counting pixel there is no scale.
    let Ok(scale) = fit.scale(true) else { return Ok(None) };
    let position = |key| table.columns.iter().position(|c| c.key == key).unwrap_or_default();
    let (aligned, unaligned) = (position(ALIGNED), position(UNALIGNED));
    let mut in_mask = Vec::new();
    for (k, &i) in views.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(k as f64 / views.len() as f64),
            message: format!("albedo of view {}", table.rows[i].0),
            remaining: None,
        });
        let record = &capture.views[i];
        let view = record.load(&LoadOptions::default())?;
        let frame = render::render(asset, &view.camera);
        if let Some((estimate, truth)) = albedo_pair(&frame, &view, record)? {
            let error = material_error(&estimate, &truth, view.alpha.as_ref(), scale);
            let error = error.map_err(failed(&view.camera.name))?;
            table.rows[i].1[aligned] = Some(error.aligned.frame.db);
            table.rows[i].1[unaligned] = Some(error.unaligned.frame.db);
            if let (Some(a), Some(u)) = (error.aligned.in_mask, error.unaligned.in_mask) {
                in_mask.push((a.db, u.db));
            }
        }
    }
    let [r, g, b] = scale;
    let mut remark = format!(
        "aligned albedo is the rendered one times {r:.3} {g:.3} {b:.3}: the linear least-squares scale of each channel over \
         {} views",
        views.len()
    );
    if !in_mask.is_empty() {
        let n = in_mask.len() as f64;
        let (a, u) = in_mask.iter().fold((0.0, 0.0), |(a, u), (x, y)| (a + x / n, u + y / n));
        remark.push_str(&format!("; albedo inside the mask: {a:.2} dB aligned, {u:.2} dB as it is"));
    }
    Ok(Some(remark))
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
    times_alpha(view.color.clone(), view.alpha.as_ref())
}

/// A picture of straight alpha over black.
pub(super) fn times_alpha(mut color: Image, alpha: Option<&Image>) -> Image {
    if let Some(alpha) = alpha {
        for (pixel, a) in color.data.chunks_exact_mut(color.channels).zip(&alpha.data) {
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
