//! Guidance bundles: what they hold, what torch says of the same weights, and what is pulled. The bundle is a tiny model of random
//! weights that is built as Stable Diffusion is, personalised and exported by `scripts/insert/test_personalise.py`.

use comgs_geom::Rng;
use comgs_image::Image;
use comgs_insert::composite::Crop;
use comgs_insert::guidance::{Guidance, View};
use comgs_insert::lds::{Distillation, GuidanceBundle, GuidanceError};
use comgs_insert::light::LightMap;
use comgs_insert::transport::{Foreground, Matrix};
use comgs_panorama::onnx::{Runtime, Tensor};
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/lds")
}

fn read(file: &str) -> Vec<u8> {
    std::fs::read(folder().join(file)).unwrap()
}

fn bundle_of(manifest: &[u8]) -> Result<GuidanceBundle, GuidanceError> {
    GuidanceBundle::from_parts(manifest, &|file| std::fs::read(folder().join(file)))
}

fn bundle() -> GuidanceBundle {
    bundle_of(&read("model.json")).unwrap()
}

fn changed(change: impl Fn(&mut serde_json::Value)) -> String {
    let mut manifest: serde_json::Value = serde_json::from_slice(&read("model.json")).unwrap();
    change(&mut manifest);
    let runtime = Runtime::Embedded;
    match bundle_of(&serde_json::to_vec(&manifest).unwrap()) {
        Err(e) => e.to_string(),
        Ok(bundle) => {
            let (photo, foreground) = scene();
            match Distillation::new(&bundle, &runtime, None, &photo, &foreground, 0) {
                Err(e) => e.to_string(),
                Ok(_) => panic!("nothing is wrong"),
            }
        }
    }
}

/// Goal: the encoder, its vector–Jacobian product, the base and the personalised denoiser give what torch gives for the same weights, to 1e-5 of the
/// largest entry, on the embedded runtime.
#[test]
fn graphs_agree_with_torch() {
    let expected: serde_json::Value = serde_json::from_slice(&read("expected.json")).unwrap();
    let list = |name: &str| -> Vec<f32> {
        expected[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32).collect()
    };
    let bundle = bundle();
    let picture = || Tensor::f32(&[1, 3, 32, 32], list("picture"));
    let latent = |name: &str| Tensor::f32(&[1, 4, 8, 8], list(name));
    let prompt = bundle.context("prompt").unwrap();
    let noisy = || {
        vec![
            ("sample", latent("sample")),
            ("time", Tensor::f32(&[1], list("time"))),
            ("told", prompt.clone()),
        ]
    };
    let cases: [(&str, Vec<(&str, Tensor)>, &str, &str); 4] = [
        ("encoder", vec![("picture", picture())], "latent", "latent"),
        (
            "encoder_vjp",
            vec![("picture", picture()), ("grad_latent", latent("grad_latent"))],
            "grad_picture",
            "grad_picture",
        ),
        ("base", noisy(), "noise", "base"),
        ("personalised", noisy(), "noise", "personalised"),
    ];
    for (graph, inputs, output, truth) in cases {
        let out = bundle.load(graph, &Runtime::Embedded).unwrap().run(&inputs, &[output]).unwrap();
        let (ours, truth) = (out[0].to_f32(), list(truth));
        assert_eq!(ours.len(), truth.len());
        let largest = truth.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let worst = ours.iter().zip(&truth).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / largest;
        println!("{graph}: {worst:.1e} of the largest entry");
        assert!(largest > 0.01 && worst < 1e-5, "{graph}: {worst}");
    }
}

fn scene() -> (Image, Foreground) {
    let mut rng = Rng::new(8);
    let photo = Image::from_data(48, 40, 3, (0..48 * 40 * 3).map(|_| rng.range(0.1, 0.9)).collect());
    let none = |channels| Image::zeros(48, 40, channels);
    let (coverage, albedo, normal, depth) = (none(1), none(3), none(3), none(1));
    (photo, Foreground { pixels: vec![], coverage, albedo, normal, depth, matrix: Matrix::default() })
}

/// Goal: the gradient reaches the composite inside the crop and nowhere else, is the same for the same seed and another for
/// another, and vanishes where both terms are the same.
#[test]
fn a_latent_model_pulls() {
    let (photo, foreground) = scene();
    let map = LightMap::zeros(4);
    let crop = Crop { x0: 5, y0: 3, x1: 40, y1: 38 };
    let view = View { iteration: 3, progress: 0.2, composite: Some(&photo), crop, light: [&map, &map] };
    let pull = |bundle: &GuidanceBundle, prompt: Option<&str>, seed: u64| {
        let runtime = Runtime::Embedded;
        let mut lds = Distillation::new(bundle, &runtime, prompt, &photo, &foreground, seed).unwrap();
        assert!(lds.looks_at_composite() && lds.name() == "lds");
        let pull = lds.pull(&view).unwrap();
        (pull.loss, pull.composite.unwrap())
    };
    let bundle = bundle();
    let (loss, grad) = pull(&bundle, None, 1);
    assert!(loss > 0.0);
    for (i, g) in grad.data.iter().enumerate() {
        assert!(g.is_finite() && (*g == 0.0 || crop.contains(i / 3, 48)));
    }
    assert!(grad.data.iter().filter(|g| **g != 0.0).count() > 3000);
    assert_eq!(pull(&bundle, Some("a photo of a car in a scene in the style of sks rendering"), 1).1, grad);
    assert!(pull(&bundle, Some("a photo of a red car"), 1).1 != grad);
    assert!(pull(&bundle, None, 2).1 != grad);
    let mut same: serde_json::Value = serde_json::from_slice(&read("model.json")).unwrap();
    same["personalised"] = same["base"].clone();
    let same = bundle_of(&serde_json::to_vec(&same).unwrap()).unwrap();
    let (loss, grad) = pull(&same, None, 1);
    assert!(loss == 0.0 && grad.data.iter().all(|g| *g == 0.0));
}

/// Goal: bundles that are not what they say are refused by what is wrong with them, and a prompt that was not exported by
/// those that were.
#[test]
fn broken_bundles() {
    let has = |text: String, words: &[&str]| {
        for word in words {
            assert!(text.contains(word), "{text:?} lacks {word:?}");
        }
    };
    has(changed(|m| m["graphs"]["encoder"]["blake3"] = "00".into()), &["encoder.onnx", "checksum"]);
    has(changed(|m| m["version"] = 7.into()), &["version: this program reads 1, got 7"]);
    has(changed(|m| m["format"] = "x".into()), &["comgs-guidance"]);
    let gone = |m: &mut serde_json::Value| {
        m["graphs"].as_object_mut().unwrap().remove("encoder_vjp");
    };
    has(changed(gone), &["graphs.encoder_vjp: missing"]);
    has(changed(|m| m["base"]["sample"]["shape"] = vec![1, 4, 9, 9].into()), &["base.sample.shape"]);
    has(changed(|m| m["base"]["time"]["name"] = "when".into()), &["base.time", "\"when\"", "sample"]);
    has(changed(|m| m["resolution"] = vec![24, 24].into()), &["encoder"]);
    has(changed(|m| m["contexts"]["empty"]["values"] = vec![0.0].into()), &["contexts.empty", "320"]);
    has(changed(|m| m["graphs"]["base"]["file"] = "../base.onnx".into()), &["a file in the bundle"]);
    has(changed(|m| m["graphs"]["base"]["file"] = "gone.onnx".into()), &["gone.onnx", "cannot be read"]);
    let (photo, foreground) = scene();
    let text = Distillation::new(&bundle(), &Runtime::Embedded, Some("a red car"), &photo, &foreground, 0)
        .err()
        .unwrap()
        .to_string();
    has(text, &["a red car", "in the style of sks rendering"]);
}
