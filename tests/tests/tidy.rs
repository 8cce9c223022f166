//! The invariants of `docs/architecture.md` that a machine can check.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
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
        ("rten", &["comgs-panorama"]),
        ("ort", &["comgs-panorama"]),
        ("gltf", &["comgs-scene"]),
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
        "comgs-probe",
        "comgs-metrics",
        "comgs-inverse",
        "comgs-compose",
        "comgs-insert",
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
                "comgs-insert",
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

/// Goal: every manifest takes the workspace's lints, so that unsafe code and missing documentation are refused everywhere.
#[test]
fn every_manifest_has_the_lints() {
    let mut manifests = vec![root().join("tests/Cargo.toml")];
    for entry in std::fs::read_dir(root().join("crates")).unwrap().flatten() {
        manifests.extend(Some(entry.path().join("Cargo.toml")).filter(|p| p.is_file()));
    }
    assert!(manifests.len() > 10);
    for manifest in manifests {
        let text = std::fs::read_to_string(&manifest).unwrap();
        assert!(text.contains("[lints]\nworkspace = true"), "{}", manifest.display());
    }
}

/// Goal: no sum of floats depends on the order of threads: no atomic float, neither by name nor by its bits.
#[test]
fn no_float_atomics() {
    let mut files = Vec::new();
    sources(&root().join("crates"), "rs", &mut files);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let floats_in_atomics = text.contains("Atomic") && text.contains("from_bits");
        for (number, line) in text.lines().enumerate() {
            let by_name = line.contains("AtomicF32") || line.contains("AtomicF64");
            let by_bits =
                floats_in_atomics && ["fetch_update", "compare_exchange"].iter().any(|f| line.contains(f));
            assert!(!by_name && !by_bits, "{}:{}: {line}", file.display(), number + 1);
        }
    }
}

/// The text of the doc comments that stand over a `#[test]`, one line each, lower case.
fn goals(source: &str) -> Vec<String> {
    let (mut goals, mut comment) = (Vec::new(), String::new());
    for line in source.lines().map(str::trim) {
        if let Some(text) = line.strip_prefix("///") {
            comment.push_str(text);
        } else if line == "#[test]" {
            goals.push(std::mem::take(&mut comment).to_lowercase());
        } else if !line.starts_with("#[") {
            comment.clear();
        }
    }
    goals
}

/// Numbers that a goal names: "hard case 7", "hard cases 11 and 14", "hard cases 11, 13–16".
fn named_cases(goal: &str) -> Vec<u32> {
    let mut cases = Vec::new();
    for (at, phrase) in goal.match_indices("hard case") {
        let rest = goal[at + phrase.len()..].trim_start_matches('s').trim_start();
        let list: String = rest
            .replace(" and ", ",")
            .replace(" to ", "–")
            .chars()
            .filter(|c| !c.is_whitespace())
            .take_while(|c| c.is_ascii_digit() || ",–-".contains(*c))
            .collect();
        for part in list.split(',') {
            let mut ends = part.split(['–', '-']).filter_map(|n| n.parse::<u32>().ok());
            if let Some(first) = ends.next() {
                cases.extend(first..=ends.next().unwrap_or(first));
            }
        }
    }
    cases
}

/// Goal: the reader of goals finds lists and ranges, and takes a number for nothing else.
#[test]
fn goals_are_read() {
    let source = "/// Goal: a (hard cases\n/// 2, 4–6 and 9).\n#[cfg(unix)]\n#[test]\nfn a() {}\n/// Hard case 3.\nfn b() {}";
    assert_eq!(goals(source).len(), 1);
    assert_eq!(named_cases(&goals(source)[0]), [2, 4, 5, 6, 9]);
    assert_eq!(named_cases("(hard case 11, readers' part): 7 of 9"), [11]);
}

/// Goal: every hard case of the list is named in the goal of a test: in the comment over it, not somewhere in a file.
#[test]
fn hard_cases_are_named_in_tests() {
    let mut files = Vec::new();
    sources(&root().join("crates"), "rs", &mut files);
    let named: BTreeSet<u32> = files
        .iter()
        .flat_map(|f| goals(&std::fs::read_to_string(f).unwrap()))
        .flat_map(|goal| named_cases(&goal))
        .collect();
    let missing: Vec<u32> = (1..=36).filter(|case| !named.contains(case)).collect();
    assert!(missing.is_empty(), "no goal of a test names the hard cases {missing:?}");
}
