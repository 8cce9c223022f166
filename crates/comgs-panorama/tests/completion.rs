//! The harmonic completion against harmonic functions known on paper.

use comgs_geom::{Rng, equirect};
use comgs_image::Image;
use comgs_panorama::{Completion, CompletionError, complete, complete_harmonic};
use glam::Vec3;
use std::f32::consts::PI;

/// A map of a function of the texel's direction.
fn map(width: usize, height: usize, channels: usize, f: impl Fn(Vec3) -> Vec3) -> Image {
    let mut image = Image::zeros(width, height, channels);
    for y in 0..height {
        for x in 0..width {
            let value = f(equirect::texel_direction(x, y, width, height)).to_array();
            image.pixel_mut(x, y).copy_from_slice(&value[..channels]);
        }
    }
    image
}

/// Alpha 1 where the predicate holds, else 0.
fn mask(width: usize, height: usize, seen: impl Fn(Vec3) -> bool) -> Image {
    map(width, height, 1, |d| Vec3::splat(if seen(d) { 1.0 } else { 0.0 }))
}

/// What is not seen gets a value that a completion must not use.
fn hidden(truth: &Image, alpha: &Image) -> Image {
    let mut image = truth.clone();
    for (pixel, &a) in image.data.chunks_exact_mut(truth.channels).zip(&alpha.data) {
        if a == 0.0 {
            pixel.fill(1e6);
        }
    }
    image
}

/// Largest relative error.
fn error(got: &Image, truth: &Image) -> f32 {
    got.data.iter().zip(&truth.data).map(|(g, t)| (g / t - 1.0).abs()).fold(0.0, f32::max)
}

fn rolled(image: &Image, columns: usize) -> Image {
    let mut out = image.clone();
    for y in 0..image.height {
        for x in 0..image.width {
            out.pixel_mut((x + columns) % image.width, y).copy_from_slice(image.pixel(x, y));
        }
    }
    out
}

/// Scattered blots of seen texels, some of them half seen.
fn blots(width: usize, height: usize, seed: u64) -> (Image, Image) {
    let mut rng = Rng::new(seed);
    let centres: Vec<(Vec3, f32, f32)> = (0..12)
        .map(|_| {
            let d = Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize();
            (d, rng.range(0.1, 0.5), rng.range(0.1, 1.2))
        })
        .collect();
    let alpha = map(width, height, 1, |d| {
        let a = centres
            .iter()
            .map(|(c, r, a)| if c.angle_between(d) < *r { *a } else { 0.0 })
            .fold(0.0, f32::max);
        Vec3::splat(a.min(1.0))
    });
    let rgb = map(width, height, 3, |d| Vec3::new(1.5 + d.x, 2.0f32.powf(3.0 * d.y), 0.1 + d.z * d.z));
    (rgb, alpha)
}

/// Goal: constant radiance stays constant, to the precision of f32, whatever is seen of it.
#[test]
fn constant_stays_constant() {
    for (width, height) in [(64, 32), (30, 15), (7, 3), (2, 1), (1, 1), (1, 6), (128, 4)] {
        let truth = map(width, height, 3, |_| Vec3::new(0.2, 3.0, 40.0));
        let mut alpha = Image::zeros(width, height, 1);
        alpha.data[width * height / 2] = 1.0;
        alpha.data[0] = 0.3;
        let got = complete_harmonic(&hidden(&truth, &alpha), &alpha).unwrap();
        assert!(error(&got, &truth) < 1e-5, "{width}×{height}: {}", error(&got, &truth));
    }
}

/// Goal: between two circles of latitude, log radiance = a · log tan(φ/2) + b is harmonic and comes back, with an
/// error that falls with the square of the texels' size.
#[test]
fn harmonic_between_circles_of_latitude() {
    let truth = |d: Vec3| {
        let polar = d.z.acos();
        let h = (0.5 * polar).tan().ln();
        Vec3::new((0.8 * h).exp(), (-0.5 * h + 1.0).exp(), (0.3 * h - 2.0).exp())
    };
    let mut errors = Vec::new();
    for height in [32, 64, 128] {
        let truth = map(2 * height, height, 3, truth);
        let alpha = mask(2 * height, height, |d| !(0.2 * PI..0.7 * PI).contains(&d.z.acos()));
        let got = complete_harmonic(&hidden(&truth, &alpha), &alpha).unwrap();
        errors.push(error(&got, &truth));
    }
    assert!(errors[2] < 3e-4, "{errors:?}");
    assert!(errors[1] < 0.4 * errors[0] && errors[2] < 0.4 * errors[1], "second order: {errors:?}");
}

/// Goal: inside a cap that contains a pole, log radiance = tan(φ/2)ᵐ cos mθ (a harmonic function in stereographic
/// coordinates, and the sphere's Laplacian has the same ones) comes back: the pole is an ordinary point.
#[test]
fn harmonic_over_a_pole() {
    for sign in [1.0f32, -1.0] {
        let truth = |d: Vec3| {
            let r = (0.5 * (sign * d.z).acos()).tan();
            let theta = d.y.atan2(d.x);
            let h = |m: i32| r.powi(m) * (m as f32 * theta).cos();
            Vec3::new(h(1).exp(), (2.0 * h(2)).exp(), (h(1) - h(3)).exp())
        };
        let (width, height) = (128, 64);
        let truth = map(width, height, 3, |d| if sign * d.z > -0.2 { truth(d) } else { Vec3::ONE });
        let alpha = mask(width, height, |d| sign * d.z < 0.3 && sign * d.z > -0.2);
        let got = complete_harmonic(&hidden(&truth, &alpha), &alpha).unwrap();
        for y in 0..height {
            for x in 0..width {
                if sign * equirect::texel_direction(x, y, width, height).z >= 0.3 {
                    for c in 0..3 {
                        let ratio = got.pixel(x, y)[c] / truth.pixel(x, y)[c];
                        assert!((ratio - 1.0).abs() < 3e-3, "{sign} {x} {y} {c}: {ratio}");
                    }
                }
            }
        }
        // All texels of the polar ring look at the same place.
        let row = if sign > 0.0 { 0 } else { height - 1 };
        let ring: Vec<f32> = (0..width).map(|x| got.pixel(x, row)[0]).collect();
        let spread =
            ring.iter().copied().fold(0.0f32, f32::max) / ring.iter().copied().fold(f32::MAX, f32::min);
        assert!(spread < 1.06, "{spread}");
    }
}

/// Goal: the two poles unseen at once: only an equatorial band is known, and every texel is filled within the band's
/// range (the maximum principle).
#[test]
fn both_poles_from_the_equator() {
    let (width, height) = (96, 48);
    let truth = map(width, height, 3, |d| Vec3::new(2.0 + d.x, 1.0, 10.0f32.powf(2.0 * d.y)));
    let alpha = mask(width, height, |d| d.z.abs() < 0.1);
    let got = complete_harmonic(&hidden(&truth, &alpha), &alpha).unwrap();
    for c in 0..3 {
        let seen = || {
            truth.data.iter().skip(c).step_by(3).zip(&alpha.data).filter(|(_, a)| **a == 1.0).map(|(v, _)| *v)
        };
        let (low, high) = (seen().fold(f32::MAX, f32::min), seen().fold(0.0, f32::max));
        for v in got.data.iter().skip(c).step_by(3) {
            assert!(*v >= low * 0.9999 && *v <= high * 1.0001, "{v} outside [{low}, {high}]");
        }
    }
    // A pole's value is the mean of the log over the circle: 10^(2 sin θ) averages to 1.
    for row in [0, height - 1] {
        assert!((got.pixel(5, row)[2] - 1.0).abs() < 0.1, "{}", got.pixel(5, row)[2]);
    }
}

/// Goal: what is seen is kept to the bit, and half-seen texels are blended over the fill.
#[test]
fn seen_texels_are_kept() {
    let (mut rgb, alpha) = blots(64, 32, 1);
    rgb.data[0] = 0.0;
    let got = complete_harmonic(&rgb, &alpha).unwrap();
    let mut seen = 0;
    for i in 0..rgb.pixels() {
        if alpha.data[i] >= comgs_panorama::completion::SEEN {
            seen += 1;
            assert_eq!(got.data[3 * i..3 * i + 3], rgb.data[3 * i..3 * i + 3]);
        }
        assert!(got.data[3 * i..3 * i + 3].iter().all(|v| v.is_finite() && *v >= 0.0));
    }
    assert!(seen > 100);
    let full = Image::filled(64, 32, 1, 1.0);
    assert_eq!(complete_harmonic(&rgb, &full).unwrap(), rgb, "all seen: nothing to do");
}

/// Goal: turning the panorama about the vertical turns the completion along: the seam is nowhere.
#[test]
fn the_azimuth_has_no_seam() {
    let (rgb, alpha) = blots(64, 32, 2);
    let plain = complete_harmonic(&rgb, &alpha).unwrap();
    for columns in [1, 17, 32, 63] {
        let turned = complete_harmonic(&rolled(&rgb, columns), &rolled(&alpha, columns)).unwrap();
        assert!(error(&turned, &rolled(&plain, columns)) < 1e-4, "{columns}");
    }
}

/// Goal: upside down is upside down.
#[test]
fn the_poles_are_alike() {
    let (rgb, alpha) = blots(48, 24, 3);
    let flipped = |image: &Image| {
        let mut out = image.clone();
        for y in 0..image.height {
            for x in 0..image.width {
                out.pixel_mut(x, image.height - 1 - y).copy_from_slice(image.pixel(x, y));
            }
        }
        out
    };
    let plain = complete_harmonic(&rgb, &alpha).unwrap();
    let turned = complete_harmonic(&flipped(&rgb), &flipped(&alpha)).unwrap();
    assert!(error(&turned, &flipped(&plain)) < 1e-4);
}

/// Goal: a half-seen texel that disagrees with its surroundings pulls less the less it is seen.
#[test]
fn faint_texels_are_hardly_trusted() {
    let (width, height) = (64, 32);
    let mut before = 0.0;
    for faint in [0.0f32, 0.2, 0.6, 0.9, 0.99] {
        let rgb = map(width, height, 3, |d| Vec3::splat(if d.x > 0.9 { 100.0 } else { 1.0 }));
        let alpha = map(width, height, 1, |d| {
            Vec3::splat(if d.x > 0.9 {
                faint
            } else if d.x < -0.5 {
                1.0
            } else {
                0.0
            })
        });
        let got = complete_harmonic(&rgb, &alpha).unwrap();
        // Half-way, where nothing is seen.
        let value = got.pixel(width / 4, height / 2)[0];
        assert!(value >= before, "{faint}: {value} after {before}");
        match faint {
            0.0 => assert!((value - 1.0).abs() < 1e-4),
            0.2 => assert!(value < 1.6, "{value}"),
            0.99 => assert!(value > 3.5, "{value}"),
            _ => {}
        }
        before = value;
    }
}

/// Goal: the same bytes at one and at three threads.
#[test]
fn deterministic_at_any_thread_count() {
    let (rgb, alpha) = blots(64, 32, 4);
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| complete_harmonic(&rgb, &alpha).unwrap())
    };
    assert_eq!(of(1), of(3));
}

/// Goal: the ends of the scale: nothing seen is an error with the largest alpha, black stays black, unusable samples
/// count as unseen, shapes are checked, and `None` leaves black.
#[test]
fn edge_cases() {
    let rgb = Image::filled(8, 4, 3, 2.0);
    let nothing = Image::filled(8, 4, 1, 0.02);
    assert_eq!(complete_harmonic(&rgb, &nothing), Err(CompletionError::NothingSeen { largest: 0.02 }));
    assert!(complete_harmonic(&rgb, &nothing).unwrap_err().to_string().contains("nothing was seen"));
    let none = complete(&rgb, &nothing, Completion::None).unwrap();
    assert!(none.data.iter().all(|v| (v - 0.04).abs() < 1e-6), "2 · 0.02 over black");

    let black = Image::zeros(8, 4, 3);
    let mut alpha = Image::zeros(8, 4, 1);
    alpha.data[3] = 1.0;
    assert_eq!(complete_harmonic(&black, &alpha).unwrap(), black);

    let mut poisoned = rgb.clone();
    let mut alpha = Image::filled(8, 4, 1, 1.0);
    poisoned.data[0] = f32::NAN;
    poisoned.data[10] = f32::INFINITY;
    poisoned.data[20] = -5.0;
    alpha.data[9] = f32::NAN;
    alpha.data[11] = 7.0;
    let got = complete_harmonic(&poisoned, &alpha).unwrap();
    assert_eq!(got.non_finite(), 0);
    assert!((got.data[0] - 2.0).abs() < 1e-4 && (got.data[27] - 2.0).abs() < 1e-4, "{:?}", &got.data[..30]);
    assert_eq!(got.data[20], 0.0);

    let grey = complete_harmonic(&Image::filled(8, 4, 1, 0.5), &nothing.map(|_| 0.5)).unwrap();
    assert_eq!(grey.channels, 1);
    assert!(grey.data.iter().all(|v| (v - 0.5).abs() < 1e-5));

    for (rgb, alpha) in [
        (Image::zeros(8, 4, 2), Image::zeros(8, 4, 1)),
        (Image::zeros(8, 4, 3), Image::zeros(8, 4, 3)),
        (Image::zeros(8, 4, 3), Image::zeros(4, 4, 1)),
        (Image::zeros(0, 0, 3), Image::zeros(0, 0, 1)),
    ] {
        assert!(matches!(complete(&rgb, &alpha, Completion::Harmonic), Err(CompletionError::Shape { .. })));
        assert!(matches!(complete(&rgb, &alpha, Completion::None), Err(CompletionError::Shape { .. })));
    }
}

/// Goal: a pathological mask (a chequerboard, one texel, one row, random dust) converges and obeys the maximum
/// principle.
#[test]
fn pathological_masks() {
    let (width, height) = (128, 64);
    let mut rng = Rng::new(5);
    let rgb = Image::from_data(
        width,
        height,
        3,
        (0..width * height * 3).map(|_| 10.0f32.powf(rng.range(-3.0, 4.0))).collect(),
    );
    let dust: Vec<f32> = (0..width * height).map(|_| if rng.uniform() < 0.01 { 1.0 } else { 0.0 }).collect();
    let fraction: Vec<f32> = (0..width * height).map(|_| rng.uniform()).collect();
    let of = |f: &dyn Fn(usize, usize) -> bool| {
        Image::from_data(
            width,
            height,
            1,
            (0..width * height).map(|i| if f(i % width, i / width) { 1.0 } else { 0.0 }).collect(),
        )
    };
    for alpha in [
        of(&|x, y| (x + y) % 2 == 0),
        of(&|x, y| (x, y) == (7, 0)),
        of(&|_, y| y == 63),
        of(&|x, _| x == 0),
        Image::from_data(width, height, 1, dust),
        Image::from_data(width, height, 1, fraction),
    ] {
        let got = complete_harmonic(&rgb, &alpha).unwrap();
        let high = rgb.data.iter().copied().fold(0.0f32, f32::max);
        assert!(got.data.iter().all(|v| v.is_finite() && *v > 0.0 && *v <= high * 1.001));
    }
}
