//! The common scene format and everything that enters it: captures (SynCom, Blender/NeRF, COLMAP), camera files,
//! assets, placements and compositions.
//!
//! Parsers are functions of bytes that return an error for any input they do not understand, in bounded memory;
//! files are touched by the functions around them. Errors name the file and the place in it (`cameras.3.intr`).

pub mod asset;
pub mod cameras;
pub mod capture;
pub mod composition;
mod error;
pub mod json;
pub mod mesh;
pub mod photo;
pub mod probe;
pub mod transform_file;
pub mod undistort;

pub use asset::{Asset, AssetKind, AssetRecord};
pub use cameras::{read_cameras, write_cameras};
pub use capture::{
    Capture, CheckDepth, CheckReport, Format, LoadOptions, OpenOptions, Problem, ProblemKind, Severity, Size,
    Split, View, ViewRecord, check, check_with,
};
pub use composition::{CompositionRecord, EffectPolicy, LampRecord, ObjectRecord, ShadowPolicy};
pub use error::SceneError;
pub use mesh::{Mesh, MeshMaterial, read_mesh};
pub use transform_file::TransformFile;
pub use undistort::undistort_image;
