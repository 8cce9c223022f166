//! Small captures on disk, made from nothing.
#![allow(dead_code, missing_docs)]

use comgs_geom::Camera;
use comgs_image::Image;
use glam::{DMat4, DVec3};
use std::fmt::Write as _;
use std::path::Path;

pub const WIDTH: usize = 24;
pub const HEIGHT: usize = 16;

/// Cameras on a circle that look at the origin.
pub fn ring(n: usize) -> Vec<Camera> {
    (0..n)
        .map(|i| {
            let a = i as f64 * 0.6;
            let eye = DVec3::new(3.0 * a.cos(), 3.0 * a.sin(), 1.0 + 0.1 * i as f64);
            Camera::look_at(&format!("{i:05}"), WIDTH, HEIGHT, 1.0, eye, DVec3::ZERO, DVec3::Z)
        })
        .collect()
}

/// A picture that differs from pixel to pixel; channels as asked.
pub fn picture(width: usize, height: usize, channels: usize, seed: usize) -> Image {
    let data = (0..width * height * channels).map(|i| ((i * 37 + seed * 11) % 101) as f32 / 100.0).collect();
    Image::from_data(width, height, channels, data)
}

pub fn png(path: &Path, width: usize, height: usize) {
    comgs_image::write_png(path, &picture(width, height, 3, 1)).unwrap();
}

pub fn exr(path: &Path, width: usize, height: usize) {
    comgs_image::write_exr(path, &picture(width, height, 4, 2)).unwrap();
}

/// A flat SynCom capture with PNG images.
pub fn syncom(root: &Path, cameras: &[Camera]) {
    comgs_scene::write_cameras(root.join("cameras.json"), cameras).unwrap();
    for camera in cameras {
        png(&root.join("images").join(format!("{}.png", camera.name)), camera.width, camera.height);
    }
}

/// Row-major text of a camera's OpenGL pose, as nested lists.
pub fn gl_rows(camera: &Camera) -> String {
    let m = DMat4::from(Camera::flip_opengl_axes(camera.world_from_camera));
    let rows: Vec<String> = (0..4).map(|r| format!("{:?}", m.row(r).to_array())).collect();
    format!("[{}]", rows.join(","))
}

/// A `transforms.json` with common parameters at the top.
pub fn transforms(path: &Path, top: &str, frames: &[(&str, &Camera, &str)]) {
    let frames: Vec<String> = frames
        .iter()
        .map(|(file, camera, extra)| {
            format!(r#"{{"file_path": "{file}", "transform_matrix": {}{extra}}}"#, gl_rows(camera))
        })
        .collect();
    std::fs::write(path, format!(r#"{{{top} "frames": [{}]}}"#, frames.join(","))).unwrap();
}

/// Text and binary of a COLMAP model: one camera of the given model, the given images, two points.
pub struct Colmap {
    pub text: [String; 3],
    pub binary: [Vec<u8>; 3],
}

pub fn colmap(
    model: (u32, &str),
    parameters: &[f64],
    size: (u64, u64),
    images: &[(&str, &Camera)],
) -> Colmap {
    let mut text = [String::from("# cameras\n"), String::from("# images\n"), String::from("# points\n")];
    let mut binary: [Vec<u8>; 3] = Default::default();
    let numbers: Vec<String> = parameters.iter().map(f64::to_string).collect();
    writeln!(text[0], "7 {} {} {} {}", model.1, size.0, size.1, numbers.join(" ")).unwrap();
    binary[0].extend(1u64.to_le_bytes());
    binary[0].extend(7u32.to_le_bytes());
    binary[0].extend(model.0.to_le_bytes());
    binary[0].extend(size.0.to_le_bytes());
    binary[0].extend(size.1.to_le_bytes());
    parameters.iter().for_each(|p| binary[0].extend(p.to_le_bytes()));

    binary[1].extend((images.len() as u64).to_le_bytes());
    for (i, (name, camera)) in images.iter().enumerate() {
        let (_, q, t) = camera.camera_from_world().to_scale_rotation_translation();
        let pose = [q.w, q.x, q.y, q.z, t.x, t.y, t.z];
        let words: Vec<String> = pose.iter().map(f64::to_string).collect();
        // Every other image has no 2D points: an empty line that is not to be taken for the next image.
        let points = if i % 2 == 0 { "1.5 2.5 0 3.5 4.5 -1" } else { "" };
        writeln!(text[1], "{} {} 7 {name}\n{points}", i + 1, words.join(" ")).unwrap();
        binary[1].extend((i as u32 + 1).to_le_bytes());
        pose.iter().for_each(|p| binary[1].extend(p.to_le_bytes()));
        binary[1].extend(7u32.to_le_bytes());
        binary[1].extend(name.bytes());
        binary[1].push(0);
        let count = if i % 2 == 0 { 2u64 } else { 0 };
        binary[1].extend(count.to_le_bytes());
        binary[1].extend(vec![0u8; 24 * count as usize]);
    }
    binary[2].extend(2u64.to_le_bytes());
    for (i, p) in [[0.1f64, 0.2, 0.3], [-1.0, 0.5, 0.25]].iter().enumerate() {
        writeln!(text[2], "{i} {} {} {} 255 0 {} 0.5 1 0 2 1", p[0], p[1], p[2], 100 * i).unwrap();
        binary[2].extend((i as u64).to_le_bytes());
        p.iter().for_each(|v| binary[2].extend(v.to_le_bytes()));
        binary[2].extend([255, 0, 100 * i as u8]);
        binary[2].extend(0.5f64.to_le_bytes());
        binary[2].extend(2u64.to_le_bytes());
        binary[2].extend([0u8; 16]);
    }
    Colmap { text, binary }
}

impl Colmap {
    pub fn write(&self, model: &Path, as_text: bool) {
        std::fs::create_dir_all(model).unwrap();
        for (i, name) in ["cameras", "images", "points3D"].iter().enumerate() {
            if as_text {
                std::fs::write(model.join(format!("{name}.txt")), &self.text[i]).unwrap();
            } else {
                std::fs::write(model.join(format!("{name}.bin")), &self.binary[i]).unwrap();
            }
        }
    }
}
