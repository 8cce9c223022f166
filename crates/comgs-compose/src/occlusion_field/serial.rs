//! A field as bytes.

use super::{FieldConfig, OcclusionField, Window};
use glam::Vec3;
use thiserror::Error;

/// First bytes of a file, the last one its version.
const MAGIC: [u8; 8] = *b"comgsOF\x01";
/// Bytes before the projections: magic, two resolutions, centre, radius.
const HEADER: usize = 8 + 2 * 4 + 4 * 4;

/// Bytes that are no occlusion field.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("not a readable occlusion field: {0}")]
pub struct FieldFormatError(String);

/// Bytes of a field, little endian: `comgsOF` and the version 1, sides of direction grid and projections (u32), centre and
/// radius (f32), middle and half extent of every direction's window (f32 × 4), then opacity and depth (u16) of every pixel of every direction. The same field gives the same bytes.
/// Inverse: [`from_bytes`].
#[must_use]
pub fn to_bytes(field: &OcclusionField) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER + field.memory_bytes());
    bytes.extend(MAGIC);
    for side in [field.config.directions, field.config.resolution] {
        bytes.extend((side as u32).to_le_bytes());
    }
    for v in [field.centre.x, field.centre.y, field.centre.z, field.radius] {
        bytes.extend(v.to_le_bytes());
    }
    for v in field.windows.iter().flat_map(|w| [w.middle, w.half]).flatten() {
        bytes.extend(v.to_le_bytes());
    }
    for value in field.texels.as_flattened() {
        bytes.extend(value.to_le_bytes());
    }
    bytes
}

/// A field from the bytes of [`to_bytes`]. Memory beyond the bytes is that of one field, which is no larger than they are.
///
/// # Errors
/// [`FieldFormatError`] for anything else: another beginning, resolutions out of range, another length, a sphere that is
/// none.
pub fn from_bytes(bytes: &[u8]) -> Result<OcclusionField, FieldFormatError> {
    let fail = |text: String| Err(FieldFormatError(text));
    let Some((header, body)) = bytes.split_at_checked(HEADER) else {
        return fail(format!("{} bytes, expected at least {HEADER}", bytes.len()));
    };
    if header[..8] != MAGIC {
        return fail("it does not begin with comgsOF and version 1".to_owned());
    }
    let word = |at: usize| [header[at], header[at + 1], header[at + 2], header[at + 3]];
    let config = FieldConfig {
        directions: u32::from_le_bytes(word(8)) as usize,
        resolution: u32::from_le_bytes(word(12)) as usize,
    };
    let problems = config.check();
    if !problems.is_empty() {
        return fail(problems.join("; "));
    }
    let texels = config.directions.pow(2) * config.resolution.pow(2);
    let directions = config.directions.pow(2);
    if body.len() != 16 * directions + 4 * texels {
        let expected = 16 * directions + 4 * texels;
        return fail(format!("{} bytes of projections, expected {expected}", body.len()));
    }
    let (windows, body) = body.split_at(16 * directions);
    let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    let windows: Vec<Window> = windows
        .as_chunks::<16>()
        .0
        .iter()
        .map(|w| Window {
            middle: [number(&w[0..]), number(&w[4..])],
            half: [number(&w[8..]), number(&w[12..])],
        })
        .collect();
    let sound = |w: &Window| {
        w.middle.iter().all(|v| v.is_finite()) && w.half.iter().all(|v| *v > 0.0 && v.is_finite())
    };
    if let Some(bad) = windows.iter().position(|w| !sound(w)) {
        return fail(format!("the window of direction {bad} is {:?}", windows[bad]));
    }
    let float = |i: usize| f32::from_le_bytes(word(16 + 4 * i));
    let (centre, radius) = (Vec3::new(float(0), float(1), float(2)), float(3));
    if !(centre.is_finite() && radius > 0.0 && radius.is_finite()) {
        return fail(format!("a bounding sphere at {centre} of radius {radius}"));
    }
    let texels = body
        .as_chunks::<4>()
        .0
        .iter()
        .map(|c| [u16::from_le_bytes([c[0], c[1]]), u16::from_le_bytes([c[2], c[3]])])
        .collect();
    Ok(OcclusionField { config, centre, radius, windows, texels })
}
