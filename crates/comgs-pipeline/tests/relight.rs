//! Relighting and its scores on a small decomposed ball: what is written, kept, refused and said.

mod common;

use comgs_compose::{Indirect, RelightConfig, Relighter, SelfOcclusion};
use comgs_geom::Camera;
use comgs_image::{Image, write_exr};
use comgs_inverse::Quality;
use comgs_pipeline::stages::eval::{self, relit};
use comgs_pipeline::stages::relight::{self, Views, Visibility};
use comgs_pipeline::{CancelToken, Context, PipelineError, Progress, Status, record::read_record};
use comgs_probe::{BakeObserver, OrientedPoints, ProbeConfig, ProbeSet, bake, place, to_bytes};
use comgs_raster::{Planes, RasterConfig};
use comgs_scene::{Asset, AssetKind, write_cameras};
use comgs_surfel::{MaterialColumns, SurfelCloud, activation::logit};
use comgs_trace::{TraceConfig, Tracer};
use glam::Vec3;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The ball of the tests with a material that varies over it, its albedo times a factor.
fn ball(factor: [f32; 3]) -> SurfelCloud {
    let mut cloud = common::object_cloud();
    let albedo = |p: &[f32; 3]| [0.3 + 0.4 * p[0].abs(), 0.25 + 0.3 * p[1].abs(), 0.4];
    let scaled = |a: [f32; 3]| std::array::from_fn(|c| logit(a[c] * factor[c]));
    cloud.material = Some(MaterialColumns {
        albedo_logits: cloud.positions.iter().map(|p| scaled(albedo(p))).collect(),
        metallic_logits: vec![logit(0.05); cloud.len()],
        roughness_logits: vec![logit(0.4); cloud.len()],
    });
    cloud
}

fn sky(height: usize) -> Image {
    let mut image = Image::filled(2 * height, height, 3, 0.4);
    image.pixel_mut(height / 2, height / 4).copy_from_slice(&[60.0, 50.0, 40.0]);
    image
}

/// Baked probes of the ball.
fn probes(cloud: &SurfelCloud) -> (ProbeSet, ProbeConfig) {
    let points = OrientedPoints {
        positions: cloud.positions.iter().map(|p| Vec3::from_array(*p)).collect(),
        normals: (0..cloud.len()).map(|i| cloud.rotation(i).z_axis).collect(),
    };
    let config = ProbeConfig { count: 120, resolution: 8, ..ProbeConfig::paper() };
    let mut set = place(&points, &config, 1.0).unwrap();
    let tracer = Tracer::new(cloud, &TraceConfig::default()).unwrap();
    bake(&tracer, &mut set, 1, BakeObserver::silent()).unwrap();
    (set, config)
}

/// A decomposed asset: surfels with material, probes, light.
fn write_asset(folder: &Path, cloud: SurfelCloud, with_probes: bool) {
    let (set, config) = probes(&cloud);
    let probes = to_bytes(&set, &config).unwrap();
    let light = comgs_image::encode_exr(Path::new("env.exr"), &sky(8)).unwrap();
    let write_probes = |w: &mut dyn Write| w.write_all(&probes);
    let write_light = |w: &mut dyn Write| w.write_all(&light);
    let mut extra: Vec<comgs_scene::asset::ExtraFile<'_>> = vec![("env.exr", &write_light)];
    if with_probes {
        extra.push(("probes.safetensors", &write_probes));
    }
    Asset::new(AssetKind::Object, cloud).save_with(folder, &extra).unwrap();
}

struct Place {
    _keep: tempfile::TempDir,
    root: PathBuf,
    input: relight::Input,
}

/// A folder with a decomposed ball, a light and cameras.
fn prepare(with_probes: bool) -> Place {
    let keep = tempfile::tempdir().unwrap();
    let root = keep.path().to_owned();
    write_asset(&root.join("ball.asset"), ball([1.0; 3]), with_probes);
    write_exr(&root.join("sky.exr"), &sky(16)).unwrap();
    write_cameras(root.join("cameras.json"), &cameras()).unwrap();
    let input = relight::Input {
        asset: root.join("ball.asset"),
        light: Some(root.join("sky.exr")),
        views: Views::Cameras(root.join("cameras.json")),
        output: root.join("out"),
    };
    Place { _keep: keep, root, input }
}

fn cameras() -> Vec<Camera> {
    common::ring(3, 2.2, 0.9, (40, 32), 0.7)
}

fn quick() -> relight::Config {
    relight::Config { quality: Quality::Draft, rays: Some(16), layers: true, ..relight::Config::default() }
}

/// Keeps what a stage says, and asks it to stop at its `stop`th update.
#[derive(Default)]
struct Ear {
    notes: Mutex<Vec<String>>,
    updates: Mutex<Vec<Status>>,
    stop: Option<(usize, CancelToken)>,
}

impl Progress for Ear {
    fn begin(&self, _: &str) {}
    fn update(&self, status: &Status) {
        let mut updates = self.updates.lock().unwrap();
        updates.push(status.clone());
        if let Some((at, token)) = &self.stop
            && updates.len() == *at
        {
            token.cancel();
        }
    }
    fn end(&self, _: &str) {}
    fn note(&self, text: &str) {
        self.notes.lock().unwrap().push(text.to_owned());
    }
    fn warn(&self, _: &str) {}
}

fn read(path: &Path) -> Image {
    comgs_image::read(path).unwrap().color
}

/// Goal: frames and layers of every camera; the second run does nothing; another light, camera or knob runs again; the
/// background shows only where the object does not.
#[test]
fn frames_are_written_once() {
    let place = prepare(true);
    let run = |config: &relight::Config| relight::run(&place.input, config, &Context::silent()).unwrap();
    let made = run(&quick());
    assert!(!made.reused && made.preview.is_none());
    let out = |name: &str| place.input.output.join(name);
    for camera in cameras() {
        assert!(out(&format!("frames/{}.png", camera.name)).is_file());
        let channels = comgs_image::read::exr_channels(&out(&format!("layers/{}.exr", camera.name))).unwrap();
        // RGBA; three kinds of light; visibility, depth; normal, albedo; roughness, metallic.
        assert_eq!(channels.len(), 4 + 9 + 2 + 6 + 2, "{channels:?}");
    }
    assert!(made.record.warnings.is_empty(), "{:?}", made.record.warnings);
    assert_eq!(made.record.results["self_occlusion"], "mixed");
    assert_eq!(made.record.results["rays"], 16);
    assert!(made.record.results["shaded_pixels"].as_u64().unwrap() > 300);
    let frame = read(&out("frames/00000.png"));
    assert!(run(&quick()).reused);
    let shown = relight::Config { background: true, ..quick() };
    assert!(!run(&shown).reused);
    let over = read(&out("frames/00000.png"));
    assert_eq!(frame.rgb(0, 0), [0.0; 3]);
    assert!(over.rgb(0, 0)[0] > 0.3, "{:?}", over.rgb(0, 0));
    let change = frame.rgb(20, 16)[0] - over.rgb(20, 16)[0];
    assert!(change.abs() < 0.02 && frame.rgb(20, 16)[0] > 0.05, "{change}");
    let bounced = relight::Config { indirect: true, layers: false, ..quick() };
    let made = run(&bounced);
    assert!(made.record.results["bounce_seconds"].as_f64().unwrap() > 0.0);
    assert!(!out("layers/00000.exr").exists(), "layers that are not asked for any more are removed");
    let other = relight::Input { light: None, ..place.input.clone() };
    assert!(!relight::run(&other, &bounced, &Context::silent()).unwrap().reused, "the capture's own light");
}

/// Goal: a turntable holds the whole object in every frame, in the middle, and comes with its cameras and a moving
/// picture.
#[test]
fn turntable_goes_round() {
    let place = prepare(true);
    let input = relight::Input { views: Views::Turntable(4), ..place.input.clone() };
    let config = relight::Config { size: [48, 32], ..quick() };
    let made = relight::run(&input, &config, &Context::silent()).unwrap();
    assert!(made.preview.unwrap().is_file());
    let cameras = comgs_scene::read_cameras(input.output.join("cameras.json")).unwrap();
    assert_eq!(cameras.len(), 4);
    for camera in &cameras {
        let frame = read(&made.frames.join(format!("{}.png", camera.name)));
        assert_eq!((frame.width, frame.height), (48, 32));
        let lit = |x: usize, y: usize| frame.rgb(x, y).iter().sum::<f32>() > 0.01;
        let edge = (0..48).any(|x| lit(x, 0) || lit(x, 31)) || (0..32).any(|y| lit(0, y) || lit(47, y));
        let inside = (0..48 * 32).filter(|i| lit(i % 48, i / 48)).count();
        assert!(!edge && inside > 150 && lit(24, 16), "{}: {edge} {inside}", camera.name);
    }
    let none = relight::Input { views: Views::Turntable(0), ..input };
    let error = relight::run(&none, &config, &Context::silent()).unwrap_err().to_string();
    assert!(error.contains("at least one frame"), "{error}");
}

/// Goal: a stopped run keeps its frames, the same command continues and gives what an uninterrupted one gives, and says
/// how long it will take.
#[test]
fn stopped_runs_continue() {
    let place = prepare(true);
    let cancel = CancelToken::default();
    let ear = Ear { stop: Some((2, cancel.clone())), ..Ear::default() };
    let stopped = relight::run(&place.input, &quick(), &Context { progress: &ear, cancel });
    let Err(PipelineError::Cancelled { kept: Some(kept) }) = stopped else { panic!("{stopped:?}") };
    assert!(kept.contains("2 of 3 frames"), "{kept}");
    assert!(read_record(&place.input.output.join("run.json")).is_none());
    let ear = Ear::default();
    let context = Context { progress: &ear, cancel: CancelToken::default() };
    relight::run(&place.input, &quick(), &context).unwrap();
    assert!(ear.notes.lock().unwrap().iter().any(|n| n.contains("4 files")), "{:?}", ear.notes);
    assert_eq!(ear.updates.lock().unwrap().len(), 1);
    let whole = relight::Input { output: place.root.join("whole"), ..place.input.clone() };
    let ear = Ear::default();
    let context = Context { progress: &ear, cancel: CancelToken::default() };
    relight::run(&whole, &quick(), &context).unwrap();
    assert!(ear.updates.lock().unwrap().last().unwrap().remaining.is_some());
    for camera in cameras() {
        for file in [format!("frames/{}.png", camera.name), format!("layers/{}.exr", camera.name)] {
            let [a, b] = [&place.input.output, &whole.output].map(|o| std::fs::read(o.join(&file)).unwrap());
            assert!(a == b, "{file}");
        }
    }
}

/// Goal: an object without probes is traced and that is said; repaired lights are warned of with their counts; what
/// cannot be used is refused by name before anything is written (hard case 26).
#[test]
fn odd_inputs_are_told() {
    let place = prepare(false);
    let ear = Ear::default();
    let context = Context { progress: &ear, cancel: CancelToken::default() };
    let made = relight::run(&place.input, &quick(), &context).unwrap();
    assert!(ear.notes.lock().unwrap().iter().any(|n| n.contains("no probes")), "{:?}", ear.notes);
    assert_eq!(made.record.results["self_occlusion"], "trace");

    let mut broken = sky(16);
    broken.pixel_mut(3, 3)[0] = f32::NAN;
    broken.pixel_mut(5, 3)[2] = -2.0;
    write_exr(&place.root.join("broken.exr"), &broken).unwrap();
    let broken = relight::Input { light: Some(place.root.join("broken.exr")), ..place.input.clone() };
    let made = relight::run(&broken, &quick(), &Context::silent()).unwrap();
    let told = |w: &String| w.contains("1 NaN") && w.contains("1 negative") && w.contains("broken.exr");
    assert!(made.record.warnings.iter().any(told), "{:?}", made.record.warnings);

    let output = place.root.join("refused");
    let refused = |change: &dyn Fn(&mut relight::Input, &mut relight::Config)| {
        let mut input = relight::Input { output: output.clone(), ..place.input.clone() };
        let mut config = quick();
        change(&mut input, &mut config);
        let error = relight::run(&input, &config, &Context::silent()).unwrap_err();
        let mut text = error.to_string();
        if let Some(source) = std::error::Error::source(&error) {
            text.push_str(&format!(": {source}"));
        }
        assert!(!output.exists(), "{text}");
        text
    };
    write_exr(&place.root.join("square.exr"), &Image::filled(8, 8, 3, 1.0)).unwrap();
    let text = refused(&|input, _| input.light = Some(place.root.join("square.exr")));
    assert!(text.contains("twice as wide") && text.contains("square.exr"), "{text}");
    let text = refused(&|input, _| input.light = Some(place.root.join("nowhere.exr")));
    assert!(text.contains("nowhere.exr"), "{text}");
    Asset::new(AssetKind::Object, common::object_cloud()).save(place.root.join("plain.asset")).unwrap();
    let text = refused(&|input, _| input.asset = place.root.join("plain.asset"));
    assert!(text.contains("comgs decompose") && text.contains("plain.asset"), "{text}");
    let text = refused(&|_, config| {
        config.indirect = true;
        config.visibility = Visibility::None;
    });
    assert!(text.contains("indirect light needs"), "{text}");
    let text = refused(&|_, config| config.rays = Some(0));
    assert!(text.contains("both 0"), "{text}");
    let inside = relight::Input { output: place.input.asset.clone(), ..place.input.clone() };
    let text = relight::run(&inside, &quick(), &Context::silent()).unwrap_err().to_string();
    assert!(text.contains("a folder of its own"), "{text}");
}

/// A picture with straight alpha, as the data stores it.
fn straight(color: &Image, weight: &Image) -> Image {
    let mut rgba = Image::zeros(color.width, color.height, 4);
    for i in 0..weight.pixels() {
        let a = weight.data[i];
        for c in 0..3 {
            rgba.data[4 * i + c] = if a > 1.0 / 255.0 { color.data[3 * i + c] / a } else { 0.0 };
        }
        rgba.data[4 * i + 3] = a;
    }
    rgba
}

/// Ground truth of the ball in the SynCom layout: a capture with albedo, and the ball under two lights, with its own
/// probes, so that nothing but the albedo makes a difference.
fn write_truth(root: &Path) {
    let cloud = ball([1.0; 3]);
    common::write_capture(&root.join("object/ball"), &cloud, AssetKind::Object, &cameras());
    let test = root.join("object/ball/test");
    for camera in &cameras()[..2] {
        let frame = comgs_raster::render(&cloud, camera, Planes::ALL, &RasterConfig::default());
        let albedo = frame.material.unwrap().select(&[0, 1, 2]);
        let path = test.join(format!("albedo/{}.exr", camera.name));
        write_exr(&path, &straight(&albedo, &frame.weight)).unwrap();
    }
    let relit = root.join("object_relit/ball");
    write_cameras(relit.join("cameras.json"), &cameras()).unwrap();
    let (set, lookup) = probes(&cloud);
    for (name, light) in [("dim", Image::filled(8, 4, 3, 0.3)), ("sunny", sky(8))] {
        write_exr(&root.join(format!("object_relit/envmaps/{name}.exr")), &light).unwrap();
        let map = comgs_light::EnvironmentMap::from_image(&light).unwrap();
        let config = RelightConfig {
            self_occlusion: SelfOcclusion::Mixed,
            indirect: Indirect::OneBounce,
            ..RelightConfig::reference().with_lookup(&lookup)
        };
        let relighter = Relighter::new(&cloud, Some(&set), &map, config).unwrap();
        for camera in cameras() {
            let frame = relighter.render(&camera);
            let path = relit.join(format!("{name}/{}.exr", camera.name));
            write_exr(&path, &straight(&frame.radiance, &frame.weight)).unwrap();
        }
    }
}

/// Goal: an asset whose albedo is off by a factor a channel is told so: aligned scores are those of noise, the others
/// are worse, and the factor that is named is the one that was applied.
#[test]
fn relit_scores_align_albedo() {
    let keep = tempfile::tempdir().unwrap();
    let root = keep.path();
    write_truth(root);
    write_asset(&root.join("dark.asset"), ball([0.5, 0.8, 1.0]), true);
    let (capture, relit_root) = (root.join("object/ball"), root.join("object_relit/ball"));
    let score = |relit_root: &Path| {
        let input = eval::Input {
            subject: root.join("dark.asset"),
            against: capture.clone(),
            relit: Some(relit_root.to_owned()),
            json: None,
        };
        eval::run(&input, &Context::silent())
    };
    let scores = score(&relit_root).unwrap();
    let names: Vec<&str> = scores.sections.iter().map(|s| s.name.as_str()).collect();
    let expected = [
        "test",
        "relit dim",
        "relit dim, albedo aligned",
        "relit sunny",
        "relit sunny, albedo aligned",
        "relit",
        "relit, albedo aligned",
    ];
    assert_eq!(names, expected);
    for light in ["relit dim", "relit sunny", "relit"] {
        let section = |kind: &str| scores.section(&format!("{light}{kind}")).unwrap();
        let psnr = |kind: &str| section(kind).table.mean("psnr_db").unwrap();
        assert_eq!(section("").table.rows.len(), if light == "relit" { 2 } else { 3 });
        // What is left is noise.
        assert!(psnr(", albedo aligned") > 38.0, "{}", scores.to_text());
        assert!(psnr("") < psnr(", albedo aligned") - 8.0, "{}", scores.to_text());
    }
    let what = &scores.section("relit dim, albedo aligned").unwrap().what;
    assert!(what.contains("albedo times 2.00") && what.contains("1.25") && what.contains("1.00"), "{what}");

    // A light without a map and a camera without a picture are remarks; nothing at all is an error.
    std::fs::remove_file(root.join("object_relit/envmaps/dim.exr")).unwrap();
    std::fs::remove_file(relit_root.join("sunny/00001.exr")).unwrap();
    let (sections, remarks) =
        relit::evaluate(&root.join("dark.asset"), &capture, &relit_root, &quick(), &Context::silent())
            .unwrap();
    assert_eq!(sections.len(), 2);
    assert_eq!(sections[0].table.rows.len(), 2);
    assert!(remarks.iter().any(|r| r.contains("dim has no map")), "{remarks:?}");
    assert!(remarks.iter().any(|r| r.contains("1 of 3 cameras")), "{remarks:?}");
    std::fs::remove_file(root.join("object_relit/envmaps/sunny.exr")).unwrap();
    let text = score(&relit_root).unwrap_err().to_string();
    assert!(text.contains("no light with both"), "{text}");
    let text = score(&root.join("object_relit")).unwrap_err().to_string();
    assert!(text.contains("object_relit/NAME"), "{text}");
}
