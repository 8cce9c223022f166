//! Every capture format, from files to pixels.

mod common;

use comgs_geom::{Camera, Lens};
use comgs_image::{Encoding, Image};
use comgs_scene::{
    Capture, Format, LoadOptions, OpenOptions, ProblemKind, SceneError, Size, Split, check, read_cameras,
};
use common::{HEIGHT, WIDTH, colmap, exr, picture, png, ring, syncom, transforms};
use glam::DVec3;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Rounding of a pose through text, inversion and quaternions.
const POSE_TOLERANCE: f64 = 1e-9;

fn assert_same_camera(a: &Camera, b: &Camera) {
    assert_eq!((a.width, a.height), (b.width, b.height));
    for (x, y) in [(a.fx, b.fx), (a.fy, b.fy), (a.cx, b.cx), (a.cy, b.cy)] {
        assert!((x - y).abs() < 1e-6, "{a:?} {b:?}");
    }
    let difference = a.world_from_camera.to_cols_array().into_iter().zip(b.world_from_camera.to_cols_array());
    assert!(difference.map(|(x, y)| (x - y).abs()).fold(0.0, f64::max) < POSE_TOLERANCE, "{a:?} {b:?}");
}

fn names(capture: &Capture) -> Vec<&str> {
    capture.views.iter().map(|v| v.camera.name.as_str()).collect()
}

/// Goal: a SynCom object (HDR, alpha, own splits) opens by folder, split and file; poses, names and pixels are right.
#[test]
fn syncom_object_with_splits() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(5);
    for (split, cameras) in [("train", &cameras[..3]), ("test", &cameras[..2])] {
        comgs_scene::write_cameras(root.join(split).join("cameras.json"), cameras).unwrap();
        for camera in cameras {
            exr(&root.join(split).join(format!("images/{}.exr", camera.name)), WIDTH, HEIGHT);
        }
    }
    let train = Capture::open(root, Split::Train).unwrap();
    assert_eq!(
        (train.format, train.held_out, names(&train)),
        (Format::SynCom, false, vec!["00000", "00001", "00002"])
    );
    for (view, camera) in train.views.iter().zip(&cameras) {
        assert_same_camera(&view.camera, camera);
    }
    let all = Capture::open(root, Split::All).unwrap();
    assert_eq!(names(&all), ["train_00000", "train_00001", "train_00002", "test_00000", "test_00001"]);
    assert_eq!(all.views[3].split, Split::Test);
    assert_eq!(Capture::open(root.join("test"), Split::All).unwrap().views.len(), 2);
    assert_eq!(read_cameras(root.join("train/cameras.json")).unwrap().len(), 3);
    assert_eq!(read_cameras(root).unwrap().len(), 5);

    let steps = Mutex::new(Vec::new());
    let views = train
        .load_with(&LoadOptions::default(), &|p| {
            steps.lock().unwrap().push((p.done, p.total, p.name.to_owned()))
        })
        .unwrap();
    assert_eq!(steps.into_inner().unwrap().len(), 3);
    let (view, expected) = (&views[0], picture(WIDTH, HEIGHT, 4, 2));
    assert_eq!(
        (view.encoding, view.color.channels, view.valid.is_none(), view.repaired),
        (Encoding::Linear, 3, true, 0)
    );
    let alpha = view.alpha.as_ref().unwrap();
    for i in 0..WIDTH * HEIGHT {
        // Half floats carry 11 bits.
        assert!(
            (view.color.data[i * 3 + 1] - expected.data[i * 4 + 1]).abs() < 1e-3,
            "straight alpha is kept"
        );
        assert!((alpha.data[i] - expected.data[i * 4 + 3]).abs() < 1e-3);
    }
}

/// Goal: cameras written are cameras read, and images are preferred in the order EXR, PNG; another image folder can be
/// chosen.
#[test]
fn camera_files_and_image_folders() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut cameras = ring(3);
    cameras[1].fy *= 1.2;
    cameras[1].cx -= 30.0;
    syncom(root, &cameras);
    exr(&root.join("images/00001.exr"), WIDTH, HEIGHT);
    exr(&root.join("images_linear/00000.exr"), WIDTH, HEIGHT);
    let read = read_cameras(root.join("cameras.json")).unwrap();
    assert_eq!(read.len(), 3);
    for (a, b) in read.iter().zip(&cameras) {
        assert_same_camera(a, b);
    }
    let capture = Capture::open(root, Split::All).unwrap();
    let extensions: Vec<_> =
        capture.views.iter().map(|v| v.image.extension().unwrap().to_str().unwrap()).collect();
    assert_eq!(extensions, ["png", "exr", "png"]);
    let options = OpenOptions { split: Split::All, images: Some(PathBuf::from("images_linear")) };
    let linear = Capture::open_with(root, &options).unwrap();
    assert_eq!((names(&linear), linear.report.left_out.len()), (vec!["00000"], 2));
}

/// Goal: NeRF captures: focal length from the field of view, size from the image, overrides in a frame, paths without
/// extensions, splits by file.
#[test]
fn blender_transforms() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(3);
    for split in ["train", "test"] {
        for i in 0..2 {
            png(&root.join(format!("{split}/r_{i}.png")), WIDTH, HEIGHT);
        }
        let paths = [format!("./{split}/r_0"), format!("{split}/r_1")];
        let frames = [
            (paths[0].as_str(), &cameras[0], ""),
            (paths[1].as_str(), &cameras[1], r#", "fl_x": 40, "cx": 3"#),
        ];
        transforms(&root.join(format!("transforms_{split}.json")), r#""camera_angle_x": 1.0,"#, &frames);
    }
    let capture = Capture::open(root, Split::Train).unwrap();
    assert_eq!((capture.format, names(&capture)), (Format::Transforms, vec!["r_0", "r_1"]));
    assert_same_camera(&capture.views[0].camera, &cameras[0]);
    let own = &capture.views[1].camera;
    assert_eq!((own.fx, own.fy, own.cx, own.cy), (40.0, 40.0, 3.0, HEIGHT as f64 / 2.0));
    assert_eq!(
        names(&Capture::open(root, Split::All).unwrap()),
        ["train_r_0", "train_r_1", "test_r_0", "test_r_1"]
    );
    assert_eq!(read_cameras(root).unwrap().len(), 4);
}

/// Goal: a phone capture with a lens, missing images and no splits: missing frames are named and left out, every eighth
/// view is held out, pixels are straightened with the unseen ones masked.
#[test]
fn lens_missing_images_and_hold_out() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(12);
    let files: Vec<String> = (0..12).map(|i| format!("images/{i:04}.png")).collect();
    for (i, file) in files.iter().enumerate() {
        if i != 2 && i != 5 {
            png(&root.join(file), WIDTH, HEIGHT);
        }
    }
    let frames: Vec<_> = files.iter().zip(&cameras).map(|(f, c)| (f.as_str(), c, "")).collect();
    let top = format!(
        r#""fl_x": 22, "fl_y": 22.5, "cx": 12.5, "cy": 8.1, "w": {WIDTH}.0, "h": {HEIGHT}.0, "k1": 0.4, "k2": -0.01, "p1": 0.001,"#
    );
    transforms(&root.join("transforms.json"), &top, &frames);
    let all = Capture::open(root, Split::All).unwrap();
    assert_eq!(all.views.len(), 10);
    assert_eq!(all.report.left_out, ["0002", "0005"]);
    let missing: Vec<_> = all.report.problems.iter().map(|p| (p.kind, p.location.as_str())).collect();
    assert_eq!(missing, [(ProblemKind::MissingImage, "frames[2]"), (ProblemKind::MissingImage, "frames[5]")]);
    assert!(all.report.problems[0].path.ends_with("images/0002.png"));
    let test = Capture::open(root, Split::Test).unwrap();
    assert_eq!((names(&test), test.held_out), (vec!["0000", "0010"], true));
    let train = Capture::open(root, Split::Train).unwrap();
    assert_eq!(train.views.len(), 8);
    assert_eq!(train.views[0].lens, Lens::open_cv([0.4, -0.01, 0.0, 0.0, 0.0, 0.0], [0.001, 0.0]));
    let view = train.views[0].load(&LoadOptions::default()).unwrap();
    let valid = view.valid.expect("the corners of a pincushion lens are not seen");
    assert_eq!((valid.pixel(0, 0)[0], valid.pixel(12, 8)[0]), (0.0, 1.0));
    assert_eq!(view.color.rgb(0, 0), [0.0; 3]);
    assert_eq!((view.camera.fx, view.camera.cx), (22.0, 12.5));
    // Cameras alone need no images and keep every frame.
    assert_eq!(read_cameras(root.join("transforms.json")).unwrap().len(), 12);
}

/// Goal: nerfstudio's split lists, point cloud, masks and fisheye model.
#[test]
fn nerfstudio_transforms() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(3);
    let files = ["images/a.png", "images/b.png", "images/c.png"];
    for file in files {
        png(&root.join(file), WIDTH, HEIGHT);
    }
    comgs_image::write_png(&root.join("m/a.png"), &Image::filled(WIDTH, HEIGHT, 1, 0.2140411)).unwrap();
    let frames: Vec<_> = files
        .iter()
        .zip(&cameras)
        .map(|(f, c)| (*f, c, if f.contains("/a") { r#", "mask_path": "m/a.png""# } else { "" }))
        .collect();
    let top = r#""camera_model": "OPENCV_FISHEYE", "fl_x": 20, "k1": 0.01, "k4": 0.002, "ply_file_path": "sparse.ply",
        "train_filenames": ["images/a.png", "images/b.png"], "test_filenames": ["images/c.png"],"#;
    transforms(&root.join("transforms.json"), top, &frames);
    let points = comgs_surfel::PointCloud { positions: vec![[1.0, 2.0, 3.0]], ..Default::default() };
    comgs_surfel::ply::write_points(&root.join("sparse.ply"), &points).unwrap();
    let train = Capture::open(root, Split::Train).unwrap();
    assert_eq!((names(&train), train.held_out), (vec!["a", "b"], false));
    assert_eq!(names(&Capture::open(root, Split::Test).unwrap()), ["c"]);
    assert_eq!(train.views[0].lens, Lens::Fisheye { k: [0.01, 0.0, 0.0, 0.002] });
    assert_eq!(train.points().unwrap().unwrap().cloud, points);
    let alpha = train.views[0].load(&LoadOptions::default()).unwrap().alpha.unwrap();
    // Grey code 128 of a mask means one half, not its sRGB luminance.
    assert!((alpha.pixel(12, 8)[0] - 0.5).abs() < 0.01, "{}", alpha.pixel(12, 8)[0]);
}

/// Goal: COLMAP text and binary models give the same views, sorted by name, with poses, lens, points, COLMAP's mask names
/// and the upward direction; smaller image folders rescale the camera.
#[test]
fn colmap_text_and_binary() {
    let cameras = ring(4);
    let files = ["b.jpg.png", "a.png", "sub/a.png", "c d.png"];
    let images: Vec<(&str, &Camera)> = files.iter().copied().zip(&cameras).collect();
    let size = (2 * WIDTH as u64, 2 * HEIGHT as u64);
    let model = colmap((4, "OPENCV"), &[44.0, 45.0, 24.0, 16.0, 0.1, -0.02, 0.001, 0.002], size, &images);
    for as_text in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        model.write(&root.join("sparse/0"), as_text);
        for file in files {
            png(&root.join("images_2").join(file), WIDTH, HEIGHT);
        }
        comgs_image::write_png(&root.join("masks/a.png.png"), &Image::filled(WIDTH, HEIGHT, 1, 1.0)).unwrap();
        let capture = Capture::open(root, Split::All).unwrap();
        assert_eq!(names(&capture), ["a", "b.jpg", "c d", "sub_a"]);
        assert!(capture.report.problems.is_empty(), "{}", capture.report);
        assert_eq!(capture.views[0].lens, Lens::open_cv([0.1, -0.02, 0.0, 0.0, 0.0, 0.0], [0.001, 0.002]));
        let expected = Camera { fx: 22.0, fy: 22.5, cx: 12.0, cy: 8.0, ..cameras[1].clone() };
        assert_same_camera(&capture.views[0].camera, &expected);
        assert!(capture.views[0].mask.is_some() && capture.views[1].mask.is_none());
        assert!(capture.up.dot(DVec3::Z) > 0.8, "{}", capture.up);
        let points = capture.points().unwrap().unwrap();
        assert_eq!(points.cloud.positions, [[0.1, 0.2, 0.3], [-1.0, 0.5, 0.25]]);
        assert_eq!(points.cloud.colors.unwrap()[0], [1.0, 0.0, 0.0]);
        for path in [root.to_owned(), root.join("sparse"), root.join("sparse/0")] {
            let read = read_cameras(&path).unwrap();
            assert_eq!((read.len(), read[0].width), (4, 2 * WIDTH));
        }
    }
}

/// Goal: every COLMAP camera model maps to its lens, and those that are not understood are refused by name.
#[test]
fn colmap_models() {
    let models: [(u32, &str, &[f64], Option<Lens>); 12] = [
        (0, "SIMPLE_PINHOLE", &[9.0, 1.0, 2.0], Some(Lens::Pinhole)),
        (1, "PINHOLE", &[9.0, 9.0, 1.0, 2.0], Some(Lens::Pinhole)),
        (
            2,
            "SIMPLE_RADIAL",
            &[9.0, 1.0, 2.0, 0.1],
            Some(Lens::open_cv([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2])),
        ),
        (
            3,
            "RADIAL",
            &[9.0, 1.0, 2.0, 0.1, 0.2],
            Some(Lens::open_cv([0.1, 0.2, 0.0, 0.0, 0.0, 0.0], [0.0; 2])),
        ),
        (
            4,
            "OPENCV",
            &[9.0, 9.0, 1.0, 2.0, 0.1, 0.2, 0.3, 0.4],
            Some(Lens::open_cv([0.1, 0.2, 0.0, 0.0, 0.0, 0.0], [0.3, 0.4])),
        ),
        (
            5,
            "OPENCV_FISHEYE",
            &[9.0, 9.0, 1.0, 2.0, 0.1, 0.2, 0.3, 0.4],
            Some(Lens::Fisheye { k: [0.1, 0.2, 0.3, 0.4] }),
        ),
        (
            6,
            "FULL_OPENCV",
            &[9.0, 9.0, 1.0, 2.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8],
            Some(Lens::open_cv([0.1, 0.2, 0.5, 0.6, 0.7, 0.8], [0.3, 0.4])),
        ),
        (7, "FOV", &[9.0, 9.0, 1.0, 2.0, 0.1], None),
        (8, "SIMPLE_RADIAL_FISHEYE", &[9.0, 1.0, 2.0, 0.1], Some(Lens::Fisheye { k: [0.1, 0.0, 0.0, 0.0] })),
        (9, "RADIAL_FISHEYE", &[9.0, 1.0, 2.0, 0.1, 0.2], Some(Lens::Fisheye { k: [0.1, 0.2, 0.0, 0.0] })),
        (10, "THIN_PRISM_FISHEYE", &[9.0; 12], None),
        (11, "RAD_TAN_THIN_PRISM_FISHEYE", &[9.0; 16], None),
    ];
    for (number, name, parameters, lens) in models {
        let model = colmap((number, name), parameters, (24, 16), &[]);
        let path = Path::new("cameras");
        let text = comgs_scene::capture::colmap::parse_cameras_text(model.text[0].as_bytes(), path).unwrap();
        let bytes = model.binary[0].as_slice();
        let binary =
            comgs_scene::capture::colmap::parse_cameras_binary(bytes, bytes.len() as u64, path).unwrap();
        assert_eq!(text, binary);
        match (&text[0].model, lens) {
            (Ok((intrinsics, found)), Some(expected)) => {
                assert_eq!((*found, intrinsics.resolve(24, 16)), (expected, [9.0, 9.0, 1.0, 2.0]), "{name}");
            }
            (Err(message), None) => assert!(message.contains(name), "{message}"),
            (found, expected) => panic!("{name}: {found:?}, expected {expected:?}"),
        }
    }
}

/// Goal: reduced images keep colour at the object's edge: the mean of straight colours is weighted by alpha, and the
/// camera shrinks along.
#[test]
fn downscaling_keeps_edges_clean() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(1);
    syncom(root, &cameras);
    // Red where covered, with a black nothing beside it, as renderers write it.
    let mut image = Image::zeros(WIDTH, HEIGHT, 4);
    for y in 0..HEIGHT {
        for x in 0..5 {
            image.pixel_mut(x, y).copy_from_slice(&[2.0, 0.0, 0.0, 1.0]);
        }
    }
    comgs_image::write_exr(&root.join("images/00000.exr"), &image).unwrap();
    let capture = Capture::open(root, Split::All).unwrap();
    let view = &capture.load(&LoadOptions { size: Size::MaxWidth(12) }).unwrap()[0];
    assert_eq!((view.camera.width, view.camera.height), (12, 8));
    assert!((view.camera.fx - cameras[0].fx / 2.0).abs() < 1e-9);
    let alpha = view.alpha.as_ref().unwrap();
    assert_eq!((alpha.pixel(2, 3)[0], alpha.pixel(3, 3)[0]), (0.5, 0.0));
    assert_eq!(view.color.rgb(2, 3), [2.0, 0.0, 0.0], "the edge is as red as the inside");
    let same = &capture.load(&LoadOptions { size: Size::Downscale(0.5) }).unwrap()[0];
    assert_eq!(same.camera.width, WIDTH, "images are never enlarged");
    assert!(capture.memory_bytes(&LoadOptions::default()) >= (WIDTH * HEIGHT * 16) as u64);
}

/// Goal: NaN and infinite pixels are zeroed, counted, and marked as not valid (hard case 26 for photographs).
#[test]
fn non_finite_pixels_are_ignored() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    syncom(root, &ring(1));
    let mut image = picture(WIDTH, HEIGHT, 3, 4);
    image.pixel_mut(3, 2)[1] = f32::NAN;
    let layer = comgs_image::Layer { name: "", channels: &["R", "G", "B"], image: &image, full_float: true };
    comgs_image::write_layers(&root.join("images/00000.exr"), &[layer]).unwrap();
    let view = &Capture::open(root, Split::All).unwrap().load(&LoadOptions::default()).unwrap()[0];
    assert_eq!(view.repaired, 1);
    let valid = view.valid.as_ref().unwrap();
    assert_eq!((valid.pixel(3, 2)[0], valid.data.iter().filter(|&&v| v == 0.0).count()), (0.0, 1));
    assert_eq!(view.color.non_finite(), 0);
}

/// Goal: a list whose images lie in folders of other names (a relit object) says which folders those are.
#[test]
fn other_image_folders_are_offered() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(2);
    comgs_scene::write_cameras(root.join("cameras.json"), &cameras).unwrap();
    for environment in ["studio", "city"] {
        for camera in &cameras {
            png(&root.join(environment).join(format!("{}.png", camera.name)), WIDTH, HEIGHT);
        }
    }
    let error = Capture::open(root, Split::All).unwrap_err().to_string();
    assert!(error.contains("folders beside it that hold such images: city, studio"), "{error}");
    let options = OpenOptions { split: Split::All, images: Some(PathBuf::from("city")) };
    assert_eq!(Capture::open_with(root, &options).unwrap().views.len(), 2);
}

/// Goal: a folder that is no capture is refused with what was looked for; a file that is no camera list too.
#[test]
fn what_is_no_capture_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = Capture::open(folder.path(), Split::All).unwrap_err();
    assert!(matches!(error, SceneError::Unrecognised { .. }));
    let text = error.to_string();
    for name in ["sparse/0/images.bin", "transforms.json", "transforms_train.json", "train/cameras.json"] {
        assert!(text.contains(name), "{text}");
    }
    assert!(!check(folder.path()).is_sound());
    assert!(matches!(Capture::open(folder.path().join("nowhere"), Split::All), Err(SceneError::Io { .. })));
    let odd = folder.path().join("odd.json");
    std::fs::write(&odd, r#"{"views": []}"#).unwrap();
    assert!(read_cameras(&odd).unwrap_err().to_string().contains("neither \"cameras\""));
}
