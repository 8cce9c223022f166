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
//! Modules in the order of the work: [`config`], [`probes`] (where they stand and what they see), `patch` (pixels of a
//! step), [`shade`], [`scale`], `checkpoint`.

mod checkpoint;
pub mod config;
mod patch;
pub mod probes;
pub mod proposal;
pub mod scale;
pub mod shade;

use crate::TrainError;
use crate::geometry_loss::{depth_normal, mask_cross_entropy};
use crate::train::{MIN_VIEWS, Observer, TrainStatus, near_plane};
use crate::view::{Rig, TrainView};
use comgs_geom::Rng;
use comgs_image::Image;
use comgs_light::brdf::Material;
use comgs_light::{LightPyramid, OctahedralLight, luminance};
use comgs_optim::{Adam, AdamConfig, Photometric, schedule};
use comgs_probe::{BakeObserver, LookupConfig, ProbeConfig, ProbeError, ProbeIndex, ProbeSet};
use comgs_raster::{
    Frame, FrameGradient, Planes, RasterConfig, SurfelGradients, Workspace, backward, forward,
};
use comgs_surfel::activation::{logit, sigmoid};
use comgs_surfel::{MaterialColumns, SurfelCloud};
use comgs_trace::{TraceConfig, Tracer};
pub use config::{AlbedoScale, DecomposeConfig, Visibility};
use glam::{DVec3, Vec3};
use patch::{Patch, Source};
use proposal::Proposal;
use shade::{Incident, Lighting, Point, Shaded};
use std::time::Instant;

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

/// Weight of a pixel below which it is not shaded: there is no depth to speak of.
const MIN_WEIGHT: f32 = 0.05;
/// Roughness and metallic at the start.
const INITIAL_ROUGHNESS: f32 = 0.5;
const INITIAL_METALLIC: f32 = 0.1;
/// Learning rates end at this share of where they start.
const FINAL_RATE: f32 = 0.1;

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

/// A rendered patch on its way through a step.
struct Work {
    patch: Patch,
    frame: Frame,
    workspace: Workspace,
    /// Pixels of the shading points, in order.
    pixels: Vec<u32>,
    /// First shading point.
    first: usize,
}

struct Trainer<'a> {
    sources: &'a [Source],
    config: &'a DecomposeConfig,
    rig: Rig,
    raster: RasterConfig,
    scene: Visible,
    workspaces: Vec<Workspace>,
    gradients: SurfelGradients,
    photometric: Photometric,
    shaded: Shaded,
    texel_shares: Vec<f32>,
    shading_seconds: f64,
    points_shaded: usize,
}

impl<'a> Trainer<'a> {
    fn new(
        sources: &'a [Source],
        config: &'a DecomposeConfig,
        rig: &Rig,
        raster: RasterConfig,
        scene: Visible,
    ) -> Self {
        Self {
            sources,
            config,
            rig: *rig,
            raster,
            scene,
            workspaces: Vec::new(),
            gradients: SurfelGradients::default(),
            photometric: Photometric::default(),
            shaded: Shaded::default(),
            texel_shares: scale::texel_shares(config.light_size),
            shading_seconds: 0.0,
            points_shaded: 0,
        }
    }

    fn incident(scene: &Visible) -> Incident<'_> {
        match (&scene.tracer, &scene.probes, &scene.index, &scene.lookup) {
            (Some(tracer), ..) => Incident::Trace { tracer, offset: scene.trace_offset },
            (None, Some(set), Some(index), Some(lookup)) => Incident::Probes { set, index, lookup },
            _ => Incident::Open,
        }
    }

    fn step(&mut self, state: &mut State, progress: f32) {
        let c = self.config;
        let light = state.pyramid.to_light();
        let seed = (u64::from(state.iteration) << 20) ^ c.seed.rotate_left(40);
        let proposal = Proposal::new(&light, seed);
        let mut points = Vec::new();
        let mut works = Vec::with_capacity(c.patches);
        for _ in 0..c.patches {
            if state.queue.is_empty() {
                let useful = |i: &u32| self.sources[*i as usize].is_useful();
                state.queue = (0..self.sources.len() as u32).filter(useful).collect();
                state.rng.shuffle(&mut state.queue);
            }
            let source = &self.sources[state.queue.pop().expect("just filled") as usize];
            let patch = source.patch(c.patch_size, &mut state.rng);
            let mut workspace = self.workspaces.pop().unwrap_or_default();
            let frame = forward(&state.cloud, &patch.camera, Planes::ALL, &self.raster, &mut workspace);
            let first = points.len();
            let pixels = shading_points(&frame, &patch.camera, &mut points);
            works.push(Work { patch, frame, workspace, pixels, first });
        }
        // While a step looks textures up, the moving ones stand in the set, and the goal waits.
        let goal = match &mut self.scene.probes {
            Some(set) if !state.textures.is_empty() => {
                Some(std::mem::replace(&mut set.texels, std::mem::take(&mut state.textures)))
            }
            _ => None,
        };
        let lighting = Lighting {
            light: &light,
            proposal: &proposal,
            incident: Self::incident(&self.scene),
            rays: c.rays,
            seed,
        };
        let start = Instant::now();
        shade::shade(&points, &lighting, &mut self.shaded);
        self.shading_seconds += start.elapsed().as_secs_f64();
        self.points_shaded += points.len();

        let mut grad_radiance = vec![Vec3::ZERO; points.len()];
        let mut gradients = Vec::with_capacity(works.len());
        let mut mse = 0.0;
        for work in &works {
            let (value, gradient) =
                patch_loss(work, &self.shaded.radiance, c, &mut self.photometric, &mut grad_radiance);
            mse += value;
            gradients.push(gradient);
        }
        let mut grad_light = vec![0.0f32; light.texels().len()];
        let mut grad_probes = vec![[0.0f32; 4]; goal.as_ref().map_or(0, Vec::len)];
        let start = Instant::now();
        let mut grad_points = shade::shade_vjp(
            &points,
            &lighting,
            &self.shaded,
            &grad_radiance,
            &mut grad_light,
            goal.is_some().then_some(grad_probes.as_mut_slice()),
        );
        self.shading_seconds += start.elapsed().as_secs_f64();
        if let (Some(goal), Some(set)) = (goal, &mut self.scene.probes) {
            state.textures = std::mem::replace(&mut set.texels, goal);
        }
        self.priors(&points, &light, &mut grad_points, &mut grad_light);

        self.gradients.reset(&state.cloud);
        for (work, mut gradient) in works.into_iter().zip(gradients) {
            let Work { patch, frame, mut workspace, pixels, first } = work;
            let range = first..first + pixels.len();
            plane_gradients(&frame, &pixels, &points[range.clone()], &grad_points[range], &mut gradient);
            backward(
                &state.cloud,
                &patch.camera,
                &frame,
                &gradient,
                &self.raster,
                &mut workspace,
                &mut self.gradients,
            );
            self.workspaces.push(workspace);
        }
        state.iteration += 1;
        self.apply(state, progress, &light, &grad_light, &mut grad_probes);
        let psnr = -10.0 * (mse / c.patches as f32).max(1e-12).log10();
        let keep = if state.iteration <= 1 { 0.0 } else { 0.98 };
        state.psnr_db = keep * state.psnr_db + (1.0 - keep) * psnr;
    }

    /// L_lam (Eq. 12) and the prior on the scale, added to the gradients.
    fn priors(
        &self,
        points: &[Point],
        light: &OctahedralLight,
        grad_points: &mut [shade::PointGradient],
        grad_light: &mut [f32],
    ) {
        let c = self.config;
        if points.is_empty() {
            return;
        }
        let share = 1.0 / points.len() as f32;
        let mean = share * points.iter().map(|p| luminance(p.material.albedo)).sum::<f32>();
        let (_, pull) = scale::albedo_prior(mean, c.albedo_mean, c.scale_weight);
        for (point, grad) in points.iter().zip(grad_points) {
            // |R − 1| + |M − 0|, both within their ranges.
            grad.roughness -= c.lambertian_weight * share;
            grad.metallic += c.lambertian_weight * share * f32::from(point.material.metallic > 0.0);
            grad.albedo += pull * share * scale::LUMINANCE;
        }
        scale::neutral_prior(light, &self.texel_shares, c.scale_weight, grad_light);
    }

    fn apply(
        &self,
        state: &mut State,
        progress: f32,
        light: &OctahedralLight,
        grad_light: &[f32],
        grad_probes: &mut [[f32; 4]],
    ) {
        let c = self.config;
        let adam = AdamConfig::default();
        let t = state.iteration;
        let late = schedule::log_linear(1.0, FINAL_RATE, progress);
        let g = &self.gradients;
        let cloud = &mut state.cloud;
        let mut dropped = 0;
        let [positions, rotations, scales, opacities, material] = &mut state.adam;
        if c.geometry_rate > 0.0 {
            let geometry = crate::TrainConfig::preset(crate::Kind::Object, crate::Quality::Balanced);
            let rate = |r: f32| r * c.geometry_rate * late;
            let place = rate(geometry.position_rate * self.rig.distance as f32);
            dropped += positions.step(
                cloud.positions.as_flattened_mut(),
                g.positions.as_flattened(),
                place,
                t,
                &adam,
            );
            dropped += rotations.step(
                cloud.rotations.as_flattened_mut(),
                g.rotations.as_flattened(),
                rate(geometry.rotation_rate),
                t,
                &adam,
            );
            dropped += scales.step(
                cloud.log_scales.as_flattened_mut(),
                g.log_scales.as_flattened(),
                rate(geometry.scale_rate),
                t,
                &adam,
            );
            dropped += opacities.step(
                &mut cloud.opacity_logits,
                &g.opacity_logits,
                rate(geometry.opacity_rate),
                t,
                &adam,
            );
        }
        let columns = cloud.material.as_mut().expect("made at the start");
        let mut raw = interleaved(columns);
        let (a, m) = (c.albedo_rate * late, c.material_rate * late);
        dropped += material.step_rows(&mut raw, g.material_logits.as_flattened(), &[a, a, a, m, m], t, &adam);
        deinterleave(&raw, columns);

        let mut grad_levels: Vec<Vec<f32>> =
            state.pyramid.levels.iter().map(|l| vec![0.0; l.len()]).collect();
        state.pyramid.vjp(light, grad_light, &mut grad_levels);
        for ((level, grad), moments) in
            state.pyramid.levels.iter_mut().zip(&grad_levels).zip(&mut state.adam_light)
        {
            dropped += moments.step(level, grad, c.light_rate * late, t, &adam);
        }
        if let (false, Some(goal)) = (grad_probes.is_empty(), &self.scene.probes) {
            // Eq. 13, a mean over all texels and channels of |texture − traced|.
            let weight = c.probe_weight / (4 * goal.texels.len()) as f32;
            for ((g, now), goal) in grad_probes.iter_mut().zip(&state.textures).zip(&goal.texels) {
                for k in 0..4 {
                    let d = now[k] - goal[k];
                    g[k] += if d == 0.0 { 0.0 } else { weight.copysign(d) };
                }
            }
            dropped += state.adam_probes.step(
                state.textures.as_flattened_mut(),
                grad_probes.as_flattened(),
                c.probe_rate,
                t,
                &adam,
            );
            for texel in &mut state.textures {
                texel[3] = texel[3].clamp(0.0, 1.0);
                texel[..3].iter_mut().for_each(|v| *v = v.max(0.0));
            }
        }
        state.dropped_gradients += dropped as u64;
    }

    /// A view of the object under the recovered light, at most 200 pixels wide.
    fn preview(&mut self, state: &State, view: &TrainView) -> (String, Image) {
        let width = view.camera.width.min(200);
        let height = (view.camera.height * width / view.camera.width.max(1)).max(1);
        let camera = view.camera.resized(width, height);
        let frame = comgs_raster::render(&state.cloud, &camera, Planes::ALL, &self.raster);
        let mut points = Vec::new();
        let pixels = shading_points(&frame, &camera, &mut points);
        let light = state.pyramid.to_light();
        let proposal = Proposal::new(&light, 0);
        let incident = Self::incident(&self.scene);
        let lighting = Lighting { light: &light, proposal: &proposal, incident, rays: 64, seed: 0 };
        let mut shaded = Shaded::default();
        shade::shade(&points, &lighting, &mut shaded);
        let mut image = Image::zeros(width, height, 3);
        for (&i, radiance) in pixels.iter().zip(&shaded.radiance) {
            let i = i as usize;
            let over_black = *radiance * frame.weight.data[i];
            image.data[3 * i..3 * i + 3].copy_from_slice(&over_black.to_array());
        }
        (camera.name, image)
    }
}

/// Material columns as rows of albedo RGB, roughness, metallic.
fn interleaved(m: &MaterialColumns) -> Vec<f32> {
    let rows = m.albedo_logits.iter().zip(m.roughness_logits.iter().zip(&m.metallic_logits));
    rows.flat_map(|(a, (r, k))| [a[0], a[1], a[2], *r, *k]).collect()
}

fn deinterleave(rows: &[f32], m: &mut MaterialColumns) {
    for (i, row) in rows.chunks_exact(5).enumerate() {
        m.albedo_logits[i].copy_from_slice(&row[..3]);
        m.roughness_logits[i] = row[3];
        m.metallic_logits[i] = row[4];
    }
}

/// Least cosine between the shading normal and the view.
const LEAST_FACING: f32 = 0.02;

/// Unit normal to shade with: the blended normal N at unit length, bent towards the eye where it faces away from it or
/// nearly so (hard case 27), as it does along silhouettes: `n′ = n + max(0, ε − n·v) v`, normalised. `None` for a zero
/// normal. Gradient: [`shading_normal_vjp`]; it kinks where the bend begins.
fn shading_normal(sum: Vec3, view: Vec3) -> Option<Vec3> {
    let n = sum.try_normalize()?;
    let lack = LEAST_FACING - n.dot(view);
    if lack > 0.0 { (n + lack * view).try_normalize() } else { Some(n) }
}

/// Gradient of [`shading_normal`] with respect to `sum`.
fn shading_normal_vjp(sum: Vec3, view: Vec3, grad: Vec3) -> Vec3 {
    let length = sum.length();
    let n = sum / length;
    let lack = LEAST_FACING - n.dot(view);
    let grad = if lack > 0.0 {
        let bent = n + lack * view;
        let unit = bent.normalize();
        let grad = (grad - unit * unit.dot(grad)) / bent.length();
        grad - view * view.dot(grad)
    } else {
        grad
    };
    (grad - n * n.dot(grad)) / length
}

/// Shading points of a G-buffer, one a pixel that has a surface (weight above 0.05 and a normal towards the eye); their
/// pixels are returned. Material and depth are the planes over the weight (ComGS §3.1: unbiased), normals at unit length.
pub fn shading_points(frame: &Frame, camera: &comgs_geom::Camera, points: &mut Vec<Point>) -> Vec<u32> {
    let (Some(depth), Some(normal), Some(material)) = (&frame.depth, &frame.normal, &frame.material) else {
        return Vec::new();
    };
    let mut pixels = Vec::new();
    for i in 0..frame.weight.data.len() {
        let w = frame.weight.data[i];
        if !(w > MIN_WEIGHT) {
            continue;
        }
        let (x, y) = (i % frame.weight.width, i / frame.weight.width);
        let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
        let view = -ray.normalize().as_vec3();
        let Some(n) = shading_normal(Vec3::from_slice(&normal.data[3 * i..]), view) else { continue };
        let position = (camera.centre() + ray * f64::from(depth.data[i] / w)).as_vec3();
        let m = &material.data[5 * i..5 * i + 5];
        points.push(Point {
            position,
            normal: n,
            view,
            material: Material {
                albedo: Vec3::new(m[0], m[1], m[2]) / w,
                roughness: m[3] / w,
                metallic: m[4] / w,
            },
        });
        pixels.push(i as u32);
    }
    pixels
}

/// Losses of a patch: its mean squared sRGB error, and the gradients with respect to the planes that do not go through the
/// shading; those with respect to the points' radiance are written to `grad_radiance`.
fn patch_loss(
    work: &Work,
    radiance: &[Vec3],
    c: &DecomposeConfig,
    photometric: &mut Photometric,
    grad_radiance: &mut [Vec3],
) -> (f32, FrameGradient) {
    let frame = &work.frame;
    let (width, height) = (frame.weight.width, frame.weight.height);
    let zero = |channels| Image::zeros(width, height, channels);
    let mut picture = zero(3);
    for (k, &i) in work.pixels.iter().enumerate() {
        let i = i as usize;
        let color = radiance[work.first + k] * frame.weight.data[i];
        picture.data[3 * i..3 * i + 3].copy_from_slice(&color.to_array());
    }
    let (mut grad_picture, mut error) = (zero(3), zero(1));
    let value =
        photometric.evaluate(&picture, &work.patch.target, c.ssim_weight, &mut grad_picture, &mut error);
    let (mut normal, mut depth, mut weight) = (zero(3), zero(1), zero(1));
    let patches = 1.0 / c.patches as f32;
    for (k, &i) in work.pixels.iter().enumerate() {
        let i = i as usize;
        let g = patches * Vec3::from_slice(&grad_picture.data[3 * i..]);
        grad_radiance[work.first + k] = g * frame.weight.data[i];
        weight.data[i] += g.dot(radiance[work.first + k]);
    }
    let term = c.depth_normal_weight * patches;
    if term > 0.0 {
        depth_normal(frame, &work.patch.camera, term, &mut normal, &mut depth, &mut weight);
    }
    if let Some(mask) = &work.patch.mask {
        mask_cross_entropy(&frame.weight, mask, c.mask_weight * patches, &mut weight);
    }
    let gradient = FrameGradient {
        color: None,
        weight: Some(weight),
        depth: Some(depth),
        normal: Some(normal),
        material: Some(zero(5)),
        error: None,
    };
    (value.mse_srgb, gradient)
}

/// Carries gradients of shading points to the premultiplied planes: `m = M/W`, and n by [`shading_normal`].
fn plane_gradients(
    frame: &Frame,
    pixels: &[u32],
    points: &[Point],
    grad_points: &[shade::PointGradient],
    gradient: &mut FrameGradient,
) {
    let (Some(normal), Some(material)) = (&frame.normal, &frame.material) else { return };
    let FrameGradient { weight: Some(grad_w), normal: Some(grad_n), material: Some(grad_m), .. } = gradient
    else {
        return;
    };
    for ((&i, point), g) in pixels.iter().zip(points).zip(grad_points) {
        let i = i as usize;
        let w = frame.weight.data[i];
        let g_n = shading_normal_vjp(Vec3::from_slice(&normal.data[3 * i..]), point.view, g.normal);
        let g_m = [g.albedo.x, g.albedo.y, g.albedo.z, g.roughness, g.metallic];
        for k in 0..3 {
            grad_n.data[3 * i + k] += g_n[k];
        }
        for k in 0..5 {
            grad_m.data[5 * i + k] += g_m[k] / w;
            grad_w.data[i] -= g_m[k] * material.data[5 * i + k] / (w * w);
        }
    }
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

#[cfg(test)]
mod tests;
