//! One step of the optimisation: patches, shading, losses, gradients, Adam.

use super::config::DecomposeConfig;
use super::gbuffer::{plane_gradients, shading_points};
use super::patch::{Patch, Source};
use super::proposal::Proposal;
use super::shade::{self, Incident, Lighting, Point, Shaded};
use super::{State, Visible, scale};
use crate::geometry_loss::{depth_normal, mask_cross_entropy};
use crate::view::{Rig, TrainView};
use comgs_image::Image;
use comgs_light::{OctahedralLight, luminance};
use comgs_optim::{AdamConfig, Photometric, schedule};
use comgs_raster::{
    Frame, FrameGradient, Planes, RasterConfig, SurfelGradients, Workspace, backward, forward,
};
use comgs_surfel::MaterialColumns;
use glam::Vec3;
use std::time::Instant;

/// Learning rates end at this share of where they start.
const FINAL_RATE: f32 = 0.1;

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

pub(super) struct Trainer<'a> {
    sources: &'a [Source],
    config: &'a DecomposeConfig,
    rig: Rig,
    pub(super) raster: RasterConfig,
    pub(super) scene: Visible,
    workspaces: Vec<Workspace>,
    gradients: SurfelGradients,
    photometric: Photometric,
    shaded: Shaded,
    texel_shares: Vec<f32>,
    /// Seconds spent on shading so far.
    pub(super) shading_seconds: f64,
    /// Points shaded so far.
    pub(super) points_shaded: usize,
}

impl<'a> Trainer<'a> {
    pub(super) fn new(
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

    pub(super) fn step(&mut self, state: &mut State, progress: f32) {
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
    pub(super) fn preview(&mut self, state: &State, view: &TrainView) -> (String, Image) {
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
