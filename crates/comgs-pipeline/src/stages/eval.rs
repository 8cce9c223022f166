//! `eval`: scores against ground truth, by [`comgs_metrics`], which shares no kernel with what it judges.

pub mod asset;
pub mod composition;
pub mod relit;
pub mod table;

pub use table::{Section, Table};

use crate::source::Source;
use crate::{Context, PipelineError, output, record::write_json};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// An asset or PLY, or a folder of frames (`<name>.png`, or `frames/<name>.png`).
    pub subject: PathBuf,
    /// A capture with test views, or a composition with `images/`, `mask/` and `empty/`.
    pub against: PathBuf,
    /// Ground truth of an asset under other lights: a folder `object_relit/NAME` ([`relit::evaluate`]).
    pub relit: Option<PathBuf>,
    /// Where to write the scores as JSON.
    pub json: Option<PathBuf>,
}

/// All scores of one evaluation.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// What was judged.
    pub subject: String,
    /// Against what.
    pub against: String,
    /// Tables: the subject, and baselines.
    pub sections: Vec<Section>,
    /// What could not be compared, and other remarks.
    pub remarks: Vec<String>,
}

impl Evaluation {
    /// A section by name.
    #[must_use]
    pub fn section(&self, name: &str) -> Option<&Section> {
        self.sections.iter().find(|s| s.name == name)
    }

    /// Everything as text for a terminal.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!("{} against {}\n", self.subject, self.against);
        for section in &self.sections {
            text.push_str(&format!("\n{} – {}\n{}", section.name, section.what, section.table.to_text()));
        }
        for remark in &self.remarks {
            text.push_str(&format!("\nnote: {remark}\n"));
        }
        text
    }
}

/// Scores an asset against a capture's held-out views, or frames against a composition's or capture's pictures.
///
/// # Errors
/// [`PipelineError`] when subject and truth do not fit together, or a picture cannot be read.
pub fn run(input: &Input, context: &Context<'_>) -> Result<Evaluation, PipelineError> {
    context.progress.begin("eval");
    if let Some(path) = &input.json {
        output::check_file(path)?;
    }
    let mut evaluation = if is_frames(&input.subject) {
        if let Some(root) = &input.relit {
            let got = format!("frames, {}", input.subject.display());
            return Err(PipelineError::input(root.display().to_string(), "an asset to relight", got));
        }
        composition::evaluate(&input.subject, &input.against, context)?
    } else {
        match Source::of(&input.subject)? {
            Source::Capture(folder) => {
                return Err(PipelineError::input(
                    folder.display().to_string(),
                    "an asset, a PLY of surfels, or a folder of frames (<name>.png or frames/<name>.png)",
                    "none of these",
                ));
            }
            _ => asset::evaluate(&input.subject, &input.against, context)?,
        }
    };
    if let Some(root) = &input.relit {
        let (sections, remarks) =
            relit::evaluate(&input.subject, &input.against, root, &relit::settings(), context)?;
        evaluation.sections.extend(sections);
        evaluation.remarks.extend(remarks);
    }
    if let Some(path) = &input.json {
        write_json(path, &evaluation)?;
    }
    let views = evaluation.sections.first().map_or(0, |s| s.table.rows.len());
    context.progress.end(&format!("{views} views compared"));
    Ok(evaluation)
}

/// Whether a path is a folder of frames and not an asset.
fn is_frames(path: &Path) -> bool {
    path.is_dir() && !comgs_scene::Asset::is_asset(path) && frames_folder(path).is_some()
}

/// The folder that holds the PNGs of a set of frames.
pub(crate) fn frames_folder(path: &Path) -> Option<PathBuf> {
    [path.join("frames"), path.to_owned()].into_iter().find(|folder| !pngs(folder).is_empty())
}

/// Names (without extension) of the PNGs in a folder, sorted.
pub(crate) fn pngs(folder: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<String> = entries
        .flatten()
        .filter_map(|e| e.file_name().to_string_lossy().strip_suffix(".png").map(str::to_owned))
        .filter(|name| !name.starts_with('.'))
        .collect();
    names.sort();
    names
}
