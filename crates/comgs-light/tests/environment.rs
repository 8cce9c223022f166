//! Environment maps against answers known on paper.

use comgs_geom::{Rng, equirect};
use comgs_image::Image;
use comgs_light::{EnvError, EnvReport, EnvironmentMap};
use glam::Vec3;
use std::f32::consts::PI;

fn random_map(height: usize, seed: u64) -> EnvironmentMap {
    let mut rng = Rng::new(seed);
    let data = (0..6 * height * height).map(|_| rng.uniform()).collect();
    EnvironmentMap::from_image(&Image::from_data(2 * height, height, 3, data)).unwrap()
}

fn from_function(height: usize, f: impl Fn(Vec3) -> Vec3) -> EnvironmentMap {
    let mut image = Image::zeros(2 * height, height, 3);
    for y in 0..height {
        for x in 0..2 * height {
            let d = equirect::texel_direction(x, y, 2 * height, height);
            image.pixel_mut(x, y).copy_from_slice(&f(d).to_array());
        }
    }
    EnvironmentMap::from_image(&image).unwrap()
}

/// Goal (26): a constant environment gives irradiance π L to every normal and integrates to 4π L.
#[test]
fn constant_environment() {
    let map = EnvironmentMap::constant(Vec3::new(1.0, 0.5, 2.0));
    for normal in [Vec3::X, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z, Vec3::new(0.6, -0.48, 0.64)] {
        let e = map.irradiance(normal) / PI;
        assert!((e - Vec3::new(1.0, 0.5, 2.0)).abs().max_element() < 2e-4, "{normal}: {e}");
        assert_eq!(map.lookup(normal), Vec3::new(1.0, 0.5, 2.0));
    }
    assert!((map.integral() / (4.0 * PI) - Vec3::new(1.0, 0.5, 2.0)).length() < 1e-6);
    assert!((map.mean() - Vec3::new(1.0, 0.5, 2.0)).length() < 1e-6);
    assert_eq!(EnvironmentMap::constant(Vec3::new(f32::NAN, -1.0, f32::INFINITY)).mean(), Vec3::ZERO);
}

/// Goal: irradiance under the linear sky L = 1 + a · ω is π (1 + ⅔ a · n), whatever the normal.
#[test]
fn linear_sky() {
    let a = Vec3::new(0.3, -0.5, 0.4);
    let map = from_function(128, |d| Vec3::splat(1.0 + a.dot(d)));
    for normal in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(-0.36, 0.48, -0.8), -a.normalize()] {
        let expected = PI * (1.0 + 2.0 / 3.0 * a.dot(normal));
        let got = map.irradiance(normal).x;
        assert!((got / expected - 1.0).abs() < 1e-3, "{normal}: {got} {expected}");
    }
}

/// Goal: the look-up is the texel at texel centres, continuous across the seam of the azimuth, and flat over the
/// poles.
#[test]
fn bilinear_wraps_and_clamps() {
    let map = random_map(8, 1);
    for y in 0..8 {
        for x in 0..16 {
            let d = equirect::texel_direction(x, y, 16, 8) * 3.0;
            assert!((map.lookup(d) - map.texel(x, y)).abs().max_element() < 1e-4);
            assert_eq!(map.radiance(d), map.texel(x, y));
            assert_eq!(map.texel_of(d), (x, y));
        }
        let v = (y as f32 + 0.5) / 8.0;
        let (left, right) =
            (map.lookup(equirect::direction(1e-5, v)), map.lookup(equirect::direction(1.0 - 1e-5, v)));
        assert!((left - right).abs().max_element() < 1e-3, "{left} {right}");
        let middle = 0.5 * (map.texel(0, y) + map.texel(15, y));
        assert!((left - middle).abs().max_element() < 1e-3);
    }
    for (v, row) in [(0.001, 0), (0.999, 7)] {
        let d = equirect::direction(2.5 / 16.0, v);
        assert!((map.lookup(d) - map.texel(2, row)).abs().max_element() < 1e-3);
    }
    for pole in [Vec3::Z, Vec3::NEG_Z] {
        assert!(map.lookup(pole).is_finite() && map.radiance(pole).is_finite());
    }
}

/// Goal: a turned map shows in `Rz d` what it showed in d, in every way it can be asked.
#[test]
fn turning() {
    let map = random_map(16, 2);
    for angle in [0.3f32, -2.0, PI, 7.5, 2.0 * PI / 32.0] {
        let turned = map.turned(angle);
        assert!((0.0..2.0 * PI).contains(&turned.turn()));
        let (sin, cos) = angle.sin_cos();
        let rotate = |d: Vec3| Vec3::new(cos * d.x - sin * d.y, sin * d.x + cos * d.y, d.z);
        for y in 0..16 {
            for x in 0..32 {
                let d = equirect::texel_direction(x, y, 32, 16);
                assert_eq!(turned.radiance(rotate(d)), map.texel(x, y), "{angle} {x} {y}");
                assert!((turned.lookup(rotate(d)) - map.lookup(d)).abs().max_element() < 1e-4);
                let (u, v) = ((x as f32 + 0.5) / 32.0, (y as f32 + 0.5) / 16.0);
                assert!((turned.direction(u, v) - rotate(d)).length() < 1e-5);
            }
        }
        let n = Vec3::new(0.48, -0.6, 0.64);
        assert!((turned.irradiance(rotate(n)) - map.irradiance(n)).abs().max_element() < 1e-4);
        assert!((turned.turned(-angle).radiance(n) - map.radiance(n)).length() < 1e-6);
    }
}

/// Goal: halving the resolution conserves the integral, and a constant map stays constant at any size.
#[test]
fn resizing_conserves_light() {
    let map = random_map(16, 3);
    for height in [8, 4, 2, 1] {
        let small = map.resized(height);
        assert_eq!((small.width(), small.height()), (2 * height, height));
        let ratio = small.integral() / map.integral();
        assert!((ratio - 1.0).abs().max_element() < 1e-5, "{height}: {ratio}");
    }
    for height in [5, 16, 40] {
        let constant = EnvironmentMap::constant(Vec3::splat(0.7)).resized(height);
        assert!(constant.image().data.iter().all(|v| (v - 0.7).abs() < 1e-5));
    }
    assert!((map.scaled(2.0).integral() / map.integral() - 2.0).abs().max_element() < 1e-5);
}

/// Goal (26): NaN, infinite and negative texels are refused with their counts, or repaired as documented.
#[test]
fn unusable_texels() {
    let mut image = Image::filled(4, 2, 3, 1.0);
    image.pixel_mut(1, 0)[0] = f32::NAN;
    image.pixel_mut(2, 1)[1] = f32::INFINITY;
    image.pixel_mut(3, 1)[2] = -0.5;
    image.pixel_mut(3, 0)[2] = f32::NEG_INFINITY;
    image.pixel_mut(0, 0)[0] = 4.0;
    let expected = EnvReport { nan: 1, infinite: 1, negative: 2 };
    assert_eq!(EnvironmentMap::from_image(&image), Err(EnvError::Samples(expected)));
    let (map, report) = EnvironmentMap::from_image_repaired(&image).unwrap();
    assert_eq!(report, expected);
    assert_eq!(report.to_string(), "1 NaN, 1 infinite, 2 negative");
    assert_eq!(map.texel(2, 1).y, 4.0, "the largest finite sample");
    assert_eq!((map.texel(3, 1).z, map.texel(3, 0).z), (0.0, 0.0));
    // Neighbours of (1, 0), with the row above the pole clamped: 4 once in each of two rows of the window, else 1.
    assert!((map.texel(1, 0).x - (4.0 * 2.0 + 1.0 * 5.0) / 7.0).abs() < 1e-6, "{}", map.texel(1, 0).x);
    let (black, report) = EnvironmentMap::from_image_repaired(&Image::filled(2, 1, 1, f32::NAN)).unwrap();
    assert!(black.is_black() && report.nan == 2);
}

/// Goal: images that are no panorama are refused with what was expected; grey ones are accepted.
#[test]
fn shapes() {
    let error = |w, h, c| EnvironmentMap::from_image(&Image::zeros(w, h, c)).unwrap_err();
    assert_eq!(error(0, 0, 3), EnvError::Empty { width: 0, height: 0 });
    assert_eq!(error(4, 3, 3), EnvError::Aspect { width: 4, height: 3 });
    assert!(error(4, 3, 3).to_string().contains("twice as wide as high"));
    assert_eq!(error(4, 2, 4), EnvError::Channels(4));
    let grey = EnvironmentMap::from_image(&Image::filled(4, 2, 1, 0.5)).unwrap();
    assert_eq!(grey.texel(1, 1), Vec3::splat(0.5));
}
