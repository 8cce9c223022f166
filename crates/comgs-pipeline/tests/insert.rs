//! `insert` and its benchmark from files to files: what is written, kept, refused and said.

use comgs_geom::Camera;
use comgs_image::{Image, read, write_exr, write_png};
use comgs_insert::ground::{Ground, Size};
use comgs_insert::material::Property;
use comgs_insert::optimise::Curves;
use comgs_insert::render::Samples;
use comgs_insert::session::LightKind;
use comgs_insert::tone::Response;
use comgs_pipeline::stages::insert::{
    self, At, CameraFrom, Config, Filled, GroundFrom, GuidedBy, Input, MaterialChoice,
};
use comgs_pipeline::stages::insert_eval;
use comgs_pipeline::{CancelToken, Context, PipelineError, Silent};
use glam::DVec3;
use std::path::{Path, PathBuf};

/// A tent of four faces, as an OBJ with y up: half a metre wide and high.
const TENT: &str = "v -0.25 0 0.25\nv 0.25 0 0.25\nv 0.25 0 -0.25\nv -0.25 0 -0.25\nv 0 0.5 0\n\
                    f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 4 3 2 1\n";

/// A photo of a bright floor under a darker wall, an object, and a light.
fn files(folder: &Path) -> Input {
    let mut photo = Image::zeros(72, 48, 3);
    for y in 0..48 {
        for x in 0..72 {
            let v = if y < 17 { 0.25 } else { 0.4 + 0.05 * ((x / 6 + y / 6) % 2) as f32 };
            photo.pixel_mut(x, y).copy_from_slice(&[v, v, 0.9 * v]);
        }
    }
    write_png(&folder.join("photo.png"), &photo).unwrap();
    std::fs::write(folder.join("tent.obj"), TENT).unwrap();
    Input {
        image: folder.join("photo.png"),
        object: folder.join("tent.obj"),
        camera: None,
        reference: None,
        light: None,
        model: None,
        output: folder.join("out"),
    }
}

fn small() -> Config {
    Config {
        camera: CameraFrom::Fov(50.0),
        ground: GroundFrom::Given(Ground::Horizon { row: 17.0, height: 1.2 }),
        at: At::Ground([4.0, 0.0]),
        iterations: 120,
        light: LightKind::Gaussians(24),
        light_height: 16,
        samples: Samples { grid: 2, light: 32, shadow: 64, depth: 2 },
        ..Config::default()
    }
}

fn run(input: &Input, config: &Config) -> Result<insert::Output, PipelineError> {
    insert::run(input, config, &Context::silent())
}

fn said(input: &Input, config: &Config) -> String {
    run(input, config).unwrap_err().to_string()
}

/// Goal: all files are written and say the same thing: the composite is the layers put together, the tent is where it was
/// put and casts a shadow, the light is a map; a second run does nothing, and another seed runs again.
#[test]
fn an_insertion_from_files_to_files() {
    let root = tempfile::tempdir().unwrap();
    let (input, config) = (files(root.path()), small());
    let made = run(&input, &config).unwrap();
    assert!(!made.reused);
    for name in [
        "composite.png",
        "preview.png",
        "env.exr",
        "layers.exr",
        "tone.json",
        "tone.svg",
        "camera.json",
        "plane.json",
        "scene.gltf",
        "report.html",
        "run.json",
    ] {
        assert!(input.output.join(name).is_file(), "{name}");
        assert!(name == "run.json" || made.record.outputs.iter().any(|o| o.path == name), "{name}");
    }
    let photo = read(&input.image).unwrap().color;
    let composite = read(&made.composite).unwrap().color;
    let changed = |x: usize, y: usize| {
        (0..3).map(|c| (composite.pixel(x, y)[c] - photo.pixel(x, y)[c]).abs()).fold(0.0f32, f32::max)
    };
    let most =
        (30..40).flat_map(|y| (28..44).map(move |x| (x, y))).map(|(x, y)| changed(x, y)).fold(0.0, f32::max);
    assert!(most > 0.01, "where the tent stands: {most}");
    assert!(made.record.results["object_pixels"].as_u64().unwrap() > 50);
    assert_eq!(changed(3, 3), 0.0, "the wall");
    let results = &made.record.results;
    assert!(results["darkest_shadow"].as_f64().unwrap() < 0.8);
    assert!((results["scene"]["size"][2].as_f64().unwrap() - 0.5).abs() < 1e-5);
    let channels = comgs_image::read::exr_channels(&input.output.join("layers.exr")).unwrap();
    for name in ["R:half", "object.A:half", "shadow.R:float", "mask.Y:half", "depth.Z:float", "albedo.G:half"]
    {
        assert!(channels.iter().any(|c| c == name), "{name} in {channels:?}");
    }
    let env = read(&input.output.join("env.exr")).unwrap().color;
    assert_eq!((env.width, env.height), (32, 16));
    assert!(env.data.iter().all(|v| v.is_finite() && *v >= 0.0));
    let camera = &comgs_scene::read_cameras(input.output.join("camera.json")).unwrap()[0];
    assert!((camera.centre().z - 1.2).abs() < 1e-5);
    // The glTF that is written is one that is read: the ground at height 0.
    let ground = comgs_scene::read_mesh(&input.output.join("scene.gltf"), comgs_scene::mesh::Up::Y).unwrap();
    assert!(ground.triangles.len() == 2 && ground.positions.iter().all(|p| p.z.abs() < 1e-6));
    assert!(ground.normals.iter().all(|n| n.z > 0.99));

    assert!(run(&input, &config).unwrap().reused);
    assert!(!run(&input, &Config { seed: 1, ..config }).unwrap().reused);
}

/// Goal: from a composite made under a light from one side, `reference` finds light that makes it again, better than even
/// light does by far, and the tone stays the identity when it is fixed.
#[test]
fn a_reference_is_matched() {
    let root = tempfile::tempdir().unwrap();
    let mut input = files(root.path());
    let mut map = Image::filled(32, 16, 3, 0.15);
    map.pixel_mut(9, 4).copy_from_slice(&[60.0, 55.0, 45.0]);
    write_exr(&root.path().join("side.exr"), &map).unwrap();
    input.light = Some(root.path().join("side.exr"));
    input.output = root.path().join("truth");
    let config = Config { guidance: GuidedBy::None, ..small() };
    let truth = run(&input, &config).unwrap().composite;
    input.light = None;
    input.output = root.path().join("even");
    let even = run(&input, &config).unwrap().composite;
    input.reference = Some(truth.clone());
    input.output = root.path().join("found");
    let config = Config { guidance: GuidedBy::Reference, curves: Curves::Fixed, iterations: 200, ..small() };
    let made = run(&input, &config).unwrap();
    let error = |path: &Path| -> f64 {
        let (a, b) = (read(path).unwrap().color, read(&truth).unwrap().color);
        comgs_metrics::rmse(&a, &b, comgs_metrics::PixelWeights::Uniform, None).unwrap()
    };
    let (found, even) = (error(&made.composite), error(&even));
    assert!(found < 0.3 * even, "{found} against {even}");
    let results = &made.record.results;
    assert!(
        results["last_loss"]["guidance"].as_f64().unwrap()
            < 0.2 * results["first_loss"]["guidance"].as_f64().unwrap()
    );
    let tone = std::fs::read_to_string(input.output.join("tone.json")).unwrap();
    let tone: serde_json::Value = serde_json::from_str(&tone).unwrap();
    assert_eq!(tone["object"]["slopes"][2], 1.0);
}

/// Goal: the preview alone is written when it is asked for.
#[test]
fn preview_alone() {
    let root = tempfile::tempdir().unwrap();
    let input = files(root.path());
    run(&input, &Config { preview_only: true, ..small() }).unwrap();
    assert!(input.output.join("preview.png").is_file() && !input.output.join("composite.png").exists());
    let (photo, preview) =
        (read(&input.image).unwrap().color, read(&input.output.join("preview.png")).unwrap().color);
    assert_ne!(photo, preview);
}

/// Goal: bad input is refused in sentences that say what and where, and nothing is written.
#[test]
fn bad_input() {
    let root = tempfile::tempdir().unwrap();
    let input = files(root.path());
    let with = |change: &dyn Fn(&mut Input, &mut Config)| {
        let (mut input, mut config) = (input.clone(), small());
        change(&mut input, &mut config);
        let text = said(&input, &config);
        assert!(!input.output.exists(), "something was written: {text}");
        text
    };
    let path = |name: &str| -> PathBuf { root.path().join(name) };
    assert!(with(&|_, c| c.at = At::Pixel([30.0, 10.0])).contains("horizon is at row 17.0"));
    assert!(with(&|_, c| c.at = At::Pixel([300.0, 10.0])).contains("72×48"));
    assert!(with(&|_, c| c.at = At::Ground([-3.0, 0.0])).contains("behind the camera"));
    assert!(with(&|_, c| c.at = At::Ground([2.0, 9.0])).contains("frame"));
    assert!(
        with(&|_, c| c.ground = GroundFrom::Given(Ground::Horizon { row: 17.0, height: -1.0 }))
            .contains("positive height")
    );
    assert!(with(&|_, c| c.camera = CameraFrom::Fov(190.0)).contains("170 degrees"));
    assert!(with(&|_, c| c.scale = Some(-1.0)).contains("--scale"));
    assert!(with(&|_, c| c.light_height = 7).contains("--light-height"));
    assert!(with(&|_, c| c.guidance = GuidedBy::Reference).contains("reference=IMAGE"));
    assert!(with(&|i, _| i.light = Some(path("photo.png"))).contains("--guidance none"));
    assert!(with(&|i, _| i.image = path("none.jpg")).contains("none.jpg"));
    write_png(&path("other.png"), &Image::filled(10, 10, 3, 0.5)).unwrap();
    let text = with(&|i, c| {
        i.reference = Some(path("other.png"));
        c.guidance = GuidedBy::Reference;
    });
    assert!(text.contains("72×48") && text.contains("10×10"), "{text}");
    let mut broken = Image::filled(72, 48, 3, 0.5);
    broken.data[5] = f32::NAN;
    write_exr(&path("nan.exr"), &broken).unwrap();
    assert!(with(&|i, _| i.image = path("nan.exr")).contains("1 NaN or infinite"));
    std::fs::write(path("flat.obj"), "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n").unwrap();
    assert!(with(&|i, _| i.object = path("flat.obj")).contains("without area"));
    let text = with(&|i, c| {
        i.reference = Some(path("photo.png"));
        c.guidance = GuidedBy::Reference;
        c.memory = 1000;
    });
    assert!(text.contains("--memory") && text.contains("bytes"), "{text}");
}

/// Goal: a run that is stopped says so and leaves no composite.
#[test]
fn a_stopped_run() {
    let root = tempfile::tempdir().unwrap();
    let input = files(root.path());
    let cancel = CancelToken::default();
    cancel.cancel();
    let error = insert::run(&input, &small(), &Context { progress: &Silent, cancel }).unwrap_err();
    assert!(matches!(error, PipelineError::Cancelled { .. }));
    assert!(!input.output.join("composite.png").exists());
}

/// Goal: the benchmark writes its tables, the true light scores best by far, and a folder without maps is refused.
#[test]
fn the_benchmark() {
    let root = tempfile::tempdir().unwrap();
    let maps = root.path().join("maps");
    std::fs::create_dir(&maps).unwrap();
    let input = |maps: &Path| insert_eval::Input {
        maps: maps.to_owned(),
        model: None,
        output: root.path().join("eval"),
        command: "comgs insert-eval maps".into(),
    };
    let config = insert_eval::Config {
        size: [72, 48],
        samples: Samples { grid: 2, light: 24, shadow: 48, depth: 2 },
        iterations: 30,
        light_height: 16,
        count: 1,
        ..insert_eval::Config::default()
    };
    let text = insert_eval::run(&input(&maps), &config, &Context::silent()).unwrap_err().to_string();
    assert!(text.contains("environment maps"));
    let mut map = Image::filled(64, 32, 3, 0.3);
    for x in 20..24 {
        map.pixel_mut(x, 8).copy_from_slice(&[40.0, 38.0, 30.0]);
    }
    write_exr(&maps.join("city.exr"), &map).unwrap();
    let made = insert_eval::run(&input(&maps), &config, &Context::silent()).unwrap();
    let of = |name: &str| made.rows.iter().find(|r| r.method.contains(name)).unwrap().touched;
    assert!(of("true map").rmse_srgb < 0.5 * of("even").rmse_srgb);
    assert!(of("true map").ssim > of("even").ssim);
    let table = std::fs::read_to_string(&made.table).unwrap();
    assert!(table.contains("| even light |") && table.contains("comgs insert-eval maps"));
    let there = |name: &str| root.path().join("eval").join(name);
    assert!(there("sheet.png").is_file() && there("insert_eval.csv").is_file());
    assert!(made.rows.iter().all(|r| !r.unseen));

    // A further map leaves the first one's results as they are; stopped after some of its methods, it goes on from there.
    let changed = |name: &str| std::fs::metadata(there(name)).unwrap().modified().unwrap();
    let first = changed("city_panorama.png");
    write_exr(&maps.join("mine.exr"), &map.map(|v| 0.7 * v)).unwrap();
    let stopping = Stopping { token: CancelToken::default(), at: "mine, map 2 of 2, panorama" };
    let context = Context { progress: &stopping, cancel: stopping.token.clone() };
    let error = insert_eval::run(&input(&maps), &config, &context).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, PipelineError::Cancelled { .. }) && text.contains("1 of 2 maps"), "{text}");
    let second = changed("mine_even_light.png");
    assert!(!there("mine_panorama.png").exists() && !there("run.json").exists());
    let made = insert_eval::run(&input(&maps), &config, &Context::silent()).unwrap();
    assert_eq!((changed("city_panorama.png"), changed("mine_even_light.png")), (first, second));
    assert_eq!(made.rows.iter().filter(|r| r.unseen).count(), made.rows.len() / 2);
    let table = std::fs::read_to_string(&made.table).unwrap();
    assert!(
        table.contains("2 maps: all maps") && table.contains("1 maps: maps that it never saw"),
        "{table}"
    );
    // A picture that was changed is made again; another seed makes all of it again.
    std::fs::write(there("mine_even_light.png"), b"damaged").unwrap();
    insert_eval::run(&input(&maps), &config, &Context::silent()).unwrap();
    assert!(changed("mine_even_light.png") > second && changed("city_panorama.png") == first);
    insert_eval::run(&input(&maps), &insert_eval::Config { seed: 1, ..config }, &Context::silent()).unwrap();
    assert!(changed("city_panorama.png") > first);
}

/// Asks for a stop when it hears of something.
struct Stopping {
    token: CancelToken,
    at: &'static str,
}

impl comgs_pipeline::Progress for Stopping {
    fn begin(&self, _: &str) {}
    fn update(&self, status: &comgs_pipeline::Status) {
        if status.message.starts_with(self.at) {
            self.token.cancel();
        }
    }
    fn end(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn warn(&self, _: &str) {}
}

/// Goal: without a plane the ground is asked of the photo: a tiled room tells it, a plain photo does not and is said not to; corners
/// whose sides are not square are remarked on.
#[test]
fn the_ground_by_the_photo() {
    let root = tempfile::tempdir().unwrap();
    let mut input = files(root.path());
    let (w, h) = (300, 200);
    let mut camera = Camera::look_at("photo", w, h, 1.0, DVec3::Z * 1.3, DVec3::new(3.0, 1.0, 0.3), DVec3::Z);
    camera.world_from_camera.matrix3 *= glam::DMat3::from_rotation_z(0.09);
    let mut photo = Image::zeros(w, h, 3);
    for y in 0..h {
        for x in 0..w {
            let mut sum = 0.0;
            for k in 0..9 {
                let (u, v) = ((k % 3) as f64 / 3.0 + 0.17, (k / 3) as f64 / 3.0 + 0.17);
                let ray = camera.ray_world(x as f64 + u, y as f64 + v);
                let (floor, wall) = (-1.3 / ray.z, 5.0 / ray.x);
                let tile = |a: f64, b: f64| f64::from(((a.floor() + b.floor()) as i64).rem_euclid(2) as u8);
                sum += if ray.z < 0.0 && floor < wall {
                    0.3 + 0.3 * tile(ray.x * floor / 0.6, ray.y * floor / 0.6)
                } else {
                    0.2 + 0.2 * tile(ray.y * wall / 0.9, (1.3 + ray.z * wall) / 0.9)
                };
            }
            photo.pixel_mut(x, y).copy_from_slice(&[(sum / 9.0) as f32; 3]);
        }
    }
    write_png(&root.path().join("room.png"), &photo).unwrap();
    let config = Config {
        camera: CameraFrom::Fov(1.0f64.to_degrees()),
        ground: GroundFrom::Photo { height: 1.3 },
        at: At::Ground([3.0, 0.0]),
        preview_only: true,
        ..small()
    };
    let plain = run(&input, &config).unwrap().record;
    assert!(plain.warnings.iter().any(|w| w.contains("edges do not tell")), "{:?}", plain.warnings);
    input.image = root.path().join("room.png");
    let found = run(&input, &config).unwrap().record;
    assert!(found.warnings.iter().any(|w| w.contains("from the photo's edges")), "{:?}", found.warnings);
    let normal: Vec<f64> =
        serde_json::from_value(found.results["scene"]["upright"]["normal"].clone()).unwrap();
    let up = camera.camera_from_world().transform_vector3(DVec3::Z);
    let off = DVec3::from_slice(&normal).angle_between(up).to_degrees();
    assert!(off < 1.0, "{off}");
    let corners = [[3.0, 0.6], [3.5, 0.6], [3.8, 1.1], [3.3, 1.1]]
        .map(|[x, y]| camera.project(DVec3::new(x, y, 0.0)).unwrap().0.to_array());
    let ground = GroundFrom::Given(Ground::Rectangle { corners, size: Size::Side(1.0) });
    let askew = run(&input, &Config { ground, ..config }).unwrap().record;
    assert!(askew.warnings.iter().any(|w| w.contains("59° instead of 90°")), "{:?}", askew.warnings);
}

/// Goal: the colour of a part is found from files, the light known; a search without a guidance that looks, a part that is
/// not there and a missing bundle are refused by what is wrong.
#[test]
fn a_material_is_found_and_wrong_wishes_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let mut input = files(root.path());
    let mut map = Image::filled(32, 16, 3, 0.3);
    map.pixel_mut(9, 4).copy_from_slice(&[9.0, 8.0, 7.0]);
    write_exr(&root.path().join("light.exr"), &map).unwrap();
    let colored = |name: &str, kd: &str| {
        std::fs::write(root.path().join(format!("{name}.mtl")), format!("newmtl cloth\nKd {kd}\nPr 0.9\n"))
            .unwrap();
        let object = root.path().join(format!("{name}.obj"));
        std::fs::write(&object, format!("mtllib {name}.mtl\nusemtl cloth\n{TENT}")).unwrap();
        object
    };
    input.light = Some(root.path().join("light.exr"));
    input.object = colored("blue", "0.2 0.4 0.7");
    input.output = root.path().join("truth");
    let config = Config { guidance: GuidedBy::None, response: Response::Reinhard, ..small() };
    let truth = run(&input, &config).unwrap().composite;
    input.object = colored("grey", "0.6 0.6 0.6");
    input.output = root.path().join("found");
    input.reference = Some(truth);
    let choice = |part: Option<&str>| {
        Some(MaterialChoice { part: part.map(str::to_owned), free: vec![Property::Albedo] })
    };
    let config = Config {
        guidance: GuidedBy::Reference,
        material: choice(None),
        curves: Curves::Fixed,
        iterations: 200,
        ..config
    };
    let made = run(&input, &config).unwrap();
    let found = &made.record.results["material"];
    assert_eq!(found["part"], "cloth");
    for (c, truth) in [0.2, 0.4, 0.7].into_iter().enumerate() {
        let ours = found["after"]["albedo"][c].as_f64().unwrap();
        assert!((ours - truth).abs() < 0.04, "{c}: {ours} instead of {truth}");
    }
    let wrong = |config: Config, word: &str| {
        let text = said(&input, &config);
        assert!(text.contains(word), "{text:?} lacks {word:?}");
    };
    wrong(Config { material: choice(Some("hat")), ..config.clone() }, "cloth");
    wrong(Config { guidance: GuidedBy::None, ..config.clone() }, "--material");
    wrong(Config { guidance: GuidedBy::Lds, material: None, ..config.clone() }, "--model DIR");
}

/// Goal: the learned completion is another light than the smooth one, finite everywhere.
#[test]
fn a_photo_completed_by_the_model() {
    let root = tempfile::tempdir().unwrap();
    let mut input = files(root.path());
    let light = |input: &Input, fill: Filled| {
        let made = run(input, &Config { fill, iterations: 40, ..small() }).unwrap();
        read(&made.folder.join("env.exr")).unwrap().color
    };
    let smooth = light(&input, Filled::Harmonic);
    input.output = root.path().join("learned");
    let learned = light(&input, Filled::Learned);
    assert!(learned.data.iter().all(|v| v.is_finite() && *v >= 0.0) && learned != smooth);
}
