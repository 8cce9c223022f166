//! Training end to end on a small analytic capture, and hard cases 11 to 16 of the list that the design keeps.

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_inverse::train::Silent;
use comgs_inverse::{Kind, Observer, Quality, TrainConfig, TrainError, TrainView, Trained, train};
use comgs_raster::{Planes, RasterConfig, render};
use glam::DVec3;
use std::time::{Duration, Instant};

const SIZE: usize = 48;

/// A striped ball of radius ½·`scale` at the origin, seen from `count` places on a sphere; exact images and masks.
fn ball(count: usize, scale: f64, offset: f64) -> Vec<TrainView> {
    (0..count)
        .map(|i| {
            let z = 0.8 - 1.5 * (i as f64 + 0.5) / count as f64;
            let a = i as f64 * 2.399_963 + offset;
            let s = (1.0 - z * z).sqrt();
            let eye = DVec3::new(s * a.cos(), s * a.sin(), z) * 2.2 * scale;
            let camera = Camera::look_at(&format!("{i:03}"), SIZE, SIZE, 0.62, eye, DVec3::ZERO, DVec3::Z);
            let mut color = Image::zeros(SIZE, SIZE, 3);
            let mut mask = Image::zeros(SIZE, SIZE, 1);
            for y in 0..SIZE {
                for x in 0..SIZE {
                    let d = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5).normalize();
                    let b = eye.dot(d);
                    let discriminant = b * b - eye.length_squared() + 0.25 * scale * scale;
                    if discriminant <= 0.0 {
                        continue;
                    }
                    let p = (eye + d * (-b - discriminant.sqrt())) / scale;
                    let stripe = 0.4 + 0.35 * (9.0 * p.z + 2.0 * p.x).sin();
                    let shade = 0.6 + 0.4 * (2.0 * p.z);
                    color.pixel_mut(x, y).copy_from_slice(&[
                        (stripe * shade) as f32,
                        (0.3 * shade) as f32,
                        ((0.8 - stripe) * shade) as f32,
                    ]);
                    mask.data[y * SIZE + x] = 1.0;
                }
            }
            TrainView { camera, color, mask: Some(mask), valid: None, hdr: true }
        })
        .collect()
}

fn config(iterations: u32) -> TrainConfig {
    TrainConfig {
        iterations,
        max_surfels: 1200,
        initial_surfels: 900,
        sh_degree: 1,
        density_interval: 20,
        ..TrainConfig::preset(Kind::Object, Quality::Draft)
    }
}

fn psnr(trained: &Trained, views: &[TrainView]) -> f64 {
    let raster = RasterConfig { near: trained.report.near, ..Default::default() };
    views
        .iter()
        .map(|v| {
            let frame = render(&trained.cloud, &v.camera, Planes::COLOR, &raster);
            let mut truth = v.color.clone();
            let mask = v.mask.as_ref().unwrap();
            truth
                .data
                .chunks_exact_mut(3)
                .zip(&mask.data)
                .for_each(|(p, m)| p.iter_mut().for_each(|v| *v *= m));
            comgs_metrics::psnr_srgb(frame.color.as_ref().unwrap(), &truth, None).unwrap().db
        })
        .sum::<f64>()
        / views.len() as f64
}

/// Goal: held-out views of the ball are predicted well after a short training; the bound fails when any of loss, gradient,
/// initialisation or growth is broken.
#[test]
fn a_ball_is_reconstructed() {
    let trained = train(&ball(24, 1.0, 0.0), None, &config(220), None, &mut Silent).unwrap();
    let db = psnr(&trained, &ball(7, 1.0, 0.4));
    assert!(db > 25.0, "{db:.2} dB");
    assert!(trained.cloud.len() <= 1200);
    assert!(trained.cloud.problems().is_empty());
    assert_eq!(trained.report.dropped_gradients, 0);
}

/// Hard case 16. Goal: the same scene ×1000 and ÷1000 trains to the same quality.
#[test]
fn scale_does_not_matter() {
    let reference = train(&ball(16, 1.0, 0.0), None, &config(80), None, &mut Silent).unwrap();
    let expected = psnr(&reference, &ball(5, 1.0, 0.4));
    for scale in [1000.0, 0.001] {
        let trained = train(&ball(16, scale, 0.0), None, &config(80), None, &mut Silent).unwrap();
        let db = psnr(&trained, &ball(5, scale, 0.4));
        assert!((db - expected).abs() < 0.5, "×{scale}: {db:.2} dB against {expected:.2} dB");
    }
}

#[derive(Default)]
struct Recorder {
    stop_after: Option<u32>,
    steps: u32,
    saved: Option<Vec<u8>>,
}

impl Observer for Recorder {
    fn wants_checkpoint(&mut self) -> bool {
        self.steps += 1;
        false
    }
    fn checkpoint(&mut self, bytes: Vec<u8>) {
        self.saved = Some(bytes);
    }
    fn cancelled(&self) -> bool {
        self.stop_after.is_some_and(|n| self.steps >= n)
    }
}

/// Hard case 15. Goal: a run that is stopped (in the middle of a growth interval, after a growth round, before the first step) and
/// resumed gives the same bytes as an uninterrupted one, at another thread count.
#[test]
fn resumed_runs_give_the_same_bytes() {
    let views = ball(8, 1.0, 0.0);
    let whole = train(&views, None, &config(60), None, &mut Silent).unwrap();
    for stop in [1, 13, 41] {
        let mut recorder = Recorder { stop_after: Some(stop), ..Default::default() };
        let stopped = train(&views, None, &config(60), None, &mut recorder);
        assert!(matches!(stopped, Err(TrainError::Cancelled(n)) if n == stop), "{stopped:?}");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let bytes = recorder.saved.unwrap();
        let resumed = pool.install(|| train(&views, None, &config(60), Some(&bytes), &mut Silent)).unwrap();
        assert_eq!(resumed.cloud, whole.cloud, "stopped after {stop}");
    }
}

/// Goal: damaged checkpoints and those of another run are refused with a reason.
#[test]
fn wrong_checkpoints_are_refused() {
    let views = ball(6, 1.0, 0.0);
    let mut recorder = Recorder { stop_after: Some(2), ..Default::default() };
    train(&views, None, &config(10), None, &mut recorder).unwrap_err();
    let bytes = recorder.saved.unwrap();
    let resume = |bytes: &[u8], views: &[TrainView], config: &TrainConfig| {
        train(views, None, config, Some(bytes), &mut Silent).unwrap_err().to_string()
    };
    for length in [0, 5, 9, 14, 60, bytes.len() / 2, bytes.len() - 1] {
        assert!(resume(&bytes[..length], &views, &config(10)).contains("cannot resume"));
    }
    assert!(resume(&bytes, &views, &config(11)).contains("another configuration"));
    assert!(resume(&bytes, &ball(7, 1.0, 0.0), &config(10)).contains("other photos"));
    let mut flipped = bytes.clone();
    flipped[8] = 9;
    assert!(resume(&flipped, &views, &config(10)).contains("version 9"));
}

/// Hard case 14. Goal: captures that cannot work are refused by name; odd ones give a sane result.
#[test]
fn impossible_captures_are_refused() {
    let run = |views: &[TrainView], kind| {
        let config = TrainConfig { kind, ..config(6) };
        train(views, None, &config, None, &mut Silent).map(|t| t.cloud.len())
    };
    assert_eq!(run(&[], Kind::Object), Err(TrainError::TooFewViews(0)));
    assert_eq!(run(&ball(1, 1.0, 0.0), Kind::Scene), Err(TrainError::TooFewViews(1)));
    let same = vec![ball(1, 1.0, 0.0)[0].clone(); 5];
    assert_eq!(run(&same, Kind::Object), Err(TrainError::NoParallax(5)));
    let mut black = ball(6, 1.0, 0.0);
    black.iter_mut().for_each(|v| v.color.data.fill(0.0));
    assert_eq!(run(&black, Kind::Scene), Err(TrainError::Black));
    let mut unmasked = ball(6, 1.0, 0.0);
    unmasked[2].mask = None;
    assert_eq!(run(&unmasked, Kind::Object), Err(TrainError::NoMasks { missing: 1, total: 6 }));
    let mut disjoint = ball(8, 1.0, 0.0);
    for (i, v) in disjoint.iter_mut().enumerate() {
        let mask = v.mask.as_mut().unwrap();
        mask.data.fill(0.0);
        mask.data[(i % 2) * (SIZE * SIZE - 1)] = 1.0;
    }
    assert_eq!(run(&disjoint, Kind::Object), Err(TrainError::EmptyHull));
    let mut poisoned = ball(6, 1.0, 0.0);
    poisoned[1].color.data[7] = f32::NAN;
    assert!(matches!(run(&poisoned, Kind::Object), Err(TrainError::View { name, .. }) if name == "001"));
    // A textureless, saturated scene: no matches, but a result.
    let mut white = ball(6, 1.0, 0.0);
    for v in &mut white {
        v.color.data.fill(1.0);
        v.mask = None;
        v.hdr = false;
    }
    let trained =
        train(&white, None, &TrainConfig { kind: Kind::Scene, ..config(6) }, None, &mut Silent).unwrap();
    assert!(trained.report.warnings.iter().any(|w| w.contains("clipped")), "{:?}", trained.report.warnings);
    assert!(trained.report.warnings.iter().any(|w| w.contains("matching")));
}

/// Hard case 11. Goal: structure-from-motion points at a camera's centre, duplicates and outliers do not break a scene.
#[test]
fn hostile_points() {
    let mut views = ball(6, 1.0, 0.0);
    views.iter_mut().for_each(|v| v.mask = None);
    let centre = views[0].camera.centre().as_vec3();
    let positions =
        vec![centre, centre, glam::Vec3::ZERO, glam::Vec3::ZERO, glam::Vec3::splat(1e9), glam::Vec3::NAN];
    let radiance = vec![glam::Vec3::splat(0.3); 6];
    let config = TrainConfig { kind: Kind::Scene, ..config(12) };
    let trained = train(&views, Some((&positions, &radiance)), &config, None, &mut Silent).unwrap();
    assert!(trained.cloud.problems().is_empty());
}

/// Goal: a time budget ends on time with what there is.
#[test]
fn time_budget_is_kept() {
    let config = TrainConfig { time_budget: Some(Duration::from_millis(700)), ..config(1_000_000) };
    let start = Instant::now();
    let trained = train(&ball(6, 1.0, 0.0), None, &config, None, &mut Silent).unwrap();
    assert!(trained.report.iterations > 3);
    assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
}
