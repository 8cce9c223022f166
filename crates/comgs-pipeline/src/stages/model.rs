//! `model check`: what a model bundle holds, whether it runs, and how fast.

use super::completers::{ModelConfig, read_bundle};
use crate::{Context, PipelineError};
use comgs_geom::equirect;
use comgs_image::Image;
use comgs_panorama::bundle::{HowExposed, Space};
use comgs_panorama::{Bundle, Completer, Learned, Partial, Runtime};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Says what a bundle holds and tries it on a made-up panorama with each runtime that is at hand.
///
/// * `folder`: of the bundle; the shipped one when absent
///
/// # Errors
/// [`PipelineError::Panorama`] with what is wrong.
pub fn run(
    folder: Option<&Path>,
    onnxruntime: Option<PathBuf>,
    context: &Context<'_>,
) -> Result<String, PipelineError> {
    let bundle = match folder {
        Some(folder) => read_bundle(folder).map_err(comgs_panorama::CompletionError::from)?,
        None => Bundle::shipped().map_err(comgs_panorama::CompletionError::from)?,
    };
    let m = &bundle.manifest;
    let mut text = String::new();
    let _ = writeln!(text, "{} ({})", m.name, bundle.origin);
    let _ = writeln!(text, "  {}", m.about);
    let _ = writeln!(text, "  licence     {}", m.licence);
    let _ = writeln!(text, "  resolution  {}×{}", m.resolution[0], m.resolution[1]);
    match &m.space {
        Space::Codes(space) => {
            let _ = writeln!(text, "  space       codes of high dynamic range; shown {:?}", space.condition);
        }
        Space::Latent(space) => {
            let _ = writeln!(
                text,
                "  space       latents 1/{}, {} channels; shown {:?}{}; exposures {:?} by {}",
                space.factor,
                space.channels,
                space.condition,
                if space.image.is_empty() {
                    String::new()
                } else {
                    format!(" and, full size, {:?}", space.image)
                },
                space.exposures.ev,
                match space.exposures.by {
                    HowExposed::Prompt { .. } => "prompt",
                    HowExposed::Network { .. } => "a network each",
                    HowExposed::Scalar { .. } => "a scalar",
                }
            );
        }
    }
    let _ = writeln!(
        text,
        "  schedule    {} steps, {:?}, predicts {:?}, {:?} spacing; {} taken by default",
        m.schedule.timesteps, m.schedule.betas, m.schedule.prediction, m.schedule.spacing, m.steps
    );
    for (role, graph) in &m.graphs {
        let _ = writeln!(text, "  {role:<11} {} (checksum right)", graph.file);
    }
    let _ = writeln!(text, "  size        {:.1} MB", bundle.bytes() as f64 / 1e6);
    let native = ModelConfig { onnxruntime, ..ModelConfig::shipped() }.runtime();
    let runtimes = if native == Runtime::Embedded { vec![native] } else { vec![Runtime::Embedded, native] };
    let partial = half_a_room(m.resolution[1])?;
    let mut first: Option<Image> = None;
    for runtime in runtimes {
        context.check()?;
        let started = Instant::now();
        let learned =
            Learned::new(&bundle, &runtime, Some(1), 0).map_err(comgs_panorama::CompletionError::from)?;
        let load = started.elapsed();
        learned.complete(&partial, 0)?;
        let started = Instant::now();
        let image = learned.complete(&partial, 0)?;
        let _ = writeln!(
            text,
            "  {}: loads in {:.2} s, a step takes {:.3} s",
            runtime.name(),
            load.as_secs_f64(),
            started.elapsed().as_secs_f64()
        );
        if let Some(first) = &first {
            let off = first
                .data
                .iter()
                .zip(&image.data)
                .map(|(a, b)| f64::from((a - b).abs() / (1.0 + a.abs())))
                .fold(0.0, f64::max);
            let _ = writeln!(text, "  the two agree to {off:.1e}");
        } else {
            first = Some(image);
        }
    }
    Ok(text)
}

/// A made-up room whose lower half is known.
fn half_a_room(height: usize) -> Result<Partial, PipelineError> {
    let width = 2 * height;
    let (mut rgb, mut alpha) = (Image::zeros(width, height, 3), Image::zeros(width, height, 1));
    for y in 0..height {
        for x in 0..width {
            let d = equirect::texel_direction(x, y, width, height);
            let value = [0.4 + 0.2 * d.x, 0.35 + 0.1 * d.y, 0.3 - 0.1 * d.z];
            rgb.pixel_mut(x, y).copy_from_slice(&value);
            alpha.data[y * width + x] = f32::from(u8::from(d.z < 0.2));
        }
    }
    Ok(Partial::new(rgb, alpha)?)
}
