//! What a photo says about its camera.

use std::io::Cursor;

/// Width in millimetres of the film that "35 mm equivalent" refers to.
const FILM_WIDTH_MM: f64 = 36.0;

/// Horizontal field of view in radians from EXIF: the focal length for 35 mm film, or the focal length with the sensor's
/// resolution. `None` where the photo states neither, or nonsense.
///
/// * `bytes`: the photo's file
/// * `width`, `height`: its size in pixels. The equivalent focal length is taken for the longer side of the film along
///   the longer side of the photo.
#[must_use]
pub fn field_of_view(bytes: &[u8], width: usize, height: usize) -> Option<f64> {
    let exif = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)).ok()?;
    let number = |tag| -> Option<f64> {
        let value = &exif.get_field(tag, exif::In::PRIMARY)?.value;
        let number = match value {
            exif::Value::Rational(r) => r.first()?.to_f64(),
            other => f64::from(other.get_uint(0)?),
        };
        (number > 0.0 && number.is_finite()).then_some(number)
    };
    let (w, h) = (width as f64, height as f64);
    // Focal length over the photo's width.
    let focal = match number(exif::Tag::FocalLengthIn35mmFilm) {
        Some(mm) => mm / FILM_WIDTH_MM * w.max(h) / w,
        None => {
            let per_unit = number(exif::Tag::FocalPlaneXResolution)?;
            let unit_mm = match number(exif::Tag::FocalPlaneResolutionUnit).unwrap_or(2.0) as u32 {
                3 => 10.0,
                4 => 1.0,
                _ => 25.4,
            };
            let sensor_pixels = number(exif::Tag::PixelXDimension).unwrap_or(w.max(h));
            number(exif::Tag::FocalLength)? * per_unit / unit_mm / sensor_pixels * w.max(h) / w
        }
    };
    let fov = 2.0 * (0.5 / focal).atan();
    (fov > 0.01 && fov < 3.1).then_some(fov)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A TIFF header with one directory that points to an EXIF directory of `fields` (tag, type, value as u32 bits).
    fn tiff(fields: &[(u16, u16, u32)]) -> Vec<u8> {
        let mut out = b"II\x2a\0\x08\0\0\0\x01\0".to_vec();
        let entry = |out: &mut Vec<u8>, tag: u16, kind: u16, value: u32| {
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(1u32.to_le_bytes());
            out.extend(value.to_le_bytes());
        };
        entry(&mut out, 0x8769, 4, 26);
        out.extend(0u32.to_le_bytes());
        out.extend((fields.len() as u16).to_le_bytes());
        for &(tag, kind, value) in fields {
            entry(&mut out, tag, kind, value);
        }
        out.extend(0u32.to_le_bytes());
        out
    }

    /// Goal: 18 mm for film is 90° across the long side; upright, the short side is narrower; a file without says none.
    #[test]
    fn focal_length_for_film() {
        let file = tiff(&[(0xa405, 3, 18)]);
        let wide = field_of_view(&file, 600, 400).unwrap();
        assert!((wide.to_degrees() - 90.0).abs() < 1e-9);
        let upright = field_of_view(&file, 400, 600).unwrap();
        assert!((upright - 2.0 * (400.0f64 / 600.0).atan()).abs() < 1e-9);
        assert!(field_of_view(&tiff(&[(0xa405, 3, 0)]), 600, 400).is_none());
        assert!(field_of_view(&tiff(&[]), 600, 400).is_none());
        assert!(field_of_view(b"no photo", 600, 400).is_none());
    }
}
