//! `tradeoff shadow`: what a shadow's accuracy costs, knob by knob, against converged rays and against ground truth.

use crate::stages::editing::{Composition, Settings};
use crate::stages::eval::composition::TruthFrames;
use crate::stages::render_composition::Seen;
use crate::tradeoff::drive::{Measured, Setting, chosen, drive};
use crate::tradeoff::{Better, Metric, Sweep, cpu_seconds, machine};
use crate::{Context, PipelineError, Status};
use comgs_compose::{
    CacheConfig, Caster, ComposeConfig, ComposedFrame, Composer, Denoise, Density, FieldConfig, FieldShadow,
    ReceiverCloud, SceneProbeConfig, SceneProbes, ShadowCache, ShadowConfig, ShadowLight, ShadowLightConfig,
    ShadowRatios, ShadowSource,
};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_inverse::Quality;
use comgs_light::{EnvironmentSampler, SplitConfig};
use comgs_probe::BakeObserver;
use comgs_trace::{TraceConfig, Tracer};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// `composition.json`.
    pub composition: PathBuf,
    /// Composition with ground truth.
    pub truth: Option<PathBuf>,
    /// Folder for `shadow.csv`, `.md`, `.svg`, `.png`.
    pub output: PathBuf,
    /// The command, as it is to be printed below the plot.
    pub command: String,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Knobs to turn, by name ([`KNOBS`]); all when empty.
    pub knobs: Vec<String>,
    /// Cameras, at most.
    pub views: usize,
    /// Rays a pixel of the reference.
    pub reference_rays: u32,
    /// Frames of which the fastest counts.
    pub repeats: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self { knobs: Vec::new(), views: 2, reference_rays: 1024, repeats: 3, seed: 0 }
    }
}

/// The knobs, in the order of the table.
pub const KNOBS: [&str; 8] =
    ["way", "quality", "field", "directions", "split", "cache", "probes", "neighbours"];

/// A way to a shadow.
#[derive(Clone, Debug, PartialEq)]
enum Way {
    Trace(u32, bool),
    Field { field: FieldConfig, light: ShadowLightConfig, cache: Option<CacheConfig> },
    Probes(SceneProbeConfig),
}

fn settings() -> Vec<Setting<Way>> {
    let field = FieldConfig::default();
    let light = ShadowLightConfig::default;
    let cache = CacheConfig::default;
    let probes = SceneProbeConfig::default;
    let plain = || Way::Field { field, light: light(), cache: Some(cache()) };
    let mut out = Vec::new();
    let mut of = |knob: &'static str, label: &str, way: Way| {
        // Knobs that probes have start from the probes.
        let is_default = match knob {
            "probes" | "neighbours" => way == Way::Probes(probes()),
            _ => way == plain(),
        };
        out.push(Setting { knob, label: label.to_owned(), is_default, way });
    };
    of("way", "cached field", plain());
    of("way", "exact field", Way::Field { field, light: light(), cache: None });
    of("way", "10k probes, cached", Way::Probes(probes()));
    of("way", "64 rays", Way::Trace(64, true));
    of("way", "256 rays", Way::Trace(256, true));
    for (label, quality) in
        [("draft", Quality::Draft), ("balanced", Quality::Balanced), ("reference", Quality::Reference)]
    {
        let s = Settings { quality, ..Settings::default() };
        of("quality", label, Way::Field { field: s.field(), light: s.light(), cache: Some(s.cache()) });
    }
    for (directions, resolution) in [(8, 64), (16, 32), (16, 64), (16, 96)] {
        let field = FieldConfig { directions, resolution };
        let label = format!("{directions}² × {resolution}²");
        of("field", &label, Way::Field { field, light: light(), cache: Some(cache()) });
    }
    for directions in [64, 256, 1024] {
        let light = ShadowLightConfig { directions, ..light() };
        of("directions", &directions.to_string(), Way::Field { field, light, cache: Some(cache()) });
    }
    for (label, split, beam_rays) in
        [("off", false, 1), ("4 rays", true, 4), ("16 rays", true, 16), ("64 rays", true, 64)]
    {
        let light = ShadowLightConfig { split: split.then(SplitConfig::default), beam_rays, ..light() };
        of("split", label, Way::Field { field, light, cache: Some(cache()) });
    }
    for (tolerance, pixels) in [(0.05, 4.0), (0.02, 2.0), (0.01, 2.0), (0.005, 1.0)] {
        let config = CacheConfig { tolerance, pixels, ..cache() };
        of(
            "cache",
            &format!("{tolerance}, {pixels} px"),
            Way::Field { field, light: light(), cache: Some(config) },
        );
    }
    for (label, count, resolution, density) in [
        ("2.5k", 2500, 16, Density::Adaptive),
        ("10k", 10_000, 16, Density::Adaptive),
        ("10k, even", 10_000, 16, Density::Uniform),
        ("10k, 8²", 10_000, 8, Density::Adaptive),
    ] {
        of("probes", label, Way::Probes(SceneProbeConfig { count, resolution, density, ..probes() }));
    }
    for neighbours in [4, 8, 16] {
        of("neighbours", &neighbours.to_string(), Way::Probes(SceneProbeConfig { neighbours, ..probes() }));
    }
    out
}

/// Runs all settings and writes one table and one plot; after every run what is done so far.
///
/// Seconds are of a frame, the fastest of some; its processor time, a mean, and the preparation stand beside it. Errors: PSNR of the shadow ratio against
/// rays in the pixels that those darken by 5 % or more; with ground truth, PSNR of the frame in the true shadow region.
/// Objects keep the light of their captures, so that the object's error does not enter.
///
/// # Errors
/// [`PipelineError`].
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Sweep, PipelineError> {
    let chosen = chosen(settings(), &config.knobs, &KNOBS)?;
    context.progress.begin("tradeoff shadow");
    let composition = Composition::load(&input.composition, None, |text| context.progress.warn(&text))?;
    let truth = input.truth.as_ref().map(|t| TruthFrames::new(t)).transpose()?;
    let bench = Bench::new(&composition, config, truth, context)?;
    let sweep = Sweep {
        title: "What a shadow's accuracy costs".to_owned(),
        command: input.command.clone(),
        machine: machine(),
        metrics: metrics(bench.truth.is_some()),
        rows: Vec::new(),
    };
    drive(sweep, &chosen, &input.output, "shadow", context, |setting| bench.measure(&setting.way, context))
}

fn metrics(truth: bool) -> Vec<Metric> {
    let mut out = vec![Metric::new("ratio_db", "ratio against rays", "dB", Better::Up, 2)];
    if truth {
        out.push(Metric::new("truth_db", "shadow region against truth", "dB", Better::Up, 2));
    }
    out.extend([
        Metric::new("cpu_ms", "processor time of a frame", "ms", Better::Down, 1),
        Metric::new("shadow_ms", "shadow of a frame", "ms", Better::Down, 1),
        Metric::new("prepare_s", "preparation", "s", Better::Down, 2),
        Metric::new("bake_s", "of it, once an object", "s", Better::Down, 2),
        Metric::new("memory_mb", "memory", "MB", Better::Down, 1),
    ]);
    out
}

/// What every setting is measured on.
struct Bench<'a> {
    composition: &'a Composition,
    config: &'a Config,
    scene_tracer: Tracer,
    sampler: EnvironmentSampler,
    cameras: Vec<Camera>,
    truth: Option<TruthFrames>,
    /// Ratios of the reference.
    reference: Vec<Image>,
    seen: ReceiverCloud,
}

/// Ratio of the reference below which a pixel is in shadow.
const IN_SHADOW: f32 = 0.95;

impl<'a> Bench<'a> {
    fn new(
        composition: &'a Composition,
        config: &'a Config,
        truth: Option<TruthFrames>,
        context: &Context<'_>,
    ) -> Result<Self, PipelineError> {
        let n = composition.cameras.len().min(config.views.max(1));
        let cameras: Vec<Camera> =
            (0..n).map(|k| composition.cameras[k * composition.cameras.len() / n].clone()).collect();
        let mut bench = Self {
            composition,
            config,
            scene_tracer: Tracer::new(&composition.scene.surfels, &TraceConfig::default())?,
            sampler: EnvironmentSampler::new(&composition.map),
            cameras,
            truth,
            reference: Vec::new(),
            seen: ReceiverCloud::default(),
        };
        let composer = bench.composer(Some((config.reference_rays, false)))?;
        let mut reference = Vec::new();
        for camera in &bench.cameras {
            context.check()?;
            context.progress.update(&Status {
                fraction: None,
                message: format!("reference of {}, {} rays", camera.name, config.reference_rays),
                remaining: None,
            });
            reference.push(composer.frame(camera).shadow);
        }
        let seen = Seen::new(&composer, &bench.cameras, Vec::new(), context)?.cloud;
        drop(composer);
        (bench.reference, bench.seen) = (reference, seen);
        Ok(bench)
    }

    fn composer(&self, rays: Option<(u32, bool)>) -> Result<Composer<'_>, PipelineError> {
        let shadow = rays.map(|(rays, smooth)| ShadowConfig {
            rays,
            seed: self.config.seed,
            denoise: if smooth { Denoise::default() } else { Denoise::Off },
            ..ShadowConfig::default()
        });
        let config = ComposeConfig { raster: self.composition.raster(), shadow, ..ComposeConfig::default() };
        let (scene, placed) = (&self.composition.scene.surfels, self.composition.placed());
        Ok(Composer::new(scene, &self.scene_tracer, &placed, &self.sampler, config)?)
    }

    /// Seconds of a frame, and measures.
    fn measure(&self, way: &Way, context: &Context<'_>) -> Result<Measured, PipelineError> {
        match way {
            Way::Trace(rays, smooth) => {
                let composer = self.composer(Some((*rays, *smooth)))?;
                // A traced frame takes seconds: once is enough.
                self.judge(1, [0.0; 3], &|c| composer.frame(c))
            }
            Way::Field { field, light, cache } => {
                let start = Instant::now();
                let cancelled = || context.cancel.is_cancelled();
                let mut casters = Vec::new();
                for object in &self.composition.objects {
                    let caster = Caster::new(&object.subject.asset.surfels, *field, None, &cancelled)
                        .map_err(|e| PipelineError::input(&object.name, "a caster", e.to_string()))?;
                    casters.push((caster, object.world_from_object));
                }
                let bake_s = start.elapsed().as_secs_f64();
                let placed: Vec<_> = casters.iter().map(|(c, s)| (c, *s)).collect();
                let start = Instant::now();
                let light = self.light(light)?;
                let exact = FieldShadow::new(&light, &placed);
                let bytes: usize = casters.iter().map(|c| c.0.field.memory_bytes()).sum();
                self.judge_exact(&exact, cache.as_ref(), start, bake_s, bytes)
            }
            Way::Probes(config) => {
                let composer = self.composer(None)?;
                let tracer = Tracer::new(composer.objects(), &TraceConfig::occlusion())?;
                let start = Instant::now();
                let light = self.light(&ShadowLightConfig::default())?;
                let probes = SceneProbes::bake(
                    &self.seen,
                    &light,
                    &tracer,
                    self.composition.spheres(),
                    config,
                    BakeObserver::silent(),
                )
                .map_err(|e| PipelineError::input("scene probes", "probes", e.to_string()))?;
                let bytes = probes.set().memory_bytes();
                self.judge_exact(&probes, Some(&CacheConfig::default()), start, 0.0, bytes)
            }
        }
    }

    fn light(&self, config: &ShadowLightConfig) -> Result<ShadowLight, PipelineError> {
        ShadowLight::new(&self.composition.map, &self.composition.lamps, config)
            .map_err(|e| PipelineError::input("the composition's lamps", "lights", e.to_string()))
    }

    fn judge_exact(
        &self,
        exact: &dyn ShadowRatios,
        cache: Option<&CacheConfig>,
        start: Instant,
        bake_s: f64,
        bytes: usize,
    ) -> Result<Measured, PipelineError> {
        let composer = self.composer(None)?;
        let cache = cache.map(|config| ShadowCache::build(&self.seen, exact, config));
        let prepare_s = start.elapsed().as_secs_f64() + bake_s;
        let bytes = bytes + cache.as_ref().map_or(0, |c| c.statistics().bytes);
        let source = match &cache {
            Some(cache) => ShadowSource::Cached(cache, exact),
            None => ShadowSource::Exact(exact),
        };
        let repeats = if cache.is_some() { self.config.repeats.max(1) } else { 1 };
        self.judge(repeats, [prepare_s, bake_s, bytes as f64 / 1e6], &|c| {
            composer.frame_with(c, source, None)
        })
    }

    fn judge(
        &self,
        repeats: usize,
        [prepare_s, bake_s, memory_mb]: [f64; 3],
        frame: &dyn Fn(&Camera) -> ComposedFrame,
    ) -> Result<Measured, PipelineError> {
        let (mut frame_s, mut shadow_s, mut square, mut counted) = (0.0, 0.0, 0.0f64, 0usize);
        let (mut truth_db, mut cpu_s) = (Vec::new(), 0.0);
        for (camera, reference) in self.cameras.iter().zip(&self.reference) {
            let mut best = (f64::INFINITY, f64::INFINITY);
            let mut last = None;
            let cpu = cpu_seconds();
            for _ in 0..repeats {
                let start = Instant::now();
                let made = frame(camera);
                best = (best.0.min(start.elapsed().as_secs_f64()), best.1.min(made.stats.shadow_s));
                last = Some(made);
            }
            let Some(made) = last else { continue };
            // Zero where the system does not tell.
            cpu_s += cpu.zip(cpu_seconds()).map_or(0.0, |(from, to)| to - from) / repeats as f64;
            frame_s += best.0;
            shadow_s += best.1;
            for (a, t) in made.shadow.data.chunks_exact(3).zip(reference.data.chunks_exact(3)) {
                if t[1] < IN_SHADOW {
                    square += (0..3).map(|c| f64::from(a[c] - t[c]).powi(2)).sum::<f64>();
                    counted += 3;
                }
            }
            if let Some(scores) =
                self.truth.as_ref().map(|t| t.judge(&camera.name, &made.beauty)).transpose()?
            {
                truth_db.extend(scores.and_then(|s| s.shadow).map(|s| s.psnr_db));
            }
        }
        let n = self.cameras.len().max(1) as f64;
        let ratio_db = -10.0 * (square / counted.max(1) as f64).log10();
        let mut values = BTreeMap::from([
            ("ratio_db".to_owned(), if counted > 0 { ratio_db } else { f64::NAN }),
            ("shadow_ms".to_owned(), 1e3 * shadow_s / n),
            ("prepare_s".to_owned(), prepare_s),
            ("bake_s".to_owned(), bake_s),
            ("memory_mb".to_owned(), memory_mb),
        ]);
        if cpu_s > 0.0 {
            values.insert("cpu_ms".to_owned(), 1e3 * cpu_s / n);
        }
        if self.truth.is_some() && !truth_db.is_empty() {
            values.insert("truth_db".to_owned(), truth_db.iter().sum::<f64>() / truth_db.len() as f64);
        }
        Ok((frame_s / n, values))
    }
}
