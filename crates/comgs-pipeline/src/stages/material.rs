//! `material`: a decomposed asset with another material.

mod edit;
mod preset;

pub use edit::{AlbedoEdit, edit};
pub use preset::{PATTERN_RANGE, PRESETS, Preset, PresetValues};

use crate::source::Source;
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, source};
use comgs_scene::asset::{ASSET_FILE, ExtraFile, SURFELS_FILE};
use comgs_scene::{Asset, AssetKind};
use comgs_surfel::activation::sigmoid;
use comgs_surfel::{MaterialColumns, ply};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Decomposed asset, or a PLY with material.
    pub asset: PathBuf,
    /// Folder of the asset to make; not the input's own.
    pub output: PathBuf,
}

/// Knobs of the stage. The preset comes first; single values then replace its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Config {
    /// A material with a name.
    pub preset: Option<Preset>,
    /// What becomes of the albedo.
    pub albedo: Option<AlbedoEdit>,
    /// Roughness everywhere, in [0, 1].
    pub roughness: Option<f64>,
    /// Metallic everywhere, in [0, 1].
    pub metallic: Option<f64>,
}

impl Config {
    /// Whether every value is in its range and there is something to do.
    ///
    /// # Errors
    /// [`PipelineError::Input`] by the name of the flag.
    pub fn check(&self) -> Result<(), PipelineError> {
        if *self == Self::default() {
            let flags = "--albedo, --roughness, --metallic or --preset";
            return Err(PipelineError::input("the edit", flags, "none of them"));
        }
        for (flag, value) in [("--roughness", self.roughness), ("--metallic", self.metallic)] {
            if let Some(v) = value.filter(|v| !(0.0..=1.0).contains(v)) {
                return Err(PipelineError::input(flag, "a number from 0 to 1", v.to_string()));
            }
        }
        match self.albedo.map(AlbedoEdit::check) {
            Some(Err(got)) => Err(PipelineError::input("--albedo", "r,g,b or a factor", got)),
            _ => Ok(()),
        }
    }
}

/// Means of a material over its surfels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Linear albedo.
    pub albedo: [f64; 3],
    /// Roughness.
    pub roughness: f64,
    /// Metallic.
    pub metallic: f64,
}

impl Summary {
    fn of(material: &MaterialColumns) -> Self {
        let mean = |logits: &mut dyn Iterator<Item = f32>, n: usize| {
            logits.map(|x| f64::from(sigmoid(x))).sum::<f64>() / n.max(1) as f64
        };
        let n = material.roughness_logits.len();
        Self {
            albedo: [0, 1, 2].map(|c| mean(&mut material.albedo_logits.iter().map(|a| a[c]), n)),
            roughness: mean(&mut material.roughness_logits.iter().copied(), n),
            metallic: mean(&mut material.metallic_logits.iter().copied(), n),
        }
    }

    fn text(&self) -> String {
        let [r, g, b] = self.albedo;
        format!("albedo {r:.3} {g:.3} {b:.3}, roughness {:.3}, metallic {:.3}", self.roughness, self.metallic)
    }
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The new asset's folder.
    pub asset: PathBuf,
    /// Whether an earlier result was still good.
    pub reused: bool,
    /// The record, with the means before and after.
    pub record: RunRecord,
}

/// Name of the cameras beside an asset, which are no listed file of it.
const CAMERAS_FILE: &str = "cameras.json";

/// Writes the asset with its material edited. Geometry, captured colours and all other files of the asset (probes, light,
/// cameras) are carried along as they are, the input is not touched. Columns that nothing edits keep their bits.
///
/// The captured colours do not follow the material: relighting shows the edit, plain rendering does not. Radiance stored in
/// probes was reflected by the old material; their visibility holds.
///
/// # Errors
/// [`PipelineError::Input`] for an asset without material, values out of range, and an output that is the input;
/// [`PipelineError::Output`] for a folder that cannot be written;
/// [`PipelineError::Scene`] when the asset is damaged or the new one cannot be written (the old one then stays).
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    config.check()?;
    refuse_in_place(input)?;
    context.progress.begin("material");
    let mut run = Run::in_folder("material", &input.output);
    let mut fingerprint = Fingerprint::new("material");
    fingerprint.surfels("asset", &input.asset)?;
    let cameras = cameras_of(&input.asset)?;
    if let Some(file) = &cameras {
        fingerprint.path("cameras", file)?;
    }
    fingerprint.config("config", config)?;
    let fingerprint = fingerprint.finish();
    if let Some(record) = run.reusable(&fingerprint) {
        context.progress.end("unchanged since the last run; nothing to do");
        return Ok(Output { asset: input.output.clone(), reused: true, record });
    }
    run.check_output()?;
    run.describe(fingerprint, json!({"asset": input.asset}), config, None)?;
    let (mut asset, notes) = run.time("load", || load(&input.asset))?;
    for note in notes {
        run.warn(context, note);
    }
    let Some(old) = asset.surfels.material.take() else {
        return Err(PipelineError::input(
            input.asset.display().to_string(),
            "an asset with material (`comgs decompose` makes it)",
            "captured colours only",
        ));
    };
    let before = Summary::of(&old);
    let (new, clamped) = run.time("edit", || Ok::<_, PipelineError>(edit(&old, config)))?;
    let after = Summary::of(&new);
    if clamped > 0 {
        let share = 100.0 * clamped as f64 / new.albedo_logits.len() as f64;
        run.warn(context, format!("the albedo of {share:.1} % of the surfels was clamped at 1"));
    }
    asset.surfels.material = Some(new);
    run.invalidate()?;
    let files = run.time("save", || save(&mut asset, cameras.as_deref(), &input.output))?;
    for file in files {
        run.output(&input.output.join(file))?;
    }
    run.results(json!({"surfels": asset.surfels.len(), "before": before, "after": after}));
    let record = run.finish()?;
    if asset.record.files.keys().any(|name| name.starts_with("probes")) {
        context.progress.note("light stored in the probes was reflected by the old material");
    }
    context.progress.end(&format!("{} (before: {})", after.text(), before.text()));
    Ok(Output { asset: input.output.clone(), reused: false, record })
}

/// The asset, and what the reader of a bare PLY has to say.
fn load(path: &Path) -> Result<(Asset, Vec<String>), PipelineError> {
    let Source::Ply(file) = Source::of(path)? else {
        return Ok((source::load_surfels(path, AssetKind::Object)?, Vec::new()));
    };
    let (cloud, report) = ply::read_surfels(&file).map_err(comgs_scene::SceneError::from)?;
    if cloud.is_empty() {
        return Err(PipelineError::input(path.display().to_string(), "at least one surfel", "none"));
    }
    let mut notes = report.missing;
    notes.extend(report.material.map(|m| m.assumed).unwrap_or_default());
    if report.dropped > 0 {
        notes.push(format!("{} surfels with non-finite values were left out", report.dropped));
    }
    Ok((Asset::new(AssetKind::Object, cloud), notes))
}

/// An asset is never overwritten by its own edit.
fn refuse_in_place(input: &Input) -> Result<(), PipelineError> {
    let source = Source::of(&input.asset)?;
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    let folder = match &source {
        Source::Asset(folder) => folder.as_path(),
        Source::Ply(file) => match file.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        },
        Source::Capture(_) => return Ok(()),
    };
    // A bare PLY may lie in the output's folder, unless the asset's own file would replace it.
    let collides =
        matches!(source, Source::Asset(_)) || source.path().file_name().is_some_and(|n| n == SURFELS_FILE);
    match (real(folder), real(&input.output)) {
        (Some(from), Some(to)) if from == to && collides => Err(PipelineError::input(
            "-o",
            "a folder other than the input's",
            format!("the input itself, {}", input.output.display()),
        )),
        _ => Ok(()),
    }
}

/// The camera list beside an asset.
fn cameras_of(path: &Path) -> Result<Option<PathBuf>, PipelineError> {
    let Source::Asset(folder) = Source::of(path)? else { return Ok(None) };
    Ok(Some(folder.join(CAMERAS_FILE)).filter(|file| file.is_file()))
}

/// Saves the asset with the files it had; returns the names of all that was written.
fn save(asset: &mut Asset, cameras: Option<&Path>, output: &Path) -> Result<Vec<String>, PipelineError> {
    let carried: Vec<(String, PathBuf)> = asset
        .record
        .files
        .keys()
        .filter(|name| *name != SURFELS_FILE)
        .map(|name| (name.clone(), asset.root.join(name)))
        .collect();
    let copies: Vec<_> = carried
        .iter()
        .map(|(_, path)| {
            move |w: &mut dyn std::io::Write| {
                let mut file = std::fs::File::open(path)?;
                std::io::copy(&mut file, w).map(|_| ())
            }
        })
        .collect();
    let extra: Vec<ExtraFile<'_>> =
        carried.iter().zip(&copies).map(|((name, _), copy)| (name.as_str(), copy as _)).collect();
    let mut written: Vec<String> = vec![ASSET_FILE.to_owned(), SURFELS_FILE.to_owned()];
    written.extend(carried.iter().map(|(name, _)| name.clone()));
    // Cameras first: the asset is whole once `asset.json` is there.
    if let Some(file) = cameras.filter(|_| !asset.record.files.contains_key(CAMERAS_FILE)) {
        let bytes = std::fs::read(file).map_err(|e| PipelineError::io(file, e))?;
        let to = output.join(CAMERAS_FILE);
        comgs_image::atomic::write_file(&to, |w| w.write_all(&bytes))
            .map_err(|e| PipelineError::io(&to, e))?;
        written.push(CAMERAS_FILE.to_owned());
    }
    asset.save_with(output, &extra)?;
    Ok(written)
}
