//! Optimisation: Adam with its state as plain columns, learning-rate schedules, and image losses with exact gradients.

pub mod adam;
pub mod photometric;
pub mod schedule;
pub mod ssim;

pub use adam::{Adam, AdamConfig};
pub use photometric::{Photometric, Target};
