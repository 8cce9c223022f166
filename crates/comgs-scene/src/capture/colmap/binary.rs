//! COLMAP's binary files: little endian, each a count and that many records.

use super::{ColmapCamera, ColmapImage, MODELS, model, push_point};
use crate::SceneError;
use comgs_surfel::PointCloud;
use std::io::{BufRead, Read};
use std::path::Path;

/// Longest accepted image name.
const MAX_NAME: u64 = 4096;

/// A byte source that knows how much is left, so that counts can be checked before memory is taken.
struct Source<'a, R> {
    reader: R,
    remaining: u64,
    path: &'a Path,
}

impl<R: BufRead> Source<'_, R> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], SceneError> {
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes).map_err(|_| self.cut())?;
        self.remaining = self.remaining.saturating_sub(N as u64);
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, SceneError> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, SceneError> {
        self.bytes().map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], SceneError> {
        let mut values = [0.0; N];
        for v in &mut values {
            *v = f64::from_le_bytes(self.bytes()?);
        }
        Ok(values)
    }

    fn skip(&mut self, count: u64, stride: u64) -> Result<(), SceneError> {
        let length = count.checked_mul(stride).filter(|&n| n <= self.remaining).ok_or_else(|| self.cut())?;
        let skipped = std::io::copy(&mut self.reader.by_ref().take(length), &mut std::io::sink());
        if skipped.map_err(SceneError::io(self.path))? != length {
            return Err(self.cut());
        }
        self.remaining -= length;
        Ok(())
    }

    /// A record count, checked against what the file can hold.
    fn count(&mut self, least_stride: u64) -> Result<usize, SceneError> {
        let count = self.u64()?;
        if count > self.remaining / least_stride {
            let reason = format!(
                "the file promises {count} records of at least {least_stride} bytes, but only {} bytes follow",
                self.remaining
            );
            return Err(SceneError::malformed(self.path, reason));
        }
        Ok(count as usize)
    }

    fn name(&mut self) -> Result<String, SceneError> {
        let mut name = Vec::new();
        let read = self
            .reader
            .by_ref()
            .take(MAX_NAME)
            .read_until(0, &mut name)
            .map_err(SceneError::io(self.path))?;
        self.remaining = self.remaining.saturating_sub(read as u64);
        if name.pop() != Some(0) {
            return Err(SceneError::malformed(self.path, "an image name does not end"));
        }
        String::from_utf8(name).map_err(|_| SceneError::malformed(self.path, "an image name is not UTF-8"))
    }

    fn cut(&self) -> SceneError {
        SceneError::malformed(self.path, "the file ends in the middle of its data")
    }
}

/// `cameras.bin` of `length` bytes; `path` is only for messages.
///
/// # Errors
/// [`SceneError::Malformed`]. A camera model that is not understood is an error of that camera, not of the file, as
/// long as its parameter count is known.
pub fn parse_cameras_binary(
    reader: impl BufRead,
    length: u64,
    path: &Path,
) -> Result<Vec<ColmapCamera>, SceneError> {
    let mut source = Source { reader, remaining: length, path };
    let count = source.count(48)?;
    let mut cameras = Vec::with_capacity(count);
    for _ in 0..count {
        let (id, number) = (source.u32()?, source.u32()?);
        let (width, height) = (source.u64()?, source.u64()?);
        let Some(&(name, parameters)) = MODELS.get(number as usize) else {
            return Err(SceneError::malformed(
                path,
                format!("camera {id} has the unknown model number {number}"),
            ));
        };
        let mut values = Vec::with_capacity(parameters);
        for _ in 0..parameters {
            values.push(source.f64s::<1>()?[0]);
        }
        cameras.push(ColmapCamera { id, width, height, model: model(name, &values) });
    }
    Ok(cameras)
}

/// `images.bin` of `length` bytes; the 2D points are skipped. `path` is only for messages.
///
/// # Errors
/// [`SceneError::Malformed`].
pub fn parse_images_binary(
    reader: impl BufRead,
    length: u64,
    path: &Path,
) -> Result<Vec<ColmapImage>, SceneError> {
    let mut source = Source { reader, remaining: length, path };
    let count = source.count(73)?;
    if count > crate::json::MAX_FRAMES {
        return Err(SceneError::malformed(
            path,
            format!("{count} images, expected at most {}", crate::json::MAX_FRAMES),
        ));
    }
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let id = source.u32()?;
        let rotation = source.f64s()?;
        let translation = source.f64s()?;
        let camera_id = source.u32()?;
        let name = source.name()?;
        let points = source.u64()?;
        source.skip(points, 24)?;
        images.push(ColmapImage { id, rotation, translation, camera_id, name });
    }
    Ok(images)
}

/// `points3D.bin` of `length` bytes; tracks are skipped. `path` is only for messages.
///
/// # Errors
/// [`SceneError::Malformed`].
pub fn parse_points_binary(reader: impl BufRead, length: u64, path: &Path) -> Result<PointCloud, SceneError> {
    let mut source = Source { reader, remaining: length, path };
    let count = source.count(51)?;
    let mut cloud = PointCloud { positions: Vec::with_capacity(count), ..PointCloud::default() };
    for _ in 0..count {
        source.u64()?;
        let position = source.f64s()?;
        let rgb = source.bytes()?;
        source.bytes::<8>()?;
        let track = source.u64()?;
        source.skip(track, 8)?;
        push_point(&mut cloud, position, rgb);
    }
    Ok(cloud)
}
