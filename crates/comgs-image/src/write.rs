//! Writing of PNG (sRGB, 8 bit), EXR and HDR (linear).

use crate::{Image, atomic, transfer};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A file that could not be written.
#[derive(Debug, Error)]
#[error("cannot write ({reason}): {}", path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

fn failed(path: &Path, reason: impl ToString) -> WriteError {
    WriteError { path: path.to_owned(), reason: reason.to_string() }
}

/// Writes linear radiance as an 8-bit sRGB PNG, clipped to [0, 1]. 1 channel is grey, 3 RGB, 4 RGB with straight
/// alpha (alpha is stored linearly).
///
/// # Errors
/// [`WriteError`]; the target is then unchanged.
pub fn write_png(path: &Path, image: &Image) -> Result<(), WriteError> {
    let color = match image.channels {
        1 => image::ExtendedColorType::L8,
        3 => image::ExtendedColorType::Rgb8,
        4 => image::ExtendedColorType::Rgba8,
        n => return Err(failed(path, format!("a PNG has 1, 3 or 4 channels, not {n}"))),
    };
    let bytes: Vec<u8> = image
        .data
        .iter()
        .enumerate()
        .map(|(i, &v)| {
            if image.channels == 4 && i % 4 == 3 {
                (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
            } else {
                transfer::srgb8_from_linear(v)
            }
        })
        .collect();
    let mut encoded = Vec::new();
    image::ImageEncoder::write_image(
        image::codecs::png::PngEncoder::new(&mut encoded),
        &bytes,
        image.width as u32,
        image.height as u32,
        color,
    )
    .map_err(|e| failed(path, e))?;
    atomic::write_file(path, |w| w.write_all(&encoded)).map_err(|e| failed(path, e))
}

/// Writes linear radiance as Radiance HDR: three channels of one shared exponent (a relative error of 1/256 of the
/// largest channel); negative values become 0.
///
/// # Errors
/// [`WriteError`] when the image has not three channels or cannot be written; the target is then unchanged.
pub fn write_hdr(path: &Path, image: &Image) -> Result<(), WriteError> {
    if image.channels != 3 {
        return Err(failed(path, format!("an HDR has 3 channels, not {}", image.channels)));
    }
    let pixels: Vec<image::Rgb<f32>> = image
        .data
        .chunks_exact(3)
        .map(|p| image::Rgb([p[0].max(0.0), p[1].max(0.0), p[2].max(0.0)]))
        .collect();
    let mut encoded = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut encoded)
        .encode(&pixels, image.width, image.height)
        .map_err(|e| failed(path, e))?;
    atomic::write_file(path, |w| w.write_all(&encoded)).map_err(|e| failed(path, e))
}

/// One layer of a multilayer EXR: its channels are named `<layer>.<channel>`.
#[derive(Clone, Debug)]
pub struct Layer<'a> {
    /// Layer name; empty for the default layer, whose channels then have plain names (R, G, B, A).
    pub name: &'a str,
    /// Channel names, one for each channel of the image (`["R", "G", "B"]`, `["Z"]`, …).
    pub channels: &'a [&'a str],
    /// The samples.
    pub image: &'a Image,
    /// Full 32-bit floats instead of halves (depth wants them).
    pub full_float: bool,
}

/// Writes linear radiance as EXR: 1 channel `Y`, 3 `R G B`, 4 `R G B A`; half float, ZIP.
///
/// # Errors
/// [`WriteError`]; the target is then unchanged.
pub fn write_exr(path: &Path, image: &Image) -> Result<(), WriteError> {
    let encoded = encode_exr(path, image)?;
    atomic::write_file(path, |w| w.write_all(&encoded)).map_err(|e| failed(path, e))
}

/// The bytes that [`write_exr`] writes; `path` is only for messages.
///
/// # Errors
/// As [`write_exr`], but for the file's own.
pub fn encode_exr(path: &Path, image: &Image) -> Result<Vec<u8>, WriteError> {
    let channels: &[&str] = match image.channels {
        1 => &["Y"],
        3 => &["R", "G", "B"],
        4 => &["R", "G", "B", "A"],
        n => return Err(failed(path, format!("an EXR of 1, 3 or 4 channels was expected, not {n}"))),
    };
    encode_layers(path, &[Layer { name: "", channels, image, full_float: image.channels == 1 }])
}

/// Writes a single-part EXR whose channels are named `layer.channel`, the form that Nuke, Blender and other
/// compositors list as layers. Values beyond the half range are clamped to ±65504 in half layers.
///
/// # Errors
/// [`WriteError`] when the layers differ in size or the file cannot be written.
pub fn write_layers(path: &Path, layers: &[Layer<'_>]) -> Result<(), WriteError> {
    let encoded = encode_layers(path, layers)?;
    atomic::write_file(path, |w| w.write_all(&encoded)).map_err(|e| failed(path, e))
}

fn encode_layers(path: &Path, layers: &[Layer<'_>]) -> Result<Vec<u8>, WriteError> {
    use exr::prelude::*;
    let Some(first) = layers.first() else { return Err(failed(path, "no layers")) };
    let (width, height) = (first.image.width, first.image.height);
    let mut list: SmallVec<[AnyChannel<FlatSamples>; 4]> = SmallVec::new();
    for layer in layers {
        if (layer.image.width, layer.image.height) != (width, height) {
            return Err(failed(path, format!("layer {} differs in size", layer.name)));
        }
        if layer.channels.len() != layer.image.channels {
            return Err(failed(path, format!("layer {} has {} channels", layer.name, layer.image.channels)));
        }
        for (c, channel) in layer.channels.iter().enumerate() {
            let name = if layer.name.is_empty() {
                (*channel).to_owned()
            } else {
                format!("{}.{channel}", layer.name)
            };
            let values = layer.image.data.iter().skip(c).step_by(layer.image.channels).copied();
            let samples = if layer.full_float {
                FlatSamples::F32(values.collect())
            } else {
                FlatSamples::F16(values.map(|v| f16::from_f32(v.clamp(-65504.0, 65504.0))).collect())
            };
            let text =
                Text::new_or_none(&name).ok_or_else(|| failed(path, format!("bad channel name {name}")))?;
            list.push(AnyChannel::new(text, samples));
        }
    }
    let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
    let layer = exr::prelude::Layer::new(
        (width, height),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(list),
    );
    let mut encoded = std::io::Cursor::new(Vec::new());
    exr::prelude::Image::from_layer(layer)
        .write()
        .non_parallel()
        .to_buffered(&mut encoded)
        .map_err(|e| failed(path, e))?;
    Ok(encoded.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read;

    fn ramp(channels: usize) -> Image {
        Image::from_data(5, 4, channels, (0..5 * 4 * channels).map(|i| i as f32 * 0.125).collect())
    }

    /// Goal: what is written is what is read back, for all channel counts of EXR.
    #[test]
    fn exr_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        for channels in [1, 3, 4] {
            let path = folder.path().join(format!("{channels}.exr"));
            let image = ramp(channels);
            write_exr(&path, &image).unwrap();
            let back = read(&path).unwrap();
            let mut expected = image.clone();
            if channels == 4 {
                expected = image.select(&[0, 1, 2]);
                assert_eq!(back.alpha.unwrap(), image.select(&[3]));
            }
            assert_eq!(back.color, expected);
            assert_eq!(read::dimensions(&path).unwrap(), (5, 4));
            let names = read::exr_channels(&path).unwrap();
            assert_eq!(names.len(), channels);
            assert!(
                names.contains(&(if channels == 1 { "Y:float" } else { "G:half" }).to_owned()),
                "{names:?}"
            );
        }
    }

    /// Goal: radiance far above 1 survives HDR to the precision of the format.
    #[test]
    fn hdr_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdr");
        let image = ramp(3).map(|v| v * 40.0);
        write_hdr(&path, &image).unwrap();
        let back = read(&path).unwrap();
        assert_eq!(back.encoding, crate::Encoding::Linear);
        for (a, b) in image.data.chunks_exact(3).zip(back.color.data.chunks_exact(3)) {
            let step = a.iter().fold(0.0, |m: f32, v| m.max(*v)) / 128.0;
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step), "{a:?} {b:?}");
        }
        assert!(write_hdr(&path, &ramp(4)).is_err());
    }

    /// Goal: an 8-bit picture survives PNG, with straight alpha kept linear.
    #[test]
    fn png_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let image = ramp(4).map(|v| v / 10.0);
        write_png(&path, &image).unwrap();
        let back = read(&path).unwrap();
        for (a, b) in image.select(&[0, 1, 2]).data.iter().zip(&back.color.data) {
            assert!((a - b).abs() < 4.5e-3, "{a} {b}");
        }
        let alpha = back.alpha.unwrap();
        assert!((alpha.data[7] - image.data[7 * 4 + 3]).abs() < 0.5 / 255.0 + 1e-6);
    }

    /// Goal: damaged files are errors that name the path, never panics (hard case 34).
    #[test]
    fn damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let good = folder.path().join("good.exr");
        write_exr(&good, &ramp(3)).unwrap();
        let bytes = std::fs::read(&good).unwrap();
        let bad = folder.path().join("bad.exr");
        for length in [0, 3, 4, 20, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&bad, &bytes[..length]).unwrap();
            let message = read(&bad).unwrap_err().to_string();
            assert!(message.contains("bad.exr"), "{message}");
        }
        let missing = read(&folder.path().join("none.png")).unwrap_err().to_string();
        assert!(missing.contains("none.png"));
    }
}
