//! A small world for the tests: a floor with a checker, a ball, cameras around them, captures and assets of both.

#![allow(dead_code, reason = "each test file uses its part")]

use comgs_geom::{Camera, sampling::uniform_sphere};
use comgs_image::{Image, write_exr, write_png};
use comgs_raster::{Planes, RasterConfig};
use comgs_scene::{Asset, AssetKind, write_cameras};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation::logit};
use glam::{DVec3, Vec2, Vec3};
use std::path::{Path, PathBuf};

fn push(cloud: &mut SurfelCloud, p: Vec3, normal: Vec3, sigma: f32, rgb: [f32; 3]) {
    let q = glam::Quat::from_rotation_arc(Vec3::Z, normal.normalize());
    cloud.positions.push(p.to_array());
    cloud.rotations.push([q.w, q.x, q.y, q.z]);
    cloud.log_scales.push([sigma.ln(); 2]);
    cloud.opacity_logits.push(logit(0.97));
    let code = rgb.map(comgs_image::transfer::srgb_from_linear);
    cloud.sh.extend(code.map(|c| (c - 0.5) / comgs_geom::sh::basis(0, Vec3::Z)[0]));
}

/// A floor at z = 0, 6 × 6, with a low wall at its back.
pub fn scene_cloud() -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Srgb);
    let n = 40;
    for i in 0..n * n {
        let (a, b) = (i % n, i / n);
        let p = Vec3::new(a as f32 + 0.5, b as f32 + 0.5, 0.0) * (6.0 / n as f32) - Vec3::new(3.0, 3.0, 0.0);
        let rgb = if (a / 4 + b / 4) % 2 == 0 { [0.6, 0.5, 0.35] } else { [0.25, 0.3, 0.4] };
        push(&mut cloud, p, Vec3::Z, 0.1, rgb);
    }
    for i in 0..n * 12 {
        let p = Vec3::new((i % n) as f32 * 6.0 / n as f32 - 2.9, 3.0, (i / n) as f32 * 0.15 + 0.05);
        push(&mut cloud, p, -Vec3::Y, 0.1, [0.5, 0.5 * ((i % 7) as f32) / 7.0, 0.4]);
    }
    cloud
}

/// A ball of radius ½ around the origin.
pub fn object_cloud() -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Srgb);
    let n = 700;
    for i in 0..n {
        let golden = 0.618_034 * i as f32;
        let d = uniform_sphere(Vec2::new((i as f32 + 0.5) / n as f32, golden - golden.floor()));
        push(&mut cloud, 0.5 * d, d, 0.035, [0.7, 0.2 + 0.2 * d.x.abs(), 0.15]);
    }
    cloud
}

/// Cameras on a ring that look at the middle.
pub fn ring(count: usize, radius: f64, height: f64, size: (usize, usize), hfov: f64) -> Vec<Camera> {
    (0..count)
        .map(|i| {
            let a = std::f64::consts::TAU * (i as f64 + 0.37) / count as f64;
            let eye = DVec3::new(radius * a.cos(), radius * a.sin(), height);
            Camera::look_at(
                &format!("{i:05}"),
                size.0,
                size.1,
                hfov,
                eye,
                DVec3::new(0.0, 0.0, 0.2),
                DVec3::Z,
            )
        })
        .collect()
}

pub fn picture(cloud: &SurfelCloud, camera: &Camera) -> (Image, Image) {
    let frame = comgs_raster::render(cloud, camera, Planes::COLOR, &RasterConfig::default());
    (frame.color.unwrap(), frame.weight)
}

/// A capture with `train` and `test`: an object as EXR with straight alpha, a scene as PNG.
pub fn write_capture(root: &Path, cloud: &SurfelCloud, kind: AssetKind, cameras: &[Camera]) {
    for (split, cameras) in [("train", cameras), ("test", &cameras[..2])] {
        for camera in cameras {
            let (color, weight) = picture(cloud, camera);
            let images = root.join(split).join("images");
            if kind == AssetKind::Object {
                let mut rgba = Image::zeros(camera.width, camera.height, 4);
                for i in 0..weight.pixels() {
                    let a = weight.data[i];
                    for c in 0..3 {
                        rgba.data[4 * i + c] = if a > 1.0 / 255.0 { color.data[3 * i + c] / a } else { 0.0 };
                    }
                    rgba.data[4 * i + 3] = a;
                }
                write_exr(&images.join(format!("{}.exr", camera.name)), &rgba).unwrap();
            } else {
                write_png(&images.join(format!("{}.png", camera.name)), &color).unwrap();
            }
        }
        write_cameras(root.join(split).join("cameras.json"), cameras).unwrap();
    }
}

/// Saved assets of both, the scene with its cameras.
pub struct World {
    pub scene: PathBuf,
    pub object: PathBuf,
    pub cameras: PathBuf,
}

pub fn world(root: &Path) -> World {
    let (scene, object) = (root.join("room.asset"), root.join("ball.asset"));
    Asset::new(AssetKind::Scene, scene_cloud()).save(&scene).unwrap();
    Asset::new(AssetKind::Object, object_cloud()).save(&object).unwrap();
    let cameras = ring(3, 2.6, 1.5, (64, 48), 0.8);
    write_cameras(scene.join("cameras.json"), &ring(8, 2.8, 1.6, (64, 48), 0.9)).unwrap();
    write_cameras(root.join("cameras.json"), &cameras).unwrap();
    World { scene, object, cameras: root.join("cameras.json") }
}
