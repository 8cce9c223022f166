//! What a lit scene says about its light, against a scene whose light is known: a floor with the shadow of an upright plate.

use comgs_geom::{equirect, sh};
use comgs_image::Image;
use comgs_panorama::evidence::{Config, refine};
use comgs_panorama::{Partial, SweepConfig, sweep};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use comgs_trace::{TraceConfig, Tracer};
use glam::{Quat, Vec3};

const SKY: f32 = 0.3;
const FLOOR: f32 = 0.5;
/// Black: it casts a shadow and does not testify.
const PLATE: f32 = 0.0;

/// Whether the plate (x = 0, |y| < 0.5, 0 < z < 1) is in the way.
fn blocked(from: Vec3, towards: Vec3) -> bool {
    if towards.x == 0.0 {
        return false;
    }
    let t = -from.x / towards.x;
    let p = from + t * towards;
    t > 1e-4 && p.y.abs() < 0.5 && (0.0..1.0).contains(&p.z)
}

/// Radiance of a floor point of albedo `FLOOR` under the sky and a sun of the given irradiance on a surface that faces it.
fn floor_radiance(p: Vec3, sun: Vec3, irradiance: f32) -> f32 {
    let n = 2000;
    let mut sky = 0.0;
    for i in 0..n {
        let z = (i as f32 + 0.5) / n as f32;
        let azimuth = std::f32::consts::PI * (1.0 + 5f32.sqrt()) * i as f32;
        let r = (1.0 - z * z).sqrt();
        let d = Vec3::new(r * azimuth.cos(), r * azimuth.sin(), z);
        sky += d.z * if blocked(p, d) { PLATE * SKY } else { SKY };
    }
    let sky = sky / n as f32 * std::f32::consts::TAU;
    let direct = if blocked(p, sun) { 0.0 } else { irradiance * sun.z };
    FLOOR / std::f32::consts::PI * (sky + direct)
}

fn scene(sun: Vec3, irradiance: f32) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let mut put = |at: Vec3, normal: Vec3, size: f32, radiance: f32| {
        let q = Quat::from_rotation_arc(Vec3::Z, normal);
        cloud.positions.push(at.to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([size.ln(), size.ln()]);
        cloud.opacity_logits.push(6.0);
        let code = (radiance - 0.5) / sh::C0;
        cloud.sh.extend([code; 3]);
    };
    for i in -45..=45 {
        for j in -45..=45 {
            let p = Vec3::new(i as f32, j as f32, 0.0) / 15.0;
            put(p, Vec3::Z, 0.045, floor_radiance(p, sun, irradiance));
        }
    }
    for i in 0..15 {
        for k in 0..15 {
            let p = Vec3::new(0.0, (i as f32 - 7.0) / 15.0, (k as f32 + 0.5) / 15.0);
            put(p, Vec3::X, 0.045, PLATE * SKY);
        }
    }
    cloud
}

/// The sweep around a point beside the plate, what is known of it, and the even sky that a completion without a sun gives.
fn look(cloud: &SurfelCloud) -> (Tracer, comgs_panorama::Sweep, Partial, Image) {
    let tracer = Tracer::new(cloud, &TraceConfig::default()).unwrap();
    let seen = sweep(&tracer, Vec3::new(0.7, 0.2, 0.35), 128, 64, &SweepConfig::default());
    let partial = seen.partial(None);
    let mut completed = seen.rgb.clone();
    for (pixel, &a) in completed.data.chunks_exact_mut(3).zip(&seen.alpha.data) {
        pixel.iter_mut().for_each(|v| *v = a * *v + (1.0 - a) * SKY);
    }
    (tracer, seen, partial, completed)
}

fn irradiance_of_change(before: &Image, after: &Image, normal: Vec3) -> f32 {
    let mut sum = 0.0;
    for y in 0..before.height {
        for x in 0..before.width {
            let d = equirect::texel_direction(x, y, before.width, before.height);
            let omega = equirect::texel_solid_angle(y, before.width, before.height);
            sum += omega * d.dot(normal).max(0.0) * (after.rgb(x, y)[1] - before.rgb(x, y)[1]);
        }
    }
    sum
}

/// Goal: a sun that no photo shows is found from the shadow it casts: its direction within 5°, its irradiance on the floor
/// within 15 %.
#[test]
fn a_shadow_tells_the_sun() {
    for sun in [Vec3::new(-0.6, 0.1, 0.8), Vec3::new(-0.5, 0.5, 0.9), Vec3::new(-0.7, -0.4, 0.6)] {
        let sun = sun.normalize();
        let (tracer, seen, partial, completed) = look(&scene(sun, 1.6));
        let evidence =
            refine(&tracer, &seen, Vec3::new(0.7, 0.2, 0.35), &partial, &completed, &Config::default());
        assert!(evidence.used, "{sun}: {:?} of {} points", evidence.loss, evidence.points);
        let off = evidence.lights[0].direction.angle_between(sun).to_degrees();
        let found = irradiance_of_change(&completed, &evidence.environment, Vec3::Z);
        let expected = 1.6 * sun.z;
        println!(
            "sun {sun}: {off:.1}° off, {found:.2} instead of {expected:.2}, {:?} {:?}",
            evidence.loss, evidence.lights
        );
        assert!(off < 5.0, "{sun}: {off}° off");
        assert!((found / expected - 1.0).abs() < 0.15, "{sun}: {found} instead of {expected}");
    }
}

/// Goal: where the shadow cannot be seen (it lies behind the plate) every direction explains the lit floor, and none is told.
#[test]
fn a_hidden_shadow_tells_no_direction() {
    let sun = Vec3::new(0.6, 0.25, 0.75).normalize();
    let (tracer, seen, partial, completed) = look(&scene(sun, 1.6));
    let centre = Vec3::new(0.7, 0.2, 0.35);
    let evidence = refine(&tracer, &seen, centre, &partial, &completed, &Config::default());
    assert!(evidence.lights.is_empty(), "{:?}", evidence.lights);
}

/// Goal: no sun, no change: the even sky that explains the scene is left as it was, or nearly; the same bytes twice.
#[test]
fn nothing_is_invented() {
    let (tracer, seen, partial, completed) = look(&scene(Vec3::Z, 0.0));
    let centre = Vec3::new(0.7, 0.2, 0.35);
    let evidence = refine(&tracer, &seen, centre, &partial, &completed, &Config::default());
    let change = irradiance_of_change(&completed, &evidence.environment, Vec3::Z);
    let sky = SKY * std::f32::consts::PI;
    assert!(evidence.lights.is_empty(), "{:?}", evidence.lights);
    assert!(change.abs() < 0.1 * sky, "{change} of {sky}: {:?}", evidence.loss);
    let again = refine(&tracer, &seen, centre, &partial, &completed, &Config::default());
    assert_eq!(evidence, again);
}
