//! Hard case 17, hard case 18 and hard case 19 of the list that the design keeps.

mod support;

use comgs_geom::Rng;
use comgs_surfel::{ColorEncoding, SurfelCloud, activation};
use comgs_trace::{LeftOut, Ray, TraceConfig, Tracer, reference};
use glam::{Quat, Vec3};
use support::{direction, judge, nothing, push, soup, stack, tracer, wide};

/// Goal (hard case 17): 3000 surfels on one ray, too faint to stop it, blend exactly in order: no buffer overflows, none is
/// counted twice.
#[test]
fn case_17_thousands_of_hits() {
    let n = 3000;
    let cloud = stack(n, 0.006, 0.001);
    let config = TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() };
    let tracer = Tracer::new(&cloud, &config).unwrap();
    let (origin, d) = (Vec3::new(-0.5, 0.1, 0.05), Vec3::new(1.0, 0.01, -0.02));
    let hits = tracer.hits(origin, d, 0.0, f32::INFINITY);
    assert_eq!(hits.len(), n);
    let mut surfels: Vec<u32> = hits.iter().map(|h| h.surfel).collect();
    surfels.sort_unstable();
    assert_eq!(surfels, (0..n as u32).collect::<Vec<_>>(), "each exactly once");
    let expected =
        reference::hits(&cloud, &config, config.alpha_min.into(), wide(origin), wide(d), 0.0, f64::MAX);
    let order: Vec<usize> = expected.iter().map(|h| h.surfel).collect();
    assert_eq!(hits.iter().map(|h| h.surfel as usize).collect::<Vec<_>>(), order, "in the reference's order");
    assert_eq!(judge(&tracer, &cloud, &Ray::new(origin, d)), n);
    // The same with the usual early stop.
    assert_eq!(judge(&support::tracer(&cloud), &cloud, &Ray::new(origin, d)), n);
}

/// Goal (hard case 17): 1500 overlapping surfels in random orientations at one spot, rays from all sides.
#[test]
fn case_17_overlapping_in_a_knot() {
    let mut rng = Rng::new(21);
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for _ in 0..1500 {
        let q = Quat::from_xyzw(rng.normal(), rng.normal(), rng.normal(), rng.normal()).normalize();
        let colour = Vec3::new(rng.uniform(), rng.uniform(), rng.uniform());
        push(&mut cloud, 0.05 * direction(&mut rng), q, [0.3, 0.2], rng.range(0.005, 0.02), colour);
    }
    let tracer =
        Tracer::new(&cloud, &TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() }).unwrap();
    let mut most = 0;
    for _ in 0..40 {
        let origin = 2.0 * direction(&mut rng);
        most = most.max(judge(&tracer, &cloud, &Ray::new(origin, 0.1 * direction(&mut rng) - origin)));
    }
    assert!(most > 1000, "{most}");
}

/// Goal (hard case 17): nearly opaque surfels stop the ray after a few, whatever is stacked behind.
#[test]
fn case_17_opaque_stacks() {
    let cloud = stack(2000, 0.999_999, 0.01);
    let tracer = tracer(&cloud);
    let hit = tracer.radiance(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY);
    // α is capped at 0.99: two hits leave exactly the stop of 1e-4, a third passes it.
    assert!((hit.alpha - 1.0).abs() < 1.01e-4 && hit.alpha <= 1.0, "{hit:?}");
    assert!((hit.depth - 1.0).abs() < 2e-4, "{hit:?}");
    assert_eq!(tracer.transmittance(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY), 0.0);
    // A stop of 0 multiplies to the end and underflows to exactly nothing.
    let endless =
        Tracer::new(&cloud, &TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() }).unwrap();
    assert_eq!(endless.transmittance(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY), 0.0);
}

/// Goal (hard case 18): an origin inside the bounds of many surfels, and exactly on one: what is behind does not count, and
/// `t_min` decides about the one it sits on.
#[test]
fn case_18_origin_inside_and_on_a_surfel() {
    let cloud = soup(1500, 22, ColorEncoding::Linear);
    let all = tracer(&cloud);
    let mut rng = Rng::new(23);
    for _ in 0..200 {
        let origin = 0.5 * direction(&mut rng);
        judge(&all, &cloud, &Ray::new(origin, direction(&mut rng)));
    }
    let mut one = SurfelCloud::empty(0, ColorEncoding::Linear);
    push(&mut one, Vec3::new(1.0, 2.0, 3.0), Quat::IDENTITY, [0.1, 0.1], 0.5, Vec3::ONE);
    let tracer = tracer(&one);
    let on = Vec3::new(1.0, 2.0, 3.0);
    let t = |d: Vec3, t_min: f32| tracer.transmittance(on, d, t_min, f32::INFINITY);
    assert!((t(Vec3::Z, 0.0) - 0.5).abs() < 1e-6, "t = 0 counts");
    assert!((t(Vec3::NEG_Z, 0.0) - 0.5).abs() < 1e-6);
    assert_eq!(t(Vec3::Z, 1e-6), 1.0);
    assert_eq!(tracer.transmittance(on - Vec3::Z, Vec3::Z, 0.0, 1.0), 1.0, "the end is exclusive");
    assert!((tracer.transmittance(on - Vec3::Z, Vec3::Z, 1.0, 2.0) - 0.5).abs() < 1e-6, "the start is not");
    // The colour at the surfel's own centre has no line of sight: it is finite all the same.
    assert!(tracer.radiance(on, Vec3::Z, 0.0, 1.0).radiance.is_finite());
}

/// Goal (hard case 18): a ray in a surfel's plane or parallel to it misses it; a nearly parallel one is as the reference says.
#[test]
fn case_18_parallel_rays() {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    push(&mut cloud, Vec3::ZERO, Quat::IDENTITY, [0.5, 0.5], 0.9, Vec3::ONE);
    let tracer = tracer(&cloud);
    for origin in [Vec3::ZERO, Vec3::new(-2.0, 0.0, 0.0), Vec3::new(-2.0, 0.0, 0.1)] {
        for d in [Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::new(1.0, 0.3, -0.0)] {
            assert_eq!(tracer.transmittance(origin, d, 0.0, f32::INFINITY), 1.0);
            assert_eq!(tracer.radiance(origin, d, 0.0, f32::INFINITY), nothing());
        }
    }
    for tilt in [1e-1f32, 1e-2, 1e-3, 1e-4] {
        for start in [-0.3f32, 0.0, 0.4] {
            let origin = Vec3::new(start - 1.0, 0.05, tilt);
            judge(&tracer, &cloud, &Ray::new(origin, Vec3::new(1.0, 0.0, -tilt)));
        }
    }
}

/// Goal (hard case 18): zero, denormal and non-finite directions and origins meet nothing; unnormalised ones measure t in their
/// own length, from 1e-30 to 1e30.
#[test]
fn case_18_directions() {
    let cloud = soup(500, 24, ColorEncoding::Linear);
    let tracer = tracer(&cloud);
    let o = Vec3::new(2.0, 0.1, 0.2);
    let bad = [
        Vec3::ZERO,
        Vec3::new(-0.0, 0.0, -0.0),
        Vec3::new(1e-40, -1e-42, 0.0),
        Vec3::new(f32::NAN, 1.0, 0.0),
        Vec3::new(1.0, f32::NAN, 0.0),
        Vec3::new(f32::INFINITY, 0.0, 0.0),
        Vec3::new(-1.0, 0.0, f32::NEG_INFINITY),
    ];
    for d in bad {
        assert_eq!(tracer.transmittance(o, d, 0.0, f32::INFINITY), 1.0, "{d}");
        assert_eq!(tracer.radiance(o, d, 0.0, f32::INFINITY), nothing(), "{d}");
        assert!(tracer.hits(o, d, 0.0, f32::INFINITY).is_empty());
    }
    for origin in [Vec3::NAN, Vec3::INFINITY, Vec3::new(0.0, f32::NEG_INFINITY, 0.0)] {
        assert_eq!(tracer.transmittance(origin, Vec3::X, 0.0, f32::INFINITY), 1.0);
    }
    for (t_min, t_max) in [(f32::NAN, 1.0), (0.0, f32::NAN), (2.0, 1.0), (1.0, 1.0), (-3.0, -1.0)] {
        assert_eq!(tracer.transmittance(o, -o, t_min, t_max), 1.0, "{t_min} {t_max}");
    }
    assert_eq!(
        tracer.radiance(o, -o, -5.0, f32::INFINITY),
        tracer.radiance(o, -o, 0.0, f32::INFINITY),
        "a negative start is 0"
    );
    let d = Vec3::new(-1.0, -0.03, -0.1);
    let plain = tracer.radiance(o, d, 0.25, 8.0);
    assert!(plain.alpha > 0.1);
    for exponent in [-100i32, -40, -7, 3, 60, 120] {
        let f = 2.0f32.powi(exponent);
        let scaled = tracer.radiance(o, d * f, 0.25 / f, 8.0 / f);
        assert_eq!(
            (scaled.radiance, scaled.alpha, scaled.normal),
            (plain.radiance, plain.alpha, plain.normal)
        );
        assert_eq!(scaled.depth, plain.depth / f, "{exponent}");
        assert_eq!(tracer.transmittance(o, d * f, 0.25 / f, 8.0 / f), tracer.transmittance(o, d, 0.25, 8.0));
    }
}

/// Goal (hard case 19): coplanar and duplicated surfels are all counted, and equal distances are ordered by index.
#[test]
fn case_19_coplanar_and_duplicated() {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let copies = 37;
    for k in 0..copies {
        let colour = Vec3::splat(k as f32 / copies as f32);
        push(&mut cloud, Vec3::ZERO, Quat::IDENTITY, [0.2, 0.4], 0.3, colour);
    }
    // Beside the first ones, in the same plane.
    for k in 0..50 {
        push(&mut cloud, Vec3::new(0.01 * k as f32, 0.0, 0.0), Quat::IDENTITY, [0.2, 0.2], 0.2, Vec3::X);
    }
    let config = TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() };
    let tracer = Tracer::new(&cloud, &config).unwrap();
    let hits = tracer.hits(Vec3::Z, Vec3::NEG_Z, 0.0, f32::INFINITY);
    assert!(hits.iter().all(|h| h.t == 1.0));
    let surfels: Vec<u32> = hits.iter().map(|h| h.surfel).collect();
    assert!(surfels.len() > 60 && surfels.is_sorted());
    assert_eq!(surfels[..copies as usize], (0..copies).collect::<Vec<u32>>());
    judge(&tracer, &cloud, &Ray::new(Vec3::Z, Vec3::NEG_Z));
    let opacity = f64::from(activation::sigmoid(activation::logit(0.3)));
    let mut only = cloud.clone();
    only.retain(&(0..cloud.len()).map(|i| i < copies as usize).collect::<Vec<_>>());
    let t = Tracer::new(&only, &config).unwrap().transmittance(Vec3::Z, Vec3::NEG_Z, 0.0, 2.0);
    let expected = (1.0 - opacity).powi(copies as i32);
    assert!((f64::from(t) / expected - 1.0).abs() < 1e-4, "{t} {expected}");
}

/// Goal (hard case 19): no surfel, one, and only surfels that are left out.
#[test]
fn case_19_none_and_one() {
    let none = SurfelCloud::empty(3, ColorEncoding::Srgb);
    let tracer_of_none = tracer(&none);
    assert!(tracer_of_none.is_empty() && tracer_of_none.bounds().is_none());
    assert_eq!(tracer_of_none.transmittance(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY), 1.0);
    assert_eq!(tracer_of_none.radiance(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY), nothing());
    assert_eq!(tracer_of_none.view(Vec3::ZERO).radiance(Vec3::X, 0.0, 1.0), nothing());

    let one = soup(1, 2, ColorEncoding::Linear);
    let tracer_of_one = tracer(&one);
    assert_eq!((tracer_of_one.len(), tracer_of_one.left_out()), (1, LeftOut::default()));
    for ray in support::rays(50, 3) {
        judge(&tracer_of_one, &one, &ray);
    }

    let mut unusable = soup(2, 4, ColorEncoding::Linear);
    unusable.opacity_logits[0] = -20.0;
    unusable.positions[1][0] = f32::NAN;
    let empty = tracer(&unusable);
    assert_eq!(empty.left_out(), LeftOut { transparent: 1, degenerate: 1 });
    assert!(empty.is_empty());
    assert_eq!(empty.radiance(Vec3::ZERO, Vec3::X, 0.0, f32::INFINITY), nothing());
}

/// Goal (hard case 19): a hundred thousand identical surfels build in bounded time, and a ray meets every one of them.
#[test]
fn case_19_all_identical() {
    let n = 100_000;
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for _ in 0..n {
        push(&mut cloud, Vec3::X, Quat::IDENTITY, [0.1, 0.1], 0.01, Vec3::ONE);
    }
    let tracer =
        Tracer::new(&cloud, &TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() }).unwrap();
    let hits = tracer.hits(Vec3::new(1.0, 0.0, -1.0), Vec3::Z, 0.0, f32::INFINITY);
    assert_eq!(hits.len(), n);
    assert!(hits.iter().enumerate().all(|(i, h)| h.surfel as usize == i && h.t == 1.0));
    assert_eq!(tracer.transmittance(Vec3::ZERO, Vec3::NEG_X, 0.0, f32::INFINITY), 1.0);
}

/// Goal (hard case 19): a regular coplanar grid of equal surfels, where all costs tie, builds in bounded time and is complete.
#[test]
fn case_19_regular_grid() {
    let n = 256;
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for k in 0..n * n {
        let centre = Vec3::new((k % n) as f32, (k / n) as f32, 0.0);
        push(&mut cloud, centre, Quat::IDENTITY, [0.5, 0.5], 0.5, Vec3::ONE);
    }
    let tracer = tracer(&cloud);
    let mut rng = Rng::new(35);
    for _ in 0..20 {
        let origin = Vec3::new(rng.range(0.0, 255.0), rng.range(0.0, 255.0), 3.0);
        assert!(judge(&tracer, &cloud, &Ray::new(origin, Vec3::new(rng.normal(), rng.normal(), -3.0))) > 3);
    }
}

/// Goal (hard case 19): a million surfels: no ray loses a hit against a walk over all of them.
#[test]
fn case_19_a_million() {
    let n = 1_000_000;
    let mut rng = Rng::new(31);
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for _ in 0..n {
        let q = Quat::from_xyzw(rng.normal(), rng.normal(), rng.normal(), rng.normal()).normalize();
        let centre = 10.0 * direction(&mut rng) * rng.uniform().cbrt();
        push(&mut cloud, centre, q, [0.03, 0.02], rng.range(0.05, 0.9), Vec3::ONE);
    }
    let tracer = tracer(&cloud);
    assert_eq!(tracer.len(), n);
    let mut hits = 0;
    for _ in 0..8 {
        hits += judge(&tracer, &cloud, &Ray::new(12.0 * direction(&mut rng), 3.0 * direction(&mut rng)));
        let origin = 12.0 * direction(&mut rng);
        hits += judge(&tracer, &cloud, &Ray::new(origin, 4.0 * direction(&mut rng) - origin));
    }
    assert!(hits > 100, "{hits}");
}

/// Goal (hard cases 5 and 19): needles, frame-filling discs and extreme log scales among ordinary surfels are finite and right.
#[test]
fn extreme_extents() {
    let mut cloud = soup(60, 33, ColorEncoding::Linear);
    for (k, scales) in [[-9.0, 0.2], [3.0, 3.0], [-40.0, -40.0], [20.0, -2.0], [30.0, 30.0], [40.0, 40.0]]
        .into_iter()
        .enumerate()
    {
        cloud.log_scales[k] = scales;
        cloud.opacity_logits[k] = -1.0;
    }
    let tracer = tracer(&cloud);
    assert_eq!(tracer.left_out().degenerate, 1, "a disc of 10¹⁷ units has no box");
    let mut known = cloud.clone();
    known.opacity_logits[5] = -30.0;
    for ray in support::rays(300, 34) {
        judge(&tracer, &known, &ray);
    }
}
