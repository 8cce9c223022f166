//! The layers of a frame as one multilayer EXR.

use crate::frame::ComposedFrame;
use comgs_image::{Layer, WriteError, write_layers};
use std::path::Path;

/// Writes a frame as one multilayer half-float EXR that Nuke and Blender list as layers.
///
/// | layer | channels | what |
/// |---|---|---|
/// | (default) | R G B A | beauty, linear, A = weight of everything |
/// | `object` | R G B A | the object, premultiplied, after occlusion by the scene |
/// | `scene` | R G B | the scene that is still seen, before its shadow: `beauty = object + scene · shadow` |
/// | `shadow` | R G B | ratio in [0, 1] |
/// | `empty` | R G B | the scene without the object |
/// | `depth` | Z | z-depth, world units, 32-bit float, 0 where undefined |
/// | `normal` | X Y Z | world space, unit, zero where undefined |
/// | `mask` | Y | coverage of the object after occlusion (also `object.A`) |
///
/// # Errors
/// [`WriteError`] when the file cannot be written; the old file is then unchanged.
pub fn write_frame_layers(path: &Path, frame: &ComposedFrame) -> Result<(), WriteError> {
    let rgb: &[&str] = &["R", "G", "B"];
    let half = |name, channels, image| Layer { name, channels, image, full_float: false };
    write_layers(
        path,
        &[
            half("", rgb, &frame.beauty),
            half("", &["A"], &frame.weight),
            half("object", &["R", "G", "B", "A"], &frame.object),
            half("scene", rgb, &frame.scene),
            half("shadow", rgb, &frame.shadow),
            half("empty", rgb, &frame.empty),
            Layer { name: "depth", channels: &["Z"], image: &frame.depth, full_float: true },
            half("normal", &["X", "Y", "Z"], &frame.normal),
            half("mask", &["Y"], &frame.mask),
        ],
    )
}
