//! `shadow`: the editing stage's occlusion cache of a composition.

use crate::stages::editing::{Composition, Settings, bake};
use crate::{Context, PipelineError, Run, RunRecord};
use serde_json::json;
use std::path::PathBuf;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// `composition.json`.
    pub composition: PathBuf,
    /// Folder of the occlusion fields.
    pub output: PathBuf,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// Different objects.
    pub objects: usize,
    /// Bytes of their fields.
    pub bytes: usize,
    /// Seconds of baking; fields that were there already cost nothing.
    pub seconds: f64,
    /// Fields that were there already.
    pub read: usize,
    /// The record.
    pub record: RunRecord,
}

/// Bakes the occlusion field of every object: `<object>-<hash>.occlusion`. The hash is of the object and the resolution:
/// moving, turning or scaling an object bakes nothing anew, and one folder may serve many compositions.
///
/// # Errors
/// [`PipelineError`].
pub fn run(input: &Input, settings: &Settings, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("occlusion of the objects");
    let mut run = Run::in_folder("shadow", &input.output);
    run.check_output()?;
    let composition = Composition::load(&input.composition, None, |text| run.warn(context, text))?;
    let mut fingerprint = composition.fingerprint("shadow")?;
    fingerprint.config("settings", settings)?;
    run.describe(fingerprint.finish(), json!({"composition": input.composition}), settings, None)?;
    std::fs::create_dir_all(&input.output).map_err(|e| PipelineError::io(&input.output, e))?;
    // What another composition has baked here stays.
    let baked = bake(&composition, settings, Some(&input.output), context)?;
    for path in &baked.written {
        run.output(path)?;
    }
    run.add_time("occlusion", baked.seconds, baked.read == baked.len());
    run.results(json!({
        "objects": baked.len(),
        "bytes": baked.bytes(),
        "read": baked.read,
        "directions": settings.field().directions,
        "resolution": settings.field().resolution,
    }));
    let (objects, bytes, seconds, read) = (baked.len(), baked.bytes(), baked.seconds, baked.read);
    let record = run.finish()?;
    context.progress.end(&format!("{objects} objects, {:.1} MB, {seconds:.2} s", bytes as f64 / 1e6));
    Ok(Output { objects, bytes, seconds, read, record })
}
