//! What can go wrong with the files of a scene.

use crate::capture::CheckReport;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// An error of this crate. Every variant names the file, last.
#[derive(Debug, Error)]
pub enum SceneError {
    /// A file or folder could not be opened or read.
    #[error("{reason}: {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        reason: io::Error,
    },
    /// A file could not be written; what was there before is unchanged.
    #[error("cannot write ({reason}): {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: io::Error,
    },
    /// JSON that is broken or does not say what is needed.
    #[error("{}{reason}: {}", at(location), path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// Path inside it, such as `cameras.3.intr`; empty for the whole file.
        location: String,
        /// What, expected, got.
        reason: String,
    },
    /// A binary or text file that does not follow its format.
    #[error("{reason}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What, expected, got.
        reason: String,
    },
    /// Written by a later version of this program.
    #[error("the file has version {found}, this program reads up to {supported}; a newer comgs is needed: {}", path.display())]
    NewerVersion {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u64,
        /// The newest version that is understood.
        supported: u64,
    },
    /// A folder that is no capture.
    #[error("no capture found; looked for {}: {}", looked_for.join(", "), path.display())]
    Unrecognised {
        /// The folder.
        path: PathBuf,
        /// The files that would have made it one.
        looked_for: Vec<String>,
    },
    /// A capture that cannot be used as it is; every problem is listed.
    #[error("{0}")]
    Unsound(Box<CheckReport>),
    /// A file of an asset is not the one that was saved with it.
    #[error("{reason}; the asset is damaged or half-written: {}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What differs.
        reason: String,
    },
    /// An image.
    #[error(transparent)]
    Image(#[from] comgs_image::ReadError),
    /// A PLY file.
    #[error(transparent)]
    Ply(#[from] comgs_surfel::PlyError),
}

fn at(location: &str) -> String {
    if location.is_empty() { String::new() } else { format!("{location}: ") }
}

impl SceneError {
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |reason| Self::Io { path: path.to_owned(), reason }
    }

    pub(crate) fn write(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |reason| Self::Write { path: path.to_owned(), reason }
    }

    pub(crate) fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), reason: reason.into() }
    }

    pub(crate) fn json(path: &Path, location: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Json { path: path.to_owned(), location: location.into(), reason: reason.into() }
    }

    /// The message without the file's path and location, for reports that state them apart.
    pub(crate) fn reason(&self) -> String {
        match self {
            Self::Io { reason, .. } | Self::Write { reason, .. } => reason.to_string(),
            Self::Json { reason, .. } | Self::Malformed { reason, .. } | Self::Damaged { reason, .. } => {
                reason.clone()
            }
            other => other.to_string(),
        }
    }
}
