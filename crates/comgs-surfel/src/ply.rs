//! PLY in and out: surfel clouds (our own, ComGS, 2DGS, 3DGS, R3DG, IRGS, GS-IR) and plain point clouds.
//!
//! Columns follow the 3DGS family: `x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0 scale_1 rot_0..3
//! [albedo_0..2 metallic roughness]` with log scale, logit opacity, quaternions w x y z, `f_rest` channel-major
//! (all of red, then green, then blue) and material as logits. Reading accepts ASCII and both byte orders and any
//! column order and scalar type; writing is binary little endian, 32-bit floats.
//!
//! Reading streams: beyond the columns themselves it holds one row. Counts in a header are believed only as
//! far as the file is long enough to hold them.

mod body;
mod dialect;
mod header;
mod points;
mod surfels;

pub use dialect::{PlyDialect, PlyMaterial};
pub use header::{Element, Header, Layout, Property, Scalar};
pub use points::{PointCloud, parse_points, read_points, write_points};
pub use surfels::{
    PlyReport, PlyStyle, VIEWER_THICKNESS, parse_surfels, read_surfels, write_surfels, write_surfels_to,
};

use std::io::BufRead;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What can go wrong with a PLY file.
#[derive(Debug, Error)]
pub enum PlyError {
    /// The file could not be opened or read.
    #[error("{reason}: {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// The header or the body does not follow the format.
    #[error("not a valid PLY file: {reason}: {}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What, expected, got.
        reason: String,
    },
    /// The header promises more than the file holds.
    #[error(
        "the header promises {count} {element} entries of at least {stride} bytes, but only {available} bytes follow it: {}",
        path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Name of the element.
        element: String,
        /// Promised number of entries.
        count: u64,
        /// Least size of an entry in bytes.
        stride: u64,
        /// Bytes that are there.
        available: u64,
    },
    /// The file is a PLY, but of something else.
    #[error("the PLY file holds no {expected}: missing columns {}: {}", missing.join(" "), path.display())]
    Columns {
        /// The file.
        path: PathBuf,
        /// What was asked for (`surfels`, `points`).
        expected: &'static str,
        /// The columns without which it cannot be had.
        missing: Vec<String>,
    },
    /// Surfels with material columns that belong to no known dialect, so that nobody knows what they mean.
    #[error(
        "the material columns {} are of no known dialect ({reason}); known are {}; without these columns the file opens as \
         plain splats: {}",
        columns.join(" "), dialect::KNOWN_MATERIAL, path.display()
    )]
    Material {
        /// The file.
        path: PathBuf,
        /// Its material columns.
        columns: Vec<String>,
        /// What is wrong with them.
        reason: String,
    },
    /// The file could not be written; what was there before is unchanged.
    #[error("cannot write ({reason}): {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: std::io::Error,
    },
}

impl PlyError {
    fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), reason: reason.into() }
    }
}

/// A PLY source: buffered bytes and how many of them are left.
struct Source<'a, R> {
    reader: R,
    remaining: u64,
    path: &'a Path,
}

impl<R: BufRead> Source<'_, R> {
    fn io(&self, reason: std::io::Error) -> PlyError {
        if reason.kind() == std::io::ErrorKind::UnexpectedEof {
            return PlyError::malformed(self.path, "the file ends in the middle of its data");
        }
        PlyError::Io { path: self.path.to_owned(), reason }
    }
}

/// Reads only the header of a PLY file.
///
/// # Errors
/// [`PlyError`] when the file cannot be read or does not start with a PLY header.
pub fn read_header(path: &Path) -> Result<Header, PlyError> {
    with_file(path, Header::parse)
}

/// Opens a file as a [`Source`].
fn with_file<T>(
    path: &Path,
    work: impl FnOnce(&mut Source<'_, std::io::BufReader<std::fs::File>>) -> Result<T, PlyError>,
) -> Result<T, PlyError> {
    let io = |reason| PlyError::Io { path: path.to_owned(), reason };
    let file = std::fs::File::open(path).map_err(io)?;
    let meta = file.metadata().map_err(io)?;
    if meta.is_dir() {
        return Err(io(std::io::ErrorKind::IsADirectory.into()));
    }
    let reader = std::io::BufReader::with_capacity(1 << 16, file);
    work(&mut Source { reader, remaining: meta.len(), path })
}

#[cfg(test)]
mod tests;
