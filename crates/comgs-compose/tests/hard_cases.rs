//! Hard cases 30 to 33: order, edges, copies, odd placements.

mod common;

use comgs_compose::{
    ComposeConfig, ComposeError, ComposedFrame, Composer, Denoise, LightSample, LightSource, Ordering,
    PlacedObject, PlacementConfig, ShadowConfig, ShadowSource, check_placement,
};
use comgs_geom::{Camera, Similarity, sampling::uniform_sphere};
use comgs_image::Image;
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_raster::{LowPass, Planes, RasterConfig};
use comgs_surfel::SurfelCloud;
use comgs_trace::{TraceConfig, Tracer};
use common::{append, at, ball, camera, empty, floor, push, rectangle};
use glam::{DVec3, Vec2, Vec3};

/// White light from everywhere.
struct Sky;

impl LightSource for Sky {
    fn sample(&self, u: Vec2) -> LightSample {
        LightSample {
            direction: uniform_sphere(u),
            radiance: Vec3::ONE,
            pdf: 1.0 / (4.0 * std::f32::consts::PI),
        }
    }

    fn evaluate(&self, _: Vec3) -> (Vec3, f32) {
        (Vec3::ONE, 1.0 / (4.0 * std::f32::consts::PI))
    }
}

/// White light from straight above.
struct Zenith;

impl LightSource for Zenith {
    fn sample(&self, _: Vec2) -> LightSample {
        LightSample { direction: Vec3::Z, radiance: Vec3::ONE, pdf: 1.0 }
    }

    fn evaluate(&self, _: Vec3) -> (Vec3, f32) {
        (Vec3::ZERO, 0.0)
    }
}

fn compose(
    scene: &SurfelCloud,
    objects: &[(&SurfelCloud, Similarity)],
    camera: &Camera,
    light: &dyn LightSource,
    config: ComposeConfig,
) -> ComposedFrame {
    let tracer = Tracer::new(scene, &TraceConfig::default()).unwrap();
    let placed: Vec<PlacedObject<'_>> = objects
        .iter()
        .map(|(cloud, world_from_object)| PlacedObject { cloud, world_from_object: *world_from_object })
        .collect();
    Composer::new(scene, &tracer, &placed, light, config).unwrap().frame(camera)
}

fn without_shadow(ordering: Ordering) -> ComposeConfig {
    ComposeConfig { shadow: None, ordering, ..ComposeConfig::default() }
}

fn few_rays() -> ComposeConfig {
    ComposeConfig {
        shadow: Some(ShadowConfig { rays: 32, ..ShadowConfig::default() }),
        ..ComposeConfig::default()
    }
}

/// A fence of five slats with gaps before the origin, seen from the test camera; edges are soft and fractional.
fn fence() -> SurfelCloud {
    let mut cloud = floor();
    for k in 0..5 {
        let corner = Vec3::new(0.75 + 0.13 * k as f32, -1.05 + 0.22 * k as f32, 0.0);
        rectangle(
            &mut cloud,
            corner,
            Vec3::new(0.06, 0.1, 0.0),
            Vec3::Z * 0.9,
            (3, 24),
            [[0.9, 0.8, 0.1], [0.9, 0.8, 0.1]],
        );
    }
    cloud
}

/// Exactly sorted radiance of one cloud through every pixel centre: the joint truth.
fn joint_truth(cloud: &SurfelCloud, camera: &Camera) -> Image {
    let tracer = Tracer::new(cloud, &TraceConfig::default()).unwrap();
    let view = tracer.view(camera.centre().as_vec3());
    let mut image = Image::zeros(camera.width, camera.height, 3);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let d = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5).as_vec3();
            let hit = view.radiance(d, 0.01, f32::INFINITY);
            image.pixel_mut(x, y).copy_from_slice(&hit.radiance.to_array());
        }
    }
    image
}

/// PSNR of linear values in [0, 1] over the pixels where `keep` is true.
fn psnr(a: &Image, b: &Image, keep: &[bool]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0f64);
    for i in 0..a.pixels() {
        if keep[i] {
            for c in 0..3 {
                sum += f64::from(a.data[3 * i + c] - b.data[3 * i + c]).powi(2);
                n += 1.0;
            }
        }
    }
    -10.0 * (sum / n.max(1.0)).log10()
}

/// Goal: against the jointly sorted truth of both clouds, splitting the scene at the object's depth beats both a
/// depth test and rasterising the merged cloud (whose surfels are sorted by their centres), at the edges where object
/// and scene overlap fractionally (hard case 31). The tracer that gives the truth has no screen-space filter, so the
/// rasteriser's is off here: what is left is order alone.
#[test]
fn split_order_has_no_fringe() {
    let (scene, object) = (fence(), ball([0.1, 0.3, 0.8]));
    let place = at(0.25, -0.2, 0.5, 1.0);
    let camera = camera(192, 144);
    let mut merged = scene.clone();
    append(&mut merged, &object.transformed(&place));
    let truth = joint_truth(&merged, &camera);

    let raster = RasterConfig { low_pass: LowPass::Off, ..RasterConfig::default() };
    let order = |ordering| {
        let config = ComposeConfig { raster, ..without_shadow(ordering) };
        compose(&scene, &[(&object, place)], &camera, &Sky, config)
    };
    let (split, test) = (order(Ordering::Split), order(Ordering::DepthTest));
    let joint = comgs_raster::render(&merged, &camera, Planes::COLOR, &raster).color.unwrap();

    // The band of pixels where either the object or what covers it is fractional.
    let edge: Vec<bool> = split.mask.data.iter().map(|m| (0.02..0.98).contains(m)).collect();
    let edges = edge.iter().filter(|e| **e).count();
    assert!(edges > 500, "{edges} edge pixels");
    let (s, t, m) =
        (psnr(&split.beauty, &truth, &edge), psnr(&test.beauty, &truth, &edge), psnr(&joint, &truth, &edge));
    println!("edge PSNR over {edges} px: split {s:.1} dB, depth test {t:.1} dB, merged raster {m:.1} dB");
    assert!(s > 35.0, "split {s}");
    assert!(s > t + 10.0, "split {s}, depth test {t}");
    // Rasterising the merged cloud is as good here, where surfels are small...
    assert!((s - m).abs() < 3.0, "split {s}, merged {m}");

    // No dark or bright fringe: the mean signed error of the band is small too.
    let mut signed = 0.0f64;
    for i in (0..edge.len()).filter(|&i| edge[i]) {
        signed += f64::from(split.beauty.data[3 * i + 1] - truth.data[3 * i + 1]);
    }
    assert!((signed / edges as f64).abs() < 0.01, "{}", signed / edges as f64);
}

/// A box of 0.5 without a bottom, its base exactly on the floor.
fn standing_box() -> SurfelCloud {
    let mut object = empty();
    let (h, c) = (0.25, [[0.8, 0.1, 0.1]; 2]);
    for (corner, u, v) in [
        (Vec3::new(-h, -h, 0.0), Vec3::X, Vec3::Z),
        (Vec3::new(h, -h, 0.0), Vec3::Y, Vec3::Z),
        (Vec3::new(-h, h, 0.0), Vec3::X, Vec3::Z),
        (Vec3::new(-h, -h, 0.0), Vec3::Y, Vec3::Z),
        (Vec3::new(-h, -h, 0.5), Vec3::X, Vec3::Y),
    ] {
        rectangle(&mut object, corner, u * 0.5, v * 0.5, (20, 20), c);
    }
    object
}

/// Goal: a foot that stands on a floor of large surfels is not eaten by it, although such surfels' centres may be
/// nearer to the camera than the object's; rasterising the merged cloud, which sorts centres, fails here (touching,
/// hard case 30).
#[test]
fn a_foot_on_the_floor_stays_whole() {
    let object = standing_box();
    let camera = camera(128, 96);
    let raster = RasterConfig { low_pass: LowPass::Off, ..RasterConfig::default() };
    let mut scene = empty();
    let rgb = [[0.6, 0.5, 0.4], [0.3, 0.35, 0.4]];
    rectangle(&mut scene, Vec3::new(-4.0, -4.0, 0.0), Vec3::X * 8.0, Vec3::Y * 8.0, (12, 12), rgb);
    let config = ComposeConfig { raster, ..without_shadow(Ordering::Split) };
    let frame = compose(&scene, &[(&object, Similarity::IDENTITY)], &camera, &Sky, config);
    let share = frame.stats.visible_px / frame.stats.object_px;
    assert!(share > 0.97, "{share} of the object is seen");

    let mut merged = scene.clone();
    append(&mut merged, &object);
    let truth = joint_truth(&merged, &camera);
    let joint = comgs_raster::render(&merged, &camera, Planes::COLOR, &raster).color.unwrap();
    let seen: Vec<bool> = frame.mask.data.iter().map(|m| *m > 0.02).collect();
    let (s, m) = (psnr(&frame.beauty, &truth, &seen), psnr(&joint, &truth, &seen));
    println!("standing box: {share:.3} of it is seen; split {s:.1} dB, merged raster {m:.1} dB");
    assert!(s > m + 3.0, "split {s}, merged {m}");
}

/// Goal: behind a wall it vanishes, half behind it is half seen, inside a closed box it vanishes, and beside the
/// frame it leaves the picture as the empty scene (hard case 30).
#[test]
fn behind_half_behind_inside_and_off_screen() {
    let object = ball([0.1, 0.3, 0.8]);
    let camera = camera(96, 72);
    let seen = |scene: &SurfelCloud, place: Similarity| {
        let frame = compose(scene, &[(&object, place)], &camera, &Sky, without_shadow(Ordering::Split));
        (frame.stats.visible_px / frame.stats.object_px.max(1e-9), frame)
    };
    let place = at(0.0, 0.0, 0.5, 1.0);
    assert!(seen(&floor(), place).0 > 0.98);

    // A wall across the view, half way to the camera, whose edge passes through the ball's centre.
    let forward = Vec3::new(3.0, -2.5, 0.0).normalize();
    let side = Vec3::Z.cross(forward);
    let wall = |from: f32| {
        let mut cloud = floor();
        let corner = forward * 1.5 + side * from;
        let wall_rgb = [[0.7, 0.7, 0.7], [0.5, 0.5, 0.5]];
        rectangle(&mut cloud, corner, side * 3.0, Vec3::Z * 2.5, (60, 50), wall_rgb);
        cloud
    };
    let behind = seen(&wall(-1.5), place).0;
    // Two percent pass between the wall's own Gaussians.
    assert!(behind < 0.03, "{behind}");
    let half = seen(&wall(0.0), place).0;
    assert!((half - 0.5).abs() < 0.06, "{half}");

    let mut boxed = floor();
    for axis in 0..3 {
        let mut e = [Vec3::ZERO; 3];
        for (k, v) in e.iter_mut().enumerate() {
            v[(axis + k) % 3] = 1.4;
        }
        for end in [0.0, 1.0] {
            let corner = Vec3::new(-0.7, -0.7, -0.2) + e[2] * end;
            rectangle(&mut boxed, corner, e[0], e[1], (20, 20), [[0.5, 0.4, 0.3]; 2]);
        }
    }
    let inside = seen(&boxed, place).0;
    assert!(inside < 0.03, "{inside}");

    let (_, frame) = seen(&floor(), at(-3.0, 30.0, 0.5, 1.0));
    assert_eq!(frame.stats.visible_px, 0.0);
    assert_eq!(frame.beauty, frame.empty);
}

/// Goal: an object off screen still throws its shadow into the frame; an object as large as the scene shadows
/// everything under it, with ratios in [0, 1] (hard case 30).
#[test]
fn shadows_reach_into_the_frame() {
    let object = ball([0.5; 3]);
    let camera = camera(48, 36);
    // High above the floor, out of the frame, straight over the point that the camera looks at.
    let frame = compose(&floor(), &[(&object, at(0.0, 0.0, 4.0, 1.0))], &camera, &Zenith, few_rays());
    assert_eq!(frame.stats.object_px, 0.0, "the ball is above the frame");
    let darkest = frame.shadow.data.iter().copied().fold(1.0f32, f32::min);
    assert!(darkest < 0.05, "{darkest}");
    let (lit, all) = (frame.shadow.data.iter().filter(|v| **v == 1.0).count(), frame.shadow.data.len());
    assert!(lit * 2 > all, "outside the shadow the ratio is exactly 1: {lit} of {all}");

    let frame = compose(&floor(), &[(&object, at(0.0, 0.0, 12.0, 20.0))], &camera, &Sky, few_rays());
    assert!(frame.shadow.data.iter().all(|v| (0.0..=1.0).contains(v)));
    let mean = frame.shadow.data.iter().sum::<f32>() / frame.shadow.data.len() as f32;
    assert!(mean < 0.6, "{mean}");
}

/// Goal: the layers recombine to the beauty exactly, without an object's shadow the scene is untouched far away, and
/// the shadow multiplies the scene only.
#[test]
fn layers_recombine() {
    let (scene, object) = (fence(), ball([0.9, 0.9, 0.9]));
    let frame = compose(&scene, &[(&object, at(0.2, 0.2, 0.5, 1.0))], &camera(96, 72), &Sky, few_rays());
    for i in 0..frame.beauty.pixels() {
        for c in 0..3 {
            let sum =
                frame.object.data[4 * i + c] + frame.scene.data[3 * i + c] * frame.shadow.data[3 * i + c];
            assert_eq!(frame.beauty.data[3 * i + c], sum);
        }
        assert_eq!(frame.mask.data[i], frame.object.data[4 * i + 3]);
        assert!(frame.weight.data[i] <= 1.0 + 1e-5);
        assert!(frame.depth.data[i].is_finite());
    }
    let path = tempfile::tempdir().unwrap();
    let file = path.path().join("layers/a.exr");
    comgs_compose::layers::write_frame_layers(&file, &frame).unwrap();
    let back = comgs_image::read(&file).unwrap();
    // The default layer (plain R, G, B) is the beauty; half floats keep 11 bits.
    for (a, b) in back.color.data.iter().zip(&frame.beauty.data) {
        assert!((a - b).abs() <= 1e-3 * b.abs() + 1e-6, "{a} {b}");
    }
}

/// Goal: a mirrored or sheared transform is refused where it is read, and an object without a visible surfel where it
/// is composed (hard case 30).
#[test]
fn what_cannot_be_composed_is_refused() {
    use glam::DMat4;
    let m = DMat4::from(at(0.0, 0.0, 0.0, 1.0).to_affine());
    let mirrored = Similarity::from_matrix(m * DMat4::from_scale(DVec3::new(1.0, -1.0, 1.0)));
    assert!(mirrored.unwrap_err().to_string().contains("mirrors"));
    let sheared = Similarity::from_matrix(m * DMat4::from_scale(DVec3::new(1.0, 1.3, 1.0)));
    assert!(sheared.unwrap_err().to_string().contains("shears"));

    let scene = floor();
    let tracer = Tracer::new(&scene, &TraceConfig::default()).unwrap();
    let mut ghost = empty();
    push(&mut ghost, Vec3::ZERO, Vec3::Z, 0.1, 0.001, [1.0; 3]);
    fn place(cloud: &SurfelCloud) -> [PlacedObject<'_>; 1] {
        [PlacedObject { cloud, world_from_object: Similarity::IDENTITY }]
    }
    let error = Composer::new(&scene, &tracer, &place(&ghost), &Sky, ComposeConfig::default()).err().unwrap();
    assert_eq!(error, ComposeError::Invisible(1));
    let nothing = empty();
    let error =
        Composer::new(&scene, &tracer, &place(&nothing), &Sky, ComposeConfig::default()).err().unwrap();
    assert!(matches!(error, ComposeError::Merge(_)), "{error}");
}

/// Goal: the same object twice: both are seen, their shadows overlap to a darker one but never below 0, and one frame
/// is the same bytes again (hard case 32).
#[test]
fn the_same_object_twice() {
    let (scene, object) = (floor(), ball([0.8, 0.2, 0.2]));
    let camera = camera(96, 72);
    let (a, b) = (at(-0.45, 0.0, 0.5, 1.0), at(0.45, 0.1, 0.5, 1.0));
    let frame = |places: &[Similarity]| {
        let objects: Vec<_> = places.iter().map(|p| (&object, *p)).collect();
        compose(&scene, &objects, &camera, &Sky, few_rays())
    };
    let (first, second, both) = (frame(&[a]), frame(&[b]), frame(&[a, b]));
    let single = first.stats.object_px + second.stats.object_px;
    assert!(both.stats.object_px < single && both.stats.object_px > 0.7 * single);
    // Means over the frame: shadows add up, less where they overlap.
    let mean = |f: &ComposedFrame| f.shadow.data.iter().sum::<f32>() / f.shadow.data.len() as f32;
    assert!(mean(&both) < mean(&first).min(mean(&second)));
    assert!(1.0 - mean(&both) < 1.02 * (2.0 - mean(&first) - mean(&second)));
    assert!(both.shadow.data.iter().all(|v| (0.0..=1.0).contains(v)));
    let again = frame(&[a, b]);
    assert_eq!((again.beauty, again.shadow), (both.beauty, both.shadow));
}

/// Goal: a frame over a scene that was rendered before, by another composer whose object stood elsewhere, is the same bytes as
/// one from scratch; so is a blend of an object's frame with the shadow that an earlier frame had.
#[test]
fn a_scene_seen_before_gives_the_same_frame() {
    let (scene, object) = (floor(), ball([0.8, 0.2, 0.2]));
    let camera = camera(96, 72);
    let tracer = Tracer::new(&scene, &TraceConfig::default()).unwrap();
    let composer = |x: f64| {
        let placed = [PlacedObject { cloud: &object, world_from_object: at(x, 0.1, 0.5, 1.0) }];
        Composer::new(&scene, &tracer, &placed, &Sky, few_rays()).unwrap()
    };
    let seen = composer(-0.6).scene_frame(&camera);
    // Asked for here, read below.
    let _ = composer(-0.6).frame_over(&seen, ShadowSource::Configured, None);
    let there = composer(0.4);
    let (again, fresh) = (there.frame_over(&seen, ShadowSource::Configured, None), there.frame(&camera));
    assert!(fresh.stats.visible_px > 50.0 && fresh.shadow.data.iter().any(|v| *v < 0.9));
    let planes = |f: &ComposedFrame| [&f.beauty, &f.shadow, &f.object, &f.scene, &f.depth].map(Image::clone);
    assert_eq!(planes(&again), planes(&fresh));
    let known = there.blend(&seen, &there.object_frame(&seen, None), ShadowSource::Known(&fresh.shadow));
    assert_eq!(planes(&known), planes(&fresh));
}

/// What the two suns of the next test leave of the floor's light at a point, by a sphere on paper; `None` in penumbras and
/// where the surfels' sphere is not sharp.
fn two_suns_on_paper(p: Vec3, centre: Vec3, suns: &[(Vec3, f32); 2]) -> Option<f32> {
    let (mut kept, mut all) = (0.0, 0.0);
    for (direction, power) in suns {
        let to = centre - p;
        let miss = (to - direction * to.dot(*direction)).length();
        let visible = match miss {
            // Radius ½; a texel of 1.4° at a distance of 1 blurs by 0.025, the surfels by twice their scale of 0.035.
            m if m < 0.38 => 0.0,
            m if m > 0.63 => 1.0,
            _ => return None,
        };
        let light = power * direction.z;
        (kept, all) = (kept + light * visible, all + light);
    }
    Some(kept / all)
}

/// Goal: two lights whose shadows overlap (hard case 32): two hot texels of unequal strength over black. Where the sphere
/// hides one sun, the floor keeps the other's share; where it hides both, nothing; elsewhere everything.
#[test]
fn two_lights_whose_shadows_overlap() {
    let (width, height) = (256, 128);
    let mut image = Image::zeros(width, height, 3);
    let mut suns = [(Vec3::Z, 0.0); 2];
    for (sun, (column, row, radiance)) in suns.iter_mut().zip([(60, 24, 3e4), (90, 30, 1e4)]) {
        image.pixel_mut(column, row).fill(radiance);
        let direction = comgs_geom::equirect::texel_direction(column, row, width, height);
        *sun = (direction, radiance * comgs_geom::equirect::texel_solid_angle(row, width, height));
    }
    let sky = EnvironmentSampler::new(&EnvironmentMap::from_image(&image).unwrap());
    let config = ComposeConfig {
        shadow: Some(ShadowConfig { rays: 256, denoise: Denoise::Off, ..ShadowConfig::default() }),
        ..ComposeConfig::default()
    };
    let camera = camera(128, 96);
    let place = at(0.0, 0.0, 0.7, 1.0);
    let frame = compose(&floor(), &[(&ball([0.8, 0.2, 0.2]), place)], &camera, &sky, config);
    let share = suns[0].1 * suns[0].0.z / suns.map(|(d, e)| e * d.z).iter().sum::<f32>();
    let mut seen = [0usize; 4];
    for y in 0..camera.height {
        for x in 0..camera.width {
            let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            let t = -camera.centre().z / ray.z;
            let p = (camera.centre() + ray * t).as_vec3();
            // Receivers on the floor only.
            if !(t > 0.0) || p.abs().max_element() > 3.5 {
                continue;
            }
            let Some(expected) = two_suns_on_paper(p, place.translation.as_vec3(), &suns) else { continue };
            let kind = [0.0, 1.0 - share, share, 1.0].iter().position(|v| (v - expected).abs() < 1e-4);
            seen[kind.unwrap()] += 1;
            for c in 0..3 {
                let s = frame.shadow.pixel(x, y)[c];
                // 128 samples of two texels split between them to about one in 128; a surfel ball lets 3 % through.
                assert!((s - expected).abs() < 0.04, "({x}, {y}) {p}: {s}, on paper {expected}");
            }
        }
    }
    assert!(seen.iter().all(|n| *n > 15), "both, either and no shadow: {seen:?} pixels");
}

/// Goal: two objects that shadow the scene at once: where both stand in the light's way their visibilities multiply (hard
/// case 32).
#[test]
fn visibilities_of_two_objects_multiply() {
    let pane = |alpha: f32| {
        let mut cloud = empty();
        for i in 0..400 {
            let p = Vec3::new((i % 20) as f32 - 9.5, (i / 20) as f32 - 9.5, 0.0) * 0.06;
            push(&mut cloud, p, Vec3::Z, 0.06, alpha, [0.5; 3]);
        }
        cloud
    };
    let (thin, thick) = (pane(0.05), pane(0.12));
    let config = ComposeConfig {
        shadow: Some(ShadowConfig { rays: 8, denoise: Denoise::Off, ..ShadowConfig::default() }),
        ..ComposeConfig::default()
    };
    let camera = camera(64, 48);
    let shadow = |objects: &[(&SurfelCloud, Similarity)]| {
        compose(&floor(), objects, &camera, &Zenith, config.clone()).shadow
    };
    let (a, b) = (at(0.0, 0.0, 1.0, 1.0), at(0.35, 0.1, 2.0, 1.0));
    let (first, second) = (shadow(&[(&thin, a)]), shadow(&[(&thick, b)]));
    let both = shadow(&[(&thin, a), (&thick, b)]);
    let mut overlap = 0;
    for ((s, x), y) in both.data.iter().zip(&first.data).zip(&second.data) {
        // The same light samples and a product of the same factors, in another order.
        assert!((s - x * y).abs() < 1e-4, "{s} is not {x} × {y}");
        overlap += usize::from((0.2..0.9).contains(x) && (0.2..0.9).contains(y));
    }
    assert!(overlap > 60, "{overlap} samples in both shadows");
}

/// Goal: on real surfels the placement check finds the floor, floating, sunk and unobserved (hard case 33).
#[test]
fn placements_are_checked_against_the_traced_scene() {
    let tracer = Tracer::new(&floor(), &TraceConfig::default()).unwrap();
    let check = |x: f64, z: f64| {
        let base = DVec3::new(x, 0.0, z);
        check_placement(&tracer, base, DVec3::Z, 0.25, 0.5, None, &PlacementConfig::default())
    };
    let standing = check(0.0, 0.0);
    assert!(standing.warnings.is_empty(), "{standing:?}");
    assert!(standing.ground_normal.unwrap().dot(DVec3::Z) > 0.999);
    assert!(check(0.0, 0.2).warnings[0].contains("floats"));
    assert!(check(0.0, -0.2).warnings[0].contains("sunk"));
    assert!(check(30.0, 0.0).warnings[0].contains("mid-air"));
}

/// Goal: the check that debug builds run after every frame names the first plane and pixel that went wrong, and is silent on
/// a sound frame.
#[test]
fn the_first_value_that_went_wrong_is_named() {
    let (scene, ball) = (floor(), ball([0.8, 0.2, 0.2]));
    let camera = camera(40, 30);
    let mut frame = compose(&scene, &[(&ball, at(0.0, 0.0, 0.5, 1.0))], &camera, &Sky, few_rays());
    assert_eq!(frame.first_non_finite(), None);
    frame.beauty.pixel_mut(3, 4)[2] = f32::INFINITY;
    frame.shadow.pixel_mut(7, 5)[1] = f32::NAN;
    let text = frame.first_non_finite().unwrap();
    assert_eq!(text, "plane shadow is NaN at pixel (7, 5), channel 1");
}
