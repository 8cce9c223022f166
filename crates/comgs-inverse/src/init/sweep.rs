//! Dense matches by plane sweep: for each view the depth at which its neighbours look alike (Collins 1996), kept where
//! other views agree. It needs no points from structure-from-motion and no trained network.

use super::SurfacePoint;
use crate::view::{Rig, TrainView};
use comgs_geom::Camera;
use comgs_image::transfer::srgb_from_linear;
use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// Settings of the sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepConfig {
    /// Width in pixels at which matching runs.
    pub width: usize,
    /// Number of inverse-depth planes.
    pub planes: usize,
    /// Views that are matched against each view.
    pub neighbours: usize,
    /// At most this many views get a depth map.
    pub references: usize,
    /// Normalised cross-correlation below which a match is dropped, in (0, 1).
    pub min_correlation: f32,
}

impl Default for SweepConfig {
    fn default() -> Self {
        Self { width: 160, planes: 112, neighbours: 3, references: 48, min_correlation: 0.7 }
    }
}

/// Nearest and farthest plane in units of the rig's distance.
const NEAR: f32 = 0.25;
const FAR: f32 = 12.0;
/// Half width of the matching window.
const RADIUS: usize = 2;

/// A view at matching resolution.
struct Matched {
    camera: Camera,
    gray: Vec<f32>,
    width: usize,
    height: usize,
    rotation: Mat3,
    centre: Vec3,
}

/// Depth of one view; 0 where there is none.
struct DepthMap {
    depth: Vec<f32>,
    score: Vec<f32>,
}

/// Oriented points on the surfaces that the views see, at most `count`, best matches first.
///
/// `cancelled` is asked between views.
pub fn plane_sweep(
    views: &[TrainView],
    rig: &Rig,
    config: &SweepConfig,
    count: usize,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Vec<SurfacePoint> {
    let matched: Vec<Matched> = views.par_iter().map(|v| prepare(v, config.width)).collect();
    let step = views.len().div_ceil(config.references.max(1)).max(1);
    let references: Vec<usize> = (0..views.len()).step_by(step).collect();
    let maps: Vec<Option<DepthMap>> = references
        .par_iter()
        .map(|&r| {
            if cancelled() {
                return None;
            }
            let sources = neighbours(&matched, r, rig, config.neighbours);
            (!sources.is_empty()).then(|| depth_map(&matched, r, &sources, rig, config))
        })
        .collect();
    let mut points = Vec::new();
    for (k, &r) in references.iter().enumerate() {
        if let Some(map) = &maps[k] {
            points.extend(consistent_points(&matched, views, &references, &maps, r, map));
        }
    }
    thin(points, count)
}

fn prepare(view: &TrainView, width: usize) -> Matched {
    let width = width.min(view.camera.width).max(8);
    let height = (view.camera.height * width / view.camera.width).max(8);
    let small = view.premultiplied().resized(width, height);
    let gray = small
        .data
        .chunks_exact(3)
        .map(|p| (srgb_from_linear(p[0]) + 2.0 * srgb_from_linear(p[1]) + srgb_from_linear(p[2])) / 4.0)
        .collect();
    let camera = view.camera.resized(width, height);
    Matched {
        rotation: camera.world_from_camera.matrix3.transpose().as_mat3(),
        centre: camera.centre().as_vec3(),
        camera,
        gray,
        width,
        height,
    }
}

/// The views with the most useful baseline: near enough to look alike, far enough to tell depths apart.
fn neighbours(views: &[Matched], r: usize, rig: &Rig, count: usize) -> Vec<usize> {
    let here = &views[r];
    let mut scored: Vec<(f64, usize)> = (0..views.len())
        .filter(|&i| i != r)
        .filter_map(|i| {
            let baseline = views[i].camera.centre().distance(here.camera.centre()) / rig.distance;
            let alignment = views[i].camera.forward().dot(here.camera.forward());
            if baseline < 0.02 || alignment < 0.6 {
                return None;
            }
            // Around a fifth of the distance is best; the logarithm makes half and double equally good.
            Some(((baseline / 0.2).ln().abs() + 2.0 * (1.0 - alignment), i))
        })
        .collect();
    scored.sort_by(|a, b| a.0.total_cmp(&b.0));
    scored.truncate(count);
    scored.into_iter().map(|(_, i)| i).collect()
}

fn depth_of_plane(rig: &Rig, plane: f32, planes: usize) -> f32 {
    let distance = rig.distance as f32;
    let (near, far) = (1.0 / (NEAR * distance), 1.0 / (FAR * distance));
    1.0 / (far + (near - far) * plane / (planes - 1) as f32)
}

fn depth_map(views: &[Matched], r: usize, sources: &[usize], rig: &Rig, config: &SweepConfig) -> DepthMap {
    let here = &views[r];
    let (w, h) = (here.width, here.height);
    let n = w * h;
    let mean_r = box_mean(&here.gray, w, h);
    let square: Vec<f32> = here.gray.iter().map(|v| v * v).collect();
    let variance_r: Vec<f32> =
        box_mean(&square, w, h).iter().zip(&mean_r).map(|(s, m)| (s - m * m).max(0.0)).collect();
    let mut best = vec![-1.0f32; n];
    let mut best_plane = vec![0usize; n];
    let mut runner_up = vec![-1.0f32; n];
    let mut costs = vec![0.0f32; config.planes * n];
    let mut per_source = vec![vec![0.0f32; n]; sources.len()];
    for plane in 0..config.planes {
        let depth = depth_of_plane(rig, plane as f32, config.planes);
        for (s, out) in sources.iter().zip(&mut per_source) {
            let warped = warp(here, &views[*s], depth);
            correlation(&here.gray, &mean_r, &variance_r, &warped, w, h, out);
        }
        let costs = &mut costs[plane * n..(plane + 1) * n];
        // The mean of the better half of the sources survives occlusion in the others.
        let half = sources.len().div_ceil(2);
        let mut values = vec![0.0f32; sources.len()];
        for i in 0..n {
            for (v, s) in values.iter_mut().zip(&per_source) {
                *v = s[i];
            }
            values.sort_by(|a, b| b.total_cmp(a));
            costs[i] = values[..half].iter().sum::<f32>() / half as f32;
        }
    }
    for plane in 0..config.planes {
        for i in 0..n {
            let c = costs[plane * n + i];
            if c > best[i] {
                best[i] = c;
                best_plane[i] = plane;
            }
        }
    }
    for plane in 0..config.planes {
        for i in 0..n {
            if plane.abs_diff(best_plane[i]) > 3 {
                runner_up[i] = runner_up[i].max(costs[plane * n + i]);
            }
        }
    }
    let depth = (0..n)
        .map(|i| {
            let p = best_plane[i];
            let distinct = best[i] - runner_up[i] > 0.03;
            if best[i] < config.min_correlation || !distinct || p == 0 || p + 1 == config.planes {
                return 0.0;
            }
            // Parabola through the best plane and its neighbours.
            let (a, b, c) = (costs[(p - 1) * n + i], best[i], costs[(p + 1) * n + i]);
            let curvature = a - 2.0 * b + c;
            let shift = if curvature < -1e-6 { (0.5 * (a - c) / curvature).clamp(-0.5, 0.5) } else { 0.0 };
            depth_of_plane(rig, p as f32 + shift, config.planes)
        })
        .collect();
    DepthMap { depth, score: best }
}

/// The source image seen through a fronto-parallel plane at `depth` of the reference; −1 outside.
fn warp(here: &Matched, source: &Matched, depth: f32) -> Vec<f32> {
    // p_source = R (z d) + t, linear in the pixel.
    let relative = source.rotation * here.rotation.transpose();
    let t = source.rotation * (here.centre - source.centre);
    let (c, s) = (&here.camera, &source.camera);
    let ray =
        |x: f32, y: f32| Vec3::new((x - c.cx as f32) / c.fx as f32, (y - c.cy as f32) / c.fy as f32, 1.0);
    let step = relative * (ray(1.0, 0.0) - ray(0.0, 0.0)) * depth;
    let mut out = Vec::with_capacity(here.width * here.height);
    let (sw, sh) = (source.width as f32, source.height as f32);
    for y in 0..here.height {
        let mut p = relative * (ray(0.5, y as f32 + 0.5) * depth) + t;
        for _ in 0..here.width {
            let inverse = 1.0 / p.z;
            let x = s.cx as f32 + s.fx as f32 * p.x * inverse - 0.5;
            let v = s.cy as f32 + s.fy as f32 * p.y * inverse - 0.5;
            let inside = p.z > 0.0 && x >= 0.0 && v >= 0.0 && x < sw - 1.0 && v < sh - 1.0;
            out.push(if inside {
                let (x0, y0) = (x as usize, v as usize);
                let (tx, ty) = (x - x0 as f32, v - y0 as f32);
                let i = y0 * source.width + x0;
                let g = &source.gray;
                let top = g[i] + (g[i + 1] - g[i]) * tx;
                let bottom = g[i + source.width] + (g[i + source.width + 1] - g[i + source.width]) * tx;
                top + (bottom - top) * ty
            } else {
                -1.0
            });
            p += step;
        }
    }
    out
}

/// Zero-mean normalised cross-correlation in a window; −1 where the source does not see the pixel.
fn correlation(
    gray: &[f32],
    mean_r: &[f32],
    variance_r: &[f32],
    warped: &[f32],
    w: usize,
    h: usize,
    out: &mut [f32],
) {
    let mean_s = box_mean(warped, w, h);
    let square: Vec<f32> = warped.iter().map(|v| v * v).collect();
    let product: Vec<f32> = warped.iter().zip(gray).map(|(a, b)| a * b).collect();
    let (square, product) = (box_mean(&square, w, h), box_mean(&product, w, h));
    for i in 0..out.len() {
        if warped[i] < 0.0 {
            out[i] = -1.0;
            continue;
        }
        let variance_s = (square[i] - mean_s[i] * mean_s[i]).max(0.0);
        let covariance = product[i] - mean_r[i] * mean_s[i];
        // The constant keeps flat windows (a textureless wall) from matching anything by noise.
        out[i] = covariance / ((variance_r[i] + 2e-5) * (variance_s + 2e-5)).sqrt();
    }
}

/// Mean over a (2·RADIUS+1)² window; beyond the border the nearest pixel repeats.
fn box_mean(image: &[f32], w: usize, h: usize) -> Vec<f32> {
    const TAPS: usize = 2 * RADIUS + 1;
    let mut rows = vec![0.0f32; image.len()];
    let mut padded = vec![0.0f32; w + 2 * RADIUS];
    for (row, out) in image.chunks_exact(w).zip(rows.chunks_exact_mut(w)) {
        padded[..RADIUS].fill(row[0]);
        padded[RADIUS..RADIUS + w].copy_from_slice(row);
        padded[RADIUS + w..].fill(row[w - 1]);
        for (x, out) in out.iter_mut().enumerate() {
            let taps: &[f32; TAPS] = padded[x..x + TAPS].try_into().expect("window");
            *out = taps.iter().sum();
        }
    }
    let mut out = vec![0.0f32; image.len()];
    for (y, target) in out.chunks_exact_mut(w).enumerate() {
        for k in 0..TAPS {
            let r = (y + k).saturating_sub(RADIUS).min(h - 1);
            for (t, s) in target.iter_mut().zip(&rows[r * w..(r + 1) * w]) {
                *t += s;
            }
        }
        target.iter_mut().for_each(|t| *t *= 1.0 / (TAPS * TAPS) as f32);
    }
    out
}

/// Points of one depth map that at least two other maps confirm, with normals from the map.
fn consistent_points(
    matched: &[Matched],
    views: &[TrainView],
    references: &[usize],
    maps: &[Option<DepthMap>],
    r: usize,
    map: &DepthMap,
) -> Vec<(f32, SurfacePoint)> {
    let here = &matched[r];
    let (w, h) = (here.width, here.height);
    let world_from_camera = here.rotation.transpose();
    let c = &here.camera;
    let point = |x: usize, y: usize, z: f32| {
        let d = Vec3::new(
            (x as f32 + 0.5 - c.cx as f32) / c.fx as f32,
            (y as f32 + 0.5 - c.cy as f32) / c.fy as f32,
            1.0,
        );
        here.centre + world_from_camera * (d * z)
    };
    let color = views[r].premultiplied().resized(w, h);
    let pixel = |x: usize, y: usize| map.depth[y * w + x];
    (0..w * h)
        .into_par_iter()
        .filter_map(|i| {
            let (x, y) = (i % w, i / w);
            let z = map.depth[i];
            if z <= 0.0 {
                return None;
            }
            let p = point(x, y, z);
            let mut confirmed = 0;
            for (k, &other) in references.iter().enumerate() {
                let (Some(other_map), true) = (&maps[k], other != r) else { continue };
                let v = &matched[other];
                let q = v.rotation * (p - v.centre);
                if q.z <= 0.0 {
                    continue;
                }
                let px = v.camera.cx as f32 + v.camera.fx as f32 * q.x / q.z;
                let py = v.camera.cy as f32 + v.camera.fy as f32 * q.y / q.z;
                if px < 0.0 || py < 0.0 || px >= v.width as f32 || py >= v.height as f32 {
                    continue;
                }
                let theirs = other_map.depth[py as usize * v.width + px as usize];
                if theirs > 0.0 && (theirs - q.z).abs() < 0.0125 * q.z {
                    confirmed += 1;
                }
            }
            if confirmed < 2 {
                return None;
            }
            let towards_camera = (here.centre - p).normalize_or(Vec3::Z);
            let normal = normal_from_map(&pixel, &point, x, y, w, h, z)
                .map_or(towards_camera, |n| if n.dot(towards_camera) < 0.0 { -n } else { n });
            // A surfel seen edge-on would be a needle on the screen; lean it back to at most 75°.
            let normal = if normal.dot(towards_camera) < 0.26 {
                (normal + towards_camera).normalize()
            } else {
                normal
            };
            let spacing = z / c.fx as f32;
            let radiance = Vec3::from_array(color.rgb(x, y));
            Some((map.score[i], SurfacePoint { position: p, normal, radiance, spacing }))
        })
        .collect()
}

/// Normal by least squares over the neighbours of like depth in a 5×5 window.
fn normal_from_map(
    depth: &dyn Fn(usize, usize) -> f32,
    point: &dyn Fn(usize, usize, f32) -> Vec3,
    x: usize,
    y: usize,
    w: usize,
    h: usize,
    z: f32,
) -> Option<Vec3> {
    let mut points = Vec::with_capacity(25);
    for v in y.saturating_sub(2)..(y + 3).min(h) {
        for u in x.saturating_sub(2)..(x + 3).min(w) {
            let d = depth(u, v);
            if d > 0.0 && (d - z).abs() < 0.05 * z {
                points.push(point(u, v, d));
            }
        }
    }
    if points.len() < 8 {
        return None;
    }
    let mean = points.iter().sum::<Vec3>() / points.len() as f32;
    let mut covariance = Mat3::ZERO;
    for p in &points {
        let d = *p - mean;
        covariance += Mat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    // Smallest eigenvector by inverse iteration.
    let trace = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    let shifted = covariance + Mat3::IDENTITY * (1e-4 * trace.max(1e-20));
    let inverse = shifted.inverse();
    let mut n = Vec3::new(0.3, 0.5, 0.8);
    for _ in 0..12 {
        n = (inverse * n).normalize_or(Vec3::Z);
    }
    n.is_finite().then_some(n)
}

/// Keeps one point for each cell of its own size, best score first, and at most `count` of them: larger cells are tried
/// until they fit.
fn thin(mut points: Vec<(f32, SurfacePoint)>, count: usize) -> Vec<SurfacePoint> {
    points.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut factor = 1.0f32;
    loop {
        let mut taken = std::collections::HashSet::new();
        let mut kept = Vec::new();
        for (_, p) in &points {
            let cell = p.spacing * factor;
            // Cells come in powers of √2, so that points of about the same size share a grid.
            let level = (cell.log2() * 2.0).round();
            let cell = (level / 2.0).exp2();
            let key = ((p.position / cell).floor().as_i64vec3(), level as i32);
            if taken.insert(key) {
                kept.push(SurfacePoint { spacing: cell.max(p.spacing), ..*p });
            }
        }
        if kept.len() <= count || factor > 64.0 {
            kept.truncate(count);
            return kept;
        }
        factor *= 1.19;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_image::Image;
    use glam::DVec3;

    /// A wall z = f(x) with a smooth random texture, rendered by intersecting rays with the plane y = 0.
    fn wall_view(eye: DVec3, target: DVec3, textured: bool) -> TrainView {
        let camera = Camera::look_at("a", 96, 72, 0.8, eye, target, DVec3::Z);
        let mut color = Image::zeros(96, 72, 3);
        for y in 0..72 {
            for x in 0..96 {
                let d = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
                let t = -eye.y / d.y;
                let p = eye + d * t;
                let v = if textured {
                    // Sines without a common period: nothing repeats that a match could slip to.
                    let waves = [(19.0, 4.0), (-7.0, 23.0), (31.7, -11.3), (8.1, 13.3), (3.3, -17.9)];
                    let sum: f64 = waves.iter().map(|(a, b)| (a * p.x + b * p.z + a).sin()).sum();
                    0.5 + 0.09 * sum
                } else {
                    0.5
                };
                color.pixel_mut(x, y).fill(v as f32);
            }
        }
        TrainView { camera, color, mask: None, valid: None, hdr: true }
    }

    fn views(textured: bool) -> Vec<TrainView> {
        (0..9)
            .map(|i| {
                let x = (f64::from(i % 3) - 1.0) * 0.4;
                let z = (f64::from(i / 3) - 1.0) * 0.3;
                wall_view(DVec3::new(x, -2.0, z), DVec3::new(0.0, 0.0, 0.0), textured)
            })
            .collect()
    }

    /// Goal: a textured wall is found where it is, with its normal.
    #[test]
    fn finds_a_textured_wall() {
        let views = views(true);
        let rig = Rig::new(&views.iter().map(|v| &v.camera).collect::<Vec<_>>()).unwrap();
        let config = SweepConfig { width: 96, ..Default::default() };
        let points = plane_sweep(&views, &rig, &config, 3000, &|| false);
        assert!(points.len() > 1000, "{}", points.len());
        // One pixel of disparity at this size: z² / (f · baseline) = 4 / (114 · 0.4).
        let one_pixel = 0.088;
        let off = points.iter().filter(|p| p.position.y.abs() > one_pixel).count();
        assert!(off * 50 < points.len(), "{off} of {} points are off the wall", points.len());
        let tilt: f32 = points.iter().map(|p| -p.normal.y).sum::<f32>() / points.len() as f32;
        // Measured: 0.89. Depth noise of half a pixel tilts a normal over five pixels by that much.
        assert!(tilt > 0.85, "{tilt}");
    }

    /// Hard case 14. Goal: a wall without texture gives no matches instead of wrong ones.
    #[test]
    fn textureless_wall_has_no_matches() {
        let views = views(false);
        let rig = Rig::new(&views.iter().map(|v| &v.camera).collect::<Vec<_>>()).unwrap();
        let points =
            plane_sweep(&views, &rig, &SweepConfig { width: 64, ..Default::default() }, 3000, &|| false);
        assert!(points.is_empty(), "{}", points.len());
    }
}
