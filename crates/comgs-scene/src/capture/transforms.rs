//! `transforms.json` of the Blender/NeRF family (Blender synthetic, instant-ngp, nerfstudio).

use super::frame::{Fault, Focal, Frame, Intrinsics, Listing, is_plain_name, name_by_file, pose};
use super::syncom::declared_size;
use super::{ProblemKind, Split};
use crate::SceneError;
use crate::json::{self, MAX_FRAMES, Number, Numbers};
use comgs_geom::{Camera, Lens};
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::value::RawValue;
use std::collections::HashSet;
use std::fmt;
use std::path::Path;

#[derive(Deserialize)]
struct File<'a> {
    #[serde(borrow)]
    frames: Frames<'a>,
    #[serde(default)]
    train_filenames: Vec<String>,
    #[serde(default)]
    val_filenames: Vec<String>,
    #[serde(default)]
    test_filenames: Vec<String>,
    ply_file_path: Option<String>,
}

/// The frames unparsed, so that each one's problems are its own.
struct Frames<'a>(Vec<&'a RawValue>);

impl<'de: 'a, 'a> Deserialize<'de> for Frames<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List;
        impl<'de> Visitor<'de> for List {
            type Value = Frames<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of frames")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Frames<'de>, A::Error> {
                let mut frames = Vec::new();
                while let Some(frame) = seq.next_element()? {
                    frames.push(frame);
                    if frames.len() > MAX_FRAMES {
                        return Err(de::Error::custom(format!("more than {MAX_FRAMES} frames")));
                    }
                }
                Ok(Frames(frames))
            }
        }
        deserializer.deserialize_seq(List)
    }
}

#[derive(Deserialize)]
struct Entry {
    file_path: String,
    transform_matrix: Numbers,
    mask_path: Option<String>,
}

/// Camera parameters; they stand at the top for all frames, or in a frame for that one.
#[derive(Deserialize, Clone, Default)]
struct Parameters {
    w: Option<Number>,
    h: Option<Number>,
    fl_x: Option<Number>,
    fl_y: Option<Number>,
    cx: Option<Number>,
    cy: Option<Number>,
    camera_angle_x: Option<Number>,
    camera_angle_y: Option<Number>,
    k1: Option<Number>,
    k2: Option<Number>,
    k3: Option<Number>,
    k4: Option<Number>,
    k5: Option<Number>,
    k6: Option<Number>,
    p1: Option<Number>,
    p2: Option<Number>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
}

/// `self.x = self.x.or(other.x)` for every field.
macro_rules! or_fields {
    ($a:expr, $b:expr, $($field:ident)*) => { Parameters { $($field: $a.$field.or_else(|| $b.$field.clone())),* } };
}

impl Parameters {
    fn or(self, top: &Self) -> Self {
        or_fields!(self, top, w h fl_x fl_y cx cy camera_angle_x camera_angle_y
            k1 k2 k3 k4 k5 k6 p1 p2 camera_model is_fisheye)
    }

    fn intrinsics(&self) -> Option<Intrinsics> {
        let focal = |pixels: Option<Number>, angle: Option<Number>| {
            pixels.map(|n| Focal::Pixels(n.0)).or(angle.map(|n| Focal::Angle(n.0)))
        };
        let x = focal(self.fl_x, self.camera_angle_x);
        let y = focal(self.fl_y, self.camera_angle_y);
        // A vertical angle beside a horizontal focal length in pixels is that camera's own, rounded; pixels are better.
        let y = if self.fl_y.is_none() && self.fl_x.is_some() { None } else { y };
        let (x, y) = match (x, y) {
            (Some(x), y) => (x, y),
            (None, Some(Focal::Pixels(f))) => (Focal::Pixels(f), None),
            (None, _) => return None,
        };
        Some(Intrinsics { x, y, cx: self.cx.map(|n| n.0), cy: self.cy.map(|n| n.0) })
    }

    fn lens(&self) -> Result<Lens, String> {
        let v = |n: Option<Number>| n.map_or(0.0, |n| n.0);
        let fisheye = self.is_fisheye == Some(true);
        match self.camera_model.as_deref() {
            Some("OPENCV_FISHEYE") => {}
            _ if fisheye => {}
            None
            | Some("OPENCV" | "FULL_OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL") => {
                let k = [v(self.k1), v(self.k2), v(self.k3), v(self.k4), v(self.k5), v(self.k6)];
                return Ok(Lens::open_cv(k, [v(self.p1), v(self.p2)]));
            }
            Some(other) => {
                return Err(format!(
                    "the camera model {other:?} is unknown, expected PINHOLE, OPENCV or OPENCV_FISHEYE"
                ));
            }
        }
        Ok(Lens::Fisheye { k: [v(self.k1), v(self.k2), v(self.k3), v(self.k4)] })
    }
}

/// Parses `transforms.json`. `path` is only for messages.
///
/// # Errors
/// [`SceneError::Json`] when the file as a whole is not a camera list; problems of single frames are faults of the
/// listing.
pub fn parse(bytes: &[u8], path: &Path) -> Result<Listing, SceneError> {
    let bytes = json::without_literals(bytes);
    let file: File<'_> = json::parse(&bytes, "", path)?;
    let top: Parameters = json::parse(&bytes, "", path)?;
    let mut listing = Listing { points: file.ply_file_path, ..Listing::default() };
    for (i, raw) in file.frames.0.iter().enumerate() {
        let location = format!("frames[{i}]");
        let text = raw.get().as_bytes();
        let parsed = json::parse::<Entry>(text, &location, path)
            .and_then(|entry| Ok((entry, json::parse::<Parameters>(text, &location, path)?)));
        match parsed {
            Ok((entry, own)) => frame(entry, &own.or(&top), &location, &mut listing),
            Err(SceneError::Json { location, reason, .. }) => {
                listing.faults.push(Fault::error(ProblemKind::Record, location, reason));
            }
            Err(other) => return Err(other),
        }
    }
    name_by_file(&mut listing.frames);
    for frame in &listing.frames {
        if !is_plain_name(&frame.name) {
            let message = format!("{:?} gives no usable name", frame.file);
            listing.faults.push(Fault::error(
                ProblemKind::Record,
                format!("{}.file_path", frame.location),
                message,
            ));
        }
    }
    listing.frames.retain(|f| is_plain_name(&f.name));
    assign_splits(&mut listing.frames, &file.train_filenames, &[&file.val_filenames, &file.test_filenames]);
    Ok(listing)
}

/// nerfstudio's lists of file names by split; a frame in none of them is in none.
fn assign_splits(frames: &mut [Frame], train: &[String], held_out: &[&Vec<String>]) {
    if train.is_empty() || held_out.iter().all(|list| list.is_empty()) {
        return;
    }
    let train: HashSet<&str> = train.iter().map(String::as_str).collect();
    let test: HashSet<&str> = held_out.iter().flat_map(|list| list.iter().map(String::as_str)).collect();
    for frame in frames {
        if test.contains(frame.file.as_str()) {
            frame.split = Some(Split::Test);
        } else if train.contains(frame.file.as_str()) {
            frame.split = Some(Split::Train);
        }
    }
}

fn frame(entry: Entry, parameters: &Parameters, location: &str, listing: &mut Listing) {
    let before = listing.faults.len();
    let mut fault = |kind, field: &str, message: String| {
        let location = if field.is_empty() { location.to_owned() } else { format!("{location}.{field}") };
        listing.faults.push(Fault::error(kind, location, message));
    };
    let world_from_camera = entry.transform_matrix.matrix().and_then(pose);
    if let Err(reason) = &world_from_camera {
        fault(ProblemKind::Pose, "transform_matrix", reason.clone());
    }
    let intrinsics = parameters.intrinsics();
    match &intrinsics {
        None => fault(ProblemKind::Intrinsics, "", "no focal length: neither fl_x nor camera_angle_x".into()),
        Some(i) => {
            if !i.x.is_sound() {
                fault(
                    ProblemKind::Intrinsics,
                    "fl_x",
                    format!("the horizontal focal length is {:?}, expected a positive one", i.x),
                );
            }
            if let Some(y) = i.y.filter(|y| !y.is_sound()) {
                fault(
                    ProblemKind::Intrinsics,
                    "fl_y",
                    format!("the vertical focal length is {y:?}, expected a positive one"),
                );
            }
            for (name, v) in [("cx", i.cx), ("cy", i.cy)] {
                if let Some(v) = v.filter(|v| !v.is_finite()) {
                    fault(ProblemKind::Intrinsics, name, format!("{name} is {v}"));
                }
            }
        }
    }
    let size = declared_size(parameters.w, parameters.h);
    if let Err(message) = &size {
        fault(ProblemKind::ImageSize, "w", message.clone());
    }
    let lens = parameters.lens();
    match &lens {
        Err(message) => fault(ProblemKind::Lens, "camera_model", message.clone()),
        Ok(lens) if !lens.is_finite() => fault(ProblemKind::Lens, "k1", format!("the lens is {lens:?}")),
        Ok(_) => {}
    }
    let sound = listing.faults.len() == before;
    if let (Ok(m), Some(intrinsics), Ok(size), Ok(lens), true) =
        (world_from_camera, intrinsics, size, lens, sound)
    {
        listing.frames.push(Frame {
            name: String::new(),
            location: location.to_owned(),
            file: entry.file_path,
            mask: entry.mask_path,
            size,
            intrinsics,
            lens,
            world_from_camera: Camera::flip_opengl_axes(m),
            split: None,
        });
    }
}
