//! Meshes from files: what is read, and what is refused with every problem named.

use comgs_image::{Image, write_png};
use comgs_scene::mesh::Up;
use comgs_scene::read_mesh;
use glam::{Vec2, Vec3};
use std::path::Path;

/// A binary glTF of one triangle list with `positions`, normals along +y, texture coordinates, and `material` JSON.
fn glb(positions: &[[f32; 3]], indices: &[u16], material: &str, extra: &str) -> Vec<u8> {
    let mut bin = Vec::new();
    let n = positions.len();
    bin.extend(positions.iter().flatten().flat_map(|v| v.to_le_bytes()));
    bin.extend((0..n).flat_map(|_| [0.0f32, 1.0, 0.0]).flat_map(f32::to_le_bytes));
    bin.extend((0..n).flat_map(|i| [i as f32 * 0.25, 0.5]).flat_map(f32::to_le_bytes));
    bin.extend(indices.iter().flat_map(|i| i.to_le_bytes()));
    let length = bin.len();
    bin.resize(length.next_multiple_of(4), 0);
    let finite = |f: fn(f32, f32) -> f32, start: f32| -> Vec<f32> {
        (0..3).map(|a| positions.iter().map(|p| p[a]).filter(|v| v.is_finite()).fold(start, f)).collect()
    };
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"mesh":0,"scale":[2,2,2],"translation":[0,1,0]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"TEXCOORD_0":2}},"indices":3,"material":0}}]}}],
        "materials":[{material}],
        "buffers":[{{"byteLength":{length}}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":{a}}},{{"buffer":0,"byteOffset":{a},"byteLength":{a}}},
        {{"buffer":0,"byteOffset":{b},"byteLength":{c}}},{{"buffer":0,"byteOffset":{d},"byteLength":{e}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":{n},"type":"VEC3","min":{min:?},"max":{max:?}}},
        {{"bufferView":1,"componentType":5126,"count":{n},"type":"VEC3"}},
        {{"bufferView":2,"componentType":5126,"count":{n},"type":"VEC2"}},
        {{"bufferView":3,"componentType":5123,"count":{count},"type":"SCALAR"}}]{extra}}}"#,
        a = 12 * n,
        b = 24 * n,
        c = 8 * n,
        d = 32 * n,
        e = 2 * indices.len(),
        count = indices.len(),
        min = finite(f32::min, f32::MAX),
        max = finite(f32::max, f32::MIN),
    );
    let mut json = json.into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut out = b"glTF".to_vec();
    out.extend(2u32.to_le_bytes());
    out.extend(((28 + json.len() + bin.len()) as u32).to_le_bytes());
    out.extend((json.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(&json);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(&bin);
    out
}

const QUAD: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 0.0, -1.0]];

fn problems(path: &Path) -> String {
    read_mesh(path, Up::Y).unwrap_err().to_string()
}

/// Goal: a GLB comes in with its node's transform, z up, fronts and normals upwards, and its material's factors times the
/// texture beside it; data textures are not linearised.
#[test]
fn binary_gltf() {
    let root = tempfile::tempdir().unwrap();
    // sRGB code 188 is linear 0.5, and as data 0.737.
    write_png(&root.path().join("map.png"), &Image::filled(4, 4, 3, 0.502_886_5)).unwrap();
    let material = r#"{"name":"tile","pbrMetallicRoughness":{"baseColorFactor":[0.5,1,1,1],
        "baseColorTexture":{"index":0},"metallicFactor":1,"roughnessFactor":0.5,"metallicRoughnessTexture":{"index":0}},
        "normalTexture":{"index":0}}"#;
    let extra = r#","images":[{"uri":"map.png"}],"textures":[{"source":0}]"#;
    let path = root.path().join("quad.glb");
    std::fs::write(&path, glb(&QUAD, &[0, 1, 2, 0, 2, 3], material, extra)).unwrap();
    let mesh = read_mesh(&path, Up::Y).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(mesh.bounds().unwrap(), (Vec3::new(0.0, 0.0, 1.0), Vec3::new(2.0, 2.0, 1.0)));
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        assert!((b - a).cross(c - a).z > 0.0, "the front looks up");
    }
    assert!(mesh.normals.iter().all(|n| n.distance(Vec3::Z) < 1e-6));
    let (albedo, roughness, metallic) = mesh.materials[mesh.material_of[0] as usize].at(Vec2::new(0.3, 7.6));
    assert!(albedo.distance(Vec3::new(0.2514, 0.5029, 0.5029)) < 1e-3, "{albedo}");
    assert!((roughness - 0.5 * 0.737).abs() < 2e-3 && (metallic - 0.737).abs() < 2e-3);
    assert!(mesh.remarks.iter().any(|r| r.contains("normal map")), "{:?}", mesh.remarks);
}

/// Goal: every problem is named at once: bad triangles of each kind with their number, and the missing texture; broken and
/// truncated files are refused without a panic.
#[test]
fn bad_meshes_are_refused() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("bad.glb");
    let mut corners = QUAD.to_vec();
    corners.push([f32::NAN, 0.0, 0.0]);
    let material = r#"{"name":"wood","pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}"#;
    let extra = r#","images":[{"uri":"gone.png"}],"textures":[{"source":0}]"#;
    let whole = glb(&corners, &[0, 1, 2, 0, 0, 1, 1, 2, 4, 0, 1, 9], material, extra);
    std::fs::write(&path, &whole).unwrap();
    let text = problems(&path);
    for part in [
        "1 of 4 triangles with indices beyond",
        "1 of 4 triangles with non-finite",
        "without area",
        "gone.png",
        "wood",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    for cut in [0, 3, 11, 20, 60, 400, whole.len() - 9] {
        std::fs::write(&path, &whole[..cut]).unwrap();
        assert!(!problems(&path).is_empty());
    }
    let outside = r#","images":[{"uri":"../up.png"}],"textures":[{"source":0}]"#;
    std::fs::write(&path, glb(&QUAD, &[0, 1, 2], material, outside)).unwrap();
    assert!(problems(&path).contains("not a file beside"));
}

/// Goal: an OBJ with polygons, a texture and physical parameters; without normals its faces are flat; what lacks a library
/// or a texture says so; either axis can be up.
#[test]
fn wavefront() {
    let root = tempfile::tempdir().unwrap();
    let path = root.path().join("box.obj");
    let body = "mtllib box.mtl\nv 0 0 0\nv 1 0 0\nv 1 0 -1\nv 0 0 -1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl red\n\
                f 1/1 2/2 3/3 4/4\n";
    std::fs::write(&path, body).unwrap();
    assert!(problems(&path).contains("material library"));
    std::fs::write(root.path().join("box.mtl"), "newmtl red\nKd 0.5 0 0\nPr 0.25\nPm 1\nmap_Kd no.png\n")
        .unwrap();
    assert!(problems(&path).contains("no.png"));
    std::fs::write(root.path().join("box.mtl"), "newmtl red\nKd 0.5 0 0\nPr 0.25\nPm 1\n").unwrap();
    let mesh = read_mesh(&path, Up::Y).unwrap();
    assert_eq!(mesh.triangles.len(), 2);
    assert!(mesh.normals.iter().all(|n| n.distance(Vec3::Z) < 1e-6));
    let (albedo, roughness, metallic) = mesh.materials[mesh.material_of[0] as usize].at(mesh.uvs[0]);
    assert_eq!((albedo, roughness, metallic), (Vec3::new(0.5, 0.0, 0.0), 0.25, 1.0));
    assert_eq!(mesh.uvs[0], Vec2::new(0.0, 1.0));
    let mesh = read_mesh(&path, Up::Z).unwrap();
    assert!(mesh.normals.iter().all(|n| n.distance(Vec3::Y) < 1e-6));
    std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n").unwrap();
    assert!(problems(&path).contains("without area"));
    std::fs::write(&path, "v 0 0 0\n").unwrap();
    assert!(problems(&path).contains("no triangles"));
    assert!(problems(&root.path().join("none.obj")).contains("none.obj"));
    std::fs::write(root.path().join("a.stl"), "solid").unwrap();
    assert!(problems(&root.path().join("a.stl")).contains(".stl"));
}
