//! The layers of a relit frame as one multilayer EXR.

use super::RelitFrame;
use comgs_image::{Layer, WriteError, write_layers};
use std::path::Path;

/// Writes a frame as one multilayer EXR (half float but for depth) that Nuke and Blender list as layers. Without
/// [`RelitFrame::layers`] only the first is written.
///
/// | layer | channels | what |
/// |---|---|---|
/// | (default) | R G B A | beauty, linear, premultiplied by A = W: `diffuse + specular + indirect` |
/// | `diffuse` | R G B | light by the matte term, premultiplied |
/// | `specular` | R G B | light by the highlight, premultiplied |
/// | `indirect` | R G B | light by way of the object itself, premultiplied |
/// | `visibility` | Y | what the object leaves open of the hemisphere, by cosine |
/// | `depth` | Z | unbiased z-depth, world units, 32-bit float, 0 where undefined |
/// | `normal` | X Y Z | world space, unit, zero where undefined |
/// | `albedo` | R G B | linear base colour, not premultiplied |
/// | `roughness`, `metallic` | Y | not premultiplied |
///
/// # Errors
/// [`WriteError`] when the file cannot be written; the old file is then unchanged.
pub fn write_relit_layers(path: &Path, frame: &RelitFrame) -> Result<(), WriteError> {
    let rgb: &[&str] = &["R", "G", "B"];
    let grey: &[&str] = &["Y"];
    let half = |name, channels, image| Layer { name, channels, image, full_float: false };
    let mut all = vec![half("", rgb, &frame.radiance), half("", &["A"], &frame.weight)];
    if let Some(l) = &frame.layers {
        all.extend([
            half("diffuse", rgb, &l.diffuse),
            half("specular", rgb, &l.specular),
            half("indirect", rgb, &l.indirect),
            half("visibility", grey, &l.visibility),
            Layer { name: "depth", channels: &["Z"], image: &l.depth, full_float: true },
            half("normal", &["X", "Y", "Z"], &l.normal),
            half("albedo", rgb, &l.albedo),
            half("roughness", grey, &l.roughness),
            half("metallic", grey, &l.metallic),
        ]);
    }
    write_layers(path, &all)
}
