//! Geometry that every stage shares: spaces, cameras and lens models, maps of the sphere, spherical
//! harmonics, sampling warps with their densities, and seeded random streams.
//!
//! Conventions (the whole list is `docs/conventions.md`): world space is right-handed with z up;
//! camera space is OpenCV's (x right, y down, z forward); pixel `(i, j)` has its centre at
//! `(i + ½, j + ½)`; transforms carry both ends in their names, `p_camera = camera_from_world * p_world`.

pub mod camera;
pub mod equirect;
pub mod frame;
pub mod lens;
pub mod octahedral;
pub mod random;
pub mod sampling;
pub mod sh;
pub mod similarity;

pub use camera::Camera;
pub use lens::Lens;
pub use random::Rng;
pub use similarity::{Similarity, SimilarityError};
