//! Against analytic shadows, traced shadows, and each other.

use super::*;
use crate::objects::{PlacedObject, merge};
use crate::receivers::Receivers;
use crate::shadow::{Occluder, ShadowConfig, trace_shadow};
use crate::shadow_light::{Lamp, ShadowLightConfig};
use comgs_geom::sampling::{hammersley, uniform_sphere};
use comgs_image::Image;
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_surfel::{ColorEncoding, activation::logit};
use glam::{DQuat, DVec3, Vec2};

fn ball() -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let n = 4000;
    for k in 0..n {
        let d = uniform_sphere(hammersley(k, n, Vec2::ZERO));
        let q = glam::Quat::from_rotation_arc(Vec3::Z, d);
        cloud.positions.push((0.5 * d).to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([0.02f32.ln(); 2]);
        cloud.opacity_logits.push(logit(0.99));
        cloud.sh.extend([0.0; 3]);
    }
    cloud
}

fn caster(cloud: &SurfelCloud) -> Caster {
    Caster::new(cloud, FieldConfig::default(), None, &|| false).unwrap()
}

fn at(p: DVec3, scale: f64, rotation: DQuat) -> Similarity {
    Similarity { scale, rotation, translation: p }
}

fn world_tracer(cloud: &SurfelCloud, places: &[Similarity]) -> Tracer {
    let placed: Vec<_> =
        places.iter().map(|&world_from_object| PlacedObject { cloud, world_from_object }).collect();
    Tracer::new(&merge(&placed).unwrap(), &TraceConfig::occlusion()).unwrap()
}

fn light(map: &EnvironmentMap, lamps: &[Lamp]) -> ShadowLight {
    ShadowLight::new(map, lamps, &ShadowLightConfig { directions: 1024, ..ShadowLightConfig::default() })
        .unwrap()
}

fn ratios(
    field: &Caster,
    map: &EnvironmentMap,
    lamps: &[Lamp],
    places: &[Similarity],
    points: &[Vec3],
) -> Vec<Vec3> {
    let light = light(map, lamps);
    let fields: Vec<_> = places.iter().map(|&s| (field, s)).collect();
    FieldShadow::new(&light, &fields).ratios(points, &vec![Vec3::Z; points.len()])
}

/// Goal: under constant light a ball at height h over a floor leaves 1 − (r/h)² beneath it (paper answer), at any
/// scale and turn of its object: the same field serves every similarity.
#[test]
fn a_ball_over_a_floor_is_analytic_under_any_similarity() {
    let cloud = ball();
    let field = caster(&cloud);
    let map = EnvironmentMap::constant(Vec3::new(1.0, 0.5, 0.2));
    // The shell's surfels reach half a standard deviation beyond the sphere on average.
    let shell = 0.5;
    for (scale, h, turn) in [
        (1.0, 1.0, DQuat::IDENTITY),
        (0.4, 0.5, DQuat::from_rotation_x(1.0)),
        (2.0, 1.3, DQuat::from_rotation_z(0.4)),
    ] {
        let s = at(DVec3::new(0.3, -0.2, h), scale, turn);
        let got = ratios(&field, &map, &[], &[s], &[Vec3::new(0.3, -0.2, 0.0)])[0];
        let expected = 1.0 - (shell * scale / h).powi(2) as f32;
        assert!((got - expected).abs().max_element() < 0.03, "scale {scale} height {h}: {got} {expected}");
    }
}

/// A sky with a sun of 2°.
fn sunny() -> EnvironmentMap {
    let (w, h) = (256, 128);
    let mut image = Image::zeros(w, h, 3);
    let sun = Vec3::new(0.5, 0.3, 0.7).normalize();
    for y in 0..h {
        for x in 0..w {
            let d = comgs_geom::equirect::texel_direction(x, y, w, h);
            let mut l = Vec3::new(0.3, 0.5, 0.9) * (0.7 + 0.5 * d.z + 0.2 * d.x);
            if d.angle_between(sun) < 0.03 {
                l += Vec3::new(500.0, 450.0, 400.0);
            }
            image.pixel_mut(x, y).copy_from_slice(&l.to_array());
        }
    }
    EnvironmentMap::from_image(&image).unwrap()
}

struct Traced<'a>(&'a Tracer, (Vec3, f32));

impl Occluder for Traced<'_> {
    fn transmittance(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        self.0.transmittance(origin, direction, 0.0, t_max)
    }
    fn bounding_sphere(&self) -> (Vec3, f32) {
        self.1
    }
}

/// Goal: sky and sun together, penumbra included, agree with a converged traced shadow (which shares no field, no grid and
/// no split), with two balls whose shadows overlap and which stand in each other's light: visibilities multiply (hard case
/// 32, the same object twice).
#[test]
fn hard_case_32_two_objects_agree_with_converged_rays() {
    let cloud = ball();
    let field = caster(&cloud);
    let map = sunny();
    let places = [
        at(DVec3::new(0.0, 0.0, 0.5), 1.0, DQuat::from_rotation_y(0.3)),
        at(DVec3::new(-0.9, 0.2, 0.7), 0.7, DQuat::from_rotation_x(0.8)),
    ];
    let n = 24;
    let points: Vec<Vec3> =
        (0..n * n).map(|i| Vec3::new((i % n) as f32 / 6.0 - 2.4, (i / n) as f32 / 6.0 - 2.0, 0.0)).collect();
    let got = ratios(&field, &map, &[], &places, &points);
    let tracer = world_tracer(&cloud, &places);
    let receivers = Receivers { width: n, height: n, points: points.clone(), normals: vec![Vec3::Z; n * n] };
    let config = ShadowConfig { rays: 8192, ..ShadowConfig::default() };
    let occluder = Traced(&tracer, (Vec3::new(-0.3, 0.1, 0.6), 1.7));
    let truth = trace_shadow(&receivers, &EnvironmentSampler::new(&map), &occluder, &config).ratio;
    let (mut square, mut worst, mut dark) = (0.0f32, 0.0f32, 0);
    for (i, got) in got.iter().enumerate() {
        let error = (*got - Vec3::from_slice(&truth.data[3 * i..3 * i + 3])).abs().max_element();
        square += error * error;
        worst = worst.max(error);
        dark += usize::from(truth.data[3 * i] < 0.5);
    }
    let rms = (square / got.len() as f32).sqrt();
    assert!(dark > 20, "the scene has shadows: {dark}");
    // Sixteen rays to the sun quantise its penumbra by 1/16; the rest is the grid.
    assert!(rms < 0.015 && worst < 0.09, "rms {rms} worst {worst}");
}

/// Goal: two lamps whose shadows overlap (hard case 32, paper B.7): where both are blocked nothing but the sky is left, where
/// one is blocked the other remains, with the shares that inverse squares give (paper answer); a lamp between point and
/// object is not blocked.
#[test]
fn hard_case_32_two_lamps_overlap() {
    let cloud = ball();
    let field = caster(&cloud);
    let black = EnvironmentMap::constant(Vec3::ZERO);
    let lamp = |x: f32, z: f32, i: f32| Lamp::Point {
        position: Vec3::new(x, 0.0, z),
        intensity: Vec3::splat(i),
        radius: 0.0,
    };
    let s = at(DVec3::new(0.0, 0.0, 1.0), 1.0, DQuat::IDENTITY);
    let lamps = [lamp(-2.0, 3.0, 4.0), lamp(2.0, 3.0, 1.0)];
    let points = [Vec3::new(1.0, 0.0, 0.0), Vec3::new(-1.0, 0.0, 0.0), Vec3::new(0.0, 3.0, 0.0)];
    let got = ratios(&field, &black, &lamps, &[s], &points);
    let irradiance = |p: Vec3, l: &Lamp| {
        let Lamp::Point { position, intensity, .. } = l else { panic!() };
        let d = *position - p;
        intensity.x * d.z / d.length().powi(3)
    };
    let share = |p: Vec3, keep: usize| {
        irradiance(p, &lamps[keep]) / (irradiance(p, &lamps[0]) + irradiance(p, &lamps[1]))
    };
    // From (1, 0, 0) the ray to (−2, 0, 3) passes the ball's middle; that to (2, 0, 3) clears it. Mirrored the other way.
    assert!((got[0].x - share(points[0], 1)).abs() < 0.01, "{} {}", got[0].x, share(points[0], 1));
    assert!((got[1].x - share(points[1], 0)).abs() < 0.01, "{} {}", got[1].x, share(points[1], 0));
    assert_eq!(got[2], Vec3::ONE);
    // Straight beneath the ball both are blocked when they stand above it.
    let above = [lamp(-0.2, 4.0, 4.0), lamp(0.2, 4.0, 1.0)];
    let both = ratios(&field, &black, &above, &[s], &[Vec3::ZERO])[0];
    assert!(both.max_element() < 0.02, "{both}");
    // A lamp under the ball: the ball is behind it.
    let under = ratios(&field, &black, &[lamp(0.0, 0.3, 1.0)], &[s], &[Vec3::ZERO])[0];
    assert_eq!(under, Vec3::ONE);
}

/// Goal: black light gives exactly 1, one hot texel of 10⁵ over 10⁻³ stays in [0, 1], and a receiver that no light reaches
/// keeps its radiance (hard cases 25 and 26).
#[test]
fn hard_cases_25_26_black_and_hot_lights() {
    let cloud = ball();
    let field = caster(&cloud);
    let s = at(DVec3::new(0.0, 0.0, 0.6), 1.0, DQuat::IDENTITY);
    let points: Vec<Vec3> = (0..50).map(|i| Vec3::new(i as f32 * 0.05 - 1.2, 0.01, 0.0)).collect();
    let black = ratios(&field, &EnvironmentMap::constant(Vec3::ZERO), &[], &[s], &points);
    assert!(black.iter().all(|r| *r == Vec3::ONE));
    for (x, y) in [(0, 0), (40, 10), (100, 40)] {
        let mut image = Image::filled(128, 64, 3, 1e-3);
        image.pixel_mut(x, y).copy_from_slice(&[1e5, 1e5, 0.0]);
        let map = EnvironmentMap::from_image(&image).unwrap();
        for r in ratios(&field, &map, &[], &[s], &points) {
            assert!(r.is_finite() && r.min_element() >= 0.0 && r.max_element() <= 1.0, "{r}");
        }
    }
}

/// Goal: an object as bright as the light around it hides nothing on balance: under constant light of radiance L, a ball of
/// radiance L leaves the ratio at 1 (paper answer), one of 2 L raises it by what it hides, a red one tints it.
#[test]
fn bounced_light_balances_what_is_hidden() {
    let cloud = ball();
    let caster = caster(&cloud);
    let map = EnvironmentMap::constant(Vec3::ONE);
    let light = light(&map, &[]);
    let s = at(DVec3::new(0.0, 0.0, 0.8), 1.0, DQuat::IDENTITY);
    let of = |radiance: Vec3| {
        let shadow = FieldShadow::new(&light, &[(&caster, s)]).with_bounce(|_, _| radiance);
        shadow.ratios(&[Vec3::new(0.1, 0.0, 0.0)], &[Vec3::Z])[0]
    };
    let dark = of(Vec3::ZERO).x;
    assert!(dark < 0.75, "{dark}");
    assert!((of(Vec3::ONE) - Vec3::ONE).abs().max_element() < 0.01, "{}", of(Vec3::ONE));
    assert!((of(2.0 * Vec3::ONE).x - (2.0 - dark)).abs() < 0.02);
    let red = of(Vec3::new(0.8, 0.1, 0.1));
    assert!(red.x > red.y + 0.1 && red.y == red.z);
}

/// Goal: a floor that a table shades from a lamp is not shaded once more by what stands on the table; the table's top is, as
/// before; and light that does not come from the lamp is hidden as before.
#[test]
fn what_the_scene_shades_is_not_shaded_twice() {
    let cloud = ball();
    let field = caster(&cloud);
    let mut table = SurfelCloud::empty(0, ColorEncoding::Linear);
    for k in 0..40 * 40 {
        table.positions.push([(k % 40) as f32 * 0.1 - 1.95, (k / 40) as f32 * 0.1 - 1.95, 0.0]);
        table.rotations.push([1.0, 0.0, 0.0, 0.0]);
        table.log_scales.push([0.1f32.ln(); 2]);
        table.opacity_logits.push(logit(0.99));
        table.sh.extend([0.0; 3]);
    }
    let scene = Tracer::new(&table, &TraceConfig::occlusion()).unwrap();
    let map = EnvironmentMap::constant(Vec3::splat(0.05));
    let sun = Lamp::Directional { direction: Vec3::Z, irradiance: Vec3::splat(3.0), angular_radius: 0.005 };
    let light = light(&map, &[sun]);
    let place = at(DVec3::new(0.0, 0.0, 0.6), 1.0, DQuat::IDENTITY);
    let plain = FieldShadow::new(&light, &[(&field, place)]);
    let aware = FieldShadow::new(&light, &[(&field, place)]).with_scene(&scene, 0.1);
    let points = [Vec3::ZERO, Vec3::new(0.0, 0.0, -1.0), Vec3::new(1.5, 0.0, 0.0)];
    let (before, after) = (plain.ratios(&points, &[Vec3::Z; 3]), aware.ratios(&points, &[Vec3::Z; 3]));
    assert!(before[0].x < 0.1 && (before[0] - after[0]).abs().max_element() < 1e-3, "{before:?} {after:?}");
    // Below, only the even light's share is left: the ball as a disc of 0.5 at 1.6 hides about a tenth of it.
    assert!(before[1].x < 0.1 && (0.85..0.95).contains(&after[1].x), "{before:?} {after:?}");
    assert!((before[2] - after[2]).abs().max_element() < 0.02, "{before:?} {after:?}");
}
