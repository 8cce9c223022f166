//! Whose PLY a header describes, and how its material columns become values.

use super::{Element, Header};
use crate::activation::ScaledSigmoid;

/// Header comment that marks a file of ours and says what the harmonic sum means.
pub(super) const ENCODING_COMMENT: &str = "comgs color_encoding";

/// Columns without which there are no surfels.
pub(super) const REQUIRED: [&str; 13] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2",
    "rot_3",
];

/// Our material columns.
pub(super) const MATERIAL: [&str; 5] = ["albedo_0", "albedo_1", "albedo_2", "metallic", "roughness"];

/// What a material column's name begins with.
const MATERIAL_PREFIXES: [&str; 4] = ["albedo", "base_color", "metallic", "roughness"];

/// What R3DG's columns of incident light and visibility begin with.
const LIGHT_PREFIXES: [&str; 2] = ["incidents_", "visibility_"];

/// The dialects with material, for messages.
pub(super) const KNOWN_MATERIAL: &str = "ComGS (albedo_0..2 metallic roughness, two scales), \
     GS-IR (albedo_0..2 roughness metallic, three scales), \
     R3DG (base_color_0..2 roughness, three scales), IRGS (base_color_0..2 roughness, two scales)";

/// Base colour of R3DG and IRGS.
const BASE_COLOR: ScaledSigmoid = ScaledSigmoid { scale: 0.77, offset: 0.03 };
/// Roughness of R3DG.
const R3DG_ROUGHNESS: ScaledSigmoid = ScaledSigmoid { scale: 0.9, offset: 0.09 };

/// Whose PLY it is, told by comments and columns.
///
/// | dialect | scales | base colour columns |
/// |---|---|---|
/// | ComGS | 2 | `albedo_0..2` |
/// | GS-IR | 3 | `albedo_0..2` |
/// | R3DG | 3 | `base_color_0..2` |
/// | IRGS | 2 | `base_color_0..2` |
/// | 2DGS, 3DGS | 2, 3 | none |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyDialect {
    /// Written by this program (`comment comgs color_encoding …`).
    Comgs,
    /// Two scales and albedo columns: a decomposed asset of the ComGS paper's layout.
    ComgsPublished,
    /// Two scales: 2D Gaussian splatting.
    TwoDgs,
    /// Three scales: 3D Gaussian splatting. Read as surfels across the axis of the smallest scale.
    ThreeDgs,
    /// Three scales and base colour columns: Relightable 3D Gaussians. Read as [`PlyDialect::ThreeDgs`].
    R3dg,
    /// Two scales and base colour columns: Inter-Reflective Gaussian Splatting.
    Irgs,
    /// Three scales and albedo columns: GS-IR. Read as [`PlyDialect::ThreeDgs`].
    GsIr,
    /// Positions without Gaussian parameters.
    Points,
}

impl PlyDialect {
    /// What a header describes; `None` when its vertices have no position. Material columns of no known dialect (which
    /// reading refuses) do not count.
    #[must_use]
    pub fn of(header: &Header) -> Option<Self> {
        let vertex = header.vertex()?;
        let has = |name: &&str| vertex.position(name).is_some();
        if !["x", "y", "z"].iter().all(has) {
            return None;
        }
        if !REQUIRED.iter().all(has) {
            return Some(Self::Points);
        }
        Some(recognise(header, vertex).map_or_else(|_| plain(header, vertex), |(dialect, _)| dialect))
    }

    /// Name for people.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Comgs => "comgs",
            Self::ComgsPublished => "ComGS",
            Self::TwoDgs => "2DGS",
            Self::ThreeDgs => "3DGS",
            Self::R3dg => "R3DG",
            Self::Irgs => "IRGS",
            Self::GsIr => "GS-IR",
            Self::Points => "point cloud",
        }
    }

    /// Whether its Gaussians have three scales and become surfels on reading.
    #[must_use]
    pub fn has_three_scales(self) -> bool {
        matches!(self, Self::ThreeDgs | Self::R3dg | Self::GsIr)
    }
}

/// The material columns of a file and how they become values.
#[derive(Clone, Debug, PartialEq)]
pub struct PlyMaterial {
    /// Name of the base colour columns without their number: `albedo` or `base_color`.
    pub base: &'static str,
    /// Activation of the base colour (linear).
    pub base_activation: ScaledSigmoid,
    /// Activation of the roughness.
    pub roughness_activation: ScaledSigmoid,
    /// Activation of metallic; `None` when there is no such column, and metallic is 0.
    pub metallic_activation: Option<ScaledSigmoid>,
    /// What the header does not tell and was assumed; one sentence each.
    pub assumed: Vec<String>,
}

impl PlyMaterial {
    /// Columns and their activations, for people.
    #[must_use]
    pub fn describe(&self) -> String {
        let metallic = match self.metallic_activation {
            Some(activation) => format!("metallic = {activation}"),
            None => "no metallic (0)".to_owned(),
        };
        format!(
            "{}_0..2 = {}, roughness = {}, {metallic}",
            self.base, self.base_activation, self.roughness_activation
        )
    }
}

/// Material columns that belong to no known dialect.
pub(super) struct Unknown {
    /// The columns.
    pub(super) columns: Vec<String>,
    /// What is wrong with them.
    pub(super) reason: String,
}

/// Whose file it is when material is left aside.
fn plain(header: &Header, vertex: &Element) -> PlyDialect {
    if header.comments.iter().any(|c| c.starts_with(ENCODING_COMMENT)) {
        PlyDialect::Comgs
    } else if vertex.position("scale_2").is_some() {
        PlyDialect::ThreeDgs
    } else {
        PlyDialect::TwoDgs
    }
}

/// Columns of R3DG's incident light and visibility.
pub(super) fn light_columns(vertex: &Element) -> usize {
    let is_light = |name: &str| LIGHT_PREFIXES.iter().any(|p| name.starts_with(p));
    vertex.properties.iter().filter(|p| is_light(&p.name)).count()
}

/// Dialect and material of a header that has the [`REQUIRED`] columns.
///
/// # Errors
/// [`Unknown`] when there are material columns that no dialect has together.
pub(super) fn recognise(
    header: &Header,
    vertex: &Element,
) -> Result<(PlyDialect, Option<PlyMaterial>), Unknown> {
    let plain = plain(header, vertex);
    let is_material = |name: &str| MATERIAL_PREFIXES.iter().any(|p| name.starts_with(p));
    let columns: Vec<&str> =
        vertex.properties.iter().map(|p| p.name.as_str()).filter(|name| is_material(name)).collect();
    if columns.is_empty() {
        return Ok((plain, None));
    }
    let base = base_of(&columns, plain)
        .map_err(|reason| Unknown { columns: columns.iter().map(|&c| c.to_owned()).collect(), reason })?;
    let (three_scales, light) = (plain == PlyDialect::ThreeDgs, light_columns(vertex) > 0);
    let dialect = match (plain, base, three_scales) {
        (PlyDialect::Comgs, ..) => PlyDialect::Comgs,
        (_, "base_color", true) => PlyDialect::R3dg,
        (_, "base_color", false) => PlyDialect::Irgs,
        (_, _, true) => PlyDialect::GsIr,
        (_, _, false) => PlyDialect::ComgsPublished,
    };
    let metallic = columns.contains(&"metallic");
    let material = PlyMaterial {
        base,
        base_activation: if base == "base_color" { BASE_COLOR } else { ScaledSigmoid::PLAIN },
        roughness_activation: match dialect {
            PlyDialect::R3dg => R3DG_ROUGHNESS,
            _ => ScaledSigmoid::PLAIN,
        },
        metallic_activation: metallic.then_some(ScaledSigmoid::PLAIN),
        assumed: assumptions(dialect, metallic, light),
    };
    Ok((dialect, Some(material)))
}

/// The name of the base colour, if the columns are together those of a dialect; otherwise what is wrong.
fn base_of(columns: &[&str], plain: PlyDialect) -> Result<&'static str, String> {
    let any = |prefix: &str| columns.iter().any(|c| c.starts_with(prefix));
    let base = match (any("albedo"), any("base_color")) {
        (true, true) => return Err("albedo and base_color are two names of one thing".into()),
        (false, false) => return Err("there is no base colour: albedo_0..2 or base_color_0..2".into()),
        (true, false) => "albedo",
        (false, true) if plain == PlyDialect::Comgs => {
            return Err("comgs itself writes albedo_0..2, not base_color".into());
        }
        (false, true) => "base_color",
    };
    let mut expected: Vec<String> = (0..3).map(|c| format!("{base}_{c}")).collect();
    expected.push("roughness".into());
    if plain == PlyDialect::Comgs {
        expected.push("metallic".into());
    }
    let absent: Vec<&str> =
        expected.iter().map(String::as_str).filter(|name| !columns.contains(name)).collect();
    if !absent.is_empty() {
        return Err(format!("missing {}", absent.join(" ")));
    }
    expected.push("metallic".into());
    let unexpected: Vec<&str> =
        columns.iter().copied().filter(|c| !expected.iter().any(|e| e == c)).collect();
    if !unexpected.is_empty() {
        return Err(format!("no dialect has {}", unexpected.join(" ")));
    }
    Ok(base)
}

fn assumptions(dialect: PlyDialect, metallic: bool, light: bool) -> Vec<String> {
    let mut assumed = Vec::new();
    let mut assume = |when: bool, text: &str| {
        if when {
            assumed.push(text.to_owned());
        }
    };
    let r3dg = dialect == PlyDialect::R3dg;
    assume(
        r3dg && !light,
        "base_color beside three scales is taken for R3DG, although there are no incidents_ and visibility_ columns",
    );
    assume(
        dialect == PlyDialect::Irgs && light,
        "base_color beside two scales is taken for IRGS (roughness a plain sigmoid), although there are incidents_ \
         or visibility_ columns, as R3DG has them",
    );
    assume(
        dialect == PlyDialect::GsIr && light,
        "albedo beside three scales is taken for GS-IR, although there are incidents_ or visibility_ columns, as R3DG \
         has them",
    );
    assume(
        metallic && (r3dg || dialect == PlyDialect::Irgs),
        "metallic is taken for a plain sigmoid; the published form of this dialect has no such column",
    );
    assumed
}
