//! `insert-eval`: how well the light of one photo is found, on the benchmark of DiPIR's Table 2 made from HDR maps.
//!
//! From each map a photo is cut (clipped to white, 8-bit sRGB), an object is put on a known ground plane, and the reference is
//! the same insertion under the map itself. Methods see the photo alone. The reference and every method are rendered by
//! [`comgs_insert::render`], which two other renderers judge (`comgs-synth` in tests, Mitsuba 3 by script), so the
//! differences here are those of light and tone alone.
//!
//! Every method's result is written as it is made; a run that was stopped goes on from there, and a run with a further method or
//! further maps makes only those.

mod case;
mod maps;
mod objects;
mod saved;
mod sheet;
mod table;

use super::insert::Filled;
use crate::stages::insert::{LOBES, read_bundle};
use crate::{Context, PipelineError, Run, RunRecord, Status};
use case::{case, cropped, estimate, picture, scores};
use comgs_image::{Image, write_png};
use comgs_insert::lds::GuidanceBundle;
use comgs_insert::panorama::GroundMeter;
use comgs_insert::render::Samples;
use comgs_insert::session::{LightKind, touched};
use comgs_insert::tone::Response;
use comgs_metrics::MetricError;
use maps::{Chosen, chosen};
use saved::Saved;
use serde::Serialize;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

pub use table::{Row, Scores, markdown};

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Folder of environment maps (`.exr`, `.hdr`), or one map.
    pub maps: PathBuf,
    /// Folder of a guidance bundle, for a row of score distillation.
    pub model: Option<PathBuf>,
    /// Output folder.
    pub output: PathBuf,
    /// The command, for the table's caption.
    pub command: String,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Maps taken, evenly spread over the sorted folder; the paper has 11.
    pub count: usize,
    /// Further maps at most, of those that the shipped completer never saw.
    pub unseen: usize,
    /// Size of the photos in pixels.
    pub size: [usize; 2],
    /// Horizontal field of view in degrees.
    pub fov_deg: f64,
    /// Camera above the ground, metres.
    pub height: f64,
    /// Where the object stands ahead of the camera, metres.
    pub distance: f64,
    /// Samples of every rendering.
    pub samples: Samples,
    /// Iterations of a fit.
    pub iterations: usize,
    /// Rows of the fitted maps.
    pub light_height: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            count: 11,
            unseen: 11,
            size: [384, 256],
            fov_deg: 60.0,
            height: 1.5,
            distance: 4.2,
            samples: Samples { grid: 2, light: 128, shadow: 128, depth: 3 },
            iterations: 600,
            light_height: 32,
            seed: 0,
        }
    }
}

/// Share of the photo's luminance below [`EXPOSED`]: exposure as a camera's meter would have it.
const METERED: f64 = 0.9;
/// Linear value that the [`METERED`] quantile is brought to.
const EXPOSED: f32 = 0.7;
/// Row of the horizon as a share of the height.
const HORIZON: f64 = 0.36;
/// Rows of the panorama that is completed.
const PANORAMA_HEIGHT: usize = 64;

/// A method.
#[derive(Clone, Copy, Debug)]
struct Method {
    name: &'static str,
    light: Estimate,
    response: Response,
}

/// Where a method's light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Estimate {
    /// Even light of the photo's mean.
    Even,
    /// The completed panorama, described as it says.
    Panorama(LightKind, Option<GroundMeter>, Filled),
    /// Score distillation by the bundle that is given, from the panorama's light on.
    Distilled,
    /// The true map reduced to what the optimised maps hold: what the description alone costs.
    True,
}

/// Methods in the order of the table. The photos' own response is [`Response::Clip`].
const METHODS: [Method; 9] = [
    Method { name: "even light", light: Estimate::Even, response: Response::Clip },
    Method {
        name: "panorama without the ground",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), None, Filled::Harmonic),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), Some(GroundMeter::TUNED), Filled::Harmonic),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama, clipped response",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), Some(GroundMeter::TUNED), Filled::Harmonic),
        response: Response::Clip,
    },
    Method {
        name: "panorama, texels",
        light: Estimate::Panorama(LightKind::Texels, Some(GroundMeter::TUNED), Filled::Harmonic),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama, learned completion",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), Some(GroundMeter::TUNED), Filled::Learned),
        response: Response::Reinhard,
    },
    Method {
        name: "panorama, learned, without the ground",
        light: Estimate::Panorama(LightKind::Gaussians(LOBES), None, Filled::Learned),
        response: Response::Reinhard,
    },
    Method { name: "score distillation", light: Estimate::Distilled, response: Response::Clip },
    Method { name: "true map at the fit's resolution", light: Estimate::True, response: Response::Clip },
];

/// What came out.
#[derive(Clone, Debug)]
pub struct Output {
    /// The table as Markdown.
    pub table: PathBuf,
    /// All scores.
    pub rows: Vec<Row>,
    /// The record.
    pub record: RunRecord,
}

/// Runs the benchmark: `insert_eval.{csv,md}`, for every map `<map>.json`, `<map>_{photo,reference}.png`,
/// `<map>_<method>.png`, and `sheet.png` with all of them.
///
/// # Errors
/// [`PipelineError`] when there are no maps, or one cannot be read. [`PipelineError::Cancelled`] says how much is kept.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Output, PipelineError> {
    context.progress.begin("insert-eval");
    let mut run = Run::in_folder("insert-eval", &input.output);
    run.check_output()?;
    let maps = chosen(&input.maps, config.count, config.unseen)?;
    let bundle = input.model.as_deref().map(read_bundle).transpose()?;
    let methods: Vec<Method> =
        METHODS.into_iter().filter(|m| bundle.is_some() || m.light != Estimate::Distilled).collect();
    let inputs = json!({"maps": input.maps, "model": input.model});
    run.describe(String::new(), inputs, config, Some(config.seed))?;
    run.invalidate()?;
    let mut bench = Bench { input, config, bundle, methods, maps: maps.len(), pace: Pace::default() };
    let (mut rows, mut strips) = (Vec::new(), Vec::new());
    for (k, chosen) in maps.iter().enumerate() {
        let left = maps.len() - k;
        let saved = bench.map(chosen, left, &mut run, context).map_err(|error| match error {
            PipelineError::Cancelled { .. } => PipelineError::Cancelled {
                kept: Some(format!(
                    "{k} of {} maps are finished in {}, the next up to the method that was being tried; the same command goes \
                     on from there",
                    maps.len(),
                    input.output.display()
                )),
            },
            other => other,
        })?;
        strips.push(bench.strip(&saved)?);
        rows.extend(bench.methods.iter().filter_map(|m| saved.row(m.name)).cloned());
    }
    let (md, csv) = (input.output.join("insert_eval.md"), input.output.join("insert_eval.csv"));
    let names: Vec<&str> = bench.methods.iter().map(|m| m.name).collect();
    write_text(&md, &markdown(&rows, &names, &input.command))?;
    write_text(&csv, &table::csv(&rows))?;
    let sheet = input.output.join("sheet.png");
    write_png(&sheet, &sheet::contact_sheet(&strips))?;
    for path in [&md, &csv, &sheet] {
        run.output(path)?;
    }
    run.results(json!({"means": table::means(&rows, &names)}));
    let record = run.finish()?;
    context.progress.end(&format!("{} maps: {}", maps.len(), md.display()));
    Ok(Output { table: md, rows, record })
}

/// How fast it goes: results that are made, not those that are taken over.
#[derive(Default)]
struct Pace {
    made: usize,
    seconds: f64,
}

impl Pace {
    fn add(&mut self, seconds: f64) {
        self.made += 1;
        self.seconds += seconds;
    }

    /// Time for `left` more results at the mean pace so far.
    fn remaining(&self, left: usize) -> Option<Duration> {
        let each = (self.made > 0).then(|| self.seconds / self.made as f64)?;
        Some(Duration::from_secs_f64(each * left as f64))
    }
}

/// What all maps share.
struct Bench<'a> {
    input: &'a Input,
    config: &'a Config,
    bundle: Option<GuidanceBundle>,
    methods: Vec<Method>,
    maps: usize,
    pace: Pace,
}

impl Bench<'_> {
    /// File of a picture of a map.
    fn file(&self, map: &str, what: &str) -> PathBuf {
        let what = what.replace(", ", "_").replace([' ', '\''], "_");
        self.input.output.join(format!("{map}_{what}.png"))
    }

    /// One map under every method: what is saved of an earlier run is taken over. `left` maps are to do, this one among them.
    fn map(
        &mut self,
        chosen: &Chosen,
        left: usize,
        run: &mut Run,
        context: &Context<'_>,
    ) -> Result<Saved, PipelineError> {
        let path = self.input.output.join(format!("{}.json", chosen.name));
        let keys = saved::keys(chosen, self.config, self.input.model.as_deref())?;
        let mut saved = Saved::read(&path, &keys, |what| self.file(&chosen.name, what));
        let rendered = saved.crop.is_some();
        let missing: Vec<Method> =
            self.methods.iter().copied().filter(|m| saved.row(m.name).is_none()).collect();
        if !rendered || !missing.is_empty() {
            let case = case(chosen, self.config)?;
            let (methods, maps) = (self.methods.len(), self.maps);
            let say = |pace: &Pace, what: &str, done: usize| {
                let to_do = left * methods - done;
                let fraction = Some(1.0 - to_do as f64 / (maps * methods) as f64);
                let message = format!("{}, map {} of {maps}, {what}", chosen.name, maps - left + 1);
                context.progress.update(&Status { fraction, message, remaining: pace.remaining(to_do) });
            };
            if !rendered {
                say(&self.pace, "reference", 0);
                let (truth, layers) = run.time("reference", || {
                    picture(&case, &case.light, Response::Clip, self.config, context)
                })?;
                for (what, image) in [("photo", &case.photo), ("reference", &truth)] {
                    write_png(&self.file(&chosen.name, what), image)?;
                    saved.picture(what, &self.file(&chosen.name, what))?;
                }
                saved.crop = Some(touched(&layers));
                saved.write(&path)?;
            }
            let truth = read_picture(&self.file(&chosen.name, "reference"))?;
            for method in missing {
                let done = self.methods.iter().filter(|m| saved.row(m.name).is_some()).count();
                say(&self.pace, method.name, done);
                context.check()?;
                let started = Instant::now();
                let light = estimate(&case, method, self.bundle.as_ref(), self.config, context)?;
                let seconds = started.elapsed().as_secs_f64();
                let (image, _) = picture(&case, &light, method.response, self.config, context)?;
                let file = self.file(&chosen.name, method.name);
                write_png(&file, &image)?;
                saved.picture(method.name, &file)?;
                let key = keys.of(method.light == Estimate::Distilled);
                let row = row(chosen, case.object_name, method.name, seconds, &image, &truth, &saved)?;
                saved.add(row, key);
                saved.write(&path)?;
                run.add_time(method.name, seconds, false);
                self.pace.add(started.elapsed().as_secs_f64());
            }
        }
        run.output(&path)?;
        for what in self.pictures() {
            run.output(&self.file(&chosen.name, what))?;
        }
        Ok(saved)
    }

    /// Photo, reference, methods.
    fn pictures(&self) -> impl Iterator<Item = &'static str> {
        let methods: Vec<&'static str> = self.methods.iter().map(|m| m.name).collect();
        ["photo", "reference"].into_iter().chain(methods)
    }

    /// A map's row of the contact sheet.
    fn strip(&self, saved: &Saved) -> Result<Vec<Image>, PipelineError> {
        self.pictures().map(|what| read_picture(&self.file(&saved.map, what))).collect()
    }
}

fn row(
    chosen: &Chosen,
    object: &str,
    method: &str,
    seconds: f64,
    image: &Image,
    truth: &Image,
    saved: &Saved,
) -> Result<Row, PipelineError> {
    let failed = |e: MetricError| PipelineError::Internal(e.to_string());
    let crop = saved.crop.ok_or_else(|| PipelineError::Internal("a row before its reference".into()))?;
    let cut = |im: &Image| cropped(im, crop);
    Ok(Row {
        map: chosen.name.clone(),
        unseen: chosen.unseen,
        object: object.to_owned(),
        method: method.to_owned(),
        seconds,
        whole: scores(image, truth).map_err(failed)?,
        touched: scores(&cut(image), &cut(truth)).map_err(failed)?,
    })
}

/// A picture of this stage, linear, three channels.
fn read_picture(path: &Path) -> Result<Image, PipelineError> {
    let image = comgs_image::read(path)?.color;
    Ok(if image.channels == 1 { image.select(&[0, 0, 0]) } else { image })
}

fn write_text(path: &Path, text: &str) -> Result<(), PipelineError> {
    comgs_image::atomic::write_file(path, |w| w.write_all(text.as_bytes()))
        .map_err(|e| PipelineError::io(path, e))
}
