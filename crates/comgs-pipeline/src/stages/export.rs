//! `export`: an asset's surfels as a bare PLY, for other programs.

use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, source};
use comgs_scene::AssetKind;
use comgs_surfel::ply::{PlyStyle, write_surfels};
use serde::Serialize;
use serde_json::json;
use std::path::PathBuf;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Asset or PLY.
    pub asset: PathBuf,
    /// The PLY to write.
    pub output: PathBuf,
}

/// Knobs of the stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Config {
    /// For viewers of 3D Gaussian splatting ([`PlyStyle::Viewer`]): three scales, harmonics of degree 3, no material.
    pub viewer: bool,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The PLY.
    pub ply: PathBuf,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record.
    pub record: RunRecord,
}

/// Writes the surfels. What the viewer's form cannot hold is said.
///
/// # Errors
/// [`PipelineError::Input`] when the output is not named `.ply`, or is the input; else as loading and writing have them.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("export");
    let refuse = |expected: &str| PipelineError::input("-o", expected, input.output.display().to_string());
    if source::extension(&input.output) != "ply" {
        return Err(refuse("a name that ends in .ply"));
    }
    let real = |path: &PathBuf| std::fs::canonicalize(path).ok();
    if real(&input.output).is_some_and(|output| Some(output) == real(&input.asset)) {
        return Err(refuse("a file other than the input"));
    }
    let mut run = Run::for_file("export", &input.output);
    run.check_output()?;
    let mut fingerprint = Fingerprint::new("export");
    fingerprint.surfels("asset", &input.asset)?;
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    let ply = input.output.clone();
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        return Ok(Output { ply, reused: true, record });
    }
    run.describe(fingerprint, json!({"asset": input.asset}), config, None)?;
    let asset = run.time("load", || source::load_surfels(&input.asset, AssetKind::Object))?;
    run.invalidate()?;
    let style = if config.viewer { PlyStyle::Viewer } else { PlyStyle::Asset };
    run.time("write", || write_surfels(&ply, &asset.surfels, style))
        .map_err(comgs_scene::SceneError::from)?;
    run.output(&ply)?;
    if config.viewer && asset.surfels.material.is_some() {
        context.progress.note("viewers show the captured colours; the material is left out");
    }
    run.results(json!({"surfels": asset.surfels.len()}));
    let record = run.finish()?;
    context.progress.end(&format!("{}: {} surfels", ply.display(), asset.surfels.len()));
    Ok(Output { ply, reused: false, record })
}
