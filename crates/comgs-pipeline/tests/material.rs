//! Material: edits of assets, what `info` says of published PLYs, and scores against true material.

mod common;

use comgs_image::{Image, write_exr};
use comgs_pipeline::stages::material::{
    AlbedoEdit, Config, Input, PATTERN_RANGE, PRESETS, Preset, edit, run,
};
use comgs_pipeline::stages::{eval, info};
use comgs_pipeline::{Context, PipelineError};
use comgs_raster::{Planes, RasterConfig};
use comgs_scene::{Asset, AssetKind};
use comgs_surfel::activation::{logit, sigmoid};
use comgs_surfel::{MaterialColumns, SurfelCloud};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Between a value and the sigmoid of its f32 logit, which is clamped 1e-6 from 0 and 1.
const KEPT: f64 = 2e-6;

fn value(logit: f32) -> f64 {
    f64::from(sigmoid(logit))
}

/// A ball whose albedo varies, in all three channels and beyond the middle by more than a factor of two.
fn material_of(n: usize) -> MaterialColumns {
    let mut material = MaterialColumns::default();
    for i in 0..n {
        let t = i as f32 / (n - 1) as f32;
        material.albedo_logits.push([0.05 + 0.9 * t, 0.1 + 0.5 * t, 0.6 - 0.4 * t].map(logit));
        material.roughness_logits.push(logit(0.2 + 0.5 * t));
        material.metallic_logits.push(logit(0.0));
    }
    material
}

fn decomposed_cloud() -> SurfelCloud {
    let mut cloud = common::object_cloud();
    cloud.material = Some(material_of(cloud.len()));
    cloud
}

/// A decomposed asset with probes, light and cameras beside it.
fn decomposed(root: &Path) -> PathBuf {
    let path = root.join("ball.asset");
    let mut asset = Asset::new(AssetKind::Object, decomposed_cloud());
    let probes = |w: &mut dyn std::io::Write| w.write_all(&[7; 70_000]);
    let light = |w: &mut dyn std::io::Write| w.write_all(b"light");
    asset.save_with(&path, &[("probes.safetensors", &probes), ("env.exr", &light)]).unwrap();
    comgs_scene::write_cameras(path.join("cameras.json"), &common::ring(3, 2.0, 1.0, (32, 24), 0.8)).unwrap();
    path
}

fn edited(asset: &Path, output: &Path, config: &Config) -> Result<Asset, PipelineError> {
    let input = Input { asset: asset.to_owned(), output: output.to_owned() };
    let made = run(&input, config, &Context::silent())?;
    assert_eq!(made.asset, output);
    Ok(Asset::load(output).unwrap())
}

fn all_files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().path())
        .map(|p| (p.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&p).unwrap()))
        .collect();
    files.sort();
    files
}

/// Goal: one value changes one column; geometry, colours, probes, light and cameras come along bit for bit, the input is
/// not touched, and the same edit is not made twice.
#[test]
fn an_edit_changes_what_it_names() {
    let root = tempfile::tempdir().unwrap();
    let asset = decomposed(root.path());
    let before = all_files(&asset);
    let old = Asset::load(&asset).unwrap();
    let output = root.path().join("rough.asset");
    let config = Config { roughness: Some(0.85), ..Config::default() };
    let new = edited(&asset, &output, &config).unwrap();
    let (from, to) = (old.surfels.material.as_ref().unwrap(), new.surfels.material.as_ref().unwrap());
    assert_eq!((&to.albedo_logits, &to.metallic_logits), (&from.albedo_logits, &from.metallic_logits));
    assert!(to.roughness_logits.iter().all(|x| (value(*x) - 0.85).abs() < KEPT));
    let without = |asset: &Asset| SurfelCloud { material: None, ..asset.surfels.clone() };
    assert_eq!(without(&new), without(&old));
    for name in ["probes.safetensors", "env.exr"] {
        assert_eq!(new.record.files[name], old.record.files[name], "{name}");
    }
    let cameras = |folder: &Path| comgs_scene::read_cameras(folder).unwrap();
    assert_eq!(cameras(&output), cameras(&asset));
    assert_eq!(all_files(&asset), before, "the input is as it was");

    let input = Input { asset: asset.clone(), output: output.clone() };
    assert!(run(&input, &config, &Context::silent()).unwrap().reused);
    let record = run(&input, &config, &Context::silent()).unwrap().record;
    assert_eq!(record.stage, "material");
    assert!((record.results["after"]["roughness"].as_f64().unwrap() - 0.85).abs() < KEPT);
    assert!(record.outputs.iter().any(|o| o.path == "probes.safetensors"));
    let other = Config { roughness: Some(0.2), ..config };
    assert!(!run(&input, &other, &Context::silent()).unwrap().reused);
    assert_eq!(Asset::load(&output).unwrap().record.files["env.exr"], old.record.files["env.exr"]);
}

/// Goal: three numbers set, one number scales with a clamp at 1 that is told; a preset comes first and single values
/// replace its own.
#[test]
fn albedo_is_set_or_scaled() {
    let root = tempfile::tempdir().unwrap();
    let asset = decomposed(root.path());
    let old = Asset::load(&asset).unwrap().surfels.material.unwrap();
    let output = root.path().join("new.asset");
    let with = |albedo: &str| Config { albedo: Some(albedo.parse().unwrap()), ..Config::default() };
    let set = edited(&asset, &output, &with("0.9, 0.2,0")).unwrap().surfels.material.unwrap();
    for logits in &set.albedo_logits {
        for (x, expected) in logits.iter().zip([0.9, 0.2, 0.0]) {
            assert!((value(*x) - expected).abs() < KEPT);
        }
    }
    assert_eq!(set.roughness_logits, old.roughness_logits);

    let scaled = edited(&asset, &output, &with("1.25")).unwrap().surfels.material.unwrap();
    for (new, old) in scaled.albedo_logits.iter().flatten().zip(old.albedo_logits.iter().flatten()) {
        assert!((value(*new) - (1.25 * value(*old)).min(1.0)).abs() < KEPT);
    }
    let input = Input { asset: asset.clone(), output: output.clone() };
    let warnings = run(&input, &with("1.25"), &Context::silent()).unwrap().record.warnings;
    // 0.05 + 0.9 t is above 0.8 for the last sixth.
    assert!(warnings.iter().any(|w| w.contains("16.7 %")), "{warnings:?}");

    let mixed = Config { preset: Some(Preset::Copper), roughness: Some(0.05), ..with("0.5") };
    let mixed = edited(&asset, &output, &mixed).unwrap().surfels.material.unwrap();
    for (x, expected) in mixed.albedo_logits[3].iter().zip([0.5, 0.325, 0.265]) {
        assert!((value(*x) - expected).abs() < KEPT);
    }
    assert!((value(mixed.roughness_logits[3]) - 0.05).abs() < KEPT);
    assert!((value(mixed.metallic_logits[3]) - 1.0).abs() < KEPT);
}

/// Goal: every preset gives its stated values; stone alone keeps the object's pattern, as its stated multiple of the
/// median luminance; the table names each preset once and holds plausible numbers.
#[test]
fn presets_are_what_the_table_says() {
    let old = material_of(301);
    let luminance = |logits: &[f32; 3]| {
        let [r, g, b] = logits.map(value);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    // Luminance grows with the index here: the median is the middle one.
    let middle = luminance(&old.albedo_logits[150]);
    let mut names = Vec::new();
    for (preset, values) in PRESETS {
        names.push(values.name);
        assert_eq!(preset.values(), values);
        assert_eq!(serde_json::to_value(preset).unwrap(), values.name);
        assert!(
            values
                .albedo
                .iter()
                .chain([&values.roughness, &values.metallic])
                .all(|v| (0.0..=1.0).contains(v))
        );
        assert!(!values.source.is_empty());
        let (new, clamped) = edit(&old, &Config { preset: Some(preset), ..Config::default() });
        assert_eq!(clamped, 0);
        let mut ratios = Vec::new();
        for (i, logits) in new.albedo_logits.iter().enumerate() {
            let ratio = if values.pattern {
                (luminance(&old.albedo_logits[i]) / middle).clamp(PATTERN_RANGE[0], PATTERN_RANGE[1])
            } else {
                1.0
            };
            ratios.push(ratio);
            for (x, v) in logits.iter().zip(values.albedo) {
                assert!((value(*x) - ratio * v).abs() < KEPT, "{} {i}", values.name);
            }
            assert!((value(new.roughness_logits[i]) - values.roughness).abs() < KEPT);
            assert!((value(new.metallic_logits[i]) - values.metallic).abs() < KEPT);
        }
        let distinct = ratios.windows(2).filter(|w| w[0] != w[1]).count();
        assert_eq!(distinct > 100, values.pattern, "{}", values.name);
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), PRESETS.len());
    // A black object has no pattern to keep.
    let black = MaterialColumns { albedo_logits: vec![[f32::NEG_INFINITY; 3]; 4], ..material_of(4) };
    let (stone, _) = edit(&black, &Config { preset: Some(Preset::Stone), ..Config::default() });
    assert!((value(stone.albedo_logits[0][0]) - 0.3).abs() < KEPT);
}

/// Goal: what cannot be done is refused with a way out, before anything is written: no material, the input as output
/// however it is spelled, nothing to edit, values out of range, a damaged asset (hard case 36).
#[test]
fn refusals_write_nothing() {
    let root = tempfile::tempdir().unwrap();
    let asset = decomposed(root.path());
    let plain = root.path().join("plain.asset");
    Asset::new(AssetKind::Object, common::object_cloud()).save(&plain).unwrap();
    let output = root.path().join("new.asset");
    let rough = Config { roughness: Some(0.5), ..Config::default() };
    let refuse = |asset: &Path, output: &Path, config: &Config| {
        edited(asset, output, config).map(|_| ()).unwrap_err().to_string()
    };
    let text = refuse(&plain, &output, &rough);
    assert!(text.contains("comgs decompose") && text.contains("plain.asset"), "{text}");

    let before = all_files(&asset);
    let spellings =
        [asset.clone(), root.path().join("./ball.asset/."), root.path().join("plain.asset/../ball.asset")];
    for own in &spellings {
        for named in [&asset, &asset.join("asset.json"), &asset.join("surfels.ply")] {
            let text = refuse(named, own, &rough);
            assert!(text.contains("other than the input's"), "{}: {text}", own.display());
        }
    }
    assert_eq!(all_files(&asset), before);

    assert!(refuse(&asset, &output, &Config::default()).contains("--preset"));
    for (bad, flag) in [
        (Config { roughness: Some(1.01), ..Config::default() }, "--roughness"),
        (Config { metallic: Some(f64::NAN), ..Config::default() }, "--metallic"),
        (Config { albedo: Some(AlbedoEdit::Scale(-1.0)), ..Config::default() }, "--albedo"),
        (Config { albedo: Some(AlbedoEdit::Set([0.0, 2.0, 0.0])), ..Config::default() }, "--albedo"),
    ] {
        let text = refuse(&asset, &output, &bad);
        assert!(text.starts_with(flag), "{text}");
    }
    for bad in ["", "a", "1,2", "1,2,3", "0.1,0.2,0.3,0.4", "-1", "NaN", "inf"] {
        assert!(bad.parse::<AlbedoEdit>().is_err(), "{bad}");
    }
    std::fs::write(asset.join("env.exr"), b"other").unwrap();
    assert!(refuse(&asset, &output, &rough).contains("env.exr"));
    assert!(!output.exists(), "nothing was written");
    let below_a_file = asset.join("env.exr").join("new.asset");
    assert!(refuse(&plain, &below_a_file, &rough).contains("env.exr"));
}

/// A published PLY with material columns, three scales when asked for; raw numbers 0 but for the red of the first.
fn published(path: &Path, scales: usize, material: &str) {
    let mut names: Vec<String> =
        "x y z f_dc_0 f_dc_1 f_dc_2 opacity rot_0 rot_1 rot_2 rot_3".split(' ').map(String::from).collect();
    names.extend((0..scales).map(|i| format!("scale_{i}")));
    names.extend(material.split(' ').map(String::from));
    let mut file = std::fs::File::create(path).unwrap();
    writeln!(file, "ply\nformat ascii 1.0\nelement vertex 2").unwrap();
    for name in &names {
        writeln!(file, "property float {name}").unwrap();
    }
    writeln!(file, "end_header").unwrap();
    for row in 0..2 {
        let value = |name: &String| if name.ends_with("r_0") && row == 0 { 30.0 } else { 0.0 };
        let line: Vec<String> = names.iter().map(|n| value(n).to_string()).collect();
        writeln!(file, "{}", line.join(" ")).unwrap();
    }
}

/// Goal: `info` says whose file it is, what its material columns are, how they were activated, what was assumed, and the
/// ranges that come out; a published PLY becomes an asset whose material can be edited; and material of nobody's dialect
/// is refused while the asset that stood there stays (the "bad input").
#[test]
fn published_material_is_told_and_edited() {
    let root = tempfile::tempdir().unwrap();
    let ply = root.path().join("published.ply");
    let text = |scales: usize, material: &str| {
        published(&ply, scales, material);
        info::run(&ply).unwrap_or_else(|e| panic!("{material}: {e}")).to_text()
    };
    let base = "base_color_0 base_color_1 base_color_2 roughness";
    for (scales, material, expected) in [
        (
            3,
            format!("{base} incidents_dc_0 visibility_dc_0"),
            vec![
                "Gaussians (R3DG)",
                "0.9·sigmoid(x) + 0.09",
                "0.415 to 0.800",
                "gaussians",
                "2 columns of incident light",
                "metallic: taken as 0",
            ],
        ),
        (3, base.to_owned(), vec!["Gaussians (R3DG)", "assumed", "no incidents_"]),
        (
            2,
            base.to_owned(),
            vec![
                "surfels (IRGS)",
                "0.77·sigmoid(x) + 0.03, roughness = sigmoid(x), no metallic",
                "0.500 to 0.500",
            ],
        ),
        (
            3,
            "albedo_0 albedo_1 albedo_2 roughness metallic".to_owned(),
            vec!["Gaussians (GS-IR)", "albedo_0..2 = sigmoid(x)", "degree 0"],
        ),
        (
            2,
            "albedo_0 albedo_1 albedo_2 metallic roughness".to_owned(),
            vec!["surfels (ComGS)", "metallic = sigmoid(x)"],
        ),
    ] {
        let text = text(scales, &material);
        for words in expected {
            assert!(text.contains(words), "{material}: {words} is not in\n{text}");
        }
    }
    let points = root.path().join("points.ply");
    std::fs::write(&points, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n").unwrap();
    assert!(
        info::run(&points).unwrap().to_text().contains("1 with x y z"),
        "points are no surfels, and no error"
    );

    published(&ply, 3, base);
    let output = root.path().join("r3dg.asset");
    let config = Config { albedo: Some(AlbedoEdit::Scale(0.5)), ..Config::default() };
    let asset = edited(&ply, &output, &config).unwrap();
    let material = asset.surfels.material.unwrap();
    assert!((value(material.albedo_logits[0][0]) - 0.4).abs() < KEPT, "half of 0.77 + 0.03");
    assert!((value(material.roughness_logits[0]) - 0.54).abs() < KEPT, "0.9 · ½ + 0.09");

    let before = all_files(&output);
    published(&ply, 3, &format!("{base} albedo_0"));
    for error in [edited(&ply, &output, &config).map(|_| ()), info::run(&ply).map(|_| ())] {
        let text = error.unwrap_err().to_string();
        assert!(
            text.contains("albedo_0") && text.contains("IRGS (") && text.ends_with("published.ply"),
            "{text}"
        );
    }
    assert_eq!(all_files(&output), before, "nothing was overwritten");
}

/// A capture of the ball with the material planes of `cloud` beside the test images, straight as renderers write them.
fn capture_with_truth(root: &Path, cloud: &SurfelCloud) {
    let cameras = common::ring(4, 2.0, 1.0, (48, 36), 0.8);
    common::write_capture(root, cloud, AssetKind::Object, &cameras);
    for camera in &cameras[..2] {
        let frame = comgs_raster::render(cloud, camera, Planes::ALL, &RasterConfig::default());
        let mut straight = frame.material.unwrap();
        for (pixel, w) in straight.data.chunks_exact_mut(5).zip(&frame.weight.data) {
            pixel.iter_mut().for_each(|v| *v = if *w > 1.0 / 255.0 { *v / w } else { 0.0 });
        }
        let write = |folder: &str, image: Image| {
            write_exr(&root.join("test").join(folder).join(format!("{}.exr", camera.name)), &image).unwrap();
        };
        write("albedo", straight.select(&[0, 1, 2]));
        write("roughness", straight.select(&[3]));
        write("metallic", straight.select(&[4]));
    }
}

/// Goal: an asset whose albedo is off by known factors scores as its own after alignment, with the inverse factors told, and
/// worse before; roughness off by 0.1 is 0.1. Without material there are no such columns.
#[test]
fn eval_scores_material() {
    let root = tempfile::tempdir().unwrap();
    let mut truth = decomposed_cloud();
    truth.material.as_mut().unwrap().roughness_logits.fill(logit(0.5));
    let capture = root.path().join("capture");
    capture_with_truth(&capture, &truth);

    let mut estimate = truth.clone();
    let material = estimate.material.as_mut().unwrap();
    for logits in &mut material.albedo_logits {
        *logits = [logits[0], logit(0.8 * sigmoid(logits[1])), logit(0.5 * sigmoid(logits[2]))];
    }
    material.roughness_logits.fill(logit(0.6));
    let score = |name: &str, cloud: SurfelCloud| {
        let path = root.path().join(name);
        Asset::new(AssetKind::Object, cloud).save(&path).unwrap();
        let input = eval::Input { subject: path, against: capture.clone(), relit: None, json: None };
        eval::run(&input, &Context::silent()).unwrap()
    };
    let scores = score("estimate.asset", estimate);
    let table = &scores.section("test").unwrap().table;
    let mean = |key: &str| table.mean(key).unwrap_or_else(|| panic!("{key}: {}", scores.to_text()));
    // Truth and alpha are stored as halves: relative errors of 5e-4, and more where alpha is small.
    let (aligned, unaligned) = (mean("albedo.aligned_psnr_db"), mean("albedo.psnr_db"));
    assert!(aligned > 60.0, "{}", scores.to_text());
    assert!((15.0..30.0).contains(&unaligned), "{}", scores.to_text());
    assert!((mean("roughness.mae") - 0.1).abs() < 1e-3, "{}", scores.to_text());
    assert!(mean("metallic.mae") < 1e-3);
    let remark = scores.remarks.iter().find(|r| r.contains("aligned albedo")).unwrap();
    assert!(remark.contains("1.000 1.250 2.000") && remark.contains("2 views"), "{remark}");
    assert!(remark.contains("inside the mask"), "{remark}");

    let own = score("own.asset", truth.clone());
    let own = &own.section("test").unwrap().table;
    assert!((own.mean("albedo.psnr_db").unwrap() - own.mean("albedo.aligned_psnr_db").unwrap()).abs() < 5.0);
    truth.material = None;
    let plain = score("plain.asset", truth);
    let keys: Vec<&str> = plain.section("test").unwrap().table.columns.iter().map(|c| c.key).collect();
    assert!(!keys.iter().any(|k| k.contains("albedo") || k.contains("roughness")), "{keys:?}");
    assert!(plain.remarks.iter().all(|r| !r.contains("albedo")));
}
