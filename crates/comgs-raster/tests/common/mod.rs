//! Clouds, cameras and comparisons that the tests share.
#![allow(dead_code, reason = "each test file uses its part")]

use comgs_geom::{Camera, Rng};
use comgs_raster::reference::{self, ReferenceCloud};
use comgs_raster::{Frame, Planes, RasterConfig, render};
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud};
use glam::DVec3;

/// A camera on the −y side that looks along +y.
pub fn camera(width: usize, height: usize) -> Camera {
    let mut camera = Camera::look_at(
        "test",
        width,
        height,
        0.9,
        DVec3::new(0.1, -4.0, 0.3),
        DVec3::new(0.0, 0.0, 0.1),
        DVec3::Z,
    );
    camera.fy *= 1.1;
    camera.cx += 1.7;
    camera
}

/// One surfel: centre, quaternion wxyz, scales, opacity logit, with a plain colour and mid material.
pub fn push(cloud: &mut SurfelCloud, position: [f32; 3], rotation: [f32; 4], scale: [f32; 2], logit: f32) {
    cloud.positions.push(position);
    cloud.rotations.push(rotation);
    cloud.log_scales.push(scale.map(f32::ln));
    cloud.opacity_logits.push(logit);
    let stride = cloud.sh_stride();
    let index = cloud.len() as f32;
    for k in 0..stride {
        cloud.sh.push(if k < 3 { 0.3 + 0.2 * ((index + k as f32) * 1.3).sin() } else { 0.0 });
    }
    if let Some(m) = &mut cloud.material {
        m.albedo_logits.push([0.3, -0.2, 0.1]);
        m.roughness_logits.push(0.4);
        m.metallic_logits.push(-0.5);
    }
}

pub fn empty() -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(3, ColorEncoding::Srgb);
    cloud.material = Some(MaterialColumns::default());
    cloud
}

/// A quaternion that turns the disc (normal +z) to face −y, towards [`camera`].
pub const FACING: [f32; 4] = [std::f32::consts::FRAC_1_SQRT_2, std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0];

pub fn random_cloud(n: usize, seed: u64, encoding: ColorEncoding) -> SurfelCloud {
    let mut rng = Rng::new(seed);
    let mut cloud = empty();
    cloud.color_encoding = encoding;
    for _ in 0..n {
        let position = [rng.range(-1.3, 1.3), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0)];
        let rotation = [rng.normal(), rng.normal(), rng.normal(), rng.normal()];
        let scale = [rng.range(-4.0, -0.7).exp(), rng.range(-4.0, -0.7).exp()];
        push(&mut cloud, position, rotation, scale, rng.range(-2.0, 2.0));
        let stride = cloud.sh_stride();
        let start = cloud.sh.len() - stride;
        for k in 3..stride {
            cloud.sh[start + k] = 0.15 * rng.normal();
        }
        let m = cloud.material.as_mut().unwrap();
        *m.albedo_logits.last_mut().unwrap() = [rng.normal(), rng.normal(), rng.normal()];
        *m.roughness_logits.last_mut().unwrap() = rng.normal();
        *m.metallic_logits.last_mut().unwrap() = rng.normal();
    }
    cloud
}

/// All planes of a frame in the order of [`reference::Pixel`].
pub fn planes_of(frame: &Frame) -> Vec<[f32; 13]> {
    (0..frame.weight.pixels())
        .map(|i| {
            let mut out = [0.0; 13];
            let plane =
                |p: &Option<comgs_image::Image>, c: usize, k: usize| p.as_ref().unwrap().data[i * c + k];
            for k in 0..3 {
                out[k] = plane(&frame.color, 3, k);
                out[5 + k] = plane(&frame.normal, 3, k);
            }
            out[3] = frame.weight.data[i];
            out[4] = plane(&frame.depth, 1, 0);
            for k in 0..5 {
                out[8 + k] = plane(&frame.material, 5, k);
            }
            out
        })
        .collect()
}

/// Compares a rendering with the reference. Where a response sits on a threshold, f32 and f64 may fall on different
/// sides of it; so up to `band` of the pixels may differ by what one surfel at the threshold is worth, the
/// others must agree to `tolerance` (relative to the plane's largest value).
pub fn assert_matches_reference(
    cloud: &SurfelCloud,
    camera: &Camera,
    config: &RasterConfig,
    tolerance: f64,
    band: f64,
) {
    let frame = render(cloud, camera, Planes::ALL, config);
    let expected = reference::render(&ReferenceCloud::new(cloud), camera, config);
    let got = planes_of(&frame);
    let mut scale = [1e-3f64; 13];
    for p in &expected {
        for k in 0..13 {
            assert!(p[k].is_finite());
            scale[k] = scale[k].max(p[k].abs());
        }
    }
    let mut outside = 0;
    for (i, (g, e)) in got.iter().zip(&expected).enumerate() {
        let mut worst = 0.0f64;
        for k in 0..13 {
            assert!(g[k].is_finite(), "pixel {i} plane {k} is {}", g[k]);
            worst = worst.max((f64::from(g[k]) - e[k]).abs() / scale[k]);
        }
        if worst > tolerance {
            outside += 1;
            assert!(worst < 0.05, "pixel {i} is off by {worst}: {g:?} {e:?}");
        }
    }
    assert!(outside as f64 <= band * got.len() as f64, "{outside} of {} pixels differ", got.len());
}
