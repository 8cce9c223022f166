//! Cached relighting against answers known on paper and against many samples.

use comgs_compose::relight::{CachedRelighter, Mirror, SelfVisibility, Standing};
use comgs_compose::{
    Caster, FieldConfig, FieldShadow, RelightConfig, RelightError, Relighter, SelfOcclusion, ShadowLight,
    ShadowLightConfig,
};
use comgs_geom::sampling::uniform_sphere;
use comgs_geom::{Camera, Similarity};
use comgs_image::Image;
use comgs_light::{EnvironmentMap, Material};
use comgs_raster::Planes;
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud, activation::logit};
use comgs_trace::{TraceConfig, Tracer};
use glam::{DQuat, DVec3, Vec2, Vec3};

/// Two balls of radius ½ and 0.3 that nearly touch, so that one shadows the other.
fn balls(material: Material) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let mut columns = MaterialColumns::default();
    for (centre, radius, n) in [(Vec3::ZERO, 0.5, 3000), (Vec3::new(0.0, 0.0, 0.85), 0.3, 1200)] {
        for i in 0..n {
            let golden = 0.618_034 * i as f32;
            let d = uniform_sphere(Vec2::new((i as f32 + 0.5) / n as f32, golden - golden.floor()));
            let q = glam::Quat::from_rotation_arc(Vec3::Z, d.normalize());
            cloud.positions.push((centre + radius * d).to_array());
            cloud.rotations.push([q.w, q.x, q.y, q.z]);
            cloud.log_scales.push([0.02f32.ln(); 2]);
            cloud.opacity_logits.push(logit(0.99));
            cloud.sh.extend([0.0; 3]);
            columns.albedo_logits.push(material.albedo.to_array().map(logit));
            columns.roughness_logits.push(logit(material.roughness));
            columns.metallic_logits.push(logit(material.metallic));
        }
    }
    cloud.material = Some(columns);
    cloud
}

fn camera() -> Camera {
    Camera::look_at("a", 64, 64, 0.8, DVec3::new(2.2, -1.6, 0.9), DVec3::new(0.0, 0.0, 0.3), DVec3::Z)
}

fn sunny() -> EnvironmentMap {
    let mut image = Image::zeros(64, 32, 3);
    for y in 0..32 {
        for x in 0..64 {
            image.pixel_mut(x, y).copy_from_slice(&[0.3, 0.4, if y < 16 { 0.9 } else { 0.2 }]);
        }
    }
    image.pixel_mut(40, 8).copy_from_slice(&[150.0, 140.0, 120.0]);
    EnvironmentMap::from_image(&image).unwrap()
}

/// Radiance of a placed cloud by the cache, and by 2048 traced samples; the pixels that are all surface.
fn both(
    own: &SurfelCloud,
    place: Similarity,
    map: &EnvironmentMap,
    hidden: bool,
    rays: u32,
) -> (Vec<Vec3>, Vec<Vec3>) {
    // Between these coarse discs the mean depth lies inside the ball; rays must start above the discs.
    let config = RelightConfig { trace_offset: 0.02, highlight_rays: rays, ..RelightConfig::balanced() };
    let world = own.transformed(&place);
    let own_tracer = Tracer::new(own, &TraceConfig::occlusion()).unwrap();
    let tracer = Tracer::new(&world, &TraceConfig::occlusion()).unwrap();
    let visibility = SelfVisibility::new(own, None, &own_tracer, false, &config).unwrap();
    let light = ShadowLight::new(map, &[], &ShadowLightConfig::default()).unwrap();
    let standing = Standing { cloud: own, tracer: &own_tracer, world_from_object: place };
    let objects = [(standing, &visibility, None)];
    let mirror = if hidden { Mirror::Trace { tracer: &tracer, offset: 0.03 } } else { Mirror::Open };
    let objects = if hidden { &objects[..] } else { &[] };
    let cached = CachedRelighter::new(&world, objects, &light, map, mirror, None, &config).unwrap();
    let frame = comgs_raster::render(cached.carrier(), &camera(), Planes::ALL, &config.raster);
    let got = cached.shade(&camera(), &frame);
    let self_occlusion = if hidden { SelfOcclusion::Trace } else { SelfOcclusion::None };
    let sampled = RelightConfig { self_occlusion, ..config.with_rays(2048) };
    let truth = Relighter::new(&world, None, map, sampled).unwrap().render(&camera());
    let solid: Vec<usize> = (0..64 * 64).filter(|&i| frame.weight.data[i] > 0.99).collect();
    assert!(solid.len() > 600, "{}", solid.len());
    let of = |image: &Image| solid.iter().map(|&i| Vec3::from_slice(&image.data[3 * i..])).collect();
    (of(&got), of(&truth.radiance))
}

/// Root mean square of the difference over that of the truth.
fn error(got: &[Vec3], truth: &[Vec3]) -> f32 {
    let square = |v: f32, d: &Vec3| v + d.length_squared();
    let differences: Vec<Vec3> = got.iter().zip(truth).map(|(a, b)| *a - *b).collect();
    (differences.iter().fold(0.0, square) / truth.iter().fold(0.0, square)).sqrt()
}

fn turned() -> Similarity {
    Similarity {
        scale: 0.9,
        rotation: DQuat::from_axis_angle(DVec3::new(0.3, 0.2, 1.0).normalize(), 0.8),
        translation: DVec3::new(0.05, -0.02, 0.04),
    }
}

/// Goal: in constant light a matte surface that hides nothing is its albedo and its highlight, as by samples.
#[test]
fn white_furnace() {
    let matte = Material { albedo: Vec3::new(0.8, 0.5, 0.2), roughness: 1.0, metallic: 0.0 };
    let white = EnvironmentMap::constant(Vec3::ONE);
    let (got, truth) = both(&balls(matte), Similarity::IDENTITY, &white, false, 8);
    assert!(error(&got, &truth) < 0.01, "{}", error(&got, &truth));
}

/// Goal: turned, scaled and shadowing itself under a sky with a sun, a matte surface comes out as by 2048 traced samples to a
/// few percent (3.8 % measured), several times nearer than without what is hidden. A polished one keeps its mean (1 to 5 % short
/// measured); its pixels, which a sun behind eight binary rays decides, are known to be off by a third.
#[test]
fn the_cache_is_what_samples_give() {
    let matte = balls(Material { albedo: Vec3::new(0.7, 0.5, 0.3), roughness: 0.8, metallic: 0.0 });
    let (got, truth) = both(&matte, turned(), &sunny(), true, 8);
    let (open, _) = both(&matte, turned(), &sunny(), false, 8);
    let (near, far) = (error(&got, &truth), error(&open, &truth));
    assert!(near < 0.06 && far > 3.0 * near, "{near} {far}");

    let metal = balls(Material { albedo: Vec3::new(0.9, 0.7, 0.3), roughness: 0.35, metallic: 1.0 });
    let (got, truth) = both(&metal, turned(), &sunny(), true, 8);
    let mean = |v: &[Vec3]| v.iter().sum::<Vec3>() / v.len() as f32;
    let short = (mean(&got) / mean(&truth) - 1.0).abs().max_element();
    assert!(short < 0.08 && error(&got, &truth) < 0.4, "{short} {}", error(&got, &truth));
}

/// Goal: what two objects hide of the same light is dark once: two pairs of balls, one above the other, come out as one cloud
/// traced with 2048 samples to a few percent, several times nearer than each alone.
#[test]
fn objects_hide_the_same_light_once() {
    let own = balls(Material { albedo: Vec3::new(0.7, 0.5, 0.3), roughness: 0.8, metallic: 0.0 });
    let above = Similarity { scale: 0.8, translation: DVec3::new(0.0, 0.05, 1.6), ..Similarity::IDENTITY };
    let places = [Similarity::IDENTITY, above];
    let map = sunny();
    let config = RelightConfig { trace_offset: 0.02, highlight_rays: 8, ..RelightConfig::balanced() };
    let parts: Vec<_> =
        places.iter().map(|p| comgs_compose::PlacedObject { cloud: &own, world_from_object: *p }).collect();
    let world = comgs_compose::merge(&parts).unwrap();
    let tracer = Tracer::new(&world, &TraceConfig::occlusion()).unwrap();
    let caster = Caster::new(&own, FieldConfig::default(), None, &|| false).unwrap();
    let visibility = SelfVisibility::new(&own, None, &caster.tracer, false, &config).unwrap();
    let light = ShadowLight::new(&map, &[], &ShadowLightConfig::default()).unwrap();
    let others: Vec<FieldShadow<'_>> =
        (0..2).map(|i| FieldShadow::new(&light, &[(&caster, places[1 - i])])).collect();
    let standing = |i: usize| Standing { cloud: &own, tracer: &caster.tracer, world_from_object: places[i] };
    let shown = |together: bool| {
        let objects: Vec<_> =
            (0..2).map(|i| (standing(i), &visibility, together.then_some(&others[i]))).collect();
        let mirror = Mirror::Trace { tracer: &tracer, offset: 0.03 };
        let cached = CachedRelighter::new(&world, &objects, &light, &map, mirror, None, &config).unwrap();
        let frame = comgs_raster::render(cached.carrier(), &camera(), Planes::ALL, &config.raster);
        let shaded = cached.shade(&camera(), &frame);
        (0..64 * 64)
            .map(|i| {
                if frame.weight.data[i] > 0.99 { Vec3::from_slice(&shaded.data[3 * i..]) } else { Vec3::NAN }
            })
            .collect::<Vec<_>>()
    };
    let sampled = RelightConfig { self_occlusion: SelfOcclusion::Trace, ..config.clone().with_rays(2048) };
    let truth = Relighter::new(&world, None, &map, sampled).unwrap().render(&camera()).radiance;
    let error = |got: Vec<Vec3>| {
        let solid: Vec<usize> = (0..64 * 64).filter(|&i| got[i].is_finite()).collect();
        assert!(solid.len() > 600, "{}", solid.len());
        let truth: Vec<Vec3> = solid.iter().map(|&i| Vec3::from_slice(&truth.data[3 * i..])).collect();
        let got: Vec<Vec3> = solid.iter().map(|&i| got[i]).collect();
        error(&got, &truth)
    };
    let (together, alone) = (error(shown(true)), error(shown(false)));
    assert!(together < 0.06 && alone > 2.0 * together, "{together} {alone}");
}

/// Goal: a black light gives black without a NaN (hard case 26), and surfels that do not add up are refused in words.
#[test]
fn hard_case_26_black_light_and_bad_input() {
    let matte = Material { albedo: Vec3::splat(0.5), roughness: 0.5, metallic: 0.0 };
    let black = EnvironmentMap::constant(Vec3::ZERO);
    let cloud = balls(matte);
    let (got, _) = both(&cloud, Similarity::IDENTITY, &black, true, 8);
    assert!(got.iter().all(|v| *v == Vec3::ZERO));
    let config = RelightConfig::balanced();
    let tracer = Tracer::new(&cloud, &TraceConfig::occlusion()).unwrap();
    let own = SelfVisibility::new(&cloud, None, &tracer, false, &config).unwrap();
    let light = ShadowLight::new(&black, &[], &ShadowLightConfig::default()).unwrap();
    let standing = Standing { cloud: &cloud, tracer: &tracer, world_from_object: Similarity::IDENTITY };
    let twice = [(standing, &own, None), (standing, &own, None)];
    let refused = CachedRelighter::new(&cloud, &twice, &light, &black, Mirror::Open, None, &config).err();
    assert!(matches!(refused, Some(RelightError::Cloud(ref p)) if p[0].contains("8400")), "{refused:?}");
}
