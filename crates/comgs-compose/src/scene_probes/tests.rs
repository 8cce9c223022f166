//! Probes in the scene against traced rays, and their spread.

use super::*;
use crate::shadow_light::ShadowLightConfig;
use comgs_geom::Camera;
use comgs_geom::sampling::{hammersley, uniform_sphere};
use comgs_light::EnvironmentMap;
use comgs_surfel::{ColorEncoding, SurfelCloud, activation::logit};
use comgs_trace::TraceConfig;
use glam::{DVec3, Vec2};

fn ball() -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for k in 0..1500 {
        let d = uniform_sphere(hammersley(k, 1500, Vec2::ZERO));
        let q = glam::Quat::from_rotation_arc(Vec3::Z, d);
        cloud.positions.push((0.5 * d + Vec3::new(0.0, 0.0, 0.55)).to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([0.03f32.ln(); 2]);
        cloud.opacity_logits.push(logit(0.99));
        cloud.sh.extend([0.0; 3]);
    }
    cloud
}

/// A floor as a grid of receivers.
fn floor() -> ReceiverCloud {
    let camera = Camera::look_at("a", 192, 192, 1.2, DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y);
    let mut receivers = crate::receivers::Receivers {
        width: 192,
        height: 192,
        points: Vec::new(),
        normals: vec![Vec3::Z; 192 * 192],
    };
    for i in 0..192 * 192 {
        let d = camera.ray_world((i % 192) as f64 + 0.5, (i / 192) as f64 + 0.5);
        receivers.points.push((camera.centre() - d * (camera.centre().z / d.z)).as_vec3());
    }
    let mut cloud = ReceiverCloud::default();
    cloud.add(&camera, &receivers);
    cloud
}

/// Goal: probes in the scene approach the traced ratio, and the adaptive spread needs fewer for the same error: with the
/// same count its error is smaller. Judge: the same light's directions, traced.
#[test]
fn adaptive_probes_beat_uniform_ones() {
    let tracer = Tracer::new(&ball(), &TraceConfig::occlusion()).unwrap();
    let map = EnvironmentMap::constant(Vec3::ONE);
    let light = ShadowLight::new(&map, &[], &ShadowLightConfig::default()).unwrap();
    let receivers = floor();
    let spheres = vec![(Vec3::new(0.0, 0.0, 0.55), 0.6)];
    let points: Vec<Vec3> = receivers.points.iter().copied().step_by(37).collect();
    let normals = vec![Vec3::Z; points.len()];
    let truth: Vec<f32> = points
        .iter()
        .map(|p| {
            let (mut lit, mut kept) = (0.0, 0.0);
            for (d, e) in light.directions.iter().zip(&light.energy) {
                let w = e.x * d.z.max(0.0);
                lit += w;
                if w > 0.0 {
                    kept += w * tracer.transmittance(*p, *d, 0.0, f32::INFINITY);
                }
            }
            kept / lit
        })
        .collect();
    let rms = |density: Density, count: usize| {
        let config = SceneProbeConfig { count, density, offset: 0.0, ..SceneProbeConfig::default() };
        let probes =
            SceneProbes::bake(&receivers, &light, &tracer, spheres.clone(), &config, BakeObserver::silent())
                .unwrap();
        let got = probes.ratios(&points, &normals);
        (got.iter().zip(&truth).map(|(g, t)| (g.x - t).powi(2)).sum::<f32>() / truth.len() as f32).sqrt()
    };
    let (uniform, adaptive, half) =
        (rms(Density::Uniform, 400), rms(Density::Adaptive, 400), rms(Density::Adaptive, 200));
    assert!(adaptive < 0.03, "{adaptive}");
    assert!(
        adaptive < 0.9 * uniform && half < uniform,
        "adaptive {adaptive}, half {half}, uniform {uniform}"
    );
}

/// Goal: no receiver in the region is said (issue 5, bad input), and the warp keeps centres and order.
#[test]
fn nothing_in_the_region_and_the_warp() {
    let tracer = Tracer::new(&ball(), &TraceConfig::occlusion()).unwrap();
    let light =
        ShadowLight::new(&EnvironmentMap::constant(Vec3::ONE), &[], &ShadowLightConfig::default()).unwrap();
    let far = vec![(Vec3::new(90.0, 0.0, 0.0), 0.5)];
    let error = SceneProbes::bake(
        &floor(),
        &light,
        &tracer,
        far,
        &SceneProbeConfig::default(),
        BakeObserver::silent(),
    );
    assert!(matches!(error, Err(ProbeError::NoPoints(n)) if n > 1000));
    let spheres = [(Vec3::ZERO, 0.5)];
    assert_eq!(warp(Vec3::ZERO, &spheres), Vec3::ZERO);
    let mut last = 0.0;
    for k in 1..100 {
        let w = warp(Vec3::X * 0.3 * k as f32, &spheres);
        assert!(w.x > last && w.x < 0.3 * k as f32);
        last = w.x;
    }
}
