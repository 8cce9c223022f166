//! What a training says: progress, errors, the result.

use comgs_image::Image;
use comgs_surfel::SurfelCloud;
use thiserror::Error;

/// What a progress bar shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainStatus {
    /// What is going on: "matching views", "training at 1/2 resolution", …
    pub phase: &'static str,
    /// Steps done.
    pub iteration: u32,
    /// Steps to do.
    pub iterations: u32,
    /// Fraction of the whole done, in [0, 1] (by the clock when there is a time budget).
    pub fraction: f32,
    /// Running mean of the training views' PSNR in dB (clipped sRGB).
    pub psnr_db: f32,
    /// Surfels now.
    pub surfels: usize,
    /// Seconds since the start (of this run).
    pub elapsed_s: f64,
    /// Estimated seconds to go.
    pub remaining_s: f64,
}

/// Whoever watches a training. All methods have defaults that do nothing.
pub trait Observer: Sync {
    /// Called a few times a second.
    fn progress(&mut self, _status: &TrainStatus) {}
    /// Called about twenty times a training with a view's name and its linear rendering.
    fn preview(&mut self, _view: &str, _rendering: &Image) {}
    /// Called now and then with a resumable state; the observer may store it.
    fn checkpoint(&mut self, _bytes: Vec<u8>) {}
    /// Whether [`Observer::checkpoint`] wants one now (asked between steps).
    fn wants_checkpoint(&mut self) -> bool {
        false
    }
    /// Whether to stop at the next step; the state is handed to [`Observer::checkpoint`] first.
    fn cancelled(&self) -> bool {
        false
    }
}

/// An observer that does nothing.
pub struct Silent;
impl Observer for Silent {}

/// Why a training did not produce a cloud.
#[derive(Debug, Error, PartialEq)]
pub enum TrainError {
    /// Fewer views than a reconstruction can be made of.
    #[error("{0} usable views, expected at least {MIN_VIEWS} from different places")]
    TooFewViews(usize),
    /// All cameras stand in one place.
    #[error("all {0} cameras stand at the same place: depth cannot be told without parallax")]
    NoParallax(usize),
    /// The images hold nothing.
    #[error("all images are black")]
    Black,
    /// An object capture without masks.
    #[error(
        "{missing} of {total} views of the object have no mask (alpha channel or mask image); masks say what belongs \
         to it"
    )]
    NoMasks {
        /// Views without a mask.
        missing: usize,
        /// All views.
        total: usize,
    },
    /// The masks contradict each other.
    #[error(
        "the masks have no volume in common: poses and masks do not fit together, or the cameras do not surround \
             the object"
    )]
    EmptyHull,
    /// A configuration value is out of range.
    #[error("configuration: {0}")]
    Config(String),
    /// A view does not fit together.
    #[error("view {name}: {problem}")]
    View {
        /// Name of the view.
        name: String,
        /// What is wrong.
        problem: String,
    },
    /// The observer asked to stop; the state went to [`Observer::checkpoint`].
    #[error("stopped on request after {0} steps; the state was saved")]
    Cancelled(u32),
    /// A checkpoint that cannot be continued.
    #[error("cannot resume from the checkpoint: {0}")]
    Checkpoint(String),
    /// Probes cannot be placed on the object.
    #[error("probes: {0}")]
    Probes(String),
    /// Nothing is left to train.
    #[error("no surfel survived: the views do not agree on any surface")]
    Vanished,
}

/// Fewest views.
pub const MIN_VIEWS: usize = 3;

/// How a training went.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TrainReport {
    /// Steps done.
    pub iterations: u32,
    /// Seconds for the initialisation.
    pub init_seconds: f64,
    /// Seconds for everything.
    pub seconds: f64,
    /// Surfels at the start.
    pub initial_surfels: usize,
    /// Surfels at the end.
    pub surfels: usize,
    /// Running mean of the training views' PSNR in dB.
    pub train_psnr_db: f32,
    /// Non-finite gradient entries that were dropped.
    pub dropped_gradients: u64,
    /// Near plane that was used, world units; render with the same.
    pub near: f32,
    /// Things the user should know.
    pub warnings: Vec<String>,
}

/// A trained cloud.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The surfels.
    pub cloud: SurfelCloud,
    /// How it went.
    pub report: TrainReport,
}
