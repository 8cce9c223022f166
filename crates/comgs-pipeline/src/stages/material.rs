//! `material`: a decomposed asset with another material.

use crate::source::Source;
use crate::{Context, Fingerprint, PipelineError, Run, RunRecord, source};
use comgs_scene::asset::{ASSET_FILE, ExtraFile, SURFELS_FILE};
use comgs_scene::{Asset, AssetKind};
use comgs_surfel::activation::{logit, sigmoid};
use comgs_surfel::{MaterialColumns, ply};
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Decomposed asset, or a PLY with material.
    pub asset: PathBuf,
    /// Folder of the asset to make; not the input's own.
    pub output: PathBuf,
}

/// What becomes of the albedo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum AlbedoEdit {
    /// The same linear Rec.709 colour everywhere, each channel in [0, 1].
    Set([f64; 3]),
    /// The old colour times this factor, clamped to [0, 1].
    Scale(f64),
}

impl FromStr for AlbedoEdit {
    type Err = String;

    /// `r,g,b` sets, one number scales.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| format!("{part:?} is not a number")))
            .collect::<Result<_, _>>()?;
        let edit = match numbers[..] {
            [scale] => Self::Scale(scale),
            [r, g, b] => Self::Set([r, g, b]),
            _ => {
                return Err(format!(
                    "expected a linear colour r,g,b or one factor, got {} numbers",
                    numbers.len()
                ));
            }
        };
        edit.check().map(|()| edit)
    }
}

impl AlbedoEdit {
    fn check(self) -> Result<(), String> {
        match self {
            Self::Set(rgb) if rgb.iter().all(|v| (0.0..=1.0).contains(v)) => Ok(()),
            Self::Set(rgb) => Err(format!("expected a linear colour with channels from 0 to 1, got {rgb:?}")),
            Self::Scale(s) if s.is_finite() && s >= 0.0 => Ok(()),
            Self::Scale(s) => Err(format!("expected a factor that is not negative, got {s}")),
        }
    }
}

/// A material with a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Brushed copper.
    Copper,
    /// Polished silver.
    Silver,
    /// Grey stone that keeps the light and dark pattern of the object.
    Stone,
    /// Red paint without a gloss.
    RedMatte,
    /// Red lacquer.
    RedGlossy,
}

/// What a [`Preset`] stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PresetValues {
    /// Name on the command line.
    pub name: &'static str,
    /// Linear Rec.709; the reflectance at normal incidence (F0) of metals.
    pub albedo: [f64; 3],
    /// Roughness in [0, 1].
    pub roughness: f64,
    /// Metallic in [0, 1].
    pub metallic: f64,
    /// Whether the object's pattern shows through; see [`PATTERN_RANGE`].
    pub pattern: bool,
    /// Where the colour comes from. Roughnesses are chosen to look as the name says.
    pub source: &'static str,
}

/// With a pattern, the albedo is the preset's times `clamp(Y / median Y, ½, 2)`, `Y` the luminance of a surfel's old
/// albedo: stone stays stone, without the black and white that paint may have.
pub const PATTERN_RANGE: [f64; 2] = [0.5, 2.0];

/// F0 of metals: Adobe, "Metal material references" of the Standard Material (measured spectra as linear Rec.709),
/// rounded to two digits.
const METAL_SOURCE: &str = "F0 from measured spectra, Adobe Standard Material metal references, rounded";

/// The presets.
pub const PRESETS: [(Preset, PresetValues); 5] = [
    (
        Preset::Copper,
        PresetValues {
            name: "copper",
            albedo: [1.0, 0.65, 0.53],
            roughness: 0.3,
            metallic: 1.0,
            pattern: false,
            source: METAL_SOURCE,
        },
    ),
    (
        Preset::Silver,
        PresetValues {
            name: "silver",
            albedo: [0.99, 0.98, 0.97],
            roughness: 0.15,
            metallic: 1.0,
            pattern: false,
            source: METAL_SOURCE,
        },
    ),
    (
        Preset::Stone,
        PresetValues {
            name: "stone",
            albedo: [0.3, 0.28, 0.25],
            roughness: 0.9,
            metallic: 0.0,
            pattern: true,
            source: "chosen: a warm grey in the middle of what natural stone reflects",
        },
    ),
    (
        Preset::RedMatte,
        PresetValues {
            name: "red-matte",
            albedo: [0.6, 0.04, 0.03],
            roughness: 0.85,
            metallic: 0.0,
            pattern: false,
            source: "chosen: a saturated red paint",
        },
    ),
    (
        Preset::RedGlossy,
        PresetValues {
            name: "red-glossy",
            albedo: [0.6, 0.04, 0.03],
            roughness: 0.12,
            metallic: 0.0,
            pattern: false,
            source: "chosen: the paint of red-matte under a clear coat",
        },
    ),
];

impl Preset {
    /// What it stands for.
    #[must_use]
    pub fn values(self) -> PresetValues {
        let [(_, first), ..] = PRESETS;
        PRESETS.iter().find(|(preset, _)| *preset == self).map_or(first, |(_, values)| *values)
    }
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

/// The edited material, and how many surfels had an albedo above 1 that was clamped.
#[must_use]
pub fn edit(old: &MaterialColumns, config: &Config) -> (MaterialColumns, usize) {
    let mut new = old.clone();
    let preset = config.preset.map(Preset::values);
    let mut clamped = 0;
    if preset.is_some() || config.albedo.is_some() {
        let colors: Vec<[f64; 3]> =
            old.albedo_logits.iter().map(|a| a.map(|x| f64::from(sigmoid(x)))).collect();
        let middle = median(colors.iter().map(luminance).collect());
        for (logits, color) in new.albedo_logits.iter_mut().zip(&colors) {
            let edited = edited_albedo(*color, middle, preset.as_ref(), config.albedo);
            clamped += usize::from(edited.iter().any(|v| *v > 1.0));
            *logits = edited.map(|v| logit(v.clamp(0.0, 1.0) as f32));
        }
    }
    if let Some(roughness) = config.roughness.or(preset.map(|p| p.roughness)) {
        new.roughness_logits.fill(logit(roughness as f32));
    }
    if let Some(metallic) = config.metallic.or(preset.map(|p| p.metallic)) {
        new.metallic_logits.fill(logit(metallic as f32));
    }
    (new, clamped)
}

/// A surfel's albedo after preset and edit, not clamped; `middle` is the median luminance.
fn edited_albedo(
    color: [f64; 3],
    middle: f64,
    preset: Option<&PresetValues>,
    edit: Option<AlbedoEdit>,
) -> [f64; 3] {
    let [low, high] = PATTERN_RANGE;
    let base = match preset {
        None => color,
        Some(p) if p.pattern && middle > 0.0 => {
            p.albedo.map(|v| v * (luminance(&color) / middle).clamp(low, high))
        }
        Some(p) => p.albedo,
    };
    match edit {
        None => base,
        Some(AlbedoEdit::Set(rgb)) => rgb,
        Some(AlbedoEdit::Scale(s)) => base.map(|v| s * v),
    }
}

/// Rec.709 luminance.
fn luminance(rgb: &[f64; 3]) -> f64 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// Middle value; the upper one of two; 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
