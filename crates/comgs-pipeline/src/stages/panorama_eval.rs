//! `panorama eval`: completers against panoramas that are known whole.

use super::completers::ModelConfig;
use crate::{Context, PipelineError, Status};
use comgs_image::transfer::{linear_from_srgb, srgb8_from_linear};
use comgs_image::{Image, read};
use comgs_metrics::spheres::{Judge, LightErrors, Protocol, SPHERES, SphereErrors};
use comgs_panorama::brackets::merge;
use comgs_panorama::bundle::Space;
use comgs_panorama::partial::{resized, roll};
use comgs_panorama::{
    Bank, Bundle, Completer, CompletionError, Constant, Harmonic, Learned, Partial, SphericalHarmonics,
};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Inputs.
#[derive(Clone, Debug)]
pub struct Input {
    /// Folder of whole panoramas (EXR or HDR).
    pub maps: PathBuf,
    /// Folder of masks (white = known); sorted into groups by their coverage.
    pub masks: PathBuf,
    /// Folder of panoramas for the nearest-of-a-bank completer; the maps that are not judged when absent.
    pub bank: Option<PathBuf>,
}

/// Knobs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Judge only every third map by name, from the second on: those that the shipped model never saw.
    pub held_out: bool,
    /// How the maps light the spheres.
    pub protocol: Protocol,
    /// Rows of the maps while they are completed.
    pub height: usize,
    /// How the learned model is run.
    pub model: ModelConfig,
    /// Further numbers of steps of the model to judge.
    pub more_steps: Vec<usize>,
    /// Further numbers of samples, whose mean is judged, at the most steps.
    pub more_samples: Vec<usize>,
    /// Whether to judge the model alone, without the simple completers.
    pub model_only: bool,
    /// Whether to judge as well what the ways to high dynamic range can hold: the whole map through 8-bit pictures at EV 0, −2.5
    /// and −5 and their merge, and through the shipped model's codes.
    pub representations: bool,
}

/// Groups of masks by coverage.
pub const GROUPS: [(&str, f64, f64); 3] =
    [("40–60 %", 0.4, 0.6), ("60–80 %", 0.6, 0.8), ("80–100 %", 0.8, 1.0)];

/// Means of one completer over one group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// Coverage of the masks.
    pub group: String,
    /// The completer.
    pub completer: String,
    /// Pairs of map and mask.
    pub cases: usize,
    /// Mean si-RMSE of mirror, glossy, diffuse.
    pub si_rmse: [f64; 3],
    /// Mean colour angle in degrees.
    pub angular_deg: [f64; 3],
    /// Mean normalised RMSE.
    pub normalized_rmse: [f64; 3],
    /// Mean and median relative error of irradiance.
    pub irradiance: [f64; 2],
    /// Median angle of the peak's direction in degrees.
    pub peak_deg: f64,
    /// Median seconds of a completion.
    pub seconds: f64,
}

/// Completes every map under every mask with every completer. Masks are turned differently for every map.
///
/// # Errors
/// [`PipelineError`]: folders without maps or masks, files that are no panoramas.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Vec<Line>, PipelineError> {
    context.progress.begin("panorama eval");
    let files = images(&input.maps, &["exr", "hdr"])?;
    let judged: Vec<&PathBuf> =
        files.iter().enumerate().filter(|(i, _)| !config.held_out || i % 3 == 1).map(|(_, f)| f).collect();
    let load = |path: &PathBuf| -> Result<Image, PipelineError> {
        let image = read(path)?.color;
        if image.channels != 3 || image.width != 2 * image.height {
            let got = format!("{}×{}×{}: {}", image.width, image.height, image.channels, path.display());
            return Err(PipelineError::input("map", "a colour panorama twice as wide as high", got));
        }
        let clean = image.map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 });
        Ok(resized(&clean, 2 * config.height, config.height))
    };
    let maps: Vec<Image> = judged.iter().map(|p| load(p)).collect::<Result<_, _>>()?;
    let bank: Vec<Image> = match &input.bank {
        Some(folder) => images(folder, &["exr", "hdr"])?.iter().map(load).collect::<Result<_, _>>()?,
        None => files.iter().filter(|f| !judged.contains(f)).map(load).collect::<Result<_, _>>()?,
    };
    let mut masks = Vec::new();
    for path in images(&input.masks, &["png", "exr"])? {
        let mask = resized(&super::panorama::read_mask(&path)?, 2 * config.height, config.height);
        let mask = mask.map(|v| f32::from(u8::from(v > 0.5)));
        let coverage = f64::from(comgs_panorama::sweep::coverage(&mask));
        if let Some(group) = GROUPS.iter().position(|g| (g.1..=g.2).contains(&coverage)) {
            masks.push((group, mask));
        }
    }
    if maps.is_empty() || masks.is_empty() {
        let got = format!("{} maps, {} masks of 40 to 100 % coverage", maps.len(), masks.len());
        return Err(PipelineError::input("panorama eval", "maps and masks", got));
    }
    let model_error = comgs_panorama::CompletionError::from;
    let mut completers: Vec<Box<dyn Completer>> = Vec::new();
    if !config.model_only {
        completers.push(Box::new(Constant));
        completers.push(Box::new(Harmonic));
        completers.push(Box::new(SphericalHarmonics::default()));
        if !bank.is_empty() {
            completers.push(Box::new(Bank::new(&bank)));
        }
    }
    completers.push(Box::new(config.model.load().map_err(model_error)?));
    for &steps in &config.more_steps {
        let model = ModelConfig { steps: Some(steps), ..config.model.clone() };
        completers.push(Box::new(model.load().map_err(model_error)?));
    }
    for &count in &config.more_samples {
        let steps = config.more_steps.iter().copied().max().or(config.model.steps);
        let model = ModelConfig { steps, ..config.model.clone() };
        completers.push(Box::new(MeanOf(model.load().map_err(model_error)?, count)));
    }
    let bad =
        |e: comgs_metrics::MetricError| PipelineError::input("map", "a panorama with light", e.to_string());
    let judges: Vec<Judge> =
        maps.par_iter().map(|m| Judge::new(m, config.protocol).map_err(bad)).collect::<Result<_, _>>()?;
    let started = Instant::now();
    let mut lines = Vec::new();
    let total = completers.len() * maps.len();
    let mut done = 0;
    for completer in &completers {
        let mut cases: Vec<(usize, LightErrors, f64)> = Vec::new();
        for (m, map) in maps.iter().enumerate() {
            context.check()?;
            let fraction = done as f64 / total as f64;
            let spent = started.elapsed();
            context.progress.update(&Status {
                fraction: Some(fraction),
                message: completer.name(),
                remaining: (fraction > 0.02).then(|| spent.mul_f64((1.0 - fraction) / fraction)),
            });
            let of_map: Vec<_> = masks
                .par_iter()
                .enumerate()
                .map(|(k, (group, mask))| {
                    // Any turn will do as long as it is the same for every completer.
                    let alpha = roll(mask, (37 * m + 11 * k) % mask.width);
                    let partial = Partial::new(map.clone(), alpha)?;
                    let started = Instant::now();
                    let completed = completer.complete(&partial, config.model.seed)?;
                    let seconds = started.elapsed().as_secs_f64();
                    let errors = judges[m].errors(&completed).map_err(bad)?;
                    Ok((*group, errors, seconds))
                })
                .collect::<Result<_, PipelineError>>()?;
            cases.extend(of_map);
            done += 1;
        }
        for (g, (group, ..)) in GROUPS.iter().enumerate() {
            let of: Vec<_> = cases
                .iter()
                .filter(|c| c.0 == g)
                .map(|(_, errors, seconds)| (errors.clone(), *seconds))
                .collect();
            if !of.is_empty() {
                lines.push(line(group, completer.name(), &of));
            }
        }
    }
    if config.representations {
        lines.extend(representations(&maps, &judges)?);
    }
    lines.sort_by_key(|l| GROUPS.iter().position(|g| g.0 == l.group));
    context.progress.end(&format!("{} maps under {} masks", maps.len(), masks.len()));
    Ok(lines)
}

/// The group of [`representations`].
const WHOLE: &str = "whole map";

/// What a map loses that is only written and read, nothing completed.
fn representations(maps: &[Image], judges: &[Judge]) -> Result<Vec<Line>, PipelineError> {
    let shipped = Bundle::shipped().map_err(CompletionError::from)?;
    let Space::Codes(space) = &shipped.manifest.space else {
        unreachable!("the shipped model's space is codes")
    };
    let level = |map: &Image| {
        let mut values: Vec<f32> = map.data.chunks_exact(3).map(|p| (p[0] + p[1] + p[2]) / 3.0).collect();
        values.sort_by(f32::total_cmp);
        values[values.len() * 9 / 10].max(1e-9)
    };
    let brackets = |map: &Image| {
        let white = level(map) / 0.8;
        let exposed = |ev: f64| {
            map.map(|v| linear_from_srgb(f32::from(srgb8_from_linear(v / white * ev.exp2() as f32)) / 255.0))
        };
        merge(&[0.0, -2.5, -5.0].map(|ev| (ev, exposed(ev)))).map(|v| v * white)
    };
    let codes = |map: &Image| {
        let unit = f64::from(level(map));
        map.map(|v| (space.codes.decode(space.codes.encode(f64::from(v) / unit)) * unit) as f32)
    };
    let ways: [(&str, &dyn Fn(&Image) -> Image); 2] =
        [("8-bit pictures at EV 0, −2.5, −5, merged", &brackets), ("two codes", &codes)];
    ways.iter()
        .map(|(name, way)| {
            let started = Instant::now();
            let errors = maps
                .iter()
                .zip(judges)
                .map(|(map, judge)| judge.errors(&way(map)))
                .collect::<Result<Vec<_>, _>>()
                .map_err(|e| PipelineError::input("map", "a panorama with light", e.to_string()))?;
            let seconds = started.elapsed().as_secs_f64() / maps.len().max(1) as f64;
            let cases: Vec<_> = errors.into_iter().map(|e| (e, seconds)).collect();
            Ok(line(WHOLE, (*name).to_owned(), &cases))
        })
        .collect()
}

/// Means over cases.
fn line(group: &str, completer: String, cases: &[(LightErrors, f64)]) -> Line {
    let n = cases.len() as f64;
    let mean = |f: &dyn Fn(&LightErrors) -> f64| cases.iter().map(|c| f(&c.0)).sum::<f64>() / n;
    let each =
        |f: &dyn Fn(&SphereErrors) -> f64| [0, 1, 2].map(|s| mean(&|e: &LightErrors| f(&e.spheres[s])));
    Line {
        group: group.to_owned(),
        completer,
        cases: cases.len(),
        si_rmse: each(&|s| s.si_rmse),
        angular_deg: each(&|s| s.angular_deg),
        normalized_rmse: each(&|s| s.normalized_rmse),
        irradiance: [mean(&|e| e.irradiance), median(cases.iter().map(|c| c.0.irradiance))],
        peak_deg: median(cases.iter().map(|c| c.0.peak_deg)),
        seconds: median(cases.iter().map(|c| c.1)),
    }
}

/// The mean of several samples of a model.
struct MeanOf(Learned, usize);

impl Completer for MeanOf {
    fn name(&self) -> String {
        format!("{}, mean of {}", self.0.name(), self.1)
    }

    fn complete(&self, partial: &Partial, seed: u64) -> Result<Image, CompletionError> {
        Ok(self.0.samples(partial, seed, self.1)?.mean)
    }
}

/// The lines as a Markdown table.
#[must_use]
pub fn to_markdown(lines: &[Line]) -> String {
    let mut text = String::from(
        "| coverage | completer | si-RMSE mirror | glossy | diffuse | colour angle | normalised RMSE | irradiance (median) | peak | time |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    let three = |v: &[f64; 3], digits: usize| v.map(|x| format!("{x:.digits$}")).join(" / ");
    for l in lines {
        let _ = writeln!(
            text,
            "| {} | {} | {:.3} | {:.3} | {:.3} | {}° | {} | {:.3} ({:.3}) | {:.0}° | {:.3} s |",
            l.group,
            l.completer,
            l.si_rmse[0],
            l.si_rmse[1],
            l.si_rmse[2],
            three(&l.angular_deg, 1),
            three(&l.normalized_rmse, 2),
            l.irradiance[0],
            l.irradiance[1],
            l.peak_deg,
            l.seconds
        );
    }
    let _ = writeln!(text, "\n{} spheres: {SPHERES:?}; angle and RMSE in that order.", SPHERES.len());
    text
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = values.collect();
    v.sort_by(f64::total_cmp);
    v.get(v.len() / 2).copied().unwrap_or(f64::NAN)
}

fn images(folder: &Path, extensions: &[&str]) -> Result<Vec<PathBuf>, PipelineError> {
    let entries = std::fs::read_dir(folder).map_err(|e| PipelineError::io(folder, e))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(Result::ok)
        .map(|e| e.path())
        .filter(|p| extensions.contains(&crate::source::extension(p).as_str()))
        .collect();
    files.sort();
    Ok(files)
}
