//! The root on disk. The only module here that knows files.

use crate::produce::{Content, Output, Progress, generate_checked};
use crate::{Recipe, SynthError};
use comgs_image::{WriteError, atomic, transfer, write_exr, write_png};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Number of files.
    pub files: usize,
    /// Paths traced.
    pub paths: f64,
    /// Wall time in seconds.
    pub seconds: f64,
}

/// Renders a recipe into a new or empty folder. Every file is written beside its place and renamed; `recipe.json`, from
/// which the same root can be made again, comes last and marks a root as whole.
///
/// # Errors
/// [`SynthError::NotEmpty`], [`SynthError::Recipe`], [`SynthError::Write`] naming the file, [`SynthError::Stopped`].
pub fn write_root(
    recipe: &Recipe,
    root: &Path,
    progress: &mut dyn FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Summary, SynthError> {
    let started = Instant::now();
    recipe.check()?;
    let failed = |e: std::io::Error| WriteError { path: root.to_owned(), reason: e.to_string() };
    std::fs::create_dir_all(root).map_err(failed)?;
    if std::fs::read_dir(root).map_err(failed)?.next().is_some() {
        return Err(SynthError::NotEmpty(root.to_owned()));
    }
    let mut files = 0;
    generate_checked(
        recipe,
        &mut |output| {
            files += 1;
            Ok(write(root, &output)?)
        },
        progress,
    )?;
    Ok(Summary { files, paths: crate::produce::paths(recipe), seconds: started.elapsed().as_secs_f64() })
}

/// Writes one file of a root.
///
/// # Errors
/// [`WriteError`]; the file is then as it was.
pub fn write(root: &Path, output: &Output) -> Result<(), WriteError> {
    let path = root.join(&output.path);
    match &output.content {
        Content::Exr(image) => write_exr(&path, image),
        Content::Png(image) => write_png(&path, image),
        // The PNG writer encodes to sRGB; coverage is stored as it is, so the encoding is undone beforehand.
        Content::Coverage(image) => write_png(&path, &image.map(transfer::linear_from_srgb)),
        Content::Json(value) => atomic::write_file(&path, |w| {
            serde_json::to_writer_pretty(&mut *w, value)?;
            w.write_all(b"\n")
        })
        .map_err(|e| WriteError { path, reason: e.to_string() }),
    }
}
