//! The path tracer against answers known on paper.

use comgs_geom::{Camera, Rng, Similarity, equirect};
use comgs_image::Image;
use comgs_synth::brdf::Brdf;
use comgs_synth::environment::Environment;
use comgs_synth::film::{self, Film};
use comgs_synth::material::{Material, Pattern};
use comgs_synth::produce::cameras_json;
use comgs_synth::recipe::PartRecipe;
use comgs_synth::shape::{Limb, Placement, Shape};
use comgs_synth::world::{Part, World};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

fn part(shape: Shape, material: Material, at: [f32; 3], turn_deg: [f32; 3]) -> Part {
    PartRecipe { shape, material, placement: Placement { at, turn_deg, scale: 1.0 } }.build()
}

fn matte(albedo: f32) -> Material {
    Material::plain([albedo; 3], 0.5, 0.0).lambert()
}

fn constant(radiance: f32) -> Environment {
    Environment::new(Image::filled(16, 8, 3, radiance))
}

fn floor(albedo: f32) -> Part {
    part(Shape::Rectangle { size: [200.0, 200.0] }, matte(albedo), [0.0; 3], [0.0; 3])
}

/// The mean over a small picture of one point, seen through a narrow lens.
fn look(world: &World, eye: DVec3, target: DVec3, hfov_rad: f64, samples: u32) -> (Film, [f64; 3]) {
    let camera = Camera::look_at("a", 16, 16, hfov_rad, eye, target, DVec3::new(0.1, 0.3, 1.0));
    let film = film::render(world, &camera, samples, 5);
    let mean = std::array::from_fn(|c| {
        film.color.data.iter().skip(c).step_by(3).map(|&v| f64::from(v)).sum::<f64>()
            / film.color.pixels() as f64
    });
    (film, mean)
}

/// Goal: a Lambert plane under a constant sky L gives back L·albedo: π·L irradiance times albedo/π.
#[test]
fn plane_under_a_constant_sky() {
    let world = World::new(&[floor(0.6)], constant(2.0), 1);
    let (film, mean) = look(&world, DVec3::new(0.5, 0.2, 2.0), DVec3::ZERO, 0.1, 64);
    assert!((mean[0] - 1.2).abs() < 0.004, "{mean:?}");
    assert!(film.coverage.data.iter().all(|&c| c == 1.0));
}

/// Goal: white furnace. A convex Lambert body in a constant world shows its albedo, at the rim too.
#[test]
fn lambert_sphere_in_a_furnace() {
    let world =
        World::new(&[part(Shape::Sphere { radius: 1.0 }, matte(0.8), [0.0; 3], [0.0; 3])], constant(1.0), 1);
    let (film, _) = look(&world, DVec3::new(4.0, 1.0, 0.5), DVec3::ZERO, 0.4, 128);
    let (mut sum, mut n) = (0.0, 0);
    for (i, &c) in film.coverage.data.iter().enumerate() {
        if c == 1.0 {
            sum += f64::from(film.straight.data[3 * i]);
            n += 1;
        }
    }
    assert!(n > 100);
    assert!((sum / f64::from(n) - 0.8).abs() < 0.004, "{}", sum / f64::from(n));
}

/// Goal: white rough metal in a furnace shows the directional albedo of its BRDF, found by quadrature: the joint
/// light and BRDF sampling neither loses nor counts twice.
#[test]
fn metal_in_a_furnace_shows_its_directional_albedo() {
    let roughness = 0.6;
    let world = World::new(
        &[part(
            Shape::Rectangle { size: [200.0, 200.0] },
            Material::plain([0.98; 3], roughness, 1.0),
            [0.0; 3],
            [0.0; 3],
        )],
        constant(1.0),
        1,
    );
    for eye in [DVec3::new(0.0, 0.01, 3.0), DVec3::new(3.0, 0.0, 1.0)] {
        let (_, mean) = look(&world, eye, DVec3::ZERO, 0.02, 128);
        let brdf = Brdf { albedo: Vec3::splat(0.98), roughness, metallic: 1.0, matte: false };
        let cos = (eye.z / eye.length()) as f32;
        let out = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        let (mut expected, n) = (0.0, 400);
        for i in 0..n {
            for j in 0..n {
                let z = (i as f32 + 0.5) / n as f32;
                let azimuth = (j as f32 + 0.5) / n as f32 * std::f32::consts::TAU;
                let r = (1.0 - z * z).sqrt();
                let light = Vec3::new(r * azimuth.cos(), r * azimuth.sin(), z);
                expected += f64::from(brdf.eval(out, light).x * z) * 2.0 * PI / f64::from(n * n);
            }
        }
        assert!((mean[0] - expected).abs() < 0.005 * expected, "{mean:?}, on paper {expected}");
        assert!(mean[0] < 1.0);
    }
}

/// Goal: inside a closed room whose walls shine with e and reflect a, radiance is e/(1 − a): all bounces count, and
/// roulette and lamp sampling are unbiased.
#[test]
fn closed_room_has_every_bounce() {
    let mut walls = Vec::new();
    let wall = Material { emission: [1.0, 0.5, 0.0], ..matte(0.5) };
    // A rectangle faces +z; turned so that it faces the centre from each side.
    for (at, turn) in [
        ([0.0, 0.0, -1.0], [0.0, 0.0, 0.0]),
        ([0.0, 0.0, 1.0], [180.0, 0.0, 0.0]),
        ([0.0, 1.0, 0.0], [90.0, 0.0, 0.0]),
        ([0.0, -1.0, 0.0], [-90.0, 0.0, 0.0]),
        ([-1.0, 0.0, 0.0], [0.0, 90.0, 0.0]),
        ([1.0, 0.0, 0.0], [0.0, -90.0, 0.0]),
    ] {
        walls.push(part(Shape::Rectangle { size: [2.0, 2.0] }, wall.clone(), at, turn));
    }
    let world = World::new(&walls, constant(0.0), 1);
    let (film, mean) = look(&world, DVec3::new(0.1, 0.2, 0.0), DVec3::new(1.0, 0.1, 0.2), 1.2, 256);
    assert!(film.coverage.data.iter().all(|&c| c == 1.0), "the room leaks");
    for (got, expected) in mean.iter().zip([2.0, 1.0, 0.0]) {
        assert!((got - expected).abs() <= 0.01 * expected, "{mean:?}");
    }
}

/// Goal: a black sphere of radius r at distance d takes (r/d)²·cos θ of a plane's irradiance (θ from the normal), as long
/// as it is above the horizon; below it, and beside it.
#[test]
fn occlusion_by_a_sphere() {
    let (r, h) = (0.5f64, 1.25f64);
    let ball = part(
        Shape::Sphere { radius: r as f32 },
        Material::plain([0.0; 3], 0.5, 0.0).lambert(),
        [0.0, 0.0, h as f32],
        [0.0; 3],
    );
    let world = World::new(&[floor(0.9), ball], constant(1.0), 1);
    for x in [0.0, 0.8, 2.5] {
        let d2 = h * h + x * x;
        let expected = 0.9 * (1.0 - r * r / d2 * (h / d2.sqrt()));
        // Seen from the side at a distance, through a lens so narrow that the point is a point.
        let target = DVec3::new(x, 0.0, 0.0);
        let (_, mean) = look(&world, target + DVec3::new(0.0, 3.0, 0.9), target, 0.004, 256);
        assert!((mean[0] - expected).abs() < 0.004, "at {x}: {}, on paper {expected}", mean[0]);
    }
}

/// Goal: a square lamp over a plane gives the irradiance of its form factor (Hamilton and Morgan's parallel rectangle).
#[test]
fn irradiance_of_a_square_lamp() {
    let (side, height, radiance) = (1.0f64, 1.5f64, 4.0f64);
    let lamp = part(
        Shape::Rectangle { size: [side as f32; 2] },
        Material { emission: [radiance as f32; 3], ..matte(0.0) },
        [0.0, 0.0, height as f32],
        [180.0, 0.0, 0.0],
    );
    let world = World::new(&[floor(0.7), lamp], constant(0.0), 1);
    let a = 0.5 * side / height;
    let root = (1.0 + a * a).sqrt();
    let quarter = 2.0 / (2.0 * PI) * (a / root * (a / root).atan());
    let expected = 0.7 * radiance * 4.0 * quarter;
    let (_, mean) = look(&world, DVec3::new(0.0, 2.5, 0.6), DVec3::ZERO, 0.004, 256);
    // The lamp reflects nothing, so there is no second bounce.
    assert!((mean[0] - expected).abs() < 0.01 * expected, "{}, on paper {expected}", mean[0]);
}

/// Goal: a glossy floor under a sky with one hot texel: the jointly sampled light equals a quadrature of the rendering
/// equation over the map.
#[test]
fn hot_texel_on_a_glossy_floor() {
    let mut map = Image::filled(64, 32, 3, 0.1);
    map.pixel_mut(32, 8).copy_from_slice(&[400.0, 300.0, 200.0]);
    let environment = Environment::new(map);
    let material = Material::plain([0.5, 0.4, 0.3], 0.4, 0.3);
    let world = World::new(
        &[part(Shape::Rectangle { size: [200.0, 200.0] }, material, [0.0; 3], [0.0; 3])],
        environment.clone(),
        1,
    );
    let eye = DVec3::new(-1.5, 0.3, 1.6);
    let (_, mean) = look(&world, eye, DVec3::ZERO, 0.01, 256);
    let brdf = Brdf { albedo: Vec3::new(0.5, 0.4, 0.3), roughness: 0.4, metallic: 0.3, matte: false };
    let out = eye.normalize().as_vec3();
    let (mut expected, n) = (0.0f64, 1024);
    for y in 0..n / 2 {
        let solid = f64::from(equirect::texel_solid_angle(y, 2 * n, n));
        for x in 0..2 * n {
            let light = equirect::texel_direction(x, y, 2 * n, n);
            expected += f64::from(brdf.eval(out, light).x * environment.radiance(light).x * light.z) * solid;
        }
    }
    assert!((mean[0] - expected).abs() < 0.01 * expected, "{}, by quadrature {expected}", mean[0]);
}

/// Goal: depth, normal and coverage of a sphere are the analytic ones.
#[test]
fn planes_of_a_sphere() {
    let material = Material::mixed([0.3; 3], [0.3; 3], 0.25, Pattern::Plain);
    let world =
        World::new(&[part(Shape::Sphere { radius: 0.8 }, material, [0.0; 3], [0.0; 3])], constant(1.0), 1);
    let (size, hfov, d) = (64usize, 0.6f64, 3.0f64);
    let camera = Camera::look_at("a", size, size, hfov, DVec3::new(0.0, -d, 0.0), DVec3::ZERO, DVec3::Z);
    let film = film::render(&world, &camera, 16, 1);
    // The silhouette is a circle of radius f·r/√(d² − r²).
    let radius = camera.fx * 0.8 / (d * d - 0.64).sqrt();
    let area: f64 = film.coverage.data.iter().map(|&c| f64::from(c)).sum();
    assert!((area / (PI * radius * radius) - 1.0).abs() < 0.01, "{area}");
    let mut checked = 0;
    for y in 0..size {
        for x in 0..size {
            let depth = f64::from(film.depth.pixel(x, y)[0]);
            let p = camera.unproject(x as f64 + 0.5, y as f64 + 0.5, depth);
            if depth == 0.0 {
                assert!(film.coverage.pixel(x, y)[0] < 1.0);
                continue;
            }
            assert!((p.length() - 0.8).abs() < 4e-3, "({x}, {y}) is {} from the centre", p.length());
            // Near the rim the pixel's mean normal is not that of its centre.
            if film.coverage.pixel(x, y)[0] == 1.0 && p.normalize().dot(-camera.forward()) > 0.4 {
                let n = Vec3::from_slice(film.normal.pixel(x, y)).as_dvec3();
                assert!(n.angle_between(p).to_degrees() < 1.0, "({x}, {y})");
                assert!((film.roughness.pixel(x, y)[0] - 0.25).abs() < 1e-5);
                assert!((film.albedo.pixel(x, y)[1] - 0.3).abs() < 1e-5);
                checked += 1;
            }
        }
    }
    assert!(checked > 800);
}

/// Goal: whatever is hit from wherever, the face normal looks at the viewer, shading and face normals agree on the side,
/// and no closed shape shows its inside to a viewer outside.
#[test]
fn normals_face_the_viewer() {
    let shapes = [
        Shape::Sphere { radius: 0.7 },
        Shape::Box { size: [1.0, 0.6, 0.8], rounding: 0.1 },
        Shape::Box { size: [1.0, 0.6, 0.8], rounding: 0.0 },
        Shape::Cylinder { radius: 0.4, height: 1.0 },
        Shape::TorusKnot { turns: 2, twists: 3, radius: 0.5, swing: 0.2, tube: 0.1 },
        Shape::Blob {
            limbs: vec![
                Limb { from: [-0.4, 0.0, 0.0], to: [0.4, 0.1, 0.0], radius: [0.3, 0.2] },
                Limb { from: [0.4, 0.1, 0.0], to: [0.5, 0.1, 0.5], radius: [0.15, 0.1] },
            ],
            blend: 0.1,
            cells: 40,
        },
    ];
    let mut rng = Rng::new(4);
    for shape in shapes {
        let world = World::new(
            &[part(shape.clone(), matte(0.5), [0.1, 0.2, 0.3], [20.0, 40.0, 60.0])],
            constant(1.0),
            1,
        );
        let mut hits = 0;
        for _ in 0..4000 {
            let mut random = || Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0));
            let origin = random().normalize_or(Vec3::X) * 3.0;
            let direction = (0.6 * random() - origin).normalize();
            let Some(hit) = world.intersect(origin, direction) else { continue };
            hits += 1;
            assert!(hit.front, "{shape:?} shows its inside");
            assert!(hit.face_normal.dot(direction) < 0.0);
            assert!(hit.normal.dot(hit.face_normal) > 0.2);
            assert!(hit.shading_normal.dot(-direction) > 0.015);
            // At grazing incidence f32 knows the distance less well than the place on the triangle.
            assert!((hit.position - origin - direction * hit.distance).length() < 2e-3);
        }
        assert!(hits > 500, "{shape:?} is hit {hits} times only");
    }
}

/// Goal: the convention of the data's README, end to end. A red patch painted in the map along d is what a camera aimed
/// along d sees in its middle, and what a panorama of the empty world shows at the same texel.
#[test]
fn a_red_patch_is_seen_where_it_was_painted() {
    let (w, h) = (64, 32);
    for (column, row) in [(10, 9), (40, 20), (63, 16), (16, 3)] {
        let mut map = Image::filled(w, h, 3, 0.1);
        for dy in -1i64..=1 {
            for dx in -1i64..=1 {
                let x = (column as i64 + dx).rem_euclid(w as i64) as usize;
                map.pixel_mut(x, (row as i64 + dy) as usize).copy_from_slice(&[5.0, 0.0, 0.0]);
            }
        }
        // The README's own formula, not the library's.
        let phi = PI * (1.0 - 2.0 * (column as f64 + 0.5) / w as f64);
        let theta = PI * (0.5 - (row as f64 + 0.5) / h as f64);
        let d = DVec3::new(phi.cos() * theta.cos(), phi.sin() * theta.cos(), theta.sin());
        let world = World::new(&[], Environment::new(map.clone()), 1);
        let camera = Camera::look_at("a", 33, 33, 1.2, DVec3::ONE, DVec3::ONE + d, DVec3::Z);
        let film = film::render(&world, &camera, 4, 1);
        assert!(film.color.rgb(16, 16)[0] > 4.9, "{column} {row}: {:?}", film.color.rgb(16, 16));
        assert!(film.color.rgb(16, 16)[1] < 0.01 && film.color.rgb(0, 0)[0] < 0.2);
        let panorama = film::panorama(&world, Vec3::ONE, h, 16, 1);
        assert!(panorama.rgb(column, row)[0] > 4.9);
        let far = ((column + 20) % w, (row + 12) % h);
        assert!((panorama.rgb(far.0, far.1)[1] - 0.1).abs() < 1e-3);
    }
}

/// Goal: `cameras.json` projects by the README's formula to where the camera itself projects.
#[test]
fn cameras_json_follows_the_readme() {
    let camera = Camera::look_at(
        "00007",
        128,
        72,
        1.1,
        DVec3::new(1.0, -2.0, 1.5),
        DVec3::new(0.1, 0.3, 0.4),
        DVec3::Z,
    );
    let json = cameras_json(std::slice::from_ref(&camera));
    let entry = &json["cameras"]["0"];
    assert_eq!(entry["name"], "00007");
    let number = |key: &str, i: usize| entry[key][i].as_f64().unwrap();
    let p_world = [0.3, 0.1, 0.9];
    // p = inv(extr) P: the pose is rigid, so its inverse is the transpose of the rotation.
    let offset: Vec<f64> = (0..3).map(|r| p_world[r] - number("extr", 4 * r + 3)).collect();
    let p: Vec<f64> = (0..3).map(|c| (0..3).map(|r| number("extr", 4 * r + c) * offset[r]).sum()).collect();
    let u = number("intr", 2) + number("intr", 0) * p[0] / -p[2];
    let v = number("intr", 3) - number("intr", 1) * p[1] / -p[2];
    let (expected, _) = camera.project(DVec3::from(p_world)).unwrap();
    assert!((u - expected.x).abs() < 1e-9 && (v - expected.y).abs() < 1e-9, "({u}, {v}) and {expected}");
    assert_eq!((0..4).map(|i| number("extr", 12 + i)).collect::<Vec<_>>(), [0.0, 0.0, 0.0, 1.0]);
}

/// Goal: with common random numbers a composed frame is the empty frame, bit for bit, wherever no path meets the object:
/// all of the sky, and most of a floor that reaches far beyond it. Where the object is, the frames differ.
#[test]
fn composition_equals_the_empty_frame_elsewhere() {
    let scene = [floor(0.5)];
    let object = part(
        Shape::Sphere { radius: 0.3 },
        Material::plain([0.7, 0.2, 0.1], 0.3, 0.0).lambert(),
        [0.0, 0.0, 0.3],
        [0.0; 3],
    )
    .moved(&Similarity::IDENTITY, true);
    let mut map = Image::filled(32, 16, 3, 0.4);
    map.pixel_mut(8, 4).fill(80.0);
    let empty = World::new(&scene, Environment::new(map.clone()), 1);
    let full = World::new(&[scene[0].clone(), object], Environment::new(map), 1);
    let camera =
        Camera::look_at("a", 96, 54, 1.2, DVec3::new(2.5, 0.4, 1.4), DVec3::new(0.0, 0.0, 0.5), DVec3::Z);
    let (a, b) = (film::render(&full, &camera, 16, 9), film::render(&empty, &camera, 16, 9));
    let (mut same, mut sky, mut object) = (0, 0, 0);
    for i in 0..96 * 54 {
        let equal = a.color.data[3 * i..3 * i + 3] == b.color.data[3 * i..3 * i + 3];
        if b.coverage.data[i] == 0.0 && a.mask.data[i] == 0.0 {
            sky += 1;
            assert!(equal, "the sky changed at pixel {i}");
        }
        if a.mask.data[i] == 1.0 {
            object += 1;
            assert!(!equal);
        }
        same += usize::from(equal);
    }
    assert!(sky > 200 && object > 60, "{sky} {object}");
    assert!(same > 96 * 54 / 2, "only {same} pixels are unchanged");
    assert!(b.mask.data.iter().all(|&m| m == 0.0));
    // Beside the object on the sunny side it takes (r/d)²·cos θ = 1.4 % of the sky's part, and gives some of it back.
    let (pixel, _) = camera.project(DVec3::new(0.2, 1.2, 0.0)).unwrap();
    let at = |f: &Film| -> f32 {
        // A patch: a single pixel at 16 samples is noise.
        let (x, y) = (pixel.x as usize, pixel.y as usize);
        (0..49).map(|k| f.color.rgb(x + k % 7 - 3, y + k / 7 - 3)[0]).sum()
    };
    let ratio = at(&a) / at(&b);
    assert!((ratio - 1.0).abs() < 0.025, "{ratio}");
}

/// Goal: the same bytes at 1 and at 3 threads; another seed gives other bytes.
#[test]
fn same_bytes_at_any_thread_count() {
    let recipe = comgs_synth::builtin::recipe("micro").unwrap();
    let parts = comgs_synth::produce::build(&recipe.scenes[0].parts);
    let camera = recipe.scenes[0].rig.test(1, (32, 18)).remove(0);
    let with = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let world = comgs_synth::produce::scene_world(&recipe, &parts, &recipe.scenes[0].light, None);
            film::render(&world, &camera, 4, seed).color
        })
    };
    let one = with(1, 3);
    assert_eq!(one, with(3, 3));
    assert_ne!(one, with(3, 4));
    assert_eq!(one.non_finite(), 0);
}
