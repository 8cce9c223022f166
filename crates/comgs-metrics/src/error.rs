//! What makes a comparison meaningless.

use thiserror::Error;

/// Why a metric was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MetricError {
    /// Two images that should have the same shape do not.
    #[error("{what}: expected {}×{}, got {}×{}", expected.0, expected.1, got.0, got.1)]
    Size {
        /// Which image.
        what: &'static str,
        /// Width and height of the first image.
        expected: (usize, usize),
        /// Width and height of this one.
        got: (usize, usize),
    },
    /// An image has another number of channels than the metric needs.
    #[error("{what}: expected {expected} channels, got {got}")]
    Channels {
        /// Which image.
        what: &'static str,
        /// What the metric needs.
        expected: &'static str,
        /// What the image has.
        got: usize,
    },
    /// An image has NaN or infinite samples.
    #[error("{what}: expected finite samples, got {count} that are NaN or infinite")]
    NonFinite {
        /// Which image.
        what: &'static str,
        /// How many samples.
        count: usize,
    },
    /// No pixel is left to measure.
    #[error(
        "{metric}: expected at least one pixel to measure, got none (empty image, empty mask, or no valid ground truth)"
    )]
    NothingToMeasure {
        /// Which metric.
        metric: &'static str,
    },
    /// The image is smaller than the metric's window.
    #[error("{metric}: expected at least {window}×{window} pixels, got {}×{}", got.0, got.1)]
    TooSmall {
        /// Which metric.
        metric: &'static str,
        /// Window size in pixels.
        window: usize,
        /// Width and height of the image.
        got: (usize, usize),
    },
    /// A parameter is outside its range.
    #[error("{parameter}: expected {expected}, got {got}")]
    Parameter {
        /// Which parameter.
        parameter: &'static str,
        /// Its range in words.
        expected: &'static str,
        /// The value.
        got: f64,
    },
}
