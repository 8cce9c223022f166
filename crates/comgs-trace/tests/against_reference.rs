//! The tracer against the f64 reference on random clouds, and its own invariants.

mod support;

use comgs_surfel::{ColorEncoding, SurfelCloud};
use comgs_trace::{Ray, TraceConfig, Tracer};
use glam::Vec3;
use support::{direction, judge, rays, soup, tracer};

/// Goal: transmittance, radiance, depth and normals agree with the reference on random clouds and rays, for both
/// colour encodings and several thresholds.
#[test]
fn random_clouds() {
    let mut most = 0;
    for (k, n) in [1, 2, 7, 8, 9, 65, 2000].into_iter().enumerate() {
        let encoding = if k % 2 == 0 { ColorEncoding::Linear } else { ColorEncoding::Srgb };
        let cloud = soup(n, k as u64, encoding);
        for config in [
            TraceConfig::default(),
            TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() },
            TraceConfig {
                alpha_min: 0.05,
                alpha_max: 0.7,
                transmittance_min: 0.01,
                ..TraceConfig::default()
            },
        ] {
            let tracer = Tracer::new(&cloud, &config).unwrap();
            for ray in rays(150, 100 + k as u64) {
                most = most.max(judge(&tracer, &cloud, &ray));
            }
        }
    }
    assert!(most > 20, "the rays should meet many surfels, met at most {most}");
}

/// Goal: giving up what is hidden changes no bit: the blend with early stop equals the blend of all hits in order,
/// cut where the transmittance falls below the stop.
#[test]
fn early_stop_is_exact() {
    let cloud = soup(5000, 3, ColorEncoding::Srgb);
    let config = TraceConfig { transmittance_min: 0.02, ..TraceConfig::default() };
    let tracer = Tracer::new(&cloud, &config).unwrap();
    let mut stopped = 0;
    for ray in rays(600, 4) {
        let (mut alpha, mut depth, mut t) = (0.0f32, 0.0f32, 1.0f32);
        let all = tracer.hits(ray.origin, ray.direction, ray.t_min, ray.t_max);
        assert!(all.windows(2).all(|p| (p[0].t, p[0].surfel) < (p[1].t, p[1].surfel)), "sorted, none twice");
        for hit in &all {
            if t < config.transmittance_min {
                stopped += 1;
                break;
            }
            alpha += t * hit.alpha;
            depth += t * hit.alpha * hit.t;
            t *= 1.0 - hit.alpha;
        }
        let got = tracer.radiance(ray.origin, ray.direction, ray.t_min, ray.t_max);
        assert_eq!((got.alpha, got.depth), (alpha.min(1.0), depth), "{ray:?}");
    }
    assert!(stopped > 100, "{stopped}");
}

/// Goal: transmittance is the complement of the blended alpha, and splitting a ray multiplies.
#[test]
fn transmittance_is_the_complement_of_alpha() {
    let cloud = soup(800, 5, ColorEncoding::Linear);
    let config = TraceConfig { transmittance_min: 0.0, ..TraceConfig::default() };
    let tracer = Tracer::new(&cloud, &config).unwrap();
    for (i, ray) in rays(400, 6).into_iter().enumerate() {
        let whole = tracer.transmittance(ray.origin, ray.direction, ray.t_min, ray.t_max);
        let alpha = tracer.radiance(ray.origin, ray.direction, ray.t_min, ray.t_max).alpha;
        assert!((1.0 - alpha - whole).abs() < 1e-5, "{ray:?}");
        // Cut exactly at a hit where there is one: it belongs to the second part.
        let hits = tracer.hits(ray.origin, ray.direction, ray.t_min, ray.t_max);
        let cut = hits.get(i % 7).map_or(ray.t_min + 0.5, |hit| hit.t);
        if cut < ray.t_max {
            let first = tracer.transmittance(ray.origin, ray.direction, ray.t_min, cut);
            let second = tracer.transmittance(ray.origin, ray.direction, cut, ray.t_max);
            assert!((first * second - whole).abs() < 1e-5, "{ray:?} cut at {cut}");
        }
    }
}

/// Goal: batches and fixed-eye views give the same bits as single rays, at one and at three threads.
#[test]
fn batches_equal_single_rays_at_any_thread_count() {
    let cloud = soup(1500, 7, ColorEncoding::Srgb);
    let tracer = tracer(&cloud);
    let rays = rays(333, 8);
    let single: Vec<_> =
        rays.iter().map(|r| tracer.transmittance(r.origin, r.direction, r.t_min, r.t_max)).collect();
    let radiance: Vec<_> =
        rays.iter().map(|r| tracer.radiance(r.origin, r.direction, r.t_min, r.t_max)).collect();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| tracer.transmittance_batch(&rays)), single);
        assert_eq!(pool.install(|| tracer.radiance_batch(&rays)), radiance);
        let eye = Vec3::new(0.3, -2.0, 0.4);
        let view = pool.install(|| tracer.view(eye));
        for ray in &rays {
            let expected = tracer.radiance(eye, ray.direction, 0.0, f32::INFINITY);
            assert_eq!(view.radiance(ray.direction, 0.0, f32::INFINITY), expected);
        }
    }
    assert!(tracer.transmittance_batch(&[]).is_empty());
}

/// Goal: a scene a million times larger or smaller gives the same picture (no absolute epsilons).
#[test]
fn scale_free() {
    let cloud = soup(400, 9, ColorEncoding::Linear);
    let plain = tracer(&cloud);
    for exponent in [-20i32, 20] {
        let factor = 2.0f32.powi(exponent);
        let mut scaled = cloud.clone();
        scaled.positions.iter_mut().flatten().for_each(|v| *v *= factor);
        scaled.log_scales.iter_mut().flatten().for_each(|v| *v += exponent as f32 * std::f32::consts::LN_2);
        let tracer = tracer(&scaled);
        for ray in rays(200, 10) {
            let a = plain.radiance(ray.origin, ray.direction, ray.t_min, ray.t_max);
            let b = tracer.radiance(ray.origin * factor, ray.direction * factor, ray.t_min, ray.t_max);
            // exp and ln of the scales round differently, so the rim of a disc may fall either way.
            assert!((a.alpha - b.alpha).abs() < 6e-3, "{ray:?}: {a:?} {b:?}");
        }
    }
}

/// Goal: the degree option gives exactly the cloud with its higher bands removed.
#[test]
fn harmonics_can_be_cut() {
    let cloud = soup(300, 12, ColorEncoding::Srgb);
    for degree in 0..=3 {
        let mut cut = SurfelCloud { sh: Vec::new(), sh_degree: degree, ..cloud.clone() };
        let kept = cut.sh_stride();
        cut.sh = cloud.sh.chunks_exact(cloud.sh_stride()).flat_map(|c| c[..kept].to_vec()).collect();
        let a = Tracer::new(&cloud, &TraceConfig { sh_degree: degree, ..TraceConfig::default() }).unwrap();
        let b = tracer(&cut);
        for ray in rays(50, 13) {
            let of = |t: &Tracer| t.radiance(ray.origin, ray.direction, 0.0, f32::INFINITY);
            assert_eq!(of(&a), of(&b));
        }
    }
}

/// Goal: columns that disagree and thresholds out of range are refused by name; nothing is traced by guessing.
#[test]
fn refusals() {
    let mut cloud = soup(3, 1, ColorEncoding::Linear);
    let config = TraceConfig { alpha_min: -1.0, ..TraceConfig::default() };
    assert!(Tracer::new(&cloud, &config).unwrap_err().to_string().contains("alpha_min is -1"));
    cloud.opacity_logits.pop();
    let message = Tracer::new(&cloud, &TraceConfig::default()).unwrap_err().to_string();
    assert!(message.contains("opacity_logits has 2 values, expected 3"), "{message}");
}

/// Goal: poison in every parameter of a ray is finite and in range (style: poison values).
#[test]
fn poison() {
    let cloud = soup(50, 14, ColorEncoding::Linear);
    let tracer = tracer(&cloud);
    let values = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        1e-45,
        -1e-40,
        f32::MIN_POSITIVE,
        1e-20,
        1e20,
        1e38,
        -1e38,
        f32::MAX,
        f32::MIN,
        1.0 / 255.0,
        0.99,
        1e-4,
    ];
    let mut rng = comgs_geom::Rng::new(15);
    for i in 0..20_000 {
        let mut pick =
            |usual: f32| if i % 2 == 0 || rng.below(3) > 0 { values[rng.below(values.len())] } else { usual };
        let origin = Vec3::new(pick(2.0), pick(0.0), pick(0.1));
        let d = Vec3::new(pick(-1.0), pick(0.05), pick(0.0));
        let (t_min, t_max) = (pick(0.0), pick(f32::INFINITY));
        let t = tracer.transmittance(origin, d, t_min, t_max);
        assert!((0.0..=1.0).contains(&t), "{:?}: {t}", Ray::between(origin, d, t_min, t_max));
        let hit = tracer.radiance(origin, d, t_min, t_max);
        let finite = hit.radiance.is_finite() && hit.alpha.is_finite() && hit.normal.is_finite();
        assert!(finite && (0.0..=1.0).contains(&hit.alpha), "{origin} {d} {t_min} {t_max}: {hit:?}");
        assert!(!hit.depth.is_nan() && hit.depth >= 0.0, "{origin} {d} {t_min} {t_max}: {hit:?}");
    }
    let _ = direction(&mut rng);
}
