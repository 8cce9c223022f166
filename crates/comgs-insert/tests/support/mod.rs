//! Scenes that both this crate and its judge, the path tracer of `comgs-synth`, can hold.
#![allow(dead_code, reason = "every test program uses its own part")]

use comgs_geom::{Camera, Similarity};
use comgs_image::Image;
use comgs_insert::light::{Gaussian, Gaussians, LightMap};
use comgs_insert::object::Object;
use comgs_scene::{Mesh, MeshMaterial};
use comgs_synth::World;
use comgs_synth::environment::Environment;
use comgs_synth::material::Material;
use comgs_synth::recipe::PartRecipe;
use comgs_synth::shape::{Placement, Shape};
use glam::{DVec3, Vec3};

/// A shape of one plain material at a place.
pub fn part(shape: Shape, at: [f32; 3], color: [f32; 3], roughness: f32, metallic: f32) -> PartRecipe {
    PartRecipe {
        shape,
        material: Material::plain(color, roughness, metallic),
        placement: Placement { at, ..Placement::default() },
    }
}

/// The same parts as one mesh of this project.
pub fn mesh(parts: &[PartRecipe]) -> Mesh {
    let mut out = Mesh::default();
    for (k, recipe) in parts.iter().enumerate() {
        let part = recipe.build();
        let affine = part.placement.to_affine();
        let rotation = part.placement.rotation.as_quat();
        let first = out.positions.len() as u32;
        out.positions
            .extend(part.mesh.positions.iter().map(|p| affine.transform_point3(p.as_dvec3()).as_vec3()));
        out.normals.extend(part.mesh.normals.iter().map(|n| rotation * *n));
        out.uvs.extend(part.mesh.positions.iter().map(|_| glam::Vec2::ZERO));
        out.triangles.extend(part.mesh.triangles.iter().map(|t| t.map(|i| i + first)));
        out.material_of.extend(part.mesh.triangles.iter().map(|_| k as u32));
        let m = &recipe.material;
        out.materials.push(MeshMaterial {
            albedo: Vec3::from_array(m.a.color),
            roughness: m.a.roughness,
            metallic: m.a.metallic,
            emission: Vec3::from_array(m.emission),
            ..MeshMaterial::default()
        });
    }
    out
}

pub fn object(parts: &[PartRecipe]) -> Object {
    Object::mesh(&mesh(parts), &Similarity::IDENTITY).unwrap()
}

/// The judge's world: the parts, and the plane z = 0 under them where it is asked for.
pub fn world(parts: &[PartRecipe], plane: bool, light: &LightMap) -> World {
    let mut all: Vec<_> = parts.iter().map(|p| p.build().moved(&Similarity::IDENTITY, true)).collect();
    if plane {
        let mut ground = part(Shape::Rectangle { size: [60.0, 60.0] }, [0.0; 3], [0.5; 3], 1.0, 0.0);
        ground.material = ground.material.lambert();
        all.push(ground.build());
    }
    World::new(&all, Environment::new(enlarged(light)), 1)
}

/// The map with every texel sixteen times sixteen: the judge interpolates, this crate's texels are constant.
pub fn enlarged(light: &LightMap) -> Image {
    let image = light.to_image();
    let f = 16;
    let mut out = Image::zeros(image.width * f, image.height * f, 3);
    for y in 0..out.height {
        for x in 0..out.width {
            let value = image.rgb(x / f, y / f);
            out.pixel_mut(x, y).copy_from_slice(&value);
        }
    }
    out
}

/// A bluish sky, darker below, and a warm sun as wide as a fist at arm's length (σ = 0.12).
pub fn sunny(height: usize, sun: Vec3, strength: f32) -> LightMap {
    let lobe = |radiance: Vec3, direction: Vec3, sigma: f32| Gaussian { radiance, direction, sigma };
    let lobes = [
        lobe(Vec3::new(0.25, 0.32, 0.45), Vec3::Z, 1.0),
        lobe(Vec3::new(0.12, 0.11, 0.09), -Vec3::Z, 1.0),
        lobe(Vec3::new(1.0, 0.9, 0.75) * strength, sun.normalize(), 0.12),
    ];
    Gaussians::new(height, &lobes).rasterise()
}

pub fn camera(width: usize, height: usize) -> Camera {
    Camera::look_at(
        "photo",
        width,
        height,
        0.7,
        DVec3::new(-4.0, 0.0, 1.8),
        DVec3::new(0.0, 0.0, 0.45),
        DVec3::Z,
    )
}
