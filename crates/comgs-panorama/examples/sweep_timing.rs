//! Time of a 512 × 256 sweep and its completion in a room of surfels:
//! `cargo run --release -p comgs-panorama --example sweep_timing -- [surfels]`

use comgs_geom::{Rng, sh};
use comgs_panorama::{Completion, SweepConfig, sweep};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use comgs_trace::{TraceConfig, Tracer};
use glam::{Quat, Vec3};
use std::time::Instant;

/// Surfels as a reconstruction leaves them: on the walls and floor of a room of 4 × 4 × 2.5, jittered off the surface,
/// of overlapping sizes; the ceiling is missing; one in twenty is a floater.
fn room(n: usize) -> SurfelCloud {
    let mut rng = Rng::new(1);
    let mut cloud = SurfelCloud::empty(3, ColorEncoding::Srgb);
    // Mean distance of n surfels spread over the 56 square units of the surfaces.
    let size = (56.0 / n as f32).sqrt();
    for i in 0..n {
        let (a, b) = (rng.range(-2.0, 2.0), rng.range(-2.0, 2.0));
        let height = rng.range(0.0, 2.5);
        let (centre, normal) = match i % 20 {
            0 => (Vec3::new(a, b, height), Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()),
            1..6 => (Vec3::new(a, b, 0.0), Vec3::Z),
            6..13 => (Vec3::new(if i % 2 == 0 { 2.0 } else { -2.0 }, b, height), Vec3::X),
            _ => (Vec3::new(a, if i % 2 == 0 { 2.0 } else { -2.0 }, height), Vec3::Y),
        };
        let tilt = Quat::from_scaled_axis(0.1 * Vec3::new(rng.normal(), rng.normal(), rng.normal()));
        let q = tilt * Quat::from_rotation_arc(Vec3::Z, normal);
        cloud.positions.push((centre + 0.01 * rng.normal() * normal).to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        let scale = || (0.7 * size).ln();
        cloud.log_scales.push([scale() + 0.4 * rng.normal(), scale() + 0.4 * rng.normal()]);
        cloud.opacity_logits.push(if i % 20 == 0 { -3.0 } else { rng.range(-1.0, 3.0) });
        for k in 0..cloud.sh_stride() {
            cloud.sh.push(if k < 3 { rng.range(-1.0, 1.0) / sh::C0 * 0.3 } else { 0.05 * rng.normal() });
        }
    }
    cloud
}

fn main() {
    let n = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(50_000);
    let cloud = room(n);
    for threads in [1, 2] {
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of two threads");
        pool.install(|| {
            let start = Instant::now();
            let tracer = Tracer::new(&cloud, &TraceConfig::default()).expect("the cloud is sound");
            let built = start.elapsed();
            let start = Instant::now();
            let got = sweep(&tracer, Vec3::new(0.2, -0.3, 0.8), 512, 256, &SweepConfig::default());
            let swept = start.elapsed();
            let start = Instant::now();
            let complete = got.complete(Completion::Harmonic).expect("most of the room is seen");
            println!(
                "{n} surfels, {threads} thread(s): build {built:.2?}, sweep 512×256 {swept:.2?}, completion {:.2?} \
                 (coverage {:.2}, mean radiance {:.3})",
                start.elapsed(),
                got.coverage,
                complete.data.iter().sum::<f32>() / complete.data.len() as f32
            );
        });
    }
}
