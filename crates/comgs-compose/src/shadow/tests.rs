//! Analytic answers, hard lights, repeatability.

use super::*;
use comgs_geom::sampling::uniform_sphere;

/// A solid ball.
struct Ball(Vec3, f32);

impl Occluder for Ball {
    fn transmittance(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        let exit = sphere_exit(origin, direction, self.0, self.1);
        if exit > 0.0 && exit <= t_max * 1.001 { 0.0 } else { 1.0 }
    }
    fn bounding_sphere(&self) -> (Vec3, f32) {
        (self.0, self.1)
    }
}

/// Constant light of a colour, drawn uniformly.
struct Constant(Vec3);

impl LightSource for Constant {
    fn sample(&self, u: Vec2) -> LightSample {
        LightSample {
            direction: uniform_sphere(u),
            radiance: self.0,
            pdf: 1.0 / (4.0 * std::f32::consts::PI),
        }
    }

    fn evaluate(&self, _: Vec3) -> (Vec3, f32) {
        (self.0, 1.0 / (4.0 * std::f32::consts::PI))
    }
}

fn floor_point(x: f32) -> Receivers {
    Receivers { width: 1, height: 1, points: vec![Vec3::new(x, 0.0, 0.0)], normals: vec![Vec3::Z] }
}

/// Goal: a ball over a floor under constant light: directly beneath, the cosine-weighted occlusion of a cone is
/// sin² of its half angle, so S = 1 − (r/h)² (hard case 24).
#[test]
fn ball_over_a_floor_is_analytic() {
    let config = ShadowConfig { rays: 16_384, ..ShadowConfig::default() };
    for (r, h) in [(0.5f32, 1.0f32), (0.9, 1.0), (0.2, 2.0)] {
        let traced =
            trace_shadow(&floor_point(0.0), &Constant(Vec3::ONE), &Ball(Vec3::new(0.0, 0.0, h), r), &config);
        let expected = 1.0 - (r / h) * (r / h);
        assert!((traced.ratio.data[0] - expected).abs() < 5e-3, "{} {expected}", traced.ratio.data[0]);
    }
}

/// Goal: the estimated variance predicts the spread over seeds within a factor of the Hammersley set's gain.
#[test]
fn variance_is_an_upper_estimate_of_the_spread() {
    let ball = Ball(Vec3::new(0.3, 0.0, 1.0), 0.6);
    let (mut sum, mut square, mut predicted) = (0.0f64, 0.0f64, 0.0f64);
    let n = 400;
    for seed in 0..n {
        let config = ShadowConfig { rays: 64, seed, ..ShadowConfig::default() };
        let t = trace_shadow(&floor_point(0.0), &Constant(Vec3::ONE), &ball, &config);
        let s = f64::from(t.ratio.data[0]);
        sum += s;
        square += s * s;
        predicted += f64::from(t.variance.data[0]);
    }
    let n = n as f64;
    let spread = square / n - (sum / n) * (sum / n);
    assert!(spread < predicted / n, "spread {spread} predicted {}", predicted / n);
    assert!(spread > 0.01 * predicted / n, "spread {spread} predicted {}", predicted / n);
}

/// Goal: a hot light of 10⁵ over 10⁻³ keeps the ratio in [0, 1]; black light gives exactly 1; a channel without
/// light keeps its 1 while the others darken (hard cases 25 and 26).
#[test]
fn hard_lights_keep_the_ratio_in_range() {
    struct Hot;
    impl LightSource for Hot {
        fn sample(&self, u: Vec2) -> LightSample {
            let direction = uniform_sphere(u);
            let (radiance, pdf) = self.evaluate(direction);
            LightSample { direction, radiance, pdf }
        }

        fn evaluate(&self, direction: Vec3) -> (Vec3, f32) {
            let hot = direction.z > 0.999;
            (Vec3::splat(if hot { 1e5 } else { 1e-3 }), 1.0 / (4.0 * std::f32::consts::PI))
        }
    }
    let ball = Ball(Vec3::new(0.0, 0.0, 1.0), 0.5);
    for seed in 0..50 {
        let config = ShadowConfig { rays: 32, seed, ..ShadowConfig::default() };
        let s = trace_shadow(&floor_point(0.2), &Hot, &ball, &config).ratio;
        assert!(s.data.iter().all(|v| (0.0..=1.0).contains(v)), "{:?}", s.data);
    }
    let config = ShadowConfig::default();
    let black = trace_shadow(&floor_point(0.0), &Constant(Vec3::ZERO), &ball, &config).ratio;
    assert_eq!(black.data, vec![1.0; 3]);
    let red = trace_shadow(&floor_point(0.0), &Constant(Vec3::new(1.0, 0.0, 0.0)), &ball, &config).ratio;
    assert!(red.data[0] < 0.9 && red.data[1] == 1.0 && red.data[2] == 1.0, "{:?}", red.data);
}

/// Goal: unusable light samples (NaN, infinite, negative, zero density) never poison the ratio (hard case 26).
#[test]
fn poisoned_samples_are_ignored() {
    let good = LightSample { direction: Vec3::Z, radiance: Vec3::ONE, pdf: 1.0 };
    let poison = [
        LightSample { radiance: Vec3::splat(f32::NAN), ..good },
        LightSample { radiance: Vec3::splat(f32::INFINITY), ..good },
        LightSample { radiance: Vec3::splat(-3.0), ..good },
        LightSample { pdf: 0.0, ..good },
        LightSample { pdf: f32::NAN, ..good },
    ];
    for bad in poison {
        let s = shadow_ratio(Vec3::Z, &[good, good, bad], &[1.0, 0.0, 0.0], DARK);
        assert_eq!(s, Vec3::splat(0.5), "{bad:?}");
    }
}

/// Goal: where the sphere lies below the horizon nothing is traced and the ratio is exactly 1; the same seed
/// gives the same picture (hard case 29), another one a different picture.
#[test]
fn short_cuts_are_exact_and_seeds_repeat() {
    let ball = Ball(Vec3::new(0.0, 0.0, -2.0), 0.5);
    let t = trace_shadow(&floor_point(0.0), &Constant(Vec3::ONE), &ball, &ShadowConfig::default());
    assert_eq!((t.rays_traced, t.ratio.data), (0, vec![1.0; 3]));
    let ball = Ball(Vec3::new(0.3, 0.1, 1.0), 0.5);
    let with = |seed| {
        let config = ShadowConfig { rays: 33, seed, ..ShadowConfig::default() };
        trace_shadow(&floor_point(0.0), &Constant(Vec3::ONE), &ball, &config).ratio.data
    };
    assert_eq!(with(3), with(3));
    assert_ne!(with(3), with(4));
}

/// Goal: under a light with a bright lobe, both halves of the samples together give the quadrature's answer, for a receiver
/// that faces the lobe and for one that mostly looks away.
#[test]
fn both_sample_sets_agree_with_quadrature() {
    use comgs_light::{EnvironmentMap, EnvironmentSampler};
    let (width, height) = (128, 64);
    let mut image = Image::zeros(width, height, 3);
    for y in 0..height {
        for x in 0..width {
            let d = comgs_geom::equirect::texel_direction(x, y, width, height);
            let lobe = d.dot(Vec3::new(0.6, 0.0, 0.8)).max(0.0).powi(64);
            image.pixel_mut(x, y).copy_from_slice(&[0.2 + 50.0 * lobe, 0.5 + 50.0 * lobe, 1.0 + 20.0 * lobe]);
        }
    }
    let map = EnvironmentMap::from_image(&image).unwrap();
    let sampler = EnvironmentSampler::new(&map);
    let ball = Ball(Vec3::new(0.5, 0.0, 1.0), 0.4);
    for normal in [Vec3::Z, Vec3::new(-0.8, 0.0, 0.6)] {
        let receivers =
            Receivers { width: 1, height: 1, points: vec![Vec3::ZERO], normals: vec![normal.normalize()] };
        let config = ShadowConfig { rays: 4096, ..ShadowConfig::default() };
        let traced = trace_shadow(&receivers, &sampler, &ball, &config).ratio;
        let (mut lit, mut kept) = (glam::DVec3::ZERO, glam::DVec3::ZERO);
        let n = 400_000;
        for k in 0..n {
            let d = uniform_sphere(hammersley(k, n, Vec2::ZERO));
            let light = (map.radiance(d) * normal.normalize().dot(d).max(0.0)).as_dvec3();
            lit += light;
            kept += light * f64::from(ball.transmittance(Vec3::ZERO, d, 10.0));
        }
        let expected = (kept / lit).as_vec3().to_array();
        for c in 0..3 {
            assert!((traced.data[c] - expected[c]).abs() < 0.01, "{:?} {expected:?}", traced.data);
        }
    }
}
