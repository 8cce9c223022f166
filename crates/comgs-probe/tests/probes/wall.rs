//! A free-standing wall of size 1, thinner than the probes are apart: bright on one face, dark on the other.

use crate::support::{baked, direction, empty, rectangle, rectangle_points, tracer};
use comgs_geom::Rng;
use comgs_probe::{LookupConfig, OrientedPoints, ProbeConfig};
use glam::Vec3;

/// What shading points of the dark face get from probes.
#[derive(Clone, Copy, Debug)]
pub struct Leak {
    /// Mean occlusion from the half space before the face, in which there is nothing: truth is 0.
    pub occlusion: f64,
    /// Mean radiance from there: truth is 0.
    pub radiance: f64,
    /// Mean share of the weight that probes of the other face have.
    pub weight: f64,
    /// Probes of the own face among the neighbours whose weight is less than half of what it is without visibility, as
    /// a share: what the visibility weight takes away wrongly.
    pub lost: f64,
}

/// Directions nearer to the face than this sine are left out: there a texel sees the wall as well.
const LOWEST: f32 = 0.35;

/// Places and bakes probes on both faces of a wall of the given thickness and looks up 400 points of the dark one.
pub fn leak(config: &ProbeConfig, thickness: f32, rays: usize, adjust: impl Fn(&mut LookupConfig)) -> Leak {
    let (u, v) = (0.5 * Vec3::Y, 0.5 * Vec3::Z);
    let half = 0.5 * thickness * Vec3::X;
    let mut cloud = empty();
    rectangle(&mut cloud, half, u, v, 80, Vec3::ZERO);
    rectangle(&mut cloud, -half, v, u, 80, Vec3::ONE);
    let tracer = tracer(&cloud);
    let mut points = OrientedPoints::default();
    rectangle_points(&mut points, half, u, v, 100);
    rectangle_points(&mut points, -half, v, u, 100);
    let set = baked(&points, &tracer, config, 1.0, rays);
    let index = set.index(config);
    let mut lookup = LookupConfig::new(&set, config);
    adjust(&mut lookup);
    let plain = LookupConfig { visibility: comgs_probe::VisibilityWeight::None, ..lookup.clone() };

    let mut rng = Rng::new(3);
    let (mut sum, mut lost, mut own) = ([0.0f64; 3], 0usize, 0usize);
    let (shaded, directions) = (400, 32);
    for _ in 0..shaded {
        let x = half + 0.8 * (rng.range(-1.0, 1.0) * u + rng.range(-1.0, 1.0) * v);
        let neighbours = index.query(x, Vec3::X, &set, &lookup);
        let without = index.query(x, Vec3::X, &set, &plain);
        let visible = |k: usize| neighbours.weights[k] / without.weights[k];
        let count = neighbours.count as usize;
        let most = (0..count).map(visible).fold(0.0, f32::max);
        for k in 0..count {
            if set.normals[neighbours.probes[k] as usize].x < 0.0 {
                sum[2] += f64::from(neighbours.weights[k]);
            } else {
                own += 1;
                lost += usize::from(visible(k) < 0.5 * most);
            }
        }
        let mut seen = 0;
        while seen < directions {
            let d = direction(&mut rng);
            if d.x > LOWEST {
                let [r, g, b, o] = set.lookup(&neighbours, d);
                sum[0] += f64::from(o) / f64::from(directions);
                sum[1] += f64::from(r + g + b) / (3.0 * f64::from(directions));
                seen += 1;
            }
        }
    }
    let mean = |v: f64| v / f64::from(shaded);
    Leak {
        occlusion: mean(sum[0]),
        radiance: mean(sum[1]),
        weight: mean(sum[2]),
        lost: lost as f64 / own as f64,
    }
}
