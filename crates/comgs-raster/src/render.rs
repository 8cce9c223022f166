//! The whole rasteriser: forward and backward over an image.

use crate::bin::Bins;
use crate::blend::{TILE_PIXELS, TileInput, TileOutput, blend_tile};
use crate::blend_vjp::{RECORD_BASE, TileGradient, blend_tile_vjp};
use crate::bounds::{TILE, cover};
use crate::color::{radiance, radiance_vjp};
use crate::config::{Planes, RasterConfig};
use crate::frame::{Frame, FrameGradient};
use crate::project::{CameraSurfel, Projected, ProjectedGradient, ScreenCamera, project, project_vjp};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_surfel::SurfelCloud;
use comgs_surfel::activation::sigmoid;
use fearless_simd::dispatch;
use glam::Vec3;
use rayon::prelude::*;

/// Surfels of one parallel work item. Chunks are joined in order, so the result does not depend on the threads.
const CHUNK: usize = 1024;

/// Buffers that a rendering leaves behind for its gradient; reuse one across iterations to save the allocations.
#[derive(Debug, Default)]
pub struct Workspace {
    projected: Vec<Projected>,
    attributes: Vec<f32>,
    first_pair: Vec<u32>,
    tiles: Vec<u32>,
    bins: Bins,
    records: Vec<f32>,
    channels: usize,
}

impl Workspace {
    /// Number of surfels that the last rendering projected into the image.
    #[must_use]
    pub fn visible(&self) -> usize {
        self.projected.len()
    }

    /// Number of (surfel, tile) pairs of the last rendering.
    #[must_use]
    pub fn pairs(&self) -> usize {
        self.tiles.len()
    }
}

/// Gradients in the shape of the cloud's columns, and two sums a surfel that growth and pruning use.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfelGradients {
    /// World position.
    pub positions: Vec<[f32; 3]>,
    /// Raw quaternion.
    pub rotations: Vec<[f32; 4]>,
    /// Log scales.
    pub log_scales: Vec<[f32; 2]>,
    /// Opacity logit.
    pub opacity_logits: Vec<f32>,
    /// Harmonics, `[surfel][coefficient][rgb]`.
    pub sh: Vec<f32>,
    /// Albedo RGB, roughness, metallic logits; empty without material.
    pub material_logits: Vec<[f32; 5]>,
    /// Σ over pixels of the blend weight T α.
    pub weight: Vec<f32>,
    /// Σ over pixels of the blend weight times [`FrameGradient::error`].
    pub error: Vec<f32>,
}

impl SurfelGradients {
    /// Zeros in the shape of a cloud.
    #[must_use]
    pub fn zeros(cloud: &SurfelCloud) -> Self {
        let mut out = Self::default();
        out.reset(cloud);
        out
    }

    /// Back to zeros, in the shape of a cloud; keeps the memory.
    pub fn reset(&mut self, cloud: &SurfelCloud) {
        fn clear<T: Clone>(column: &mut Vec<T>, n: usize, zero: T) {
            column.clear();
            column.resize(n, zero);
        }
        let n = cloud.len();
        clear(&mut self.positions, n, [0.0; 3]);
        clear(&mut self.rotations, n, [0.0; 4]);
        clear(&mut self.log_scales, n, [0.0; 2]);
        clear(&mut self.opacity_logits, n, 0.0);
        clear(&mut self.sh, cloud.sh.len(), 0.0);
        clear(&mut self.material_logits, if cloud.material.is_some() { n } else { 0 }, [0.0; 5]);
        clear(&mut self.weight, n, 0.0);
        clear(&mut self.error, n, 0.0);
    }
}

/// Renders planes of a cloud as a camera sees it (ComGS Eq. 1).
///
/// An empty cloud, or one that is wholly out of view, gives zeros. Surfels with non-finite parameters are left
/// out. The same inputs give the same bytes at any thread count.
#[must_use]
pub fn render(cloud: &SurfelCloud, camera: &Camera, planes: Planes, config: &RasterConfig) -> Frame {
    forward(cloud, camera, planes, config, &mut Workspace::default())
}

/// As [`render`], keeping in `workspace` what [`backward`] needs.
#[must_use]
pub fn forward(
    cloud: &SurfelCloud,
    camera: &Camera,
    planes: Planes,
    config: &RasterConfig,
    workspace: &mut Workspace,
) -> Frame {
    let screen = ScreenCamera::new(camera);
    let channels = attribute_channels(planes);
    project_all(cloud, &screen, config, channels, workspace);
    let tiles_x = screen.width.div_ceil(TILE);
    let tiles_y = screen.height.div_ceil(TILE);
    let w = workspace;
    w.bins.build(&w.projected, &w.first_pair, &w.tiles, tiles_x * tiles_y);

    let mut frame = Frame::zeros(screen.width, screen.height, planes);
    let state = &*w;
    bands(&mut frame).into_par_iter().for_each(|mut band| {
        for tx in 0..tiles_x {
            let input = tile_input(state, &screen, config, tx, band.ty, tiles_x);
            if input.entries.is_empty() {
                continue;
            }
            match channels {
                0 => band.store(&dispatch!(config.level, s => blend_tile::<_, 0, true>(s, &input)), tx),
                3 => band.store(&dispatch!(config.level, s => blend_tile::<_, 3, false>(s, &input)), tx),
                6 => band.store(&dispatch!(config.level, s => blend_tile::<_, 6, true>(s, &input)), tx),
                _ => band.store(&dispatch!(config.level, s => blend_tile::<_, 11, true>(s, &input)), tx),
            }
        }
    });
    frame
}

/// Adds to `gradients` the gradient of a loss, given its gradient with respect to the planes of `frame`, which
/// [`forward`] just computed into `workspace` from the same cloud, camera, planes and configuration.
///
/// Exact where the blend is smooth; at the cut-offs of [`RasterConfig`] the blend jumps, and the gradient is that of
/// either side. Planes that were not rendered cannot have a gradient and are ignored.
///
/// # Panics
/// When `gradients` does not have the cloud's shape.
pub fn backward(
    cloud: &SurfelCloud,
    camera: &Camera,
    frame: &Frame,
    gradient: &FrameGradient,
    config: &RasterConfig,
    workspace: &mut Workspace,
    gradients: &mut SurfelGradients,
) {
    assert_eq!(gradients.positions.len(), cloud.len(), "gradients in the shape of the cloud");
    let screen = ScreenCamera::new(camera);
    let tiles_x = screen.width.div_ceil(TILE);
    let tiles_y = screen.height.div_ceil(TILE);
    let channels = workspace.channels;
    let stride = RECORD_BASE + channels;
    let mut records = std::mem::take(&mut workspace.records);
    records.resize(workspace.bins.entries.len() * stride, 0.0);
    let state = &*workspace;

    // Each tile owns its stretch of records: no atomics, no order that depends on the threads.
    let mut rest = records.as_mut_slice();
    let mut work = Vec::with_capacity(tiles_x * tiles_y);
    for tile in 0..tiles_x * tiles_y {
        let count = (state.bins.offsets[tile + 1] - state.bins.offsets[tile]) as usize;
        let (mine, others) = rest.split_at_mut(count * stride);
        rest = others;
        if count > 0 {
            work.push((tile, mine));
        }
    }
    work.into_par_iter().for_each(|(tile, records)| {
        let (tx, ty) = (tile % tiles_x, tile / tiles_x);
        let input = tile_input(state, &screen, config, tx, ty, tiles_x);
        match channels {
            0 => {
                let g = load_gradient::<0>(frame, gradient, &input);
                dispatch!(config.level, s => blend_tile_vjp::<_, 0, true>(s, &input, &g, records));
            }
            3 => {
                let g = load_gradient::<3>(frame, gradient, &input);
                dispatch!(config.level, s => blend_tile_vjp::<_, 3, false>(s, &input, &g, records));
            }
            6 => {
                let g = load_gradient::<6>(frame, gradient, &input);
                dispatch!(config.level, s => blend_tile_vjp::<_, 6, true>(s, &input, &g, records));
            }
            _ => {
                let g = load_gradient::<11>(frame, gradient, &input);
                dispatch!(config.level, s => blend_tile_vjp::<_, 11, true>(s, &input, &g, records));
            }
        }
    });
    gather(cloud, &screen, state, &records, stride, gradients);
    workspace.records = records;
}

/// Blended attributes a surfel: nothing, colour, colour + normal, colour + normal + material.
fn attribute_channels(planes: Planes) -> usize {
    match planes {
        Planes { material: true, .. } => 11,
        Planes { normal: true, .. } | Planes { color: true, depth: true, .. } => 6,
        Planes { color: true, .. } => 3,
        _ => 0,
    }
}

/// What one chunk of surfels projects to.
#[derive(Default)]
struct ChunkOutput {
    projected: Vec<Projected>,
    attributes: Vec<f32>,
    tiles: Vec<u32>,
    counts: Vec<u32>,
}

fn project_all(
    cloud: &SurfelCloud,
    screen: &ScreenCamera,
    config: &RasterConfig,
    channels: usize,
    workspace: &mut Workspace,
) {
    let n = cloud.len();
    let chunks: Vec<ChunkOutput> = (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut out = ChunkOutput::default();
            for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(n) {
                project_one(cloud, i, screen, config, channels, &mut out);
            }
            out
        })
        .collect();
    let w = workspace;
    w.channels = channels;
    w.projected.clear();
    w.attributes.clear();
    w.tiles.clear();
    w.first_pair.clear();
    w.first_pair.push(0);
    for c in &chunks {
        w.projected.extend_from_slice(&c.projected);
        w.attributes.extend_from_slice(&c.attributes);
        w.tiles.extend_from_slice(&c.tiles);
        for count in &c.counts {
            w.first_pair.push(w.first_pair.last().expect("not empty") + count);
        }
    }
}

fn project_one(
    cloud: &SurfelCloud,
    i: usize,
    screen: &ScreenCamera,
    config: &RasterConfig,
    channels: usize,
    out: &mut ChunkOutput,
) {
    let Some(geometry) =
        CameraSurfel::new(screen, cloud.positions[i], cloud.rotations[i], cloud.log_scales[i])
    else {
        return;
    };
    let Some(mut projected) = project(screen, config, i as u32, &geometry, cloud.opacity_logits[i]) else {
        return;
    };
    let before = out.tiles.len();
    let Some(rows) = cover(screen, config, &projected, &geometry, &mut |tile| out.tiles.push(tile)) else {
        return;
    };
    if out.tiles.len() == before {
        return;
    }
    projected.rows = rows;
    let start = out.attributes.len();
    if channels >= 3 {
        let offset = Vec3::from_array(cloud.positions[i]) - screen.centre;
        let direction = offset.normalize_or(Vec3::Z);
        out.attributes.extend(radiance(cloud.sh_of(i), cloud.sh_degree, cloud.color_encoding, direction));
    }
    if channels >= 6 {
        let normal = screen.camera_from_world.transpose() * geometry.frame.z_axis * projected.facing;
        out.attributes.extend(normal.to_array());
    }
    if channels >= 11 {
        match &cloud.material {
            Some(m) => {
                out.attributes.extend(m.albedo_logits[i].map(sigmoid));
                out.attributes.push(sigmoid(m.roughness_logits[i]));
                out.attributes.push(sigmoid(m.metallic_logits[i]));
            }
            None => out.attributes.extend([0.0; 5]),
        }
    }
    // A non-finite attribute would poison every pixel it touches, so the surfel is left out.
    if !out.attributes[start..].iter().all(|v| v.is_finite()) {
        out.attributes.truncate(start);
        out.tiles.truncate(before);
        return;
    }
    out.counts.push((out.tiles.len() - before) as u32);
    out.projected.push(projected);
}

fn tile_input<'a>(
    state: &'a Workspace,
    screen: &ScreenCamera,
    config: &RasterConfig,
    tx: usize,
    ty: usize,
    tiles_x: usize,
) -> TileInput<'a> {
    let tile = ty * tiles_x + tx;
    let range = state.bins.offsets[tile] as usize..state.bins.offsets[tile + 1] as usize;
    TileInput {
        projected: &state.projected,
        attributes: &state.attributes,
        entries: &state.bins.entries[range],
        origin: [tx * TILE, ty * TILE],
        image: [screen.width, screen.height],
        near: config.near,
        alpha_max: config.alpha_max,
        transmittance_min: config.transmittance_min,
    }
}

/// Mutable rows of every plane that one row of tiles covers.
struct Band<'a> {
    ty: usize,
    width: usize,
    color: Option<&'a mut [f32]>,
    weight: &'a mut [f32],
    depth: Option<&'a mut [f32]>,
    normal: Option<&'a mut [f32]>,
    material: Option<&'a mut [f32]>,
}

fn bands(frame: &mut Frame) -> Vec<Band<'_>> {
    let (width, height) = (frame.weight.width, frame.weight.height);
    if width == 0 || height == 0 {
        return Vec::new();
    }
    fn rows(image: &mut Option<Image>) -> Option<std::slice::ChunksMut<'_, f32>> {
        image.as_mut().map(|i| {
            let length = i.width * i.channels * TILE;
            i.data.chunks_mut(length)
        })
    }
    let mut color = rows(&mut frame.color);
    let mut depth = rows(&mut frame.depth);
    let mut normal = rows(&mut frame.normal);
    let mut material = rows(&mut frame.material);
    frame
        .weight
        .data
        .chunks_mut(width * TILE)
        .enumerate()
        .map(|(ty, weight)| Band {
            ty,
            width,
            color: color.as_mut().and_then(Iterator::next),
            weight,
            depth: depth.as_mut().and_then(Iterator::next),
            normal: normal.as_mut().and_then(Iterator::next),
            material: material.as_mut().and_then(Iterator::next),
        })
        .collect()
}

impl Band<'_> {
    fn store<const CHANNELS: usize>(&mut self, tile: &TileOutput<CHANNELS>, tx: usize) {
        let columns = TILE.min(self.width - tx * TILE);
        for y in 0..self.weight.len() / self.width {
            for x in 0..columns {
                let from = y * TILE + x;
                let to = y * self.width + tx * TILE + x;
                self.weight[to] = tile.weight[from];
                if let Some(depth) = &mut self.depth {
                    depth[to] = tile.depth[from];
                }
                let copy = |plane: &mut Option<&mut [f32]>, first: usize, count: usize| {
                    if let Some(plane) = plane {
                        for c in 0..count {
                            plane[to * count + c] = tile.attributes[first + c][from];
                        }
                    }
                };
                copy(&mut self.color, 0, 3);
                copy(&mut self.normal, 3, 3);
                copy(&mut self.material, 6, 5);
            }
        }
    }
}

/// Transposes the gradient images into a tile's planes and forms g·B.
fn load_gradient<const CHANNELS: usize>(
    frame: &Frame,
    gradient: &FrameGradient,
    input: &TileInput<'_>,
) -> TileGradient<CHANNELS> {
    let mut g = TileGradient {
        attributes: [[0.0; TILE_PIXELS]; CHANNELS],
        weight: [0.0; TILE_PIXELS],
        depth: [0.0; TILE_PIXELS],
        total: [0.0; TILE_PIXELS],
        error: [0.0; TILE_PIXELS],
    };
    let [width, height] = input.image;
    let columns = TILE.min(width - input.origin[0]);
    for y in 0..TILE.min(height - input.origin[1]) {
        for x in 0..columns {
            let from = (input.origin[1] + y) * width + input.origin[0] + x;
            let to = y * TILE + x;
            let mut total = 0.0;
            let mut copy = |gradient: &Option<Image>, plane: &Option<Image>, first: usize, count: usize| {
                if let (Some(gradient), Some(plane)) = (gradient, plane) {
                    for c in 0..count {
                        let v = gradient.data[from * count + c];
                        g.attributes[first + c][to] = v;
                        total += v * plane.data[from * count + c];
                    }
                }
            };
            if CHANNELS >= 3 {
                copy(&gradient.color, &frame.color, 0, 3);
            }
            if CHANNELS >= 6 {
                copy(&gradient.normal, &frame.normal, 3, 3);
            }
            if CHANNELS >= 11 {
                copy(&gradient.material, &frame.material, 6, 5);
            }
            if let Some(weight) = &gradient.weight {
                g.weight[to] = weight.data[from];
                total += weight.data[from] * frame.weight.data[from];
            }
            if let (Some(gradient), Some(depth)) = (&gradient.depth, &frame.depth) {
                g.depth[to] = gradient.data[from];
                total += gradient.data[from] * depth.data[from];
            }
            if let Some(error) = &gradient.error {
                g.error[to] = error.data[from];
            }
            g.total[to] = total;
        }
    }
    g
}

/// Sums each surfel's records in a fixed order and carries them back to its raw parameters.
fn gather(
    cloud: &SurfelCloud,
    screen: &ScreenCamera,
    state: &Workspace,
    records: &[f32],
    stride: usize,
    gradients: &mut SurfelGradients,
) {
    let sh_stride = cloud.sh_stride();
    let mut material = gradients.material_logits.chunks_mut(CHUNK);
    let columns: Vec<_> = gradients
        .positions
        .chunks_mut(CHUNK)
        .zip(gradients.rotations.chunks_mut(CHUNK))
        .zip(gradients.log_scales.chunks_mut(CHUNK))
        .zip(gradients.opacity_logits.chunks_mut(CHUNK))
        .zip(gradients.sh.chunks_mut(CHUNK * sh_stride))
        .zip(gradients.weight.chunks_mut(CHUNK).zip(gradients.error.chunks_mut(CHUNK)))
        .map(|columns| (columns, material.next()))
        .collect();
    columns.into_par_iter().enumerate().for_each(|(chunk, columns)| {
        let ((((((positions, rotations), log_scales), opacities), sh), (weights, errors)), mut material) =
            columns;
        let base = chunk * CHUNK;
        let first = state.projected.partition_point(|p| (p.surfel as usize) < base);
        let last = state.projected.partition_point(|p| (p.surfel as usize) < base + CHUNK);
        let mut sum = [0.0f32; RECORD_BASE + 11];
        for k in first..last {
            let sum = &mut sum[..stride];
            sum.fill(0.0);
            for pair in state.first_pair[k]..state.first_pair[k + 1] {
                let at = state.bins.position_of_pair[pair as usize] as usize * stride;
                for (s, r) in sum.iter_mut().zip(&records[at..at + stride]) {
                    *s += r;
                }
            }
            let projected = &state.projected[k];
            let i = projected.surfel as usize;
            let local = i - base;
            weights[local] += sum[14];
            errors[local] += sum[15];
            let attributes = &sum[RECORD_BASE..];
            let mut grad_position = Vec3::ZERO;
            if attributes.len() >= 3 {
                let offset = Vec3::from_array(cloud.positions[i]) - screen.centre;
                grad_position += radiance_vjp(
                    cloud.sh_of(i),
                    cloud.sh_degree,
                    cloud.color_encoding,
                    offset.normalize_or(Vec3::Z),
                    offset.length(),
                    [attributes[0], attributes[1], attributes[2]],
                    &mut sh[local * sh_stride..(local + 1) * sh_stride],
                );
            }
            let grad_normal =
                if attributes.len() >= 6 { Vec3::from_slice(&attributes[3..6]) } else { Vec3::ZERO };
            if let (Some(out), Some(m)) = (&mut material, &cloud.material)
                && attributes.len() >= 11
            {
                let raw = [
                    m.albedo_logits[i][0],
                    m.albedo_logits[i][1],
                    m.albedo_logits[i][2],
                    m.roughness_logits[i],
                    m.metallic_logits[i],
                ];
                for c in 0..5 {
                    let value = sigmoid(raw[c]);
                    out[local][c] += attributes[6 + c] * value * (1.0 - value);
                }
            }
            let Some(geometry) =
                CameraSurfel::new(screen, cloud.positions[i], cloud.rotations[i], cloud.log_scales[i])
            else {
                continue;
            };
            let three = |at: usize| [sum[at], sum[at + 1], sum[at + 2]];
            let g = project_vjp(
                screen,
                projected,
                &geometry,
                cloud.rotations[i],
                cloud.log_scales[i],
                &ProjectedGradient {
                    form_u: three(0),
                    form_v: three(3),
                    form_w: three(6),
                    plane: sum[9],
                    centre: [sum[10], sum[11]],
                    depth: sum[12],
                    opacity: sum[13],
                },
                grad_normal,
            );
            grad_position += g.position;
            for c in 0..3 {
                positions[local][c] += grad_position[c];
            }
            for c in 0..4 {
                rotations[local][c] += g.rotation[c];
            }
            for c in 0..2 {
                log_scales[local][c] += g.log_scale[c];
            }
            opacities[local] += g.opacity_logit;
        }
    });
}
