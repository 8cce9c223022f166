//! Relightable surfels as the inserted object, against a path tracer that knows the surface they stand for.

mod support;

use comgs_geom::Similarity;
use comgs_insert::object::Object;
use comgs_insert::transport::{ForegroundConfig, ShadowConfig, trace_foreground, trace_shadow};
use comgs_surfel::activation::logit;
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud};
use comgs_synth::film;
use comgs_synth::shape::Shape;
use glam::{Quat, Vec3};
use support::{camera, part, sunny, world};

const RADIUS: f32 = 0.45;

/// A ball of surfels of one material on the plane z = 0: Fibonacci's spiral, neighbours overlapping at one standard deviation.
fn ball(count: usize, color: [f32; 3], roughness: f32, metallic: f32) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let mut material = MaterialColumns::default();
    let spacing = RADIUS * (4.0 * std::f32::consts::PI / count as f32).sqrt();
    for k in 0..count {
        let z = 1.0 - (2.0 * k as f32 + 1.0) / count as f32;
        let (s, c) = (k as f32 * 2.399_963).sin_cos();
        let d = Vec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z);
        let q = Quat::from_rotation_arc(Vec3::Z, d);
        cloud.positions.push((RADIUS * d + Vec3::Z * RADIUS).to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([(0.75 * spacing).ln(); 2]);
        cloud.opacity_logits.push(logit(0.995));
        cloud.sh.extend([0.0; 3]);
        material.albedo_logits.push(color.map(logit));
        material.roughness_logits.push(logit(roughness));
        material.metallic_logits.push(logit(metallic));
    }
    cloud.material = Some(material);
    cloud
}

/// Goal: a ball of surfels with a known material has the radiance and casts the shadow that the path tracer of comgs-synth gives the
/// sphere: on average to 2 % and by pixel to a few per cent for radiance, to 0.01 for the shadow ratio. Its surface is a few
/// thousandths of its radius thick, so its outline is softer: only pixels inside both are compared.
#[test]
fn surfels_against_the_path_tracer() {
    let light = sunny(32, Vec3::new(-0.5, 0.6, 0.8), 6.0);
    let (w, h) = (60, 40);
    let camera = camera(w, h);
    for (name, color, roughness, metallic) in
        [("rough", [0.7, 0.4, 0.25], 0.8, 0.02), ("metal", [0.9, 0.7, 0.4], 0.4, 0.98)]
    {
        let object = Object::surfels(&ball(3000, color, roughness, metallic), &Similarity::IDENTITY).unwrap();
        let sphere = part(Shape::Sphere { radius: RADIUS }, [0.0, 0.0, RADIUS], color, roughness, metallic);
        let truth = film::render(&world(std::slice::from_ref(&sphere), false, &light), &camera, 512, 3);
        let config = ForegroundConfig { depth: 3, bsdf_samples: 64, ..ForegroundConfig::default() };
        let traced = trace_foreground(&object, &camera, &config, |_| true).unwrap();
        let radiance = traced.radiance(&light);
        let (mut sum, mut truth_sum, mut error, mut count, mut albedo) = (0.0f64, 0.0f64, 0.0f64, 0, 0.0f32);
        for i in 0..w * h {
            if traced.coverage.data[i] < 0.99 || truth.coverage.data[i] < 1.0 {
                continue;
            }
            for c in 0..3 {
                let (a, b) = (f64::from(radiance.data[3 * i + c]), f64::from(truth.straight.data[3 * i + c]));
                (sum, truth_sum, error, count) = (sum + a, truth_sum + b, error + (a - b).abs(), count + 1);
                albedo = albedo.max((traced.albedo.data[3 * i + c] - color[c]).abs());
            }
        }
        println!(
            "{name}: mean {:+.2} %, mean absolute error {:.2} %, base colour off by {albedo:.4}, {count} values",
            100.0 * (sum / truth_sum - 1.0),
            100.0 * error / truth_sum
        );
        assert!(count > 300 && albedo < 0.02, "{name}");
        assert!((sum / truth_sum - 1.0).abs() < 0.02, "{name}");
        assert!(error / truth_sum < 0.06, "{name}");
    }
    // The judge's ball is black, so that it lights the ground no more than the ratio has it.
    let object = Object::surfels(&ball(3000, [0.5; 3], 0.9, 0.02), &Similarity::IDENTITY).unwrap();
    let mut black = part(Shape::Sphere { radius: RADIUS }, [0.0, 0.0, RADIUS], [0.0; 3], 1.0, 0.0);
    black.material = black.material.clone().lambert();
    let bare = film::render(&world(&[], true, &light), &camera, 512, 5);
    let with = film::render(&world(std::slice::from_ref(&black), true, &light), &camera, 512, 5);
    let coverage: Vec<f32> = with.mask.data.clone();
    let config = ShadowConfig { samples: 4, ..ShadowConfig::default() };
    let shadow = trace_shadow(&object, &camera, &coverage, &config, |_| true).unwrap();
    let beta = shadow.spread(&shadow.ratios(&light, |_| true).beta, w, h);
    let (mut bias, mut error, mut deepest, mut count) = (0.0f64, 0.0f64, 1.0f32, 0);
    for i in (0..w * h).filter(|i| bare.depth.data[*i] > 0.0 && coverage[*i] == 0.0) {
        for c in 0..3 {
            let truth = with.color.data[3 * i + c] / bare.color.data[3 * i + c];
            let off = f64::from(beta.data[3 * i + c] - truth);
            (bias, error, deepest, count) = (bias + off, error + off.abs(), deepest.min(truth), count + 1);
        }
    }
    let n = f64::from(count);
    println!(
        "shadow: bias {:+.4}, mean absolute error {:.4}, darkest {deepest:.3}, {count} values",
        bias / n,
        error / n
    );
    assert!(deepest < 0.6 && count > 1000);
    assert!((bias / n).abs() < 0.004 && error / n < 0.01);
}
