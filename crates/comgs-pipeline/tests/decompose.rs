//! Decomposition as a stage: what is written, reuse, interruption, refusals; and how good it is, on a synthetic object at
//! thumbnail size whose truth is known.

mod common;

use comgs_inverse::{Quality, Visibility};
use comgs_pipeline::stages::{ablate, decompose, reconstruct};
use comgs_pipeline::{CancelToken, Context, PipelineError, Progress, Status, record::read_record};
use comgs_scene::{Asset, AssetKind};
use std::path::Path;

/// A capture of the ball and its asset as `reconstruct` would leave it.
fn ball(root: &Path) -> decompose::Input {
    let cameras = common::ring(14, 2.2, 0.8, (64, 64), 0.6);
    let capture = root.join("ball");
    common::write_capture(&capture, &common::object_cloud(), AssetKind::Object, &cameras);
    let asset = root.join("ball.asset");
    Asset::new(AssetKind::Object, common::object_cloud()).save(&asset).unwrap();
    decompose::Input { asset, capture, output: None }
}

fn quick() -> decompose::Config {
    let mut config = decompose::Config::preset(Quality::Draft);
    config.decompose.iterations = 30;
    config.decompose.probes = 200;
    config.decompose.probe_resolution = 8;
    config.decompose.rays = 16;
    config.decompose.light_size = 32;
    config.decompose.patches = 2;
    config.decompose.patch_size = 20;
    config
}

fn text_of(error: &PipelineError) -> String {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        text.push_str(&format!(": {cause}"));
        source = cause.source();
    }
    text
}

/// Goal: an object gets material, light, probes and its old surfels; the second run does nothing; another setting starts from
/// the old surfels again, so the order of runs does not matter.
#[test]
fn an_object_becomes_relightable_once() {
    let root = tempfile::tempdir().unwrap();
    let input = ball(root.path());
    let made = decompose::run(&input, &quick(), &Context::silent()).unwrap();
    assert!(!made.reused);
    let asset = Asset::load(&input.asset).unwrap();
    let material = asset.surfels.material.as_ref().expect("material");
    assert_eq!(material.albedo_logits.len(), asset.surfels.len());
    for file in [decompose::LIGHT_FILE, decompose::PROBES_FILE, decompose::RADIANCE_FILE] {
        assert!(asset.file(file).is_some_and(|p| p.is_file()), "{file}");
    }
    assert!(input.asset.join("decomposition.png").is_file());
    let probes = std::fs::read(asset.file(decompose::PROBES_FILE).unwrap()).unwrap();
    let (set, _) = comgs_probe::from_bytes(&probes).unwrap();
    assert!(set.len() > 10 && set.resolution == 8, "{} probes", set.len());
    let record = read_record(&input.asset.join("run.json")).unwrap();
    assert!(record.results["decomposition"]["scale"].as_str().unwrap().starts_with("prior"));

    assert!(decompose::run(&input, &quick(), &Context::silent()).unwrap().reused);
    let first = std::fs::read(input.asset.join("surfels.ply")).unwrap();
    let mut other = quick();
    other.decompose.visibility = Visibility::None;
    assert!(!decompose::run(&input, &other, &Context::silent()).unwrap().reused);
    assert!(Asset::load(&input.asset).unwrap().file(decompose::PROBES_FILE).is_none());
    decompose::run(&input, &quick(), &Context::silent()).unwrap();
    assert!(
        std::fs::read(input.asset.join("surfels.ply")).unwrap() == first,
        "a rerun must start from the same surfels"
    );
}

/// Goal: an explicit factor multiplies the albedo that the prior finds, exactly, and the report says so; so does a grey card,
/// whose pixel then has its albedo.
#[test]
fn the_scale_is_what_was_asked_for() {
    let root = tempfile::tempdir().unwrap();
    let input = ball(root.path());
    let albedo = |config: &decompose::Config, name: &str| {
        let input = decompose::Input { output: Some(root.path().join(name)), ..input.clone() };
        let made = decompose::run(&input, config, &Context::silent()).unwrap();
        let scale = made.record.results["decomposition"]["scale"].as_str().unwrap().to_owned();
        (Asset::load(root.path().join(name)).unwrap().surfels.material.unwrap().albedo_logits, scale)
    };
    let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
    let (plain, _) = albedo(&quick(), "a.asset");
    let mut scaled = quick();
    scaled.decompose.albedo_scale = comgs_inverse::AlbedoScale::Factor([0.5, 0.25, 0.5]);
    let (half, said) = albedo(&scaled, "b.asset");
    assert!(said.contains("given"), "{said}");
    for (a, b) in plain.iter().zip(&half) {
        for (c, factor) in [0.5, 0.25, 0.5].into_iter().enumerate() {
            assert!((sigmoid(b[c]) - (factor * sigmoid(a[c])).max(0.002)).abs() < 1e-4);
        }
    }
    let mut card = quick();
    card.grey_card = Some(decompose::GreyCard { view: "00003".into(), x: 32, y: 34, albedo: 0.1 });
    let (_, said) = albedo(&card, "c.asset");
    assert!(said.contains("grey card"), "{said}");
    card.grey_card = Some(decompose::GreyCard { view: "00003".into(), x: 0, y: 0, albedo: 0.1 });
    let wrong = decompose::Input { output: Some(root.path().join("d.asset")), ..input };
    let error = text_of(&decompose::run(&wrong, &card, &Context::silent()).unwrap_err());
    assert!(error.contains("grey card"), "{error}");
    assert!(!Asset::is_asset(&root.path().join("d.asset")));
}

/// Cancels when the steps have begun.
struct StopInSteps(CancelToken);

impl Progress for StopInSteps {
    fn begin(&self, _: &str) {}
    fn update(&self, status: &Status) {
        if status.message.contains("step ") {
            self.0.cancel();
        }
    }
    fn end(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn warn(&self, _: &str) {}
}

/// Goal: a stopped decomposition leaves the asset as it was and says how to go on; resumed, it ends with the bytes of one
/// that was never stopped (hard case 15).
#[test]
fn a_stopped_decomposition_resumes_to_the_same_bytes() {
    let root = tempfile::tempdir().unwrap();
    let input = ball(root.path());
    let before = std::fs::read(input.asset.join("surfels.ply")).unwrap();
    let mut config = quick();
    config.decompose.iterations = 400;
    let cancel = CancelToken::default();
    let stop = StopInSteps(cancel.clone());
    let error = decompose::run(&input, &config, &Context { progress: &stop, cancel }).unwrap_err();
    assert!(matches!(&error, PipelineError::Cancelled { kept: Some(_) }), "{error}");
    assert!(std::fs::read(input.asset.join("surfels.ply")).unwrap() == before);
    Asset::load(&input.asset).unwrap();
    let resumed = decompose::Config { resume: reconstruct::Resume::Expected, ..config.clone() };
    decompose::run(&input, &resumed, &Context::silent()).unwrap();
    let whole = decompose::Input { output: Some(root.path().join("whole.asset")), ..input.clone() };
    // The radiance surfels are the same, so the whole run starts where the stopped one did.
    decompose::run(&whole, &config, &Context::silent()).unwrap();
    for file in ["surfels.ply", decompose::LIGHT_FILE, decompose::PROBES_FILE] {
        let read = |folder: &Path| std::fs::read(folder.join(file)).unwrap();
        assert!(read(&input.asset) == read(&root.path().join("whole.asset")), "{file} differs");
    }
}

/// Goal: what cannot be decomposed is refused with the reason, and nothing is overwritten: a scene, photos without masks, other
/// photos than the surfels', a configuration out of range.
#[test]
fn unusable_input_is_refused() {
    let root = tempfile::tempdir().unwrap();
    let input = ball(root.path());
    let before = std::fs::read(input.asset.join("surfels.ply")).unwrap();
    let refuse = |input: &decompose::Input, config: &decompose::Config| {
        text_of(&decompose::run(input, config, &Context::silent()).unwrap_err())
    };
    let scene = root.path().join("room.asset");
    Asset::new(AssetKind::Scene, common::scene_cloud()).save(&scene).unwrap();
    let text = refuse(&decompose::Input { asset: scene, ..input.clone() }, &quick());
    assert!(text.contains("only objects"), "{text}");

    let unmasked = root.path().join("room");
    let cameras = common::ring(5, 2.6, 1.5, (32, 24), 0.9);
    common::write_capture(&unmasked, &common::scene_cloud(), AssetKind::Scene, &cameras);
    let text = refuse(&decompose::Input { capture: unmasked, ..input.clone() }, &quick());
    assert!(text.contains("mask"), "{text}");

    // Cameras that look at the object from so far that no depth is consistent with another.
    let mut apart = common::object_cloud();
    apart.positions.iter_mut().for_each(|p| p[2] += 500.0);
    let away = root.path().join("away.asset");
    Asset::new(AssetKind::Object, apart).save(&away).unwrap();
    let text = refuse(&decompose::Input { asset: away, ..input.clone() }, &quick());
    assert!(text.contains("consistent point"), "{text}");

    let mut bad = quick();
    bad.decompose.probe_resolution = 1;
    let text = refuse(&input, &bad);
    assert!(text.contains("probe_resolution"), "{text}");
    assert!(std::fs::read(input.asset.join("surfels.ply")).unwrap() == before);
    Asset::load(&input.asset).unwrap();
}

/// Goal: quality. A synthetic object at 64 × 64 is reconstructed, decomposed with and without probes, and judged by its
/// true albedo, normals and pictures under another light; the sweep writes its table and plots.
#[test]
fn a_synthetic_object_is_decomposed_well_enough() {
    let root = tempfile::tempdir().unwrap();
    let mut recipe = comgs_synth::builtin::recipe("tiny").unwrap();
    recipe.scenes.clear();
    recipe.compositions.clear();
    recipe.objects[0].views = comgs_synth::recipe::ViewPlan {
        size: (64, 64),
        train: 20,
        test: 3,
        train_samples: 24,
        test_samples: 64,
    };
    let data = root.path().join("data");
    comgs_synth::write_root(&recipe, &data, &mut |_| std::ops::ControlFlow::Continue(())).unwrap();
    let input = ablate::Input {
        capture: data.join("object").join(&recipe.objects[0].name),
        asset: None,
        relit: None,
        output: root.path().join("ablation"),
        command: "comgs ablate decompose".into(),
    };
    let config = ablate::Config {
        iterations: 100,
        knobs: vec!["visibility".into()],
        relit_views: 3,
        quality: Quality::Draft,
        max_width: 64,
        seed: 0,
    };
    let sweep = ablate::run(&input, &config, &Context::silent()).unwrap();
    assert_eq!(sweep.rows.len(), 3);
    for row in &sweep.rows {
        println!("{} {:.1} s {:?}", row.label, row.seconds, row.values);
    }
    let probes = &sweep.rows[0];
    // Bounds a decibel or two, and degrees, under what was measured when this was written (see the printed rows).
    assert!(probes.values["albedo_db"] > ALBEDO_DB, "{:?}", probes.values);
    assert!(probes.values["relit_db"] > RELIT_DB, "{:?}", probes.values);
    assert!(probes.values["normal_deg"] < NORMAL_DEG, "{:?}", probes.values);
    for file in ["decompose.csv", "decompose.md", "decompose.svg", "decompose.png"] {
        assert!(input.output.join(file).is_file(), "{file}");
    }
    let unknown = ablate::Config { knobs: vec!["colour".into()], ..config };
    assert!(ablate::run(&input, &unknown, &Context::silent()).is_err());
}

/// Measured 27.1 dB, 27.8 dB and 11.4° (150 steps; without probes 27.0 and 28.4: a small object that shades itself little).
const ALBEDO_DB: f64 = 25.0;
const RELIT_DB: f64 = 26.0;
const NORMAL_DEG: f64 = 14.0;
