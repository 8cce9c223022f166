//! Shadow, render, animate and plan on a small world: what they write, read again, refuse and estimate.

mod common;

use comgs_geom::Similarity;
use comgs_image::{Image, write_exr};
use comgs_inverse::Quality;
use comgs_pipeline::stages::editing::{Relight, Settings, Shadow};
use comgs_pipeline::stages::{
    animate, plan, render_composition, shadow, tradeoff_reconstruct, tradeoff_relight,
};
use comgs_pipeline::{Context, PipelineError};
use comgs_scene::composition::COMPOSITION_VERSION;
use comgs_scene::{
    Asset, AssetKind, CompositionRecord, EffectPolicy, LampRecord, ObjectRecord, ShadowPolicy, TransformFile,
    write_cameras,
};
use comgs_surfel::{MaterialColumns, activation::logit};
use glam::{DQuat, DVec3};
use std::path::{Path, PathBuf};

fn similarity(x: f64, y: f64, z: f64) -> Similarity {
    Similarity { scale: 0.6, rotation: DQuat::from_rotation_z(0.4), translation: DVec3::new(x, y, z) }
}

/// A sky with a sun.
fn sunny() -> Image {
    let mut image = Image::filled(64, 32, 3, 0.3);
    image.pixel_mut(20, 8).copy_from_slice(&[120.0, 110.0, 100.0]);
    image
}

/// A room, a ball with or without material, a light, cameras.
fn write(root: &Path, places: &[Similarity], with_material: bool, light: &Image) -> PathBuf {
    let mut ball = common::object_cloud();
    if with_material {
        ball.material = Some(MaterialColumns {
            albedo_logits: vec![[logit(0.8), logit(0.2), logit(0.2)]; ball.len()],
            metallic_logits: vec![logit(0.02); ball.len()],
            roughness_logits: vec![logit(0.7); ball.len()],
        });
    }
    Asset::new(AssetKind::Scene, common::scene_cloud()).save(root.join("room.asset")).unwrap();
    Asset::new(AssetKind::Object, ball).save(root.join("ball.asset")).unwrap();
    write_exr(&root.join("env.exr"), light).unwrap();
    write_cameras(root.join("cameras.json"), &common::ring(3, 2.6, 1.5, (128, 96), 0.9)).unwrap();
    let record = CompositionRecord {
        version: COMPOSITION_VERSION,
        scene: "room.asset".into(),
        objects: places
            .iter()
            .enumerate()
            .map(|(i, s)| ObjectRecord {
                name: format!("ball{i}"),
                asset: "ball.asset".into(),
                similarity: (*s).into(),
            })
            .collect(),
        light: Some("env.exr".into()),
        light_at: None,
        lamps: Vec::new(),
        effects: EffectPolicy { shadow: ShadowPolicy::Traced },
        cameras: "cameras.json".into(),
    };
    let path = root.join("composition.json");
    record.write(&path).unwrap();
    path
}

fn draft() -> Settings {
    Settings { quality: Quality::Draft, ..Settings::default() }
}

fn render(root: &Path, composition: &Path, name: &str, settings: Settings) -> render_composition::Output {
    let input = render_composition::Input {
        composition: composition.to_owned(),
        cameras: None,
        photos: None,
        cache: Some(root.join("cache")),
        output: root.join(name),
    };
    let config = render_composition::Config { settings, ..render_composition::Config::default() };
    render_composition::run(&input, &config, &Context::silent()).unwrap()
}

fn picture(root: &Path, name: &str, camera: &str) -> Image {
    comgs_image::read(&root.join(name).join("frames").join(format!("{camera}.png"))).unwrap().color
}

fn mean(image: &Image) -> f32 {
    image.data.iter().sum::<f32>() / image.data.len() as f32
}

fn rms(a: &Image, b: &Image) -> f32 {
    (a.data.iter().zip(&b.data).map(|(a, b)| (a - b).powi(2)).sum::<f32>() / a.data.len() as f32).sqrt()
}

/// Goal: fields are baked once and read again, also after the object has moved; an unchanged run does nothing; cached,
/// probe and traced shadows give nearly the same picture, and all are darker than none.
#[test]
fn occlusion_is_baked_once_and_all_shadows_agree() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let composition = write(root, &[similarity(0.0, 0.0, 0.3)], false, &sunny());
    let bake = || {
        let input = shadow::Input { composition: composition.clone(), output: root.join("cache") };
        shadow::run(&input, &draft(), &Context::silent()).unwrap()
    };
    assert_eq!((bake().read, bake().read), (0, 1));
    let cached = render(root, &composition, "cached", draft());
    assert_eq!(cached.record.results["occlusion_read"], 1);
    assert_eq!(cached.record.results["missed_pixels"], 0);
    assert!(render(root, &composition, "cached", draft()).reused);
    let traced = Settings { shadow: Shadow::Trace, ..draft() };
    render(root, &composition, "traced", traced);
    render(root, &composition, "probes", Settings { shadow: Shadow::Probes, ..draft() });
    render(root, &composition, "none", Settings { shadow: Shadow::None, ..draft() });
    for camera in ["00000", "00001"] {
        let of = |name: &str| picture(root, name, camera);
        let (cached, traced, none) = (of("cached"), of("traced"), of("none"));
        assert!(mean(&cached) < 0.98 * mean(&none), "{} {}", mean(&cached), mean(&none));
        let (near, far) = (rms(&cached, &traced), rms(&none, &traced));
        assert!(near < 0.35 * far, "{camera}: cached {near}, none {far}");
        let probes = rms(&of("probes"), &traced);
        assert!(probes < 0.6 * far, "{camera}: probes {probes}, none {far}");
    }
    // Moved, the object needs no new field.
    write(root, &[similarity(0.5, 0.3, 0.3)], false, &sunny());
    assert_eq!(render(root, &composition, "moved", draft()).record.results["occlusion_read"], 1);
}

/// Goal: several objects, one of them twice, are baked once and shadow together; a lamp adds a shadow of its own (hard
/// case 32).
#[test]
fn hard_case_32_several_objects_and_lamps() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let places = [similarity(-0.5, 0.0, 0.3), similarity(0.5, 0.1, 0.3)];
    let composition = write(root, &places, false, &Image::filled(16, 8, 3, 0.4));
    let two = render(root, &composition, "two", draft());
    assert_eq!(two.record.results["strong_lights"], 0);
    let mut record = CompositionRecord::read(&composition).unwrap();
    let lamp = LampRecord::Point { position: [0.0, 1.5, 1.2], intensity: [6.0; 3], radius: 0.05 };
    record.lamps = vec![lamp];
    record.write(&composition).unwrap();
    let lit = render(root, &composition, "lamp", draft());
    assert_eq!(lit.record.results["strong_lights"], 1);
    assert!(rms(&picture(root, "two", "00000"), &picture(root, "lamp", "00000")) > 0.004);
    record.lamps = vec![LampRecord::Point { position: [f64::MAX; 3], intensity: [-1.0; 3], radius: 0.1 }];
    record.write(&composition).unwrap();
    let input = render_composition::Input {
        composition,
        cameras: None,
        photos: None,
        cache: None,
        output: root.join("bad"),
    };
    let error = render_composition::run(&input, &Default::default(), &Context::silent()).unwrap_err();
    assert!(error.to_string().contains("lamp 1"), "{error}");
}

/// Goal: bad input of issue 5 and hard cases 26, 30, 31, 33: a black light gives frames without shadow and says so; an
/// object inside the floor, in mid-air, larger than the scene and out of sight is rendered finite, and said; a
/// similarity that is none is refused with its field; zero receivers are no error.
#[test]
fn hard_cases_26_30_33_bad_input_is_named() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let run = |s: Similarity, light: &Image, name: &str| {
        let composition = write(root, &[s], false, light);
        let made = render(root, &composition, name, draft());
        for camera in ["00000", "00001", "00002"] {
            assert_eq!(picture(root, name, camera).non_finite(), 0, "{name}");
        }
        made.record.warnings.join("\n")
    };
    let standing = similarity(0.0, 0.0, 0.3);
    assert!(run(standing, &Image::zeros(16, 8, 3), "black").contains("black"));
    assert_eq!(
        rms(&picture(root, "black", "00000"), &{
            let composition = write(root, &[standing], false, &Image::zeros(16, 8, 3));
            render(root, &composition, "plain", Settings { shadow: Shadow::None, ..draft() });
            picture(root, "plain", "00000")
        }),
        0.0
    );
    let sky = sunny();
    assert!(run(similarity(0.0, 0.0, -0.1), &sky, "sunk").contains("sunk"));
    assert!(run(similarity(0.0, 0.0, 5.0), &sky, "air").contains("mid-air"));
    let huge = Similarity { scale: 30.0, ..standing };
    assert!(run(huge, &sky, "huge").contains("larger than the scene"));
    assert!(run(similarity(500.0, 0.0, 0.3), &sky, "away").contains("no camera sees"));
    let composition = write(root, &[standing], false, &sky);
    let text = std::fs::read_to_string(&composition).unwrap();
    std::fs::write(&composition, text.replace("\"scale\": 0.6", "\"scale\": -0.6")).unwrap();
    let input = plan::Input { composition, cameras: None, photos: None, cache: None };
    let error = plan::run(&input, &draft(), &plan::Limits::default(), &Context::silent()).unwrap_err();
    assert!(
        matches!(error, PipelineError::Scene(_)) && error.to_string().contains("similarity.scale"),
        "{error}"
    );
}

/// Goal: a path of poses gives a frame a step without baking again; a path without poses, and one that names nobody, are
/// refused.
#[test]
fn objects_move_along_a_path() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let composition = write(root, &[similarity(0.0, 0.0, 0.3)], false, &sunny());
    let poses = root.join("poses");
    std::fs::create_dir(&poses).unwrap();
    let input = |path: PathBuf| {
        write_cameras(root.join("one.json"), &common::ring(1, 2.6, 1.5, (64, 48), 0.9)).unwrap();
        animate::Input {
            composition: composition.clone(),
            path,
            cameras: Some(root.join("one.json")),
            photos: None,
            cache: None,
            output: root.join("film"),
        }
    };
    let config = animate::Config { settings: draft() };
    let refuse =
        |input: &animate::Input| animate::run(input, &config, &Context::silent()).unwrap_err().to_string();
    assert!(refuse(&input(poses.clone())).contains("files of transforms"));
    for k in 0..3 {
        let file = TransformFile::single("ball0", similarity(0.3 * f64::from(k) - 0.3, 0.0, 0.3));
        file.write(poses.join(format!("{k}.json"))).unwrap();
    }
    let made = animate::run(&input(poses.clone()), &config, &Context::silent()).unwrap();
    assert!(made.preview.is_file() && made.edit_s > 0.0);
    let frame = |k: usize| comgs_image::read(&root.join(format!("film/frames/{k:05}.png"))).unwrap().color;
    assert!(rms(&frame(0), &frame(1)) > 0.01 && rms(&frame(1), &frame(2)) > 0.01);
    let stranger = TransformFile {
        objects: vec![("cat".into(), similarity(0.0, 0.0, 0.3)), ("dog".into(), similarity(0.0, 0.0, 0.3))],
    };
    stranger.write(poses.join("9.json")).unwrap();
    assert!(refuse(&input(poses)).contains("cat, dog"));
}

/// A sky with a sun 8° above the horizon, on the side where the room has no wall.
fn evening() -> Image {
    let mut image = Image::filled(64, 32, 3, 0.3);
    image.pixel_mut(52, 14).copy_from_slice(&[400.0, 360.0, 300.0]);
    image
}

/// Goal: the plan's estimates hold within a factor of two of what the effects change at full size, all six of them, on a ball
/// with material under a sun, a low sun, whose shadow is long, and an overcast sky; what is below the tolerance is left out,
/// what is above is in; a budget that cannot be met gives the cheapest plan and says so.
#[test]
fn estimates_hold_within_a_factor_of_two() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let mut compared = std::collections::BTreeSet::new();
    for (light, name) in
        [(sunny(), "sun"), (evening(), "evening"), (Image::filled(16, 8, 3, 0.5), "overcast")]
    {
        let composition = write(root, &[similarity(0.0, 0.0, 0.3)], true, &light);
        let input =
            plan::Input { composition: composition.clone(), cameras: None, photos: None, cache: None };
        let made = plan::run(&input, &draft(), &plan::Limits::default(), &Context::silent()).unwrap();
        let line = |effect: &str| made.lines.iter().find(|l| l.effect == effect).unwrap();
        let mut settings =
            Settings { relight: Relight::Off, shadow: Shadow::None, self_occlusion: false, ..draft() };
        let frames = |settings: &Settings, folder: &str| -> Vec<Image> {
            let folder = format!("{name}_{folder}");
            render(root, &composition, &folder, settings.clone());
            ["00000", "00001", "00002"].map(|c| picture(root, &folder, c)).to_vec()
        };
        let mut before = frames(&settings, "none");
        let steps: [(&str, fn(&mut Settings)); 7] = [
            ("scene light on the object", |s| s.relight = Relight::Auto),
            ("self-occlusion", |s| s.self_occlusion = true),
            ("cast shadow, near", |s| (s.shadow, s.near_only) = (Shadow::Auto, true)),
            ("cast shadow, far", |s| s.near_only = false),
            ("near-field light", |s| s.near_field = true),
            ("bounce on the scene", |s| s.bounce = true),
            ("indirect on the object", |s| s.indirect = true),
        ];
        for (effect, turn_on) in steps {
            turn_on(&mut settings);
            let after = frames(&settings, &effect.replace([' ', ','], "_"));
            let outcome = plan::change(&before, &after);
            before = after;
            let Some(estimate) = line(effect).change else {
                // Not tried, for what it builds on is not seen.
                assert!(line(effect).reason.contains("not tried"), "{effect}");
                continue;
            };
            assert_eq!(line(effect).on, estimate.mean >= plan::TOLERANCE, "{effect}");
            if outcome.mean >= plan::TOLERANCE || estimate.mean >= plan::TOLERANCE {
                let ratio = estimate.mean / outcome.mean;
                assert!((0.5..2.0).contains(&ratio), "{name}, {effect}: {estimate:?} {outcome:?}");
                compared.insert(effect);
            }
        }
        assert!(line("cast shadow, near").on && made.settings.shadow == Shadow::Auto);
        assert!(!line("glossy receiver").on && line("glossy receiver").reason.contains("not modelled"));
        let tight = plan::Limits { budget_s: Some(1e-6), ..plan::Limits::default() };
        let cheapest = plan::run(&input, &draft(), &tight, &Context::silent()).unwrap();
        assert!(cheapest.lines.iter().all(|l| !l.on));
        assert!(cheapest.shortfall.unwrap().contains("cannot be met"));
    }
    assert!(
        compared.contains("cast shadow, far") && compared.contains("bounce on the scene"),
        "{compared:?}"
    );
    eprintln!("compared: {compared:?}");
}

/// Goal: a budget picks the finest quality whose estimate fits and names all estimates, a quality that is asked for stays; what a
/// plan has made gives a run the same frames as a run of its own.
#[test]
fn a_budget_picks_a_quality_and_a_run_takes_over() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let composition = write(root, &[similarity(0.0, 0.0, 0.3)], true, &sunny());
    let input = plan::Input { composition: composition.clone(), cameras: None, photos: None, cache: None };
    let limits = |budget_s, any_quality| plan::Limits { budget_s, any_quality, ..plan::Limits::default() };
    let settings = Settings::default();
    let of = |limits: plan::Limits| plan::run_for(&input, &settings, &limits, &Context::silent()).unwrap();
    let (ample, made) = of(limits(Some(3600.0), true));
    let estimates: Vec<f64> = ample.qualities.iter().map(|q| q.1).collect();
    assert!(estimates.len() == 3 && estimates.is_sorted(), "{estimates:?}");
    assert_eq!(ample.settings.quality, Quality::Reference);
    assert_eq!(of(limits(Some(3600.0), false)).0.settings.quality, Quality::Balanced);
    let (tight, _) = of(limits(Some(1e-6), true));
    assert!(
        tight.settings.quality == Quality::Draft && tight.to_text().contains("quality draft, the finest")
    );
    let render = |name: &str, made| {
        let input = render_composition::Input {
            composition: composition.clone(),
            cameras: None,
            photos: None,
            cache: None,
            output: root.join(name),
        };
        let settings = Settings { quality: Quality::Draft, ..ample.settings.clone() };
        let config = render_composition::Config { settings, ..Default::default() };
        render_composition::run_planned(&input, &config, made, &Context::silent()).unwrap()
    };
    render("after", Some(made));
    render("alone", None);
    for camera in ["00000", "00001", "00002"] {
        assert_eq!(picture(root, "after", camera), picture(root, "alone", camera));
    }
}

/// Goal: where nothing is to be seen nothing is simulated, and what builds on an invisible effect is not even tried: an
/// object behind every camera, and one without material, which says what is missing.
#[test]
fn what_nobody_sees_is_not_tried() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let plan_of = |composition: PathBuf| {
        plan::run(
            &plan::Input { composition, cameras: None, photos: None, cache: None },
            &draft(),
            &plan::Limits::default(),
            &Context::silent(),
        )
        .unwrap()
    };
    let away = plan_of(write(root, &[similarity(500.0, 0.0, 0.3)], true, &sunny()));
    assert!(away.lines.iter().all(|l| !l.on), "{}", away.to_text());
    let untried = away.lines.iter().filter(|l| l.reason.starts_with("not tried")).count();
    assert_eq!(untried, 5, "{}", away.to_text());
    let plain = plan_of(write(root, &[similarity(0.0, 0.0, 0.3)], false, &sunny()));
    let reason = |effect: &str| plain.lines.iter().find(|l| l.effect == effect).unwrap().reason.clone();
    assert!(reason("scene light on the object").contains("comgs decompose"), "{}", plain.to_text());
    assert!(plain.lines.iter().any(|l| l.on && l.effect == "cast shadow, near"));
}

/// Goal: the sweep of the objects' light gives a row a value; more samples come nearer to many samples; a knob that is none is
/// refused.
#[test]
fn relighting_is_swept() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let input = tradeoff_relight::Input {
        composition: write(root, &[similarity(0.0, 0.0, 0.3)], true, &sunny()),
        truth: None,
        output: root.join("sweep"),
        command: "comgs tradeoff relight".into(),
    };
    let config = |knob: &str| tradeoff_relight::Config {
        knobs: vec![knob.into()],
        views: 1,
        reference_rays: 1024,
        repeats: 1,
        seed: 0,
    };
    let made = tradeoff_relight::run(&input, &config("samples"), &Context::silent()).unwrap();
    let of = |label: &str| made.rows.iter().find(|r| r.label == label).unwrap().values["samples_db"];
    assert!(of("256") > of("64") + 2.0 && of("64") > of("16") + 2.0, "{:?}", made.rows);
    assert_eq!(made.rows.iter().filter(|r| r.is_default).count(), 1);
    assert!(["csv", "md", "svg", "png"].iter().all(|e| root.join(format!("sweep/relight.{e}")).is_file()));
    let error = tradeoff_relight::run(&input, &config("colour"), &Context::silent()).unwrap_err().to_string();
    assert!(error.contains("highlight") && error.contains("colour"), "{error}");
}

/// Goal: the sweep of a reconstruction scores every setting, and the same command again makes nothing anew.
#[test]
fn reconstruction_is_swept_and_goes_on() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let cameras = common::ring(8, 2.0, 0.8, (48, 36), 0.8);
    common::write_capture(&root.join("ball"), &common::object_cloud(), AssetKind::Object, &cameras);
    let input = tradeoff_reconstruct::Input {
        capture: root.join("ball"),
        output: root.join("sweep"),
        assets: root.join("assets"),
        command: "comgs tradeoff reconstruct".into(),
    };
    let config = tradeoff_reconstruct::Config {
        knobs: vec!["iterations".into()],
        iterations: 24,
        width: 48,
        surfels: 300,
        repeats: 1,
        seed: 0,
    };
    let sweep = || tradeoff_reconstruct::run(&input, &config, &Context::silent()).unwrap();
    let first = sweep();
    assert!(
        first.rows.len() == 5 && first.rows.iter().all(|r| r.values["psnr_db"] > 5.0),
        "{:?}",
        first.rows
    );
    assert!(first.rows[4].values["psnr_db"] > first.rows[0].values["psnr_db"], "{:?}", first.rows);
    // The same seconds: those of the records, not of reading them; a record may round the last digit.
    for (again, first) in sweep().rows.iter().zip(&first.rows) {
        assert!((again.seconds - first.seconds).abs() < 1e-9, "{again:?} {first:?}");
        assert_eq!(again.values, first.values);
    }
}

/// Goal: frames have noise where the scene's photos have some, as much as these, and as the plan said (factor of two); clean photos call for
/// none, and without photos the plan says what is missing.
#[test]
fn frames_take_the_noise_of_photos() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    let composition = write(root, &[similarity(0.0, 0.0, 0.3)], false, &sunny());
    let photos = root.join("photos");
    common::write_capture(
        &photos,
        &common::scene_cloud(),
        AssetKind::Scene,
        &common::ring(4, 2.8, 1.6, (160, 120), 0.9),
    );
    let plan_with = |photos: Option<&Path>| {
        let input = plan::Input {
            composition: composition.clone(),
            cameras: None,
            photos: photos.map(Path::to_owned),
            cache: None,
        };
        plan::run(&input, &draft(), &plan::Limits::default(), &Context::silent()).unwrap()
    };
    let line = |plan: &plan::Plan| plan.lines.iter().find(|l| l.effect == "noise").unwrap().clone();
    assert!(line(&plan_with(None)).reason.contains("--photos"));
    let clean = line(&plan_with(Some(&photos)));
    assert!(!clean.on && clean.reason.contains("no noise"), "{clean:?}");

    let noise = comgs_compose::Noise { sigma: [0.03; 8] };
    for (k, split) in ["train", "test"].iter().enumerate() {
        for entry in std::fs::read_dir(photos.join(split).join("images")).unwrap() {
            let path = entry.unwrap().path();
            let mut photo = comgs_image::read(&path).unwrap().color;
            let name = path.file_name().unwrap().to_string_lossy().bytes().map(u64::from).sum::<u64>();
            noise.add(&mut photo, 5, name + 1000 * k as u64);
            comgs_image::write_png(&path, &photo).unwrap();
        }
    }
    let planned = plan_with(Some(&photos));
    let noisy = line(&planned);
    assert!(noisy.on && planned.settings.noise, "{noisy:?}");
    let shown = |noise: bool, name: &str| {
        let input = render_composition::Input {
            composition: composition.clone(),
            cameras: None,
            photos: Some(photos.clone()),
            cache: None,
            output: root.join(name),
        };
        let settings = Settings { noise, shadow: Shadow::None, ..draft() };
        let config = render_composition::Config { settings, ..render_composition::Config::default() };
        render_composition::run(&input, &config, &Context::silent()).unwrap();
        ["00000", "00001", "00002"].map(|c| picture(root, name, c)).to_vec()
    };
    let (before, after) = (shown(false, "without"), shown(true, "with"));
    let ratio = noisy.change.unwrap().mean / plan::change(&before, &after).mean;
    assert!((0.5..2.0).contains(&ratio), "{ratio}");
    let found = comgs_compose::Noise::estimate(&after).unwrap();
    assert!((found.at(0.5) / 0.03 - 1.0).abs() < 0.3, "{found:?}");
}
