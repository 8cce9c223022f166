//! Round trips, dialects and hostile files.

use super::*;
use crate::{ColorEncoding, MaterialColumns, SurfelCloud};
use comgs_geom::Rng;
use glam::Vec3;

mod material;

fn random_cloud(n: usize, degree: usize, material: bool) -> SurfelCloud {
    let mut rng = Rng::new(7);
    let mut cloud = SurfelCloud::empty(degree, ColorEncoding::Srgb);
    let mut columns = MaterialColumns::default();
    for _ in 0..n {
        cloud.positions.push([rng.normal(), rng.normal(), rng.normal()]);
        cloud.rotations.push([rng.normal(), rng.normal(), rng.normal(), rng.normal()]);
        cloud.log_scales.push([rng.range(-4.0, -1.0), rng.range(-4.0, -1.0)]);
        cloud.opacity_logits.push(rng.normal());
        cloud.sh.extend((0..3 * comgs_geom::sh::coefficient_count(degree)).map(|_| rng.normal()));
        columns.albedo_logits.push([rng.normal(), rng.normal(), rng.normal()]);
        columns.metallic_logits.push(rng.normal());
        columns.roughness_logits.push(rng.normal());
    }
    cloud.material = material.then_some(columns);
    cloud
}

fn bytes_of(cloud: &SurfelCloud, style: PlyStyle) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_surfels_to(&mut bytes, cloud, style).unwrap();
    bytes
}

fn here() -> &'static Path {
    Path::new("memory.ply")
}

/// The same vertices as ASCII or big endian, made from the little-endian file.
fn relaid(bytes: &[u8], layout: &str) -> Vec<u8> {
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    let columns = header.matches("property").count();
    let mut out = header.replace("binary_little_endian", layout).into_bytes();
    for row in bytes[end..].chunks_exact(4 * columns) {
        for value in row.as_chunks::<4>().0 {
            let value = f32::from_le_bytes(*value);
            match layout {
                "ascii" => out.extend(format!("{value:?} ").bytes()),
                "binary_big_endian" => out.extend(value.to_be_bytes()),
                _ => out.extend(value.to_le_bytes()),
            }
        }
        if layout == "ascii" {
            out.push(b'\n');
        }
    }
    out
}

/// Goal: what is written reads back bit for bit, at every degree, with and without material, in all three layouts.
#[test]
fn asset_round_trip_is_exact() {
    for degree in 0..=3 {
        for material in [false, true] {
            let cloud = random_cloud(17, degree, material);
            let bytes = bytes_of(&cloud, PlyStyle::Asset);
            for layout in ["binary_little_endian", "ascii", "binary_big_endian"] {
                let (back, report) = parse_surfels(&relaid(&bytes, layout), here()).unwrap();
                assert_eq!(back, cloud, "{layout}");
                assert_eq!((report.dialect, report.count, report.dropped), (PlyDialect::Comgs, 17, 0));
                assert_eq!(report.missing.len(), usize::from(degree == 0) + usize::from(!material));
            }
        }
    }
}

/// Goal: a linear cloud says so in its header, and an unknown encoding is refused rather than guessed.
#[test]
fn color_encoding_is_kept() {
    let mut cloud = random_cloud(2, 1, false);
    cloud.color_encoding = ColorEncoding::Linear;
    let bytes = bytes_of(&cloud, PlyStyle::Asset);
    assert_eq!(parse_surfels(&bytes, here()).unwrap().0.color_encoding, ColorEncoding::Linear);
    let text = String::from_utf8_lossy(&bytes[..100]).into_owned();
    assert!(text.contains("comment comgs color_encoding linear\n"), "{text}");
    let mut odd = bytes.clone();
    let at = odd.windows(6).position(|w| w == b"linear").unwrap();
    odd[at..at + 6].copy_from_slice(b"banana");
    assert!(parse_surfels(&odd, here()).unwrap_err().to_string().contains("banana"));
}

/// Goal: the viewer export has three scales with the thin one across the surfel, 45 f_rest columns in channel-major
/// order, and is read back by ourselves as the same discs.
#[test]
fn viewer_export_is_thin() {
    let cloud = random_cloud(9, 1, true);
    let bytes = bytes_of(&cloud, PlyStyle::Viewer);
    let (back, report) = parse_surfels(&bytes, here()).unwrap();
    assert!(report.columns.iter().any(|c| c == "scale_2") && report.columns.iter().any(|c| c == "f_rest_44"));
    assert_eq!((&back.log_scales, &back.rotations), (&cloud.log_scales, &cloud.rotations));
    assert_eq!(back.sh_degree, 3);
    assert_eq!(back.material, None);
    for i in 0..cloud.len() {
        assert_eq!(back.sh_of(i)[..12], *cloud.sh_of(i));
        assert!(back.sh_of(i)[12..].iter().all(|&v| v == 0.0));
    }
    // The first red coefficient of degree 1 is f_rest_0, the first green one f_rest_15 after padding.
    let stride = 4 * report.columns.len();
    let row = &bytes[bytes.len() - stride..];
    let column = |name: &str| {
        let at = 4 * report.columns.iter().position(|c| c == name).unwrap();
        f32::from_le_bytes(row[at..at + 4].try_into().unwrap())
    };
    let last = cloud.sh_of(8);
    assert_eq!((column("f_rest_0"), column("f_rest_15"), column("f_rest_30")), (last[3], last[4], last[5]));
    let thin = cloud.log_scales[8][0].min(cloud.log_scales[8][1]) + VIEWER_THICKNESS.ln();
    assert!((column("scale_2") - thin).abs() < 1e-6);
}

/// A 3DGS file with one Gaussian of the given scales and rotation.
fn three_dgs(scales: [f32; 3], rotation: [f32; 4]) -> Vec<u8> {
    let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 1\n");
    let names = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    for name in names.split(' ') {
        text += &format!("property float {name}\n");
    }
    text += "end_header\n1 2 3 0 0 0 0.1 0.2 0.3 0.5";
    for v in scales.iter().chain(&rotation) {
        text += &format!(" {v}");
    }
    text.into_bytes()
}

/// Goal: a 3D Gaussian becomes the disc across its thinnest axis: normal and tangents are the right columns of
/// its rotation, the frame stays right-handed, and the scales go with their axes.
#[test]
fn three_scales_flatten_across_the_thinnest() {
    let rotation = [0.4f32, -0.3, 0.7, 0.5];
    let axes = crate::cloud::rotation_matrix(rotation);
    let axes = [axes.x_axis, axes.y_axis, axes.z_axis];
    for thinnest in 0..3 {
        let mut scales = [-1.0f32, -2.0, -1.5];
        scales[thinnest] = -6.0;
        let (cloud, report) = parse_surfels(&three_dgs(scales, rotation), here()).unwrap();
        assert_eq!(report.dialect, PlyDialect::ThreeDgs);
        assert!(report.missing.iter().any(|m| m.contains("third scale")), "{:?}", report.missing);
        let frame = cloud.rotation(0);
        assert!((frame.determinant() - 1.0).abs() < 1e-5);
        let (u, v) = ((thinnest + 1) % 3, (thinnest + 2) % 3);
        for (got, expected) in
            [(frame.z_axis, axes[thinnest]), (frame.x_axis, axes[u]), (frame.y_axis, axes[v])]
        {
            assert!(got.distance(expected) < 1e-5, "{thinnest}: {got} {expected}");
        }
        assert_eq!(cloud.log_scales[0], [scales[u], scales[v]]);
    }
}

/// Goal: published dialects are told apart, and what is not there is said.
#[test]
fn dialects_and_missing_columns() {
    let strip = |bytes: Vec<u8>| {
        let text = String::from_utf8_lossy(&bytes).into_owned();
        text.replace("comment comgs color_encoding srgb\n", "").into_bytes()
    };
    let plain = strip(relaid(&bytes_of(&random_cloud(3, 3, false), PlyStyle::Asset), "ascii"));
    let (cloud, report) = parse_surfels(&plain, here()).unwrap();
    assert_eq!((report.dialect, cloud.color_encoding), (PlyDialect::TwoDgs, ColorEncoding::Srgb));
    let material = strip(relaid(&bytes_of(&random_cloud(3, 3, true), PlyStyle::Asset), "ascii"));
    assert_eq!(parse_surfels(&material, here()).unwrap().1.dialect, PlyDialect::ComgsPublished);

    let points =
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        property float opacity\nend_header\n0 0 0 1\n";
    let error = parse_surfels(points, here()).unwrap_err();
    assert!(matches!(&error, PlyError::Columns { missing, .. } if missing.len() == 9), "{error}");
    assert!(error.to_string().contains("scale_0") && error.to_string().ends_with("memory.ply"));

    let mut nan = random_cloud(4, 0, false);
    nan.positions[1][2] = f32::NAN;
    nan.sh[7] = f32::INFINITY;
    let (cloud, report) = parse_surfels(&bytes_of(&nan, PlyStyle::Asset), here()).unwrap();
    assert_eq!((cloud.len(), report.dropped), (2, 2));
    assert!(cloud.problems().is_empty());
}

/// Goal: points with 8-bit colours and double positions, behind another element with a list, in every layout.
#[test]
fn point_clouds() {
    let ascii = b"ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nelement face 2\r\nproperty list uchar int i\r\n\
        element vertex 2\r\nproperty double x\r\nproperty double y\r\nproperty double z\r\nproperty uchar red\r\n\
        property uchar green\r\nproperty uchar blue\r\nend_header\r\n3 0 1 2\r\n0\r\n1.5 2 3 255 0 128\r\n-1 0 4e2 0 0 255";
    let cloud = parse_points(ascii, here()).unwrap();
    assert_eq!(cloud.positions, [[1.5, 2.0, 3.0], [-1.0, 0.0, 400.0]]);
    let colors = cloud.colors.as_ref().unwrap();
    assert_eq!((colors[0][0], colors[0][1]), (1.0, 0.0));
    assert!((colors[0][2] - 0.2158).abs() < 1e-3, "sRGB 128 is linear 0.2158, got {}", colors[0][2]);

    let mut binary =
        b"ply\nformat binary_big_endian 1.0\nelement face 1\nproperty list uchar short i\nelement vertex 1\n\
        property float x\nproperty float y\nproperty float z\nend_header\n"
            .to_vec();
    binary.extend([2, 0, 1, 0, 2]);
    for v in [1.0f32, -2.0, 0.25] {
        binary.extend(v.to_be_bytes());
    }
    assert_eq!(parse_points(&binary, here()).unwrap().positions, [[1.0, -2.0, 0.25]]);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points3d.ply");
    let cloud = PointCloud { normals: Some(vec![[0.0, 0.0, 1.0]; 2]), ..cloud };
    write_points(&path, &cloud).unwrap();
    let back = read_points(&path).unwrap();
    assert_eq!((&back.positions, &back.normals), (&cloud.positions, &cloud.normals));
    for (a, b) in back.colors.unwrap().iter().zip(cloud.colors.as_ref().unwrap()) {
        assert!(Vec3::from_array(*a).distance(Vec3::from_array(*b)) < 1e-5);
    }
}

/// Goal: made-up counts, broken headers and cut files are refused by name before memory is taken (hard case 34).
#[test]
fn hostile_headers_are_refused() {
    let header = |count: &str, layout: &str| {
        format!(
            "ply\nformat {layout} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        )
    };
    for layout in ["ascii", "binary_little_endian"] {
        for count in ["1000000000000", "18446744073709551615", "99999999999999999999", "-1", "2"] {
            let text = header(count, layout) + "0 0 0 ";
            assert!(parse_points(text.as_bytes(), here()).is_err(), "{layout} {count}");
        }
    }
    let error = parse_points(header("1000000000", "binary_little_endian").as_bytes(), here()).unwrap_err();
    assert!(error.to_string().contains("promises 1000000000 vertex"), "{error}");
    // An element of nothing, repeated for ever.
    let endless = "ply\nformat ascii 1.0\nelement nothing 18446744073709551615\nelement vertex 0\nproperty float x\n\
        property float y\nproperty float z\nend_header\n";
    assert!(parse_points(endless.as_bytes(), here()).is_err());
    for bad in [
        "",
        "plx\n",
        "ply\n",
        "ply\nformat ascii 1.0\nend_header\n",
        "ply\nend_header\n",
        "ply\nformat ascii 1.0\nproperty float x\nend_header\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty quux x\nend_header\n1\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float x\nend_header\n1 1\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nproperty float y\nproperty float z\nend_header\n1 1 1 1\n",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 a 1\n",
    ] {
        assert!(parse_points(bad.as_bytes(), here()).is_err(), "{bad:?}");
    }
    let long = format!("ply\nformat ascii 1.0\ncomment {}\n", "x".repeat(1 << 20));
    assert!(parse_points(long.as_bytes(), here()).unwrap_err().to_string().contains("longer than"));
    let bytes = bytes_of(&random_cloud(5, 2, true), PlyStyle::Asset);
    for cut in [bytes.len() - 1, bytes.len() / 2, 400, 3] {
        assert!(parse_surfels(&bytes[..cut], here()).is_err());
    }
}

/// Goal: a writer that fails (a full disk) gives an error and leaves the old file as it was (hard case 36).
#[test]
fn a_failed_write_keeps_the_old_file() {
    struct Full(usize);
    impl std::io::Write for Full {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let cloud = random_cloud(50, 3, false);
    let error = write_surfels_to(&mut Full(3000), &cloud, PlyStyle::Asset).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    write_surfels(&path, &cloud, PlyStyle::Asset).unwrap();
    let mut torn = cloud.clone();
    torn.opacity_logits.pop();
    assert!(matches!(write_surfels(&path, &torn, PlyStyle::Asset), Err(PlyError::Write { .. })));
    assert_eq!(read_surfels(&path).unwrap().0, cloud);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file is left");
    let blocked = path.join("below_a_file.ply");
    assert!(matches!(write_surfels(&blocked, &cloud, PlyStyle::Asset), Err(PlyError::Write { .. })));
    assert!(matches!(read_surfels(folder.path()), Err(PlyError::Io { .. })));
    assert!(read_header(&path).is_ok());
}
