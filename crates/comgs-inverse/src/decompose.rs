//! Step 2: from a reconstructed object to material, light and visibility (ComGS §3.1.2).
//!
//! The surfels get albedo, roughness and metallic columns; the light the object was captured under becomes an octahedral
//! environment map; what occludes and what is reflected from the object itself comes from Surface Octahedral Probes. Each
//! step draws a few patches from as many views, renders their G-buffers, shades them ([`shade`], Eq. 6–8), compares
//! with the photos, and carries the gradient through shading and rasteriser to every parameter. The loss is Eq. 14:
//!
//! ```text
//! L = L_pbr + λ_lam L_lam + λ_sops L_sops + λ_d2n L_d2n + λ_mask L_mask
//! ```
//!
//! and the prior of [`scale`] on what photos cannot tell. Geometry moves at a tenth of its rates; the radiance
//! (harmonics) of step 1 stays as it is: it is what the probes saw.
//!
//! The same loop runs with traced rays instead of probes and without any occlusion, so that the three can be compared.
//!
//! Modules in the order of the work: [`config`], [`probes`] (where they stand and what they see), `trainer` (a step) with
//! `patch` (its pixels), [`gbuffer`] (its shading points), [`proposal`] and [`shade`] (their radiance), [`scale`] (the prior),
//! and `checkpoint`.

mod checkpoint;
pub mod config;
pub mod gbuffer;
mod patch;
pub mod probes;
pub mod proposal;
pub mod scale;
pub mod shade;
mod trainer;

use crate::TrainError;
use crate::train::{MIN_VIEWS, Observer, TrainStatus, near_plane};
use crate::view::{Rig, TrainView};
use comgs_geom::Rng;
use comgs_light::{LightPyramid, OctahedralLight, luminance};
use comgs_optim::Adam;
use comgs_probe::{BakeObserver, LookupConfig, ProbeConfig, ProbeError, ProbeIndex, ProbeSet};
use comgs_raster::{Planes, RasterConfig};
use comgs_surfel::activation::{logit, sigmoid};
use comgs_surfel::{MaterialColumns, SurfelCloud};
use comgs_trace::{TraceConfig, Tracer};
pub use config::{AlbedoScale, DecomposeConfig, Visibility};
pub use gbuffer::shading_points;
use glam::{DVec3, Vec3};
use patch::Source;
use std::time::Instant;
use trainer::Trainer;

/// How a decomposition went.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct DecomposeReport {
    /// Steps done.
    pub iterations: u32,
    /// Seconds for everything.
    pub seconds: f64,
    /// Seconds until the first step: G-buffers, fusion, probes.
    pub init_seconds: f64,
    /// Seconds of that for baking the probes.
    pub bake_seconds: f64,
    /// Mean seconds of a step.
    pub step_seconds: f64,
    /// Share of a step spent on shading (probe look-ups, rays, BRDF, forward and back).
    pub shading_share: f64,
    /// Shading points of a step on average.
    pub points_per_step: f64,
    /// Oriented points that fusion found.
    pub fused_points: usize,
    /// Share of the pixels with a surface that fusion made points of.
    pub fused_share: f32,
    /// Probes; 0 without.
    pub probes: usize,
    /// Bytes of the probes' textures and places.
    pub probe_bytes: usize,
    /// Running mean of the patches' PSNR in dB.
    pub train_psnr_db: f32,
    /// Mean albedo (luminance) over the surfels, by opacity.
    pub mean_albedo: f32,
    /// How the scale of albedo and light was fixed, in words.
    pub scale: String,
    /// The factor a channel that an explicit scale applied to the prior's albedo.
    pub scale_factor: [f32; 3],
    /// Non-finite gradient entries that were dropped.
    pub dropped_gradients: u64,
    /// Things the user should know.
    pub warnings: Vec<String>,
}

/// A relightable object.
#[derive(Clone, Debug)]
pub struct Decomposed {
    /// The surfels, with material.
    pub cloud: SurfelCloud,
    /// The light it was captured under.
    pub light: OctahedralLight,
    /// What its surroundings look like from its surface; `None` with [`Visibility::None`] and [`Visibility::Trace`].
    pub probes: Option<ProbeSet>,
    /// How those are looked up.
    pub probe_config: ProbeConfig,
    /// How it went.
    pub report: DecomposeReport,
}

/// Everything that a step changes.
pub(crate) struct State {
    pub iteration: u32,
    pub cloud: SurfelCloud,
    pub pyramid: LightPyramid,
    /// Empty without probes.
    pub textures: Vec<[f32; 4]>,
    /// Moments of positions, rotations, log scales, opacities, material.
    pub adam: [Adam; 5],
    /// Moments of the light's levels.
    pub adam_light: Vec<Adam>,
    /// Moments of the probe textures; empty when they are fixed.
    pub adam_probes: Adam,
    pub rng: Rng,
    pub queue: Vec<u32>,
    pub dropped_gradients: u64,
    pub psnr_db: f32,
    pub elapsed_s: f64,
}

/// Roughness and metallic at the start.
const INITIAL_ROUGHNESS: f32 = 0.5;
const INITIAL_METALLIC: f32 = 0.1;
/// Decomposes a reconstructed object into material and light.
///
/// * `views`: the photos that `cloud` was reconstructed from, with masks
/// * `cloud`: from [`crate::train()`]; material that it has already is where the optimisation starts
/// * `resume`: bytes that [`Observer::checkpoint`] got from the same views, cloud and configuration
///
/// The same inputs and seed give the same bytes at any thread count, unless there is a time budget.
///
/// # Errors
/// [`TrainError`]: no masks, too few views, a configuration out of range, a cloud that no two views agree on.
pub fn decompose(
    views: &[TrainView],
    cloud: &SurfelCloud,
    config: &DecomposeConfig,
    resume: Option<&[u8]>,
    observer: &mut dyn Observer,
) -> Result<Decomposed, TrainError> {
    let start = Instant::now();
    let mut report = DecomposeReport::default();
    let (rig, sources) = check(views, cloud, config, &mut report)?;
    let raster = RasterConfig { near: near_plane(&rig), transmittance_min: 1e-3, ..Default::default() };
    observer.progress(&TrainStatus {
        phase: "placing probes",
        iterations: config.iterations,
        ..Default::default()
    });

    let scene = Visible::new(views, cloud, config, &raster, &mut report, observer)?;
    report.init_seconds = start.elapsed().as_secs_f64();
    let identity = checkpoint::identity(views, cloud);
    let mut state = match resume {
        Some(bytes) => checkpoint::from_bytes(bytes, config, &identity).map_err(TrainError::Checkpoint)?,
        None => initial_state(&sources, cloud, &scene, config),
    };
    let mut trainer = Trainer::new(&sources, config, &rig, raster, scene);
    let already = state.elapsed_s;
    let mut last_report = Instant::now();
    let mut next_preview = 0.0f32;
    let first = state.iteration;
    let loop_start = Instant::now();
    loop {
        state.elapsed_s = already + start.elapsed().as_secs_f64();
        let by_steps = state.iteration as f32 / config.iterations as f32;
        let by_clock =
            config.time_budget.map_or(0.0, |b| (state.elapsed_s / b.as_secs_f64().max(1e-3)) as f32);
        let progress = by_steps.max(by_clock);
        if progress >= 1.0 {
            break;
        }
        if observer.cancelled() {
            observer.checkpoint(checkpoint::to_bytes(&state, config, &identity));
            return Err(TrainError::Cancelled(state.iteration));
        }
        trainer.step(&mut state, progress);
        if progress >= next_preview {
            let (name, image) = trainer.preview(&state, &views[0]);
            observer.preview(&name, &image);
            next_preview = progress + 0.05;
        }
        if last_report.elapsed().as_secs_f64() > 0.2 {
            last_report = Instant::now();
            let elapsed_s = start.elapsed().as_secs_f64();
            let each = loop_start.elapsed().as_secs_f64() / f64::from((state.iteration - first).max(1));
            let by_steps = each * f64::from(config.iterations - state.iteration.min(config.iterations));
            let by_budget = config.time_budget.map(|b| (b.as_secs_f64() - state.elapsed_s).max(0.0));
            observer.progress(&TrainStatus {
                phase: "separating material and light",
                iteration: state.iteration,
                iterations: config.iterations,
                fraction: progress,
                psnr_db: state.psnr_db,
                surfels: state.cloud.len(),
                elapsed_s,
                remaining_s: by_budget.map_or(by_steps, |b| b.min(by_steps)),
            });
        }
        if observer.wants_checkpoint() {
            observer.checkpoint(checkpoint::to_bytes(&state, config, &identity));
        }
    }
    let steps = f64::from((state.iteration - first).max(1));
    report.step_seconds = loop_start.elapsed().as_secs_f64() / steps;
    report.shading_share = trainer.shading_seconds / loop_start.elapsed().as_secs_f64().max(1e-9);
    report.points_per_step = trainer.points_shaded as f64 / steps;
    finish(state, trainer, &sources, config, report, start)
}

/// What the steps share and do not change: who sees what.
struct Visible {
    tracer: Option<Tracer>,
    /// Textures as they were baked: the goal of Eq. 13.
    probes: Option<ProbeSet>,
    index: Option<ProbeIndex>,
    lookup: Option<LookupConfig>,
    trace_offset: f32,
}

impl Visible {
    fn new(
        views: &[TrainView],
        cloud: &SurfelCloud,
        config: &DecomposeConfig,
        raster: &RasterConfig,
        report: &mut DecomposeReport,
        observer: &mut dyn Observer,
    ) -> Result<Self, TrainError> {
        let mut out = Self {
            tracer: None,
            probes: None,
            index: None,
            lookup: None,
            trace_offset: config.probe_offset.max(1e-3) * probes::object_size(cloud),
        };
        if config.visibility == Visibility::None {
            return Ok(out);
        }
        let tracer = Tracer::new(cloud, &TraceConfig::default())
            .map_err(|e| TrainError::Config(format!("the object cannot be traced: {e}")))?;
        if config.visibility == Visibility::Trace {
            out.tracer = Some(tracer);
            return Ok(out);
        }
        let cameras: Vec<_> = views.iter().map(|v| &v.camera).collect();
        let mut set = probes::place(&cameras, cloud, config, raster, report)?;
        let cancelled = || observer.cancelled();
        let start = Instant::now();
        let watcher = BakeObserver { cancelled: &cancelled, progress: &|_| {} };
        comgs_probe::bake(&tracer, &mut set, 1, watcher).map_err(|e| match e {
            ProbeError::Cancelled { .. } => TrainError::Cancelled(0),
            other => TrainError::Probes(other.to_string()),
        })?;
        report.bake_seconds = start.elapsed().as_secs_f64();
        report.probes = set.len();
        report.probe_bytes = set.memory_bytes();
        let probe_config = probes::probe_config(config);
        out.lookup = Some(LookupConfig::new(&set, &probe_config));
        out.index = Some(set.index(&probe_config));
        out.probes = Some(set);
        Ok(out)
    }
}

fn check(
    views: &[TrainView],
    cloud: &SurfelCloud,
    config: &DecomposeConfig,
    report: &mut DecomposeReport,
) -> Result<(Rig, Vec<Source>), TrainError> {
    if let Some(problem) = config.check().into_iter().next() {
        return Err(TrainError::Config(problem));
    }
    if let Some(problem) = cloud.problems().into_iter().next() {
        return Err(TrainError::Config(format!("the object's surfels are unsound: {problem}")));
    }
    if cloud.is_empty() {
        return Err(TrainError::Vanished);
    }
    if views.len() < MIN_VIEWS {
        return Err(TrainError::TooFewViews(views.len()));
    }
    let missing = views.iter().filter(|v| v.mask.is_none()).count();
    if missing > 0 {
        return Err(TrainError::NoMasks { missing, total: views.len() });
    }
    if let AlbedoScale::GreyCard { view, x, y, .. } = config.albedo_scale {
        let inside = views.get(view).is_some_and(|v| x < v.camera.width && y < v.camera.height);
        if !inside {
            return Err(TrainError::Config(format!(
                "the grey card's pixel {x},{y} of view {view} does not exist"
            )));
        }
    }
    let cameras: Vec<_> = views.iter().map(|v| &v.camera).collect();
    let rig = Rig::new(&cameras).ok_or(TrainError::TooFewViews(0))?;
    let sources: Vec<Source> = views.iter().map(Source::new).collect();
    let empty = sources.iter().filter(|s| !s.is_useful()).count();
    if empty == sources.len() {
        return Err(TrainError::EmptyHull);
    }
    if empty > 0 {
        report.warnings.push(format!("{empty} views show nothing of the object and are not used"));
    }
    if views.iter().any(|v| !v.hdr) {
        report.warnings.push(
            "the photos are not HDR: what they clipped limits how bright the recovered light can be".into(),
        );
    }
    Ok((rig, sources))
}

/// Grey light as bright as the prior wants it, the photos' mean colours as albedo, and what a mid surface is otherwise.
fn initial_state(
    sources: &[Source],
    cloud: &SurfelCloud,
    scene: &Visible,
    config: &DecomposeConfig,
) -> State {
    let (sum, count) =
        sources.iter().map(Source::radiance_sum).fold((DVec3::ZERO, 0), |a, b| (a.0 + b.0, a.1 + b.1));
    let mean = (sum / count.max(1) as f64).as_vec3();
    let level = scale::initial_light(mean, config.albedo_mean);
    let mut cloud = cloud.clone();
    let n = cloud.len();
    if cloud.material.is_none() {
        let albedo = |i: usize| {
            // The constant harmonic: what the surfel looks like on average.
            let mean = mean_radiance(&cloud, i) / level;
            mean.to_array().map(|a| logit(a.clamp(0.03, 0.9)))
        };
        cloud.material = Some(MaterialColumns {
            albedo_logits: (0..n).map(albedo).collect(),
            metallic_logits: vec![logit(INITIAL_METALLIC); n],
            roughness_logits: vec![logit(INITIAL_ROUGHNESS); n],
        });
    }
    let pyramid = LightPyramid::constant(config.light_size, Vec3::splat(level));
    let moving = scene.probes.as_ref().filter(|_| config.probe_rate > 0.0);
    let textures = moving.map_or(Vec::new(), |p| p.texels.clone());
    State {
        iteration: 0,
        adam: [3 * n, 4 * n, 2 * n, n, 5 * n].map(Adam::new),
        adam_light: pyramid.levels.iter().map(|l| Adam::new(l.len())).collect(),
        adam_probes: Adam::new(4 * textures.len()),
        cloud,
        pyramid,
        textures,
        rng: Rng::new(config.seed),
        queue: Vec::new(),
        dropped_gradients: 0,
        psnr_db: 0.0,
        elapsed_s: 0.0,
    }
}

/// Radiance of a surfel's constant harmonic.
fn mean_radiance(cloud: &SurfelCloud, i: usize) -> Vec3 {
    let mut first = SurfelCloud::empty(0, cloud.color_encoding);
    first.sh = cloud.sh_of(i)[..3].to_vec();
    first.radiance(0, Vec3::Z)
}

fn finish(
    state: State,
    trainer: Trainer<'_>,
    sources: &[Source],
    config: &DecomposeConfig,
    mut report: DecomposeReport,
    start: Instant,
) -> Result<Decomposed, TrainError> {
    let mut light = state.pyramid.to_light();
    let mut cloud = state.cloud;
    let factor = match config.albedo_scale {
        AlbedoScale::Prior => [1.0; 3],
        AlbedoScale::Factor(f) => f,
        AlbedoScale::GreyCard { view, x, y, albedo } => {
            let seen = albedo_at(&cloud, &sources[view], x, y, &trainer.raster).ok_or_else(|| {
                TrainError::Config(format!(
                    "the grey card's pixel {x},{y} of view {view} does not show the object"
                ))
            })?;
            std::array::from_fn(|k| albedo / seen[k].max(1e-4))
        }
    };
    report.scale_factor = factor;
    report.scale = match config.albedo_scale {
        AlbedoScale::Prior => format!(
            "prior: mean albedo near {} (weight {}), light neutral on average",
            config.albedo_mean, config.scale_weight
        ),
        AlbedoScale::Factor(f) => format!("given: the prior's albedo times {f:?}"),
        AlbedoScale::GreyCard { view, x, y, albedo } => {
            format!("grey card: pixel {x},{y} of view {view} has albedo {albedo}")
        }
    };
    if let Some(material) = &mut cloud.material
        && factor != [1.0; 3]
    {
        let clamped = scale::rescale(material, factor);
        light = light.scaled(Vec3::from_array(factor).recip());
        if clamped > 0 {
            report.warnings.push(format!(
                "the albedo of {clamped} surfels would leave [{}, {}] at this scale and was clamped",
                scale::MIN_ALBEDO,
                scale::MAX_ALBEDO
            ));
        }
    }
    if let Some(m) = &cloud.material {
        let (mut sum, mut weight) = (0.0f64, 0.0f64);
        for (albedo, opacity) in m.albedo_logits.iter().zip(&cloud.opacity_logits) {
            let o = f64::from(sigmoid(*opacity));
            sum += o * f64::from(luminance(Vec3::from_array(albedo.map(sigmoid))));
            weight += o;
        }
        report.mean_albedo = (sum / weight.max(1e-12)) as f32;
    }
    if state.dropped_gradients > 0 {
        report.warnings.push(format!("{} non-finite gradient entries were dropped", state.dropped_gradients));
    }
    let mut set = trainer.scene.probes;
    if let Some(set) = &mut set
        && !state.textures.is_empty()
    {
        set.texels = state.textures;
    }
    report.iterations = state.iteration;
    report.train_psnr_db = state.psnr_db;
    report.dropped_gradients = state.dropped_gradients;
    report.seconds = start.elapsed().as_secs_f64();
    Ok(Decomposed { cloud, light, probes: set, probe_config: probes::probe_config(config), report })
}

/// Albedo that a view shows at a pixel; `None` where it shows nothing.
fn albedo_at(
    cloud: &SurfelCloud,
    source: &Source,
    x: usize,
    y: usize,
    raster: &RasterConfig,
) -> Option<[f32; 3]> {
    let frame = comgs_raster::render(cloud, source.camera(), Planes::ALL, raster);
    let i = y * frame.weight.width + x;
    let w = frame.weight.data[i];
    let material = frame.material.as_ref()?;
    (w > 0.5).then(|| std::array::from_fn(|k| material.data[5 * i + k] / w))
}
