//! The layout on disk.

use comgs_image::read;
use comgs_synth::{Recipe, SynthError, builtin, write_root};
use serde_json::Value;
use std::ops::ControlFlow;
use std::path::Path;

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap_or_else(|e| panic!("{e}: {}", path.display())))
        .unwrap()
}

/// Goal: the smallest built-in writes every part of the layout of `docs/synth.md`, readable, of the declared size, with
/// the conventions of the data: straight alpha, zero outside, coverage stored as it is, depth in front of the camera.
#[test]
fn micro_root_has_every_part() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("root");
    let recipe = builtin::recipe("micro").unwrap();
    let (mut last, mut calls) = (0.0, 0);
    let summary = write_root(&recipe, &root, &mut |p| {
        assert!(p.fraction >= last && p.fraction <= 1.0);
        last = p.fraction;
        calls += 1;
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!(last, 1.0);
    assert!(calls > 20 && summary.files > 50);

    let size = |path: &str| read::dimensions(&root.join(path)).unwrap_or_else(|e| panic!("{e}"));
    for path in ["object/blob/train/images/00007.exr", "object_relit/blob/evening/00001.png"] {
        assert_eq!(size(path), (40, 40), "{path}");
    }
    for plane in ["images", "albedo", "normal", "depth", "roughness", "metallic"] {
        assert_eq!(size(&format!("object/blob/test/{plane}/00000.exr")), (40, 40));
    }
    for path in [
        "train/images/00000.png",
        "test/images/00001.png",
        "test/images_linear/00001.exr",
        "test/depth/00001.exr",
    ] {
        assert_eq!(size(&format!("scene/courtyard/{path}")), (48, 27), "{path}");
    }
    for path in
        ["object/blob/train_envmap_gt.exr", "object_relit/envmaps/evening.exr", "scene_env/courtyard.exr"]
    {
        assert_eq!(size(path), (64, 32), "{path}");
    }
    let composition = root.join("composition/courtyard_with_blob");
    assert_eq!(read::dimensions(&composition.join("envmap_gt.exr")).unwrap(), (64, 32));
    for (folder, ending) in [
        ("images", "png"),
        ("images_linear", "exr"),
        ("mask", "png"),
        ("empty", "png"),
        ("empty_linear", "exr"),
    ] {
        let path = composition.join(folder).join(format!("00000.{ending}"));
        assert_eq!(read::dimensions(&path).unwrap(), (48, 27), "{folder}");
    }
    let transform = json(&composition.join("transform.json"));
    assert_eq!(transform["blob"]["transform"].as_array().unwrap().len(), 16);
    let cameras = json(&root.join("object/blob/train/cameras.json"));
    assert_eq!(cameras["cameras"].as_object().unwrap().len(), 8);
    assert_eq!(cameras["cameras"]["3"]["name"], "00003");

    let picture = read(&root.join("object/blob/test/images/00000.exr")).unwrap();
    let alpha = picture.alpha.unwrap();
    let albedo = read(&root.join("object/blob/test/albedo/00000.exr")).unwrap();
    assert_eq!(albedo.alpha.unwrap(), alpha);
    let normal = read(&root.join("object/blob/test/normal/00000.exr")).unwrap().color;
    let depth = read(&root.join("object/blob/test/depth/00000.exr")).unwrap().color;
    let (mut inside, mut outside) = (0, 0);
    for i in 0..1600 {
        let length = normal.data[3 * i..3 * i + 3].iter().map(|v| v * v).sum::<f32>().sqrt();
        if alpha.data[i] <= 1.0 / 255.0 {
            outside += 1;
            assert!(picture.color.data[3 * i..3 * i + 3] == [0.0; 3] && length == 0.0);
        } else {
            assert!((length - 1.0).abs() < 2e-3);
        }
        if alpha.data[i] == 1.0 {
            inside += 1;
            // The object is in the unit ball, the camera at distance 4.
            assert!((3.0..5.0).contains(&depth.data[i]), "{}", depth.data[i]);
        }
    }
    assert!(inside > 150 && outside > 600, "{inside} {outside}");

    // The mask's code values are coverage: a multiple of 1/16 at 16 samples, not its sRGB code.
    let mask = read(&composition.join("mask/00000.png")).unwrap();
    let codes: Vec<f32> = mask
        .color
        .data
        .iter()
        .step_by(mask.color.channels)
        .map(|&v| comgs_image::transfer::srgb_from_linear(v))
        .collect();
    assert!(codes.iter().any(|&c| c > 0.99) && codes.contains(&0.0));
    assert!(codes.iter().all(|c| (c * 16.0 - (c * 16.0).round()).abs() < 16.0 / 255.0));
    assert!(codes.iter().any(|&c| c > 0.05 && c < 0.95));

    // The recipe beside the data makes the same data again.
    let text = std::fs::read_to_string(root.join("recipe.json")).unwrap();
    assert_eq!(Recipe::from_json(&text).unwrap(), recipe);
    let again = write_root(&recipe, &root, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert!(matches!(again, SynthError::NotEmpty(_)), "{again}");
}

/// Goal: a stop is prompt and leaves a root without the record that marks it as whole; a folder that cannot be written is
/// an error with its path.
#[test]
fn stop_and_unwritable_folder() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("root");
    let recipe = builtin::recipe("micro").unwrap();
    let mut calls = 0;
    let error = write_root(&recipe, &root, &mut |_| {
        calls += 1;
        if calls == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
    .unwrap_err();
    assert!(matches!(error, SynthError::Stopped));
    assert!(root.join("object/blob/train/images/00000.exr").exists() && !root.join("recipe.json").exists());

    let file = folder.path().join("file");
    std::fs::write(&file, "in the way").unwrap();
    let error = write_root(&recipe, &file.join("root"), &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert!(error.to_string().contains("file"), "{error}");
}
