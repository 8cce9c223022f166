//! Index, weights and gradients against brute force in f64.

use crate::round::fibonacci;
use crate::support::direction;
use comgs_geom::Rng;
use comgs_probe::{
    LookupConfig, Neighbours, OrientedPoints, ProbeConfig, ProbeIndex, ProbeSet, VisibilityWeight, place,
    reference, sample_vjp,
};
use glam::Vec3;

/// Probes on a sphere, some of them twice, some in a clump, one far away; with random textures and moments that hide
/// about half of what is around.
fn awkward_set(resolution: usize, seed: u64) -> ProbeSet {
    let mut rng = Rng::new(seed);
    let mut positions: Vec<Vec3> = fibonacci(600).iter().map(|d| *d * rng.range(0.9, 1.1)).collect();
    positions.extend((0..100).map(|_| Vec3::X + 0.01 * Vec3::new(rng.normal(), rng.normal(), rng.normal())));
    positions.extend_from_within(40..60);
    positions.push(Vec3::new(40.0, -3.0, 2.0));
    let normals = positions.iter().map(|p| p.normalize()).collect();
    let texels = positions.len() * resolution * resolution;
    let far = 0.6;
    ProbeSet {
        normals,
        resolution,
        texels: (0..texels).map(|_| [rng.uniform(), rng.uniform(), rng.uniform(), rng.uniform()]).collect(),
        moments: (0..texels)
            .map(|_| {
                let distance = far * rng.uniform();
                [distance, distance * distance * rng.range(1.0, 1.3)]
            })
            .collect(),
        spacing: 0.15,
        far_distance: far,
        positions,
    }
}

fn points(n: usize, seed: u64) -> (Vec<Vec3>, Vec<Vec3>) {
    let mut rng = Rng::new(seed);
    (0..n)
        .map(|i| {
            let d = direction(&mut rng);
            let reach = [1.0, 1.0, 1.3, 3.0][i % 4];
            (d * reach * rng.range(0.95, 1.05), (d + 0.3 * direction(&mut rng)).normalize())
        })
        .unzip()
}

/// Weights in f32: a few roundings of values that are differences of coordinates of size 1 over distances of 0.01.
const WEIGHT: f64 = 2e-4;

/// Goal: the same probes in the same order and the same weights as brute force in f64, for every K, for radii from a
/// tenth of the spacing to the whole set, with and without visibility, with duplicates, clumps and an outlier.
#[test]
fn queries_agree_with_brute_force() {
    let set = awkward_set(8, 1);
    let (xs, normals) = points(160, 2);
    let mut several = 0;
    for radius in [0.015f32, 0.2, 0.4, 3.0, 100.0] {
        let index = ProbeIndex::new(&set.positions, radius);
        assert_eq!(index.len(), set.len());
        for (neighbours, visibility) in [
            (1, VisibilityWeight::None),
            (8, VisibilityWeight::Chebyshev),
            (16, VisibilityWeight::Chebyshev),
            (5, VisibilityWeight::None),
        ] {
            let config = LookupConfig {
                neighbours,
                visibility,
                min_distance: 1e-3,
                min_deviation: 0.02,
                normal_bias: 0.03,
                visibility_floor: 1e-3,
            };
            let batch = index.query_batch(&xs, &normals, &set, &config);
            for ((x, normal), got) in xs.iter().zip(&normals).zip(&batch) {
                let (x64, n64) = (x.as_dvec3(), normal.as_dvec3());
                let expected = reference::neighbours(&set, radius.into(), &config, x64, n64);
                let probes: Vec<usize> = got.iter().map(|(p, _)| p).collect();
                assert_eq!(probes, expected.iter().map(|(p, _)| *p).collect::<Vec<_>>(), "{x} {radius}");
                for ((_, got), (_, expected)) in got.iter().zip(&expected) {
                    assert!((f64::from(got) - expected).abs() < WEIGHT, "{x}: {got} {expected}");
                }
                assert!((got.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                several += usize::from(got.count > 1);
            }
        }
    }
    assert!(several > 1000, "{several}");
}

/// Goal: positions that are not finite are never found, and do not hide the others.
#[test]
fn positions_that_are_not_finite() {
    let mut set = awkward_set(2, 3);
    set.positions[5] = Vec3::NAN;
    set.positions[100] = Vec3::NEG_INFINITY;
    let index = ProbeIndex::new(&set.positions, 0.3);
    assert_eq!(index.len(), set.len() - 2);
    let config = LookupConfig { visibility: VisibilityWeight::None, ..lookup(8) };
    let (xs, normals) = points(50, 4);
    for (x, normal) in xs.iter().zip(&normals) {
        let got: Vec<usize> = index.query(*x, *normal, &set, &config).iter().map(|(p, _)| p).collect();
        let expected = reference::neighbours(&set, 0.3f32.into(), &config, x.as_dvec3(), normal.as_dvec3());
        assert_eq!(got, expected.iter().map(|(p, _)| *p).collect::<Vec<_>>());
    }
}

fn lookup(neighbours: usize) -> LookupConfig {
    LookupConfig {
        neighbours,
        visibility: VisibilityWeight::Chebyshev,
        min_distance: 1e-3,
        min_deviation: 0.02,
        normal_bias: 0.03,
        visibility_floor: 1e-3,
    }
}

/// Shading points that share probes, and what a loss makes of their lookups: Σ g · lookup over points and directions.
struct Batch {
    neighbours: Vec<Neighbours>,
    exact: Vec<Vec<(usize, f64)>>,
    directions: Vec<Vec<Vec3>>,
    grads: Vec<Vec<[f32; 4]>>,
}

impl Batch {
    fn new(set: &ProbeSet, n: usize) -> Self {
        let mut rng = Rng::new(7);
        let (xs, normals) = points(n, 8);
        let index = ProbeIndex::new(&set.positions, 0.4);
        let config = lookup(7);
        let mut special = vec![Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::NEG_Y, Vec3::new(1.0, -1.0, 0.0)];
        special.extend((0..9).map(|_| direction(&mut rng)));
        Self {
            neighbours: index.query_batch(&xs, &normals, set, &config),
            exact: xs
                .iter()
                .zip(&normals)
                .map(|(x, n)| reference::neighbours(set, 0.4f32.into(), &config, x.as_dvec3(), n.as_dvec3()))
                .collect(),
            directions: vec![special.clone(); n],
            grads: (0..n)
                .map(|_| special.iter().map(|_| std::array::from_fn(|_| rng.normal())).collect())
                .collect(),
        }
    }

    fn loss(&self, set: &ProbeSet) -> f64 {
        let mut sum = 0.0;
        for ((exact, directions), grads) in self.exact.iter().zip(&self.directions).zip(&self.grads) {
            for (d, g) in directions.iter().zip(grads) {
                let value = reference::lookup(set, exact, d.as_dvec3());
                sum += (0..4).map(|c| f64::from(g[c]) * value[c]).sum::<f64>();
            }
        }
        sum
    }

    fn gradient(&self, set: &ProbeSet) -> Vec<[f32; 4]> {
        let texture = set.texture_len();
        let mut blended = vec![[0.0; 4]; self.neighbours.len() * texture];
        for ((grad, directions), grads) in
            blended.chunks_exact_mut(texture).zip(&self.directions).zip(&self.grads)
        {
            for (d, g) in directions.iter().zip(grads) {
                sample_vjp(set.resolution, *d, *g, grad);
            }
        }
        let mut out = vec![[0.0; 4]; set.texels.len()];
        set.blend_vjp(&self.neighbours, &blended, &mut out);
        out
    }
}

/// Goal: the gradient of sampling and blending is that of central differences of the f64 reference, at texels of
/// probes that many points share and at those that none uses; it is not all zero.
#[test]
fn gradient_agrees_with_finite_differences() {
    let mut set = awkward_set(5, 5);
    let batch = Batch::new(&set, 60);
    let gradient = batch.gradient(&set);
    let touched: Vec<usize> = (0..gradient.len()).filter(|&i| gradient[i] != [0.0; 4]).collect();
    assert!(touched.len() > 1000 && touched.len() < gradient.len() - 1000, "{}", touched.len());
    let step = 0.125f32;
    for k in 0..80 {
        // The odd ones are mostly untouched.
        let i = if k % 2 == 0 { touched[k * 37 % touched.len()] } else { k * 9973 % gradient.len() };
        let c = k % 4;
        let kept = set.texels[i][c];
        set.texels[i][c] = kept + step;
        let up = batch.loss(&set);
        // What f32 made of the steps.
        let (high, low) = (set.texels[i][c], kept - step);
        set.texels[i][c] = low;
        let down = batch.loss(&set);
        set.texels[i][c] = kept;
        let expected = (up - down) / f64::from(high - low);
        let got = f64::from(gradient[i][c]);
        // The sums are over up to 60 points with gradients of size 1 and weights that agree to WEIGHT.
        assert!(
            (got - expected).abs() < 2e-3 * expected.abs() + 2e-4,
            "texel {i}: {got}, expected {expected}"
        );
    }
}

/// Goal: ⟨J t, g⟩ = ⟨t, Jᵀ g⟩, and both functions add to what is there.
#[test]
fn gradient_is_the_adjoint() {
    let set = awkward_set(16, 6);
    let batch = Batch::new(&set, 100);
    let gradient = batch.gradient(&set);
    let inner: f64 = gradient
        .iter()
        .zip(&set.texels)
        .map(|(g, t)| (0..4).map(|c| f64::from(g[c]) * f64::from(t[c])).sum::<f64>())
        .sum();
    let forward: f64 = batch
        .neighbours
        .iter()
        .zip(&batch.directions)
        .zip(&batch.grads)
        .map(|((n, directions), grads)| {
            let one = |(d, g): (&Vec3, &[f32; 4])| {
                let v = set.lookup(n, *d);
                (0..4).map(|c| f64::from(g[c]) * f64::from(v[c])).sum::<f64>()
            };
            directions.iter().zip(grads).map(one).sum::<f64>()
        })
        .sum();
    // 5600 terms of size 1 that cancel in part.
    assert!((inner - forward).abs() < 1e-3, "{inner} {forward}");
    assert!(forward.abs() > 1.0, "{forward}");

    let texture = set.texture_len();
    let ones = vec![[1.0; 4]; texture];
    let mut out = vec![[3.0; 4]; set.texels.len()];
    set.blend_vjp(&batch.neighbours[..1], &ones, &mut out);
    for (probe, weight) in batch.neighbours[0].iter() {
        assert!((out[probe * texture][2] - 3.0 - weight).abs() < 1e-6);
    }
    let mut texels = vec![[2.0; 4]; texture];
    sample_vjp(16, Vec3::new(0.2, -0.7, -0.4), [1.0, -1.0, 0.0, 4.0], &mut texels);
    let added: f32 = texels.iter().map(|t| t[3] - 2.0).sum();
    assert!((added - 4.0).abs() < 1e-5 && texels.iter().all(|t| t[2] == 2.0));
}

/// Goal: probes cover a surface at the spacing that they state, at the offset asked for, and the radius holds more than
/// K of them; too few points, single points and unusable ones are survived or refused.
#[test]
fn placement() {
    let mut rng = Rng::new(9);
    let normals: Vec<Vec3> = (0..20_000).map(|_| direction(&mut rng)).collect();
    let points = OrientedPoints { positions: normals.clone(), normals };
    let config = ProbeConfig { count: 1000, ..ProbeConfig::default() };
    let set = place(&points, &config, 2.0).unwrap();
    assert_eq!(set.len(), 1000);
    assert!(set.problems().is_empty(), "{:?}", set.problems());
    for (p, n) in set.positions.iter().zip(&set.normals) {
        assert!((p.length() - 1.02).abs() < 1e-5 && p.normalize().dot(*n) > 0.999_99);
    }
    // 1000 discs as far apart as the spacing: between the densest packing and half of it.
    let share = 1000.0 * set.spacing * set.spacing / (4.0 * std::f32::consts::PI);
    assert!((0.5..1.16).contains(&share), "{share}");
    let index = set.index(&config);
    let lookup = LookupConfig::new(&set, &config);
    assert!(fibonacci(500).iter().all(|d| index.query(*d, *d, &set, &lookup).count == 8));

    let one = OrientedPoints { positions: vec![Vec3::ONE; 4], normals: vec![Vec3::Z; 4] };
    let set = place(&one, &config, 2.0).unwrap();
    assert_eq!((set.len(), set.spacing), (1, 2.0));
    assert_eq!(set.index(&config).query(Vec3::ZERO, Vec3::Z, &set, &lookup).weights[0], 1.0);
    let bad = OrientedPoints { positions: vec![Vec3::NAN, Vec3::X], normals: vec![Vec3::Z, Vec3::ZERO] };
    assert!(place(&bad, &config, 2.0).unwrap_err().to_string().contains("none of the 2 points"));
    for size in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(place(&one, &config, size).is_err());
    }
    assert!(place(&one, &ProbeConfig { count: 0, ..config }, 1.0).is_err());
}
