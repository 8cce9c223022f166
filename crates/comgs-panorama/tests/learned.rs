//! The learned completer: what it must keep, and how it turns.

use comgs_geom::equirect;
use comgs_image::Image;
use comgs_panorama::partial::roll;
use comgs_panorama::{Bundle, Completer, CompletionError, Harmonic, Learned, Partial, Runtime};
use glam::Vec3;

fn model(steps: usize) -> Learned {
    Learned::new(&Bundle::shipped().unwrap(), &Runtime::Embedded, Some(steps), 0).unwrap()
}

/// A room with a window and a lamp; the upper half and a wedge are unknown.
fn partial(height: usize) -> Partial {
    let width = 2 * height;
    let (mut rgb, mut alpha) = (Image::zeros(width, height, 3), Image::zeros(width, height, 1));
    let mut normal = Image::zeros(width, height, 3);
    for y in 0..height {
        for x in 0..width {
            let d = equirect::texel_direction(x, y, width, height);
            let window = d.x > 0.8 && d.z.abs() < 0.3;
            let value =
                if window { Vec3::new(6.0, 7.0, 8.0) } else { Vec3::new(0.4, 0.3, 0.25) * (1.2 + d.x) };
            rgb.pixel_mut(x, y).copy_from_slice(&value.to_array());
            let known = d.z < 0.35 && !(d.y > 0.7 && d.x < 0.3);
            alpha.data[y * width + x] = f32::from(u8::from(known));
            normal.pixel_mut(x, y).copy_from_slice(&if d.z < -0.4 { Vec3::Z } else { -d }.to_array());
        }
    }
    Partial { normal: Some(normal), ..Partial::new(rgb, alpha).unwrap() }
}

/// Goal: no seam and no preferred side. The input turned by any number of texels gives the same panorama turned; the model
/// sees normals turned with it, to rounding.
#[test]
fn turning_the_input_turns_the_output() {
    let (partial, model) = (partial(64), model(1));
    let straight = model.complete(&partial, 3).unwrap();
    for texels in [1, 7, 64, 101, 127] {
        let turned = model.complete(&partial.rolled(texels), 3).unwrap();
        let expected = roll(&straight, texels);
        let off = turned
            .data
            .iter()
            .zip(&expected.data)
            .fold(0.0f32, |m, (a, b)| m.max((a - b).abs() / (0.1 + b.abs())));
        assert!(off < 2e-3, "turned by {texels}: off by {off}");
    }
}

/// Goal: what is known comes back to the bit; the rest is finite, not negative, and not black.
#[test]
fn what_is_known_is_kept() {
    for height in [64, 100, 128] {
        let partial = partial(height);
        let whole = model(1).complete(&partial, 0).unwrap();
        for (i, &a) in partial.alpha.data.iter().enumerate() {
            let (new, old) = (&whole.data[3 * i..3 * i + 3], &partial.rgb.data[3 * i..3 * i + 3]);
            if a == 1.0 {
                assert_eq!(new, old);
            } else {
                assert!(new.iter().all(|v| v.is_finite() && *v > 0.0), "{new:?}");
            }
        }
    }
}

/// Goal: radiance has no unit. A scene twice as bright is completed twice as bright.
#[test]
fn exposure_passes_through() {
    let (partial, model) = (partial(64), model(1));
    let one = model.complete(&partial, 0).unwrap();
    let brighter = Partial { rgb: partial.rgb.map(|v| 32.0 * v), ..partial };
    let two = model.complete(&brighter, 0).unwrap();
    for (a, b) in one.data.iter().zip(&two.data) {
        assert!((32.0 * a - b).abs() < 1e-3 * b.abs().max(1e-2), "{a} and {b}");
    }
}

/// Goal: the same seed gives the same bytes; with several steps another seed gives another panorama, and the spread is 0
/// where the panorama is known.
#[test]
fn samples() {
    let partial = partial(64);
    let model = model(4);
    assert_eq!(model.complete(&partial, 5).unwrap(), model.complete(&partial, 5).unwrap());
    let samples = model.samples(&partial, 5, 3).unwrap();
    assert_eq!((samples.all.len(), samples.dropped), (3, 0));
    assert_ne!(samples.all[0], samples.all[1]);
    let mut unknown = 0.0;
    for (i, &a) in partial.alpha.data.iter().enumerate() {
        let spread = &samples.spread.data[3 * i..3 * i + 3];
        if a == 1.0 {
            assert_eq!(spread, [0.0; 3]);
        } else {
            unknown += spread[0];
        }
    }
    assert!(unknown > 0.0);
}

/// Goal: clipped texels may become brighter, never darker, and what is not clipped is kept.
#[test]
fn clipped_texels_are_a_lower_bound() {
    let mut partial = partial(64);
    let data = partial.rgb.data.chunks_exact(3).map(|p| f32::from(u8::from(p[2] > 5.0))).collect();
    partial.clipped = Some(Image::from_data(128, 64, 1, data));
    let whole = model(1).complete(&partial, 0).unwrap();
    for (i, &a) in partial.alpha.data.iter().enumerate() {
        let clipped = partial.clipped.as_ref().unwrap().data[i] > 0.5;
        for c in 0..3 {
            let (new, old) = (whole.data[3 * i + c], partial.rgb.data[3 * i + c]);
            assert!(if clipped || a < 1.0 { new >= old || a < 1.0 } else { new == old });
        }
    }
}

/// Goal: nothing known, maps of different sizes or of another aspect, and unusable samples are errors or harmless.
#[test]
fn bad_input() {
    let good = partial(64);
    let model = model(1);
    let nothing = Partial { alpha: Image::zeros(128, 64, 1), ..good.clone() };
    assert!(matches!(model.complete(&nothing, 0), Err(CompletionError::NothingSeen { .. })));
    assert!(matches!(Harmonic.complete(&nothing, 0), Err(CompletionError::NothingSeen { .. })));
    let small = Partial { alpha: Image::zeros(64, 32, 1), ..good.clone() };
    assert!(matches!(model.complete(&small, 0), Err(CompletionError::Shape { .. })));
    let square = Partial::new(Image::zeros(64, 64, 3), Image::zeros(64, 64, 1));
    assert!(matches!(square, Err(CompletionError::Aspect { .. })));
    let mut broken = good;
    broken.rgb.data[3 * (50 * 128 + 9)] = f32::NAN;
    assert_eq!(model.complete(&broken, 0).unwrap().non_finite(), 0);
}
