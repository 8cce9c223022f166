//! Strong lights apart from the rest: the sum is the map, nothing is invented, hard maps stay sound.

use comgs_geom::{equirect, sampling::hammersley};
use comgs_image::Image;
use comgs_light::{EnvironmentMap, LightSplit, SplitConfig, luminance};
use glam::{Vec2, Vec3};

const WIDTH: usize = 256;
const HEIGHT: usize = 128;

fn map(radiance: impl Fn(Vec3) -> Vec3) -> EnvironmentMap {
    let mut image = Image::zeros(WIDTH, HEIGHT, 3);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let d = equirect::texel_direction(x, y, WIDTH, HEIGHT);
            image.pixel_mut(x, y).copy_from_slice(&radiance(d).to_array());
        }
    }
    EnvironmentMap::from_image(&image).unwrap()
}

fn sky(d: Vec3) -> Vec3 {
    Vec3::new(0.3, 0.5, 0.9) * (0.6 + 0.4 * d.z)
}

/// Goal: a sun and a lamp are found with the direction, solid angle and energy they were painted with, across the azimuth's
/// seam too, and rest and lights add up to the map to rounding.
#[test]
fn painted_lights_are_found_and_add_up() {
    let sun = Vec3::new(-0.8, 0.0, 0.6).normalize();
    let lamp = Vec3::new(0.2, 0.9, 0.1).normalize();
    let (sun_cos, lamp_cos) = (0.03f32.cos(), 0.09f32.cos());
    let map = map(|d| {
        let mut l = sky(d);
        if d.dot(sun) > sun_cos {
            l += Vec3::new(900.0, 800.0, 700.0);
        }
        if d.dot(lamp) > lamp_cos {
            l += Vec3::new(60.0, 30.0, 10.0);
        }
        l
    });
    let split = LightSplit::new(&map, &SplitConfig::default());
    assert_eq!(split.strong.len(), 2);
    for (light, at, radiance) in [
        (&split.strong[0], sun, Vec3::new(900.0, 800.0, 700.0)),
        (&split.strong[1], lamp, Vec3::new(60.0, 30.0, 10.0)),
    ] {
        assert!(light.direction.angle_between(at) < 0.01, "{} {at}", light.direction);
        let expected = radiance * light.solid_angle;
        // The light's energy is what is above its surroundings, here exactly what was painted on a sky that hardly varies.
        assert!((light.energy - expected).abs().max_element() < 0.01 * expected.max_element());
    }
    let sum = split.sum();
    for (a, b) in sum.image().data.iter().zip(&map.image().data) {
        assert!((a - b).abs() <= 2.0 * f32::EPSILON * b, "{a} {b}");
    }
    let peak = split.rest.image().data.iter().fold(0.0f32, |a, &b| a.max(b));
    assert!(peak < 1.0, "the rest has no sun left: {peak}");
}

/// Goal: samples of a light are distributed as its energy: their mean irradiance is the quadrature's on any plane.
#[test]
fn samples_stand_for_the_energy() {
    let sun = Vec3::new(0.3, -0.7, 0.5).normalize();
    let map = map(|d| sky(d) + Vec3::splat(400.0) * (d.dot(sun) - 0.998).max(0.0) / 0.002);
    let split = LightSplit::new(&map, &SplitConfig::default());
    assert_eq!(split.strong.len(), 1);
    let light = &split.strong[0];
    for normal in [Vec3::Z, sun, sun.any_orthonormal_vector()] {
        let n = 4096;
        let mean: f32 = (0..n)
            .map(|k| normal.dot(light.sample(&map, hammersley(k, n, Vec2::ZERO))).max(0.0) / n as f32)
            .sum();
        let truth: f32 = light
            .texels()
            .iter()
            .map(|t| {
                let d = equirect::texel_direction(t.column, t.row, WIDTH, HEIGHT);
                let omega = equirect::texel_solid_angle(t.row, WIDTH, HEIGHT);
                luminance(t.radiance) * omega * normal.dot(d).max(0.0) / luminance(light.energy)
            })
            .sum();
        assert!((mean - truth).abs() < 3e-3, "{mean} {truth}");
    }
}

/// Goal: maps without a small strong light yield none and come back as they are: constant, a smooth sky, a bright half, a
/// window of half a steradian, and a black one (hard case 26).
#[test]
fn maps_without_strong_light_pay_nothing() {
    let window = |d: Vec3| if d.x > 0.9 { Vec3::splat(50.0) } else { sky(d) };
    let half = |d: Vec3| Vec3::splat(if d.z > 0.0 { 30.0 } else { 0.01 });
    for map in [map(|_| Vec3::ONE), map(sky), map(half), map(window), EnvironmentMap::constant(Vec3::ZERO)] {
        let split = LightSplit::new(&map, &SplitConfig::default());
        assert!(split.strong.is_empty());
        assert_eq!(split.rest, map);
    }
}

/// Goal: one texel of 10⁵ over 10⁻³, at the pole, on the seam and anywhere, becomes one light that holds nearly all of the
/// map; all is finite and in range (hard case 25).
#[test]
fn hard_case_25_one_hot_texel() {
    for (column, row) in [(0, 0), (0, 64), (WIDTH - 1, 30), (77, HEIGHT - 1), (100, 60)] {
        let mut image = Image::filled(WIDTH, HEIGHT, 3, 1e-3);
        image.pixel_mut(column, row).copy_from_slice(&[1e5; 3]);
        let map = EnvironmentMap::from_image(&image).unwrap();
        let split = LightSplit::new(&map, &SplitConfig::default());
        assert_eq!(split.strong.len(), 1, "{column} {row}");
        let light = &split.strong[0];
        assert!(light.energy.is_finite() && light.direction.is_normalized());
        let expected = 1e5 * equirect::texel_solid_angle(row, WIDTH, HEIGHT);
        assert!((light.energy.x / expected - 1.0).abs() < 1e-3);
        assert_eq!(split.rest.image().data.iter().fold(0.0f32, |a, &b| a.max(b)), 1e-3);
        assert_eq!(split.sum(), map);
    }
}

/// Goal: values out of range are named, NaN included.
#[test]
fn configurations_are_checked() {
    assert!(SplitConfig::default().check().is_empty());
    let bad = SplitConfig { contrast: f32::NAN, max_solid_angle: 0.0, min_share: 2.0, max_lights: 0 };
    assert_eq!(bad.check().len(), 3);
}
