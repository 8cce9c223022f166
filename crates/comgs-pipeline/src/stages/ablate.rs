//! `ablate`: what each choice of a decomposition costs in time and memory, and what it gives.

use super::reconstruct::{self, load, train_views};
use crate::tradeoff::{Better, Metric, Row, Sweep, machine};
use crate::{Context, PipelineError, Status, source};
use comgs_compose::relight::{RelightConfig, Relighter, SelfOcclusion};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_inverse::{DecomposeConfig, Decomposed, Observer, Quality, TrainStatus, Visibility, decompose};
use comgs_light::EnvironmentMap;
use comgs_metrics::{MetricError, align_scale, material_error, normal_error, psnr_srgb};
use comgs_raster::{Planes, RasterConfig, render};
use comgs_scene::{AssetKind, Capture, LoadOptions, Split};
use comgs_surfel::activation::{logit, sigmoid};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// Object capture with ground truth (`albedo/`, `normal/` beside the test images).
    pub capture: PathBuf,
    /// Its reconstruction; made in the output folder when absent.
    pub asset: Option<PathBuf>,
    /// Ground truth under other lights (`object_relit/NAME`); looked for beside the capture when absent.
    pub relit: Option<PathBuf>,
    /// Folder for `decompose.csv`, `.md`, `.svg`, `.png`.
    pub output: PathBuf,
    /// The command, as it is to be printed below the plot.
    pub command: String,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Steps of every decomposition.
    pub iterations: u32,
    /// Knobs to turn, by name ([`KNOBS`]); all when empty.
    pub knobs: Vec<String>,
    /// Cameras under each other light, at most.
    pub relit_views: usize,
    /// Quality of the reconstruction, when there is none.
    pub quality: Quality,
    /// Photographs are reduced to this width.
    pub max_width: usize,
    /// Seed.
    pub seed: u64,
}

/// The knobs, in the order of the table.
pub const KNOBS: [&str; 6] = ["visibility", "offset", "probes", "texture", "rays", "chebyshev"];

/// A setting of a knob.
struct Setting {
    knob: &'static str,
    label: &'static str,
    change: fn(&mut DecomposeConfig),
}

fn settings() -> Vec<Setting> {
    let of = |knob, label, change| Setting { knob, label, change };
    vec![
        of("visibility", "probes", |_| {}),
        of("visibility", "trace", |c| c.visibility = Visibility::Trace),
        of("visibility", "none", |c| c.visibility = Visibility::None),
        of("offset", "0 %", |c| c.probe_offset = 0.0),
        of("offset", "1 %", |_| {}),
        of("offset", "2 %", |c| c.probe_offset = 0.02),
        of("probes", "1k", |c| c.probes = 1000),
        of("probes", "5k", |_| {}),
        of("probes", "10k", |c| c.probes = 10_000),
        of("texture", "8²", |c| c.probe_resolution = 8),
        of("texture", "16²", |_| {}),
        of("texture", "32²", |c| c.probe_resolution = 32),
        of("rays", "32", |c| c.rays = 32),
        of("rays", "128", |_| {}),
        of("rays", "512", |c| c.rays = 512),
        of("chebyshev", "off", |_| {}),
        of("chebyshev", "on", |c| c.chebyshev = true),
    ]
}

/// Runs a decomposition for every setting and writes one table and one plot. What is done so far is written after every
/// run, so an interrupted sweep leaves its first rows.
///
/// Times are wall-clock seconds of the decomposition (placing and baking probes included), all in one process, one after
/// the other.
///
/// # Errors
/// [`PipelineError`]: a capture without ground-truth albedo, or what `reconstruct` and `decompose` refuse.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Sweep, PipelineError> {
    if let Some(unknown) = config.knobs.iter().find(|k| !KNOBS.contains(&k.as_str())) {
        return Err(PipelineError::input("--knobs", KNOBS.join(", "), unknown.clone()));
    }
    let asset = match &input.asset {
        Some(asset) => asset.clone(),
        None => {
            let asset = input.output.join("object.asset");
            let made = reconstruct::Input { capture: input.capture.clone(), output: asset.clone() };
            let settings = reconstruct::Config {
                quality: config.quality,
                seed: config.seed,
                max_width: config.max_width,
                ..reconstruct::Config::default()
            };
            reconstruct::run(&made, &settings, context)?;
            asset
        }
    };
    context.progress.begin("ablate decompose");
    let object = source::load_surfels(&asset, AssetKind::Object)?;
    let capture = Capture::open(&input.capture, Split::Train)?;
    let views = train_views(&load(&capture, config.max_width, context)?);
    let truth = Truth::load(input, config, source::raster_config(&object))?;
    let mut sweep = Sweep {
        title: format!("What a decomposition's choices cost: {}", source::name_of(&input.capture)),
        command: input.command.clone(),
        machine: machine(),
        metrics: metrics(!truth.lights.is_empty()),
        rows: Vec::new(),
    };
    let chosen: Vec<Setting> = settings()
        .into_iter()
        .filter(|s| config.knobs.is_empty() || config.knobs.iter().any(|k| k == s.knob))
        .collect();
    let base =
        DecomposeConfig { iterations: config.iterations, seed: config.seed, ..DecomposeConfig::default() };
    // The defaults of all knobs are one and the same run.
    let mut default_run: Option<(f64, BTreeMap<String, f64>)> = None;
    for (i, setting) in chosen.iter().enumerate() {
        context.check()?;
        let mut settings = base.clone();
        (setting.change)(&mut settings);
        let is_default = settings == base;
        let (seconds, values) = match (&default_run, is_default) {
            (Some(run), true) => run.clone(),
            _ => {
                let mut watcher = Watcher { context, done: i, total: chosen.len(), name: setting };
                let made = decompose(&views, &object.surfels, &settings, None, &mut watcher)
                    .map_err(|e| PipelineError::Train { capture: input.capture.clone(), reason: e })?;
                (made.report.seconds, truth.score(&made)?)
            }
        };
        if is_default {
            default_run = Some((seconds, values.clone()));
        }
        sweep.rows.push(Row {
            group: setting.knob.into(),
            label: setting.label.into(),
            is_default,
            seconds,
            values,
        });
        sweep.write(&input.output, "decompose")?;
    }
    context.progress.end(&format!(
        "{} runs; {}",
        sweep.rows.len(),
        input.output.join("decompose.md").display()
    ));
    Ok(sweep)
}

fn metrics(relit: bool) -> Vec<Metric> {
    let mut out = vec![Metric::new("albedo_db", "albedo, aligned", "dB", Better::Up, 2)];
    if relit {
        out.push(Metric::new("relit_db", "relighting, aligned", "dB", Better::Up, 2));
    }
    out.extend([
        Metric::new("normal_deg", "normals", "°", Better::Down, 2),
        Metric::new("step_ms", "a step", "ms", Better::Down, 1),
        Metric::new("probe_mb", "probes", "MB", Better::Down, 1),
    ]);
    out
}

struct TestView {
    camera: Camera,
    mask: Image,
    /// Over black.
    albedo: Image,
    normal: Option<Image>,
}

struct Light {
    map: EnvironmentMap,
    /// Camera and picture over black.
    views: Vec<(Camera, Image)>,
}

/// What decompositions are judged by.
struct Truth {
    raster: RasterConfig,
    views: Vec<TestView>,
    lights: Vec<Light>,
}

impl Truth {
    fn load(input: &Input, config: &Config, raster: RasterConfig) -> Result<Self, PipelineError> {
        let capture = Capture::open(&input.capture, Split::Test)?;
        let mut views = Vec::new();
        for record in &capture.views {
            let beside = record.image.parent().and_then(Path::parent).unwrap_or(Path::new("."));
            let plane = |folder: &str| -> Result<Option<Image>, PipelineError> {
                let path = beside.join(folder).join(format!("{}.exr", record.camera.name));
                Ok(if path.is_file() { Some(comgs_image::read(&path)?.color) } else { None })
            };
            let Some(albedo) = plane("albedo")? else { continue };
            let view = record.load(&LoadOptions::default())?;
            let Some(mask) = view.alpha else { continue };
            let mut albedo = albedo.select(&[0, 1, 2]);
            multiply(&mut albedo, &mask);
            views.push(TestView { camera: view.camera, mask, albedo, normal: plane("normal")? });
        }
        if views.is_empty() {
            return Err(PipelineError::input(
                input.capture.display().to_string(),
                "test views with masks and ground-truth albedo (test/albedo/<name>.exr)",
                "none",
            ));
        }
        let lights = match relit_root(input) {
            Some(root) => read_lights(&root, config.relit_views)?,
            None => Vec::new(),
        };
        Ok(Self { raster, views, lights })
    }

    fn score(&self, made: &Decomposed) -> Result<BTreeMap<String, f64>, PipelineError> {
        let failed =
            |e: MetricError| PipelineError::input("ground truth", "comparable pictures", e.to_string());
        let (mut albedos, mut normals, mut angle) = (Vec::new(), 0, 0.0);
        for view in &self.views {
            let frame = render(&made.cloud, &view.camera, Planes::ALL, &self.raster);
            let Some(material) = &frame.material else { continue };
            albedos.push(material.select(&[0, 1, 2]));
            if let Some(truth) = &view.normal {
                let unit = super::render::unit_normals(&frame, &view.camera);
                angle += normal_error(&unit, truth, Some(&view.mask)).map_err(failed)?.mean_deg;
                normals += 1;
            }
        }
        let estimates: Vec<&Image> = albedos.iter().collect();
        let truths: Vec<&Image> = self.views.iter().map(|v| &v.albedo).collect();
        let masks: Vec<Option<&Image>> = self.views.iter().map(|v| Some(&v.mask)).collect();
        let scale = align_scale(&estimates, &truths, &masks, true).map_err(failed)?;
        let mut albedo = 0.0;
        for (estimate, view) in estimates.iter().zip(&self.views) {
            let error = material_error(estimate, &view.albedo, Some(&view.mask), scale).map_err(failed)?;
            albedo += error.aligned.frame.db / self.views.len() as f64;
        }
        let mut values = BTreeMap::from([
            ("albedo_db".to_owned(), albedo),
            ("step_ms".to_owned(), 1e3 * made.report.step_seconds),
            ("probe_mb".to_owned(), made.report.probe_bytes as f64 / 1e6),
        ]);
        if normals > 0 {
            values.insert("normal_deg".to_owned(), angle / f64::from(normals));
        }
        if !self.lights.is_empty() {
            values.insert("relit_db".to_owned(), self.relit(made, scale, &failed)?);
        }
        Ok(values)
    }

    /// Mean PSNR under the other lights, albedo multiplied by `scale`.
    fn relit(
        &self,
        made: &Decomposed,
        scale: [f64; 3],
        failed: &dyn Fn(MetricError) -> PipelineError,
    ) -> Result<f64, PipelineError> {
        let mut cloud = made.cloud.clone();
        if let Some(material) = &mut cloud.material {
            for albedo in &mut material.albedo_logits {
                for c in 0..3 {
                    albedo[c] = logit((sigmoid(albedo[c]) * scale[c] as f32).clamp(0.001, 0.999));
                }
            }
        }
        let probes = made.probes.as_ref();
        let config = RelightConfig {
            self_occlusion: if probes.is_some() { SelfOcclusion::Probes } else { SelfOcclusion::Trace },
            hidden_probes: made.probe_config.visibility,
            raster: self.raster,
            ..RelightConfig::draft()
        };
        let (mut sum, mut count) = (0.0, 0.0);
        for light in &self.lights {
            let relighter = Relighter::new(&cloud, probes, &light.map, config.clone())
                .map_err(|e| PipelineError::Internal(e.to_string()))?;
            for (camera, truth) in &light.views {
                sum += psnr_srgb(&relighter.render(camera).radiance, truth, None).map_err(failed)?.db;
                count += 1.0;
            }
        }
        Ok(sum / count)
    }
}

/// Puts straight colours over black.
fn multiply(color: &mut Image, alpha: &Image) {
    for (pixel, a) in color.data.chunks_exact_mut(3).zip(&alpha.data) {
        pixel.iter_mut().for_each(|v| *v *= a);
    }
}

/// The relit ground truth that was named, or `object_relit/NAME` beside `object/NAME`.
fn relit_root(input: &Input) -> Option<PathBuf> {
    if input.relit.is_some() {
        return input.relit.clone();
    }
    let absolute = std::path::absolute(&input.capture).ok()?;
    let root = absolute.parent()?.parent()?.join("object_relit").join(absolute.file_name()?);
    root.is_dir().then_some(root)
}

fn read_lights(root: &Path, most: usize) -> Result<Vec<Light>, PipelineError> {
    let cameras = comgs_scene::read_cameras(root)?;
    let mut folders: Vec<PathBuf> = std::fs::read_dir(root)
        .map_err(|e| PipelineError::io(root, e))?
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.is_dir())
        .collect();
    folders.sort();
    let mut lights = Vec::new();
    for folder in folders {
        let name = source::name_of(&folder);
        let path = root.parent().unwrap_or(root).join("envmaps").join(format!("{name}.exr"));
        let image = comgs_image::read(&path)?.color;
        let (map, _) = EnvironmentMap::from_image_repaired(&image).map_err(|e| {
            PipelineError::input(path.display().to_string(), "an environment map", e.to_string())
        })?;
        let every = cameras.len().div_ceil(most.max(1)).max(1);
        let mut views = Vec::new();
        for camera in cameras.iter().step_by(every) {
            let path = folder.join(format!("{}.png", camera.name));
            let picture = comgs_image::read(&path)?;
            let mut color = picture.color;
            if let Some(alpha) = &picture.alpha {
                multiply(&mut color, alpha);
            }
            views.push((camera.clone(), color));
        }
        lights.push(Light { map, views });
    }
    Ok(lights)
}

/// Passes on the progress of one run as a part of the sweep's.
struct Watcher<'a, 'b> {
    context: &'a Context<'b>,
    done: usize,
    total: usize,
    name: &'a Setting,
}

impl Observer for Watcher<'_, '_> {
    fn progress(&mut self, s: &TrainStatus) {
        let share = 1.0 / self.total as f64;
        self.context.progress.update(&Status {
            fraction: Some(share * (self.done as f64 + f64::from(s.fraction))),
            message: format!(
                "run {} of {}: {} {}, {:.1} dB",
                self.done + 1,
                self.total,
                self.name.knob,
                self.name.label,
                s.psnr_db
            ),
            remaining: (s.iteration > 0).then(|| Duration::from_secs_f64(s.remaining_s.clamp(0.0, 1e6))),
        });
    }

    fn cancelled(&self) -> bool {
        self.context.cancel.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every knob has settings, and exactly one of each is the default.
    #[test]
    fn every_knob_has_one_default() {
        let base = DecomposeConfig::default();
        for knob in KNOBS {
            let own: Vec<_> = settings().into_iter().filter(|s| s.knob == knob).collect();
            let defaults = own
                .iter()
                .filter(|s| {
                    let mut c = base.clone();
                    (s.change)(&mut c);
                    c == base
                })
                .count();
            assert!(own.len() >= 2 && defaults == 1, "{knob}");
        }
    }
}
