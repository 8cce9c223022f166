//! The lit surface points that testify.

use super::Config;
use crate::Sweep;
use comgs_geom::{Rng, equirect};
use glam::{DVec3, Vec3};

/// A point of the scene's surface and what it reflects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Receiver {
    pub position: Vec3,
    pub normal: Vec3,
    /// Linear radiance as seen from the sweep's centre.
    pub radiance: DVec3,
    pub cluster: usize,
    /// Whether the photos clipped it: it reflects at least this much.
    pub clipped: bool,
    /// Whether it only judges.
    pub judge: bool,
}

/// All of them.
pub(super) struct Receivers {
    pub all: Vec<Receiver>,
    pub clusters: usize,
    /// Scene units by which rays start above the surface.
    pub offset: f32,
}

/// One in so many judges.
const JUDGES: usize = 5;
/// Points further than this many times the median distance are left out: light is not the same there.
const FURTHEST: f32 = 3.0;
/// Points darker than this share of the mean are left out.
const DARKEST: f64 = 0.03;
/// Points that a cluster needs.
const FEWEST_ALIKE: usize = 25;
/// Rounds of the clustering.
const ROUNDS: usize = 12;

impl Receivers {
    /// Picks texels of sweeps with chances in proportion to their solid angle; opaque, not black, facing the sweep's
    /// centre. Several sweeps see behind things, where their shadows lie.
    pub(super) fn choose(sweeps: &[(Vec3, Sweep)], config: &Config) -> Self {
        let mut depths: Vec<f32> = sweeps
            .iter()
            .take(1)
            .flat_map(|(_, s)| s.depth.data.iter().zip(&s.alpha.data))
            .filter(|(_, a)| **a > 0.9)
            .map(|(d, _)| *d)
            .collect();
        depths.sort_by(f32::total_cmp);
        let median = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
        let mut all = Vec::new();
        for (k, (centre, seen)) in sweeps.iter().enumerate() {
            let mut rng = Rng::stream(config.seed, 0x6576_6964 + k as u64);
            let share = config.points / sweeps.len().max(1);
            pick(seen, *centre, share, FURTHEST * median, config.clip, &mut rng, &mut all);
        }
        // What is nearly black tells of its own noise and of what shines through it.
        let mean = all.iter().map(|r| r.radiance.element_sum()).sum::<f64>() / all.len().max(1) as f64;
        all.retain(|r| r.radiance.element_sum() > DARKEST * mean);
        for (i, r) in all.iter_mut().enumerate() {
            r.judge = i % JUDGES == 0;
        }
        let clusters = cluster(&mut all, config, median.max(1e-6));
        // A cluster of few points explains itself by its own albedo, whatever the light.
        let mut counts = vec![0; clusters];
        all.iter().for_each(|r| counts[r.cluster] += 1);
        all.retain(|r| counts[r.cluster] >= FEWEST_ALIKE);
        Self { all, clusters, offset: 0.01 * median }
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }
}

/// Adds up to `count` texels of a sweep.
fn pick(
    seen: &Sweep,
    centre: Vec3,
    count: usize,
    furthest: f32,
    clip: Option<f32>,
    rng: &mut Rng,
    all: &mut Vec<Receiver>,
) {
    let (width, height) = (seen.rgb.width, seen.rgb.height);
    let mut used = vec![false; width * height];
    let until = all.len() + count;
    for _ in 0..8 * count {
        if all.len() >= until {
            break;
        }
        let z = 1.0 - 2.0 * rng.uniform();
        let azimuth = std::f32::consts::TAU * rng.uniform();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (u, v) = equirect::uv_from_direction(Vec3::new(r * azimuth.cos(), r * azimuth.sin(), z));
        let x = ((u * width as f32) as usize).min(width - 1);
        let y = ((v * height as f32) as usize).min(height - 1);
        let i = y * width + x;
        let depth = seen.depth.data[i];
        if used[i] || seen.alpha.data[i] < 0.95 || depth <= 0.0 || depth > furthest {
            continue;
        }
        used[i] = true;
        let d = equirect::texel_direction(x, y, width, height);
        let normal = Vec3::from(seen.normal.rgb(x, y));
        let radiance = Vec3::from(seen.rgb.rgb(x, y)).as_dvec3();
        let usable = radiance.is_finite() && radiance.min_element() > 1e-4 && normal.dot(d) < -0.15;
        if usable {
            let position = centre + d * depth;
            let clipped = clip.is_some_and(|level| radiance.max_element() > 0.93 * f64::from(level));
            all.push(Receiver { position, normal, radiance, cluster: 0, clipped, judge: false });
        }
    }
}

/// k-means over hue, normal and place. Brightness has no say: it is what differs between light and shadow.
fn cluster(all: &mut [Receiver], config: &Config, scale: f32) -> usize {
    let k = config.clusters.clamp(1, all.len().max(1));
    if all.is_empty() {
        return 0;
    }
    let features: Vec<[f32; 8]> = all
        .iter()
        .map(|r| {
            let hue = [(r.radiance.x / r.radiance.y).ln() as f32, (r.radiance.z / r.radiance.y).ln() as f32];
            let n = r.normal * 0.7;
            // Hardly by place: a cluster as small as a shadow would take it for dark paint.
            let p = r.position / scale * 0.03;
            [2.0 * hue[0], 2.0 * hue[1], n.x, n.y, n.z, p.x, p.y, p.z]
        })
        .collect();
    let distance = |a: &[f32; 8], b: &[f32; 8]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
    // Farthest points to begin with: the same at any time.
    let mut centres = vec![features[0]];
    while centres.len() < k {
        let far = features
            .iter()
            .map(|f| centres.iter().map(|c| distance(f, c)).fold(f32::INFINITY, f32::min))
            .enumerate()
            .fold((0, -1.0), |best, (i, d)| if d > best.1 { (i, d) } else { best });
        centres.push(features[far.0]);
    }
    for _ in 0..ROUNDS {
        let mut sums = vec![([0.0f32; 8], 0.0f32); k];
        for (r, f) in all.iter_mut().zip(&features) {
            let best = (0..k).min_by(|&a, &b| distance(f, &centres[a]).total_cmp(&distance(f, &centres[b])));
            r.cluster = best.unwrap_or(0);
            sums[r.cluster].1 += 1.0;
            for (s, v) in sums[r.cluster].0.iter_mut().zip(f) {
                *s += v;
            }
        }
        for (c, (sum, n)) in centres.iter_mut().zip(&sums) {
            if *n > 0.0 {
                *c = sum.map(|v| v / n);
            }
        }
    }
    k
}
