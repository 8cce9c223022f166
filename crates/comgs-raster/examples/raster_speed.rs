//! Speed of the rasteriser: `cargo run --release -p comgs-raster --example raster_speed`.
//!
//! 50,000 surfels on the walls of a room and on a ball in it, 512×288, colour + depth + normal, forward and backward;
//! then the same at one thread, with the instruction set that every machine of this kind has, and with scalar code, in one
//! run (arguments: count, part of a case's name). Times are the smallest of several repeats, because other programs on the
//! machine only ever add to them.
//!
//! `Level::fallback()` is scalar source code. The compiler still vectorises it with what the target always has (SSE2 on
//! x86-64, four lanes), so "SIMD over scalar" compares with that; a build whose scalar code is really scalar is
//! `RUSTFLAGS="-C no-vectorize-slp -C no-vectorize-loops" cargo run --release -p comgs-raster --example raster_speed`.
//!
//! A splat-pixel evaluation is one surfel at one pixel of a tile whose list it is on, in one pass: 64 for each of the
//! (surfel, tile) pairs, twice. Rows that a surfel does not reach are skipped, so fewer are computed.

use comgs_geom::{Camera, Rng};
use comgs_image::Image;
use comgs_raster::{FrameGradient, Planes, RasterConfig, SurfelGradients, Workspace, backward, forward};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use fearless_simd::Level;
use glam::{DVec3, Quat, Vec3};
use std::time::Instant;

fn room(count: usize) -> SurfelCloud {
    let mut rng = Rng::new(1);
    let mut cloud = SurfelCloud::empty(3, ColorEncoding::Srgb);
    for i in 0..count {
        let (p, n) = if i % 5 == 0 {
            let n = Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            (n * 0.8 + Vec3::new(0.0, 0.0, 0.8), n)
        } else {
            let mut p = Vec3::new(rng.range(-3.0, 3.0), rng.range(-3.0, 3.0), rng.range(0.0, 3.0));
            let axis = rng.below(3);
            let side = if rng.uniform() < 0.5 { -1.0 } else { 1.0 };
            let mut n = Vec3::ZERO;
            n[axis] = -side;
            p[axis] = if axis == 2 { if side < 0.0 { 0.0 } else { 3.0 } } else { 3.0 * side };
            (p, n)
        };
        let q = Quat::from_rotation_arc(Vec3::Z, n) * Quat::from_rotation_z(rng.range(0.0, 6.0));
        cloud.positions.push(p.to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([rng.range(-4.5, -3.0), rng.range(-4.5, -3.0)]);
        cloud.opacity_logits.push(rng.range(-1.0, 4.0));
        for k in 0..48 {
            cloud.sh.push(if k < 3 { rng.normal() } else { 0.1 * rng.normal() });
        }
    }
    cloud
}

fn main() {
    let count = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(50_000);
    let cloud = room(count);
    let camera =
        Camera::look_at("a", 512, 288, 1.2, DVec3::new(2.5, -2.2, 1.9), DVec3::new(0.0, 0.0, 0.8), DVec3::Z);
    let image = |c: usize| Some(Image::filled(512, 288, c, 0.1));
    let gradient = FrameGradient {
        color: image(3),
        weight: image(1),
        depth: image(1),
        normal: image(3),
        ..Default::default()
    };
    let measure = |planes: Planes, level: Level, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let config = RasterConfig { level, ..Default::default() };
            let mut workspace = Workspace::default();
            let mut gradients = SurfelGradients::zeros(&cloud);
            let (mut best_forward, mut best_backward) = (f64::INFINITY, f64::INFINITY);
            let mut evaluations = 0.0;
            for _ in 0..12 {
                let start = Instant::now();
                let frame = forward(&cloud, &camera, planes, &config, &mut workspace);
                best_forward = best_forward.min(start.elapsed().as_secs_f64());
                let start = Instant::now();
                gradients.reset(&cloud);
                backward(&cloud, &camera, &frame, &gradient, &config, &mut workspace, &mut gradients);
                best_backward = best_backward.min(start.elapsed().as_secs_f64());
                evaluations = workspace.pairs() as f64 * 64.0;
            }
            (best_forward, best_backward, evaluations, workspace.visible())
        })
    };
    let (best, base, scalar) = (Level::new(), Level::baseline(), Level::fallback());
    let rows = [
        ("colour, best SIMD, 2 threads", Planes::COLOR, best, 2),
        ("colour+depth+normal, best SIMD, 2 threads", Planes::GEOMETRY, best, 2),
        ("colour+depth+normal, best SIMD, 1 thread", Planes::GEOMETRY, best, 1),
        ("colour+depth+normal, baseline, 1 thread", Planes::GEOMETRY, base, 1),
        ("colour+depth+normal, scalar, 1 thread", Planes::GEOMETRY, scalar, 1),
        ("all planes, best SIMD, 2 threads", Planes::ALL, best, 2),
    ];
    println!("best SIMD {best:?}, baseline {base:?}");
    println!("| case | forward ms | backward ms | both ms | splat-pixel evaluations/s |");
    println!("|---|---|---|---|---|");
    let filter = std::env::args().nth(2).unwrap_or_default();
    let mut both = Vec::new();
    for (name, planes, level, threads) in rows.into_iter().filter(|row| row.0.contains(&filter)) {
        let (f, b, evaluations, visible) = measure(planes, level, threads);
        println!(
            "| {name} ({visible} visible) | {:.1} | {:.1} | {:.1} | {:.0} M |",
            f * 1e3,
            b * 1e3,
            (f + b) * 1e3,
            2.0 * evaluations / (f + b) / 1e6
        );
        both.push((name, [f, b, f + b]));
    }
    let time = |part: &str| both.iter().find(|(name, _)| name.contains(part)).map(|(_, seconds)| *seconds);
    for (what, slow, fast) in [
        ("1 to 2 threads", "normal, best SIMD, 1", "normal, best SIMD, 2"),
        ("best SIMD over baseline", "baseline", "normal, best SIMD, 1"),
        ("best SIMD over scalar", "scalar", "normal, best SIMD, 1"),
    ] {
        if let (Some(slow), Some(fast)) = (time(slow), time(fast)) {
            let [f, b, both] = [0, 1, 2].map(|i| slow[i] / fast[i]);
            println!("{what}: {both:.2}× (forward {f:.2}×, backward {b:.2}×)");
        }
    }
}
