//! Problems of a capture, all at once.

use super::Format;
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;

/// Whether a problem can be lived with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Work goes on, without the thing or with a repair that the message states.
    Warning,
    /// The capture cannot be used until it is put right.
    Error,
}

/// Classes of problems.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ProblemKind {
    /// A file or entry that does not follow its format.
    Record,
    /// A listed image is not there; its frame is left out.
    MissingImage,
    /// An image that cannot be read.
    UnreadableImage,
    /// An image of another size than declared, or a senseless size.
    ImageSize,
    /// A listed mask is not there.
    MissingMask,
    /// A mask that belongs to no image.
    OrphanMask,
    /// A mask of another size than its image, or unreadable.
    Mask,
    /// A name or key that is used twice.
    DuplicateName,
    /// A pose that is not a rigid motion.
    Pose,
    /// Focal length or principal point.
    Intrinsics,
    /// Lens model or coefficients.
    Lens,
    /// A camera far from all others.
    OutlierCamera,
    /// Too few different views to reconstruct anything from.
    Views,
    /// Black, saturated, textureless or non-finite pixels.
    Content,
}

impl ProblemKind {
    /// Problems that stand in the way of reconstruction only: single views can still be rendered and compared.
    #[must_use]
    pub fn concerns_reconstruction_only(self) -> bool {
        matches!(self, Self::Views | Self::Content | Self::OutlierCamera)
    }
}

/// One problem.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Problem {
    /// Whether it can be lived with.
    pub severity: Severity,
    /// Class.
    pub kind: ProblemKind,
    /// The file that it is about.
    pub path: PathBuf,
    /// Path inside that file, such as `cameras.3.intr`; empty when it is about the file.
    pub location: String,
    /// What, expected, got.
    pub message: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.severity {
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        let colon = if self.location.is_empty() { "" } else { ": " };
        write!(f, "{word}: {}{colon}{}: {}", self.location, self.message, self.path.display())
    }
}

/// What a look at a capture found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CheckReport {
    /// The capture.
    pub root: PathBuf,
    /// Its format, when it has one.
    pub format: Option<Format>,
    /// Usable training views.
    pub train_views: usize,
    /// Usable test views.
    pub test_views: usize,
    /// Frames that are listed but left out, by name.
    pub left_out: Vec<String>,
    /// Everything that is wrong, in file order.
    pub problems: Vec<Problem>,
}

impl CheckReport {
    /// Problems of a severity.
    pub fn of(&self, severity: Severity) -> impl Iterator<Item = &Problem> {
        self.problems.iter().filter(move |p| p.severity == severity)
    }

    /// Number of errors.
    #[must_use]
    pub fn errors(&self) -> usize {
        self.of(Severity::Error).count()
    }

    /// Whether work can start.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.errors() == 0
    }
}

impl fmt::Display for CheckReport {
    /// A line of summary, then one line a problem, errors first.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let format = self.format.map_or("unrecognised", Format::name);
        let warnings = self.of(Severity::Warning).count();
        write!(
            f,
            "{format} capture, {} training and {} test views, {} left out, {} errors, {warnings} warnings: {}",
            self.train_views,
            self.test_views,
            self.left_out.len(),
            self.errors(),
            self.root.display()
        )?;
        for problem in self.of(Severity::Error).chain(self.of(Severity::Warning)) {
            write!(f, "\n  {problem}")?;
        }
        Ok(())
    }
}
