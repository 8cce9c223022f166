//! The invariants of `docs/architecture.md` that a machine can check.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn packages() -> Vec<Value> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--format-version", "1", "--offline"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    metadata["packages"].as_array().unwrap().clone()
}

/// Source files below a folder of the repository.
fn sources(folder: &Path, extension: &str, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        let name = entry.file_name();
        if path.is_dir() {
            if name != "target" && !name.to_string_lossy().starts_with('.') {
                sources(&path, extension, out);
            }
        } else if path.extension().is_some_and(|e| e == extension) {
            out.push(path);
        }
    }
}

/// Goal: dependencies point to a strictly lower layer, and every manifest states its layer.
#[test]
fn dependencies_point_downward() {
    let packages = packages();
    let layer: BTreeMap<String, i64> = packages
        .iter()
        .map(|p| {
            let name = p["name"].as_str().unwrap().to_owned();
            let layer = p["metadata"]["layer"].as_i64().unwrap_or_else(|| panic!("{name} states no layer"));
            (name, layer)
        })
        .collect();
    assert!(layer.len() > 10);
    for p in &packages {
        let name = p["name"].as_str().unwrap();
        for d in p["dependencies"].as_array().unwrap() {
            let dependency = d["name"].as_str().unwrap();
            if let (true, Some(below)) = (d["kind"].is_null(), layer.get(dependency)) {
                assert!(
                    *below < layer[name],
                    "{name} (layer {}) depends on {dependency} (layer {below})",
                    layer[name]
                );
            }
        }
        assert!(p["description"].as_str().is_some_and(|d| d.len() > 20), "{name} has no description");
        assert_eq!(p["license"].as_str(), Some("MIT OR Apache-2.0"), "{name}");
    }
}

/// Goal: heavy dependencies stay in their leaves, command-line crates in the command line.
#[test]
fn heavy_dependencies_sit_in_leaves() {
    let allowed = [
        ("obvhs", &["comgs-trace", "comgs-synth"][..]),
        ("clap", &["comgs-cli"]),
        ("anyhow", &["comgs-cli"]),
        ("indicatif", &["comgs-cli"]),
        ("ctrlc", &["comgs-cli"]),
    ];
    for p in packages() {
        let name = p["name"].as_str().unwrap();
        for d in p["dependencies"].as_array().unwrap().iter().filter(|d| d["kind"].is_null()) {
            let dependency = d["name"].as_str().unwrap();
            if let Some((_, crates)) = allowed.iter().find(|(n, _)| *n == dependency) {
                assert!(crates.contains(&name), "{name} depends on {dependency}");
            }
        }
    }
}

/// Goal: kernels know neither the disk nor the command line.
#[test]
fn kernels_do_not_touch_files() {
    let kernels = [
        "comgs-geom",
        "comgs-optim",
        "comgs-light",
        "comgs-raster",
        "comgs-trace",
        "comgs-panorama",
        "comgs-inverse",
    ];
    for kernel in kernels {
        let mut files = Vec::new();
        sources(&root().join("crates").join(kernel).join("src"), "rs", &mut files);
        assert!(!files.is_empty(), "{kernel}");
        for file in files {
            let text = std::fs::read_to_string(&file).unwrap();
            for forbidden in ["std::fs", "File::", "std::env", "println!", "eprintln!"] {
                assert!(!text.contains(forbidden), "{} uses {forbidden}", file.display());
            }
        }
    }
}

/// Goal: the witnesses share no kernel with what they judge.
#[test]
fn witnesses_share_no_kernel() {
    for p in packages() {
        let name = p["name"].as_str().unwrap();
        if name != "comgs-synth" && name != "comgs-metrics" {
            continue;
        }
        for d in p["dependencies"].as_array().unwrap().iter().filter(|d| d["kind"].is_null()) {
            let dependency = d["name"].as_str().unwrap();
            let shared = [
                "comgs-raster",
                "comgs-trace",
                "comgs-inverse",
                "comgs-compose",
                "comgs-light",
                "comgs-optim",
            ];
            assert!(!shared.contains(&dependency), "{name} depends on {dependency}");
        }
    }
}

/// Goal: no unsafe code, no unfinished code, no path of a developer's machine.
#[test]
fn sources_are_finished_and_safe() {
    let mut files = Vec::new();
    for folder in ["crates", "tests"] {
        sources(&root().join(folder), "rs", &mut files);
    }
    // Assembled, so that this file does not contain them.
    let forbidden = [
        ["todo", "!("].concat(),
        ["unimplemented", "!("].concat(),
        ["FIX", "ME"].concat(),
        ["unsafe", " {"].concat(),
        ["/ro", "ot/"].concat(),
        ["/wo", "rk/"].concat(),
    ];
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        for f in &forbidden {
            assert!(!text.contains(f.as_str()), "{} contains {f}", file.display());
        }
    }
}

/// Goal: every hard case of the list up to the scope of the work so far has a test that names it.
#[test]
fn hard_cases_are_named_in_tests() {
    let mut files = Vec::new();
    sources(&root().join("crates"), "rs", &mut files);
    let text: String =
        files.iter().map(|f| std::fs::read_to_string(f).unwrap()).collect::<String>().to_lowercase();
    let covered = (1..=19).chain(24..=26).chain(30..=36);
    for case in covered {
        // "hard case 1" must not be found in "hard case 11".
        let named = ["hard case ", "hard cases "].iter().any(|phrase| {
            let wanted = format!("{phrase}{case}");
            text.match_indices(&wanted)
                .any(|(at, _)| !text[at + wanted.len()..].starts_with(|c: char| c.is_ascii_digit()))
        });
        assert!(named, "no test names hard case {case}");
    }
}
