//! The hard cases that concern readers and writers of files (numbers as in the project's list of hard cases).

mod common;

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_scene::capture::colmap::{parse_cameras_binary, parse_images_binary, parse_points_binary};
use comgs_scene::capture::{syncom as syncom_format, transforms as transforms_format};
use comgs_scene::{
    Asset, AssetKind, Capture, CheckDepth, CheckReport, LoadOptions, ProblemKind, SceneError, Severity,
    Split, check, check_with, read_cameras,
};
use comgs_surfel::{ColorEncoding, PointCloud, SurfelCloud, ply};
use common::{HEIGHT, WIDTH, colmap, exr, png, ring, syncom, transforms};
use glam::DVec3;
use std::path::Path;
use std::time::{Duration, Instant};

/// A refusal must not take longer than this, whatever a header promises (generous: machines under load).
const QUICK: Duration = Duration::from_secs(5);

/// Goal (hard case 11): duplicate points and points in a camera's centre do not reach training, and a misplaced camera
/// neither inflates the extent nor goes unnamed.
#[test]
fn case_11_degenerate_points_and_outlier_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut cameras = ring(9);
    let sound = cameras.clone();
    cameras[4].world_from_camera.translation = DVec3::new(1e6, 0.0, 0.0);
    syncom(root, &cameras);
    let centre = cameras[1].centre().as_vec3().to_array();
    let positions = vec![[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], centre, [0.5, 0.0, 0.0]];
    let points = PointCloud { positions, ..PointCloud::default() };
    ply::write_points(&root.join("points3d.ply"), &points).unwrap();

    let capture = Capture::open(root, Split::All).unwrap();
    let points = capture.points().unwrap().unwrap();
    assert_eq!((points.duplicates, points.at_cameras), (1, 1));
    assert_eq!(points.cloud.positions, [[0.1, 0.2, 0.3], [0.5, 0.0, 0.0]]);
    let (_, radius) = capture.extent();
    let farthest = sound.iter().map(|c| c.centre().length()).fold(0.0, f64::max);
    assert!(radius < 2.0 * farthest, "{radius}");
    let report = check(root);
    let outliers: Vec<_> = report.problems.iter().filter(|p| p.kind == ProblemKind::OutlierCamera).collect();
    assert_eq!(outliers.len(), 1, "{report}");
    assert_eq!(outliers[0].location, "cameras.4");
}

/// Goal (hard case 14, readers' part): one camera, identical cameras and turning on the spot are refused by the check;
/// black, saturated and textureless images are named when it looks at pixels.
#[test]
fn case_14_captures_without_depth() {
    let kinds =
        |report: &CheckReport| -> Vec<ProblemKind> { report.problems.iter().map(|p| p.kind).collect() };
    let one = tempfile::tempdir().unwrap();
    syncom(one.path(), &ring(1));
    assert_eq!(kinds(&check(one.path())), [ProblemKind::Views]);
    let two = tempfile::tempdir().unwrap();
    syncom(two.path(), &ring(2));
    let report = check(two.path());
    assert_eq!(kinds(&report), [ProblemKind::Views]);
    assert!(report.to_string().contains("2 training views only") && !report.is_sound(), "{report}");
    // A single view can still be rendered or compared.
    assert_eq!(Capture::open(one.path(), Split::All).unwrap().views.len(), 1);

    let same = tempfile::tempdir().unwrap();
    let cameras: Vec<Camera> =
        (0..3).map(|i| Camera { name: format!("v{i}"), ..ring(1)[0].clone() }).collect();
    syncom(same.path(), &cameras);
    let report = check(same.path());
    assert!(report.to_string().contains("identical") && !report.is_sound(), "{report}");

    let dull = tempfile::tempdir().unwrap();
    syncom(dull.path(), &ring(4));
    for (i, value) in [(0, 0.0), (1, 1.0), (2, 0.4)] {
        let path = dull.path().join(format!("images/{i:05}.png"));
        comgs_image::write_png(&path, &Image::filled(WIDTH, HEIGHT, 3, value)).unwrap();
    }
    assert!(check(dull.path()).problems.is_empty());
    let report = check_with(dull.path(), CheckDepth::Pixels);
    let messages: Vec<&str> = report.problems.iter().map(|p| p.message.as_str()).collect();
    assert_eq!(messages, ["the image is black", "the image is saturated", "the image has no texture"]);
    assert!(report.is_sound(), "these are warnings");

    let dark = tempfile::tempdir().unwrap();
    syncom(dark.path(), &ring(4));
    for i in 0..4 {
        let path = dark.path().join(format!("images/{i:05}.png"));
        comgs_image::write_png(&path, &Image::filled(WIDTH, HEIGHT, 3, 0.0)).unwrap();
    }
    let report = check_with(dark.path(), CheckDepth::Pixels);
    assert!(report.to_string().contains("all training images are black"), "{report}");
    assert_eq!((report.errors(), report.problems.len()), (1, 5), "{report}");
}

/// Goal (hard case 35): focal lengths that are not positive are refused in every format; legal intrinsics that nobody means
/// (a principal point far outside, a field of view of a hundredth of a degree) are warned of.
#[test]
fn case_35_senseless_intrinsics() {
    let report = |edit: &dyn Fn(&mut Camera)| {
        let folder = tempfile::tempdir().unwrap();
        let mut cameras = ring(4);
        edit(&mut cameras[1]);
        syncom(folder.path(), &cameras);
        check(folder.path())
    };
    for f in [0.0, -20.0] {
        let report = report(&|c| c.fy = f);
        assert_eq!(report.errors(), 1, "{report}");
        assert!(report.to_string().contains("expected a positive"), "{report}");
    }
    for (edit, expected) in [
        ((|c| c.cx = 1e5) as fn(&mut Camera), "cx is 100000"),
        (|c| (c.fx, c.fy) = (2e5, 2e5), "field of view"),
        (|c| c.fx = 0.01, "field of view"),
    ] {
        let report = report(&edit);
        assert!(report.is_sound() && report.to_string().contains(expected), "{report}");
    }
    let folder = tempfile::tempdir().unwrap();
    let cameras = ring(3);
    for i in 0..3 {
        png(&folder.path().join(format!("images/{i}.png")), WIDTH, HEIGHT);
    }
    let files: Vec<String> = (0..3).map(|i| format!("images/{i}.png")).collect();
    let frames: Vec<_> = files.iter().zip(&cameras).map(|(f, c)| (f.as_str(), c, "")).collect();
    transforms(&folder.path().join("transforms.json"), r#""fl_x": 22, "fl_y": -22,"#, &frames);
    assert!(check(folder.path()).to_string().contains("vertical focal length"));
    let names: Vec<(&str, &Camera)> = ["0.png", "1.png", "2.png"].into_iter().zip(&cameras).collect();
    std::fs::remove_file(folder.path().join("transforms.json")).unwrap();
    let model = colmap((1, "PINHOLE"), &[20.0, -20.0, 12.0, 8.0], (24, 16), &names);
    model.write(&folder.path().join("sparse/0"), true);
    assert!(check(folder.path()).to_string().contains("not positive"));
}

/// Goal (hard case 34): deep, wide, endless and cut JSON is refused quickly.
#[test]
fn case_34_hostile_json() {
    let path = Path::new("hostile.json");
    let start = Instant::now();
    let deep = format!(r#"{{"frames": {}"#, "[".repeat(1 << 20));
    let deep_value =
        format!(r#"{{"frames": [{{"file_path": "a", "transform_matrix": {}"#, "[".repeat(1 << 20));
    let wide = format!(r#"{{"frames": [{}{{}}]}}"#, "{},".repeat(200_000));
    let long_matrix =
        format!(r#"{{"frames": [{{"file_path": "a", "transform_matrix": [{}1]}}]}}"#, "1,".repeat(1 << 20));
    for text in [&deep, &deep_value, &wide] {
        assert!(transforms_format::parse(text.as_bytes(), path).is_err());
    }
    let listing = transforms_format::parse(long_matrix.as_bytes(), path).unwrap();
    assert_eq!((listing.frames.len(), listing.faults.len()), (0, 1));
    assert!(listing.faults[0].location.starts_with("frames[0].transform_matrix"), "{:?}", listing.faults);
    let cameras = format!(r#"{{"cameras": {{{}"x": 1}}}}"#, r#""a": 0,"#.repeat(200_000));
    assert!(syncom_format::parse(cameras.as_bytes(), path).unwrap_err().to_string().contains("more than"));
    assert!(start.elapsed() < QUICK);
}

/// Goal (hard case 34): counts in COLMAP files that the file cannot hold are refused before memory is taken, and a model
/// cut anywhere is an error, not a panic and not a smaller model.
#[test]
fn case_34_hostile_colmap() {
    let start = Instant::now();
    let path = Path::new("hostile.bin");
    for count in [u64::MAX, 1 << 60, 1 << 40, 1000] {
        let mut bytes = count.to_le_bytes().to_vec();
        bytes.extend([0; 200]);
        let length = bytes.len() as u64;
        for error in [
            parse_cameras_binary(bytes.as_slice(), length, path).unwrap_err(),
            parse_images_binary(bytes.as_slice(), length, path).unwrap_err(),
            parse_points_binary(bytes.as_slice(), length, path).unwrap_err(),
        ] {
            assert!(error.to_string().contains(&format!("promises {count} records")), "{error}");
        }
    }
    let cameras = ring(3);
    let images: Vec<(&str, &Camera)> = ["a.png", "b.png", "c.png"].into_iter().zip(&cameras).collect();
    let model = colmap((1, "PINHOLE"), &[20.0, 20.0, 12.0, 8.0], (24, 16), &images);
    for (i, whole) in model.binary.iter().enumerate() {
        for cut in 0..whole.len() {
            let bytes = &whole[..cut];
            let length = cut as u64;
            let failed = match i {
                0 => parse_cameras_binary(bytes, length, path).is_err(),
                1 => parse_images_binary(bytes, length, path).is_err(),
                _ => parse_points_binary(bytes, length, path).is_err(),
            };
            assert!(failed, "file {i} cut at {cut} of {}", whole.len());
        }
    }
    assert!(start.elapsed() < QUICK);
}

/// Goal (hard case 34): an EXR or PNG that promises a giant image is named by the check, not decoded.
#[test]
fn case_34_giant_images() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut cameras = ring(3);
    syncom(root, &cameras);
    // The width in a PNG header is at bytes 16 to 19; its checksum covers it, so the header is refused.
    let path = root.join("images/00000.png");
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
    std::fs::write(&path, &bytes).unwrap();
    std::fs::write(root.join("images/00001.png"), b"").unwrap();
    let report = check(root);
    let bad: Vec<_> = report.of(Severity::Error).map(|p| (p.kind, p.location.as_str())).collect();
    assert!(bad.contains(&(ProblemKind::UnreadableImage, "cameras.1")), "{report}");
    assert!(bad.iter().any(|b| b.1 == "cameras.0"), "{report}");
    // A camera file that asks for a giant frame is refused before anything is rendered.
    cameras[0].width = 1 << 20;
    cameras[0].height = 1 << 20;
    comgs_scene::write_cameras(root.join("giant.json"), &cameras).unwrap();
    assert!(read_cameras(root.join("giant.json")).unwrap_err().to_string().contains("1048576×1048576"));
}

/// Goal (hard case 35): every problem of a broken SynCom capture is listed at once, each with its file and its place in
/// it; opening refuses with the same list.
#[test]
fn case_35_every_problem_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(12);
    syncom(root, &cameras);
    std::fs::remove_file(root.join("images/00001.png")).unwrap();
    png(&root.join("images/00002.png"), WIDTH + 7, HEIGHT);
    png(&root.join("images/00003.png"), WIDTH / 2, HEIGHT / 2);
    comgs_image::write_png(&root.join("masks/99999.png"), &Image::filled(WIDTH, HEIGHT, 1, 1.0)).unwrap();
    comgs_image::write_png(&root.join("masks/00004.png"), &Image::filled(3, 3, 1, 1.0)).unwrap();
    std::fs::write(root.join("images/00005.png"), b"not an image").unwrap();

    let mut value: serde_json::Value =
        serde_json::from_slice(&std::fs::read(root.join("cameras.json")).unwrap()).unwrap();
    value["cameras"]["6"]["name"] = "00007".into();
    value["cameras"]["8"]["extr"] = serde_json::json!(vec![0.0; 16]);
    value["cameras"]["9"]["intr"][1] = "NAN".into();
    value["cameras"]["10"]["name"] = "../../escape".into();
    value["cameras"]["11"]["intr"][0] = serde_json::json!("wide");
    // Python writes NaN bare.
    let text = value.to_string().replace("\"NAN\"", "NaN");
    std::fs::write(root.join("cameras.json"), text).unwrap();

    let report = check(root);
    let expected = [
        (ProblemKind::Intrinsics, "cameras.9.intr[1]", "cameras.json", Severity::Error),
        (ProblemKind::Record, "cameras.10.name", "cameras.json", Severity::Error),
        (ProblemKind::Record, "cameras.11.intr[0]", "cameras.json", Severity::Error),
        (ProblemKind::Pose, "cameras.8.extr", "cameras.json", Severity::Error),
        (ProblemKind::DuplicateName, "cameras.7", "cameras.json", Severity::Error),
        (ProblemKind::MissingImage, "cameras.1", "images/00001", Severity::Warning),
        (ProblemKind::ImageSize, "cameras.2", "images/00002.png", Severity::Error),
        (ProblemKind::ImageSize, "cameras.3", "images/00003.png", Severity::Warning),
        (ProblemKind::Mask, "cameras.4", "masks/00004.png", Severity::Error),
        (ProblemKind::UnreadableImage, "cameras.5", "images/00005.png", Severity::Error),
        (ProblemKind::OrphanMask, "", "masks/99999.png", Severity::Warning),
    ];
    for (kind, location, path, severity) in expected {
        let found = report.problems.iter().any(|p| {
            (p.kind, p.location.as_str(), p.severity) == (kind, location, severity) && p.path.ends_with(path)
        });
        assert!(found, "{kind:?} at {location:?} in {path} is not in\n{report}");
    }
    assert_eq!(report.problems.len(), expected.len(), "{report}");
    let lines = report.to_string().lines().count();
    assert_eq!(lines, 1 + expected.len());
    let SceneError::Unsound(refused) = Capture::open(root, Split::All).unwrap_err() else {
        panic!("expected Unsound")
    };
    assert_eq!(refused.problems, report.problems);
}

/// Goal (hard case 35): the same for a Blender/NeRF capture and a COLMAP model.
#[test]
fn case_35_other_formats() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let cameras = ring(6);
    let files: Vec<String> = (0..6).map(|i| format!("images/{i}.png")).collect();
    for file in &files {
        png(&root.join(file), WIDTH, HEIGHT);
    }
    let mut frames: Vec<_> = files.iter().zip(&cameras).map(|(f, c)| (f.as_str(), c, "")).collect();
    let mut flat = cameras[2].clone();
    flat.world_from_camera.matrix3.x_axis = DVec3::ZERO;
    frames[2].1 = &flat;
    frames[3].2 = r#", "k1": NaN"#;
    frames[4].2 = r#", "camera_model": "EQUIRECTANGULAR""#;
    frames[5] = frames[0];
    let extra = r#", "fl_x": 0, "mask_path": "m.png""#;
    frames[1].2 = extra;
    transforms(&root.join("transforms.json"), r#""camera_angle_x": 1.0,"#, &frames);
    let report = check(root);
    let errors: Vec<(ProblemKind, &str)> =
        report.of(Severity::Error).map(|p| (p.kind, p.location.as_str())).collect();
    for expected in [
        (ProblemKind::Intrinsics, "frames[1].fl_x"),
        (ProblemKind::Pose, "frames[2].transform_matrix"),
        (ProblemKind::Lens, "frames[3].k1"),
        (ProblemKind::Lens, "frames[4].camera_model"),
        (ProblemKind::DuplicateName, "frames[5]"),
    ] {
        assert!(errors.contains(&expected), "{expected:?} is not in\n{report}");
    }

    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut cameras = ring(3);
    cameras[1].world_from_camera.translation.x = f64::NAN;
    let images: Vec<(&str, &Camera)> = ["a.png", "b.png", "a.png"].into_iter().zip(&cameras).collect();
    let model = colmap((7, "FOV"), &[20.0, 20.0, 12.0, 8.0, 0.9], (24, 16), &images);
    model.write(&root.join("sparse/0"), false);
    let report = check(root);
    assert!(report.to_string().contains("camera 7: the camera model FOV is not supported"), "{report}");
    let model = colmap((1, "PINHOLE"), &[20.0, 20.0, 12.0, 8.0], (24, 16), &images);
    model.write(&root.join("sparse/0"), false);
    png(&root.join("images/a.png"), WIDTH, HEIGHT);
    let report = check(root);
    assert!(report.to_string().contains("is not invertible"), "{report}");
    assert!(report.problems.iter().any(|p| p.kind == ProblemKind::DuplicateName), "{report}");
}

/// Goal (hard case 35): an image that changes between opening and loading is an error, not a wrong picture.
#[test]
fn case_35_an_image_that_changes() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    syncom(root, &ring(2));
    let capture = Capture::open(root, Split::All).unwrap();
    png(&root.join("images/00001.png"), 5, 5);
    let error = capture.load(&LoadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("5×5 pixels, expected 24×16") && error.contains("00001.png"), "{error}");
    let bytes = std::fs::read(root.join("images/00000.png")).unwrap();
    std::fs::write(root.join("images/00000.png"), &bytes[..bytes.len() / 2]).unwrap();
    assert!(matches!(capture.load(&LoadOptions::default()), Err(SceneError::Image(_))));
    exr(&root.join("images/00000.exr"), WIDTH, HEIGHT);
    png(&root.join("images/00001.png"), WIDTH, HEIGHT);
    assert!(Capture::open(root, Split::All).unwrap().views[0].load(&LoadOptions::default()).is_ok());
}

fn cloud(n: usize) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Srgb);
    for i in 0..n {
        cloud.positions.push([i as f32, 0.0, 0.0]);
        cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
        cloud.log_scales.push([-1.0; 2]);
        cloud.opacity_logits.push(0.0);
        cloud.sh.extend([0.1; 3]);
    }
    cloud
}

/// Goal (hard case 36): where no file can be made there is a clear error with the path, and nothing is left behind.
#[test]
fn case_36_unwritable_folders() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, b"x").unwrap();
    let target = file.join("a.asset");
    let error = Asset::new(AssetKind::Object, cloud(3)).save(&target).unwrap_err();
    assert!(matches!(&error, SceneError::Write { path, .. } if path.starts_with(&target)), "{error}");
    assert!(error.to_string().starts_with("cannot write ("), "{error}");
    for error in [
        comgs_scene::write_cameras(file.join("cameras.json"), &ring(1)).unwrap_err(),
        comgs_scene::TransformFile::single("a", comgs_geom::Similarity::IDENTITY)
            .write(file.join("transform.json"))
            .unwrap_err(),
    ] {
        assert!(matches!(error, SceneError::Write { .. }), "{error}");
    }
    assert_eq!(std::fs::read(&file).unwrap(), b"x");
}

/// Goal (hard case 36): a disk that is really full (the operating system refuses to let files grow beyond a few
/// kilobytes): saving fails with an error, and the asset that was there still loads.
///
/// The limit holds for a whole process, so the test runs itself again under it, through a shell.
#[cfg(unix)]
#[test]
fn case_36_a_full_disk() {
    const FOLDER: &str = "COMGS_TEST_FULL_DISK_FOLDER";
    let new = || Asset::new(AssetKind::Scene, cloud(20_000));
    if let Some(root) = std::env::var_os(FOLDER) {
        // The limited child: saving a megabyte must fail, cleanly.
        let error = new().save(&root).unwrap_err();
        assert!(matches!(error, SceneError::Write { .. }), "{error}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("a.asset");
    let mut old = Asset::new(AssetKind::Object, cloud(5));
    old.save(&root).unwrap();
    let under_limit = |root: &Path| {
        std::process::Command::new("sh")
            // With the signal ignored the write itself fails, as it does on a full disk.
            .args(["-c", "trap '' XFSZ; ulimit -f 8; exec \"$0\" --exact case_36_a_full_disk"])
            .arg(std::env::current_exe().unwrap())
            .env(FOLDER, root)
            .output()
            .unwrap()
    };
    for root in [root.clone(), folder.path().join("fresh.asset")] {
        let output = under_limit(&root);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    }
    assert_eq!(Asset::load(&root).unwrap().surfels, old.surfels);
    assert_eq!(std::fs::read_dir(&root).unwrap().count(), 2, "no partial file is left");
    assert!(Asset::load(folder.path().join("fresh.asset")).is_err());
    new().save(&root).unwrap();
    assert_eq!(Asset::load(&root).unwrap().surfels.len(), 20_000, "without the limit the same save works");
}
