//! What a composition leaves beside its frames: `composition.json`, preview, report.

use super::plan::{Config, Input, Plan};
use crate::report::{Picture, Report, ReportFrame};
use crate::stages::{eval, frames};
use crate::{PipelineError, Run, report};
use comgs_image::Image;
use comgs_scene::{CompositionRecord, EffectPolicy, ObjectRecord, ShadowPolicy, write_cameras};
use std::path::{Component, Path, PathBuf};

/// Milliseconds a frame in the animated preview: a composition's views are not a film, they want looking at.
const PREVIEW_MS: u32 = 700;
/// As above, for camera paths of many frames.
const PREVIEW_PATH_MS: u32 = 80;
/// From how many frames on cameras are taken for a path.
const PATH_FRAMES: usize = 24;

/// Writes `cameras.json` and `composition.json`.
pub(super) fn write_composition(
    plan: &Plan,
    input: &Input,
    config: &Config,
    run: &mut Run,
) -> Result<(), PipelineError> {
    let cameras = input.output.join("cameras.json");
    write_cameras(&cameras, &plan.cameras)?;
    run.output(&cameras)?;
    let record = CompositionRecord {
        version: comgs_scene::composition::COMPOSITION_VERSION,
        scene: relative(&plan.scene_path, &input.output)?,
        objects: plan
            .objects
            .iter()
            .map(|o| {
                Ok(ObjectRecord {
                    name: o.name.clone(),
                    asset: relative(&o.path, &input.output)?,
                    similarity: o.world_from_object.into(),
                })
            })
            .collect::<Result<_, PipelineError>>()?,
        light: Some(relative(&plan.environment, &input.output)?),
        light_at: plan.light_at.map(|at| at.to_array()),
        lamps: Vec::new(),
        effects: EffectPolicy {
            shadow: if config.shadow { ShadowPolicy::Traced } else { ShadowPolicy::None },
        },
        cameras: "cameras.json".into(),
    };
    let path = input.output.join("composition.json");
    record.write(&path)?;
    run.output(&path)
}

/// Writes `preview.gif` and `report.html` from the frames on disk.
pub(super) fn write_report(
    plan: &Plan,
    input: &Input,
    config: &Config,
    evaluation: Option<eval::Evaluation>,
    run: &mut Run,
) -> Result<(), PipelineError> {
    let start = std::time::Instant::now();
    let read = |folder: &str, name: &str| -> Result<Image, PipelineError> {
        Ok(comgs_image::read(&input.output.join(folder).join(format!("{name}.png")))?.color)
    };
    let names: Vec<&str> = plan.cameras.iter().map(|c| c.name.as_str()).collect();
    let shown: Vec<&str> = if names.len() > 4 * PATH_FRAMES {
        // A GIF of hundreds of frames is no preview.
        (0..4 * PATH_FRAMES).map(|k| names[k * names.len() / (4 * PATH_FRAMES)]).collect()
    } else {
        names.clone()
    };
    let pictures: Vec<Image> = shown.iter().map(|name| read("frames", name)).collect::<Result<_, _>>()?;
    let pace = if names.len() >= PATH_FRAMES { PREVIEW_PATH_MS } else { PREVIEW_MS };
    let preview = input.output.join("preview.gif");
    frames::write_gif(&preview, &pictures.iter().collect::<Vec<_>>(), pace)?;
    run.output(&preview)?;

    let mut light = Vec::new();
    if let Some(pictures) = &plan.light_pictures {
        let seen = plan.coverage.unwrap_or(0.0) * 100.0;
        light.push(Picture {
            caption: format!("The scene as the object sees it: {seen:.0} % of the sphere was reconstructed"),
            image: comgs_image::read(&pictures.sweep)?.color,
        });
    }
    light.push(Picture {
        caption: if plan.light_pictures.is_some() {
            "Completed (clipped for the screen; env.exr holds the radiance)".into()
        } else {
            "The light that was given (clipped for the screen)".into()
        },
        image: comgs_image::read(&plan.environment)?.color,
    });
    let count = names.len().min(report::MAX_FRAMES);
    let chosen: Vec<&str> = (0..count).map(|k| names[k * names.len() / count]).collect();
    let report_frames = chosen
        .iter()
        .map(|name| {
            Ok(ReportFrame {
                name: (*name).to_owned(),
                before: read("empty", name)?,
                after: read("frames", name)?,
            })
        })
        .collect::<Result<Vec<_>, PipelineError>>()?;
    let objects: Vec<&str> = plan.objects.iter().map(|o| o.name.as_str()).collect();
    let scene_name = scene_name(plan);
    run.add_time("preview", start.elapsed().as_secs_f64(), false);
    let page = Report {
        title: format!("{} in {scene_name}", objects.join(" and ")),
        summary: summary(plan, config, names.len()),
        frames: report_frames,
        all_frames: names.len(),
        light,
        evaluation,
        timings: run.timings().to_vec(),
        peak_memory_bytes: crate::record::peak_memory_bytes(),
        warnings: run.warnings().to_vec(),
        config: serde_json::to_string_pretty(config).unwrap_or_default(),
    };
    let path = input.output.join("report.html");
    report::write(&path, &page)?;
    run.output(&path)
}

/// The capture's name where the asset knows it.
fn scene_name(plan: &Plan) -> String {
    match &plan.scene.record.capture {
        Some(capture) => capture.name.clone(),
        None => crate::source::name_of(&plan.scene_path),
    }
}

fn summary(plan: &Plan, config: &Config, frames: usize) -> String {
    let surfels: usize = plan.objects.iter().map(|o| o.asset.surfels.len()).sum();
    let shadow = if config.shadow {
        format!("its shadow is traced with {} light samples a pixel", config.shadow_rays)
    } else {
        "it casts no shadow".to_owned()
    };
    format!(
        "{frames} frames of {}×{} pixels. The scene has {} surfels, the object {surfels}. The object keeps the look it \
         was captured with; {shadow}.",
        plan.cameras[0].width,
        plan.cameras[0].height,
        plan.scene.surfels.len()
    )
}

/// `path` as seen from `folder`, with forward slashes; absolute where they share nothing.
fn relative(path: &Path, folder: &Path) -> Result<String, PipelineError> {
    let canonical = |p: &Path| std::fs::canonicalize(p).map_err(|e| PipelineError::io(p, e));
    let (path, folder) = (canonical(path)?, canonical(folder)?);
    let text = |p: &Path| p.to_string_lossy().replace('\\', "/");
    let (a, b): (Vec<Component<'_>>, Vec<Component<'_>>) =
        (path.components().collect(), folder.components().collect());
    let shared = a.iter().zip(&b).take_while(|(x, y)| x == y).count();
    if shared == 0 {
        return Ok(text(&path));
    }
    let mut out: PathBuf = std::iter::repeat_n("..", b.len() - shared).collect();
    out.extend(&a[shared..]);
    Ok(if out.as_os_str().is_empty() { ".".to_owned() } else { text(&out) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: paths inside, beside and above the folder come out relative with forward slashes.
    #[test]
    fn relative_paths() {
        let root = tempfile::tempdir().unwrap();
        for folder in ["out", "out/scene.asset", "assets/cow.asset"] {
            std::fs::create_dir_all(root.path().join(folder)).unwrap();
        }
        let of = |path: &str| relative(&root.path().join(path), &root.path().join("out")).unwrap();
        assert_eq!(of("out/scene.asset"), "scene.asset");
        assert_eq!(of("assets/cow.asset"), "../assets/cow.asset");
        assert_eq!(of("out"), ".");
        assert!(relative(Path::new("/nonexistent/x"), root.path()).is_err());
    }
}
