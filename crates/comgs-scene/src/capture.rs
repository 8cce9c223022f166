//! Captures: posed photographs in any of the formats that are read.
//!
//! A capture is recognised by what it holds: `sparse/` is COLMAP, `transforms_train.json` or `transforms.json` is
//! Blender/NeRF, `cameras.json` or `train/cameras.json` is SynCom. [`check`] lists every problem at once from the file
//! headers alone; [`Capture::open`] refuses what has errors; [`Capture::load`] reads the pixels.

pub mod colmap;
pub mod frame;
pub mod syncom;
pub mod transforms;

mod check;
mod files;
mod load;
mod points;
mod recognise;
mod report;
pub(crate) mod survey;

pub use check::{CheckDepth, check, check_with};
pub use load::{LoadOptions, LoadProgress, Size, View};
pub use points::InitialPoints;
pub use report::{CheckReport, Problem, ProblemKind, Severity};

use crate::SceneError;
use comgs_geom::{Camera, Lens};
use glam::DVec3;
use serde::Serialize;
use std::path::{Path, PathBuf};

pub(crate) use recognise::recognise;

/// Formats of captures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// `cameras.json`, as the SynCom data set has it.
    SynCom,
    /// `transforms*.json` of Blender, instant-ngp and nerfstudio.
    Transforms,
    /// COLMAP's sparse models.
    Colmap,
}

impl Format {
    /// Name for people.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SynCom => "SynCom",
            Self::Transforms => "Blender/NeRF",
            Self::Colmap => "COLMAP",
        }
    }
}

/// Which views of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// For training.
    Train,
    /// Held out.
    Test,
    /// Both.
    All,
}

impl Split {
    /// Name as folders and files have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Test => "test",
            Self::All => "all",
        }
    }
}

/// In a capture without splits of its own every eighth view, from the first, is held out for testing, in the order of
/// the list (COLMAP: of the image names), as is usual in the literature.
pub const HOLD_OUT_EVERY: usize = 8;

/// Fewest training views that anything can be reconstructed of: two see too few places twice.
pub const MIN_VIEWS: usize = 3;

/// How to open a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenOptions {
    /// Which views.
    pub split: Split,
    /// Folder of the images, relative to the camera list, instead of the format's own (`images_linear`, `empty`).
    /// Images are then found by their last path part, with any extension.
    pub images: Option<PathBuf>,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { split: Split::All, images: None }
    }
}

/// A view whose image is known to be there.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewRecord {
    /// Camera of the image file as it lies there, before straightening (pinhole part only).
    pub camera: Camera,
    /// Lens of the photograph.
    pub lens: Lens,
    /// Image file.
    pub image: PathBuf,
    /// Mask file.
    pub mask: Option<PathBuf>,
    /// [`Split::Train`] or [`Split::Test`].
    pub split: Split,
    /// The camera list.
    pub list: PathBuf,
    /// Path inside the list, such as `cameras.3`.
    pub location: String,
}

/// An opened capture: every view has a sound camera and a readable image header.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Its folder.
    pub root: PathBuf,
    /// Its format.
    pub format: Format,
    /// The split that was asked for.
    pub split: Split,
    /// Whether the capture came without splits, so that [`HOLD_OUT_EVERY`] applied.
    pub held_out: bool,
    /// The views of the split, in list order. Names are unique.
    pub views: Vec<ViewRecord>,
    /// Unit vector towards the sky: +z where the format says so (SynCom, Blender/NeRF), for COLMAP the mean of the
    /// cameras' upward directions. Coordinates stay as the files have them.
    pub up: DVec3,
    /// What is wrong but could be lived with, left-out frames included.
    pub report: CheckReport,
    /// Point cloud of structure from motion.
    pub points_path: Option<PathBuf>,
}

impl Capture {
    /// Opens a capture: its folder, or its camera list. Reads lists and image headers, no pixels.
    ///
    /// # Errors
    /// [`SceneError::Unrecognised`] for a folder that is none; [`SceneError::Unsound`] with every problem when the
    /// capture has errors, or no view in the split.
    pub fn open(path: impl AsRef<Path>, split: Split) -> Result<Self, SceneError> {
        Self::open_with(path, &OpenOptions { split, ..OpenOptions::default() })
    }

    /// [`Capture::open`] with options.
    ///
    /// # Errors
    /// As [`Capture::open`].
    pub fn open_with(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Self, SceneError> {
        survey::open(path.as_ref(), options)
    }

    /// Component-wise median of the camera centres and the median distance from it: a measure of the scene's extent
    /// that one misplaced camera does not inflate.
    #[must_use]
    pub fn extent(&self) -> (DVec3, f64) {
        extent(self.views.iter().map(|v| v.camera.centre()))
    }

    /// The points of structure from motion, if the capture has any, in its world.
    ///
    /// Exact duplicates and points in a camera's centre are left out and counted; both break nearest-neighbour
    /// distances and projections.
    ///
    /// # Errors
    /// [`SceneError`] when the file is broken.
    pub fn points(&self) -> Result<Option<InitialPoints>, SceneError> {
        points::read(self)
    }
}

/// See [`Capture::extent`].
pub(crate) fn extent(centres: impl Iterator<Item = DVec3>) -> (DVec3, f64) {
    let centres: Vec<DVec3> = centres.collect();
    let median = |mut values: Vec<f64>| -> f64 {
        if values.is_empty() {
            return 0.0;
        }
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let centre = DVec3::new(
        median(centres.iter().map(|c| c.x).collect()),
        median(centres.iter().map(|c| c.y).collect()),
        median(centres.iter().map(|c| c.z).collect()),
    );
    (centre, median(centres.iter().map(|c| c.distance(centre)).collect()))
}
