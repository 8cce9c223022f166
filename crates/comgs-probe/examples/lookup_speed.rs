//! Lookups per second of both ways to read probes, and of their gradient.
//!
//! ```text
//! cargo run --release -p comgs-probe --example lookup_speed -- [probes] [resolution] [directions]
//! ```
//!
//! A batch of shading points on a sphere, as an iteration of inverse rendering has it, each with the same number of
//! directions in its upper hemisphere. Blend, then sample: K textures are summed once, and every direction takes four
//! taps. Sample, then blend: every direction takes 4 K taps. Best of several rounds, at 1 and 2 threads.

use comgs_geom::{Rng, octahedral};
use comgs_probe::{
    LookupConfig, OrientedPoints, ProbeConfig, ProbeIndex, ProbeSet, VisibilityWeight, place, sample,
    sample_vjp,
};
use glam::{Vec3, Vec4};
use rayon::prelude::*;
use std::time::Instant;

const POINTS: usize = 4096;
const ROUNDS: usize = 9;

fn unit(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

/// A sphere of size 1 with random textures whose moments see the sphere's inside as near.
fn probes(count: usize, resolution: usize) -> (ProbeSet, ProbeConfig) {
    let mut rng = Rng::new(1);
    let normals: Vec<Vec3> = (0..20 * count).map(|_| unit(&mut rng)).collect();
    let points = OrientedPoints { positions: normals.iter().map(|n| 0.5 * *n).collect(), normals };
    let config = ProbeConfig { count, resolution, ..ProbeConfig::default() };
    let mut set = place(&points, &config, 1.0).expect("the configuration is sound");
    for texel in &mut set.texels {
        *texel = [rng.uniform(), rng.uniform(), rng.uniform(), rng.uniform()];
    }
    let texture = set.texture_len();
    for (i, m) in set.moments.iter_mut().enumerate() {
        let d = octahedral::texel_direction(i % texture % resolution, i % texture / resolution, resolution);
        if d.dot(set.normals[i / texture]) < 0.0 {
            let distance = rng.range(0.2, 1.0) * set.far_distance;
            *m = [distance, 1.1 * distance * distance];
        }
    }
    (set, config)
}

/// Seconds of the best round.
fn best(threads: usize, mut f: impl FnMut() -> f32 + Send) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    let mut best = f64::MAX;
    for _ in 0..ROUNDS {
        let start = Instant::now();
        let result = pool.install(&mut f);
        best = best.min(start.elapsed().as_secs_f64());
        assert!(result.is_finite());
    }
    best
}

fn row(name: &str, unit: &str, count: usize, seconds: [f64; 2]) {
    print!("  {name:<42}");
    for s in seconds {
        print!("{:>9.2} ms {:>8.2} M{unit}/s", 1e3 * s, count as f64 / s / 1e6);
    }
    println!();
}

fn both(mut f: impl FnMut() -> f32 + Send) -> [f64; 2] {
    [best(1, &mut f), best(2, &mut f)]
}

fn main() {
    let argument = |i: usize, or: usize| std::env::args().nth(i).and_then(|s| s.parse().ok()).unwrap_or(or);
    let (count, resolution, rays) = (argument(1, 5000), argument(2, 16), argument(3, 128));
    let (set, config) = probes(count, resolution);
    let index: ProbeIndex = set.index(&config);
    let mut rng = Rng::new(2);
    let normals: Vec<Vec3> = (0..POINTS).map(|_| unit(&mut rng)).collect();
    let points: Vec<Vec3> = normals.iter().map(|n| 0.5 * *n).collect();
    let directions: Vec<Vec3> = normals
        .iter()
        .flat_map(|n| {
            let mut rng = Rng::stream(3, u64::from(n.x.to_bits()));
            (0..rays)
                .map(move |_| unit(&mut rng))
                .map(|d| if d.dot(*n) < 0.0 { -d } else { d })
                .collect::<Vec<_>>()
        })
        .collect();
    let chebyshev = LookupConfig::new(&set, &config);
    let plain = LookupConfig { visibility: VisibilityWeight::None, ..chebyshev.clone() };
    let within =
        points.iter().map(|x| set.positions.iter().filter(|p| p.distance(*x) < index.radius()).count());
    println!(
        "{count} probes of {resolution}², {POINTS} points with {rays} directions, K = {}; {:.1} probes in the \
         radius on average; {:.1} MB and {:.2} MB of index",
        config.neighbours,
        within.sum::<usize>() as f64 / POINTS as f64,
        set.memory_bytes() as f64 / 1e6,
        index.memory_bytes() as f64 / 1e6
    );
    println!("  {:<42}{:>22}{:>22}", "", "1 thread", "2 threads");

    let query = |config: &LookupConfig| index.query_batch(&points, &normals, &set, config);
    row("query, no visibility", "points", POINTS, both(|| query(&plain)[7].weights[0]));
    row("query, Chebyshev", "points", POINTS, both(|| query(&chebyshev)[7].weights[0]));

    let neighbours = query(&chebyshev);
    let texture = set.texture_len();
    let blend_then_sample = || {
        let shade = |(n, directions): (&_, &[Vec3])| {
            let mut blended = vec![[0.0f32; 4]; texture];
            set.blend(n, &mut blended);
            directions.iter().map(|&d| Vec4::from_array(sample(&blended, resolution, d))).sum::<Vec4>()
        };
        let sums: Vec<Vec4> = neighbours.par_iter().zip(directions.par_chunks(rays)).map(shade).collect();
        sums.iter().sum::<Vec4>().w
    };
    let sample_then_blend = || {
        let shade = |(n, directions): (&_, &[Vec3])| {
            directions.iter().map(|&d| Vec4::from_array(set.lookup(n, d))).sum::<Vec4>()
        };
        let sums: Vec<Vec4> = neighbours.par_iter().zip(directions.par_chunks(rays)).map(shade).collect();
        sums.iter().sum::<Vec4>().w
    };
    let (a, b) = (blend_then_sample(), sample_then_blend());
    assert!((a / b - 1.0).abs() < 1e-4, "{a} {b}");
    let blend_only = || {
        let mut blended = vec![[0.0f32; 4]; POINTS * texture];
        blended.par_chunks_mut(texture).zip(&neighbours).for_each(|(out, n)| set.blend(n, out));
        blended[3][3]
    };
    row("blend, then sample", "lookups", POINTS * rays, both(blend_then_sample));
    row("sample, then blend", "lookups", POINTS * rays, both(sample_then_blend));
    row("blend alone, all textures kept", "points", POINTS, both(blend_only));

    let mut grad_blended = vec![[0.0f32; 4]; POINTS * texture];
    let mut scatter = || {
        grad_blended.fill([0.0; 4]);
        grad_blended.par_chunks_mut(texture).zip(directions.par_chunks(rays)).for_each(
            |(grad, directions)| {
                directions.iter().for_each(|&d| sample_vjp(resolution, d, [1.0, 0.5, 0.25, 2.0], grad));
            },
        );
        grad_blended[5][0]
    };
    row("gradient of sample", "lookups", POINTS * rays, both(&mut scatter));
    let mut grad = vec![[0.0f32; 4]; set.texels.len()];
    let gather = || {
        set.blend_vjp(&neighbours, &grad_blended, &mut grad);
        grad[0][0]
    };
    row("gradient of blend", "points", POINTS, both(gather));
}
