//! glTF 2.0 and its binary form.

use super::{Mesh, MeshMaterial, texture, z_up};
use crate::SceneError;
use glam::{Mat4, Vec2, Vec3};
use gltf::{Gltf, buffer, image, mesh::Mode};
use std::path::Path;

/// Deepest nesting of nodes.
const MAX_DEPTH: usize = 64;

pub(super) fn parse(bytes: &[u8], path: &Path, problems: &mut Vec<String>) -> Result<Mesh, SceneError> {
    let Gltf { document, mut blob } =
        Gltf::from_slice(bytes).map_err(|e| SceneError::malformed(path, format!("not a glTF file: {e}")))?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut buffers = Vec::new();
    for b in document.buffers() {
        let data = match b.source() {
            buffer::Source::Bin => blob.take().ok_or_else(|| "the binary chunk is missing".to_owned()),
            buffer::Source::Uri(uri) => fetch(uri, folder),
        };
        let data = data.and_then(|d| {
            let (got, expected) = (d.len(), b.length());
            if got >= expected { Ok(d) } else { Err(format!("{got} bytes, expected {expected}")) }
        });
        buffers.push(data.unwrap_or_else(|reason| {
            problems.push(format!("buffer {}: {reason}", b.index()));
            Vec::new()
        }));
    }
    if !problems.is_empty() {
        return Ok(Mesh::default());
    }
    let mut reader = Reader { buffers, folder, path, mesh: Mesh::default(), problems };
    reader.mesh.materials.push(MeshMaterial { name: "(default)".into(), ..MeshMaterial::default() });
    for material in document.materials() {
        let read = reader.material(&material);
        reader.mesh.materials.push(read);
    }
    let scene = document.default_scene().or_else(|| document.scenes().next());
    match scene {
        Some(scene) => scene.nodes().for_each(|node| reader.node(&node, Mat4::IDENTITY, 0)),
        None => reader.problems.push("no scene".into()),
    }
    Ok(reader.mesh)
}

struct Reader<'a> {
    buffers: Vec<Vec<u8>>,
    folder: &'a Path,
    path: &'a Path,
    mesh: Mesh,
    problems: &'a mut Vec<String>,
}

impl Reader<'_> {
    fn node(&mut self, node: &gltf::Node<'_>, parent: Mat4, depth: usize) {
        if depth > MAX_DEPTH {
            self.problems.push(format!("nodes are nested more than {MAX_DEPTH} deep"));
            return;
        }
        let transform = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        if let Some(mesh) = node.mesh() {
            for primitive in mesh.primitives() {
                let name = mesh.name().map_or_else(|| mesh.index().to_string(), str::to_owned);
                self.primitive(&primitive, transform, &format!("mesh {name}, part {}", primitive.index()));
            }
        }
        for child in node.children() {
            self.node(&child, transform, depth + 1);
        }
    }

    fn primitive(&mut self, primitive: &gltf::Primitive<'_>, transform: Mat4, what: &str) {
        if primitive.mode() != Mode::Triangles {
            self.mesh
                .remarks
                .push(format!("{what}: {:?} is left out, only triangles are read", primitive.mode()));
            return;
        }
        // Accessors without a buffer view make the crate's reader panic on some files; such parts are refused first.
        let accessors = primitive.attributes().map(|(_, a)| a).chain(primitive.indices());
        if let Some(problem) = accessors.into_iter().find_map(|a| self.accessor_problem(&a)) {
            self.problems.push(format!("{what}: {problem}"));
            return;
        }
        let reader = primitive.reader(|b| self.buffers.get(b.index()).map(Vec::as_slice));
        let Some(positions) = reader.read_positions() else {
            self.problems.push(format!("{what}: no positions"));
            return;
        };
        let positions: Vec<Vec3> =
            positions.map(|p| z_up(transform.transform_point3(Vec3::from_array(p)).to_array())).collect();
        let set =
            primitive.material().pbr_metallic_roughness().base_color_texture().map_or(0, |t| t.tex_coord());
        let uvs: Vec<Vec2> = match reader.read_tex_coords(set) {
            Some(uvs) => uvs.into_f32().map(Vec2::from_array).collect(),
            None => vec![Vec2::ZERO; positions.len()],
        };
        let indices: Vec<u32> = match reader.read_indices() {
            Some(indices) => indices.into_u32().collect(),
            None => (0..positions.len() as u32).collect(),
        };
        let material = primitive.material().index().map_or(0, |i| i as u32 + 1);
        let mirrored = transform.determinant() < 0.0;
        let turn = |t: [u32; 3]| if mirrored { [t[0], t[2], t[1]] } else { t };
        let triangles = indices.chunks_exact(3).map(|t| turn([t[0], t[1], t[2]]));
        let normals = reader.read_normals().map(|normals| {
            let rotate = transform.inverse().transpose();
            normals
                .map(|n| z_up(rotate.transform_vector3(Vec3::from_array(n)).to_array()).normalize_or(Vec3::Z))
                .collect::<Vec<_>>()
        });
        if uvs.len() != positions.len() || normals.as_ref().is_some_and(|n| n.len() != positions.len()) {
            self.problems.push(format!("{what}: attributes of different length"));
            return;
        }
        match normals {
            Some(normals) => {
                let first = self.mesh.positions.len() as u32;
                self.mesh.positions.extend(positions);
                self.mesh.uvs.extend(uvs);
                self.mesh.normals.extend(normals);
                for t in triangles {
                    self.mesh.triangles.push(t.map(|i| i.saturating_add(first)));
                    self.mesh.material_of.push(material);
                }
            }
            None => {
                for t in triangles {
                    if t.iter().any(|&i| i as usize >= positions.len()) {
                        self.problems.push(format!("{what}: an index beyond the corners"));
                        return;
                    }
                    let t = t.map(|i| i as usize);
                    self.mesh.push_flat(t.map(|i| positions[i]), t.map(|i| uvs[i]), material);
                }
            }
        }
    }

    /// Why an accessor cannot be read: outside its view or buffer, or without one.
    fn accessor_problem(&self, accessor: &gltf::Accessor<'_>) -> Option<String> {
        if accessor.sparse().is_some() {
            return Some("sparse accessors are not read".into());
        }
        let Some(view) = accessor.view() else { return Some("an accessor without data".into()) };
        let stride = view.stride().unwrap_or(accessor.size()).max(1);
        let needed = accessor
            .count()
            .checked_sub(1)
            .and_then(|n| n.checked_mul(stride))
            .and_then(|n| n.checked_add(accessor.size()))
            .and_then(|n| n.checked_add(accessor.offset()));
        let fits = needed.is_some_and(|n| n <= view.length())
            && view
                .offset()
                .checked_add(view.length())
                .is_some_and(|end| end <= self.buffers[view.buffer().index()].len());
        (!fits).then(|| format!("accessor {} reaches beyond its data", accessor.index()))
    }

    fn material(&mut self, material: &gltf::Material<'_>) -> MeshMaterial {
        let name = material
            .name()
            .map_or_else(|| format!("material {}", material.index().unwrap_or(0)), str::to_owned);
        let pbr = material.pbr_metallic_roughness();
        let [r, g, b, _] = pbr.base_color_factor();
        if material.normal_texture().is_some() {
            self.mesh.remarks.push(format!("{name}: the normal map is not used"));
        }
        if material.alpha_mode() != gltf::material::AlphaMode::Opaque {
            self.mesh.remarks.push(format!("{name}: transparency is not modelled"));
        }
        let albedo_map = pbr.base_color_texture().and_then(|t| self.texture(&t.texture(), &name, false));
        let surface_map =
            pbr.metallic_roughness_texture().and_then(|t| self.texture(&t.texture(), &name, true));
        MeshMaterial {
            albedo: Vec3::new(r, g, b),
            roughness: pbr.roughness_factor(),
            metallic: pbr.metallic_factor(),
            emission: Vec3::from_array(material.emissive_factor()),
            albedo_map,
            surface_map,
            name,
        }
    }

    fn texture(
        &mut self,
        source: &gltf::Texture<'_>,
        material: &str,
        data: bool,
    ) -> Option<comgs_image::Image> {
        let bytes = match source.source().source() {
            image::Source::Uri { uri, .. } => fetch(uri, self.folder),
            image::Source::View { view, .. } => {
                let end = view.offset().saturating_add(view.length());
                self.buffers[view.buffer().index()]
                    .get(view.offset()..end)
                    .map(<[u8]>::to_vec)
                    .ok_or_else(|| "reaches beyond its buffer".to_owned())
            }
        };
        match bytes.and_then(|b| texture(&b, self.path, data)) {
            Ok(image) => Some(image),
            Err(reason) => {
                self.problems.push(format!("{material}: texture {}: {reason}", source.index()));
                None
            }
        }
    }
}

/// Bytes of a data URI, or of a file beside the glTF's.
fn fetch(uri: &str, folder: &Path) -> Result<Vec<u8>, String> {
    if let Some(rest) = uri.strip_prefix("data:") {
        let (_, data) = rest.split_once(";base64,").ok_or("a data URI that is not base 64")?;
        return base64(data).ok_or_else(|| "broken base 64".to_owned());
    }
    let relative = percent_decoded(uri);
    let below = Path::new(&relative).components().all(|c| matches!(c, std::path::Component::Normal(_)));
    if uri.contains(':') || !below {
        return Err(format!("{uri} is not a file beside the mesh"));
    }
    std::fs::read(folder.join(&relative)).map_err(|e| format!("{relative}: {e}"))
}

/// Text with `%20` and its like undone.
fn percent_decoded(text: &str) -> String {
    let mut out = Vec::with_capacity(text.len());
    let bytes = text.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        let hex = text.get(i + 1..i + 3).and_then(|h| u8::from_str_radix(h, 16).ok());
        match (bytes[i], hex) {
            (b'%', Some(byte)) => {
                out.push(byte);
                i += 3;
            }
            (byte, _) => {
                out.push(byte);
                i += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// Standard base 64 (RFC 4648 §4), padding optional; `None` for any other character.
fn base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut word, mut bits) = (0u32, 0);
    for c in text.trim_end_matches('=').bytes() {
        let digit = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        word = (word << 6) | u32::from(digit);
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            out.push((word >> bits) as u8);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: RFC 4648's vectors, and refusal of what is none.
    #[test]
    fn base64_vectors() {
        for (code, text) in
            [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9vYmFy", "foobar"), ("+/8=", "\u{0}")]
        {
            let bytes = base64(code).unwrap();
            if code == "+/8=" {
                assert_eq!(bytes, [0xfb, 0xff]);
            } else {
                assert_eq!(bytes, text.as_bytes());
            }
        }
        assert!(base64("Zm9 v").is_none());
        assert_eq!(percent_decoded("a%20b%zz"), "a b%zz");
    }
}
