//! Values and gradients against the f64 reference, at every instruction set of this machine (hard case 10).

mod common;

use comgs_geom::Rng;
use comgs_image::Image;
use comgs_raster::reference::{self, ReferenceCloud};
use comgs_raster::{
    Frame, FrameGradient, LowPass, Planes, RasterConfig, SurfelGradients, Workspace, backward, forward,
    render,
};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use common::{camera, empty, push, random_cloud};
use fearless_simd::Level;

/// The best level of this machine, its baseline, and scalar code.
fn levels() -> [Level; 3] {
    [Level::new(), Level::baseline(), Level::fallback()]
}

/// Goal: every plane equals the reference, for both colour encodings and at every instruction set.
#[test]
fn values() {
    for (seed, encoding) in [(1, ColorEncoding::Srgb), (2, ColorEncoding::Linear)] {
        let cloud = random_cloud(120, seed, encoding);
        for level in levels() {
            let config = RasterConfig { level, ..Default::default() };
            common::assert_matches_reference(&cloud, &camera(45, 37), &config, 2e-4, 0.01);
        }
    }
}

/// Goal: what is not asked for is absent, and what is asked for does not depend on what else is.
#[test]
fn planes_do_not_depend_on_each_other() {
    let cloud = random_cloud(60, 3, ColorEncoding::Srgb);
    let camera = camera(33, 20);
    let config = RasterConfig::default();
    let all = render(&cloud, &camera, Planes::ALL, &config);
    for bits in 0..16 {
        let planes =
            Planes { color: bits & 1 > 0, depth: bits & 2 > 0, normal: bits & 4 > 0, material: bits & 8 > 0 };
        let some = render(&cloud, &camera, planes, &config);
        assert_eq!(some.weight, all.weight);
        assert_eq!(some.color, if planes.color { all.color.clone() } else { None });
        assert_eq!(some.depth, if planes.depth { all.depth.clone() } else { None });
        assert_eq!(some.normal, if planes.normal { all.normal.clone() } else { None });
        assert_eq!(some.material, if planes.material { all.material.clone() } else { None });
    }
}

/// Thresholds so low that the blend is smooth to rounding: the test-only setting for finite differences.
fn smooth(low_pass: LowPass) -> RasterConfig {
    RasterConfig { alpha_min: 1e-7, transmittance_min: 0.0, low_pass, ..Default::default() }
}

fn random_gradient(width: usize, height: usize, seed: u64) -> FrameGradient {
    let mut rng = Rng::new(seed);
    let mut plane = |c: usize| {
        Some(Image::from_data(width, height, c, (0..width * height * c).map(|_| rng.normal()).collect()))
    };
    FrameGradient {
        color: plane(3),
        weight: plane(1),
        depth: plane(1),
        normal: plane(3),
        material: plane(5),
        error: None,
    }
}

/// Inner product of a gradient with a rendering of the reference.
fn loss(
    cloud: &ReferenceCloud,
    camera: &comgs_geom::Camera,
    config: &RasterConfig,
    g: &FrameGradient,
) -> f64 {
    let pixels = reference::render(cloud, camera, config);
    let mut sum = 0.0;
    for (i, p) in pixels.iter().enumerate() {
        let at =
            |plane: &Option<Image>, c: usize, k: usize| f64::from(plane.as_ref().unwrap().data[i * c + k]);
        for k in 0..3 {
            sum += at(&g.color, 3, k) * p[k] + at(&g.normal, 3, k) * p[5 + k];
        }
        sum += at(&g.weight, 1, 0) * p[3] + at(&g.depth, 1, 0) * p[4];
        for k in 0..5 {
            sum += at(&g.material, 5, k) * p[8 + k];
        }
    }
    sum
}

fn gradients(
    cloud: &SurfelCloud,
    camera: &comgs_geom::Camera,
    config: &RasterConfig,
    g: &FrameGradient,
) -> (SurfelGradients, Frame) {
    let mut workspace = Workspace::default();
    let frame = forward(cloud, camera, Planes::ALL, config, &mut workspace);
    let mut out = SurfelGradients::zeros(cloud);
    backward(cloud, camera, &frame, g, config, &mut workspace, &mut out);
    (out, frame)
}

/// Goal (hard case 10): all parameters of all surfels have the gradient that central differences of the f64 reference have. Surfels are
/// small and large, tilted, overlapping, and (with the filter) narrower than a pixel.
#[test]
fn every_parameter_against_finite_differences() {
    for (seed, low_pass) in [(11, LowPass::Sigma(0.7)), (12, LowPass::Off), (13, LowPass::Sigma(1.5))] {
        let encoding = if seed == 12 { ColorEncoding::Linear } else { ColorEncoding::Srgb };
        let mut cloud = random_cloud(14, seed, encoding);
        if low_pass != LowPass::Off {
            push(&mut cloud, [0.31, -0.2, 0.2], [0.4, 0.7, 0.1, 0.0], [0.004, 0.003], 1.0);
        }
        let camera = camera(26, 19);
        let config = smooth(low_pass);
        let g = random_gradient(camera.width, camera.height, seed + 100);
        let (analytic, _) = gradients(&cloud, &camera, &config, &g);
        let base = ReferenceCloud::new(&cloud);
        let h = 1e-6;
        let mut checked = 0;
        let mut check = |name: &str, i: usize, value: f32, change: &dyn Fn(&mut ReferenceCloud, f64)| {
            let (mut plus, mut minus) = (base.clone(), base.clone());
            change(&mut plus, h);
            change(&mut minus, -h);
            let numeric =
                (loss(&plus, &camera, &config, &g) - loss(&minus, &camera, &config, &g)) / (2.0 * h);
            let tolerance = 2e-3 * numeric.abs().max(0.5);
            assert!(
                (numeric - f64::from(value)).abs() < tolerance,
                "{name} of surfel {i}, seed {seed}: numeric {numeric}, analytic {value}"
            );
            checked += usize::from(numeric.abs() > 1e-3);
        };
        for i in 0..cloud.len() {
            for k in 0..3 {
                check("position", i, analytic.positions[i][k], &|c, h| c.surfels[i].position[k] += h);
            }
            for k in 0..4 {
                check("rotation", i, analytic.rotations[i][k], &|c, h| c.surfels[i].rotation[k] += h);
            }
            for k in 0..2 {
                check("log_scale", i, analytic.log_scales[i][k], &|c, h| c.surfels[i].log_scale[k] += h);
            }
            check("opacity", i, analytic.opacity_logits[i], &|c, h| c.surfels[i].opacity_logit += h);
            for k in [0, 1, 5, 20, 33, 47] {
                check("sh", i, analytic.sh[i * 48 + k], &|c, h| c.surfels[i].sh[k] += h);
            }
            for k in 0..5 {
                check("material", i, analytic.material_logits[i][k], &|c, h| c.surfels[i].material[k] += h);
            }
        }
        assert!(checked > cloud.len() * 15, "only {checked} gradients were large enough to mean something");
    }
}

/// Goal (hard case 10): ⟨Jv, u⟩ = ⟨v, Jᵀu⟩ for a random direction in parameter space: one number that every entry takes part in.
#[test]
fn adjoint_identity() {
    let cloud = random_cloud(40, 21, ColorEncoding::Srgb);
    let camera = camera(40, 30);
    let config = smooth(LowPass::Sigma(0.7));
    let g = random_gradient(40, 30, 5);
    let (analytic, _) = gradients(&cloud, &camera, &config, &g);
    let mut rng = Rng::new(77);
    let base = ReferenceCloud::new(&cloud);
    let (mut plus, mut minus) = (base.clone(), base.clone());
    let mut inner = 0.0f64;
    let h = 1e-6;
    for i in 0..cloud.len() {
        let mut step = |p: &mut f64, m: &mut f64, gradient: f32| {
            let v = f64::from(rng.normal());
            *p += h * v;
            *m -= h * v;
            inner += v * f64::from(gradient);
        };
        let (p, m) = (&mut plus.surfels[i], &mut minus.surfels[i]);
        for k in 0..3 {
            step(&mut p.position[k], &mut m.position[k], analytic.positions[i][k]);
        }
        for k in 0..4 {
            step(&mut p.rotation[k], &mut m.rotation[k], analytic.rotations[i][k]);
        }
        for k in 0..2 {
            step(&mut p.log_scale[k], &mut m.log_scale[k], analytic.log_scales[i][k]);
        }
        step(&mut p.opacity_logit, &mut m.opacity_logit, analytic.opacity_logits[i]);
        for k in 0..48 {
            step(&mut p.sh[k], &mut m.sh[k], analytic.sh[i * 48 + k]);
        }
        for k in 0..5 {
            step(&mut p.material[k], &mut m.material[k], analytic.material_logits[i][k]);
        }
    }
    let numeric = (loss(&plus, &camera, &config, &g) - loss(&minus, &camera, &config, &g)) / (2.0 * h);
    assert!((numeric - inner).abs() < 1e-3 * numeric.abs().max(1.0), "{numeric} {inner}");
    assert!(numeric.abs() > 1.0);
}

/// Goal: the radial part of the quaternion gradient is zero (only the direction of the quaternion matters).
#[test]
fn quaternion_gradient_is_tangential() {
    let cloud = random_cloud(30, 31, ColorEncoding::Srgb);
    let camera = camera(32, 24);
    let (g, _) = gradients(&cloud, &camera, &RasterConfig::default(), &random_gradient(32, 24, 6));
    let mut largest = 0.0f32;
    for (q, g) in cloud.rotations.iter().zip(&g.rotations) {
        let radial: f32 = (0..4).map(|k| q[k] * g[k]).sum();
        let size = g.iter().fold(0.0f32, |a, v| a.max(v.abs()));
        largest = largest.max(size);
        assert!(radial.abs() < 1e-4 * size.max(1.0), "{radial}");
    }
    assert!(largest > 0.1);
}

/// Goal: the path from the view direction to the position through the harmonics is included: with a colour loss on one
/// big opaque surfel whose colour depends on the direction, moving it sideways changes the colour.
#[test]
fn view_direction_gradient_is_included() {
    let mut cloud = empty();
    push(&mut cloud, [0.0, 0.0, 0.0], common::FACING, [50.0, 50.0], 2.0);
    cloud.sh[3 * 3] = 0.8; // −C1·x of red
    let camera = camera(8, 8);
    let config = smooth(LowPass::Off);
    let mut g = FrameGradient { color: Some(Image::zeros(8, 8, 3)), ..Default::default() };
    for p in g.color.as_mut().unwrap().data.chunks_exact_mut(3) {
        p[0] = 1.0;
    }
    let (analytic, _) = gradients(&cloud, &camera, &config, &g);
    assert!(analytic.positions[0][0].abs() > 0.5, "{:?}", analytic.positions[0]);
}

/// Goal: where a colour is clamped at 0 the harmonics get no gradient, elsewhere they do.
#[test]
fn colour_clamp_stops_the_gradient() {
    let mut cloud = empty();
    push(&mut cloud, [0.0, 0.0, 0.0], common::FACING, [0.5, 0.5], 1.0);
    cloud.sh[0] = -3.0;
    cloud.sh[1] = 0.5;
    let (g, frame) =
        gradients(&cloud, &camera(16, 16), &RasterConfig::default(), &random_gradient(16, 16, 9));
    assert_eq!(g.sh[0], 0.0);
    assert!(g.sh[1].abs() > 1e-3);
    assert!(frame.color.unwrap().data.iter().step_by(3).all(|&r| r == 0.0));
}

/// Goal: weight and error sums a surfel are what brute force over single-surfel differences says: the weights of all
/// surfels add up to the weight plane, weighted by the error image.
#[test]
fn statistics_add_up() {
    let cloud = random_cloud(50, 41, ColorEncoding::Srgb);
    let camera = camera(30, 22);
    let mut workspace = Workspace::default();
    let config = RasterConfig::default();
    let frame = forward(&cloud, &camera, Planes::COLOR, &config, &mut workspace);
    let mut rng = Rng::new(3);
    let error = Image::from_data(30, 22, 1, (0..30 * 22).map(|_| rng.uniform()).collect());
    let g = FrameGradient { error: Some(error.clone()), ..Default::default() };
    let mut out = SurfelGradients::zeros(&cloud);
    backward(&cloud, &camera, &frame, &g, &config, &mut workspace, &mut out);
    let total: f32 = frame.weight.data.iter().sum();
    assert!((out.weight.iter().sum::<f32>() / total - 1.0).abs() < 1e-4);
    let weighted: f32 = frame.weight.data.iter().zip(&error.data).map(|(w, e)| w * e).sum();
    assert!((out.error.iter().sum::<f32>() / weighted - 1.0).abs() < 1e-4);
    assert!(out.positions.iter().flatten().all(|v| *v == 0.0));
}

/// Goal: the same bytes, forward and backward, at 1, 2 and 5 threads.
#[test]
fn deterministic_at_any_thread_count() {
    let cloud = random_cloud(3000, 51, ColorEncoding::Srgb);
    let camera = camera(97, 61);
    let g = random_gradient(97, 61, 8);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| gradients(&cloud, &camera, &RasterConfig::default(), &g))
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
    assert!(one.0.positions.iter().flatten().any(|v| *v != 0.0));
}
