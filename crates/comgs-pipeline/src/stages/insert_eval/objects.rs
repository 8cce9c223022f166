//! The objects of the benchmark, from `comgs-synth`'s shapes.

use comgs_scene::{Mesh, MeshMaterial};
use comgs_synth::shape::{Placement, Shape};
use glam::{Vec2, Vec3};

/// Object number `k`, in turn: its name and mesh, about a metre large.
pub(super) fn object(k: usize) -> (&'static str, Mesh) {
    let part = |shape: Shape, at: [f32; 3], albedo: Vec3, roughness: f32, metallic: f32| {
        (shape, at, MeshMaterial { albedo, roughness, metallic, ..MeshMaterial::default() })
    };
    let (name, parts) = match k % 3 {
        0 => (
            "spheres, matte and mirror",
            vec![
                part(Shape::Sphere { radius: 0.42 }, [0.0, 0.45, 0.42], Vec3::splat(0.6), 0.9, 0.0),
                part(Shape::Sphere { radius: 0.42 }, [0.0, -0.45, 0.42], Vec3::splat(0.85), 0.12, 1.0),
            ],
        ),
        1 => (
            "glossy knot",
            vec![part(
                Shape::TorusKnot { turns: 2, twists: 3, radius: 0.38, swing: 0.16, tube: 0.1 },
                [0.0, 0.0, 0.6],
                Vec3::new(0.7, 0.12, 0.08),
                0.25,
                0.0,
            )],
        ),
        _ => (
            "box and copper cylinder",
            vec![
                part(
                    Shape::Box { size: [0.6, 0.5, 0.9], rounding: 0.04 },
                    [0.0, 0.35, 0.45],
                    Vec3::new(0.75, 0.7, 0.62),
                    0.7,
                    0.0,
                ),
                part(
                    Shape::Cylinder { radius: 0.22, height: 0.7 },
                    [-0.1, -0.4, 0.35],
                    Vec3::new(0.93, 0.6, 0.45),
                    0.3,
                    1.0,
                ),
            ],
        ),
    };
    let mut mesh = Mesh::default();
    for (shape, at, material) in parts {
        append(&mut mesh, &shape, Placement { at, ..Placement::default() }, material);
    }
    (name, mesh)
}

fn append(mesh: &mut Mesh, shape: &Shape, placement: Placement, material: MeshMaterial) {
    let (part, first) = (shape.mesh(), mesh.positions.len() as u32);
    let place = placement.similarity();
    let rotation = place.rotation.as_quat();
    mesh.positions.extend(part.positions.iter().map(|p| place.transform_point(p.as_dvec3()).as_vec3()));
    mesh.normals.extend(part.normals.iter().map(|n| rotation * *n));
    mesh.uvs.extend(part.positions.iter().map(|_| Vec2::ZERO));
    mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + first)));
    mesh.material_of.extend(part.triangles.iter().map(|_| mesh.materials.len() as u32));
    mesh.materials.push(material);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every object is a sound mesh of about a metre that stands on the ground.
    #[test]
    fn objects_are_sound() {
        for k in 0..3 {
            let (name, mesh) = object(k);
            let mut problems = Vec::new();
            mesh.check(&mut problems);
            assert!(problems.is_empty(), "{name}: {problems:?}");
            let (low, high) = mesh.bounds().unwrap();
            assert!((high - low).max_element() < 2.0 && (high - low).min_element() > 0.3, "{name}");
        }
    }
}
