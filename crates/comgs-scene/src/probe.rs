//! Entry points for fuzzers and mutation tests: bytes in, nothing out, and never a panic. One function a file family.
//!
//! What a parser accepts is also used the way the readers use it, so that a value that passes parsing and breaks its
//! user is found too.

use crate::asset::parse_record;
use crate::capture::colmap;
use crate::capture::frame::Listing;
use crate::capture::{syncom as syncom_format, transforms as transforms_format};
use crate::{CompositionRecord, TransformFile};
use comgs_geom::Camera;
use comgs_surfel::ply as ply_format;
use comgs_surfel::ply::PlyStyle;
use glam::DVec2;
use std::path::Path;

fn here() -> &'static Path {
    Path::new("memory")
}

/// PLY: surfels and points. Surfels that were read are written and must read back.
///
/// # Panics
/// When a cloud that was read is unsound or does not read back: a bug.
pub fn ply(data: &[u8]) {
    let _ = ply_format::parse_points(data, here());
    if let Ok((cloud, report)) = ply_format::parse_surfels(data, here()) {
        assert_eq!(cloud.problems(), Vec::<String>::new());
        assert_eq!(cloud.len(), report.count);
        for style in [PlyStyle::Asset, PlyStyle::Viewer] {
            let mut bytes = Vec::new();
            assert!(ply_format::write_surfels_to(&mut bytes, &cloud, style).is_ok());
            let back = ply_format::parse_surfels(&bytes, here()).map(|(back, _)| back.positions);
            assert!(back.is_ok_and(|positions| positions == cloud.positions), "what is written reads back");
        }
    }
}

/// COLMAP: all six files of a model, binary and text.
pub fn colmap(data: &[u8]) {
    let length = data.len() as u64;
    let cameras = [
        colmap::parse_cameras_binary(data, length, here()).unwrap_or_default(),
        colmap::parse_cameras_text(data, here()).unwrap_or_default(),
    ];
    let images = [
        colmap::parse_images_binary(data, length, here()).unwrap_or_default(),
        colmap::parse_images_text(data, here()).unwrap_or_default(),
    ];
    let _ = colmap::parse_points_binary(data, length, here());
    let _ = colmap::parse_points_text(data, here());
    for cameras in &cameras {
        for images in &images {
            use_listing(&colmap::listing(cameras, images.clone()));
        }
        // Images of another file meet these cameras by giving every camera an image.
        let made_up = cameras.iter().take(100).map(|c| colmap::ColmapImage {
            id: c.id,
            rotation: [1.0, 0.0, 0.0, 0.0],
            translation: [0.0; 3],
            camera_id: c.id,
            name: format!("{}.png", c.id),
        });
        use_listing(&colmap::listing(cameras, made_up.collect()));
    }
}

/// Blender/NeRF `transforms.json`.
pub fn transforms(data: &[u8]) {
    if let Ok(listing) = transforms_format::parse(data, here()) {
        use_listing(&listing);
    }
}

/// SynCom `cameras.json` and `transform.json`.
pub fn syncom(data: &[u8]) {
    if let Ok(listing) = syncom_format::parse(data, here()) {
        use_listing(&listing);
    }
    let _ = TransformFile::parse(data, here());
}

/// `asset.json` and `composition.json`.
pub fn asset(data: &[u8]) {
    let _ = parse_record(data, here());
    let _ = CompositionRecord::parse(data, here());
}

/// Pictures: EXR, HDR, PNG, JPEG. What was decoded has as many samples as its size says, and a camera accepts that size.
///
/// # Panics
/// When a decoded picture contradicts itself: a bug.
pub fn image(data: &[u8]) {
    let Ok(loaded) = comgs_image::read::decode(data, here()) else { return };
    let (w, h) = (loaded.color.width, loaded.color.height);
    assert!(w > 0 && h > 0 && w * h <= comgs_geom::camera::MAX_PIXELS);
    assert_eq!(loaded.color.data.len(), w * h * loaded.color.channels);
    assert!(loaded.alpha.is_none_or(|a| (a.width, a.height, a.channels) == (w, h, 1)));
}

fn use_listing(listing: &Listing) {
    for frame in listing.frames.iter().take(100) {
        let (width, height) = frame.size.unwrap_or((64, 48));
        let [fx, fy, cx, cy] = frame.intrinsics.resolve(width, height);
        let name = frame.name.clone();
        let camera =
            Camera { name, width, height, fx, fy, cx, cy, world_from_camera: frame.world_from_camera };
        let _ = camera.problems();
        let _ = frame.lens.valid_radius();
        let _ = frame.lens.undistort(DVec2::new(0.4, -0.3));
    }
}
