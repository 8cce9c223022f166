//! The octahedral light against integrals by brute force, its sampler against its density, and its gradients.

use comgs_geom::{Rng, equirect, octahedral, sampling};
use comgs_image::Image;
use comgs_light::{
    EnvReport, EnvironmentMap, Importance, LightPyramid, OctahedralError, OctahedralLight, OctahedralSampler,
    luminance,
};
use glam::{DVec3, Vec2, Vec3};
use std::f64::consts::PI;

fn unit(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

fn numbers(rng: &mut Rng) -> Vec2 {
    Vec2::new(rng.uniform(), rng.uniform())
}

/// Over five decades, with black texels in between.
fn random_light(size: usize, seed: u64) -> OctahedralLight {
    let mut rng = Rng::new(seed);
    let texels = (0..size * size)
        .flat_map(|_| {
            let black = rng.below(4) == 0;
            [0; 3].map(|_| if black { 0.0 } else { 10.0f32.powf(rng.range(-3.0, 2.0)) })
        })
        .collect();
    OctahedralLight::from_texels(size, texels).unwrap()
}

/// ∫ of a function of direction over the sphere, on an equirectangular grid of `2 rows × rows`.
fn brute_force(rows: usize, f: impl Fn(Vec3) -> Vec3) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for row in 0..rows {
        let omega = f64::from(equirect::texel_solid_angle(row, 2 * rows, rows));
        for column in 0..2 * rows {
            sum += omega * f(equirect::texel_direction(column, row, 2 * rows, rows)).as_dvec3();
        }
    }
    sum
}

/// Largest difference from 1 of the components of `a / b`.
fn apart(a: DVec3, b: DVec3) -> f64 {
    (a / b - 1.0).abs().max_element()
}

/// Goal: texels are checked as an environment's are, and shapes are named.
#[test]
fn unusable_texels() {
    let mut texels = vec![1.0f32; 12];
    assert!(OctahedralLight::from_texels(2, texels.clone()).is_ok());
    (texels[0], texels[5], texels[7], texels[8]) = (f32::NAN, f32::INFINITY, -1.0, f32::NEG_INFINITY);
    let report = EnvReport { nan: 1, infinite: 1, negative: 2 };
    assert_eq!(OctahedralLight::from_texels(2, texels.clone()), Err(OctahedralError::Samples(report)));
    let error = OctahedralLight::from_texels(3, texels).unwrap_err();
    assert_eq!(error.to_string(), "an octahedral map of 3×3 has 27 values, got 12");
    assert!(OctahedralLight::from_texels(0, Vec::new()).is_err());
    assert!(OctahedralLight::constant(2, Vec3::new(f32::NAN, -1.0, f32::INFINITY)).is_black());
}

/// Goal: the integral is that of the interpolated radiance, of smooth maps and of every single hot texel.
#[test]
fn integrals() {
    let constant = OctahedralLight::constant(16, Vec3::new(1.0, 0.5, 2.0));
    let expected = 4.0 * PI * DVec3::new(1.0, 0.5, 2.0);
    assert!(apart(constant.integral().as_dvec3(), expected) < 1e-6);
    assert!((constant.mean() - Vec3::new(1.0, 0.5, 2.0)).length() < 1e-5);
    for (size, seed) in [(1, 1), (5, 2), (32, 3)] {
        let light = random_light(size, seed);
        let light = if light.is_black() { OctahedralLight::constant(size, Vec3::ONE) } else { light };
        let exact = brute_force(1024, |d| light.radiance(d));
        assert!(apart(light.integral().as_dvec3(), exact) < 1e-4, "{size}: {} {exact}", light.integral());
    }
    // Beside the poles, on a fold, at a corner, in the middle of a face.
    for texel in [7 * 16 + 7, 3 * 16 + 4, 0, 15 * 16, 11 * 16 + 10] {
        let mut texels = vec![0.0; 16 * 16 * 3];
        texels[3 * texel..3 * texel + 3].fill(1.0);
        let light = OctahedralLight::from_texels(16, texels).unwrap();
        let exact = brute_force(1024, |d| light.radiance(d));
        assert!(apart(light.integral().as_dvec3(), exact) < 1e-3, "{texel}: {} {exact}", light.integral());
    }
}

/// ∫ L max(0, n · ω) dω.
fn irradiance(rows: usize, normal: Vec3, radiance: impl Fn(Vec3) -> Vec3) -> DVec3 {
    brute_force(rows, |d| radiance(d) * normal.dot(d).max(0.0))
}

/// Goal: from an equirectangular map and back no light is lost (10⁻⁵), and it stays where it was: the irradiance of
/// every normal is that of the source, for maps finer and coarser than the octahedral one, turned ones, and one with
/// a sun of a single texel.
#[test]
fn resampling_conserves_light() {
    let mut rng = Rng::new(4);
    let mut sky = Image::zeros(256, 128, 3);
    for (i, pixel) in sky.data.chunks_exact_mut(3).enumerate() {
        let d = equirect::texel_direction(i % 256, i / 256, 256, 128);
        pixel.copy_from_slice(&(Vec3::splat(1.0) + 0.5 * d + 0.3 * Vec3::splat(d.x * d.y)).to_array());
    }
    let mut sunny = sky.clone();
    sunny.pixel_mut(40, 45).fill(2e4);
    let coarse: Vec<f32> = (0..6 * 16).map(|_| rng.uniform()).collect();
    let maps = [
        EnvironmentMap::from_image(&sky).unwrap().turned(0.7),
        EnvironmentMap::from_image(&sunny).unwrap(),
        EnvironmentMap::from_image(&Image::from_data(8, 4, 3, coarse)).unwrap().turned(2.0),
    ];
    for (i, map) in maps.iter().enumerate() {
        let light = OctahedralLight::from_environment(map, 64);
        assert_eq!(light.size(), 64);
        let (before, after) = (map.integral().as_dvec3(), light.integral().as_dvec3());
        assert!(apart(after, before) < 1e-5, "{i}: {before} {after}");
        let back = light.to_environment(64);
        assert!(apart(back.integral().as_dvec3(), before) < 1e-5, "{i}: {} {before}", back.integral());
        for normal in [Vec3::Z, -Vec3::Z, Vec3::X, unit(&mut rng), unit(&mut rng), unit(&mut rng)] {
            let exact = map.irradiance(normal).as_dvec3();
            for (way, got) in [
                ("there", irradiance(256, normal, |d| light.radiance(d))),
                ("and back", back.irradiance(normal).as_dvec3()),
            ] {
                // Blur by a texel moves a sun at the horizon by a part of its 3°; elsewhere nothing.
                assert!(apart(got, exact) < 0.01, "{i}, {normal}, {way}: {got} {exact}");
            }
        }
    }
    let constant = OctahedralLight::from_environment(&EnvironmentMap::constant(Vec3::splat(0.7)), 32);
    assert!(constant.texels().iter().all(|v| (v - 0.7).abs() < 1e-6));
    let back = constant.to_environment(16);
    assert!(back.image().data.iter().all(|v| (v - 0.7).abs() < 1e-6));
    assert!(OctahedralLight::from_environment(&EnvironmentMap::constant(Vec3::ZERO), 8).is_black());
    assert!(
        constant
            .clone()
            .scaled(Vec3::new(2.0, 0.0, 1.0))
            .texel(3)
            .abs_diff_eq(Vec3::new(1.4, 0.0, 0.7), 1e-5)
    );
}

/// Goal (hard case 28): χ² of a histogram of samples against the density integrated over cells that are not the
/// texels; the density integrates to 1.
#[test]
fn histogram_matches_the_density() {
    for (light, seed) in [(random_light(7, 5), 6), (random_light(8, 7), 8), (random_light(1, 20), 9)] {
        let sampler = OctahedralSampler::new(&light, Importance::Exact);
        let (columns, rows, fine, count) = (20usize, 10usize, 50usize, 200_000);
        let mut histogram = vec![0.0f64; columns * rows];
        let mut rng = Rng::new(seed);
        for _ in 0..count {
            let (u, v) = equirect::uv_from_direction(sampler.sample(numbers(&mut rng)).direction);
            let (row, column) = ((v * rows as f32) as usize, (u * columns as f32) as usize);
            histogram[row.min(rows - 1) * columns + column] += 1.0;
        }
        let mut expected = vec![0.0f64; columns * rows];
        for y in 0..rows * fine {
            let omega = equirect::texel_solid_angle(y, columns * fine, rows * fine);
            for x in 0..columns * fine {
                let d = equirect::texel_direction(x, y, columns * fine, rows * fine);
                expected[y / fine * columns + x / fine] +=
                    f64::from(count) * f64::from(sampler.pdf(d) * omega);
            }
        }
        let total = expected.iter().sum::<f64>() / f64::from(count);
        assert!((total - 1.0).abs() < 1e-3, "the density integrates to 1: {total}");
        let (mut chi, mut cells) = (0.0, 0.0);
        for (o, e) in histogram.iter().zip(&expected) {
            if *e > 5.0 {
                chi += (o - e).powi(2) / e;
                cells += 1.0;
            } else {
                assert!(*o < 30.0, "{o} samples where {e} are expected");
            }
        }
        // Mean of χ² is the number of cells, its deviation √(2 cells); six of them is one run in 10⁸.
        assert!(chi < cells + 6.0 * (2.0f64 * cells).sqrt(), "χ² {chi} over {cells} cells");
    }
}

/// Goal: what a sample says of itself is what the light and the density say of its direction; extreme random numbers
/// are survived; the estimator converges to the integral and the irradiance.
#[test]
fn samples_are_consistent() {
    for light in [random_light(16, 10), random_light(5, 11), random_light(64, 12)] {
        let sampler = OctahedralSampler::new(&light, Importance::Exact);
        assert_eq!(sampler.light(), &light);
        let mut rng = Rng::new(13);
        for i in 0..20_000 {
            let ends = [0.0, f32::MIN_POSITIVE, 0.5, 1.0 - f32::EPSILON / 2.0];
            let u = if i < 16 { Vec2::new(ends[i % 4], ends[i / 4]) } else { numbers(&mut rng) };
            let s = sampler.sample(u);
            assert!((s.direction.length() - 1.0).abs() < 1e-5 && s.pdf > 0.0 && s.pdf.is_finite());
            assert_eq!(s.radiance, light.radiance(s.direction));
            assert!(sampler.pdf(s.direction) <= s.pdf);
        }
        let normal = Vec3::new(0.48, 0.6, 0.64);
        let n = 1 << 16;
        let (mut integral, mut on_surface) = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..n {
            let s = sampler.sample(sampling::hammersley(i, n, Vec2::new(0.2, 0.9)));
            let value = (s.radiance / s.pdf).as_dvec3() / f64::from(n);
            integral += value;
            on_surface += value * f64::from(normal.dot(s.direction).max(0.0));
        }
        assert!(apart(integral, light.integral().as_dvec3()) < 0.01, "{integral}");
        let exact = irradiance(512, normal, |d| light.radiance(d));
        assert!(apart(on_surface, exact) < 0.01, "{on_surface} {exact}");
    }
}

/// Goal: Eq. 18 is the paper's: a texel by its share of the luminance, the density `H W I / 4π`. What it costs: a lamp
/// at the zenith counts for 3 times what it is, one in the middle of an octant for 0.6 times; the exact table has
/// neither.
#[test]
fn the_papers_density_and_its_bias() {
    let light = random_light(16, 14);
    let total: f32 = (0..256).map(|t| luminance(light.texel(t))).sum();
    let sampler = OctahedralSampler::new(&light, Importance::EqualArea);
    let mut rng = Rng::new(15);
    let mut histogram = [0.0f64; 256];
    let count = 200_000;
    for _ in 0..count {
        let s = sampler.sample(numbers(&mut rng));
        let texel = octahedral::texel_of(s.direction, 16);
        histogram[texel] += 1.0;
        let expected = 256.0 * luminance(light.texel(texel)) / total / (4.0 * std::f32::consts::PI);
        assert!((s.pdf / expected - 1.0).abs() < 1e-4);
        assert_eq!((s.radiance, s.pdf), sampler.evaluate(s.direction));
        assert_eq!(s.pdf, sampler.pdf(s.direction));
    }
    let chi: f64 = (0..256)
        .map(|t| (histogram[t], f64::from(count) * f64::from(luminance(light.texel(t)) / total)))
        .filter(|(_, e)| *e > 5.0)
        .map(|(o, e)| (o - e).powi(2) / e)
        .sum();
    // At most 256 cells: mean 256, deviation 23.
    assert!(chi < 256.0 + 6.0 * 23.0, "χ² {chi}");

    for (at, low, high) in [(Vec3::Z, 2.9, 3.15), (Vec3::ONE, 0.59, 0.61)] {
        let mut texels = vec![0.0; 3 * 256 * 256];
        let place = octahedral::texel_of(at, 256);
        // A lamp of 5 × 5 texels, wide enough that interpolation at its rim hardly counts.
        for y in -2isize..=2 {
            for x in -2isize..=2 {
                let texel =
                    octahedral::neighbour((place % 256) as isize + x, (place / 256) as isize + y, 256);
                texels[3 * texel..3 * texel + 3].fill(100.0);
            }
        }
        let lamp = OctahedralLight::from_texels(256, texels).unwrap();
        let estimate = |importance| {
            let sampler = OctahedralSampler::new(&lamp, importance);
            let n = 4096;
            let value = |i| {
                let s = sampler.sample(sampling::hammersley(i, n, Vec2::ZERO));
                f64::from(s.radiance.x / s.pdf) / f64::from(n)
            };
            (0..n).map(value).sum::<f64>() / f64::from(lamp.integral().x)
        };
        let paper = estimate(Importance::EqualArea);
        assert!(low < paper && paper < high, "{at}: {paper}");
        let exact = estimate(Importance::Exact);
        assert!((exact - 1.0).abs() < 2e-3, "{at}: {exact}");
    }
}

/// The interpolated luminance of a direction by a way of its own in f64: the map's coordinates from angles of the
/// octahedron's faces, and a table with a one-texel border that is filled by walking over the edge.
fn reference_radiance(light: &OctahedralLight, d: DVec3) -> DVec3 {
    let n = light.size() as i64;
    let p = d / (d.x.abs() + d.y.abs() + d.z.abs());
    let (mut u, mut v) = (p.x, p.y);
    if p.z < 0.0 {
        // Mirrored on the line |x| + |y| = 1 of its quadrant.
        let (sx, sy) = (if p.x < 0.0 { -1.0 } else { 1.0 }, if p.y < 0.0 { -1.0 } else { 1.0 });
        (u, v) = (sx * (1.0 - sy * p.y), sy * (1.0 - sx * p.x));
    }
    let (x, y) = ((u + 1.0) * 0.5 * n as f64 - 0.5, (v + 1.0) * 0.5 * n as f64 - 0.5);
    let mut sum = DVec3::ZERO;
    for (column, row) in
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| (x.floor() as i64 + i, y.floor() as i64 + j))
    {
        let weight = (1.0 - (x - column as f64).abs()) * (1.0 - (y - row as f64).abs());
        // Over an edge: half a turn about the edge's middle.
        let (mut c, mut r) = (column, row);
        if c < 0 || c >= n {
            (c, r) = (if c < 0 { 0 } else { n - 1 }, n - 1 - r);
        }
        if r < 0 || r >= n {
            (c, r) = (n - 1 - c, if r < 0 { 0 } else { n - 1 });
        }
        sum += weight * light.texel((r * n + c) as usize).as_dvec3();
    }
    sum
}

/// Goal: value, gradient of the texels (adjoint identity) and gradient of the direction (central differences in f64)
/// are those of the reference; the latter has no part along the direction.
#[test]
fn gradients_match_the_reference() {
    let mut rng = Rng::new(16);
    let mut size_of_gradients = 0.0;
    for size in [1usize, 2, 5, 16] {
        let texels = (0..3 * size * size).map(|_| rng.uniform()).collect();
        let light = OctahedralLight::from_texels(size, texels).unwrap();
        for i in 0..2000 {
            let length = 10f32.powf(rng.range(-3.0, 3.0));
            let d = unit(&mut rng) * if i % 2 == 0 { 1.0 } else { length };
            let exact = reference_radiance(&light, d.as_dvec3());
            let got = light.radiance(d).as_dvec3();
            assert!((got - exact).abs().max_element() < 1e-5, "{d} in {size}: {got} {exact}");

            let grad = Vec3::new(rng.normal(), rng.normal(), rng.normal());
            let mut grad_texels = vec![0.0; light.texels().len()];
            light.radiance_vjp(d, grad, &mut grad_texels);
            let transposed: f32 = grad_texels.iter().zip(light.texels()).map(|(g, t)| g * t).sum();
            assert!((f64::from(transposed) - exact.dot(grad.as_dvec3())).abs() < 2e-5);

            let step = 1e-6 * f64::from(d.length());
            let along = |axis: DVec3| {
                let difference = reference_radiance(&light, d.as_dvec3() + step * axis)
                    - reference_radiance(&light, d.as_dvec3() - step * axis);
                difference.dot(grad.as_dvec3()) / (2.0 * step)
            };
            let expected = DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z));
            let got = light.direction_vjp(d, grad).as_dvec3();
            // In units of the direction's length; differences over a kink are left out.
            let length = f64::from(d.length());
            let p = octahedral::uv_from_direction(d) * size as f32 + 0.5;
            let on_a_line = (p - p.round()).abs().min_element() < 1e-4 * size as f32;
            if on_a_line || d.abs().min_element() < 1e-4 * d.length() {
                continue;
            }
            assert!(
                (got - expected).length() * length < 1e-3 * size as f64,
                "{d} in {size}: {got} {expected}"
            );
            assert!(got.dot(d.as_dvec3()).abs() < 1e-4 * size as f64);
            size_of_gradients += got.length() * length;
        }
    }
    assert!(size_of_gradients > 1000.0, "not all zero: {size_of_gradients}");
}

/// Sum of a pyramid's levels at every texel in f64, each level interpolated to the next by direction.
fn reference_pyramid(sizes: &[usize], levels: &[Vec<f64>]) -> Vec<f64> {
    let mut sum = levels[0].clone();
    for k in 1..sizes.len() {
        let mut next = levels[k].clone();
        for t in 0..sizes[k] * sizes[k] {
            let d = octahedral::texel_direction(t % sizes[k], t / sizes[k], sizes[k]);
            let f = octahedral::footprint(d, sizes[k - 1]);
            for (texel, weight) in f.texels.into_iter().zip(f.weights) {
                // Sixteenths, but for rounding in the direction.
                let weight = (16.0 * f64::from(weight)).round() / 16.0;
                for c in 0..3 {
                    next[3 * t + c] += weight * sum[3 * texel as usize + c];
                }
            }
        }
        sum = next;
    }
    sum
}

fn random_pyramid(size: usize, seed: u64) -> LightPyramid {
    let mut rng = Rng::new(seed);
    let mut pyramid = LightPyramid::constant(size, Vec3::new(1.0, 0.5, 2.0));
    pyramid.levels.iter_mut().flatten().for_each(|v| *v += rng.normal());
    pyramid
}

/// Goal: the pyramid's light is the exponential of the levels' sum, interpolated over the sphere, edges included.
#[test]
fn the_pyramid_is_the_sum_of_its_levels() {
    let constant = LightPyramid::constant(256, Vec3::new(1.0, 0.5, 2.0));
    assert_eq!(constant.sizes, [8, 16, 32, 64, 128, 256]);
    assert_eq!(constant.parameters(), 3 * (64 + 256 + 1024 + 4096 + 16384 + 65536));
    let light = constant.to_light();
    assert_eq!(light.size(), 256);
    assert!(
        light
            .texels()
            .chunks_exact(3)
            .all(|t| (Vec3::from_slice(t) - Vec3::new(1.0, 0.5, 2.0)).length() < 1e-5)
    );
    assert_eq!(LightPyramid::constant(20, Vec3::ONE).sizes, [10, 20]);
    assert_eq!(LightPyramid::constant(9, Vec3::ONE).sizes, [9]);
    let black = LightPyramid::constant(4, Vec3::new(0.0, -1.0, f32::INFINITY)).to_light().texel(7);
    assert_eq!(black, Vec3::new((-12f32).exp(), (-12f32).exp(), 12f32.exp()));

    for size in [20, 36, 64] {
        let pyramid = random_pyramid(size, 17);
        let levels: Vec<Vec<f64>> =
            pyramid.levels.iter().map(|l| l.iter().map(|&v| f64::from(v)).collect()).collect();
        let expected = reference_pyramid(&pyramid.sizes, &levels);
        for (got, sum) in pyramid.to_light().texels().iter().zip(expected) {
            assert!((f64::from(*got) / sum.exp() - 1.0).abs() < 1e-5, "{got} {}", sum.exp());
        }
    }
}

/// Goal: the pyramid's gradient is that of the reference in f64 (central differences), adds, and is 0 where radiance is
/// held to its range; texels beyond it do not touch the others.
#[test]
fn the_pyramids_gradient() {
    let mut rng = Rng::new(18);
    let mut pyramid = random_pyramid(36, 19);
    let last = pyramid.levels.len() - 1;
    pyramid.levels[last][100] = 40.0;
    pyramid.levels[last][200] = -40.0;
    pyramid.levels[last][300] = f32::NAN;
    let light = pyramid.to_light();
    assert!(light.texels().iter().all(|v| v.is_finite() && *v > 0.0));
    pyramid.levels[last][300] = -50.0;
    let grad: Vec<f32> = (0..light.texels().len()).map(|_| rng.normal()).collect();
    let mut got: Vec<Vec<f32>> = pyramid.levels.iter().map(|l| vec![1.0; l.len()]).collect();
    pyramid.vjp(&light, &grad, &mut got);
    let levels: Vec<Vec<f64>> =
        pyramid.levels.iter().map(|l| l.iter().map(|&v| f64::from(v)).collect()).collect();
    let objective = |levels: &[Vec<f64>]| -> f64 {
        let sum = reference_pyramid(&pyramid.sizes, levels);
        sum.iter().zip(&grad).map(|(s, g)| s.clamp(-12.0, 12.0).exp() * f64::from(*g)).sum()
    };
    let mut total = 0.0;
    for k in 0..=last {
        // Corners, edges, the centre's neighbours, and some at random.
        let (size, count) = (pyramid.sizes[k], pyramid.levels[k].len());
        let mut places = vec![0, 3 * (size - 1) + 1, count - 1, 3 * size * (size / 2), 3 * (size / 2) + 2];
        places.extend((0..40).map(|_| rng.below(count)));
        for i in places {
            let step = 1e-5;
            let (mut above, mut below) = (levels.clone(), levels.clone());
            above[k][i] += step;
            below[k][i] -= step;
            let expected = (objective(&above) - objective(&below)) / (2.0 * step);
            let g = f64::from(got[k][i]) - 1.0;
            // f32 sums of radiances of about 10, where one texel is at e¹² its clamped value adds 10⁻⁹ of rounding.
            assert!((g - expected).abs() < 1e-3 * expected.abs() + 2e-4, "level {k}, {i}: {g} {expected}");
            total += g.abs();
        }
    }
    assert!(total > 10.0, "not all zero: {total}");
    for i in [100, 200, 300] {
        assert_eq!(got[last][i], 1.0);
    }
}

/// Goal (hard case 29): the same bytes at any number of threads.
#[test]
fn deterministic_at_any_thread_count() {
    let mut sky = Image::zeros(64, 32, 3);
    let mut rng = Rng::new(21);
    sky.data.iter_mut().for_each(|v| *v = rng.uniform());
    let map = EnvironmentMap::from_image(&sky).unwrap();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let pyramid = random_pyramid(64, 22);
            let light = pyramid.to_light();
            let mut grad: Vec<Vec<f32>> = pyramid.levels.iter().map(|l| vec![0.0; l.len()]).collect();
            pyramid.vjp(&light, light.texels(), &mut grad);
            let resampled = OctahedralLight::from_environment(&map, 32);
            let back = resampled.to_environment(16);
            (light, grad, resampled, back)
        })
    };
    assert!(run(1) == run(3));
}
