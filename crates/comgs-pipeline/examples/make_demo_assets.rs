//! Makes `assets/demo` from a SynCom-style root: a reduced copy, small enough to ship.
//!
//! `cargo run --release -p comgs-pipeline --example make_demo_assets -- ROOT OBJECT SCENE assets/demo`

use comgs_geom::Camera;
use comgs_image::{Image, read, write_exr, write_png};
use comgs_scene::{read_cameras, write_cameras};
use std::path::{Path, PathBuf};

/// Every `count`-th view of a list, evenly spread.
fn pick(cameras: Vec<Camera>, count: usize) -> Vec<Camera> {
    let n = cameras.len();
    cameras
        .into_iter()
        .enumerate()
        .filter(|(i, _)| (i * count) / n != ((i + 1) * count) / n)
        .map(|(_, c)| c)
        .collect()
}

fn image_file(folder: &Path, name: &str) -> Option<PathBuf> {
    ["exr", "png"].iter().map(|e| folder.join(format!("{name}.{e}"))).find(|p| p.is_file())
}

/// Reduces one image; straight alpha is averaged with its colour premultiplied.
fn reduce(from: &Path, to: &Path, width: usize, height: usize) {
    let loaded = read(from).expect("an image");
    let image = match loaded.alpha {
        None => loaded.color.resized(width, height),
        Some(alpha) => {
            let mut both = Image::zeros(alpha.width, alpha.height, 4);
            for i in 0..alpha.pixels() {
                let a = alpha.data[i];
                for c in 0..3 {
                    both.data[4 * i + c] = a * loaded.color.data[3 * i + c];
                }
                both.data[4 * i + 3] = a;
            }
            let mut small = both.resized(width, height);
            for p in small.data.chunks_exact_mut(4) {
                let a = p[3];
                p[..3].iter_mut().for_each(|v| *v = if a > 1.0 / 255.0 { *v / a } else { 0.0 });
            }
            small
        }
    };
    let png = to.extension().is_some_and(|e| e == "png");
    if png { write_png(to, &image) } else { write_exr(to, &image) }.expect("a writable folder");
}

/// Copies `folders` of images for the picked cameras of `from`, reduced to `width`.
fn copy(from: &Path, to: &Path, cameras: usize, width: usize, folders: &[&str]) {
    let picked = pick(read_cameras(from.join("cameras.json")).expect("cameras"), cameras);
    let small: Vec<Camera> = picked.iter().map(|c| c.resized(width, c.height * width / c.width)).collect();
    write_cameras(to.join("cameras.json"), &small).expect("a writable folder");
    for folder in folders {
        for c in &small {
            if let Some(source) = image_file(&from.join(folder), &c.name) {
                let target = to.join(folder).join(source.file_name().expect("a file"));
                reduce(&source, &target, c.width, c.height);
            }
        }
    }
}

fn main() {
    let a: Vec<String> = std::env::args().skip(1).collect();
    let [root, object, scene, out] = a.as_slice() else { panic!("ROOT OBJECT SCENE OUT") };
    let (root, out) = (Path::new(root), Path::new(out));
    let (object_from, object_to) = (root.join("object").join(object), out.join("object").join(object));
    copy(&object_from.join("train"), &object_to.join("train"), 36, 200, &["images"]);
    copy(&object_from.join("test"), &object_to.join("test"), 6, 200, &["images", "normal"]);
    let (scene_from, scene_to) = (root.join("scene").join(scene), out.join("scene").join(scene));
    copy(&scene_from.join("train"), &scene_to.join("train"), 52, 256, &["images"]);
    copy(&scene_from.join("test"), &scene_to.join("test"), 5, 256, &["images"]);
    let name = format!("{scene}_with_{object}");
    let (from, to) = (root.join("composition").join(&name), out.join("composition").join(&name));
    copy(&from, &to, 4, 256, &["images", "images_linear", "mask", "empty", "empty_linear"]);
    std::fs::copy(from.join("transform.json"), to.join("transform.json")).expect("transform.json");
    reduce(&from.join("envmap_gt.exr"), &to.join("envmap_gt.exr"), 256, 128);
}
