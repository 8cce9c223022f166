//! The sampler against its density, the map's integral, and the worst maps there are (hard cases 25, 26, 28).

use comgs_geom::{Rng, equirect, sampling};
use comgs_image::Image;
use comgs_light::{EnvironmentMap, EnvironmentSampler, luminance};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

fn random_map(height: usize, seed: u64) -> EnvironmentMap {
    let mut rng = Rng::new(seed);
    // Over five decades, with black texels in between.
    let data = (0..6 * height * height)
        .map(|_| if rng.below(4) == 0 { 0.0 } else { 10.0f32.powf(rng.range(-3.0, 2.0)) })
        .collect();
    EnvironmentMap::from_image(&Image::from_data(2 * height, height, 3, data)).unwrap()
}

/// One texel of 10⁵ over 10⁻³, 128 × 64.
fn hot() -> EnvironmentMap {
    let mut image = Image::filled(128, 64, 3, 1e-3);
    image.pixel_mut(40, 20).fill(1e5);
    EnvironmentMap::from_image(&image).unwrap()
}

fn numbers(rng: &mut Rng) -> Vec2 {
    Vec2::new(rng.uniform(), rng.uniform())
}

/// Goal (28): χ² of a histogram of samples against the density integrated over its cells, which are not the texels.
#[test]
fn histogram_matches_the_density() {
    for (map, seed) in
        [(random_map(6, 1), 2), (random_map(6, 1).turned(0.7), 3), (EnvironmentMap::constant(Vec3::ONE), 4)]
    {
        let sampler = EnvironmentSampler::new(&map);
        let (columns, rows) = (20usize, 10usize);
        let n = 200_000;
        let mut histogram = vec![0.0f64; columns * rows];
        let mut rng = Rng::new(seed);
        for _ in 0..n {
            let d = sampler.sample(numbers(&mut rng)).direction;
            let (u, v) = equirect::uv_from_direction(d);
            histogram[(v * rows as f32) as usize * columns + (u * columns as f32) as usize] += 1.0;
        }
        // Midpoint rule on a grid whose rows are cut at the rows of the map, where the density jumps.
        let fine = 60;
        let mut expected = vec![0.0f64; columns * rows];
        for y in 0..rows * fine {
            let omega = equirect::texel_solid_angle(y, columns * fine, rows * fine);
            for x in 0..columns * fine {
                let d = equirect::texel_direction(x, y, columns * fine, rows * fine);
                expected[y / fine * columns + x / fine] += f64::from(n) * f64::from(sampler.pdf(d) * omega);
            }
        }
        let total: f64 = expected.iter().sum();
        assert!((total / f64::from(n) - 1.0).abs() < 2e-3, "the density integrates to 1: {total}");
        let (mut chi, mut cells) = (0.0, 0.0);
        for (o, e) in histogram.iter().zip(&expected) {
            if *e > 5.0 {
                chi += (o - e).powi(2) / e;
                cells += 1.0;
            } else {
                assert!(*o < 30.0, "{o} samples where {e} are expected");
            }
        }
        // Mean of χ² is the number of cells, its deviation √(2 cells); six of them is one run in 10⁸.
        assert!(chi < cells + 6.0 * (2.0f64 * cells).sqrt(), "χ² {chi} over {cells} cells");
    }
}

/// Goal: what a sample says of itself is what the map and the density say of its direction, and radiance over density
/// has the same luminance everywhere.
#[test]
fn samples_are_consistent() {
    for map in [random_map(16, 5), random_map(16, 5).turned(-1.3), hot(), random_map(256, 6)] {
        let sampler = EnvironmentSampler::new(&map);
        let total = luminance(map.integral());
        let mut rng = Rng::new(7);
        for i in 0..20_000 {
            let mut u = numbers(&mut rng);
            if i < 16 {
                let ends = [0.0, f32::MIN_POSITIVE, 0.5, 1.0 - f32::EPSILON / 2.0];
                u = Vec2::new(ends[i % 4], ends[i / 4]);
            }
            let s = sampler.sample(u);
            assert!((s.direction.length() - 1.0).abs() < 1e-5);
            assert!(s.pdf > 0.0);
            assert_eq!(s.radiance, map.radiance(s.direction), "{u}");
            assert_eq!(s.pdf, sampler.pdf(s.direction), "{u}");
            let ratio = luminance(s.radiance) / s.pdf / total;
            assert!((ratio - 1.0).abs() < 1e-4, "{u}: {ratio}");
        }
    }
}

/// Goal: the estimator of the integral and of the irradiance converges to the brute-force values.
#[test]
fn estimators_converge() {
    let map = random_map(12, 8);
    let sampler = EnvironmentSampler::new(&map);
    let normal = Vec3::new(0.48, 0.6, 0.64);
    let n = 1 << 16;
    let (mut integral, mut irradiance) = (Vec3::ZERO, Vec3::ZERO);
    for i in 0..n {
        let s = sampler.sample(sampling::hammersley(i, n, Vec2::new(0.2, 0.9)));
        integral += s.radiance / s.pdf;
        irradiance += s.radiance * normal.dot(s.direction).max(0.0) / s.pdf;
    }
    let integral = integral / n as f32 / map.integral();
    let irradiance = irradiance / n as f32 / map.irradiance(normal);
    assert!((integral - 1.0).abs().max_element() < 0.01, "{integral}");
    assert!((irradiance - 1.0).abs().max_element() < 0.01, "{irradiance}");
}

/// Goal (25): one texel of 10⁵ over 10⁻³: with 64 samples the irradiance of a surface that sees the sun is within 2 %
/// every time, and no sample exceeds the bound that its hue gives; the dim sky's share is not lost.
#[test]
fn hot_texel() {
    let map = hot();
    let sampler = EnvironmentSampler::new(&map);
    let sun = equirect::texel_direction(40, 20, 128, 64);
    let exact = map.irradiance(sun).x;
    let bound = map.integral().x * 1.001;
    let mut rng = Rng::new(9);
    for _ in 0..200 {
        let mut sum = 0.0;
        for _ in 0..64 {
            let s = sampler.sample(numbers(&mut rng));
            let value = s.radiance.x * sun.dot(s.direction).max(0.0) / s.pdf;
            assert!(value <= bound, "{value} {bound}");
            sum += value / 64.0;
        }
        assert!((sum / exact - 1.0).abs() < 0.02, "{sum} {exact}");
    }
    // Facing away from the sun only the sky is left: drawn with 0.02 % of the samples, but without bias.
    let away = -sun;
    let exact = map.irradiance(away).x;
    let n = 4_000_000;
    let mut sum = 0.0f64;
    for _ in 0..n {
        let s = sampler.sample(numbers(&mut rng));
        sum += f64::from(s.radiance.x * away.dot(s.direction).max(0.0) / s.pdf);
    }
    let mean = sum / f64::from(n) / f64::from(exact);
    assert!((mean - 1.0).abs() < 0.15, "{mean}");
    // The defensive mixture does the same with a ten-thousandth of the samples.
    let n = 400;
    let mut sum = 0.0f64;
    for _ in 0..n {
        let s = sampler.sample_defensive(away, 0.5, numbers(&mut rng));
        if s.pdf > 0.0 {
            sum += f64::from(s.radiance.x * away.dot(s.direction).max(0.0) / s.pdf);
        }
    }
    let mean = sum / f64::from(n) / f64::from(exact);
    assert!((mean - 1.0).abs() < 0.15, "{mean}");
}

/// Goal: the mixture is unbiased for any share, its density is what it says, and its estimator is bounded by the
/// cosine lobe's.
#[test]
fn defensive_mixture() {
    let map = random_map(8, 10);
    let sampler = EnvironmentSampler::new(&map);
    let normal = Vec3::new(-0.36, 0.48, -0.8);
    let exact = luminance(map.irradiance(normal));
    for share in [0.0f32, 0.25, 0.5, 1.0] {
        let n = 1 << 16;
        let mut sum = 0.0f64;
        for i in 0..n {
            let s = sampler.sample_defensive(normal, share, sampling::hammersley(i, n, Vec2::new(0.1, 0.4)));
            assert_eq!(s.radiance, map.radiance(s.direction));
            assert!((s.pdf - sampler.pdf_defensive(s.direction, normal, share)).abs() <= 1e-6 * s.pdf);
            let cosine = normal.dot(s.direction).max(0.0);
            if s.pdf > 0.0 {
                let value = luminance(s.radiance) * cosine / s.pdf;
                if share > 0.0 {
                    assert!(value <= 1.0001 * PI / share * luminance(s.radiance));
                }
                sum += f64::from(value);
            }
        }
        let ratio = sum / f64::from(n) / f64::from(exact);
        assert!((ratio - 1.0).abs() < 0.01, "{share}: {ratio}");
    }
}

/// Goal (26): a black map is sampled uniformly, with no division by zero.
#[test]
fn black_map() {
    let map = EnvironmentMap::constant(Vec3::ZERO);
    let sampler = EnvironmentSampler::new(&map);
    assert!(sampler.is_black());
    let mut mean = Vec3::ZERO;
    let n = 4096;
    for i in 0..n {
        let s = sampler.sample(sampling::hammersley(i, n, Vec2::ZERO));
        assert_eq!((s.radiance, s.pdf), (Vec3::ZERO, 1.0 / (4.0 * PI)));
        assert_eq!(sampler.pdf(s.direction), s.pdf);
        mean += s.direction;
    }
    assert!((mean / n as f32).length() < 0.01);
}

/// Goal: the same numbers give the same sample, whatever was drawn before (29).
#[test]
fn deterministic() {
    let sampler = EnvironmentSampler::new(&random_map(8, 11));
    let u = Vec2::new(0.37, 0.61);
    let first = sampler.sample(u);
    let _ = sampler.sample(Vec2::ZERO);
    assert_eq!(sampler.sample(u), first);
    assert_eq!(EnvironmentSampler::new(&random_map(8, 11)).sample(u), first);
}
