//! The stages on a small world: what they write, what they refuse, and what they do not do twice.

mod common;

use comgs_geom::Similarity;
use comgs_pipeline::stages::{compose, eval, info, light, place, render};
use comgs_pipeline::{CancelToken, Context, PipelineError, Silent, record::read_record};
use comgs_scene::{CompositionRecord, TransformFile};
use common::{World, world};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};

fn placed(root: &Path, world: &World, at: place::At) -> Result<place::Output, PipelineError> {
    let input = place::Input {
        scene: world.scene.clone(),
        object: world.object.clone(),
        cameras: None,
        output: root.join("transform.json"),
    };
    place::run(&input, &place::Config { at, size: Some(0.8), yaw_deg: 30.0 }, &Context::silent())
}

/// Goal: a point and a pixel that shows this point give the same placement; the ground is seen; the file reads back.
#[test]
fn place_by_point_and_by_pixel() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let by_point = placed(root.path(), &world, place::At::Point([0.2, -0.3, 0.0])).unwrap();
    assert!(by_point.report.warnings.is_empty(), "{:?}", by_point.report);
    assert!(by_point.report.ground_normal.unwrap().dot(DVec3::Z) > 0.99);
    assert!(by_point.report.gap.unwrap().abs() < 0.02);
    let read = TransformFile::read(root.path().join("transform.json")).unwrap();
    let s = read.get(Some("ball")).unwrap();
    // The ball has radius ½, so 0.8 large is a scale of 0.8 and its centre stands 0.4 high (surfels stick out a little).
    assert!((s.scale - 0.8).abs() < 0.06, "{s:?}");
    assert!((s.translation - DVec3::new(0.2, -0.3, 0.4)).length() < 0.02, "{s:?}");

    let cameras = comgs_scene::read_cameras(&world.scene).unwrap();
    let (pixel, _) = cameras[3].project(DVec3::new(0.2, -0.3, 0.0)).unwrap();
    let at = place::At::Pixel { view: cameras[3].name.clone(), x: pixel.x, y: pixel.y };
    let by_pixel = placed(root.path(), &world, at).unwrap();
    let off = by_pixel.world_from_object.translation.distance(by_point.world_from_object.translation);
    assert!(off < 0.05, "{off}");
    assert!(root.path().join("transform.json.place.run.json").is_file());
}

/// Goal: sky, a view that is not there and a place in mid-air are told with their figures (hard case 33).
#[test]
fn odd_places_are_told() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let fail = |view: &str, x: f64, y: f64| {
        let at = place::At::Pixel { view: view.into(), x, y };
        placed(root.path(), &world, at).unwrap_err().to_string()
    };
    assert!(fail("00003", 30.0, 0.5).contains("weight"), "{}", fail("00003", 30.0, 0.5));
    assert!(fail("nope", 1.0, 1.0).contains("00000, 00001"), "{}", fail("nope", 1.0, 1.0));
    assert!(fail("00003", 64.0, 1.0).contains("64×48"), "{}", fail("00003", 64.0, 1.0));
    let floating = placed(root.path(), &world, place::At::Point([0.0, 0.0, 0.3])).unwrap();
    assert!(floating.report.warnings[0].contains("floats"), "{:?}", floating.report);
    let record = read_record(&root.path().join("transform.json.place.run.json")).unwrap();
    assert_eq!(record.warnings, floating.report.warnings);
}

/// Goal: the light of a small room is partly seen, and completion leaves nothing black.
#[test]
fn light_is_swept_and_completed() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input =
        light::Input { scene: world.scene.clone(), output: root.path().join("env.exr"), report: None };
    let config = light::Config { height: 16, ..light::Config::at(DVec3::new(0.0, 0.0, 0.4)) };
    let made = light::run(&input, &config, &Context::silent()).unwrap();
    assert!((0.4..0.8).contains(&made.coverage), "{}", made.coverage);
    let map = comgs_image::read(&made.environment).unwrap().color;
    assert_eq!((map.width, map.height), (32, 16));
    assert!(map.data.iter().all(|v| *v > 0.0));
    for picture in [&made.pictures.environment, &made.pictures.sweep, &made.pictures.alpha] {
        assert!(picture.is_file(), "{}", picture.display());
    }
    assert!(light::run(&input, &config, &Context::silent()).unwrap().reused);
    let none = light::Config { completion: light::Fill::None, ..config.clone() };
    let made = light::run(&input, &none, &Context::silent()).unwrap();
    assert!(!made.reused, "another completion is another light");
    assert!(comgs_image::read(&made.environment).unwrap().color.data.contains(&0.0));
    let nowhere = light::Config { at: [f64::NAN, 0.0, 0.0], ..config };
    assert!(light::run(&input, &nowhere, &Context::silent()).is_err());
}

fn composition(root: &Path, world: &World) -> compose::Input {
    placed(root, world, place::At::Point([0.0, 0.0, 0.0])).unwrap();
    compose::Input {
        scene: world.scene.clone(),
        objects: vec![world.object.clone()],
        transform: root.join("transform.json"),
        cameras: world.cameras.clone(),
        light: None,
        truth: None,
        output: root.join("out"),
    }
}

fn quick() -> compose::Config {
    compose::Config { shadow_rays: 16, layers: true, ..compose::Config::default() }
}

/// Goal: a composition writes everything that is promised, the second run does nothing, a changed knob or a damaged frame
/// runs again, and frames of cameras that are gone are removed.
#[test]
fn compose_writes_everything_once() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input = composition(root.path(), &world);
    let made = compose::run(&input, &quick(), &Context::silent()).unwrap();
    assert!(!made.reused);
    let out = |name: &str| input.output.join(name);
    for name in
        ["frames/00000.png", "empty/00002.png", "layers/00001.exr", "env.exr", "cameras.json", "preview.gif"]
    {
        assert!(out(name).is_file(), "{name}");
    }
    let page = std::fs::read_to_string(out("report.html")).unwrap();
    assert!(page.contains("ball in room") && page.contains("shadow"));
    let record = CompositionRecord::read(out("composition.json")).unwrap();
    assert_eq!((record.scene.as_str(), record.objects[0].name.as_str()), ("../room.asset", "ball"));
    let run = read_record(&out("run.json")).unwrap();
    assert!(run.warnings.is_empty(), "{:?}", run.warnings);
    assert!(run.results["shadow_rays"].as_u64().unwrap() > 0);
    assert!(run.timings.iter().any(|t| t.stage == "light: sweep"));

    // The object is there, its shadow darkens the floor, the sky of the frame stays as it was.
    let (frame, empty) = (read(&out("frames/00000.png")), read(&out("empty/00000.png")));
    let differ = frame.data.iter().zip(&empty.data).filter(|(a, b)| a != b).count();
    assert!(differ > 300, "{differ} of {}", frame.data.len());
    let pixels = || frame.data.chunks_exact(3).zip(empty.data.chunks_exact(3));
    let sky = pixels().filter(|(_, e)| e.iter().all(|v| *v == 0.0)).count();
    let changed_sky = pixels().filter(|(f, e)| e.iter().all(|v| *v == 0.0) && f != e).count();
    assert!(sky > 100 && changed_sky * 10 < sky, "{changed_sky} of {sky} sky pixels changed");

    assert!(compose::run(&input, &quick(), &Context::silent()).unwrap().reused);
    std::fs::write(out("frames/00001.png"), b"scribble").unwrap();
    assert!(!compose::run(&input, &quick(), &Context::silent()).unwrap().reused);
    assert!(read(&out("frames/00001.png")).width == 64);
    let fewer = compose::Input { cameras: root.path().join("one.json"), ..input.clone() };
    let cameras = comgs_scene::read_cameras(&world.cameras).unwrap();
    comgs_scene::write_cameras(&fewer.cameras, &cameras[..1]).unwrap();
    assert!(!compose::run(&fewer, &quick(), &Context::silent()).unwrap().reused);
    assert!(out("frames/00000.png").is_file() && !out("frames/00001.png").exists());
}

fn read(path: &Path) -> comgs_image::Image {
    comgs_image::read(path).unwrap().color
}

/// Goal: an interrupted composition says how it goes on, keeps its frames, and ends with the same bytes as one that was
/// never interrupted.
#[test]
fn an_interrupted_composition_continues() {
    struct StopAfter(CancelToken, std::sync::atomic::AtomicUsize);
    impl comgs_pipeline::Progress for StopAfter {
        fn begin(&self, _: &str) {}
        fn update(&self, status: &comgs_pipeline::Status) {
            if status.message.starts_with("frame ")
                && self.1.fetch_add(1, std::sync::atomic::Ordering::SeqCst) == 1
            {
                self.0.cancel();
            }
        }
        fn end(&self, _: &str) {}
        fn note(&self, _: &str) {}
        fn warn(&self, _: &str) {}
    }
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input = composition(root.path(), &world);
    let cancel = CancelToken::default();
    let stop = StopAfter(cancel.clone(), std::sync::atomic::AtomicUsize::new(0));
    let error = compose::run(&input, &quick(), &Context { progress: &stop, cancel }).unwrap_err();
    assert!(error.to_string().contains("2 of 3 frames"), "{error}");
    assert!(!input.output.join("run.json").exists());
    let written = std::fs::metadata(input.output.join("frames/00000.png")).unwrap().modified().unwrap();
    compose::run(&input, &quick(), &Context::silent()).unwrap();
    assert_eq!(
        std::fs::metadata(input.output.join("frames/00000.png")).unwrap().modified().unwrap(),
        written
    );
    let whole = compose::Input { output: root.path().join("whole"), ..input.clone() };
    compose::run(&whole, &quick(), &Context::silent()).unwrap();
    for name in ["frames/00000.png", "frames/00002.png", "layers/00001.exr"] {
        let bytes = |input: &compose::Input| std::fs::read(input.output.join(name)).unwrap();
        assert_eq!(bytes(&input), bytes(&whole), "{name}");
    }
}

/// Goal: mirrored transforms, unknown objects, missing files and a capture in place of an asset are refused by name before
/// anything is written; an output that cannot be a folder leaves nothing half-written (hard cases 30 and 36).
#[test]
fn bad_input_is_refused_before_any_work() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input = composition(root.path(), &world);
    let refuse =
        |input: &compose::Input| compose::run(input, &quick(), &Context::silent()).unwrap_err().to_string();

    let mirrored = root.path().join("mirrored.json");
    let m = r#"{"ball": {"transform": [-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}"#;
    std::fs::write(&mirrored, m).unwrap();
    let text = refuse(&compose::Input { transform: mirrored, ..input.clone() });
    assert!(text.contains("mirror") && text.contains("mirrored.json"), "{text}");

    let two = TransformFile {
        objects: vec![("a".into(), Similarity::IDENTITY), ("b".into(), Similarity::IDENTITY)],
    };
    two.write(root.path().join("two.json")).unwrap();
    let text = refuse(&compose::Input { transform: root.path().join("two.json"), ..input.clone() });
    assert!(text.contains("a, b") && text.contains("ball"), "{text}");

    let text = refuse(&compose::Input { scene: PathBuf::from("/nonexistent/room"), ..input.clone() });
    assert!(text.ends_with("/nonexistent/room"), "{text}");
    assert!(!input.output.exists(), "nothing was written");

    let file = root.path().join("file");
    std::fs::write(&file, b"x").unwrap();
    let text = refuse(&compose::Input { output: file.join("out"), ..input.clone() });
    assert!(text.contains("file"), "{text}");
    assert_eq!(std::fs::read(&file).unwrap(), b"x");
}

/// Goal: hidden and invisible objects are warned of.
#[test]
fn unseen_objects_are_warned_of() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input = composition(root.path(), &world);
    let warnings = |translation: DVec3| {
        let s = Similarity { scale: 0.5, rotation: DQuat::IDENTITY, translation };
        TransformFile::single("ball", s).write(&input.transform).unwrap();
        compose::run(&input, &quick(), &Context::silent()).unwrap().record.warnings.join("; ")
    };
    let away = warnings(DVec3::new(0.0, 0.0, 40.0));
    assert!(away.contains("outside every frame") && away.contains("mid-air"), "{away}");
    let under = warnings(DVec3::new(0.0, 0.0, -1.0));
    assert!(under.contains("hidden"), "{under}");
}

/// Goal: the truth scores infinitely well against itself, an asset scores well against its own pictures, and frames
/// without any counterpart are an error.
#[test]
fn eval_knows_the_truth() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let capture = root.path().join("capture");
    let cameras = common::ring(4, 2.6, 1.5, (48, 36), 0.9);
    common::write_capture(&capture, &common::scene_cloud(), comgs_scene::AssetKind::Scene, &cameras);
    let run = |subject: &Path, against: &Path| {
        let json = Some(root.path().join("scores.json"));
        let input =
            eval::Input { subject: subject.to_owned(), against: against.to_owned(), relit: None, json };
        eval::run(&input, &Context::silent())
    };
    let scores = run(&world.scene, &capture).unwrap();
    let table = &scores.section("test").unwrap().table;
    assert_eq!(table.rows.len(), 2);
    // Only the rounding to 8 bits is left.
    assert!(table.mean("psnr_db").unwrap() > 55.0, "{}", scores.to_text());

    let rendered = root.path().join("rendered");
    let render_input = render::Input {
        asset: world.scene.clone(),
        cameras: capture.join("test/cameras.json"),
        output: rendered.clone(),
    };
    render::run(&render_input, &render::Config { layers: true }, &Context::silent()).unwrap();
    let scores = run(&rendered, &capture).unwrap();
    assert_eq!(scores.section("composed").unwrap().table.mean("psnr_db"), Some(f64::INFINITY));
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(root.path().join("scores.json")).unwrap()).unwrap();
    assert!(json["sections"][0]["mean"]["ssim"].as_f64().unwrap() > 0.999);

    let other = root.path().join("other");
    std::fs::create_dir_all(other.join("images")).unwrap();
    std::fs::copy(rendered.join("frames/00000.png"), other.join("images/zzz.png")).unwrap();
    assert!(run(&rendered, &other).unwrap_err().to_string().contains("named as the frames are"));
    assert!(run(&capture, &capture).is_err());
}

/// Goal: a composition scored by region: the true frame beats the empty one in the object and in the shadow.
#[test]
fn eval_by_region() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input = composition(root.path(), &world);
    compose::run(&input, &quick(), &Context::silent()).unwrap();
    // Our own result as "truth": its frames, masks and empty frames.
    let truth = root.path().join("truth");
    for (from, to) in [("frames", "images"), ("empty", "empty")] {
        std::fs::create_dir_all(truth.join(to)).unwrap();
        for name in ["00000", "00001", "00002"] {
            let file = format!("{name}.png");
            std::fs::copy(input.output.join(from).join(&file), truth.join(to).join(&file)).unwrap();
        }
    }
    for name in ["00000", "00001", "00002"] {
        let alpha = comgs_image::read(&input.output.join(format!("layers/{name}.exr"))).unwrap();
        let layers =
            comgs_image::read::exr_channels(&input.output.join(format!("layers/{name}.exr"))).unwrap();
        assert!(
            layers.contains(&"mask.Y:half".to_owned()) && layers.contains(&"depth.Z:float".to_owned()),
            "{layers:?}"
        );
        assert!(alpha.alpha.is_some());
        let (frame, empty) =
            (read(&truth.join(format!("images/{name}.png"))), read(&truth.join(format!("empty/{name}.png"))));
        // Red is what only the ball is.
        let mut mask = comgs_image::Image::zeros(64, 48, 1);
        for i in 0..mask.pixels() {
            mask.data[i] = f32::from(frame.data[3 * i] > empty.data[3 * i] + 0.05);
        }
        comgs_image::write_png(&truth.join(format!("mask/{name}.png")), &mask).unwrap();
    }
    let scored = compose::Input { truth: Some(truth), ..input };
    let made = compose::run(&scored, &quick(), &Context::silent()).unwrap();
    let evaluation = made.evaluation.unwrap();
    let mean = |section: &str, key: &str| evaluation.section(section).unwrap().table.mean(key).unwrap();
    assert_eq!(mean("composed", "whole.psnr_db"), f64::INFINITY);
    assert!(mean("empty", "shadow.psnr_db") < 40.0 && mean("empty", "object.psnr_db") < 25.0);
    assert_eq!(mean("true empty", "shadow.psnr_db"), mean("empty", "shadow.psnr_db"));
    let page = std::fs::read_to_string(&made.report).unwrap();
    assert!(page.contains("shadow dB"));
}

/// Goal: info says what each kind of file holds, and refuses what is none.
#[test]
fn info_on_everything() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let input = composition(root.path(), &world);
    compose::run(&input, &quick(), &Context::silent()).unwrap();
    let capture = root.path().join("capture");
    let cameras = common::ring(4, 2.6, 1.5, (48, 36), 0.9);
    common::write_capture(&capture, &common::object_cloud(), comgs_scene::AssetKind::Object, &cameras);
    let out = |name: &str| input.output.join(name);
    let json = Some(root.path().join("scores.json"));
    let scored = eval::Input { subject: world.object.clone(), against: capture.clone(), relit: None, json };
    eval::run(&scored, &Context::silent()).unwrap();
    let recipe = serde_json::to_string(&comgs_synth::builtin::recipe("micro").unwrap()).unwrap();
    std::fs::write(root.path().join("recipe.json"), recipe).unwrap();
    for folder in ["object/shelf", "scene/room", "composition/room_with_shelf"] {
        std::fs::create_dir_all(root.path().join("syncom").join(folder)).unwrap();
    }
    for (path, expected) in [
        (world.scene.clone(), "asset (scene)"),
        (world.scene.join("asset.json"), "asset (scene)"),
        (world.scene.join("surfels.ply"), "PLY of surfels"),
        (world.cameras.clone(), "camera list"),
        (root.path().join("transform.json"), "placement"),
        (root.path().join("transform.json.place.run.json"), "place"),
        (out("env.exr"), "2:1"),
        (out("layers/00000.exr"), "shadow.G:half"),
        (out("frames/00000.png"), "64×48"),
        (out("composition.json"), "../room.asset"),
        (out("run.json"), "light: sweep"),
        (out("preview.gif"), "3"),
        (out("report.html"), "ball in room"),
        (root.path().join("scores.json"), "psnr_db"),
        (root.path().join("recipe.json"), "recipe for synth"),
        (root.path().join("syncom"), "shelf"),
        (input.output.clone(), "composition"),
        (capture, "4 to train, 2 to test"),
    ] {
        let text = info::run(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_text();
        assert!(text.contains(expected), "{}: {text}", path.display());
    }
    let odd = root.path().join("odd.bin");
    std::fs::write(&odd, b"?").unwrap();
    assert!(info::run(&odd).is_err() && info::run(&root.path().join("none")).is_err());
    let _ = Silent;
}
