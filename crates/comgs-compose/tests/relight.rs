//! Relighting against answers known on paper, a brute-force reference, and traced rays.

use comgs_compose::relight::{self, Point, reference, write_relit_layers};
use comgs_compose::{Heuristic, Indirect, RelightConfig, RelightError, Relighter, RelitFrame, SelfOcclusion};
use comgs_geom::sampling::uniform_sphere;
use comgs_geom::{Camera, Rng};
use comgs_image::Image;
use comgs_light::{EnvironmentMap, Material, luminance};
use comgs_probe::{BakeObserver, OrientedPoints, ProbeConfig, ProbeError, ProbeSet, bake, place};
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud, activation::logit};
use comgs_trace::{TraceConfig, Tracer};
use glam::{DVec3, Vec2, Vec3};
use std::f64::consts::PI;

const MATTE: Material = Material { albedo: Vec3::new(0.8, 0.5, 0.2), roughness: 1.0, metallic: 0.0 };

fn empty() -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    cloud.material = Some(MaterialColumns::default());
    cloud
}

fn push(cloud: &mut SurfelCloud, p: Vec3, normal: Vec3, sigma: f32, material: Material) {
    let q = glam::Quat::from_rotation_arc(Vec3::Z, normal.normalize());
    cloud.positions.push(p.to_array());
    cloud.rotations.push([q.w, q.x, q.y, q.z]);
    cloud.log_scales.push([sigma.ln(); 2]);
    cloud.opacity_logits.push(logit(0.99));
    cloud.sh.extend([0.0; 3]);
    let columns = cloud.material.as_mut().unwrap();
    columns.albedo_logits.push(material.albedo.to_array().map(logit));
    columns.roughness_logits.push(logit(material.roughness));
    columns.metallic_logits.push(logit(material.metallic));
}

/// A ball of radius ½ around the origin.
fn ball(material: Material) -> SurfelCloud {
    let mut cloud = empty();
    let n = 4000;
    for i in 0..n {
        let golden = 0.618_034 * i as f32;
        let d = uniform_sphere(Vec2::new((i as f32 + 0.5) / n as f32, golden - golden.floor()));
        push(&mut cloud, 0.5 * d, d, 0.02, material);
    }
    cloud
}

/// A box from `low` to `high` whose surfels are `step` apart.
fn block(cloud: &mut SurfelCloud, low: Vec3, high: Vec3, step: f32, material: Material) {
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        let count = |k: usize| ((high[k] - low[k]) / step).round().max(1.0) as usize;
        for side in 0..2 {
            let mut normal = Vec3::ZERO;
            normal[axis] = if side == 0 { -1.0 } else { 1.0 };
            for i in 0..count(u) * count(v) {
                let mut p = if side == 0 { low } else { high };
                p[u] = low[u] + (high[u] - low[u]) * ((i % count(u)) as f32 + 0.5) / count(u) as f32;
                p[v] = low[v] + (high[v] - low[v]) * ((i / count(u)) as f32 + 0.5) / count(v) as f32;
                push(cloud, p, normal, 0.6 * step, material);
            }
        }
    }
}

/// Baked probes over the surfels, which know their outsides.
fn probes(cloud: &SurfelCloud, count: usize, size: f32) -> ProbeSet {
    let points = OrientedPoints {
        positions: cloud.positions.iter().map(|p| Vec3::from_array(*p)).collect(),
        normals: (0..cloud.len()).map(|i| cloud.rotation(i).z_axis).collect(),
    };
    let config = ProbeConfig { count, ..ProbeConfig::paper() };
    let mut set = place(&points, &config, size).unwrap();
    let tracer = Tracer::new(cloud, &TraceConfig::default()).unwrap();
    bake(&tracer, &mut set, 4, BakeObserver::silent()).unwrap();
    set
}

fn camera(size: usize) -> Camera {
    Camera::look_at("a", size, size, 0.6, DVec3::new(1.5, -1.1, 0.7), DVec3::ZERO, DVec3::Z)
}

fn config(occlusion: SelfOcclusion) -> RelightConfig {
    RelightConfig { self_occlusion: occlusion, layers: true, ..RelightConfig::balanced() }
}

/// A map of 16 × 8 texels whose radiance spreads over five powers of ten.
fn rough_map(seed: u64) -> EnvironmentMap {
    let mut rng = Rng::new(seed);
    let data = (0..16 * 8 * 3).map(|_| 10.0f32.powf(rng.range(-3.0, 1.0))).collect();
    let mut image = Image::from_data(16, 8, 3, data);
    image.pixel_mut(5, 2).copy_from_slice(&[60.0, 50.0, 40.0]);
    EnvironmentMap::from_image(&image).unwrap().turned(0.4)
}

/// Difference that two seeds may make under a small sun, in root mean square over the pixels.
const NOISE: f64 = 0.01;
/// Difference that they may make in the worst pixel.
const FIREFLY: f64 = 0.2;

/// One texel of 10⁵ over 10⁻³ (hard case 25).
fn small_sun(width: usize) -> EnvironmentMap {
    let mut image = Image::filled(width, width / 2, 3, 1e-3);
    image.pixel_mut(width * 5 / 8, width / 8).fill(1e5);
    EnvironmentMap::from_image(&image).unwrap()
}

/// Pixels that are all surface, and not edge-on: at a silhouette the mean depth of discs lies off the ball.
fn solid(frame: &RelitFrame, camera: &Camera) -> Vec<usize> {
    let normals = &frame.layers.as_ref().unwrap().normal;
    let facing = |i: usize| {
        let ray = camera.ray_world((i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5);
        -ray.normalize().as_vec3().dot(rgb(normals, i))
    };
    (0..frame.weight.pixels()).filter(|&i| frame.weight.data[i] > 0.99 && facing(i) > 0.3).collect()
}

fn rgb(image: &Image, i: usize) -> Vec3 {
    Vec3::from_slice(&image.data[3 * i..])
}

/// Goal: white furnace: in constant light the matte term of a convex body is its albedo, whatever is asked about
/// occlusion. Tolerances: noise of 128 samples a pixel; for rays, surfels that stand proud of the ball (rays start higher
/// than by default, because between these coarse discs the mean depth lies up to 1 % of the diameter inside); for
/// probes, 16 texels a side that blur the horizon.
#[test]
fn white_furnace_hard_case_26() {
    let cloud = ball(MATTE);
    let set = probes(&cloud, 400, 1.0);
    let white = EnvironmentMap::constant(Vec3::ONE);
    for (occlusion, of_mean, of_pixel) in [
        (SelfOcclusion::None, 0.003, 0.04),
        (SelfOcclusion::Trace, 0.003, 0.04),
        (SelfOcclusion::Probes, 0.006, 0.05),
    ] {
        let config = RelightConfig { trace_offset: 0.02, ..config(occlusion) };
        let relighter = Relighter::new(&cloud, Some(&set), &white, config).unwrap();
        let camera = camera(48);
        let frame = relighter.render(&camera);
        let layers = frame.layers.as_ref().unwrap();
        let (mut mean, mut worst, mut open) = (Vec3::ZERO, 0.0f32, 0.0);
        let pixels = solid(&frame, &camera);
        for &i in &pixels {
            let ratio = rgb(&layers.diffuse, i) / frame.weight.data[i] / MATTE.albedo;
            mean += ratio / pixels.len() as f32;
            worst = worst.max((ratio - 1.0).abs().max_element());
            open += layers.visibility.data[i] / pixels.len() as f32;
        }
        assert!(pixels.len() > 400);
        assert!((mean - 1.0).abs().max_element() < of_mean, "{occlusion:?} {mean}");
        assert!(worst < of_pixel, "{occlusion:?} {worst}");
        assert!((open - 1.0).abs() < of_mean, "{occlusion:?} {open}");
    }
}

/// A point of random material and light from the side of the eye.
fn random_point(rng: &mut Rng) -> Point {
    let direction = |rng: &mut Rng| uniform_sphere(Vec2::new(rng.uniform(), rng.uniform()));
    let normal = direction(rng);
    let view = (normal * rng.range(0.3, 2.0) + direction(rng)).normalize();
    let view = if view.dot(normal) < 0.05 { normal } else { view };
    let material = Material {
        albedo: Vec3::new(rng.uniform(), rng.uniform(), rng.uniform()),
        roughness: rng.range(0.2, 1.0),
        metallic: rng.below(2) as f32,
    };
    Point { position: 0.5 * normal, normal, view, material }
}

fn mean(relighter: &Relighter<'_>, point: &Point, streams: u64) -> [DVec3; 2] {
    let mut sum = [DVec3::ZERO; 2];
    for stream in 0..streams {
        let lit = relighter.radiance(point, stream);
        sum[0] += lit.diffuse.as_dvec3() / streams as f64;
        sum[1] += lit.specular.as_dvec3() / streams as f64;
    }
    sum
}

/// Goal: with both heuristics the estimator's mean is the integral, matte and highlight apart, as brute force over all
/// texels has it. Tolerance: 2 % of the whole is three standard errors of 64 × 512 samples and the midpoint rule's
/// error at the narrowest highlight (α = 0.04 against cells of 0.016 radians).
#[test]
fn brute_force_agrees() {
    const TOLERANCE: f64 = 0.02;
    let cloud = ball(MATTE);
    let mut rng = Rng::new(3);
    for k in 0..6 {
        let map = rough_map(k);
        for heuristic in [Heuristic::Balance, Heuristic::Power] {
            let config = RelightConfig {
                heuristic,
                self_occlusion: SelfOcclusion::None,
                ..RelightConfig::reference()
            };
            let relighter = Relighter::new(&cloud, None, &map, config).unwrap();
            let point = random_point(&mut rng);
            let expected = reference::radiance(&point, &map, 24, |_| (1.0, DVec3::ZERO));
            let [diffuse, specular] = mean(&relighter, &point, 64);
            let whole = (expected.diffuse + expected.specular).element_sum();
            let off = (diffuse - expected.diffuse).abs().element_sum()
                + (specular - expected.specular).abs().element_sum();
            assert!(off < TOLERANCE * whole, "{heuristic:?} {point:?}: {diffuse} {specular} {expected:?}");
        }
    }
}

/// Goal: samples of the light alone, of the BRDF alone and of both have the same mean; on a polished surface under a
/// small lamp and a bright sky both together have the least variance by far, at the same number of samples.
#[test]
fn both_proposals_beat_either() {
    // A sky that is brightest in front, and a lamp of one texel.
    let mut image = Image::zeros(64, 32, 3);
    for y in 0..32 {
        for x in 0..64 {
            let sky = if y < 16 { 0.2 + 3.0 * (x as f32 / 64.0) } else { 0.1 };
            image.pixel_mut(x, y).fill(sky);
        }
    }
    image.pixel_mut(40, 9).fill(4000.0);
    let map = EnvironmentMap::from_image(&image).unwrap();
    let cloud = ball(MATTE);
    // The eye looks at the mirror image of the sky beside the lamp: lamp and sky both count.
    let normal = Vec3::new(0.3, -0.2, 1.0).normalize();
    let lamp = map.direction(42.0 / 64.0, 10.0 / 32.0);
    let view = (2.0 * normal.dot(lamp) * normal - lamp).normalize();
    let material = Material { albedo: Vec3::splat(0.3), roughness: 0.15, metallic: 0.0 };
    let point = Point { position: 0.5 * normal, normal, view, material };
    let of = |light_rays, brdf_rays, heuristic| {
        let config = RelightConfig {
            light_rays,
            brdf_rays,
            heuristic,
            self_occlusion: SelfOcclusion::None,
            ..RelightConfig::balanced()
        };
        let relighter = Relighter::new(&cloud, None, &map, config).unwrap();
        let n = 2000;
        let values: Vec<f64> =
            (0..n).map(|s| f64::from(luminance(relighter.radiance(&point, s).total()))).collect();
        let mean = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
        (mean, variance, (variance / n as f64).sqrt())
    };
    let all = [
        of(64, 0, Heuristic::Balance),
        of(0, 64, Heuristic::Balance),
        of(32, 32, Heuristic::Balance),
        of(32, 32, Heuristic::Power),
    ];
    let both = all[2];
    for (mean, variance, error) in &all[..2] {
        // Four standard errors of the difference; Hammersley sets only make it smaller.
        assert!((mean - both.0).abs() < 4.0 * error.hypot(both.2) + 1e-3 * both.0, "{all:?}");
        assert!(*variance > 3.0 * both.1, "{all:?}");
    }
    assert!((all[3].0 - both.0).abs() < 4.0 * all[3].2.hypot(both.2) + 1e-3 * both.0, "{all:?}");
    assert!(all[3].1 < 2.0 * both.1, "{all:?}");
}

/// Goal: hard case 25: under one texel of 10⁵ over 10⁻³ two seeds give the same picture, from chalk to a polished
/// metal: neither light's nor BRDF's samples leave fireflies. Bounds on |a − b| / (a + b): [`NOISE`] in root mean square
/// over the picture (found: 0.4 %) and [`FIREFLY`] in the worst pixel (found: 10 %, where the outline of the sun that the
/// polished ball mirrors cuts a highlight a twentieth as wide as the sun; 6 % on the others).
#[test]
fn small_sun_is_quiet_hard_case_25() {
    for (roughness, metallic) in [(0.05, 1.0), (0.1, 0.0), (0.2, 1.0), (0.4, 0.0), (1.0, 0.0)] {
        let material = Material { albedo: Vec3::splat(0.6), roughness, metallic };
        let cloud = ball(material);
        let set = probes(&cloud, 400, 1.0);
        let map = small_sun(128);
        let of = |seed| {
            let config = RelightConfig { seed, ..config(SelfOcclusion::Probes) };
            Relighter::new(&cloud, Some(&set), &map, config).unwrap().render(&camera(48)).radiance
        };
        let (a, b) = (of(1), of(2));
        // A tenth of the darkness of the map is dark.
        let apart = |i: usize| f64::from((a.data[i] - b.data[i]).abs() / (a.data[i] + b.data[i]).max(1e-4));
        let apart: Vec<f64> = (0..a.data.len()).filter(|&i| a.data[i] > 0.0).map(apart).collect();
        let mean_square = apart.iter().map(|d| d * d).sum::<f64>() / apart.len() as f64;
        let worst = apart.iter().copied().fold(0.0, f64::max);
        assert!(
            mean_square.sqrt() < NOISE && worst < FIREFLY,
            "{material:?}: {} {worst}",
            mean_square.sqrt()
        );
    }
}

/// Goal: what two facing walls hide from one another: rays agree with the form factor of parallel squares, probes with
/// rays.
#[test]
fn facing_walls() {
    let mut cloud = empty();
    let gap = 0.4;
    block(&mut cloud, Vec3::new(-0.1, -0.5, -0.5), Vec3::new(0.0, 0.5, 0.5), 0.03, MATTE);
    block(&mut cloud, Vec3::new(gap, -0.5, -0.5), Vec3::new(gap + 0.1, 0.5, 0.5), 0.03, MATTE);
    let set = probes(&cloud, 600, 1.0);
    let white = EnvironmentMap::constant(Vec3::ONE);
    let of = |occlusion| {
        let config =
            RelightConfig { self_occlusion: occlusion, trace_offset: 0.003, ..RelightConfig::reference() };
        Relighter::new(&cloud, Some(&set), &white, config).unwrap()
    };
    let (traced, probed) = (of(SelfOcclusion::Trace), of(SelfOcclusion::Probes));
    let mut off = 0.0;
    for y in [-0.4f32, -0.2, 0.0, 0.2, 0.4] {
        for z in [-0.4f32, -0.2, 0.0, 0.2, 0.4] {
            let position = Vec3::new(0.0, y, z);
            let point = Point { position, normal: Vec3::X, view: Vec3::X, material: MATTE };
            let open = |r: &Relighter<'_>| r.radiance(&point, 0).diffuse.x / MATTE.albedo.x;
            let (t, p) = (open(&traced), open(&probed));
            // From a point, the other wall is four rectangles with a corner opposite to it.
            let mut hidden = 0.0;
            for (a, b) in [(0.5 - y, 0.5 - z), (0.5 + y, 0.5 - z), (0.5 - y, 0.5 + z), (0.5 + y, 0.5 + z)] {
                let (x, y) = (f64::from(a / gap), f64::from(b / gap));
                let (rx, ry) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
                hidden += (x / rx * (y / rx).atan() + y / ry * (x / ry).atan()) / (2.0 * PI);
            }
            let text = format!("{y} {z}: paper {:.3}, rays {t:.3}, probes {p:.3}", 1.0 - hidden);
            // Discs stick out of the wall by half of their spacing: 2 × 0.015 of 1 in each direction.
            assert!((f64::from(t) - (1.0 - hidden)).abs() < 0.045, "{text}");
            // One texel of 16 × 16 is 0.9 % of the hemisphere's cosine; the wall's outline crosses many.
            assert!((t - p).abs() < 0.04, "{text}");
            off += (t - p).abs() / 25.0;
        }
    }
    assert!(off < 0.015, "{off}");
}

/// Goal: in a corner whose wall the sun lights, one bounce brightens the floor by the wall's radiosity times the form
/// factor of a rectangle that stands on it.
#[test]
fn corner_bounce() {
    let wall = Material { albedo: Vec3::new(0.9, 0.3, 0.1), roughness: 1.0, metallic: 0.0 };
    let mut cloud = empty();
    block(&mut cloud, Vec3::new(0.0, -1.0, -0.1), Vec3::new(1.0, 1.0, 0.0), 0.05, MATTE);
    block(&mut cloud, Vec3::new(-0.1, -1.0, -0.1), Vec3::new(0.0, 1.0, 1.0), 0.05, wall);
    let set = probes(&cloud, 1200, 2.0);
    let mut sun = Image::zeros(64, 32, 3);
    // Straight ahead (+x), 35° above the horizon.
    for x in 31..33 {
        sun.pixel_mut(x, 9).fill(100.0);
    }
    let map = EnvironmentMap::from_image(&sun).unwrap();
    let radiosity = wall.albedo / std::f32::consts::PI * map.irradiance(Vec3::X);
    // Rays: the wall's soft edge. Probes: the wall's light in texels that it fills in part.
    for (occlusion, tolerance) in [(SelfOcclusion::Trace, 0.04), (SelfOcclusion::Probes, 0.12)] {
        let base = RelightConfig { self_occlusion: occlusion, ..RelightConfig::reference() };
        let with = RelightConfig { indirect: Indirect::OneBounce, ..base.clone() };
        let without = Relighter::new(&cloud, Some(&set), &map, base).unwrap();
        let with = Relighter::new(&cloud, Some(&set), &map, with).unwrap();
        assert!(with.preparation().bounce_s > 0.0 && without.preparation().bounce_s == 0.0);
        for c in [0.2f64, 0.4, 0.7] {
            let position = Vec3::new(c as f32, 0.0, 0.0);
            let view = Vec3::new(0.3, 0.2, 1.0).normalize();
            let point = Point { position, normal: Vec3::Z, view, material: MATTE };
            let (mut brighter, mut indirect) = (Vec3::ZERO, Vec3::ZERO);
            for stream in 0..8 {
                let (a, b) = (with.radiance(&point, stream), without.radiance(&point, stream));
                brighter += (a.total() - b.total()) / 8.0;
                indirect += a.indirect / 8.0;
                assert_eq!(b.indirect, Vec3::ZERO);
            }
            // Twice a rectangle of height 1 and width 1 with its lower corner at the foot of the point.
            let r = (1.0 + c * c).sqrt();
            let factor = ((1.0 / c).atan() - c / r * (1.0 / r).atan()) / PI;
            let matte = (MATTE.albedo * radiosity).as_dvec3() * factor;
            let paper = reference::radiance(&point, &map, 8, |d| {
                let t = -f64::from(position.x) / d.x;
                let hit = t > 0.0 && (t * d.y).abs() < 1.0 && t * d.z < 1.0;
                if hit { (0.0, radiosity.as_dvec3()) } else { (1.0, DVec3::ZERO) }
            });
            let ratio = indirect.as_dvec3() / paper.indirect;
            assert!((ratio - 1.0).abs().max_element() < tolerance, "{occlusion:?} at {c}: {ratio}");
            // The reference holds the highlight too, which adds little where the albedo is high.
            assert!((1.0..1.04).contains(&(paper.indirect.x / matte.x)), "{paper:?} {matte}");
            assert!((brighter - indirect).abs().max_element() < 1e-5 * indirect.max_element());
        }
    }
}

/// Goal: the same bytes with one thread and with two, bounce and layers included; another seed gives other noise; the
/// layers add up; pixels without a surface are empty (hard case 29).
#[test]
fn same_bytes_hard_case_29() {
    let mut cloud = ball(Material { albedo: Vec3::splat(0.5), roughness: 0.3, metallic: 0.5 });
    block(&mut cloud, Vec3::new(-0.6, -0.6, -0.7), Vec3::new(0.6, 0.6, -0.55), 0.06, MATTE);
    let set = probes(&cloud, 300, 1.2);
    let map = rough_map(9);
    let render = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let config =
                RelightConfig { seed, indirect: Indirect::OneBounce, layers: true, ..RelightConfig::draft() };
            Relighter::new(&cloud, Some(&set), &map, config).unwrap().render(&camera(40))
        })
    };
    let (one, two, other) = (render(1, 0), render(2, 0), render(2, 1));
    assert_eq!((&one.radiance, &one.weight, &one.layers), (&two.radiance, &two.weight, &two.layers));
    assert_eq!(one.weight, other.weight);
    assert_ne!(one.radiance, other.radiance);
    let layers = one.layers.as_ref().unwrap();
    let (mut shown, mut glow) = (0, 0.0);
    for i in 0..one.weight.pixels() {
        let sum = rgb(&layers.diffuse, i) + rgb(&layers.specular, i) + rgb(&layers.indirect, i);
        assert!((sum - rgb(&one.radiance, i)).abs().max_element() <= 1e-5 * sum.max_element());
        glow += luminance(rgb(&layers.indirect, i));
        let weight = one.weight.data[i];
        assert!(weight == 0.0 || weight > relight::points::MIN_WEIGHT);
        if weight == 0.0 {
            assert_eq!((rgb(&one.radiance, i), layers.depth.data[i]), (Vec3::ZERO, 0.0));
        } else {
            shown += 1;
            assert!((rgb(&layers.normal, i).length() - 1.0).abs() < 1e-5 && layers.depth.data[i] > 0.5);
        }
    }
    assert_eq!(shown, one.stats.points);
    assert!(shown > 400 && glow > 0.0, "{shown} {glow}");
    let background = relight::background(&map, &camera(40));
    let over = one.over(&background);
    let empty = (0..one.weight.pixels()).find(|&i| one.weight.data[i] == 0.0).unwrap();
    assert_eq!(rgb(&over, empty), rgb(&background, empty));
}

/// Goal: layers are written as named channels.
#[test]
fn layers_are_channels() {
    let cloud = ball(MATTE);
    let white = EnvironmentMap::constant(Vec3::ONE);
    let folder = tempfile::tempdir().unwrap();
    let write = |layers: bool| {
        let config = RelightConfig { layers, ..config(SelfOcclusion::None) };
        let frame = Relighter::new(&cloud, None, &white, config).unwrap().render(&camera(16));
        let path = folder.path().join("frame.exr");
        write_relit_layers(&path, &frame).unwrap();
        let names = comgs_image::read::exr_channels(&path).unwrap();
        names.iter().map(|n| n.split(':').next().unwrap_or_default().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(write(false), ["A", "B", "G", "R"]);
    let all = write(true);
    for name in ["diffuse.R", "specular.G", "indirect.B", "visibility.Y", "depth.Z", "normal.X", "albedo.R"] {
        assert!(all.iter().any(|n| n == name), "{name} in {all:?}");
    }
    assert!(all.iter().any(|n| n == "roughness.Y") && all.iter().any(|n| n == "metallic.Y"), "{all:?}");
}

/// Goal: hard cases 26 and 27: black light gives black; every corner of the material, seen from straight above to below
/// the horizon, gives finite radiance that is not negative.
#[test]
fn extremes_hard_cases_26_and_27() {
    let cloud = ball(MATTE);
    let black = EnvironmentMap::constant(Vec3::ZERO);
    let set = probes(&cloud, 100, 1.0);
    let dark = RelightConfig { indirect: Indirect::OneBounce, ..config(SelfOcclusion::Probes) };
    let frame = Relighter::new(&cloud, Some(&set), &black, dark).unwrap().render(&camera(16));
    // The harmonics of a black surfel are −½ and sum to 0 but for rounding.
    assert!(frame.radiance.data.iter().all(|v| (0.0..1e-6).contains(v)));
    assert!(frame.weight.data.iter().any(|w| *w > 0.9));
    let map = small_sun(64);
    for heuristic in [Heuristic::Balance, Heuristic::Power] {
        let config = RelightConfig { heuristic, ..config(SelfOcclusion::Probes) };
        let relighter = Relighter::new(&cloud, Some(&set), &map, config).unwrap();
        for roughness in [0.0, 1e-6, 0.5, 1.0] {
            for metallic in [0.0, 1.0] {
                for albedo in [Vec3::ZERO, Vec3::ONE] {
                    for n_v in [1.0f32, 1e-3, 1e-7, 0.0, -1e-7, -0.5] {
                        let view = Vec3::new((1.0 - n_v * n_v).sqrt(), 0.0, n_v);
                        let material = Material { albedo, roughness, metallic };
                        let point = Point { position: Vec3::Z * 0.5, normal: Vec3::Z, view, material };
                        let lit = relighter.radiance(&point, 7);
                        let all = [lit.diffuse, lit.specular, lit.indirect];
                        let sound = all.iter().all(|v| v.is_finite() && v.min_element() >= 0.0);
                        assert!(sound, "{point:?}: {lit:?}");
                        assert!(n_v > 0.0 || lit.total() == Vec3::ZERO, "{point:?}: {lit:?}");
                    }
                }
            }
        }
    }
}

/// Goal: what cannot be relit is refused with its reason; a stopped bake is told as such.
#[test]
fn bad_input_is_named() {
    let cloud = ball(MATTE);
    let set = probes(&cloud, 50, 1.0);
    let white = EnvironmentMap::constant(Vec3::ONE);
    let fail = |cloud: &SurfelCloud, set: Option<&ProbeSet>, config: RelightConfig| {
        let error = Relighter::new(cloud, set, &white, config).err().expect("an error");
        let source = std::error::Error::source(&error).map(ToString::to_string).unwrap_or_default();
        format!("{error}: {source}")
    };
    let probed = || config(SelfOcclusion::Probes);
    let expect = |text: String, words: &str| assert!(text.contains(words), "{text}");
    expect(fail(&cloud, None, probed()), "no probes");
    expect(fail(&cloud, None, config(SelfOcclusion::Mixed)), "no probes");
    expect(
        fail(
            &cloud,
            Some(&ProbeSet { resolution: 16, spacing: 1.0, far_distance: 1.0, ..ProbeSet::default() }),
            probed(),
        ),
        "no probes",
    );
    expect(fail(&cloud, Some(&ProbeSet { spacing: f32::NAN, ..set.clone() }), probed()), "spacing is NaN");
    expect(fail(&SurfelCloud { material: None, ..cloud.clone() }, Some(&set), probed()), "not decomposed");
    expect(fail(&empty(), Some(&set), probed()), "0 surfels");
    let mut broken = cloud.clone();
    broken.material.as_mut().unwrap().roughness_logits[3] = f32::NAN;
    expect(fail(&broken, Some(&set), probed()), "roughness_logits has 1");
    expect(fail(&cloud, Some(&set), RelightConfig { neighbours: 0, ..probed() }), "neighbours is 0");
    let stop = BakeObserver { cancelled: &|| true, progress: &|_| {} };
    let bounce = RelightConfig { indirect: Indirect::OneBounce, ..probed() };
    let stopped = Relighter::prepare(&cloud, Some(&set), &white, bounce, stop).err();
    assert!(
        matches!(stopped, Some(RelightError::Probes(ProbeError::Cancelled { total: 50, .. }))),
        "{stopped:?}"
    );
}

/// Goal: the shadow of an edge under a small sun is sharp where the light's samples are traced, with half of the rays of
/// full tracing; probes blur it.
#[test]
fn mixed_shadows_are_sharp() {
    let mut cloud = empty();
    block(&mut cloud, Vec3::new(-0.6, -0.6, -0.1), Vec3::new(0.6, 0.6, 0.0), 0.03, MATTE);
    block(&mut cloud, Vec3::new(-0.6, -0.3, 0.2), Vec3::new(0.0, 0.3, 0.3), 0.03, MATTE);
    let set = probes(&cloud, 1500, 1.2);
    let mut image = Image::filled(128, 64, 3, 0.3);
    // 46° above the horizon of +x.
    image.pixel_mut(64, 15).fill(2000.0);
    let map = EnvironmentMap::from_image(&image).unwrap();
    let line = |self_occlusion| -> Vec<f32> {
        let config = RelightConfig { self_occlusion, ..RelightConfig::reference() };
        let relighter = Relighter::new(&cloud, Some(&set), &map, config).unwrap();
        let point = |x: i32| Point {
            position: Vec3::new(0.02 * x as f32, 0.0, 0.0),
            normal: Vec3::Z,
            view: Vec3::Z,
            material: MATTE,
        };
        (-25..25).map(|x| relighter.radiance(&point(x), 0).total().x).collect()
    };
    let (traced, mixed, probed) =
        (line(SelfOcclusion::Trace), line(SelfOcclusion::Mixed), line(SelfOcclusion::Probes));
    let apart = |a: &[f32]| a.iter().zip(&traced).map(|(a, b)| (a - b).abs()).sum::<f32>() / 50.0;
    // Found: 0.004 and 0.035 of a floor that is 0.86 bright in the sun.
    assert!(apart(&mixed) < 0.01, "{mixed:.2?} {traced:.2?}");
    assert!(apart(&probed) > 4.0 * apart(&mixed), "{probed:.2?} {traced:.2?}");
}
