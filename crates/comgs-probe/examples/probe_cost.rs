//! Seconds of everything that makes probes: fusion, farthest point sampling, baking.
//!
//! ```text
//! cargo run --release -p comgs-probe --example probe_cost -- [surfels] [probes] [resolution]
//! ```
//!
//! The object is a sphere with a neck, so that it sees itself, of overlapping surfels with harmonics of degree 3.
//! Baking is measured as it is done and, for the choice between them, ray by ray with and without colours that are
//! worked out once for each probe.

use comgs_geom::{Camera, Rng, octahedral};
use comgs_image::Image;
use comgs_probe::{
    BakeObserver, DepthView, FusionConfig, OrientedPoints, ProbeConfig, bake, bake_occlusion,
    farthest_points, fuse, place,
};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation};
use comgs_trace::{TraceConfig, Tracer};
use glam::{DVec3, Quat, Vec3};
use std::time::Instant;

fn unit(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

/// Point of the surface in a direction: radius 0.5 with a waist, so that a part of the sky is hidden.
fn surface(d: Vec3) -> Vec3 {
    d * (0.2 + 0.3 * d.z.abs())
}

fn normal(d: Vec3) -> Vec3 {
    // Gradient of ‖p‖ − 0.2 − 0.3 |z| / ‖p‖ at p = surface(d).
    let r = surface(d).length();
    (d - 0.3 / r * (Vec3::Z * d.z.signum() - d * d.z.abs())).normalize()
}

fn cloud(n: usize) -> SurfelCloud {
    let mut rng = Rng::new(1);
    let mut cloud = SurfelCloud::empty(3, ColorEncoding::Srgb);
    let scale = 0.7 * (std::f32::consts::PI / n as f32).sqrt() * 0.7;
    for _ in 0..n {
        let d = unit(&mut rng);
        let tilt = Quat::from_scaled_axis(0.1 * Vec3::new(rng.normal(), rng.normal(), rng.normal()));
        let q = tilt * Quat::from_rotation_arc(Vec3::Z, normal(d));
        cloud.positions.push((surface(d) + 0.2 * scale * rng.normal() * normal(d)).to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([(scale * (0.3 * rng.normal()).exp()).ln(); 2]);
        cloud.opacity_logits.push(activation::logit(rng.range(0.5, 0.98)));
        for k in 0..cloud.sh_stride() {
            cloud.sh.push(if k < 3 { rng.range(-0.5, 1.0) } else { 0.1 * rng.normal() });
        }
    }
    cloud
}

/// Depth and normals of a sphere of radius 0.5.
fn sphere_view(eye: DVec3, side: usize) -> DepthView {
    let camera = Camera::look_at("sphere", side, side, 0.7, eye, DVec3::ZERO, DVec3::Z);
    let (mut depth, mut normal) = (Image::zeros(side, side, 1), Image::zeros(side, side, 3));
    for y in 0..side {
        for x in 0..side {
            let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            let (a, b, c) = (ray.length_squared(), eye.dot(ray), eye.length_squared() - 0.25);
            if b * b > a * c {
                let t = (-b - (b * b - a * c).sqrt()) / a;
                depth.pixel_mut(x, y)[0] = t as f32;
                normal.pixel_mut(x, y).copy_from_slice(&(2.0 * (eye + ray * t)).as_vec3().to_array());
            }
        }
    }
    DepthView { camera, depth, normal }
}

fn timed<T>(name: &str, f: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = f();
    println!("  {name:<58}{:>9.3} s", start.elapsed().as_secs_f64());
    result
}

fn main() {
    let argument = |i: usize, or: usize| std::env::args().nth(i).and_then(|s| s.parse().ok()).unwrap_or(or);
    let (surfels, count, resolution) = (argument(1, 50_000), argument(2, 5000), argument(3, 16));
    let mut rng = Rng::new(5);
    let directions: Vec<Vec3> = (0..1_000_000).map(|_| unit(&mut rng)).collect();

    let views: Vec<DepthView> =
        directions[..60].iter().map(|d| sphere_view(2.0 * d.as_dvec3(), 400)).collect();
    println!("fusion of 60 views of 400², {:?}", FusionConfig::default());
    let (_, report) =
        timed("fuse", || fuse(&views, &FusionConfig::default())).expect("the sphere is consistent");
    println!("  {} points of {} pixels", report.points(), report.usable);

    println!("farthest point sampling, n = {count}");
    for n in [100_000, 1_000_000] {
        timed(&format!("{n} points on a sphere"), || farthest_points(&directions[..n], count));
    }
    let ball: Vec<Vec3> =
        directions.iter().enumerate().map(|(i, d)| *d * ((i as f32 + 0.5) / 1e6).cbrt()).collect();
    timed("1000000 points in a ball", || farthest_points(&ball, count));

    let config = ProbeConfig { count, resolution, ..ProbeConfig::default() };
    let points = OrientedPoints {
        positions: directions[..200_000].iter().map(|&d| surface(d)).collect(),
        normals: directions[..200_000].iter().map(|&d| normal(d)).collect(),
    };
    let mut set = place(&points, &config, 1.0).expect("the configuration is sound");
    println!("spacing {:.4}, {:.1} MB", set.spacing, set.memory_bytes() as f64 / 1e6);
    let tracer = Tracer::new(&cloud(surfels), &TraceConfig::default()).expect("the cloud is sound");

    println!("{count} probes of {resolution}² before {surfels} surfels");
    for rays in [1, 4, 16] {
        let start = Instant::now();
        bake(&tracer, &mut set, rays, BakeObserver::silent()).expect("the set is sound");
        let seconds = start.elapsed().as_secs_f64();
        let traced = (set.texels.len() * rays) as f64;
        println!("  bake, {rays:>2} rays a texel {seconds:>9.3} s {:>9.2} M rays/s", traced / seconds / 1e6);
    }
    let share = set.texels.iter().map(|t| f64::from(t[3])).sum::<f64>() / set.texels.len() as f64;
    println!("  mean occlusion {share:.4}");
    let start = Instant::now();
    bake_occlusion(&tracer, &mut set, 1, BakeObserver::silent()).expect("the set is sound");
    let seconds = start.elapsed().as_secs_f64();
    println!(
        "  occlusion alone, 1 ray a texel {seconds:.3} s, {:.2} M rays/s",
        set.texels.len() as f64 / seconds / 1e6
    );

    println!("one thread, 100 probes: ray by ray against a view of each probe");
    for side in [8usize, 16, 32, 64, 128] {
        let rays: Vec<Vec3> =
            (0..side * side).map(|t| octahedral::texel_direction(t % side, t / side, side)).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        let [single, view] = [false, true].map(|with_view| {
            let start = Instant::now();
            pool.install(|| {
                for &origin in &set.positions[..100.min(set.len())] {
                    let view = with_view.then(|| tracer.view(origin));
                    for &d in &rays {
                        let hit = match &view {
                            Some(view) => view.radiance(d, 0.0, f32::INFINITY),
                            None => tracer.radiance(origin, d, 0.0, f32::INFINITY),
                        };
                        assert!(hit.alpha <= 1.0);
                    }
                }
            });
            start.elapsed().as_secs_f64()
        });
        println!("  {:>6} rays a probe: {single:>8.3} s, view {view:>8.3} s", rays.len());
    }
}
