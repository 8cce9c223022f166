//! Which format a folder or file is.

use super::{Format, Split};
use crate::SceneError;
use crate::json;
use serde::Deserialize;
use serde_json::value::RawValue;
use std::path::{Path, PathBuf};

/// One camera list of a capture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    /// Its split; `None` when the capture has a single list.
    pub split: Option<Split>,
    /// The list: a JSON file, or the folder of a COLMAP model.
    pub list: PathBuf,
    /// The folder that images are relative to.
    pub base: PathBuf,
}

/// A capture's lists.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Recognised {
    pub root: PathBuf,
    pub format: Format,
    pub parts: Vec<Part>,
}

/// What makes a folder a capture, in the order of looking.
const LOOKED_FOR: [&str; 8] = [
    "sparse/0/images.bin",
    "sparse/0/images.txt",
    "sparse/images.bin",
    "transforms_train.json",
    "transforms.json",
    "cameras.json",
    "train/cameras.json",
    "test/cameras.json",
];

/// Recognises a capture's folder, a camera list, or a COLMAP model's folder.
///
/// # Errors
/// [`SceneError::Io`] when there is nothing, [`SceneError::Unrecognised`] when it is no capture.
pub(crate) fn recognise(path: &Path) -> Result<Recognised, SceneError> {
    let meta = std::fs::metadata(path).map_err(SceneError::io(path))?;
    if !meta.is_dir() {
        return recognise_file(path);
    }
    let model = ["sparse/0", "sparse", "colmap/sparse/0"].iter().map(|f| path.join(f)).find(|f| is_model(f));
    if let Some(list) = model.or_else(|| lowest_numbered_model(&path.join("sparse"))) {
        let parts = vec![Part { split: None, list, base: path.to_owned() }];
        return Ok(Recognised { root: path.to_owned(), format: Format::Colmap, parts });
    }
    // The model's own folder, or the folder of models: the images lie above.
    let inside = is_model(path).then(|| path.to_owned());
    let inside = inside.or_else(|| path.ends_with("sparse").then(|| lowest_numbered_model(path)).flatten());
    if let Some(list) = inside {
        let root = images_root(&list);
        let parts = vec![Part { split: None, list, base: root.clone() }];
        return Ok(Recognised { root, format: Format::Colmap, parts });
    }
    let own_splits = |train: &str, test: &[&str]| {
        let part = |split, name: &str| {
            let list = path.join(name);
            list.is_file().then(|| Part { split: Some(split), base: parent(&list), list })
        };
        let mut parts: Vec<Part> = part(Split::Train, train).into_iter().collect();
        parts.extend(test.iter().find_map(|name| part(Split::Test, name)));
        if let [only] = parts.as_mut_slice() {
            only.split = None;
        }
        parts
    };
    let single = |name: &str| {
        let list = path.join(name);
        if list.is_file() { vec![Part { split: None, list, base: path.to_owned() }] } else { Vec::new() }
    };
    let candidates = [
        (
            Format::Transforms,
            own_splits("transforms_train.json", &["transforms_test.json", "transforms_val.json"]),
        ),
        (Format::Transforms, single("transforms.json")),
        (Format::SynCom, single("cameras.json")),
        (Format::SynCom, own_splits("train/cameras.json", &["test/cameras.json"])),
    ];
    for (format, parts) in candidates {
        if !parts.is_empty() {
            return Ok(Recognised { root: path.to_owned(), format, parts });
        }
    }
    Err(SceneError::Unrecognised {
        path: path.to_owned(),
        looked_for: LOOKED_FOR.iter().map(|&s| s.to_owned()).collect(),
    })
}

fn recognise_file(path: &Path) -> Result<Recognised, SceneError> {
    let base = parent(path);
    let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    if matches!(stem, "images" | "cameras") && is_model(&base) && !name.ends_with(".json") {
        return recognise(&base);
    }
    #[derive(Deserialize)]
    struct Probe<'a> {
        #[serde(borrow)]
        cameras: Option<&'a RawValue>,
        #[serde(borrow)]
        frames: Option<&'a RawValue>,
    }
    let bytes = json::read_limited(path, json::MAX_BYTES)?;
    let fixed = json::without_literals(&bytes);
    let probe: Probe<'_> = json::parse(&fixed, "", path)?;
    let format = match (probe.cameras, probe.frames) {
        (Some(_), _) => Format::SynCom,
        (None, Some(_)) => Format::Transforms,
        (None, None) => {
            return Err(SceneError::json(
                path,
                "",
                "no camera list: neither \"cameras\" (SynCom) nor \"frames\" (NeRF)",
            ));
        }
    };
    let parts = vec![Part { split: None, list: path.to_owned(), base: base.clone() }];
    Ok(Recognised { root: base, format, parts })
}

/// Whether a folder holds a COLMAP model.
fn is_model(folder: &Path) -> bool {
    ["bin", "txt"]
        .iter()
        .any(|e| ["cameras", "images"].iter().all(|name| folder.join(format!("{name}.{e}")).is_file()))
}

fn lowest_numbered_model(sparse: &Path) -> Option<PathBuf> {
    let mut numbers: Vec<u32> = std::fs::read_dir(sparse)
        .ok()?
        .take(10_000)
        .flatten()
        .filter_map(|e| e.file_name().to_str()?.parse().ok())
        .collect();
    numbers.sort_unstable();
    numbers.iter().map(|n| sparse.join(n.to_string())).find(|f| is_model(f))
}

/// The folder above a model (`x/sparse/0`) that holds its images.
fn images_root(model: &Path) -> PathBuf {
    let absolute = model.canonicalize().unwrap_or_else(|_| model.to_owned());
    absolute.ancestors().take(3).find(|f| f.join("images").is_dir()).unwrap_or(&absolute).to_owned()
}

fn parent(file: &Path) -> PathBuf {
    match file.parent() {
        Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
        _ => PathBuf::from("."),
    }
}
