//! Pictures of how a light came about.

use crate::PipelineError;
use crate::stages::completers::Completed;
use crate::stages::panorama::exposed;
use comgs_image::transfer::linear_from_srgb;
use comgs_image::{Image, write_exr, write_png};
use comgs_metrics::spheres::{SPHERES, picture};
use comgs_panorama::{Partial, Sweep};
use std::path::{Path, PathBuf};

/// Writes into `folder`: what was seen, how much of it, clipped texels, normals, depth, the completed map, three spheres
/// under it, and with several samples each of them and their spread.
pub(super) fn write(
    folder: &Path,
    seen: &Sweep,
    partial: &Partial,
    completed: &Completed,
) -> Result<Vec<PathBuf>, PipelineError> {
    std::fs::create_dir_all(folder).map_err(|e| PipelineError::io(folder, e))?;
    let mut files = Vec::new();
    let mut png = |name: String, image: &Image| -> Result<(), PipelineError> {
        let path = folder.join(name);
        write_png(&path, image)?;
        files.push(path);
        Ok(())
    };
    let code = |v: f32| linear_from_srgb(v.clamp(0.0, 1.0));
    let mut known = seen.rgb.clone();
    for (pixel, &a) in known.data.chunks_exact_mut(3).zip(&seen.alpha.data) {
        pixel.iter_mut().for_each(|v| *v *= a);
    }
    png("1_seen.png".into(), &known)?;
    png("2_coverage.png".into(), &seen.alpha.map(code))?;
    if let Some(clipped) = &partial.clipped {
        png("3_clipped.png".into(), &clipped.map(code))?;
    }
    png("4_normals.png".into(), &seen.normal.map(|v| code(0.5 + 0.5 * v)))?;
    let far = seen.depth.data.iter().copied().fold(0.0f32, f32::max).max(1e-9);
    png("5_depth.png".into(), &seen.depth.map(|v| code(v / far)))?;
    png("6_completed.png".into(), &exposed(&completed.image))?;
    png("7_spheres.png".into(), &spheres(&completed.image))?;
    for (i, sample) in completed.samples.iter().enumerate() {
        png(format!("8_sample_{i}.png"), &exposed(sample))?;
    }
    if let Some(spread) = &completed.spread {
        png("9_spread.png".into(), &exposed(spread))?;
        let path = folder.join("spread.exr");
        write_exr(&path, spread)?;
        files.push(path);
    }
    Ok(files)
}

/// Mirror, glossy and diffuse sphere side by side, exposed so that the diffuse one has a mean of ½.
fn spheres(map: &Image) -> Image {
    let pictures = SPHERES.map(|s| picture(map, s).0);
    let side = pictures[0].width;
    let inside = std::f32::consts::FRAC_PI_4;
    let mean = pictures[2].data.iter().sum::<f32>() / (pictures[2].data.len() as f32 * inside);
    let gain = if mean > 0.0 { 0.5 / mean } else { 1.0 };
    let mut out = Image::zeros(3 * side, side, 3);
    for (k, picture) in pictures.iter().enumerate() {
        for y in 0..side {
            for x in 0..side {
                let value = picture.rgb(x, y).map(|v| v * gain);
                out.pixel_mut(k * side + x, y).copy_from_slice(&value);
            }
        }
    }
    out
}
