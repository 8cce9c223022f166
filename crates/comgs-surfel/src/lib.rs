//! The Gaussian surfel cloud: structure-of-arrays columns of raw parameters, their activations, similarity
//! transforms, and PLY in and out.

pub mod activation;
pub mod cloud;
pub mod ply;

pub use cloud::{ColorEncoding, MaterialColumns, SurfelCloud};
pub use ply::{PlyDialect, PlyError, PlyMaterial, PlyReport, PlyStyle, PointCloud};
