//! The product in one test: synthetic captures with exact truth are reconstructed, composed and scored. The bounds are a
//! little under what was measured, so that a loss of quality anywhere on the way fails.

use comgs_inverse::{Kind, Quality};
use comgs_pipeline::Context;
use comgs_pipeline::stages::{compose, eval, reconstruct, synth};
use std::path::{Path, PathBuf};

fn asset(capture: &Path, output: PathBuf, kind: Kind, max_surfels: usize) -> PathBuf {
    let config = reconstruct::Config {
        kind: Some(kind),
        quality: Quality::Draft,
        max_surfels: Some(max_surfels),
        ..reconstruct::Config::default()
    };
    reconstruct::run(&reconstruct::Input { capture: capture.to_owned(), output }, &config, &Context::silent())
        .unwrap()
        .asset
}

fn psnr(subject: &Path, against: &Path, section: &str, key: &str) -> f64 {
    let input =
        eval::Input { subject: subject.to_owned(), against: against.to_owned(), relit: None, json: None };
    let evaluation = eval::run(&input, &Context::silent()).unwrap();
    evaluation.section(section).unwrap().table.mean(key).unwrap()
}

/// Goal: object and scene are predicted from held-out views, and the composed frames are nearer to the path-traced truth than
/// the empty scene is, in the object's region and in its shadow.
#[test]
fn synthetic_captures_to_composed_frames() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("root");
    let input = synth::Input { recipe: "tiny".into(), output: root.clone() };
    synth::run(&input, &synth::Overrides::default(), &Context::silent()).unwrap();
    let object_capture = root.join("object/blob");
    let scene_capture = root.join("scene/courtyard");
    let composition = root.join("composition/courtyard_with_blob");

    let object = asset(&object_capture, folder.path().join("blob.asset"), Kind::Object, 5_000);
    let scene = asset(&scene_capture, folder.path().join("courtyard.asset"), Kind::Scene, 12_000);
    let object_db = psnr(&object, &object_capture, "test", "psnr_db");
    let scene_db = psnr(&scene, &scene_capture, "test", "psnr_db");

    let input = compose::Input {
        scene,
        objects: vec![object],
        transform: composition.join("transform.json"),
        cameras: composition.join("cameras.json"),
        // The true light: what a sweep cannot see (the sun) is not this test's matter.
        light: Some(composition.join("envmap_gt.exr")),
        truth: None,
        output: folder.path().join("composed"),
    };
    compose::run(&input, &compose::Config::default(), &Context::silent()).unwrap();
    let score = |section: &str, key: &str| psnr(&input.output, &composition, section, key);
    let figures = [
        ("object", object_db, 26.0),
        ("scene", scene_db, 19.0),
        (
            "object region over empty scene",
            score("composed", "object.psnr_db") - score("empty", "object.psnr_db"),
            1.0,
        ),
        (
            "shadow region over empty scene",
            score("composed", "shadow.psnr_db") - score("empty", "shadow.psnr_db"),
            0.5,
        ),
    ];
    println!("{figures:?}");
    for (name, got, bound) in figures {
        assert!(got > bound, "{name}: {got:.2} dB, expected more than {bound} dB; all: {figures:?}");
    }
}
