//! What can go wrong in a stage.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// An error of a stage, in words for the person at the terminal; the path comes last.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// A file could not be read or written.
    #[error("{reason}: {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// Results cannot be written where they should go.
    #[error("cannot {doing} the output folder {}: {reason}", folder.display())]
    Output {
        /// `create` or `write into`.
        doing: &'static str,
        /// The folder.
        folder: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// An input is not what the stage needs: what, expected, got.
    #[error("{what}: expected {expected}, got {got}")]
    Input {
        /// Which input.
        what: String,
        /// What it should be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// A stage was asked to stop. What was kept says how to go on.
    #[error("stopped{}", kept.as_ref().map(|k| format!("; {k}")).unwrap_or_default())]
    Cancelled {
        /// What was kept and how it is resumed.
        kept: Option<String>,
    },
    /// Reading or writing of scenes, captures and assets.
    #[error(transparent)]
    Scene(#[from] comgs_scene::SceneError),
    /// Reading of an image.
    #[error(transparent)]
    Read(#[from] comgs_image::ReadError),
    /// Writing of an image.
    #[error(transparent)]
    Write(#[from] comgs_image::WriteError),
    /// A transform that is no similarity.
    #[error("{what}")]
    Transform {
        /// Which transform.
        what: String,
        /// Why.
        #[source]
        reason: comgs_geom::similarity::SimilarityError,
    },
    /// Composition.
    #[error(transparent)]
    Compose(#[from] comgs_compose::ComposeError),
    /// Completion of a panorama.
    #[error(transparent)]
    Panorama(#[from] comgs_panorama::CompletionError),
    /// Insertion into a photo.
    #[error(transparent)]
    Insert(comgs_insert::InsertError),
    /// Ray tracing.
    #[error(transparent)]
    Trace(#[from] comgs_trace::TraceError),
    /// A capture that cannot be reconstructed.
    #[error("cannot be reconstructed: {}", capture.display())]
    Train {
        /// The capture.
        capture: PathBuf,
        /// Why.
        #[source]
        reason: comgs_inverse::TrainError,
    },
    /// Making of synthetic captures.
    #[error(transparent)]
    Synth(#[from] comgs_synth::SynthError),
    /// A light that is none.
    #[error("not a light: {}", path.display())]
    Light {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        reason: comgs_light::EnvError,
    },
    /// A fault of comgs itself.
    #[error("internal error: {0}")]
    Internal(String),
}

impl PipelineError {
    /// A file-system error at a path.
    #[must_use]
    pub fn io(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), reason }
    }

    /// An input that is not what is needed.
    #[must_use]
    pub fn input(what: impl Into<String>, expected: impl Into<String>, got: impl Into<String>) -> Self {
        Self::Input { what: what.into(), expected: expected.into(), got: got.into() }
    }
}
