//! What else lies about: roots of captures, moving pictures, reports, scores, recipes.

use super::Info;
use crate::PipelineError;
use comgs_synth::Recipe;
use serde_json::Value;
use std::path::Path;

/// Folders of a SynCom root, with what their subfolders are.
const ROOT: [(&str, &str); 5] = [
    ("object", "objects"),
    ("object_relit", "objects under other lights"),
    ("scene", "scenes"),
    ("composition", "compositions"),
    ("scene_env", "lights"),
];

/// A SynCom root: `object/NAME`, `scene/NAME`, `composition/SCENE_with_OBJECT`. `None` for a folder that is none.
pub(super) fn root(path: &Path) -> Option<Info> {
    let mut info = Info::new(format!("root of captures (SynCom): {}", path.display()));
    for (folder, what) in ROOT {
        let mut names: Vec<String> = std::fs::read_dir(path.join(folder))
            .into_iter()
            .flatten()
            .flatten()
            .filter(|e| folder == "scene_env" || e.path().is_dir())
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        if !names.is_empty() {
            info.fact(what, names.join(", "));
        }
    }
    let captures = info.facts.iter().any(|(what, _)| what == "objects" || what == "scenes");
    captures.then_some(info)
}

/// A GIF: size and frames.
pub(super) fn gif(path: &Path) -> Result<Info, PipelineError> {
    use image::{AnimationDecoder, ImageDecoder, codecs::gif::GifDecoder};
    let file = std::fs::File::open(path).map_err(|e| PipelineError::io(path, e))?;
    let broken = |e: image::ImageError| {
        PipelineError::input(path.display().to_string(), "a GIF", format!("a damaged file ({e})"))
    };
    let decoder = GifDecoder::new(std::io::BufReader::new(file)).map_err(broken)?;
    let (w, h) = decoder.dimensions();
    if w as usize * h as usize > comgs_image::read::MAX_PIXELS {
        return Err(PipelineError::input(
            path.display().to_string(),
            "a smaller GIF",
            format!("{w}×{h} pixels"),
        ));
    }
    let mut frames = 0;
    for frame in decoder.into_frames() {
        frame.map_err(broken)?;
        frames += 1;
    }
    let mut info = Info::new(format!("moving picture: {}", path.display()));
    info.fact("size", format!("{w}×{h}"));
    info.fact("frames", frames.to_string());
    Ok(info)
}

/// A report or another page: its title.
pub(super) fn html(path: &Path) -> Result<Info, PipelineError> {
    let text = std::fs::read(path).map_err(|e| PipelineError::io(path, e))?;
    let text = String::from_utf8_lossy(&text[..text.len().min(1 << 16)]).into_owned();
    let title = text.split_once("<title>").and_then(|(_, rest)| rest.split_once("</title>"));
    let mut info = Info::new(format!("page for a browser: {}", path.display()));
    info.fact("title", title.map_or("none", |(title, _)| title.trim()));
    Ok(info)
}

/// Scores as `eval --json` and `compose` write them. `None` when the JSON is something else.
pub(super) fn scores(path: &Path, json: &Value) -> Option<Info> {
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let (subject, against) = (text(&json["subject"])?, text(&json["against"])?);
    let mut info = Info::new(format!("scores: {}", path.display()));
    info.fact("of", subject);
    info.fact("against", against);
    for section in json["sections"].as_array()? {
        let means = section["mean"].as_object()?;
        let shown = means.iter().filter_map(|(key, v)| v.as_f64().map(|v| format!("{key} {v:.3}")));
        info.fact(&text(&section["name"])?, shown.take(6).collect::<Vec<_>>().join(", "));
    }
    Some(info)
}

/// A recipe of `comgs synth`. `None` when the JSON is something else.
pub(super) fn recipe(path: &Path, json: &str) -> Option<Info> {
    let recipe = Recipe::from_json(json).ok()?;
    let mut info = Info::new(format!("recipe for synth: {}", path.display()));
    info.fact("name", &recipe.name);
    info.fact("seed", recipe.seed.to_string());
    info.fact("objects", recipe.objects.len().to_string());
    info.fact("scenes", recipe.scenes.len().to_string());
    info.fact("compositions", recipe.compositions.len().to_string());
    Some(info)
}
