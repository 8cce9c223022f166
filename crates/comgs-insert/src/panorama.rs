//! From a photo to the light around it: its pixels are directions, what they do not show is completed.

use crate::error::InsertError;
use crate::light::LightMap;
use crate::tone::Response;
use comgs_geom::{Camera, equirect};
use comgs_image::Image;
use comgs_panorama::{Completion, complete};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Fills a partial panorama; the seam at which a learned completer takes the place of the smooth one.
pub trait Completer {
    /// Its name in records.
    fn name(&self) -> &'static str;

    /// Linear radiance everywhere.
    ///
    /// * `rgb`: equirectangular, straight, three channels
    /// * `alpha`: how much of a texel was seen, one channel
    ///
    /// # Errors
    /// In words.
    fn complete(&self, rgb: &Image, alpha: &Image) -> Result<Image, String>;
}

/// The smoothest log radiance that agrees with what was seen ([`comgs_panorama::complete_harmonic`]).
#[derive(Clone, Copy, Debug, Default)]
pub struct Harmonic;

impl Completer for Harmonic {
    fn name(&self) -> &'static str {
        "harmonic"
    }

    fn complete(&self, rgb: &Image, alpha: &Image) -> Result<Image, String> {
        complete(rgb, alpha, Completion::Harmonic).map_err(|e| e.to_string())
    }
}

/// What a photo shows of the sphere around its camera.
#[derive(Clone, Debug)]
pub struct Partial {
    /// Radiance, straight, three channels, equirectangular.
    pub rgb: Image,
    /// Share of each texel inside the photo, one channel.
    pub alpha: Image,
}

/// Looks along each side of a texel.
const LOOKS: usize = 4;

/// Projects a photo onto the sphere, taken to be infinitely far away.
///
/// * `photo`: linear values in [0, 1]
/// * `camera`: of the photo's size, with its pose
/// * `response`, `most`: undone as [`Response::invert`] has it
/// * `height`: rows of the panorama
#[must_use]
pub fn project(photo: &Image, camera: &Camera, response: Response, most: f32, height: usize) -> Partial {
    let width = 2 * height;
    let into = camera.camera_from_world().matrix3;
    let mut texels = vec![[0.0f32; 4]; width * height];
    texels.par_iter_mut().enumerate().for_each(|(i, out)| {
        let (mut sum, mut seen) = (Vec3::ZERO, 0.0f32);
        for k in 0..LOOKS * LOOKS {
            let sub = |cell: usize, look: usize, n: usize| {
                (cell as f32 + (look as f32 + 0.5) / LOOKS as f32) / n as f32
            };
            let d = equirect::direction(sub(i % width, k % LOOKS, width), sub(i / width, k / LOOKS, height));
            let p: DVec3 = into * d.as_dvec3();
            if p.z <= 1e-6 {
                continue;
            }
            let (x, y) = (camera.cx + camera.fx * p.x / p.z, camera.cy + camera.fy * p.y / p.z);
            if !(0.0..camera.width as f64).contains(&x) || !(0.0..camera.height as f64).contains(&y) {
                continue;
            }
            let value = Vec3::from_array(photo.rgb(x as usize, y as usize));
            sum += value.map(|v| response.invert(v, most));
            seen += 1.0;
        }
        let rgb = if seen > 0.0 { sum / seen } else { Vec3::ZERO };
        *out = [rgb.x, rgb.y, rgb.z, seen / (LOOKS * LOOKS) as f32];
    });
    let all = Image::from_data(width, height, 4, texels.concat());
    Partial { rgb: all.select(&[0, 1, 2]), alpha: all.select(&[3]) }
}

/// The completed light, and as a map of `height` rows.
///
/// # Errors
/// [`InsertError::Input`] where the completer has nothing to go by.
pub fn surroundings(
    partial: &Partial,
    completer: &dyn Completer,
    height: usize,
) -> Result<(Image, LightMap), InsertError> {
    let wrong = |got: String| InsertError::Input {
        what: "the photo's panorama",
        expected: "one that can be completed".into(),
        got,
    };
    let image = completer.complete(&partial.rgb, &partial.alpha).map_err(wrong)?;
    let map = LightMap::from_image(&image, height).map_err(|e| wrong(e.to_string()))?;
    Ok((image, map))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the photo's left is the panorama's left and its sky is up; its share of the sphere is that of its field of view
    /// on paper (`4 atan(ab/√(1 + a² + b²))` for half-extents a, b); the response is undone.
    #[test]
    fn photo_on_the_sphere() {
        let camera = Camera::look_at("photo", 60, 40, 1.2, DVec3::ZERO, DVec3::X, DVec3::Z);
        let mut photo = Image::filled(60, 40, 3, 0.5);
        for y in 0..40 {
            for x in 0..60 {
                photo.pixel_mut(x, y)[0] = if x < 30 { 0.25 } else { 0.5 };
                photo.pixel_mut(x, y)[2] = if y < 20 { 1.0 } else { 0.0 };
            }
        }
        let partial = project(&photo, &camera, Response::Reinhard, 0.9, 64);
        let share: f64 = (0..128 * 64)
            .map(|i| {
                f64::from(partial.alpha.data[i]) * f64::from(equirect::texel_solid_angle(i / 128, 128, 64))
            })
            .sum();
        let (a, b) = ((0.6f64).tan(), (0.6f64).tan() * 40.0 / 60.0);
        let paper = 4.0 * (a * b / (1.0 + a * a + b * b).sqrt()).atan();
        assert!((share - paper).abs() < 0.01 * paper, "{share} {paper}");
        // Left of the centre and above it.
        let texel = partial.rgb.rgb(60, 28);
        assert!((texel[0] - 1.0 / 3.0).abs() < 1e-5 && (texel[1] - 1.0).abs() < 1e-5);
        assert!((texel[2] - 9.0).abs() < 1e-4);
        assert!((partial.rgb.rgb(68, 36)[2]).abs() < 1e-6);
        let (_, map) = surroundings(&partial, &Harmonic, 16).unwrap();
        assert!(map.data.iter().all(|v| v.is_finite() && *v >= 0.0));
        assert!(
            surroundings(&Partial { rgb: Image::zeros(8, 4, 3), alpha: Image::zeros(8, 4, 1) }, &Harmonic, 4)
                .is_err()
        );
    }
}
