//! Surfel clouds in PLY files.

use super::body::{checked_count, for_each_vertex};
use super::dialect::{self, ENCODING_COMMENT, MATERIAL, REQUIRED};
use super::{Element, Header, Layout, PlyDialect, PlyError, PlyMaterial, Source, with_file};
use crate::activation::{ScaledSigmoid, logit};
use crate::{ColorEncoding, MaterialColumns, SurfelCloud};
use comgs_geom::sh;
use comgs_image::atomic;
use std::io::{self, BufRead, Write};
use std::path::Path;

/// Thickness of a surfel in a viewer export, as a fraction of its smaller tangent scale.
///
/// Thin enough to look flat in viewers that draw 3D Gaussians, thick enough that their covariances stay well
/// conditioned in f32.
pub const VIEWER_THICKNESS: f32 = 1e-3;

/// What a surfel PLY held and what it did not.
#[derive(Clone, Debug, PartialEq)]
pub struct PlyReport {
    /// Whose file it is.
    pub dialect: PlyDialect,
    /// How its body is stored.
    pub layout: Layout,
    /// Its vertex columns, in file order.
    pub columns: Vec<String>,
    /// Its material columns and what they meant; the cloud has them as logits.
    pub material: Option<PlyMaterial>,
    /// What a complete file has and this one lacks, or what had to be given up; one sentence each.
    pub missing: Vec<String>,
    /// Surfels that were read and kept.
    pub count: usize,
    /// Surfels that were dropped because a parameter was NaN or infinite.
    pub dropped: usize,
    /// Degree of the harmonics.
    pub sh_degree: usize,
}

/// Reads the surfels of a PLY file of any dialect.
///
/// * No `comgs color_encoding` comment: the harmonics are sRGB code values, as published splats store them.
/// * Three scales: the surfel's normal is the axis of the smallest scale, which is then dropped (except in our own
///   viewer exports, whose third scale is known to be the normal's).
/// * Material of another dialect is activated as that dialect does it and kept as the logit of the value, clamped to
///   ±[`crate::activation::MAX_LOGIT`] ([`ScaledSigmoid::to_logit`]); our own is kept bit for bit. A file without
///   metallic gets metallic 0, and the report says so.
/// * A surfel with a non-finite parameter is dropped and counted.
///
/// # Errors
/// [`PlyError`]; [`PlyError::Columns`] lists every column that surfels need and the file lacks, and
/// [`PlyError::Material`] the material columns that no known dialect has together. Memory stays in proportion to the
/// file's length whatever its header says.
pub fn read_surfels(path: &Path) -> Result<(SurfelCloud, PlyReport), PlyError> {
    with_file(path, read_source)
}

/// [`read_surfels`] from memory; `path` is only for messages.
///
/// # Errors
/// As [`read_surfels`].
pub fn parse_surfels(bytes: &[u8], path: &Path) -> Result<(SurfelCloud, PlyReport), PlyError> {
    read_source(&mut Source { reader: bytes, remaining: bytes.len() as u64, path })
}

fn read_source<R: BufRead>(source: &mut Source<'_, R>) -> Result<(SurfelCloud, PlyReport), PlyError> {
    let header = Header::parse(source)?;
    let vertex =
        header.vertex().ok_or_else(|| PlyError::malformed(source.path, "there is no vertex element"))?;
    let absent: Vec<String> =
        REQUIRED.iter().filter(|n| vertex.position(n).is_none()).map(|&n| n.to_owned()).collect();
    if !absent.is_empty() {
        return Err(PlyError::Columns { path: source.path.to_owned(), expected: "surfels", missing: absent });
    }
    let (dialect, material) = dialect::recognise(&header, vertex).map_err(|unknown| PlyError::Material {
        path: source.path.to_owned(),
        columns: unknown.columns,
        reason: unknown.reason,
    })?;
    let mut missing = Vec::new();
    let columns = Columns::find(vertex, dialect, material.as_ref(), source.path, &mut missing)?;
    let color_encoding = color_encoding(&header, source.path)?;
    let count = checked_count(&header, source)?;

    let mut cloud = SurfelCloud::empty(columns.sh_degree, color_encoding);
    cloud.positions.reserve_exact(count);
    cloud.rotations.reserve_exact(count);
    cloud.log_scales.reserve_exact(count);
    cloud.opacity_logits.reserve_exact(count);
    cloud.sh.reserve_exact(count * cloud.sh_stride());
    cloud.material = columns.material.as_ref().map(|_| MaterialColumns::default());
    let mut dropped = 0;
    for_each_vertex(&header, source, |row| dropped += usize::from(!columns.push(row, &mut cloud)))?;
    if dialect.has_three_scales() {
        missing.push(
            "the third scale was dropped: every Gaussian became a disc across its thinnest axis".into(),
        );
    }
    let report = PlyReport {
        dialect,
        layout: header.layout,
        columns: vertex.properties.iter().map(|p| p.name.clone()).collect(),
        material,
        missing,
        count: cloud.len(),
        dropped,
        sh_degree: columns.sh_degree,
    };
    Ok((cloud, report))
}

fn color_encoding(header: &Header, path: &Path) -> Result<ColorEncoding, PlyError> {
    let Some(comment) = header.comments.iter().find(|c| c.starts_with(ENCODING_COMMENT)) else {
        return Ok(ColorEncoding::Srgb);
    };
    match comment[ENCODING_COMMENT.len()..].trim() {
        "srgb" => Ok(ColorEncoding::Srgb),
        "linear" => Ok(ColorEncoding::Linear),
        other => {
            let reason = format!("the colour encoding is {other:?}, expected \"srgb\" or \"linear\"");
            Err(PlyError::malformed(path, reason))
        }
    }
}

/// Where the parameters stand in a row.
struct Columns {
    required: [usize; 13],
    third_scale: Option<usize>,
    /// `[coefficient][rgb]`, without the constant term.
    rest: Vec<usize>,
    sh_degree: usize,
    material: Option<MaterialAt>,
}

/// Where material stands in a row, and how it becomes logits.
struct MaterialAt {
    base: [usize; 3],
    metallic: Option<usize>,
    roughness: usize,
    /// Activations of base colour, metallic and roughness; `None` keeps the raw numbers, which are ours.
    activations: Option<[ScaledSigmoid; 3]>,
}

impl MaterialAt {
    fn find(vertex: &Element, material: &PlyMaterial, dialect: PlyDialect) -> Self {
        let at = |name: &str| vertex.position(name).unwrap_or_default();
        let [r, g, b] = [0, 1, 2].map(|c| at(&format!("{}_{c}", material.base)));
        let metallic = material.metallic_activation.unwrap_or(ScaledSigmoid::PLAIN);
        Self {
            base: [r, g, b],
            metallic: vertex.position("metallic"),
            roughness: at("roughness"),
            activations: (dialect != PlyDialect::Comgs).then_some([
                material.base_activation,
                metallic,
                material.roughness_activation,
            ]),
        }
    }

    /// Logits of albedo, metallic and roughness; NaN where the row has it.
    fn logits(&self, row: &[f64]) -> [f32; 5] {
        let raw = |at: usize, k: usize| {
            let x = row[at] as f32;
            self.activations.map_or(x, |activations| activations[k].to_logit(x))
        };
        let [r, g, b] = self.base.map(|at| raw(at, 0));
        let metallic = self.metallic.map_or_else(|| logit(0.0), |at| raw(at, 1));
        [r, g, b, metallic, raw(self.roughness, 2)]
    }
}

impl Columns {
    fn find(
        vertex: &Element,
        dialect: PlyDialect,
        material: Option<&PlyMaterial>,
        path: &Path,
        missing: &mut Vec<String>,
    ) -> Result<Self, PlyError> {
        let count = vertex.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
        let sh_degree = (0..=sh::MAX_DEGREE).find(|&d| 3 * (sh::coefficient_count(d) - 1) == count);
        let sh_degree = sh_degree.ok_or_else(|| {
            PlyError::malformed(
                path,
                format!("{count} f_rest columns, expected 0, 9, 24 or 45 (degree 0 to 3)"),
            )
        })?;
        if sh_degree == 0 {
            missing.push("f_rest: colours do not depend on the viewing direction".into());
        }
        let per_channel = sh::coefficient_count(sh_degree) - 1;
        let mut rest = Vec::with_capacity(count);
        for k in 0..per_channel {
            for c in 0..3 {
                let name = format!("f_rest_{}", c * per_channel + k);
                let at = vertex.position(&name);
                rest.push(
                    at.ok_or_else(|| PlyError::malformed(path, format!("the column {name} is missing")))?,
                );
            }
        }
        match material {
            None => missing.push(format!("{}: no material", MATERIAL.join(" "))),
            Some(m) if m.metallic_activation.is_none() => {
                missing.push("metallic: taken as 0 everywhere".into());
            }
            Some(_) => {}
        }
        let light = dialect::light_columns(vertex);
        if light > 0 {
            missing.push(format!("{light} columns of incident light and visibility are not read"));
        }
        let material = material.map(|m| MaterialAt::find(vertex, m, dialect));
        let third_scale = vertex.position("scale_2").filter(|_| dialect.has_three_scales());
        let required = REQUIRED.map(|name| vertex.position(name).unwrap_or_default());
        Ok(Self { required, third_scale, rest, sh_degree, material })
    }

    /// Appends a row; `false` when it was dropped for a non-finite value.
    fn push(&self, row: &[f64], cloud: &mut SurfelCloud) -> bool {
        let at = |i: usize| row[self.required[i]] as f32;
        let position = [at(0), at(1), at(2)];
        let constant = [at(3), at(4), at(5)];
        let opacity = at(6);
        let mut scales = [at(7), at(8)];
        let mut rotation = [at(9), at(10), at(11), at(12)];
        if let Some(third) = self.third_scale {
            (scales, rotation) = flatten([scales[0], scales[1], row[third] as f32], rotation);
        }
        let material = self.material.as_ref().map(|m| m.logits(row));
        // An infinite log scale or logit still has a meaning (0, 1, a point); NaN has none.
        let finite = position.iter().chain(&constant).chain(&rotation).all(|v| v.is_finite())
            && self.rest.iter().all(|&i| (row[i] as f32).is_finite())
            && !scales.iter().chain(&[opacity]).chain(material.iter().flatten()).any(|v| v.is_nan());
        if !finite {
            return false;
        }
        cloud.positions.push(position);
        cloud.rotations.push(rotation);
        cloud.log_scales.push(scales);
        cloud.opacity_logits.push(opacity);
        cloud.sh.extend(constant);
        cloud.sh.extend(self.rest.iter().map(|&i| row[i] as f32));
        if let (Some(columns), Some([r, g, b, metallic, roughness])) = (&mut cloud.material, material) {
            columns.albedo_logits.push([r, g, b]);
            columns.metallic_logits.push(metallic);
            columns.roughness_logits.push(roughness);
        }
        true
    }
}

/// A 3D Gaussian as a disc: the axis of the smallest scale becomes the normal. The axes are relabelled cyclically,
/// which keeps the frame right-handed.
fn flatten(scales: [f32; 3], rotation: [f32; 4]) -> ([f32; 2], [f32; 4]) {
    let thinnest = (0..3).rev().fold(2, |best, i| if scales[i] < scales[best] { i } else { best });
    // Quaternion of the relabelling: a third of a turn about (1, 1, 1), forwards or backwards.
    let relabel = match thinnest {
        0 => [0.5, 0.5, 0.5, 0.5],
        1 => [0.5, -0.5, -0.5, -0.5],
        _ => return ([scales[0], scales[1]], rotation),
    };
    let ([aw, ax, ay, az], [bw, bx, by, bz]) = (rotation, relabel);
    let product = [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ];
    ([scales[(thinnest + 1) % 3], scales[(thinnest + 2) % 3]], product)
}

/// For whom a PLY is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyStyle {
    /// For ourselves: two scales, the cloud's own degree, material columns when there are any. Reads back exactly.
    Asset,
    /// For viewers of 3D Gaussians: a thin `scale_2` ([`VIEWER_THICKNESS`]), harmonics padded to degree 3, no
    /// material columns.
    Viewer,
}

/// Writes surfels as binary little-endian PLY; the file is whole or unchanged.
///
/// # Errors
/// [`PlyError::Write`].
pub fn write_surfels(path: &Path, cloud: &SurfelCloud, style: PlyStyle) -> Result<(), PlyError> {
    atomic::write_file(path, |w| write_surfels_to(w, cloud, style))
        .map_err(|reason| PlyError::Write { path: path.to_owned(), reason })
}

/// [`write_surfels`] into any writer.
///
/// # Errors
/// Whatever the writer says, and `InvalidInput` when the cloud's columns disagree in length.
pub fn write_surfels_to(w: &mut dyn Write, cloud: &SurfelCloud, style: PlyStyle) -> io::Result<()> {
    let n = cloud.len();
    let material = cloud.material.as_ref().filter(|_| style == PlyStyle::Asset);
    let lengths = [cloud.rotations.len(), cloud.log_scales.len(), cloud.opacity_logits.len()];
    let material_lengths =
        material.map(|m| [m.albedo_logits.len(), m.metallic_logits.len(), m.roughness_logits.len()]);
    if lengths.iter().chain(material_lengths.iter().flatten()).any(|&l| l != n)
        || cloud.sh.len() != n * cloud.sh_stride()
    {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "the cloud's columns differ in length"));
    }
    let per_channel_stored = sh::coefficient_count(cloud.sh_degree) - 1;
    let per_channel = match style {
        PlyStyle::Asset => per_channel_stored,
        PlyStyle::Viewer => sh::MAX_COEFFICIENTS - 1,
    };
    write_header(w, cloud, style, per_channel)?;

    let mut row: Vec<f32> = Vec::with_capacity(80);
    for i in 0..n {
        row.clear();
        row.extend(cloud.positions[i]);
        row.extend(cloud.rotation(i).z_axis.to_array());
        let harmonics = cloud.sh_of(i);
        row.extend(&harmonics[..3]);
        for c in 0..3 {
            row.extend((0..per_channel).map(|k| harmonics.get((k + 1) * 3 + c).copied().unwrap_or(0.0)));
        }
        row.push(cloud.opacity_logits[i]);
        let scales = cloud.log_scales[i];
        row.extend(scales);
        if style == PlyStyle::Viewer {
            row.push(scales[0].min(scales[1]) + VIEWER_THICKNESS.ln());
        }
        row.extend(cloud.rotations[i]);
        if let Some(m) = material {
            row.extend(m.albedo_logits[i]);
            row.extend([m.metallic_logits[i], m.roughness_logits[i]]);
        }
        for value in &row {
            w.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

fn write_header(
    w: &mut dyn Write,
    cloud: &SurfelCloud,
    style: PlyStyle,
    per_channel: usize,
) -> io::Result<()> {
    let encoding = match cloud.color_encoding {
        ColorEncoding::Srgb => "srgb",
        ColorEncoding::Linear => "linear",
    };
    write!(w, "ply\nformat binary_little_endian 1.0\ncomment {ENCODING_COMMENT} {encoding}\n")?;
    writeln!(w, "element vertex {}", cloud.len())?;
    let mut names: Vec<String> =
        ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from).into();
    names.extend((0..3 * per_channel).map(|i| format!("f_rest_{i}")));
    names.extend(["opacity", "scale_0", "scale_1"].map(String::from));
    if style == PlyStyle::Viewer {
        names.push("scale_2".into());
    }
    names.extend(["rot_0", "rot_1", "rot_2", "rot_3"].map(String::from));
    if cloud.material.is_some() && style == PlyStyle::Asset {
        names.extend(MATERIAL.map(String::from));
    }
    for name in names {
        writeln!(w, "property float {name}")?;
    }
    writeln!(w, "end_header")
}
