//! `panorama complete`: a partial panorama made whole.

use super::completers::{self, Fill, ModelConfig};
use crate::source::extension;
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord};
use comgs_image::transfer::linear_from_srgb;
use comgs_image::{Encoding, Image, read, write_exr, write_hdr, write_png};
use comgs_panorama::Partial;
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Equirectangular radiance (EXR or HDR), or a picture, of which only the masked part counts.
    pub partial: PathBuf,
    /// What is known: white (over ½) = known. The alpha of `partial` when absent.
    pub mask: Option<PathBuf>,
    /// World normals of what is known (EXR, 3 channels).
    pub normals: Option<PathBuf>,
    /// The map to write (`.exr` or `.hdr`).
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// What fills the rest.
    pub completion: Fill,
    /// How a learned model is run.
    pub model: ModelConfig,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The map.
    pub environment: PathBuf,
    /// Its picture.
    pub picture: PathBuf,
    /// What filled it.
    pub by: String,
    /// Share of the sphere that was known.
    pub coverage: f64,
    /// The record.
    pub record: RunRecord,
}

/// Completes a panorama from files.
///
/// # Errors
/// [`PipelineError`]: maps of different sizes or of the wrong aspect, a mask that is all known or all unknown, a model that
/// cannot be used.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("panorama");
    let mut run = Run::for_file("panorama", &input.output);
    if !matches!(extension(&input.output).as_str(), "exr" | "hdr") {
        let expected = "a name that ends in .exr or .hdr (a picture cannot hold the light)";
        return Err(PipelineError::input("-o", expected, input.output.display().to_string()));
    }
    for (what, path) in
        [("input", Some(&input.partial)), ("mask", input.mask.as_ref()), ("normals", input.normals.as_ref())]
    {
        path.map_or(Ok(()), |path| crate::output::refuse_input(&input.output, what, path))?;
    }
    let mut fingerprint = Fingerprint::new("panorama");
    fingerprint.path("input", &input.partial)?;
    for (name, path) in [("mask", &input.mask), ("normals", &input.normals), ("model", &config.model.model)] {
        if let Some(path) = path {
            fingerprint.path(name, path)?;
        }
    }
    fingerprint.config("config", config)?;
    run.check_output()?;
    let inputs = json!({"input": input.partial, "mask": input.mask, "normals": input.normals});
    run.describe(fingerprint.finish(), inputs, config, Some(config.model.seed))?;
    let partial = run.time("load", || load(input))?;
    let coverage = partial.coverage();
    if !(coverage > 0.0 && coverage < 1.0) {
        let what = if coverage > 0.0 { "all known" } else { "all unknown" };
        let expected = "a panorama of which a part is known and a part is not";
        return Err(PipelineError::input("the mask", expected, what.to_owned()));
    }
    let broken = partial.rgb.data.chunks_exact(3).zip(&partial.alpha.data);
    let broken = broken.filter(|(rgb, a)| **a > 0.0 && rgb.iter().any(|v| !v.is_finite())).count();
    if broken > 0 {
        run.warn(
            context,
            format!("{broken} texels that should be known are no numbers and count as unknown"),
        );
    }
    let started = std::time::Instant::now();
    let completed = completers::complete(&partial, config.completion, &config.model, &mut run, context)?;
    run.add_time("complete", started.elapsed().as_secs_f64(), false);
    let picture = input.output.with_extension("png");
    if extension(&input.output) == "hdr" {
        write_hdr(&input.output, &completed.image)?;
    } else {
        write_exr(&input.output, &completed.image)?;
    }
    write_png(&picture, &exposed(&completed.image))?;
    run.output(&input.output)?;
    run.output(&picture)?;
    run.results(json!({"coverage": coverage, "completer": completed.by, "runtime": completed.runtime}));
    let record = run.finish()?;
    let summary =
        format!("{}: {:.0} % known, the rest by {}", input.output.display(), 100.0 * coverage, completed.by);
    context.progress.end(&summary);
    Ok(Output { environment: input.output.clone(), picture, by: completed.by, coverage, record })
}

fn load(input: &Input) -> Result<Partial, PipelineError> {
    let loaded = read(&input.partial)?;
    let rgb = loaded.color;
    let (width, height) = (rgb.width, rgb.height);
    if rgb.channels != 3 {
        let got = format!("{} channels: {}", rgb.channels, input.partial.display());
        return Err(PipelineError::input("--input", "a colour panorama", got));
    }
    let alpha = match (&input.mask, loaded.alpha) {
        (Some(path), _) => {
            let mask = read_mask(path)?;
            fitting("--mask", path, &mask, width, height)?;
            mask
        }
        (None, Some(alpha)) => alpha,
        (None, None) => {
            let expected = "a mask, or an alpha channel in the input";
            return Err(PipelineError::input("--mask", expected, "neither".to_owned()));
        }
    };
    let normal = match &input.normals {
        Some(path) => {
            let normal = read(path)?.color;
            if normal.channels != 3 {
                let got = format!("{} channels: {}", normal.channels, path.display());
                return Err(PipelineError::input("--normals", "3 channels", got));
            }
            fitting("--normals", path, &normal, width, height)?;
            Some(normal)
        }
        None => None,
    };
    let partial = Partial { normal, ..Partial::new(rgb, alpha)? };
    partial.check()?;
    Ok(partial)
}

/// A mask file as 0 and 1: white, over half of the code range, is 1.
pub(super) fn read_mask(path: &Path) -> Result<Image, PipelineError> {
    let loaded = read(path)?;
    // Pictures were made linear on reading; the half that is meant is that of their codes.
    let half = if loaded.encoding == Encoding::Srgb { linear_from_srgb(0.5) } else { 0.5 };
    Ok(loaded.color.select(&[0]).map(|v| f32::from(u8::from(v > half))))
}

fn fitting(what: &str, path: &Path, image: &Image, width: usize, height: usize) -> Result<(), PipelineError> {
    if (image.width, image.height) == (width, height) {
        return Ok(());
    }
    let got = format!("{}×{}: {}", image.width, image.height, path.display());
    Err(PipelineError::input(what, format!("the input's size, {width}×{height}"), got))
}

/// For a picture: exposed so that the mean of the log radiance is middle grey.
#[must_use]
pub fn exposed(image: &Image) -> Image {
    let mut sum = 0.0f64;
    for pixel in image.data.chunks_exact(3) {
        sum += f64::from(pixel[0] + pixel[1] + pixel[2]).max(1e-6).ln();
    }
    let mean = (sum / image.pixels().max(1) as f64).exp() / 3.0;
    image.map(|v| v * (0.25 / mean) as f32)
}
