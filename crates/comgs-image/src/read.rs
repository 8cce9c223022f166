//! Reading of EXR, HDR, PNG and JPEG into linear radiance.

use crate::{Image, transfer};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// How a file stores its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// 8 or 16 bit, sRGB-encoded, clipped at 1.
    Srgb,
    /// Floating point, linear.
    Linear,
}

/// An image as read: colour (1 or 3 channels, linear), and alpha when the file has it.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// One or three channels of linear radiance, not premultiplied (as stored).
    pub color: Image,
    /// One channel in [0, 1].
    pub alpha: Option<Image>,
    /// How the file stored its values.
    pub encoding: Encoding,
}

/// What can go wrong with an image file.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file could not be opened or read.
    #[error("{reason}: {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// The content is not an image that comgs reads.
    #[error("not a readable image ({reason}): {}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The decoder's words.
        reason: String,
    },
    /// The header asks for more pixels than comgs accepts.
    #[error("{width}×{height} pixels is more than the limit of {MAX_PIXELS}: {}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Declared width.
        width: usize,
        /// Declared height.
        height: usize,
    },
}

/// Largest accepted image (67 million pixels: 8192×8192, an 11k panorama); a header that asks for more is refused before
/// memory is taken. In floats and three channels it is 768 MiB.
pub const MAX_PIXELS: usize = 1 << 26;
/// Largest number of samples in all channels of an EXR: four channels at [`MAX_PIXELS`], or more in a smaller picture.
const MAX_SAMPLES: usize = 4 * MAX_PIXELS;
/// Pixels that one byte of a file can hold at most: a PNG of one bit a pixel, all equal, holds 8256 (deflate reaches 1032
/// to 1). A header that promises more is believed no further, so memory stays in proportion to the file.
const PIXELS_PER_BYTE: usize = 1 << 14;

/// Reads an image by its content's format (EXR by its magic number, others through `image`).
///
/// sRGB files are linearised; EXR and HDR are taken as linear Rec.709. An EXR with one channel (of any name) is
/// grey; `X, Y, Z` and `R, G, B` are both read as three channels.
///
/// # Errors
/// [`ReadError`]; memory use is bounded by [`MAX_PIXELS`].
pub fn read(path: &Path) -> Result<Loaded, ReadError> {
    let bytes = std::fs::read(path).map_err(|reason| ReadError::Io { path: path.to_owned(), reason })?;
    decode(&bytes, path)
}

/// Reads an image from memory; `path` is only for messages.
///
/// # Errors
/// As [`read`].
pub fn decode(bytes: &[u8], path: &Path) -> Result<Loaded, ReadError> {
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        decode_exr(bytes, path)
    } else {
        decode_other(bytes, path)
    }
}

/// Width and height from a file's header, without reading the pixels.
///
/// # Errors
/// As [`read`].
pub fn dimensions(path: &Path) -> Result<(usize, usize), ReadError> {
    let io = |reason| ReadError::Io { path: path.to_owned(), reason };
    let decode = |reason: String| ReadError::Decode { path: path.to_owned(), reason };
    let mut file = std::io::BufReader::new(std::fs::File::open(path).map_err(io)?);
    let mut magic = [0u8; 4];
    std::io::Read::read_exact(&mut file, &mut magic).map_err(|e| decode(e.to_string()))?;
    if magic == [0x76, 0x2f, 0x31, 0x01] {
        let meta = exr::meta::MetaData::read_from_file(path, false).map_err(|e| decode(e.to_string()))?;
        let size = meta.headers.first().ok_or_else(|| decode("no layer".into()))?.layer_size;
        return Ok((size.width(), size.height()));
    }
    let reader = image::ImageReader::open(path).map_err(io)?.with_guessed_format().map_err(io)?;
    let (w, h) = reader.into_dimensions().map_err(|e| decode(e.to_string()))?;
    Ok((w as usize, h as usize))
}

/// Names and sample types of an EXR's channels, all layers, in file order (`object.A:half`).
///
/// # Errors
/// As [`read`]; reads the header only.
pub fn exr_channels(path: &Path) -> Result<Vec<String>, ReadError> {
    let decode = |reason: String| ReadError::Decode { path: path.to_owned(), reason };
    let meta = exr::meta::MetaData::read_from_file(path, false).map_err(|e| decode(e.to_string()))?;
    let channels = meta.headers.iter().flat_map(|header| {
        header.channels.list.iter().map(|channel| {
            let kind = match channel.sample_type {
                exr::meta::attribute::SampleType::F16 => "half",
                exr::meta::attribute::SampleType::F32 => "float",
                exr::meta::attribute::SampleType::U32 => "uint",
            };
            format!("{}:{kind}", channel.name)
        })
    });
    Ok(channels.collect())
}

/// Whether a picture of this size may be decoded from a file of `bytes` bytes.
fn check_size(width: usize, height: usize, bytes: usize, path: &Path) -> Result<(), ReadError> {
    if width == 0 || height == 0 {
        return Err(ReadError::Decode { path: path.to_owned(), reason: "the image is empty".into() });
    }
    match width.checked_mul(height) {
        Some(n) if n <= MAX_PIXELS && n > bytes.saturating_mul(PIXELS_PER_BYTE) => {
            let reason = format!("{width}×{height} pixels cannot be in {bytes} bytes");
            Err(ReadError::Decode { path: path.to_owned(), reason })
        }
        Some(n) if n <= MAX_PIXELS => Ok(()),
        _ => Err(ReadError::TooLarge { path: path.to_owned(), width, height }),
    }
}

fn decode_exr(bytes: &[u8], path: &Path) -> Result<Loaded, ReadError> {
    use exr::prelude::{ReadChannels, ReadLayers};
    let error = |reason: String| ReadError::Decode { path: path.to_owned(), reason };
    let meta = exr::meta::MetaData::read_from_buffered(bytes, false).map_err(|e| error(e.to_string()))?;
    for header in &meta.headers {
        check_size(header.layer_size.width(), header.layer_size.height(), bytes.len(), path)?;
        let channels = header.channels.list.len();
        if header.layer_size.area().saturating_mul(channels) > MAX_SAMPLES {
            return Err(error(format!("{channels} channels are more than {MAX_SAMPLES} samples")));
        }
    }
    let exr_image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(std::io::Cursor::new(bytes))
        .map_err(|e| error(e.to_string()))?;
    let layer = exr_image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let channels = &layer.channel_data.list;
    // A channel's own name is what follows the last dot ("beauty.R" is R).
    let find = |name: &str| {
        channels.iter().find(|c| {
            let text = c.name.to_string();
            text.rsplit('.').next().is_some_and(|last| last.eq_ignore_ascii_case(name))
        })
    };
    let colour: Vec<_> = if let (Some(r), Some(g), Some(b)) = (find("R"), find("G"), find("B")) {
        vec![r, g, b]
    } else if let (Some(x), Some(y), Some(z)) = (find("X"), find("Y"), find("Z")) {
        vec![x, y, z]
    } else {
        let first =
            find("Y").or_else(|| channels.iter().find(|c| !c.name.to_string().eq_ignore_ascii_case("A")));
        vec![first.or(channels.first()).ok_or_else(|| error("no channels".into()))?]
    };
    let mut color = Image::zeros(width, height, colour.len());
    for (c, channel) in colour.iter().enumerate() {
        if channel.sample_data.len() != width * height {
            return Err(error(format!("channel {} is subsampled", channel.name)));
        }
        for (i, v) in channel.sample_data.values_as_f32().enumerate() {
            color.data[i * colour.len() + c] = v;
        }
    }
    let alpha = find("A")
        .filter(|a| a.sample_data.len() == width * height)
        .map(|a| Image::from_data(width, height, 1, a.sample_data.values_as_f32().collect()));
    Ok(Loaded { color, alpha, encoding: Encoding::Linear })
}

fn decode_other(bytes: &[u8], path: &Path) -> Result<Loaded, ReadError> {
    use image::{ColorType, DynamicImage};
    let error = |reason: String| ReadError::Decode { path: path.to_owned(), reason };
    let guess = || {
        image::ImageReader::new(std::io::Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|e| error(e.to_string()))
    };
    let (w, h) = guess()?.into_dimensions().map_err(|e| error(e.to_string()))?;
    let (width, height) = (w as usize, h as usize);
    check_size(width, height, bytes.len(), path)?;
    let mut reader = guess()?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_PIXELS as u64 * 16);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| error(e.to_string()))?;
    let linear = matches!(decoded, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_));
    let has_alpha = decoded.color().has_alpha();
    let samples: Vec<f32> = if decoded.color() == ColorType::Rgb8 || decoded.color() == ColorType::L8 {
        let table: Vec<f32> = (0..256).map(|i| transfer::linear_from_srgb(i as f32 / 255.0)).collect();
        let rgb = decoded.into_rgb8();
        return Ok(Loaded {
            color: Image::from_data(width, height, 3, rgb.iter().map(|&b| table[b as usize]).collect()),
            alpha: None,
            encoding: Encoding::Srgb,
        });
    } else {
        decoded.into_rgba32f().into_raw()
    };
    let mut color = Image::zeros(width, height, 3);
    let mut alpha = Image::zeros(width, height, 1);
    for (i, p) in samples.chunks_exact(4).enumerate() {
        for c in 0..3 {
            color.data[i * 3 + c] = if linear { p[c] } else { transfer::linear_from_srgb(p[c]) };
        }
        alpha.data[i] = p[3];
    }
    Ok(Loaded {
        color,
        alpha: has_alpha.then_some(alpha),
        encoding: if linear { Encoding::Linear } else { Encoding::Srgb },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    /// A PNG chunk with its checksum.
    fn chunk(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
        let body = [&kind[..], content].concat();
        let crc = !body.iter().fold(!0u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |c, _| (c >> 1) ^ (0xedb8_8320 & (c & 1).wrapping_neg()))
        });
        [&(content.len() as u32).to_be_bytes(), &body[..], &crc.to_be_bytes()].concat()
    }

    /// The beginning of a PNG of 8-bit greys whose header is sound.
    fn png_header(width: u32, height: u32) -> Vec<u8> {
        let size = [width.to_be_bytes(), height.to_be_bytes()].concat();
        let header = [&size[..], &[8, 0, 0, 0, 0]].concat();
        [b"\x89PNG\r\n\x1a\n".to_vec(), chunk(b"IHDR", &header), chunk(b"IDAT", &[0x78, 0x9c])].concat()
    }

    /// Goal: a small file that asks for 16000×16000 pixels (three gigabytes in floats) is refused from its header
    /// (hard case 34); what is just below the limit is not refused for its size.
    #[test]
    fn giants_are_refused_quickly() {
        let bytes = png_header(16_000, 16_000);
        let start = Instant::now();
        let error = decode(&bytes, Path::new("giant.png")).unwrap_err();
        assert!(matches!(error, ReadError::TooLarge { width: 16_000, height: 16_000, .. }), "{error}");
        // Reading the header takes microseconds, decoding seconds.
        assert!(start.elapsed() < Duration::from_millis(200), "{:?}", start.elapsed());
        let small = decode(&png_header(16, 16), Path::new("small.png")).unwrap_err();
        assert!(matches!(small, ReadError::Decode { .. }), "{small}");
        let size = |w, h, bytes| check_size(w, h, bytes, Path::new("x")).is_ok();
        assert!(size(8192, 8192, 8200) && !size(8192, 8193, 8200) && !size(usize::MAX, 2, usize::MAX));
        assert!(!size(8192, 8192, 500), "half a kilobyte holds no such picture");
    }
}
