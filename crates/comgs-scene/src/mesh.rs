//! Triangle meshes with metallic-roughness materials: glTF 2.0 (`.gltf`, `.glb`) and Wavefront OBJ.

mod gltf;
mod obj;

use crate::SceneError;
use comgs_image::{Encoding, Image, transfer::srgb_from_linear};
use glam::{Vec2, Vec3};
use std::path::Path;

/// A mesh in its own space, z up. All columns are consistent and finite, and no triangle is degenerate: readers refuse
/// what is not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a corner.
    pub normals: Vec<Vec3>,
    /// Texture coordinates, one a corner, v down as images have it; 0 where the file has none.
    pub uvs: Vec<Vec2>,
    /// Three corners a triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Material of every triangle.
    pub material_of: Vec<u32>,
    /// Materials, at least one.
    pub materials: Vec<MeshMaterial>,
    /// What the file asks for and this project does not model, in words (normal maps, transparency).
    pub remarks: Vec<String>,
}

/// Metallic-roughness material: factors times textures.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshMaterial {
    /// Its name, for messages.
    pub name: String,
    /// Base colour, linear.
    pub albedo: Vec3,
    /// Perceptual roughness.
    pub roughness: f32,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Radiance sent out, linear.
    pub emission: Vec3,
    /// Base colour, linear, three channels.
    pub albedo_map: Option<Image>,
    /// Roughness in green, metalness in blue, values as stored (glTF's arrangement).
    pub surface_map: Option<Image>,
}

impl Default for MeshMaterial {
    /// Grey, matte.
    fn default() -> Self {
        Self {
            name: String::new(),
            albedo: Vec3::splat(0.8),
            roughness: 0.9,
            metallic: 0.0,
            emission: Vec3::ZERO,
            albedo_map: None,
            surface_map: None,
        }
    }
}

impl MeshMaterial {
    /// Base colour, roughness and metalness at texture coordinates, which repeat: factors times textures.
    #[must_use]
    pub fn at(&self, uv: Vec2) -> (Vec3, f32, f32) {
        let (albedo, roughness, metallic) = self.texel(uv);
        (
            (self.albedo * albedo).clamp(Vec3::ZERO, Vec3::ONE),
            (self.roughness * roughness).clamp(0.0, 1.0),
            (self.metallic * metallic).clamp(0.0, 1.0),
        )
    }

    /// Base colour, roughness and metalness of the textures at texture coordinates, which repeat; 1 where there is none.
    #[must_use]
    pub fn texel(&self, uv: Vec2) -> (Vec3, f32, f32) {
        let albedo = self.albedo_map.as_ref().map_or(Vec3::ONE, |map| bilinear(map, uv));
        let surface = self.surface_map.as_ref().map_or(Vec3::ONE, |map| bilinear(map, uv));
        (albedo, surface.y, surface.z)
    }
}

/// Bilinear look-up of a repeating texture of three channels.
fn bilinear(map: &Image, uv: Vec2) -> Vec3 {
    let (w, h) = (map.width, map.height);
    let place = |u: f32, n: usize| {
        let x = (u - u.floor()) * n as f32 - 0.5;
        let left = x.floor();
        let first = (left as isize).rem_euclid(n as isize) as usize;
        (first, (first + 1) % n, x - left)
    };
    let ((x0, x1, tx), (y0, y1, ty)) = (place(uv.x, w), place(uv.y, h));
    let at = |x, y| Vec3::from_array(map.rgb(x, y));
    at(x0, y0).lerp(at(x1, y0), tx).lerp(at(x0, y1).lerp(at(x1, y1), tx), ty)
}

/// Which axis of an OBJ points up; glTF says y itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Up {
    /// As most exporters write it.
    #[default]
    Y,
    /// As CAD programs do.
    Z,
}

/// File names that [`read_mesh`] takes, without the dot.
pub const EXTENSIONS: [&str; 3] = ["glb", "gltf", "obj"];

/// Whether a path is named like a mesh.
#[must_use]
pub fn is_mesh(path: &Path) -> bool {
    let name = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    EXTENSIONS.contains(&name.as_str())
}

/// Reads a mesh by its name's ending. Textures and buffers beside it are read too.
///
/// # Errors
/// [`SceneError`]: unreadable, broken, without triangles, or with any of: non-finite or degenerate triangles, indices
/// beyond the corners, textures that are missing or no images. All problems are listed at once.
pub fn read_mesh(path: &Path, up: Up) -> Result<Mesh, SceneError> {
    let bytes = std::fs::read(path).map_err(SceneError::io(path))?;
    let mut problems = Vec::new();
    let name = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let mesh = match name.as_str() {
        "glb" | "gltf" => gltf::parse(&bytes, path, &mut problems)?,
        "obj" => obj::parse(&bytes, path, up, &mut problems)?,
        other => {
            return Err(SceneError::malformed(
                path,
                format!("expected a mesh (.glb, .gltf or .obj), got .{other}"),
            ));
        }
    };
    mesh.check(&mut problems);
    if problems.is_empty() { Ok(mesh) } else { Err(SceneError::malformed(path, problems.join("; "))) }
}

/// Twice the area of a degenerate triangle, as a share of its longest side squared.
const DEGENERATE: f32 = 1e-7;

impl Mesh {
    /// Lowest and highest coordinates; `None` for an empty mesh.
    #[must_use]
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let first = *self.positions.first()?;
        Some(self.positions.iter().fold((first, first), |(lo, hi), &p| (lo.min(p), hi.max(p))))
    }

    /// Adds every problem of the triangles to `problems`, each kind once with how many there are and the first.
    pub fn check(&self, problems: &mut Vec<String>) {
        let (mut beyond, mut broken, mut flat) = (Vec::new(), Vec::new(), Vec::new());
        for (k, t) in self.triangles.iter().enumerate() {
            if t.iter().any(|&i| i as usize >= self.positions.len()) {
                beyond.push(k);
                continue;
            }
            let [a, b, c] = t.map(|i| self.positions[i as usize]);
            if ![a, b, c].iter().all(|p| p.is_finite() && p.abs().max_element() < 1e15) {
                broken.push(k);
                continue;
            }
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            if !((b - a).cross(c - a).length() > DEGENERATE * longest * longest) {
                flat.push(k);
            }
        }
        let kinds = [
            (beyond, "with indices beyond the corners"),
            (broken, "with non-finite corners"),
            (flat, "without area (degenerate)"),
        ];
        for (which, what) in kinds {
            if let Some(first) = which.first() {
                problems.push(format!(
                    "{} of {} triangles {what}, the first is number {first}",
                    which.len(),
                    self.triangles.len()
                ));
            }
        }
        if self.triangles.is_empty() {
            problems.push("no triangles".into());
        }
    }

    /// Adds a triangle of corners of its own with its face's normal: for files without normals.
    fn push_flat(&mut self, corners: [Vec3; 3], uvs: [Vec2; 3], material: u32) {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(Vec3::Z);
        let first = self.positions.len() as u32;
        self.positions.extend(corners);
        self.normals.extend([normal; 3]);
        self.uvs.extend(uvs);
        self.triangles.push([first, first + 1, first + 2]);
        self.material_of.push(material);
    }
}

/// From a space with y up to one with z up.
fn z_up(p: [f32; 3]) -> Vec3 {
    Vec3::new(p[0], -p[2], p[1])
}

/// An image of three channels: linear colour, or values as stored where they are data.
fn texture(bytes: &[u8], path: &Path, data: bool) -> Result<Image, String> {
    let loaded = comgs_image::read::decode(bytes, path).map_err(|e| e.to_string())?;
    let color = match loaded.color.channels {
        1 => loaded.color.select(&[0, 0, 0]),
        _ => loaded.color.select(&[0, 1, 2]),
    };
    Ok(if data && loaded.encoding == Encoding::Srgb { color.map(srgb_from_linear) } else { color })
}
