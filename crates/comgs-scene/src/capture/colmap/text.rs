//! COLMAP's text files.

use super::{ColmapCamera, ColmapImage, model, push_point};
use crate::SceneError;
use comgs_surfel::PointCloud;
use std::io::{BufRead, Read};
use std::path::Path;
use std::str::FromStr;

/// Longest line whose content matters; lines of 2D points and tracks may be longer and are skipped.
const MAX_LINE: u64 = 1 << 16;

/// Lines with their numbers.
struct Lines<'a, R> {
    reader: R,
    number: usize,
    path: &'a Path,
}

impl<R: BufRead> Lines<'_, R> {
    /// The beginning (at most [`MAX_LINE`] bytes) of the next line, trimmed; `None` at the end.
    fn next(&mut self) -> Result<Option<String>, SceneError> {
        let mut line = Vec::new();
        self.reader
            .by_ref()
            .take(MAX_LINE)
            .read_until(b'\n', &mut line)
            .map_err(SceneError::io(self.path))?;
        if line.is_empty() {
            return Ok(None);
        }
        self.number += 1;
        if line.last() != Some(&b'\n') {
            self.reader.skip_until(b'\n').map_err(SceneError::io(self.path))?;
        }
        Ok(Some(String::from_utf8_lossy(&line).trim().to_owned()))
    }

    /// The next line that is neither empty nor a comment.
    fn next_record(&mut self) -> Result<Option<String>, SceneError> {
        while let Some(line) = self.next()? {
            if !line.is_empty() && !line.starts_with('#') {
                return Ok(Some(line));
            }
        }
        Ok(None)
    }

    fn error(&self, reason: impl std::fmt::Display) -> SceneError {
        SceneError::malformed(self.path, format!("line {}: {reason}", self.number))
    }

    fn value<T: FromStr>(&self, word: Option<&str>, what: &str) -> Result<T, SceneError> {
        let word = word.ok_or_else(|| self.error(format!("{what} is missing")))?;
        word.parse().map_err(|_| self.error(format!("{what} is {word:?}, expected a number")))
    }
}

/// `cameras.txt`; `path` is only for messages.
///
/// # Errors
/// [`SceneError::Malformed`] with the line.
pub fn parse_cameras_text(reader: impl BufRead, path: &Path) -> Result<Vec<ColmapCamera>, SceneError> {
    let mut lines = Lines { reader, number: 0, path };
    let mut cameras = Vec::new();
    while let Some(line) = lines.next_record()? {
        let mut words = line.split_ascii_whitespace();
        let id = lines.value(words.next(), "the camera number")?;
        let name = words.next().ok_or_else(|| lines.error("the camera model is missing"))?;
        let width = lines.value(words.next(), "the width")?;
        let height = lines.value(words.next(), "the height")?;
        let parameters =
            words.map(|w| lines.value(Some(w), "a camera parameter")).collect::<Result<Vec<f64>, _>>()?;
        cameras.push(ColmapCamera { id, width, height, model: model(name, &parameters) });
        if cameras.len() > crate::json::MAX_FRAMES {
            return Err(lines.error(format!("more than {} cameras", crate::json::MAX_FRAMES)));
        }
    }
    Ok(cameras)
}

/// `images.txt`; every second line, which holds 2D points and may be empty, is skipped. `path` is only for messages.
///
/// # Errors
/// [`SceneError::Malformed`] with the line.
pub fn parse_images_text(reader: impl BufRead, path: &Path) -> Result<Vec<ColmapImage>, SceneError> {
    let mut lines = Lines { reader, number: 0, path };
    let mut images = Vec::new();
    while let Some(line) = lines.next_record()? {
        let mut rest = line.as_str();
        let mut words = std::iter::from_fn(|| {
            let (word, after) =
                rest.trim_start().split_once(char::is_whitespace).unwrap_or((rest.trim_start(), ""));
            rest = after;
            (!word.is_empty()).then_some(word)
        });
        let id = lines.value(words.next(), "the image number")?;
        let mut number = |what| lines.value::<f64>(words.next(), what);
        let rotation = [number("qw")?, number("qx")?, number("qy")?, number("qz")?];
        let translation = [number("tx")?, number("ty")?, number("tz")?];
        let camera_id = lines.value(words.next(), "the camera number")?;
        // The name is the rest of the line: it may have spaces.
        let name = rest.trim();
        if name.is_empty() {
            return Err(lines.error("the image name is missing"));
        }
        images.push(ColmapImage { id, rotation, translation, camera_id, name: name.to_owned() });
        if images.len() > crate::json::MAX_FRAMES {
            return Err(lines.error(format!("more than {} images", crate::json::MAX_FRAMES)));
        }
        lines.next()?;
    }
    Ok(images)
}

/// `points3D.txt`; tracks are skipped. `path` is only for messages.
///
/// # Errors
/// [`SceneError::Malformed`] with the line.
pub fn parse_points_text(reader: impl BufRead, path: &Path) -> Result<PointCloud, SceneError> {
    let mut lines = Lines { reader, number: 0, path };
    let mut cloud = PointCloud::default();
    while let Some(line) = lines.next_record()? {
        let mut words = line.split_ascii_whitespace();
        let _: u64 = lines.value(words.next(), "the point number")?;
        let mut position = [0.0; 3];
        for v in &mut position {
            *v = lines.value(words.next(), "a coordinate")?;
        }
        let mut rgb = [0; 3];
        for v in &mut rgb {
            *v = lines.value(words.next(), "a colour")?;
        }
        push_point(&mut cloud, position, rgb);
    }
    Ok(cloud)
}
