//! SynCom's `cameras.json`.

use super::ProblemKind;
use super::frame::{Fault, Focal, Frame, Intrinsics, Listing, is_plain_name, pose};
use crate::SceneError;
use crate::json::{self, MAX_FRAMES, Number, Numbers};
use comgs_geom::{Camera, Lens};
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::value::RawValue;
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

#[derive(Deserialize)]
struct File<'a> {
    #[serde(borrow)]
    cameras: Entries<'a>,
}

/// The cameras unparsed, so that each one's problems are its own; repeated keys are kept and reported.
struct Entries<'a>(Vec<(String, &'a RawValue)>);

impl<'de: 'a, 'a> Deserialize<'de> for Entries<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Map;
        impl<'de> Visitor<'de> for Map {
            type Value = Entries<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of cameras")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entries<'de>, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                    if entries.len() > MAX_FRAMES {
                        return Err(de::Error::custom(format!("more than {MAX_FRAMES} cameras")));
                    }
                }
                Ok(Entries(entries))
            }
        }
        deserializer.deserialize_map(Map)
    }
}

#[derive(Deserialize)]
struct Entry {
    name: String,
    width: Option<Number>,
    height: Option<Number>,
    intr: Numbers,
    extr: Numbers,
}

/// Parses `cameras.json`. `path` is only for messages.
///
/// # Errors
/// [`SceneError::Json`] when the file as a whole is not a camera list; problems of single cameras are faults of the
/// listing.
pub fn parse(bytes: &[u8], path: &Path) -> Result<Listing, SceneError> {
    let bytes = json::without_literals(bytes);
    let file: File<'_> = json::parse(&bytes, "", path)?;
    let mut listing = Listing::default();
    let mut keys = std::collections::HashSet::new();
    for (key, raw) in &file.cameras.0 {
        let location = format!("cameras.{key}");
        if !keys.insert(key.as_str()) {
            listing.faults.push(Fault::error(ProblemKind::DuplicateName, &location, "the key is used twice"));
        }
        match json::parse::<Entry>(raw.get().as_bytes(), &location, path) {
            Ok(entry) => frame(entry, &location, &mut listing),
            Err(SceneError::Json { location, reason, .. }) => {
                listing.faults.push(Fault::error(ProblemKind::Record, location, reason));
            }
            Err(other) => return Err(other),
        }
    }
    Ok(listing)
}

fn frame(entry: Entry, location: &str, listing: &mut Listing) {
    let before = listing.faults.len();
    let mut fault = |kind, field: &str, message: String| {
        listing.faults.push(Fault::error(kind, format!("{location}.{field}"), message));
    };
    if !is_plain_name(&entry.name) {
        fault(ProblemKind::Record, "name", format!("{:?} cannot name a file", entry.name));
    }
    let intr = &entry.intr.0;
    if intr.len() != 4 {
        fault(ProblemKind::Intrinsics, "intr", format!("{} numbers, expected fx, fy, cx, cy", intr.len()));
    }
    for (i, (name, &v)) in ["fx", "fy", "cx", "cy"].iter().zip(intr).enumerate() {
        if !v.is_finite() || (i < 2 && v <= 0.0) {
            let expected = if i < 2 { "a positive focal length" } else { "a finite principal point" };
            let message = format!("{name} is {v}, expected {expected} in pixels");
            fault(ProblemKind::Intrinsics, &format!("intr[{i}]"), message);
        }
    }
    let world_from_camera = entry.extr.matrix().and_then(pose);
    if let Err(reason) = &world_from_camera {
        fault(ProblemKind::Pose, "extr", reason.clone());
    }
    let size = declared_size(entry.width, entry.height);
    if let Err(message) = &size {
        fault(ProblemKind::ImageSize, "width", message.clone());
    }
    if let (Ok(m), Ok(size), true) = (world_from_camera, size, listing.faults.len() == before) {
        listing.frames.push(Frame {
            file: entry.name.clone(),
            name: entry.name,
            location: location.to_owned(),
            mask: None,
            size,
            intrinsics: Intrinsics {
                x: Focal::Pixels(intr[0]),
                y: Some(Focal::Pixels(intr[1])),
                cx: Some(intr[2]),
                cy: Some(intr[3]),
            },
            lens: Lens::Pinhole,
            world_from_camera: Camera::flip_opengl_axes(m),
            split: None,
        });
    }
}

/// A declared image size; `None` when it is not stated.
pub(super) fn declared_size(
    width: Option<Number>,
    height: Option<Number>,
) -> Result<Option<(usize, usize)>, String> {
    let (Some(Number(w)), Some(Number(h))) = (width, height) else { return Ok(None) };
    let good = |v: f64| v >= 1.0 && v.fract() == 0.0 && v <= comgs_image::read::MAX_PIXELS as f64;
    if !good(w) || !good(h) || w * h > comgs_image::read::MAX_PIXELS as f64 {
        return Err(format!("the image size is {w}×{h}"));
    }
    Ok(Some((w as usize, h as usize)))
}

#[derive(Serialize)]
struct OutputFile<'a> {
    cameras: BTreeMap<usize, OutputEntry<'a>>,
}

#[derive(Serialize)]
struct OutputEntry<'a> {
    name: &'a str,
    width: usize,
    height: usize,
    intr: [f64; 4],
    extr: [f64; 16],
}

/// The text of a `cameras.json` that lists the cameras in order.
pub(crate) fn to_value(cameras: &[Camera]) -> impl Serialize + '_ {
    let entries = cameras.iter().enumerate().map(|(i, c)| {
        let gl = Camera::flip_opengl_axes(c.world_from_camera);
        (
            i,
            OutputEntry {
                name: &c.name,
                width: c.width,
                height: c.height,
                intr: [c.fx, c.fy, c.cx, c.cy],
                extr: glam::DMat4::from(gl).transpose().to_cols_array(),
            },
        )
    });
    OutputFile { cameras: entries.collect() }
}
