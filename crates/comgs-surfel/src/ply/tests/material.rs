//! Material columns of the published dialects: told apart, activated as their own programs do it, refused when they are
//! of nobody.

use super::*;
use crate::activation::{MAX_LOGIT, sigmoid};

/// What the issue allows between the value that a file means and the one that is kept.
const KEPT: f64 = 1e-5;

/// Columns and one value a column and row.
struct File {
    columns: Vec<String>,
    rows: Vec<Vec<f32>>,
}

impl File {
    /// Random splats with two or three scales and the named further columns, raw numbers in ±9.
    fn random(scales: usize, further: &str) -> Self {
        let mut rng = Rng::new(11);
        let mut columns: Vec<String> = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity rot_0 rot_1 rot_2 rot_3"
            .split(' ')
            .map(String::from)
            .collect();
        columns.extend((0..scales).map(|i| format!("scale_{i}")));
        columns.extend(further.split_whitespace().map(String::from));
        let rows = (0..7).map(|_| columns.iter().map(|_| rng.range(-9.0, 9.0)).collect()).collect();
        Self { columns, rows }
    }

    fn column(&self, name: &str) -> Vec<f32> {
        let at = self.columns.iter().position(|c| c == name).unwrap();
        self.rows.iter().map(|row| row[at]).collect()
    }

    fn set(&mut self, row: usize, name: &str, value: f32) {
        let at = self.columns.iter().position(|c| c == name).unwrap();
        self.rows[row][at] = value;
    }

    fn bytes(&self) -> Vec<u8> {
        let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", self.rows.len())
            .into_bytes();
        for name in &self.columns {
            text.extend(format!("property float {name}\n").bytes());
        }
        text.extend(b"end_header\n");
        text.extend(self.rows.iter().flatten().flat_map(|v| v.to_le_bytes()));
        text
    }

    fn read(&self) -> (SurfelCloud, PlyReport) {
        parse_surfels(&self.bytes(), here()).unwrap()
    }
}

const ALBEDO: &str = "albedo_0 albedo_1 albedo_2 roughness metallic";
const BASE: &str = "base_color_0 base_color_1 base_color_2 roughness";
const LIGHT: &str =
    "incidents_dc_0 incidents_dc_1 incidents_dc_2 incidents_rest_0 visibility_dc_0 visibility_rest_0";

/// The formulas of the issue, in f64: `scale · sigmoid(x) + offset`.
fn activated(x: f32, scale: f64, offset: f64) -> f64 {
    scale / (1.0 + (-f64::from(x)).exp()) + offset
}

/// Goal: each dialect is told by its header and read with its own activations; what is kept means the same to 1e-5;
/// and the result is written in our own form, from which it reads back bit for bit.
#[test]
fn published_material_keeps_its_values() {
    let base = (0.77, 0.03);
    let plain = (1.0, 0.0);
    let r3dg = format!("{BASE} {LIGHT}");
    for (scales, further, dialect, albedo, roughness) in [
        (2, ALBEDO, PlyDialect::ComgsPublished, plain, plain),
        (3, ALBEDO, PlyDialect::GsIr, plain, plain),
        (3, r3dg.as_str(), PlyDialect::R3dg, base, (0.9, 0.09)),
        (2, BASE, PlyDialect::Irgs, base, plain),
    ] {
        let file = File::random(scales, further);
        let (cloud, report) = file.read();
        assert_eq!((report.dialect, report.count), (dialect, 7), "{further}");
        assert_eq!(PlyDialect::of(&header_of(&file.bytes())), Some(dialect));
        let name = report.material.as_ref().unwrap().base;
        assert!(report.material.as_ref().unwrap().assumed.is_empty(), "{:?}", report.material);
        let material = cloud.material.as_ref().unwrap();
        let near = |logit: f32, expected: f64| {
            let off = (f64::from(sigmoid(logit)) - expected).abs();
            assert!(off < KEPT, "{dialect:?}: {expected} is off by {off}");
        };
        for c in 0..3 {
            for (i, x) in file.column(&format!("{name}_{c}")).into_iter().enumerate() {
                near(material.albedo_logits[i][c], activated(x, albedo.0, albedo.1));
            }
        }
        for (i, x) in file.column("roughness").into_iter().enumerate() {
            near(material.roughness_logits[i], activated(x, roughness.0, roughness.1));
        }
        let has_metallic = further.contains("metallic");
        for i in 0..7 {
            let expected = if has_metallic { activated(file.column("metallic")[i], 1.0, 0.0) } else { 0.0 };
            near(material.metallic_logits[i], expected);
            assert!(material.metallic_logits[i].abs() <= MAX_LOGIT + 1e-3);
        }
        let said = report.missing.join("; ");
        assert_eq!(said.contains("metallic: taken as 0"), !has_metallic, "{said}");
        assert_eq!(said.contains("6 columns of incident light"), further.contains("incidents"), "{said}");
        assert_eq!(said.contains("third scale"), scales == 3, "{said}");

        let (back, report) = parse_surfels(&bytes_of(&cloud, PlyStyle::Asset), here()).unwrap();
        assert_eq!((back, report.dialect), (cloud, PlyDialect::Comgs));
    }
}

fn header_of(bytes: &[u8]) -> Header {
    Header::parse(&mut Source { reader: bytes, remaining: bytes.len() as u64, path: here() }).unwrap()
}

/// Goal: the order of the columns and the layout of the body do not matter.
#[test]
fn column_order_and_layout_do_not_matter() {
    let file = File::random(3, &format!("{LIGHT} {BASE}"));
    let (expected, _) = file.read();
    let mut reversed = File { columns: file.columns.clone(), rows: file.rows.clone() };
    reversed.columns.reverse();
    reversed.rows.iter_mut().for_each(|row| row.reverse());
    assert_eq!(reversed.read().0, expected);
    for layout in ["ascii", "binary_big_endian"] {
        let (cloud, report) = parse_surfels(&relaid(&file.bytes(), layout), here()).unwrap();
        assert_eq!((cloud, report.dialect), (expected.clone(), PlyDialect::R3dg), "{layout}");
    }
}

/// Goal: what a header does not tell is assumed and said: R3DG without its light columns, IRGS and GS-IR with them,
/// metallic where the dialect has none, no metallic where it has one.
#[test]
fn assumptions_are_said() {
    let with_light = |columns: &str| format!("{columns} {LIGHT}");
    for (scales, further, dialect, words) in [
        (3, BASE.to_owned(), PlyDialect::R3dg, "no incidents_"),
        (3, with_light(&format!("{BASE} metallic")), PlyDialect::R3dg, "metallic is taken"),
        (2, format!("{BASE} metallic"), PlyDialect::Irgs, "metallic is taken"),
        (2, with_light(BASE), PlyDialect::Irgs, "beside two scales"),
        (3, with_light(ALBEDO), PlyDialect::GsIr, "beside three scales"),
    ] {
        let (cloud, report) = File::random(scales, &further).read();
        let assumed = report.material.unwrap().assumed.join("; ");
        assert_eq!(report.dialect, dialect, "{further}");
        assert!(assumed.contains(words), "{further}: {assumed:?}");
        assert!(cloud.material.is_some() && cloud.problems().is_empty());
    }
    let without = ALBEDO.replace(" metallic", "");
    for (scales, dialect) in [(2, PlyDialect::ComgsPublished), (3, PlyDialect::GsIr)] {
        let (cloud, report) = File::random(scales, &without).read();
        assert_eq!(report.dialect, dialect);
        assert!(report.missing.iter().any(|m| m.contains("metallic: taken as 0")), "{:?}", report.missing);
        assert!(cloud.material.unwrap().metallic_logits.iter().all(|l| sigmoid(*l) < 2e-6));
    }
}

/// Goal: raw numbers at the ends of f32 stay finite and mean the ends of the dialect's range; NaN drops the surfel, in
/// a material column as in any other (hard case 6).
#[test]
fn extreme_material_is_clamped() {
    for (scales, further) in [(3, BASE), (2, BASE), (2, ALBEDO), (3, ALBEDO)] {
        let mut file = File::random(scales, further);
        let name = if further == BASE { "base_color_1" } else { "albedo_1" };
        let ends = [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN];
        for (row, x) in ends.into_iter().enumerate() {
            file.set(row, name, x);
            file.set(row, "roughness", -x);
        }
        file.set(4, "roughness", f32::NAN);
        file.set(5, name, f32::NAN);
        let (cloud, report) = file.read();
        assert_eq!((report.count, report.dropped), (5, 2), "{further}");
        let material = cloud.material.unwrap();
        let (scale, offset) = if further == BASE { (0.77, 0.03) } else { (1.0, 0.0) };
        for (row, x) in ends.into_iter().enumerate() {
            let logit = material.albedo_logits[row][1];
            assert!(logit.is_finite() && material.roughness_logits[row].is_finite());
            assert!((f64::from(sigmoid(logit)) - activated(x, scale, offset)).abs() < KEPT);
        }
    }
    // Our own files keep even that: a cloud that was written is the cloud that is read.
    let mut cloud = random_cloud(2, 0, true);
    cloud.material.as_mut().unwrap().roughness_logits[1] = 40.0;
    assert_eq!(parse_surfels(&bytes_of(&cloud, PlyStyle::Asset), here()).unwrap().0, cloud);
}

/// Goal: material columns of no known dialect are refused by name, with the known dialects listed; as a point cloud the
/// file still opens, and without the columns it would open as plain splats.
#[test]
fn foreign_material_is_refused() {
    for (scales, further, named) in [
        (2, "albedo_0 albedo_1 roughness metallic", "missing albedo_2"),
        (3, "albedo_1 albedo_2 roughness", "missing albedo_0"),
        (3, "base_color_0 base_color_1 base_color_2", "missing roughness"),
        (2, "albedo_0 albedo_1 albedo_2 metallic", "missing roughness"),
        (3, &format!("{ALBEDO} base_color_0 base_color_1 base_color_2"), "two names of one thing"),
        (2, "albedo_0 base_color_1 roughness", "two names of one thing"),
        (3, "roughness", "no base colour"),
        (2, "metallic roughness", "no base colour"),
        (2, &format!("{ALBEDO} albedo_3"), "no dialect has albedo_3"),
        (3, &format!("{BASE} roughness_1"), "no dialect has roughness_1"),
        (2, "albedo roughness", "missing albedo_0 albedo_1 albedo_2"),
    ] {
        let file = File::random(scales, further);
        let error = parse_surfels(&file.bytes(), here()).unwrap_err();
        assert!(matches!(&error, PlyError::Material { .. }), "{further}: {error}");
        let text = error.to_string();
        for word in further.split(' ').chain([named, "ComGS (", "GS-IR (", "R3DG (", "IRGS ("]) {
            assert!(text.contains(word), "{further}: {word} is not in {text}");
        }
        assert!(text.ends_with("memory.ply"), "{text}");
        let plain = if scales == 3 { PlyDialect::ThreeDgs } else { PlyDialect::TwoDgs };
        assert_eq!(PlyDialect::of(&header_of(&file.bytes())), Some(plain));
        assert_eq!(parse_points(&file.bytes(), here()).unwrap().len(), 7);
    }
    // Our comment does not make foreign columns ours.
    let ours = |bytes: Vec<u8>| {
        let text = b"ply\nformat binary_little_endian 1.0\n";
        assert!(bytes.starts_with(text));
        [&text[..], b"comment comgs color_encoding srgb\n", &bytes[text.len()..]].concat()
    };
    for (further, named) in
        [(BASE, "not base_color"), ("albedo_0 albedo_1 albedo_2 roughness", "missing metallic")]
    {
        let error = parse_surfels(&ours(File::random(2, further).bytes()), here()).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    }
}
