//! Plain point clouds in PLY files (structure-from-motion points).

use super::body::{checked_count, for_each_vertex};
use super::{Header, PlyError, Scalar, Source, with_file};
use comgs_image::{atomic, transfer};
use std::io::BufRead;
use std::path::Path;

/// Points with what is known of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// World space.
    pub positions: Vec<[f32; 3]>,
    /// Linear Rec.709, as many as positions; files hold sRGB codes.
    pub colors: Option<Vec<[f32; 3]>>,
    /// World space, as stored (possibly zero), as many as positions.
    pub normals: Option<Vec<[f32; 3]>>,
}

impl PointCloud {
    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }
}

/// Reads `x y z`, and `red green blue` and `nx ny nz` when they are there.
///
/// Integer colours are codes of their type's range (255 for `uchar`), float colours codes in [0, 1]; both are sRGB
/// and become linear. Points with a non-finite coordinate are left out.
///
/// # Errors
/// [`PlyError`]; [`PlyError::Columns`] when there are no positions. Memory is bounded as for surfels.
pub fn read_points(path: &Path) -> Result<PointCloud, PlyError> {
    with_file(path, read_source)
}

/// [`read_points`] from memory; `path` is only for messages.
///
/// # Errors
/// As [`read_points`].
pub fn parse_points(bytes: &[u8], path: &Path) -> Result<PointCloud, PlyError> {
    read_source(&mut Source { reader: bytes, remaining: bytes.len() as u64, path })
}

fn read_source<R: BufRead>(source: &mut Source<'_, R>) -> Result<PointCloud, PlyError> {
    let header = Header::parse(source)?;
    let vertex =
        header.vertex().ok_or_else(|| PlyError::malformed(source.path, "there is no vertex element"))?;
    let triple = |names: [&str; 3]| -> Option<[usize; 3]> {
        let found = names.map(|n| vertex.position(n));
        found.iter().all(Option::is_some).then(|| found.map(Option::unwrap_or_default))
    };
    let Some(xyz) = triple(["x", "y", "z"]) else {
        let missing =
            ["x", "y", "z"].iter().filter(|n| vertex.position(n).is_none()).map(|&n| n.into()).collect();
        return Err(PlyError::Columns { path: source.path.to_owned(), expected: "points", missing });
    };
    let normal = triple(["nx", "ny", "nz"]);
    let color =
        triple(["red", "green", "blue"]).or_else(|| triple(["diffuse_red", "diffuse_green", "diffuse_blue"]));
    let white = color.map_or(1.0, |c| match vertex.properties[c[0]].scalar {
        Scalar::U8 => 255.0,
        Scalar::U16 => 65535.0,
        _ => 1.0,
    });
    let count = checked_count(&header, source)?;
    let mut cloud = PointCloud {
        positions: Vec::with_capacity(count),
        colors: color.map(|_| Vec::with_capacity(count)),
        normals: normal.map(|_| Vec::with_capacity(count)),
    };
    for_each_vertex(&header, source, |row| {
        let position = xyz.map(|i| row[i] as f32);
        if !position.iter().all(|v| v.is_finite()) {
            return;
        }
        cloud.positions.push(position);
        if let (Some(out), Some(at)) = (&mut cloud.colors, color) {
            out.push(at.map(|i| {
                let code = (row[i] / white) as f32;
                if code.is_finite() { transfer::linear_from_srgb(code.clamp(0.0, 1.0)) } else { 0.0 }
            }));
        }
        if let (Some(out), Some(at)) = (&mut cloud.normals, normal) {
            out.push(at.map(|i| row[i] as f32).map(|v| if v.is_finite() { v } else { 0.0 }));
        }
    })?;
    Ok(cloud)
}

/// Writes points as binary little-endian PLY with 8-bit sRGB colours; the file is whole or unchanged.
///
/// # Errors
/// [`PlyError::Write`].
pub fn write_points(path: &Path, cloud: &PointCloud) -> Result<(), PlyError> {
    atomic::write_file(path, |w| {
        writeln!(w, "ply\nformat binary_little_endian 1.0\nelement vertex {}", cloud.len())?;
        let mut names = vec!["x", "y", "z"];
        if cloud.normals.is_some() {
            names.extend(["nx", "ny", "nz"]);
        }
        for name in names {
            writeln!(w, "property float {name}")?;
        }
        if cloud.colors.is_some() {
            for name in ["red", "green", "blue"] {
                writeln!(w, "property uchar {name}")?;
            }
        }
        writeln!(w, "end_header")?;
        for (i, position) in cloud.positions.iter().enumerate() {
            let normal = cloud.normals.as_ref().and_then(|n| n.get(i));
            for value in position.iter().chain(normal.into_iter().flatten()) {
                w.write_all(&value.to_le_bytes())?;
            }
            if let Some(color) = cloud.colors.as_ref().and_then(|c| c.get(i)) {
                w.write_all(&color.map(transfer::srgb8_from_linear))?;
            }
        }
        Ok(())
    })
    .map_err(|reason| PlyError::Write { path: path.to_owned(), reason })
}
