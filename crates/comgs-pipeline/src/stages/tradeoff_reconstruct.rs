//! `tradeoff reconstruct`: what steps, image size, surfels and presets of a reconstruction cost, and what they give at views that
//! were held out.

use super::{eval, reconstruct};
use crate::tradeoff::drive::{Measured, Setting, chosen, drive};
use crate::tradeoff::{Better, Metric, Sweep, machine};
use crate::{Context, PipelineError, source};
use comgs_inverse::Quality;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Any capture; views are held out where it has no test split.
    pub capture: PathBuf,
    /// Folder for `reconstruct.csv`, `.md`, `.svg`, `.png`.
    pub output: PathBuf,
    /// Folder for the assets. A run whose asset is there already is read, with the time that it took.
    pub assets: PathBuf,
    /// The command, as it is to be printed below the plot.
    pub command: String,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Knobs to turn, by name ([`KNOBS`]); all but `quality` when empty.
    pub knobs: Vec<String>,
    /// Steps where another knob is turned; more and fewer are tried around it.
    pub iterations: u32,
    /// Width of the photographs where another knob is turned.
    pub width: usize,
    /// Limit on surfels where another knob is turned.
    pub surfels: usize,
    /// Runs with seeds one after the other of which the mean is shown.
    pub repeats: u64,
    /// First seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self { knobs: Vec::new(), iterations: 1000, width: 400, surfels: 20_000, repeats: 1, seed: 0 }
    }
}

/// The knobs, in the order of the table. The presets take as long as they take, so they run only where they are asked for.
pub const KNOBS: [&str; 4] = ["iterations", "width", "surfels", "quality"];

/// A reconstruction.
#[derive(Clone, Debug, PartialEq)]
struct Way {
    iterations: Option<u32>,
    width: usize,
    surfels: Option<usize>,
    quality: Quality,
}

fn settings(config: &Config) -> Vec<Setting<Way>> {
    let plain = Way {
        iterations: Some(config.iterations),
        width: config.width,
        surfels: Some(config.surfels),
        quality: Quality::Balanced,
    };
    let mut out = Vec::new();
    let mut of = |knob: &'static str, label: String, way: Way| {
        let is_default = way == plain;
        out.push(Setting { knob, label, is_default, way });
    };
    for share in [0.125, 0.25, 0.5, 1.0, 2.0] {
        let iterations = ((f64::from(config.iterations) * share).round() as u32).max(1);
        of("iterations", iterations.to_string(), Way { iterations: Some(iterations), ..plain.clone() });
    }
    for divisor in [4, 2, 1] {
        let width = (config.width / divisor).max(16);
        of("width", format!("{width} px"), Way { width, ..plain.clone() });
    }
    for share in [0.25, 0.5, 1.0, 2.0] {
        let surfels = ((config.surfels as f64 * share).round() as usize).max(16);
        of("surfels", surfels.to_string(), Way { surfels: Some(surfels), ..plain.clone() });
    }
    // The presets see the photographs whole.
    for (label, quality) in
        [("draft", Quality::Draft), ("balanced", Quality::Balanced), ("reference", Quality::Reference)]
    {
        let width = reconstruct::Config::default().max_width;
        of("quality", label.to_owned(), Way { iterations: None, width, surfels: None, quality });
    }
    out
}

/// Reconstructs with every setting and writes one table and one plot; after every run what is done so far. An interrupted sweep
/// goes on with the same command: assets that are done are not made again, a run that was cut off continues from its checkpoint.
///
/// Seconds are wall-clock seconds of the stage as its record has them. Scores are those of `eval` at the held-out views in full
/// size.
///
/// # Errors
/// [`PipelineError`]: what `reconstruct` and `eval` refuse; [`PipelineError::Cancelled`].
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Sweep, PipelineError> {
    let knobs = match config.knobs.is_empty() {
        true => KNOBS.iter().filter(|k| **k != "quality").map(|k| (*k).to_owned()).collect(),
        false => config.knobs.clone(),
    };
    let chosen = chosen(settings(config), &knobs, &KNOBS)?;
    let sweep = Sweep {
        title: format!(
            "What a reconstruction's steps, pixels and surfels cost: {}",
            source::name_of(&input.capture)
        ),
        command: input.command.clone(),
        machine: machine(),
        metrics: vec![
            Metric::new("psnr_db", "held-out photos", "dB", Better::Up, 2),
            Metric::new("ssim", "SSIM", "", Better::Up, 4),
            Metric::new("normal_deg", "normals", "°", Better::Down, 2),
            Metric::new("depth_mae", "depth, MAE", "", Better::Down, 4),
            Metric::new("surfels", "surfels", "", Better::Down, 0),
        ],
        rows: Vec::new(),
    };
    let mut sweep = drive(sweep, &chosen, &input.output, "reconstruct", context, |setting| {
        measure(input, config, &setting.way, context)
    })?;
    // What the capture does not know is no column.
    let rows = &sweep.rows;
    sweep.metrics.retain(|m| rows.iter().any(|r| r.values.contains_key(&m.key)));
    sweep.write(&input.output, "reconstruct")?;
    Ok(sweep)
}

fn measure(
    input: &Input,
    config: &Config,
    way: &Way,
    context: &Context<'_>,
) -> Result<Measured, PipelineError> {
    let n = config.repeats.max(1);
    let mut sums: BTreeMap<String, f64> = BTreeMap::new();
    let mut seconds = 0.0;
    for seed in config.seed..config.seed + n {
        let part = |value: Option<String>| value.unwrap_or_else(|| "preset".to_owned());
        let quality = format!("{:?}", way.quality).to_lowercase();
        let (steps, surfels) = (way.iterations.map(|v| v.to_string()), way.surfels.map(|v| v.to_string()));
        let name = format!("{quality}-{}-{}-{}-{seed}.asset", part(steps), way.width, part(surfels));
        let asset = input.assets.join(name);
        let settings = reconstruct::Config {
            quality: way.quality,
            iterations: way.iterations,
            max_surfels: way.surfels,
            max_width: way.width,
            seed,
            resume: reconstruct::Resume::IfThere,
            ..reconstruct::Config::default()
        };
        let made = reconstruct::Input { capture: input.capture.clone(), output: asset.clone() };
        let made = reconstruct::run(&made, &settings, context)?;
        seconds += made.record.timings.iter().map(|t| t.seconds).sum::<f64>();
        let judged = eval::Input { subject: asset, against: input.capture.clone(), relit: None, json: None };
        let scores = eval::run(&judged, context)?;
        let mut add = |key: &str, value: Option<f64>| {
            if let Some(value) = value {
                *sums.entry(key.to_owned()).or_default() += value / n as f64;
            }
        };
        if let Some(section) = scores.section("test") {
            for (key, column) in [
                ("psnr_db", "psnr_db"),
                ("ssim", "ssim"),
                ("normal_deg", "normal.mean_deg"),
                ("depth_mae", "depth.mae"),
            ] {
                add(key, section.table.mean(column));
            }
        }
        add("surfels", made.record.results["surfels"].as_f64());
    }
    Ok((seconds / n as f64, sums))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every knob but the presets turns around the defaults, which are one way; no two ways share an asset.
    #[test]
    fn knobs_turn_around_the_defaults() {
        let all = settings(&Config::default());
        for knob in ["iterations", "width", "surfels"] {
            let defaults = all.iter().filter(|s| s.knob == knob && s.is_default).count();
            assert!(defaults == 1 && all.iter().filter(|s| s.knob == knob).count() > 2, "{knob}");
        }
        assert!(
            all.iter().filter(|s| s.knob == "quality").all(|s| !s.is_default && s.way.iterations.is_none())
        );
    }
}
