//! COLMAP's sparse models, binary and text: cameras, images and 3D points.
//!
//! Models 0 to 6, 8 and 9 (pinhole, radial, OpenCV, fisheye) are understood; the others (FOV, thin prism) are
//! refused by name. Poses are `camera_from_world` with OpenCV axes; the world is COLMAP's own.

mod binary;
mod text;

pub use binary::{parse_cameras_binary, parse_images_binary, parse_points_binary};
pub use text::{parse_cameras_text, parse_images_text, parse_points_text};

use super::ProblemKind;
use super::frame::{Fault, Focal, Frame, Intrinsics, Listing, is_plain_name, name_by_file};
use comgs_geom::Lens;
use comgs_image::transfer;
use comgs_surfel::PointCloud;
use glam::{DAffine3, DQuat, DVec3};
use std::collections::HashMap;

/// A camera of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapCamera {
    /// COLMAP's number.
    pub id: u32,
    /// Image size.
    pub width: u64,
    /// Image size.
    pub height: u64,
    /// Focal length, principal point and lens, or why the model is not understood.
    pub model: Result<(Intrinsics, Lens), String>,
}

/// A registered image of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ColmapImage {
    /// COLMAP's number.
    pub id: u32,
    /// Rotation `camera_from_world`, w x y z as stored.
    pub rotation: [f64; 4],
    /// Translation `camera_from_world`.
    pub translation: [f64; 3],
    /// Its camera's number.
    pub camera_id: u32,
    /// File name relative to the image folder.
    pub name: String,
}

/// Names and parameter counts of COLMAP's camera models by number.
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// Parameters of a model as focal length, principal point and lens.
fn model(name: &str, p: &[f64]) -> Result<(Intrinsics, Lens), String> {
    let Some((_, count)) = MODELS.iter().find(|(n, _)| *n == name) else {
        return Err(format!("the camera model {name} is unknown"));
    };
    if p.len() != *count {
        return Err(format!("the camera model {name} has {} parameters, expected {count}", p.len()));
    }
    if let Some(v) = p.iter().find(|v| !v.is_finite()) {
        return Err(format!("a parameter of the camera is {v}"));
    }
    let one = |lens| (Intrinsics { x: Focal::Pixels(p[0]), y: None, cx: Some(p[1]), cy: Some(p[2]) }, lens);
    let two = |lens| {
        let y = Some(Focal::Pixels(p[1]));
        (Intrinsics { x: Focal::Pixels(p[0]), y, cx: Some(p[2]), cy: Some(p[3]) }, lens)
    };
    let radial = |k1, k2| Lens::open_cv([k1, k2, 0.0, 0.0, 0.0, 0.0], [0.0; 2]);
    let sound = match name {
        "SIMPLE_PINHOLE" => one(Lens::Pinhole),
        "PINHOLE" => two(Lens::Pinhole),
        "SIMPLE_RADIAL" => one(radial(p[3], 0.0)),
        "RADIAL" => one(radial(p[3], p[4])),
        "OPENCV" => two(Lens::open_cv([p[4], p[5], 0.0, 0.0, 0.0, 0.0], [p[6], p[7]])),
        "FULL_OPENCV" => two(Lens::open_cv([p[4], p[5], p[8], p[9], p[10], p[11]], [p[6], p[7]])),
        "OPENCV_FISHEYE" => two(Lens::Fisheye { k: [p[4], p[5], p[6], p[7]] }),
        "SIMPLE_RADIAL_FISHEYE" => one(Lens::Fisheye { k: [p[3], 0.0, 0.0, 0.0] }),
        "RADIAL_FISHEYE" => one(Lens::Fisheye { k: [p[3], p[4], 0.0, 0.0] }),
        _ => {
            return Err(format!(
                "the camera model {name} is not supported; undistort the images with COLMAP first"
            ));
        }
    };
    if !sound.0.x.is_sound() || sound.0.y.is_some_and(|y| !y.is_sound()) {
        return Err("the focal length is not positive and finite".into());
    }
    Ok(sound)
}

/// Puts cameras and images together, sorted by image name.
#[must_use]
pub fn listing(cameras: &[ColmapCamera], mut images: Vec<ColmapImage>) -> Listing {
    let by_id: HashMap<u32, &ColmapCamera> = cameras.iter().map(|c| (c.id, c)).collect();
    images.sort_by(|a, b| a.name.cmp(&b.name).then(a.id.cmp(&b.id)));
    let mut listing = Listing::default();
    let mut faulty = std::collections::BTreeSet::new();
    for image in &images {
        let location = format!("image {}", image.id);
        let Some(camera) = by_id.get(&image.camera_id) else {
            let message =
                format!("{:?} refers to camera {}, which is not there", image.name, image.camera_id);
            listing.faults.push(Fault::error(ProblemKind::Record, location, message));
            continue;
        };
        let size = super::syncom::declared_size(
            Some(crate::json::Number(camera.width as f64)),
            Some(crate::json::Number(camera.height as f64)),
        );
        let (model, size) = match (&camera.model, size) {
            (Ok(model), Ok(size)) => (model, size),
            (Err(message), _) => {
                if faulty.insert(camera.id) {
                    let place = format!("camera {}", camera.id);
                    listing.faults.push(Fault::error(ProblemKind::Intrinsics, place, message.clone()));
                }
                continue;
            }
            (_, Err(message)) => {
                if faulty.insert(camera.id) {
                    let place = format!("camera {}", camera.id);
                    listing.faults.push(Fault::error(ProblemKind::ImageSize, place, message));
                }
                continue;
            }
        };
        let [w, x, y, z] = image.rotation;
        let (q, t) = (DQuat::from_xyzw(x, y, z, w), DVec3::from_array(image.translation));
        if !(q.length_squared() > 1e-12) || !q.is_finite() || !t.is_finite() {
            let message = format!("the pose of {:?} is not invertible: {:?} {t}", image.name, image.rotation);
            listing.faults.push(Fault::error(ProblemKind::Pose, location, message));
            continue;
        }
        listing.frames.push(Frame {
            name: String::new(),
            location,
            file: image.name.clone(),
            mask: None,
            size,
            intrinsics: model.0,
            lens: model.1,
            world_from_camera: DAffine3::from_rotation_translation(q.normalize(), t).inverse(),
            split: None,
        });
    }
    name_by_file(&mut listing.frames);
    for frame in &listing.frames {
        if !is_plain_name(&frame.name) {
            let message = format!("{:?} gives no usable name", frame.file);
            listing.faults.push(Fault::error(ProblemKind::Record, &frame.location, message));
        }
    }
    listing.frames.retain(|f| is_plain_name(&f.name));
    listing
}

/// Appends a 3D point; non-finite ones are left out.
fn push_point(cloud: &mut PointCloud, position: [f64; 3], rgb: [u8; 3]) {
    let position = position.map(|v| v as f32);
    if position.iter().all(|v| v.is_finite()) {
        cloud.positions.push(position);
        let color = rgb.map(|v| transfer::linear_from_srgb(f32::from(v) / 255.0));
        cloud.colors.get_or_insert_default().push(color);
    }
}
