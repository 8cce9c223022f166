//! What the stages that make pictures share: camera lists, names of frames, previews.

use crate::PipelineError;
use comgs_geom::Camera;
use comgs_image::{Image, transfer::srgb8_from_linear};
use std::path::Path;

/// Reads cameras and insists that there are some and that every name can be a file's.
pub(crate) fn read_cameras(path: &Path) -> Result<Vec<Camera>, PipelineError> {
    let cameras = comgs_scene::read_cameras(path)?;
    if cameras.is_empty() {
        return Err(PipelineError::input(path.display().to_string(), "at least one camera", "none"));
    }
    Ok(cameras)
}

/// 8-bit sRGB of the first three channels, row by row.
pub(crate) fn rgb8(image: &Image) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(image.pixels() * 3);
    for pixel in image.data.chunks_exact(image.channels) {
        let grey = image.channels < 3;
        bytes.extend((0..3).map(|c| srgb8_from_linear(pixel[if grey { 0 } else { c }])));
    }
    bytes
}

/// Largest width of a frame in an animated preview: GIF is no format for large pictures.
const PREVIEW_WIDTH: usize = 480;

/// Writes an animated GIF that loops for ever.
///
/// Frames larger than [`PREVIEW_WIDTH`] are reduced; frames of different sizes are brought to the first one's.
pub(crate) fn write_gif(path: &Path, frames: &[&Image], milliseconds: u32) -> Result<(), PipelineError> {
    use image::codecs::gif::{GifEncoder, Repeat};
    let Some(first) = frames.first() else { return Ok(()) };
    let width = first.width.min(PREVIEW_WIDTH);
    let height = (first.height * width).div_ceil(first.width).max(1);
    let mut bytes = Vec::new();
    let failed = |e: image::ImageError| {
        PipelineError::Write(comgs_image::WriteError { path: path.to_owned(), reason: e.to_string() })
    };
    {
        // Speed 10 of 1 (best) to 30: the palette of 256 colours limits quality more than its search does.
        let mut encoder = GifEncoder::new_with_speed(&mut bytes, 10);
        encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
        for frame in frames {
            let small = frame.resized(width, height);
            let rgb = rgb8(&small);
            let rgba: Vec<u8> = rgb.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect();
            let buffer = image::RgbaImage::from_raw(width as u32, height as u32, rgba)
                .ok_or_else(|| PipelineError::Internal("a preview frame of the wrong size".into()))?;
            let delay = image::Delay::from_numer_denom_ms(milliseconds, 1);
            encoder.encode_frame(image::Frame::from_parts(buffer, 0, 0, delay)).map_err(failed)?;
        }
    }
    comgs_image::atomic::write_file(path, |w| w.write_all(&bytes)).map_err(|e| PipelineError::io(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: a preview is a GIF of the right size whose frames follow one another, reduced when large.
    #[test]
    fn previews_are_readable() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("preview.gif");
        let frames = [Image::filled(960, 480, 3, 0.2), Image::filled(960, 480, 3, 0.8)];
        write_gif(&path, &frames.iter().collect::<Vec<_>>(), 200).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(&bytes[..6], b"GIF89a");
        let decoder = image::codecs::gif::GifDecoder::new(std::io::Cursor::new(bytes)).unwrap();
        let frames: Vec<_> = image::AnimationDecoder::into_frames(decoder).map(Result::unwrap).collect();
        assert_eq!(frames.len(), 2);
        assert_eq!(frames[0].buffer().dimensions(), (480, 240));
        assert!(frames[0].buffer().get_pixel(3, 3).0[0] < frames[1].buffer().get_pixel(3, 3).0[0]);
    }
}
