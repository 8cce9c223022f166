//! Wavefront OBJ with MTL materials.

use super::{Mesh, MeshMaterial, Up, texture, z_up};
use crate::SceneError;
use glam::{Vec2, Vec3};
use std::path::Path;

pub(super) fn parse(
    bytes: &[u8],
    path: &Path,
    up: Up,
    problems: &mut Vec<String>,
) -> Result<Mesh, SceneError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let options = tobj::LoadOptions { single_index: true, triangulate: true, ..Default::default() };
    let (models, materials) = tobj::load_obj_buf(&mut &*bytes, &options, |mtl| {
        let bytes = std::fs::read(folder.join(mtl)).map_err(|_| tobj::LoadError::OpenFileFailed)?;
        tobj::load_mtl_buf(&mut bytes.as_slice())
    })
    .map_err(|e| SceneError::malformed(path, format!("not an OBJ file: {e}")))?;
    let mut mesh = Mesh::default();
    mesh.materials.push(MeshMaterial { name: "(default)".into(), ..MeshMaterial::default() });
    match materials {
        Ok(materials) => {
            for m in &materials {
                mesh.materials.push(material(m, folder, problems));
            }
        }
        Err(e) => problems.push(format!("the material library: {e}")),
    }
    let count = mesh.materials.len() as u32;
    let turn = |p: [f32; 3]| if up == Up::Y { z_up(p) } else { Vec3::from_array(p) };
    for model in &models {
        let m = &model.mesh;
        let triple = |column: &[f32], i: u32| {
            let i = 3 * i as usize;
            turn([column[i], column[i + 1], column[i + 2]])
        };
        let corners = m.positions.len() / 3;
        let material = m.material_id.map_or(0, |i| i as u32 + 1).min(count - 1);
        let uv = |i: u32| match m.texcoords.get(2 * i as usize..2 * i as usize + 2) {
            Some(t) => Vec2::new(t[0], 1.0 - t[1]),
            None => Vec2::ZERO,
        };
        let first = mesh.positions.len() as u32;
        let smooth = m.normals.len() == m.positions.len();
        if smooth {
            for i in 0..corners as u32 {
                mesh.positions.push(triple(&m.positions, i));
                mesh.normals.push(triple(&m.normals, i).normalize_or(Vec3::Z));
                mesh.uvs.push(uv(i));
            }
        }
        for t in m.indices.chunks_exact(3) {
            let t = [t[0], t[1], t[2]];
            if t.iter().any(|&i| i as usize >= corners) {
                problems.push(format!("{}: an index beyond the corners", model.name));
                break;
            }
            if smooth {
                mesh.triangles.push(t.map(|i| i + first));
                mesh.material_of.push(material);
            } else {
                mesh.push_flat(t.map(|i| triple(&m.positions, i)), t.map(uv), material);
            }
        }
    }
    Ok(mesh)
}

/// Kd as base colour, `Pr` and `Pm` where the file has them; else roughness from the Phong exponent by equal lobes,
/// `α² = 2 / (Ns + 2)` (Walter et al. 2007), with `α = roughness²`.
fn material(m: &tobj::Material, folder: &Path, problems: &mut Vec<String>) -> MeshMaterial {
    let number = |name: &str| m.unknown_param.get(name).and_then(|v| v.trim().parse::<f32>().ok());
    let from_exponent = m.shininess.map(|ns| (2.0 / (ns.max(0.0) + 2.0)).powf(0.25));
    let albedo_map = m.diffuse_texture.as_ref().and_then(|name| {
        let file = folder.join(name);
        let read = std::fs::read(&file).map_err(|e| e.to_string()).and_then(|b| texture(&b, &file, false));
        read.map_err(|reason| problems.push(format!("{}: texture {name}: {reason}", m.name))).ok()
    });
    // A textured material usually states Kd 0 or 1 beside its map; black would hide the map.
    let kd = m.diffuse.map_or(Vec3::splat(0.8), Vec3::from_array);
    let albedo = if albedo_map.is_some() && kd == Vec3::ZERO { Vec3::ONE } else { kd };
    MeshMaterial {
        name: m.name.clone(),
        albedo,
        roughness: number("Pr").or(from_exponent).unwrap_or(0.9),
        metallic: number("Pm").unwrap_or(0.0),
        emission: m.emissive.map_or(Vec3::ZERO, Vec3::from_array),
        albedo_map,
        surface_map: None,
    }
}
