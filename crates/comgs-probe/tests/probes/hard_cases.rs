//! Hard case 20, hard case 21, hard case 22, hard case 23 and hard case 24 of the list that the design keeps.

use crate::round::{ball, fibonacci};
use crate::support::{baked, direction, empty, push, rectangle, rectangle_points, tracer};
use crate::wall;
use comgs_geom::{Rng, octahedral};
use comgs_probe::{
    BakeObserver, LookupConfig, Neighbours, OrientedPoints, ProbeConfig, ProbeError, ProbeIndex, ProbeSet,
    VisibilityWeight, bake, bake_occlusion, place, reference, sample,
};
use comgs_surfel::SurfelCloud;
use glam::Vec3;
use std::f32::consts::{FRAC_1_SQRT_2, PI};

/// f32 sums of up to 64 products of values up to 1.
const ROUNDING: f32 = 2e-5;

/// Probes at random places of the unit ball with random textures.
fn random_set(count: usize, resolution: usize, seed: u64) -> ProbeSet {
    let mut rng = Rng::new(seed);
    let normals: Vec<Vec3> = (0..count).map(|_| direction(&mut rng)).collect();
    let points = OrientedPoints { positions: normals.iter().map(|n| *n * rng.uniform()).collect(), normals };
    let config = ProbeConfig { count, resolution, ..ProbeConfig::default() };
    let mut set = place(&points, &config, 2.0).expect("the points are sound");
    for (texel, moments) in set.texels.iter_mut().zip(&mut set.moments) {
        *texel = [rng.uniform(), rng.uniform(), rng.uniform(), rng.uniform()];
        let distance = rng.uniform() * set.far_distance;
        *moments = [distance, distance * distance * rng.range(1.0, 1.5)];
    }
    set
}

/// A set of probes at given places, looking at nothing.
fn set_at(positions: &[Vec3]) -> ProbeSet {
    let texels = 16 * positions.len();
    ProbeSet {
        positions: positions.to_vec(),
        normals: vec![Vec3::Z; positions.len()],
        resolution: 4,
        texels: (0..texels).map(|i| [(i / 16) as f32, 0.0, 0.0, 0.5]).collect(),
        moments: vec![[1.5, 2.25]; texels],
        spacing: 1.0,
        far_distance: 1.5,
    }
}

fn plain(neighbours: usize) -> LookupConfig {
    LookupConfig {
        neighbours,
        min_distance: 1e-3,
        visibility: VisibilityWeight::None,
        min_deviation: 0.1,
        normal_bias: 0.0,
        visibility_floor: 1e-3,
    }
}

/// Directions on poles, axes, folds and edges of the map, with zeros of both signs.
fn awkward_directions() -> Vec<Vec3> {
    let mut all = Vec::new();
    for x in [0.0, -0.0, 1.0, -1.0] {
        for y in [0.0, -0.0, 1.0, -1.0, 0.3] {
            for z in [0.0, -0.0, 1.0, -1.0, 1e-8, -1e-8, 1e-39] {
                all.push(Vec3::new(x, y, z));
            }
        }
    }
    all.retain(|d| *d != Vec3::ZERO);
    all
}

/// Goal (hard case 20): lookups at exact poles, folds and signed zeros are the f64 reference's, whichever sign a zero has.
#[test]
fn case_20_poles_folds_and_signed_zeros() {
    for resolution in [2, 5, 16] {
        let set = random_set(12, resolution, 3);
        let index = ProbeIndex::new(&set.positions, 1.0);
        let neighbours = index.query(Vec3::splat(0.1), Vec3::Z, &set, &plain(8));
        let exact =
            reference::neighbours(&set, 1.0, &plain(8), Vec3::splat(0.1).as_dvec3(), Vec3::Z.as_dvec3());
        let mut blended = vec![[0.0; 4]; set.texture_len()];
        set.blend(&neighbours, &mut blended);
        for d in awkward_directions() {
            let expected = reference::lookup(&set, &exact, d.as_dvec3());
            for got in [set.lookup(&neighbours, d), sample(&blended, resolution, d)] {
                for c in 0..4 {
                    assert!(
                        (f64::from(got[c]) - expected[c]).abs() < f64::from(ROUNDING),
                        "{d}: {got:?} {expected:?}"
                    );
                }
            }
            let positive = Vec3::from_array(d.to_array().map(|v| v + 0.0));
            assert_eq!(set.lookup(&neighbours, d), set.lookup(&neighbours, positive), "{d}");
        }
        // No direction at all is +z, not NaN.
        for nothing in [Vec3::ZERO, Vec3::NAN] {
            assert_eq!(set.lookup(&neighbours, nothing), set.lookup(&neighbours, Vec3::Z));
        }
    }
}

/// Goal (hard case 20): interpolation is continuous along great circles across every fold and edge.
#[test]
fn case_20_continuous_everywhere() {
    let set = random_set(3, 16, 5);
    let neighbours = ProbeIndex::new(&set.positions, 2.0).query(Vec3::ZERO, Vec3::Z, &set, &plain(3));
    let mut rng = Rng::new(6);
    let steps = 20_000;
    for _ in 0..12 {
        let (a, b) = (direction(&mut rng), direction(&mut rng).any_orthonormal_vector());
        let at = |k: usize| {
            let (s, c) = (2.0 * PI * k as f32 / steps as f32).sin_cos();
            set.lookup(&neighbours, c * a + s * b.reject_from_normalized(a).normalize())
        };
        // A step is 3e-4 rad; the map stretches by at most √20.8 · 16 texels a radian, a texel changes by at most 1 in
        // each of two axes.
        let largest = 2.0 * 4.6 * 16.0 * (2.0 * PI / steps as f32) + ROUNDING;
        let mut last = at(0);
        for k in 1..=steps {
            let next = at(k);
            let change = (0..4).map(|c| (next[c] - last[c]).abs()).fold(0.0, f32::max);
            assert!(change <= largest, "step {k}: {change}, at most {largest}");
            last = next;
        }
    }
}

/// Goal (hard case 20): what stands at a pole is baked at this pole, at the centre of the map (+z) and at its corners (−z).
#[test]
fn case_20_baked_poles() {
    for pole in [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::NEG_Y] {
        let mut cloud = empty();
        // Radius 0.5 at distance 1: more than a texel around the pole.
        push(&mut cloud, pole, -pole, 0.25, 0.99, Vec3::new(0.2, 0.4, 0.8));
        push(&mut cloud, 1.01 * pole, -pole, 0.25, 0.99, Vec3::new(0.2, 0.4, 0.8));
        let mut set = set_at(&[Vec3::ZERO]);
        set.resolution = 16;
        set.texels = vec![[0.0; 4]; 256];
        set.moments = vec![[1.5, 2.25]; 256];
        bake(&tracer(&cloud), &mut set, 1, BakeObserver::silent()).unwrap();
        let neighbours = ProbeIndex::new(&set.positions, 1.0).query(Vec3::ZERO, Vec3::Z, &set, &plain(1));
        let [r, g, b, o] = set.lookup(&neighbours, pole);
        // Three quarters of the peak: the texels around the pole look past its centre.
        assert!(o > 0.75 && o <= 1.0, "{pole}: {o}");
        assert!((r / o - 0.2).abs() < 1e-3 && (g / o - 0.4).abs() < 1e-3 && (b / o - 0.8).abs() < 1e-3);
        let away = pole.any_orthonormal_vector();
        assert_eq!(set.lookup(&neighbours, -pole), [0.0; 4]);
        assert_eq!(set.lookup(&neighbours, away), [0.0; 4]);
    }
}

/// Goal (hard case 21): fewer probes in the radius than asked for are used as they are, with weights of sum 1.
#[test]
fn case_21_fewer_than_k() {
    let set = set_at(&[Vec3::X, Vec3::new(0.0, 0.5, 0.0), Vec3::new(5.0, 0.0, 0.0)]);
    let index = ProbeIndex::new(&set.positions, 1.0);
    let n = index.query(Vec3::ZERO, Vec3::Z, &set, &plain(8));
    assert_eq!((n.count, &n.probes[..2]), (2, &[1, 0][..]));
    // Both lie in the tangent plane: 1/0.5 against 1/1.
    assert!((n.weights[0] - 2.0 / 3.0).abs() < 1e-6 && (n.weights[1] - 1.0 / 3.0).abs() < 1e-6, "{n:?}");
    assert!(n.weights[2..].iter().all(|w| *w == 0.0));
    let got = set.lookup(&n, Vec3::X);
    assert!((got[0] - 2.0 / 3.0).abs() < 1e-6, "{got:?}");
}

/// Goal (hard case 21): a probe at distance 0 gets the bounded weight, no NaN, and nearly all of it; weights are continuous
/// there.
#[test]
fn case_21_distance_zero() {
    let set = set_at(&[Vec3::ZERO, Vec3::X]);
    let index = ProbeIndex::new(&set.positions, 2.0);
    let config = plain(8);
    let at = |x: Vec3| index.query(x, Vec3::Z, &set, &config);
    let n = at(Vec3::ZERO);
    assert_eq!(n.probes[0], 0);
    // 0.51 / 1e-3 against 0.51 / 1.
    assert!((n.weights[0] - 1000.0 / 1001.0).abs() < 1e-5, "{n:?}");
    for d in fibonacci(50) {
        let near = at(1e-7 * d);
        assert!((near.weights[0] - n.weights[0]).abs() < 1e-5, "{near:?}");
    }
    // All probes in one place share.
    let set = set_at(&[Vec3::ONE; 5]);
    let n = ProbeIndex::new(&set.positions, 1.0).query(Vec3::ONE, Vec3::Z, &set, &config);
    assert_eq!((n.count, &n.probes[..5]), (5, &[0, 1, 2, 3, 4][..]));
    assert!(n.weights[..5].iter().all(|w| (*w - 0.2).abs() < 1e-6));
}

/// Goal (hard case 21): outside all radii the nearest probe alone counts, however far; an isolated probe is found; an empty set
/// and a point that is not finite give nothing, and nothing blends to 0.
#[test]
fn case_21_outside_all_radii() {
    let mut positions: Vec<Vec3> = fibonacci(500);
    positions.push(Vec3::new(0.0, 0.0, 1e6));
    let set = set_at(&positions);
    let index = ProbeIndex::new(&set.positions, 0.2);
    let mut rng = Rng::new(8);
    for reach in [1.5, 3.0, 100.0, 1e5, 1e12] {
        for _ in 0..50 {
            let x = reach * direction(&mut rng);
            let nearest = (0..positions.len()).fold(0, |best, i| {
                if positions[i].as_dvec3().distance(x.as_dvec3())
                    < positions[best].as_dvec3().distance(x.as_dvec3())
                {
                    i
                } else {
                    best
                }
            });
            let n = index.query(x, Vec3::Z, &set, &plain(8));
            assert_eq!((n.count, n.weights[0]), (1, 1.0));
            let got = positions[n.probes[0] as usize].as_dvec3().distance(x.as_dvec3());
            let best = positions[nearest].as_dvec3().distance(x.as_dvec3());
            assert!(
                got <= best * (1.0 + 1e-6),
                "{x}: probe {} at {got}, nearest {nearest} at {best}",
                n.probes[0]
            );
        }
    }
    let n = index.query(Vec3::new(0.05, 0.0, 1e6), Vec3::Z, &set, &plain(8));
    assert_eq!((n.count, n.probes[0], n.weights[0]), (1, 500, 1.0));
    for x in [Vec3::NAN, Vec3::INFINITY] {
        assert_eq!(index.query(x, Vec3::Z, &set, &plain(8)), Neighbours::default());
    }
    let nothing = set_at(&[]);
    let empty = ProbeIndex::new(&nothing.positions, 1.0);
    let n = empty.query(Vec3::ZERO, Vec3::Z, &nothing, &plain(8));
    assert_eq!(n.count, 0);
    let mut blended = vec![[7.0; 4]; 16];
    set.blend(&n, &mut blended);
    assert!(blended.iter().all(|t| *t == [0.0; 4]));
    assert_eq!(set.lookup(&n, Vec3::X), [0.0; 4]);
    // A normal that is not finite leaves the weights finite.
    let n = index.query(Vec3::Z, Vec3::NAN, &set, &plain(8));
    assert!((n.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
}

/// Goal (hard case 22): a probe inside a body sees nothing but its inside; a point outside loses it to the visible ones.
#[test]
fn case_22_probe_inside_geometry() {
    let mut cloud = empty();
    ball(&mut cloud, Vec3::ZERO, 0.5, 4000, Vec3::ONE);
    let tracer = tracer(&cloud);
    let normals = fibonacci(400);
    let points = OrientedPoints { positions: normals.iter().map(|n| 0.5 * *n).collect(), normals };
    let config = ProbeConfig { count: 400, ..ProbeConfig::default() };
    let mut set = place(&points, &config, 1.0).unwrap();
    // One probe has gone astray: below the surface, and nearest to a point of it.
    let lost = 17;
    let outwards = set.normals[lost];
    set.positions[lost] = 0.48 * outwards;
    bake(&tracer, &mut set, 1, BakeObserver::silent()).unwrap();
    assert!(set.texture(lost).iter().all(|t| t[3] > 0.9), "the inside is closed");
    let (x, up) = (0.5 * outwards, outwards);
    let index = set.index(&config);
    let occlusion = |visibility| {
        let lookup = LookupConfig { visibility, ..LookupConfig::new(&set, &config) };
        let n = index.query(x, up, &set, &lookup);
        let weight = n.iter().filter(|(p, _)| *p == lost).map(|(_, w)| w).sum::<f32>();
        (set.lookup(&n, up)[3], weight)
    };
    let (without, chebyshev) = (occlusion(VisibilityWeight::None), occlusion(VisibilityWeight::Chebyshev));
    // It hides behind the surface: Eq. 11 leaves it 0.01 of its weight, which distance makes up for in part.
    assert!(chebyshev.1 < 0.2 * without.1 && chebyshev.0 < 0.01, "{without:?} {chebyshev:?}");
    assert!(without.1 > 0.0);
}

/// Leaks are at least this much smaller with the Chebyshev weight where the offset is not 0; measured: 280 to 1100
/// (`examples/thin_wall.rs`).
const CHEBYSHEV_GAIN: f64 = 50.0;

/// Goal (hard case 22): through a wall thinner than the probes are apart, with offsets of 1 % and 2 %, the paper's weights leak
/// and Chebyshev's do not; nothing that is visible is lost.
#[test]
fn case_22_thin_wall() {
    for thickness in [0.005, 0.02] {
        for offset in [0.01, 0.02] {
            let with = |visibility| {
                let config = ProbeConfig { count: 500, offset, visibility, ..ProbeConfig::default() };
                wall::leak(&config, thickness, 1, |_| ())
            };
            let (paper, ours) = (with(VisibilityWeight::None), with(VisibilityWeight::Chebyshev));
            let case = format!("thickness {thickness}, offset {offset}: {paper:?} {ours:?}");
            assert!(paper.occlusion > 0.05 && paper.radiance > 0.05, "{case}");
            assert!(ours.occlusion * CHEBYSHEV_GAIN < paper.occlusion, "{case}");
            assert!(ours.radiance * CHEBYSHEV_GAIN < paper.radiance, "{case}");
            assert!(ours.weight < 0.01 && ours.lost < 0.01, "{case}");
        }
    }
}

/// Goal (hard case 22): probes on the surface itself (offset 0) stand among the surfels and see them: occlusion is wrong with and
/// without visibility, which is why there is an offset. Where all are hidden, the weights say little: the leak is halved, no more.
#[test]
fn case_22_no_offset() {
    let with = |visibility| {
        let config = ProbeConfig { count: 500, offset: 0.0, visibility, ..ProbeConfig::default() };
        wall::leak(&config, 0.02, 1, |_| ())
    };
    let (paper, ours) = (with(VisibilityWeight::None), with(VisibilityWeight::Chebyshev));
    assert!(paper.occlusion > 0.5 && ours.occlusion > 0.5, "{paper:?} {ours:?}");
    assert!(ours.radiance < 0.7 * paper.radiance, "{paper:?} {ours:?}");
}

/// Goal (hard case 22): on an open surface, from without and from within, the visibility weight leaves what is visible alone.
#[test]
fn case_22_visible_probes_keep_their_weight() {
    let mut cloud = empty();
    ball(&mut cloud, Vec3::ZERO, 0.5, 8000, Vec3::ONE);
    let tracer = tracer(&cloud);
    for side in [1.0, -1.0] {
        let directions = fibonacci(5000);
        let points = OrientedPoints {
            positions: directions.iter().map(|d| 0.5 * *d).collect(),
            normals: directions.iter().map(|d| side * *d).collect(),
        };
        let config = ProbeConfig { count: 500, ..ProbeConfig::default() };
        let set = baked(&points, &tracer, &config, 1.0, 1);
        let index = set.index(&config);
        let chebyshev = LookupConfig::new(&set, &config);
        let plain = LookupConfig { visibility: VisibilityWeight::None, ..chebyshev.clone() };
        let (mut dimmed, mut all) = (0, 0);
        for d in fibonacci(1777) {
            let [a, b] = [&chebyshev, &plain].map(|c| index.query(0.5 * d, side * d, &set, c));
            for k in 0..a.count as usize {
                all += 1;
                dimmed += usize::from(a.weights[k] < 0.9 * b.weights[k]);
            }
        }
        assert!(all > 8 * 1700 && dimmed * 200 < all, "side {side}: {dimmed} of {all}");
    }
}

/// Goal (hard case 23): blend, then sample equals sample, then blend to rounding, for every number of neighbours and all kinds of
/// directions.
#[test]
fn case_23_the_order_does_not_matter() {
    let set = random_set(200, 16, 11);
    let index = ProbeIndex::new(&set.positions, 0.7);
    let mut rng = Rng::new(12);
    let mut blended = vec![[0.0; 4]; set.texture_len()];
    let mut counts = [0; 17];
    for k in 0..340 {
        let config = LookupConfig { visibility: VisibilityWeight::Chebyshev, ..plain(1 + k % 16) };
        let n = index.query(direction(&mut rng) * rng.uniform(), direction(&mut rng), &set, &config);
        counts[n.count as usize] += 1;
        set.blend(&n, &mut blended);
        for d in fibonacci(60).into_iter().chain(awkward_directions()) {
            let (a, b) = (sample(&blended, 16, d), set.lookup(&n, d));
            for c in 0..4 {
                assert!((a[c] - b[c]).abs() < ROUNDING, "{d}: {a:?} {b:?}");
            }
        }
    }
    assert!(counts[1..].iter().all(|c| *c > 0), "every count occurs: {counts:?}");
}

/// Occlusion of a probe at the origin, over the sphere.
fn occluded_share(cloud: &SurfelCloud, rays: usize) -> (f64, ProbeSet) {
    let mut set = set_at(&[Vec3::ZERO]);
    set.resolution = 16;
    set.texels = vec![[0.0; 4]; 256];
    set.moments = vec![[1.5, 2.25]; 256];
    bake(&tracer(cloud), &mut set, rays, BakeObserver::silent()).unwrap();
    let angles = octahedral::solid_angles(16);
    let sum: f64 = set.texels.iter().zip(&angles).map(|(t, a)| f64::from(t[3] * a)).sum();
    (sum / (4.0 * std::f64::consts::PI), set)
}

/// Goal (hard case 24): a plane beneath a probe hides the solid angle of its rectangle, and every direction at 30°
/// and more below the horizon (two texels); as far above it, nothing.
#[test]
fn case_24_plane() {
    let mut cloud = empty();
    let (half, height) = (5.0f32, 0.3f32);
    rectangle(&mut cloud, -height * Vec3::Z, half * Vec3::X, half * Vec3::Y, 100, Vec3::ONE);
    let (share, set) = occluded_share(&cloud, 64);
    // 4 atan(a b / (h √(a² + b² + h²))) of 4π.
    let expected = (half * half / (height * (2.0 * half * half + height * height).sqrt())).atan() / PI;
    // 64 rays in a texel of 13° resolve the rectangle's edge, 3° below the horizon, to a degree: 0.009 of the sphere.
    assert!((share - f64::from(expected)).abs() < 0.01, "{share} {expected}");
    let neighbours = ProbeIndex::new(&set.positions, 1.0).query(Vec3::ZERO, Vec3::Z, &set, &plain(1));
    for d in fibonacci(500) {
        let o = set.lookup(&neighbours, d)[3];
        if d.z < -0.5 {
            // 1.5 % pass between the surfels.
            assert!(o > 0.97, "{d}: {o}");
        } else if d.z > 0.5 {
            assert_eq!(o, 0.0, "{d}");
        }
    }
}

/// Goal (hard case 24): inside a hemisphere half of the sphere is hidden, and the distance moments are those of its
/// radius; beyond it, those of escape.
#[test]
fn case_24_hemisphere() {
    let mut cloud = empty();
    let scale = 0.0125;
    for d in fibonacci(40_000).into_iter().filter(|d| d.z > 0.0) {
        push(&mut cloud, d, -d, scale, 0.95, Vec3::ONE);
    }
    let (share, set) = occluded_share(&cloud, 64);
    // The rim's surfels reach beyond the equator by up to their radius of 3.3 scales, a band of half of this share.
    assert!((-0.005..1.65 * f64::from(scale)).contains(&(share - 0.5)), "{share}");
    for (i, (texel, moments)) in set.texels.iter().zip(&set.moments).enumerate() {
        let z = octahedral::texel_direction(i % 16, i / 16, 16).z;
        if z > 0.3 {
            // Up to 1.2 % pass between the surfels.
            assert!((texel[3] - 1.0).abs() < 0.02, "{i}: {texel:?}");
            // Radius 1, far 1.5; surfels are flat, so they lie up to 0.3 % within.
            assert!((moments[0] - 1.0).abs() < 0.01 && (moments[1] - 1.0).abs() < 0.02, "{moments:?}");
        } else if z < -0.3 {
            let off = (moments[0] - 1.5).abs().max((moments[1] - 2.25).abs());
            assert!(texel[3] == 0.0 && off < 1e-5, "{i}: {texel:?} {moments:?}");
        }
    }
}

/// Goal (hard case 24): a ball at a distance hides a cap of half angle asin(r / d), whichever way it lies; occlusion baked alone
/// is the same and keeps the moments.
#[test]
fn case_24_sphere_at_a_distance() {
    for (centre, radius) in [(Vec3::new(0.0, 0.0, -2.0), 0.7f32), (Vec3::new(1.0, -1.2, 0.5), 0.8)] {
        let mut cloud = empty();
        ball(&mut cloud, centre, radius, 6000, Vec3::ONE);
        let (share, set) = occluded_share(&cloud, 16);
        let expected = f64::from(0.5 * (1.0 - (1.0 - radius * radius / centre.length_squared()).sqrt()));
        // Texels lose what lies between 16 rays; surfels at the limb stand out of the ball by 0.5 % of its radius.
        assert!((share / expected - 1.0).abs() < 0.05, "{share} {expected}");
        let mut alone = set.clone();
        bake_occlusion(&tracer(&cloud), &mut alone, 16, BakeObserver::silent()).unwrap();
        assert_eq!(alone.moments, set.moments);
        for (a, b) in alone.texels.iter().zip(&set.texels) {
            assert!(a[..3] == [0.0; 3] && (a[3] - b[3]).abs() < 2e-4, "{a:?} {b:?}");
        }
    }
}

/// Goal: a stopped bake says how far it got and leaves the set as it was; progress reaches every probe.
#[test]
fn a_stopped_bake_changes_nothing() {
    let mut cloud = empty();
    rectangle(&mut cloud, Vec3::ZERO, Vec3::X, Vec3::Y, 20, Vec3::ONE);
    let tracer = tracer(&cloud);
    let mut points = OrientedPoints::default();
    rectangle_points(&mut points, Vec3::ZERO, Vec3::X, Vec3::Y, 10);
    let mut set = place(&points, &ProbeConfig { count: 100, ..ProbeConfig::default() }, 2.0).unwrap();
    let before = set.clone();
    let finished = std::sync::atomic::AtomicUsize::new(0);
    let progress = |n: usize| {
        finished.fetch_max(n, std::sync::atomic::Ordering::Relaxed);
    };
    let stop = || finished.load(std::sync::atomic::Ordering::Relaxed) >= 16;
    let observer = BakeObserver { cancelled: &stop, progress: &progress };
    let error = bake(&tracer, &mut set, 1, observer).unwrap_err();
    assert!(
        matches!(error, ProbeError::Cancelled { done, total: 100 } if (16..100).contains(&done)),
        "{error}"
    );
    assert_eq!(set, before);
    let observer = BakeObserver { cancelled: &|| false, progress: &progress };
    bake(&tracer, &mut set, 1, observer).unwrap();
    assert_eq!(finished.into_inner(), 100);
    assert_ne!(set, before);
    // FRAC_1_SQRT_2 from the plane, seen from its middle: below is hidden, above is free.
    let down = Vec3::new(FRAC_1_SQRT_2, 0.0, -FRAC_1_SQRT_2);
    let middle = set.index(&ProbeConfig::default()).query(Vec3::ZERO, Vec3::Z, &set, &plain(4));
    assert!(set.lookup(&middle, down)[3] > 0.95 && set.lookup(&middle, -down)[3] < 0.05);
}
