//! Up by a photo's edges, against cameras that are known: rooms from the path tracer of `comgs-synth`.

mod support;

use comgs_geom::Camera;
use comgs_insert::horizon::upright;
use comgs_synth::environment::Environment;
use comgs_synth::film;
use comgs_synth::material::{Material, Pattern};
use comgs_synth::recipe::PartRecipe;
use comgs_synth::shape::Shape;
use comgs_synth::world::World;
use glam::{DMat3, DVec3, Vec3};
use support::{enlarged, part, sunny};

/// A tiled floor, two walls with a picture and a window's frame, furniture, and two things that are round.
fn room() -> Vec<PartRecipe> {
    let solid = |size: [f32; 3], at: [f32; 3], color: [f32; 3]| {
        part(Shape::Box { size, rounding: 0.0 }, at, color, 0.9, 0.0)
    };
    let mut floor = part(Shape::Rectangle { size: [12.0, 12.0] }, [2.0, 0.0, 0.0], [0.6; 3], 1.0, 0.0);
    floor.material = Material::mixed(
        [0.62, 0.58, 0.5],
        [0.5, 0.45, 0.38],
        0.9,
        Pattern::Tiles { size: [0.5, 0.5], gap: 0.03, shift: 0.0 },
    );
    let mut parts = vec![
        floor,
        solid([0.2, 12.0, 3.0], [6.0, 0.0, 1.5], [0.75, 0.72, 0.66]),
        solid([12.0, 0.2, 3.0], [2.0, 3.0, 1.5], [0.55, 0.62, 0.68]),
        solid([0.1, 1.6, 1.0], [5.87, -0.8, 1.7], [0.2, 0.25, 0.3]),
        solid([1.2, 0.1, 1.4], [3.2, 2.88, 1.6], [0.85, 0.85, 0.8]),
        solid([0.9, 0.5, 0.75], [4.2, -1.4, 0.375], [0.5, 0.3, 0.18]),
        solid([0.5, 0.9, 1.8], [5.2, 1.9, 0.9], [0.4, 0.25, 0.15]),
        solid([0.35, 0.35, 0.45], [3.1, 0.6, 0.225], [0.7, 0.2, 0.15]),
        part(Shape::Sphere { radius: 0.3 }, [3.6, -0.3, 0.3], [0.2, 0.5, 0.3], 0.8, 0.0),
        part(Shape::Cylinder { radius: 0.15, height: 0.5 }, [2.7, 1.4, 0.25], [0.8, 0.7, 0.3], 0.8, 0.0),
    ];
    // Furniture stands askew, as it does.
    parts[7].placement.turn_deg[2] = 25.0;
    parts
}

/// Goal: the normal of the ground is found to 2° in rendered rooms at known pitch and roll, and the photo of a lawn of noise under a
/// smooth sky is not believed to tell it.
#[test]
fn rooms_of_known_cameras() {
    let light = sunny(16, Vec3::new(-0.6, -0.5, 0.8), 6.0);
    let world = |parts: &[PartRecipe]| {
        let built: Vec<_> = parts.iter().map(PartRecipe::build).collect();
        World::new(&built, Environment::new(enlarged(&light)), 2)
    };
    let furnished = world(&room());
    let eye = DVec3::new(0.0, -0.4, 1.5);
    let camera = |pitch: f64, roll: f64, heading: f64| {
        let (s, c) = pitch.to_radians().sin_cos();
        let ahead = DMat3::from_rotation_z(heading.to_radians()) * DVec3::new(c, 0.0, s);
        let mut camera = Camera::look_at("photo", 480, 320, 1.1, eye, eye + ahead, DVec3::Z);
        camera.world_from_camera.matrix3 *= DMat3::from_rotation_z(roll.to_radians());
        camera
    };
    let cases =
        [(0.0, 0.0, 10.0), (-12.0, 5.0, 25.0), (-25.0, -8.0, 0.0), (6.0, 12.0, 35.0), (-15.0, 0.0, -20.0)];
    for (pitch, roll, heading) in cases {
        let camera = camera(pitch, roll, heading);
        let photo = film::render(&furnished, &camera, 24, 7).color.map(|v| v.clamp(0.0, 1.0));
        let found = upright(&photo, &camera).unwrap();
        let up = camera.camera_from_world().transform_vector3(DVec3::Z);
        let error = DVec3::from_array(found.normal).angle_between(up).to_degrees();
        println!("pitch {pitch}°, roll {roll}°: off by {error:.2}°, {found:?}");
        assert!(found.is_sure() && error < 2.0, "pitch {pitch}, roll {roll}: {error:.2}°");
    }
    let mut lawn = part(Shape::Rectangle { size: [40.0, 40.0] }, [0.0; 3], [0.2; 3], 1.0, 0.0);
    lawn.material =
        Material::mixed([0.1, 0.3, 0.05], [0.3, 0.4, 0.1], 1.0, Pattern::Noise { size: 0.3, contrast: 6.0 });
    let camera = camera(-10.0, 6.0, 0.0);
    let photo = film::render(&world(&[lawn]), &camera, 24, 7).color.map(|v| v.clamp(0.0, 1.0));
    let found = upright(&photo, &camera);
    println!("lawn: {found:?}");
    assert!(found.is_none_or(|f| !f.is_sure()));
}
