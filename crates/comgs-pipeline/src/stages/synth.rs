//! `synth`: captures with exact ground truth from a recipe.

use crate::{Context, PipelineError, Run, RunRecord, Status};
pub use comgs_synth::Overrides;
use comgs_synth::{Recipe, SynthError, builtin, write_root};
use serde_json::json;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Name of a built-in recipe, or a recipe file.
    pub recipe: String,
    /// The root to write: a new or empty folder.
    pub output: PathBuf,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The recipe as rendered.
    pub recipe: Recipe,
    /// The record; beside the root (`<root>.run.json`), because a root holds nothing but itself.
    pub record: RunRecord,
}

/// The names of the built-in recipes.
#[must_use]
pub fn builtin_names() -> &'static [&'static str] {
    &builtin::NAMES
}

/// Renders a recipe into a SynCom root.
///
/// # Errors
/// [`PipelineError::Synth`] for an unknown or unsound recipe, or a root that is not empty; [`PipelineError::Cancelled`].
pub fn run(input: &Input, overrides: &Overrides, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("synth");
    let recipe = read_recipe(&input.recipe)?.with(overrides);
    let mut run = Run::beside("synth", &input.output);
    let result = write_root(&recipe, &input.output, &mut |p| {
        context.progress.update(&Status {
            fraction: Some(p.fraction),
            message: p.doing.to_owned(),
            remaining: None,
        });
        if context.cancel.is_cancelled() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    let summary = result.map_err(|e| match e {
        SynthError::Stopped => PipelineError::Cancelled {
            kept: Some(format!("{} is incomplete and can be deleted", input.output.display())),
        },
        other => other.into(),
    })?;
    run.describe(String::new(), json!({"recipe": input.recipe}), &recipe, Some(recipe.seed))?;
    run.add_time("path trace", summary.seconds, false);
    run.results(json!({"files": summary.files, "paths": summary.paths}));
    let record = run.finish()?;
    context.progress.end(&format!("{}: {} files", input.output.display(), summary.files));
    Ok(Output { recipe, record })
}

/// A recipe file, or a built-in recipe by name.
fn read_recipe(name: &str) -> Result<Recipe, PipelineError> {
    let path = Path::new(name);
    if !path.is_file() {
        return Ok(builtin::recipe(name)?);
    }
    let text = std::fs::read_to_string(path).map_err(|e| PipelineError::io(path, e))?;
    Ok(Recipe::from_json(&text)?)
}
