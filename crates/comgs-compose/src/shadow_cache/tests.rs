//! Cached against exact.

use super::*;
use crate::field_shadow::StrongFrom;
use comgs_geom::Camera;
use glam::DVec3;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A shadow with a soft part, a sharp edge and a thin bar, known everywhere.
struct Painted {
    asked: AtomicUsize,
}

impl Painted {
    fn new() -> Self {
        Self { asked: AtomicUsize::new(0) }
    }

    fn at(point: Vec3, normal: Vec3) -> Vec3 {
        let soft = 1.0 - 0.5 * (-point.length_squared()).exp();
        let disc = (point - Vec3::new(1.0, 0.0, 0.0)).length() < 0.4;
        let bar = (point.y - 0.3).abs() < 0.02 && point.x.abs() < 1.0;
        let sharp = if normal.z > 0.5 && (disc || bar) { 0.3 } else { 1.0 };
        Vec3::new(1.0, 0.9, 0.8) * soft * sharp
    }
}

impl ShadowRatios for Painted {
    fn ratios(&self, points: &[Vec3], normals: &[Vec3]) -> Vec<Vec3> {
        self.asked.fetch_add(points.len(), Ordering::Relaxed);
        points.iter().zip(normals).map(|(p, n)| Self::at(*p, *n)).collect()
    }
    fn spheres(&self) -> Vec<(Vec3, f32)> {
        vec![(Vec3::new(0.0, 0.0, 0.5), 0.5)]
    }
    fn strong(&self) -> Vec<StrongFrom> {
        Vec::new()
    }
}

fn camera() -> Camera {
    Camera::look_at("a", 160, 120, 0.9, DVec3::new(2.5, -3.0, 2.2), DVec3::ZERO, DVec3::Z)
}

/// Floor at z = 0 with a wall at y = 2, as the camera sees it.
fn room(camera: &Camera) -> Receivers {
    let eye = camera.centre();
    let mut receivers = Receivers {
        width: camera.width,
        height: camera.height,
        points: vec![eye.as_vec3(); camera.width * camera.height],
        normals: vec![Vec3::ZERO; camera.width * camera.height],
    };
    for y in 0..camera.height {
        for x in 0..camera.width {
            let d = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            let floor = if d.z < 0.0 { -eye.z / d.z } else { f64::INFINITY };
            let wall = if d.y > 0.0 { (2.0 - eye.y) / d.y } else { f64::INFINITY };
            let (t, normal) = if floor < wall { (floor, Vec3::Z) } else { (wall, -Vec3::Y) };
            if t.is_finite() {
                receivers.points[y * camera.width + x] = (eye + d * t).as_vec3();
                receivers.normals[y * camera.width + x] = normal;
            }
        }
    }
    receivers
}

fn cloud(camera: &Camera) -> ReceiverCloud {
    let mut cloud = ReceiverCloud::default();
    cloud.add(camera, &room(camera));
    cloud
}

fn error(cache: &ShadowCache, camera: &Camera, exact: &Painted) -> (f32, f32, usize) {
    let receivers = room(camera);
    let read = cache.read(&receivers, exact);
    let mut errors: Vec<f32> = (0..receivers.points.len())
        .filter(|&i| receivers.is_surface(i))
        .map(|i| {
            let truth = Painted::at(receivers.points[i], receivers.normals[i]);
            (Vec3::from_slice(&read.ratio.data[3 * i..3 * i + 3]) - truth).abs().max_element()
        })
        .collect();
    errors.sort_by(f32::total_cmp);
    let rms = (errors.iter().map(|e| e * e).sum::<f32>() / errors.len() as f32).sqrt();
    (rms, errors[errors.len() * 9 / 10], read.missed)
}

/// Goal: the cache gives the exact ratio within its tolerance where that is smooth, follows edges to about a pixel, misses
/// nothing that its own camera sees, and asks far fewer points than there are pixels.
#[test]
fn cached_ratios_follow_the_exact_ones() {
    let (camera, exact) = (camera(), Painted::new());
    let cloud = cloud(&camera);
    let cache = ShadowCache::build(&cloud, &exact, &CacheConfig { pixels: 1.0, ..CacheConfig::default() });
    let (rms, ninety, missed) = error(&cache, &camera, &exact);
    assert_eq!(missed, 0);
    assert!(rms < 0.05 && ninety < 0.01, "rms {rms}, nine of ten within {ninety}");
    let asked = cache.statistics().evaluated;
    assert!(asked * 2 < cloud.len(), "{asked} for {} points", cloud.len());
    // A coarser tolerance asks less and errs more.
    let coarse = ShadowCache::build(
        &cloud,
        &exact,
        &CacheConfig { tolerance: 0.08, pixels: 4.0, ..CacheConfig::default() },
    );
    assert!(coarse.statistics().evaluated < asked);
    assert!(error(&coarse, &camera, &exact).0 > rms);
}

/// Goal: a camera that the cache was not built for gets right ratios: what is not covered is worked out.
#[test]
fn other_cameras_are_right_too() {
    let (camera, exact) = (camera(), Painted::new());
    let cache = ShadowCache::build(&cloud(&camera), &exact, &CacheConfig::default());
    let other = Camera::look_at("b", 160, 120, 0.9, DVec3::new(-3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z);
    let (rms, _, missed) = error(&cache, &other, &exact);
    assert!(rms < 0.08, "{rms}");
    assert!(missed > 0 && missed < 160 * 120 / 2, "{missed}");
}

/// Goal: floor and wall in one cell do not mix, the same build gives the same bytes on one thread and on several, zero
/// points give an empty cache whose frames are all worked out.
#[test]
fn classes_repeatability_and_nothing_to_cover() {
    let (camera, exact) = (camera(), Painted::new());
    let cloud = cloud(&camera);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let build = || ShadowCache::build(&cloud, &exact, &CacheConfig::default());
    let (a, b) = (build(), one.install(build));
    assert_eq!(a.ratios, b.ratios);
    let receivers = room(&camera);
    assert_eq!(a.read(&receivers, &exact).ratio, b.read(&receivers, &exact).ratio);
    let none = ShadowCache::build(&ReceiverCloud::default(), &exact, &CacheConfig::default());
    assert_eq!(none.statistics().cells, 0);
    let (rms, _, missed) = error(&none, &camera, &exact);
    assert!(rms == 0.0 && missed > 10_000);
    assert_eq!(CacheConfig { tolerance: 0.0, pixels: f32::NAN, largest: -1.0 }.check().len(), 3);
}
