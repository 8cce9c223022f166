//! Occlusion rays per second: surfels against triangles, as many of them in the same places, in one run.
//!
//! ```text
//! cargo run --release -p comgs-trace --example rays_per_second -- [primitives]
//! ```
//!
//! Surfels go through this crate (transmittance: every surfel on the ray counts until less than 1e-4 passes) and,
//! to judge the choice of tree, as scalar discs through obvhs' own two traversals. Triangles go through `obvhs`
//! as it is made for (any hit ends the ray), each as large as its surfel's effective area ∫ exp(−(u² + v²)/2) = 2π s².
//! The cost of a ray depends on what it meets, so the mean number of surfels on a ray is printed as well.

use comgs_geom::{Rng, sh};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation};
use comgs_trace::{Ray, TraceConfig, Tracer};
use glam::{Mat3, Quat, Vec3, Vec3A};
use obvhs::{
    BvhBuildParams,
    aabb::Aabb,
    bvh2::{Bvh2, builder::build_bvh2},
    cwbvh::{CwBvh, builder::build_cwbvh},
    ray as obvhs_ray,
    triangle::Triangle,
};
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// A surfel, as all of the contestants are made from it.
#[derive(Clone, Copy)]
struct Patch {
    centre: Vec3,
    rotation: Mat3,
    scale: f32,
    opacity: f32,
}

fn patch(rng: &mut Rng, centre: Vec3, normal: Vec3, scale: f32) -> Patch {
    let tilt = Quat::from_scaled_axis(0.1 * Vec3::new(rng.normal(), rng.normal(), rng.normal()));
    let rotation = Mat3::from_quat(tilt * Quat::from_rotation_arc(Vec3::Z, normal));
    let scale = scale * (0.3 * rng.normal()).exp();
    Patch {
        centre: centre + 0.2 * scale * rng.normal() * normal,
        rotation,
        scale,
        opacity: rng.range(0.3, 0.95),
    }
}

fn direction(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

/// An object on a floor that is not there: a knobbly sphere of radius 0.5 whose shadow is wanted. Rays go from the
/// plane beneath to the upper half space; two thirds miss.
fn object(n: usize, rays: usize) -> (Vec<Patch>, Vec<Ray>) {
    let mut rng = Rng::new(1);
    let size = (std::f32::consts::PI / n as f32).sqrt();
    let patches = (0..n)
        .map(|_| {
            let d = direction(&mut rng);
            let radius = 0.5 + 0.05 * (9.0 * d.x).sin() * (7.0 * d.y).cos();
            patch(&mut rng, Vec3::new(0.0, 0.0, 0.55) + radius * d, d, 0.7 * size)
        })
        .collect();
    // As shadows are traced: from one point after another to many directions.
    let side = (rays / 64).isqrt();
    let rays = (0..side * side)
        .flat_map(|k| {
            let p =
                3.0 * (Vec3::new((k % side) as f32, (k / side) as f32, 0.0) / side as f32 - 0.5).with_z(0.0);
            let mut rng = Rng::stream(2, k as u64);
            (0..64).map(move |_| {
                let d = direction(&mut rng);
                Ray::new(p, d.with_z(d.z.abs()))
            })
        })
        .collect();
    (patches, rays)
}

/// A closed room of 4 × 4 × 2.5, seen from points inside it: every ray is stopped.
fn room(n: usize, rays: usize) -> (Vec<Patch>, Vec<Ray>) {
    let mut rng = Rng::new(3);
    let size = (72.0 / n as f32).sqrt();
    let patches = (0..n)
        .map(|i| {
            let (a, b, h) = (rng.range(-2.0, 2.0), rng.range(-2.0, 2.0), rng.range(0.0, 2.5));
            let side = if i % 2 == 0 { 2.0 } else { -2.0 };
            let (centre, normal) = match i % 9 {
                0..3 => (Vec3::new(side, a, h), Vec3::X),
                3..6 => (Vec3::new(a, side, h), Vec3::Y),
                _ => (Vec3::new(a, b, 1.25 * (1.0 + side / 2.0)), Vec3::Z),
            };
            patch(&mut rng, centre, normal, 0.7 * size)
        })
        .collect();
    let rays = (0..rays)
        .map(|k| {
            let mut rng = Rng::stream(4, k as u64 / 64);
            let origin = Vec3::new(rng.range(-1.5, 1.5), rng.range(-1.5, 1.5), rng.range(0.5, 2.0));
            let mut rng = Rng::stream(5, k as u64);
            Ray::new(origin, direction(&mut rng))
        })
        .collect();
    (patches, rays)
}

fn cloud(patches: &[Patch]) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for p in patches {
        let q = Quat::from_mat3(&p.rotation);
        cloud.positions.push(p.centre.to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([p.scale.ln(); 2]);
        cloud.opacity_logits.push(activation::logit(p.opacity));
        cloud.sh.extend([0.5 / sh::C0; 3]);
    }
    cloud
}

/// Equilateral, of area 2π s².
fn triangle(p: &Patch) -> Triangle {
    let area = 2.0 * std::f32::consts::PI * p.scale * p.scale;
    let radius = (4.0 * area / (3.0 * 3.0f32.sqrt())).sqrt();
    let corner = |k: f32| {
        let (s, c) = (k * std::f32::consts::TAU / 3.0).sin_cos();
        Vec3A::from(p.centre + radius * (c * p.rotation.x_axis + s * p.rotation.y_axis))
    };
    Triangle { v0: corner(0.0), v1: corner(1.0), v2: corner(2.0) }
}

/// One surfel as a scalar routine wants it.
#[derive(Clone, Copy)]
struct Disc {
    centre: Vec3A,
    normal: Vec3A,
    u: Vec3A,
    v: Vec3A,
    log_opacity: f32,
}

impl Disc {
    fn new(p: &Patch) -> Self {
        let m = p.rotation;
        Self {
            centre: p.centre.into(),
            normal: m.z_axis.into(),
            u: (m.x_axis / p.scale).into(),
            v: (m.y_axis / p.scale).into(),
            log_opacity: p.opacity.ln(),
        }
    }

    fn aabb(p: &Patch) -> Aabb {
        let r = (2.0 * (p.opacity * 255.0).ln()).sqrt() * p.scale;
        let (a, b) = (p.rotation.x_axis * r, p.rotation.y_axis * r);
        let half = Vec3A::new(a.x.hypot(b.x), a.y.hypot(b.y), a.z.hypot(b.z)) + 1e-3 * r;
        Aabb::new(Vec3A::from(p.centre) - half, Vec3A::from(p.centre) + half)
    }

    #[inline(always)]
    fn alpha(&self, ray: &obvhs_ray::Ray) -> f32 {
        let offset = self.centre - ray.origin;
        let t = self.normal.dot(offset) / self.normal.dot(ray.direction);
        if !(t >= ray.tmin && t < ray.tmax) {
            return 0.0;
        }
        let hit = t * ray.direction - offset;
        let (u, v) = (self.u.dot(hit), self.v.dot(hit));
        let log_alpha = self.log_opacity - 0.5 * (u * u + v * v);
        if log_alpha < -5.541_263_5 { 0.0 } else { log_alpha.exp().min(0.99) }
    }
}

fn obvhs_ray(ray: &Ray) -> obvhs_ray::Ray {
    obvhs_ray::Ray::new(ray.origin.into(), ray.direction.into(), ray.t_min, ray.t_max)
}

fn discs_cwbvh(bvh: &CwBvh, discs: &[Disc], ray: &Ray) -> f32 {
    let mut t = 1.0f32;
    bvh.ray_traverse_miss(obvhs_ray(ray), |ray, id| {
        t *= 1.0 - discs[id].alpha(ray);
        if t < 1e-4 { 0.0 } else { f32::INFINITY }
    });
    t
}

fn discs_bvh2(bvh: &Bvh2, discs: &[Disc], ray: &Ray) -> f32 {
    let mut t = 1.0f32;
    bvh.ray_traverse_miss(obvhs_ray(ray), |ray, id| {
        t *= 1.0 - discs[id].alpha(ray);
        if t < 1e-4 { 0.0 } else { f32::INFINITY }
    });
    t
}

/// Rounds of which the best counts; many short ones find a quiet moment of a busy machine.
const ROUNDS: usize = 15;

/// Rays per second of the best round, in millions, at 1 and 2 threads; and the share of rays that pass.
fn measure(name: &str, rays: &[Ray], trace: impl Fn(&[Ray]) -> Vec<f32> + Sync) {
    print!("  {name:<44}");
    let mut passed = 0.0;
    for threads in [1, 2] {
        let pool =
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of two threads");
        let mut best = f64::MAX;
        for _ in 0..ROUNDS {
            let start = Instant::now();
            let result = pool.install(|| trace(rays));
            best = best.min(start.elapsed().as_secs_f64());
            passed = result.iter().map(|&t| f64::from(t)).sum::<f64>() / rays.len() as f64;
        }
        print!("{:>12.2}", rays.len() as f64 / best / 1e6);
    }
    println!("{passed:>14.4}");
}

fn batch(rays: &[Ray], one: impl Fn(&Ray) -> f32 + Sync + Send) -> Vec<f32> {
    rays.par_iter().with_min_len(64).map(one).collect()
}

fn main() {
    let n: usize = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(50_000);
    println!("{n} primitives, occlusion; millions of rays per second");
    for (scene, (patches, rays)) in
        [("object from the floor below", object(n, 1 << 17)), ("closed room from inside", room(n, 1 << 16))]
    {
        let start = Instant::now();
        let tracer = Tracer::new(&cloud(&patches), &TraceConfig::occlusion()).expect("the cloud is sound");
        let built = start.elapsed();
        let met: usize =
            rays.iter().step_by(97).map(|r| tracer.hits(r.origin, r.direction, r.t_min, r.t_max).len()).sum();
        println!(
            "\n{scene}: {} rays, {:.1} surfels on the mean ray, tree built in {built:.2?}",
            rays.len(),
            met as f64 / rays.len().div_ceil(97) as f64
        );
        println!("  {:<44}{:>12}{:>12}{:>14}", "", "1 thread", "2 threads", "mean passed");

        let triangles: Vec<Triangle> = patches.iter().map(triangle).collect();
        let boxes: Vec<Aabb> = patches.iter().map(Disc::aabb).collect();
        let params = BvhBuildParams::medium_build();
        let mut time = Duration::ZERO;
        measure("surfels, comgs-trace", &rays, |rays| tracer.transmittance_batch(rays));
        {
            let bvh = build_cwbvh(&boxes, params, &mut time);
            let discs: Vec<Disc> =
                bvh.primitive_indices.iter().map(|&i| Disc::new(&patches[i as usize])).collect();
            measure("surfels, obvhs CwBvh + scalar discs", &rays, |rays| {
                batch(rays, |r| discs_cwbvh(&bvh, &discs, r))
            });
            let bvh = build_bvh2(&boxes, params, &mut time);
            let discs: Vec<Disc> =
                bvh.primitive_indices.iter().map(|&i| Disc::new(&patches[i as usize])).collect();
            measure("surfels, obvhs Bvh2 + scalar discs", &rays, |rays| {
                batch(rays, |r| discs_bvh2(&bvh, &discs, r))
            });
        }
        {
            let bvh = build_cwbvh(&triangles, params, &mut time);
            let ordered: Vec<Triangle> =
                bvh.primitive_indices.iter().map(|&i| triangles[i as usize]).collect();
            measure("triangles, obvhs CwBvh, any hit", &rays, |rays| {
                batch(rays, |r| {
                    f32::from(bvh.ray_traverse_miss(obvhs_ray(r), |ray, id| ordered[id].intersect(ray)))
                })
            });
            let bvh = build_bvh2(&triangles, params, &mut time);
            let ordered: Vec<Triangle> =
                bvh.primitive_indices.iter().map(|&i| triangles[i as usize]).collect();
            measure("triangles, obvhs Bvh2, any hit", &rays, |rays| {
                batch(rays, |r| {
                    f32::from(bvh.ray_traverse_miss(obvhs_ray(r), |ray, id| ordered[id].intersect(ray)))
                })
            });
        }
    }
}
