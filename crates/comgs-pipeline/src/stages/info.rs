//! `info`: what anything of ours or of others holds.

mod other;

use crate::progress::{human_bytes, human_duration};
use crate::source::extension;
use crate::{PipelineError, record::read_record};
use comgs_image::Encoding;
use comgs_scene::{Asset, CompositionRecord, TransformFile, check};
use comgs_surfel::{MaterialColumns, SurfelCloud, activation::sigmoid, ply};
use std::path::Path;

/// Largest JSON that is looked at as scores or a recipe.
const MAX_SMALL_JSON: u64 = 4 << 20;

/// Facts about a file or folder.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Info {
    /// What it is, one line.
    pub title: String,
    /// Name and value.
    pub facts: Vec<(String, String)>,
    /// What is wrong or missing.
    pub problems: Vec<String>,
}

impl Info {
    fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    fn fact(&mut self, name: &str, value: impl Into<String>) {
        self.facts.push((name.to_owned(), value.into()));
    }

    /// As text for a terminal.
    #[must_use]
    pub fn to_text(&self) -> String {
        let width = self.facts.iter().map(|(n, _)| n.chars().count()).max().unwrap_or(0);
        let mut text = format!("{}\n", self.title);
        for (name, value) in &self.facts {
            let gap = " ".repeat(width - name.chars().count());
            text.push_str(&format!("  {name}{gap}  {value}\n"));
        }
        for problem in &self.problems {
            text.push_str(&format!("  ! {problem}\n"));
        }
        text
    }
}

/// Looks at a path: an asset, a PLY, a picture, a capture or a root of captures, a camera list, a composition, a placement,
/// scores, a recipe, a report or a run record.
///
/// # Errors
/// [`PipelineError`] when the path is not there, is none of these, or is damaged.
pub fn run(path: &Path) -> Result<Info, PipelineError> {
    let metadata = std::fs::metadata(path).map_err(|e| PipelineError::io(path, e))?;
    if metadata.is_dir() {
        return if Asset::is_asset(path) { asset(path) } else { folder(path) };
    }
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut info = match (name.as_str(), extension(path).as_str()) {
        ("asset.json", _) => return asset(path.parent().unwrap_or(Path::new("."))),
        (_, "ply") => ply_file(path)?,
        (_, "exr" | "png" | "jpg" | "jpeg" | "hdr") => picture(path)?,
        ("composition.json", _) => composition(path)?,
        (_, "json") if read_record(path).is_some() => run_record(path),
        (_, "json") => json(path)?,
        (_, "gif") => other::gif(path)?,
        (_, "html" | "htm") => other::html(path)?,
        _ => {
            return Err(PipelineError::input(
                path.display().to_string(),
                "an asset, PLY, EXR, HDR, PNG, JPEG, GIF, HTML, capture or root of captures, camera list, transform.json, \
                 composition.json, scores.json, a recipe or run.json",
                format!("a file of {}", human_bytes(metadata.len())),
            ));
        }
    };
    info.fact("size on disk", human_bytes(metadata.len()));
    Ok(info)
}

fn asset(path: &Path) -> Result<Info, PipelineError> {
    let (asset, report) = Asset::load_with_report(path)?;
    let record = &asset.record;
    let kind = serde_json::to_value(record.kind)
        .ok()
        .and_then(|v| v.as_str().map(str::to_owned))
        .unwrap_or_default();
    let mut info = Info::new(format!("asset ({kind}): {}", path.display()));
    cloud_facts(&mut info, &asset.surfels, "surfels");
    info.fact("up", format!("{:.3?}", record.up));
    if let Some(capture) = &record.capture {
        let [w, h] = capture.image_size;
        info.fact(
            "capture",
            format!(
                "{} ({}), {} views of {w}×{h}{}",
                capture.name,
                capture.format.name(),
                capture.views,
                if capture.hdr { ", HDR" } else { "" }
            ),
        );
        if !capture.left_out.is_empty() {
            info.fact("left out", capture.left_out.join(", "));
        }
    }
    if let Some(training) = &record.training {
        let time = human_duration(training.seconds);
        let (program, steps, seed) = (&training.program, training.iterations, training.seed);
        info.fact("training", format!("{program}, {steps} steps in {time}, seed {seed}"));
        for (name, value) in &training.metrics {
            info.fact(name, format!("{value:.4}"));
        }
    }
    let files: Vec<String> =
        record.files.iter().map(|(name, f)| format!("{name} ({})", human_bytes(f.bytes))).collect();
    info.fact("files", files.join(", "));
    if report.dropped > 0 {
        info.problems.push(format!("{} surfels with non-finite values were left out", report.dropped));
    }
    Ok(info)
}

fn cloud_facts(info: &mut Info, cloud: &SurfelCloud, count: &str) {
    info.fact(count, cloud.len().to_string());
    info.fact("harmonics", format!("degree {}", cloud.sh_degree));
    info.fact("colour", format!("{:?} sums", cloud.color_encoding));
    info.fact("material", if cloud.material.is_some() { "albedo, roughness, metallic" } else { "none" });
    if let Some(material) = &cloud.material {
        material_facts(info, material);
    }
    if let Some((low, high)) = cloud.bounds() {
        info.fact("bounds", format!("{low:.3} to {high:.3}"));
    }
    let median = |mut values: Vec<f32>| {
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    let scales = cloud.log_scales.iter().map(|[a, b]| a.max(*b).exp()).collect();
    let opacities = cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect();
    info.fact("median", format!("larger scale {:.5}, opacity {:.3}", median(scales), median(opacities)));
}

/// Ranges and means after activation.
fn material_facts(info: &mut Info, material: &MaterialColumns) {
    let range = |logits: &mut dyn Iterator<Item = f32>| {
        let (mut low, mut high, mut sum, mut n) = (f64::INFINITY, f64::NEG_INFINITY, 0.0, 0usize);
        for value in logits.map(|x| f64::from(sigmoid(x))) {
            (low, high, sum, n) = (low.min(value), high.max(value), sum + value, n + 1);
        }
        (n > 0).then(|| format!("{low:.3} to {high:.3}, mean {:.3}", sum / n as f64))
    };
    let mut fact = |name: &str, logits: &mut dyn Iterator<Item = f32>| {
        if let Some(text) = range(logits) {
            info.fact(name, text);
        }
    };
    for (c, name) in ["albedo red", "albedo green", "albedo blue"].into_iter().enumerate() {
        fact(name, &mut material.albedo_logits.iter().map(|a| a[c]));
    }
    fact("roughness", &mut material.roughness_logits.iter().copied());
    fact("metallic", &mut material.metallic_logits.iter().copied());
}

fn ply_file(path: &Path) -> Result<Info, PipelineError> {
    let scene = |e: comgs_surfel::PlyError| comgs_scene::SceneError::from(e);
    let header = ply::read_header(path).map_err(scene)?;
    if ply::PlyDialect::of(&header).is_none_or(|dialect| dialect == ply::PlyDialect::Points) {
        let mut info = Info::new(format!("PLY: {}", path.display()));
        info.fact("layout", format!("{:?}", header.layout));
        for element in &header.elements {
            let columns: Vec<&str> = element.properties.iter().map(|p| p.name.as_str()).collect();
            info.fact(&element.name, format!("{} with {}", element.count, columns.join(" ")));
        }
        return Ok(info);
    }
    let (cloud, report) = ply::read_surfels(path).map_err(scene)?;
    let three = report.dialect.has_three_scales();
    let what = if three { "Gaussians" } else { "surfels" };
    let mut info = Info::new(format!("PLY of {what} ({}): {}", report.dialect.name(), path.display()));
    cloud_facts(&mut info, &cloud, if three { "gaussians" } else { "surfels" });
    if let Some(material) = &report.material {
        info.fact("material columns", material.describe());
        for sentence in &material.assumed {
            info.fact("assumed", sentence);
        }
    }
    info.fact("layout", format!("{:?}", report.layout));
    info.fact("columns", report.columns.join(" "));
    info.problems.extend(report.missing);
    if report.dropped > 0 {
        info.problems.push(format!("{} surfels with non-finite values were left out", report.dropped));
    }
    Ok(info)
}

fn picture(path: &Path) -> Result<Info, PipelineError> {
    let loaded = comgs_image::read(path)?;
    let (w, h) = (loaded.color.width, loaded.color.height);
    let mut info = Info::new(format!("picture: {}", path.display()));
    info.fact("size", format!("{w}×{h}"));
    let values = match loaded.encoding {
        Encoding::Srgb => "sRGB, clipped at 1",
        Encoding::Linear => "floating point, linear",
    };
    info.fact("values", values);
    if extension(path) == "exr" {
        let channels = comgs_image::read::exr_channels(path)?;
        info.fact("channels", channels.join(" "));
    } else {
        let alpha = if loaded.alpha.is_some() { " and alpha" } else { "" };
        info.fact("channels", format!("{}{alpha}", loaded.color.channels));
    }
    let finite: Vec<f32> = loaded.color.data.iter().copied().filter(|v| v.is_finite()).collect();
    let (low, high) =
        finite.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    let mean = finite.iter().map(|v| f64::from(*v)).sum::<f64>() / finite.len().max(1) as f64;
    info.fact("linear range", format!("{low:.5} to {high:.5}, mean {mean:.5}"));
    if loaded.encoding == Encoding::Linear && w == 2 * h {
        info.fact("shape", "2:1, as environment maps have it (z up, centre looks along +x)");
    }
    let bad = loaded.color.non_finite();
    if bad > 0 {
        info.problems.push(format!("{bad} samples are not finite"));
    }
    let negative = loaded.color.data.iter().filter(|v| **v < 0.0).count();
    if negative > 0 {
        info.problems.push(format!("{negative} samples are negative"));
    }
    Ok(info)
}

/// A folder of a run or a capture.
fn folder(path: &Path) -> Result<Info, PipelineError> {
    if path.join("composition.json").is_file() {
        return composition(&path.join("composition.json"));
    }
    let report = check(path);
    if report.format.is_none() && path.join("run.json").is_file() {
        return Ok(run_record(&path.join("run.json")));
    }
    if report.format.is_none()
        && let Some(info) = other::root(path)
    {
        return Ok(info);
    }
    let Some(format) = report.format else {
        // The reader's own words list what was looked for.
        comgs_scene::read_cameras(path)?;
        return Err(PipelineError::input(path.display().to_string(), "a capture", "none"));
    };
    let mut info = Info::new(format!("capture ({}): {}", format.name(), path.display()));
    info.fact("views", format!("{} to train, {} to test", report.train_views, report.test_views));
    if let Ok(cameras) = comgs_scene::read_cameras(path) {
        camera_facts(&mut info, &cameras);
    }
    info.problems.extend(report.problems.iter().map(ToString::to_string));
    Ok(info)
}

fn camera_facts(info: &mut Info, cameras: &[comgs_geom::Camera]) {
    let mut sizes: Vec<(usize, usize)> = cameras.iter().map(|c| (c.width, c.height)).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let text: Vec<String> = sizes.iter().take(4).map(|(w, h)| format!("{w}×{h}")).collect();
    let more = if sizes.len() > 4 { ", …" } else { "" };
    info.fact("image size", format!("{}{more}", text.join(", ")));
    if let Some(c) = cameras.first() {
        let hfov = 2.0 * (0.5 * c.width as f64 / c.fx).atan().to_degrees();
        info.fact("field of view", format!("{hfov:.1}° across (first camera)"));
    }
    let names: Vec<&str> = cameras.iter().take(6).map(|c| c.name.as_str()).collect();
    let more = if cameras.len() > 6 { ", …" } else { "" };
    info.fact("names", format!("{}{more}", names.join(", ")));
}

fn composition(path: &Path) -> Result<Info, PipelineError> {
    let record = CompositionRecord::read(path)?;
    let mut info = Info::new(format!("composition: {}", path.display()));
    info.fact("scene", &record.scene);
    for object in &record.objects {
        let s = &object.similarity;
        let text = format!("{} at {:.3?}, scale {:.4}", object.asset, s.translation, s.scale);
        info.fact(&object.name, text);
    }
    info.fact("light", record.light.as_deref().unwrap_or("none"));
    info.fact("shadow", format!("{:?}", record.effects.shadow).to_lowercase());
    info.fact("cameras", &record.cameras);
    Ok(info)
}

fn run_record(path: &Path) -> Info {
    let Some(record) = read_record(path) else { return Info::new(path.display().to_string()) };
    let mut info = Info::new(format!("run of comgs {}: {}", record.comgs, path.display()));
    info.fact("stage", &record.stage);
    info.fact("took", human_duration(record.seconds));
    for t in &record.timings {
        let reused = if t.reused { " (earlier run)" } else { "" };
        info.fact(&format!("  {}", t.stage), format!("{}{reused}", human_duration(t.seconds)));
    }
    if let Some(bytes) = record.peak_memory_bytes {
        info.fact("peak memory", human_bytes(bytes));
    }
    info.fact("outputs", record.outputs.len().to_string());
    info.problems.extend(record.warnings);
    info
}

/// A placement, scores, a recipe or a camera list, whichever reads.
fn json(path: &Path) -> Result<Info, PipelineError> {
    if let Ok(file) = TransformFile::read(path) {
        let mut info = Info::new(format!("placement: {}", path.display()));
        for (name, s) in &file.objects {
            let text = format!(
                "at {:.4}, scale {:.4}, rotation (w x y z) {:.4} {:.4} {:.4} {:.4}",
                s.translation, s.scale, s.rotation.w, s.rotation.x, s.rotation.y, s.rotation.z
            );
            info.fact(name, text);
        }
        return Ok(info);
    }
    // No score file or recipe is as large as a camera list may be.
    let small = std::fs::metadata(path).is_ok_and(|m| m.len() <= MAX_SMALL_JSON);
    if let Some(text) = small.then(|| std::fs::read_to_string(path).ok()).flatten() {
        let scores = serde_json::from_str(&text).ok().and_then(|value| other::scores(path, &value));
        if let Some(info) = scores.or_else(|| other::recipe(path, &text)) {
            return Ok(info);
        }
    }
    let cameras = comgs_scene::read_cameras(path)?;
    let mut info = Info::new(format!("camera list: {}", path.display()));
    info.fact("cameras", cameras.len().to_string());
    camera_facts(&mut info, &cameras);
    Ok(info)
}
