//! The sweep in scenes whose panorama is known.

use comgs_geom::{equirect, sh};
use comgs_panorama::{Completion, Sweep, SweepConfig, sweep};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation};
use comgs_trace::{TraceConfig, Tracer};
use glam::{Quat, Vec3};

fn push(cloud: &mut SurfelCloud, centre: Vec3, normal: Vec3, scale: f32, opacity: f32, colour: Vec3) {
    let q = Quat::from_rotation_arc(Vec3::Z, normal.normalize());
    cloud.positions.push(centre.to_array());
    cloud.rotations.push([q.w, q.x, q.y, q.z]);
    cloud.log_scales.push([scale.ln(); 2]);
    cloud.opacity_logits.push(activation::logit(opacity));
    cloud.sh.extend((colour - 0.5).to_array().map(|c| c / sh::C0));
}

/// A sphere of radius 3 around `centre`, closed with overlapping discs; its colour by direction.
fn shell(centre: Vec3, colour: impl Fn(Vec3) -> Vec3) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let n = 1500;
    for i in 0..n {
        // Fibonacci points.
        let z = 1.0 - (2.0 * i as f32 + 1.0) / n as f32;
        let (s, c) = (i as f32 * 2.399_963).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let d = Vec3::new(r * c, r * s, z);
        push(&mut cloud, centre + 3.0 * d, d, 0.2, 0.98, colour(d));
    }
    cloud
}

fn of(cloud: &SurfelCloud, centre: Vec3, config: &SweepConfig) -> Sweep {
    sweep(&Tracer::new(cloud, &TraceConfig::default()).unwrap(), centre, 64, 32, config)
}

/// Goal: inside a closed sphere everything is covered, at the radius, facing the centre, in the right colours.
#[test]
fn inside_a_sphere() {
    let centre = Vec3::new(1.0, -2.0, 0.5);
    let sky = |d: Vec3| Vec3::new(2.0 + d.x, 1.5 + d.y, 1.2 + d.z);
    let got = of(&shell(centre, sky), centre, &SweepConfig::default());
    assert!((got.coverage - 1.0).abs() < 1e-5, "{}", got.coverage);
    for y in 0..32 {
        for x in 0..64 {
            let d = equirect::texel_direction(x, y, 64, 32);
            assert!(got.alpha.pixel(x, y)[0] > 0.98);
            // Discs touch the sphere from outside: their rims lie a little beyond.
            assert!((got.depth.pixel(x, y)[0] - 3.0).abs() < 0.1, "{}", got.depth.pixel(x, y)[0]);
            assert!(Vec3::from_slice(got.normal.pixel(x, y)).dot(-d) > 0.98);
            let colour = Vec3::from_slice(got.rgb.pixel(x, y));
            assert!((colour - sky(d)).abs().max_element() < 0.15, "{x} {y}: {colour} {}", sky(d));
        }
    }
    assert_eq!(got.complete(Completion::Harmonic).unwrap().non_finite(), 0);
}

/// Goal: a surfel on +x is in the image's centre, one on +y in its left quarter, one on +z at the top; what is not
/// met is 0 in every plane, and coverage is the discs' solid angle.
#[test]
fn directions_and_coverage() {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    push(&mut cloud, 2.0 * Vec3::X, Vec3::X, 0.4, 0.9, Vec3::X);
    push(&mut cloud, 4.0 * Vec3::Y, Vec3::Y, 0.8, 0.9, Vec3::Y);
    push(&mut cloud, 5.0 * Vec3::Z, Vec3::Z, 2.0, 0.9, Vec3::Z);
    let tracer = Tracer::new(&cloud, &TraceConfig::default()).unwrap();
    let got = sweep(&tracer, Vec3::ZERO, 256, 128, &SweepConfig::default());
    for (x, y, colour, depth) in [(128, 64, Vec3::X, 2.0), (64, 64, Vec3::Y, 4.0), (200, 0, Vec3::Z, 5.0)] {
        let straight = Vec3::from_slice(got.rgb.pixel(x, y));
        assert!((straight - colour).length() < 1e-4, "{x} {y}: {straight}");
        assert!((got.alpha.pixel(x, y)[0] - 0.9).abs() < 0.01);
        assert!((got.depth.pixel(x, y)[0] - depth).abs() < 0.01 * depth);
        assert!((Vec3::from_slice(got.normal.pixel(x, y)) + colour).length() < 1e-4);
    }
    for plane in [&got.rgb, &got.normal, &got.depth, &got.alpha] {
        assert!(plane.pixel(20, 90).iter().all(|&v| v == 0.0));
    }
    // Rows around the pole count whole, hence the 4 %. α > ½ within r = s √(2 ln(0.9 / 0.5)): caps of tan β = r / distance.
    let radius = (2.0f32 * (0.9f32 / 0.5).ln()).sqrt();
    let cap = |ratio: f32| 0.5 * (1.0 - (radius * ratio).atan().cos());
    let expected = cap(0.2) + cap(0.2) + cap(0.4);
    assert!((got.coverage / expected - 1.0).abs() < 0.04, "{} {expected}", got.coverage);
}

/// Goal: a floater between the centre and the scene disappears with `t_min`, and what is beyond `t_max` too.
#[test]
fn floaters_are_skipped() {
    let mut cloud = shell(Vec3::ZERO, |_| Vec3::ONE);
    push(&mut cloud, Vec3::new(0.2, 0.0, 0.0), Vec3::X, 0.2, 0.99, Vec3::ZERO);
    let look = |t_min: f32, t_max: f32| of(&cloud, Vec3::ZERO, &SweepConfig { t_min, t_max, samples: 1 });
    let everything = look(0.0, f32::INFINITY);
    assert!(everything.rgb.pixel(32, 16)[0] < 0.05 && everything.depth.pixel(32, 16)[0] < 0.3);
    let beyond = look(0.8, f32::INFINITY);
    assert!((beyond.rgb.pixel(32, 16)[0] - 1.0).abs() < 1e-4 && beyond.depth.pixel(32, 16)[0] > 2.9);
    let near = look(0.0, 1.0);
    assert!(near.coverage > 0.1 && near.coverage < 0.5 && near.alpha.pixel(0, 16)[0] == 0.0);
}

/// Goal: more rays a texel average straight colour by alpha and alpha by area: the edge of a disc is softened.
#[test]
fn supersampling_averages() {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    push(&mut cloud, 2.0 * Vec3::X, Vec3::X, 0.3, 0.9, Vec3::new(3.0, 2.0, 1.0));
    let one = of(&cloud, Vec3::ZERO, &SweepConfig::default());
    let many = of(&cloud, Vec3::ZERO, &SweepConfig { samples: 4, ..SweepConfig::default() });
    let sum = |s: &Sweep| s.alpha.data.iter().sum::<f32>();
    assert!((sum(&one) / sum(&many) - 1.0).abs() < 0.05);
    assert_ne!(one.alpha, many.alpha);
    for i in 0..64 * 32 {
        if many.alpha.data[i] > 0.0 {
            assert!((many.rgb.data[3 * i] - 3.0).abs() < 1e-4, "one colour stays one colour");
        }
    }
}

/// Goal: the same bytes at one and at three threads; empty scenes, odd sizes and unusable centres see nothing.
#[test]
fn deterministic_and_total() {
    let cloud = shell(Vec3::ZERO, |d| d + 1.5);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| of(&cloud, Vec3::splat(0.3), &SweepConfig::default()))
    };
    assert_eq!(on(1), on(3));
    let tracer = Tracer::new(&cloud, &TraceConfig::default()).unwrap();
    for centre in [Vec3::NAN, Vec3::new(f32::INFINITY, 0.0, 0.0)] {
        let got = sweep(&tracer, centre, 8, 4, &SweepConfig::default());
        assert_eq!((got.coverage, got.alpha.data.iter().sum::<f32>()), (0.0, 0.0));
        assert!(got.complete(Completion::Harmonic).is_err());
    }
    for (w, h) in [(0, 0), (1, 1), (5, 3)] {
        let got = sweep(&tracer, Vec3::ZERO, w, h, &SweepConfig { samples: 0, ..SweepConfig::default() });
        assert_eq!((got.rgb.pixels(), got.normal.pixels()), (w * h, w * h));
    }
    let nothing =
        Tracer::new(&SurfelCloud::empty(0, ColorEncoding::Linear), &TraceConfig::default()).unwrap();
    assert_eq!(sweep(&nothing, Vec3::ZERO, 8, 4, &SweepConfig::default()).coverage, 0.0);
}
