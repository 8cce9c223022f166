//! Bundles that are damaged, mismatched or from elsewhere are refused with the reason.

use comgs_panorama::{Bundle, ModelError, Runtime};
use std::path::Path;

fn read(folder: &Path) -> Result<Bundle, ModelError> {
    let path = folder.join("model.json");
    Bundle::from_parts(&std::fs::read(&path).unwrap(), &path, &|file| std::fs::read(folder.join(file)))
}

/// The shipped bundle in a folder, its manifest changed.
fn bundle(edit: impl Fn(&mut serde_json::Value)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/panorama");
    let text = std::fs::read(shipped.join("model.json")).unwrap();
    let mut manifest: serde_json::Value = serde_json::from_slice(&text).unwrap();
    edit(&mut manifest);
    std::fs::write(folder.path().join("model.json"), manifest.to_string()).unwrap();
    std::fs::copy(shipped.join("completer.onnx"), folder.path().join("completer.onnx")).unwrap();
    folder
}

fn message(edit: impl Fn(&mut serde_json::Value)) -> String {
    let folder = bundle(edit);
    match read(folder.path()).and_then(|b| b.load("denoiser", &Runtime::Embedded, 1).map(|_| ())) {
        Ok(()) => "fine".into(),
        Err(error) => error.to_string(),
    }
}

/// Goal: the shipped bundle is what its manifest says, small enough, and reads from a folder too.
#[test]
fn the_shipped_bundle_is_sound() {
    assert_eq!(message(|_| ()), "fine");
    assert!(Bundle::shipped().unwrap().bytes() <= 20_000_000);
}

/// Goal: every problem of a manifest at once, each with its field.
#[test]
fn problems_are_listed_together() {
    let text = message(|m| {
        m["version"] = 2.into();
        m["resolution"] = serde_json::json!([128, 128]);
        m["space"]["codes"]["fuse"] = serde_json::json!([16.0, 8.0]);
        m["schedule"]["timesteps"] = 0.into();
        m["graphs"]["denoiser"]["inputs"].as_object_mut().unwrap().remove("time");
    });
    for part in
        ["version", "resolution", "codes.fuse", "schedule.timesteps", "graphs.denoiser.inputs.time: missing"]
    {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
    assert!(message(|m| m["surprise"] = 1.into()).contains("surprise"));
    assert!(
        message(|m| m["graphs"]["denoiser"]["file"] = "../../etc/passwd".into()).contains("in the bundle")
    );
}

/// Goal: names and shapes that the graph does not have are found before it is run.
#[test]
fn a_graph_that_differs_from_its_manifest() {
    let text = message(|m| m["graphs"]["denoiser"]["inputs"]["time"]["name"] = "t".into());
    assert!(text.contains("inputs.time") && text.contains("\"t\"") && text.contains("noisy"), "{text}");
    let text = message(|m| {
        m["resolution"] = serde_json::json!([64, 32]);
        for (side, role, channels) in
            [("inputs", "sample", 6), ("inputs", "condition", 14), ("outputs", "prediction", 6)]
        {
            m["graphs"]["denoiser"][side][role]["shape"] = serde_json::json!([1, channels, 32, 64]);
        }
    });
    assert!(text.contains("the graph has [1, 6, 64, 128]"), "{text}");
}

/// Goal: a truncated, changed or missing graph is refused by its checksum or its absence, before any runtime sees it.
#[test]
fn damaged_files() {
    let folder = bundle(|_| ());
    let path = folder.path().join("completer.onnx");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(matches!(read(folder.path()), Err(ModelError::Checksum { .. })));
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(read(folder.path()), Err(ModelError::Read { .. })));
}
