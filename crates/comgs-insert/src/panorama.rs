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

/// The ground as a light meter: what a photo does not show of the light, it shows by what the ground sends back.
///
/// A Lambertian ground of albedo ρ under the irradiance E has the radiance ρ E / π. Where the photo's ground is brighter than
/// the completed sky can make it, the rest must come from a light outside the frame. Its direction is not known; a wide
/// lobe above and behind the camera gives objects the right brightness with a soft shadow, and is wrong by least for a
/// sun that may stand anywhere the photo does not look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundMeter {
    /// ρ, taken for any ground.
    pub albedo: f32,
    /// Width of the lobe in radians.
    pub sigma: f32,
    /// Elevation of the lobe in radians; its azimuth is opposite to the camera's.
    pub elevation: f32,
}

impl GroundMeter {
    /// Chosen on 23 of the 34 maps of `hdri`, those that `comgs insert-eval` does not take: RMSE of sRGB values 0.0579 with a
    /// clipped response, against 0.0730 without a meter; 0.0633 with ρ = 0.15, 0.0616 with 0.5; 0.0578 with σ = 0.25, 0.0597
    /// with 1; 0.0619 straight from above, 0.0626 from 29° up.
    pub const TUNED: Self = Self { albedo: 0.25, sigma: 0.5, elevation: 0.9 };
}

impl Default for GroundMeter {
    fn default() -> Self {
        Self::TUNED
    }
}

/// Rows of the ground that is measured start this far below the horizon (radians): the far ground is trees and walls.
const BELOW_HORIZON: f32 = 0.1;

/// Most that the lobe may add, as a multiple of the completed sky's irradiance: a snow field is no sun.
const MOST_ADDED: f32 = 8.0;

impl GroundMeter {
    /// Irradiance (luminance) on the ground by the photo's own ground; `None` where it shows none.
    #[must_use]
    pub fn irradiance(&self, partial: &Partial) -> Option<f32> {
        let (w, h) = (partial.rgb.width, partial.rgb.height);
        let first = ((0.5 + BELOW_HORIZON / std::f32::consts::PI) * h as f32).ceil() as usize;
        let (mut sum, mut weight) = (0.0f32, 0.0f32);
        for i in first * w..w * h {
            let a = partial.alpha.data[i] * equirect::texel_solid_angle(i / w, w, h);
            sum += a * comgs_light::luminance(Vec3::from_slice(&partial.rgb.data[3 * i..3 * i + 3]));
            weight += a;
        }
        (weight > 1e-3).then(|| std::f32::consts::PI * sum / (weight * self.albedo))
    }

    /// Adds the missing light to a completed panorama (three channels); returns how many times the sky's irradiance was
    /// added, 0 where nothing is missing or no ground is seen.
    pub fn add_missing(&self, partial: &Partial, camera: &Camera, panorama: &mut Image) -> f32 {
        let Some(metered) = self.irradiance(partial) else { return 0.0 };
        let (w, h) = (panorama.width, panorama.height);
        let behind = -camera.forward().as_vec3().truncate().normalize_or(glam::Vec2::X);
        let (sin, cos) = self.elevation.sin_cos();
        let centre = (behind * cos).extend(sin);
        let (mut sky, mut unit) = (0.0f32, 0.0f32);
        let lobe = |i: usize| {
            let d = equirect::texel_direction(i % w, i / w, w, h);
            (d.z, ((d.dot(centre) - 1.0) / (self.sigma * self.sigma)).exp())
        };
        for i in 0..w * h / 2 {
            let (z, g) = lobe(i);
            let cosine = z.max(0.0) * equirect::texel_solid_angle(i / w, w, h);
            sky += cosine * comgs_light::luminance(Vec3::from_slice(&panorama.data[3 * i..3 * i + 3]));
            unit += cosine * g;
        }
        if !(sky > 0.0 && unit > 0.0 && metered > sky) {
            return 0.0;
        }
        let added = (metered - sky).min(MOST_ADDED * sky);
        for i in 0..w * h {
            let (_, g) = lobe(i);
            panorama.data[3 * i..3 * i + 3].iter_mut().for_each(|v| *v += added / unit * g);
        }
        added / sky
    }
}

/// The completed light as a map of `height` rows, with what the ground tells of in addition where there is a `meter`; also how
/// many times the sky's irradiance was added.
///
/// # Errors
/// [`InsertError::Input`] where the completer has nothing to go by.
pub fn surroundings(
    partial: &Partial,
    camera: &Camera,
    completer: &dyn Completer,
    meter: Option<&GroundMeter>,
    height: usize,
) -> Result<(LightMap, f32), InsertError> {
    let wrong = |got: String| InsertError::Input {
        what: "the photo's panorama",
        expected: "one that can be completed".into(),
        got,
    };
    let mut image = completer.complete(&partial.rgb, &partial.alpha).map_err(wrong)?;
    let added = meter.map_or(0.0, |m| m.add_missing(partial, camera, &mut image));
    let map = LightMap::from_image(&image, height).map_err(|e| wrong(e.to_string()))?;
    Ok((map, added))
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
        let (map, added) = surroundings(&partial, &camera, &Harmonic, None, 16).unwrap();
        assert!(map.data.iter().all(|v| v.is_finite() && *v >= 0.0) && added == 0.0);
        let nothing = Partial { rgb: Image::zeros(8, 4, 3), alpha: Image::zeros(8, 4, 1) };
        assert!(surroundings(&nothing, &camera, &Harmonic, None, 4).is_err());
    }

    /// Goal: a ground that is as bright as albedo and sky say adds nothing; one three times as bright adds twice the sky, so
    /// that the irradiance of the result is what the ground shows; without any ground there is no meter.
    #[test]
    fn the_ground_tells_of_light_outside_the_frame() {
        let camera = Camera::look_at("photo", 60, 40, 1.2, DVec3::ZERO, DVec3::X, DVec3::Z);
        let (w, h) = (128, 64);
        let mut alpha = Image::zeros(w, h, 1);
        for y in 40..56 {
            for x in 50..80 {
                alpha.pixel_mut(x, y)[0] = 1.0;
            }
        }
        let meter = GroundMeter::default();
        let irradiance = |im: &Image| -> f32 {
            (0..w * h / 2)
                .map(|i| {
                    let z = equirect::texel_direction(i % w, i / w, w, h).z;
                    z * equirect::texel_solid_angle(i / w, w, h) * im.data[3 * i]
                })
                .sum()
        };
        for (times, expected) in [(0.5f32, 0.0f32), (0.99, 0.0), (3.0, 2.0)] {
            // Even light of radiance 1 has the irradiance π.
            let rgb = Image::filled(w, h, 3, times * meter.albedo);
            let partial = Partial { rgb, alpha: alpha.clone() };
            let mut panorama = Image::filled(w, h, 3, 1.0);
            let added = meter.add_missing(&partial, &camera, &mut panorama);
            assert!((added - expected).abs() < 0.01, "{times}: {added}");
            let truth = std::f32::consts::PI * (1.0 + expected);
            assert!((irradiance(&panorama) - truth).abs() < 0.01 * truth);
        }
        let none = Partial { rgb: Image::filled(w, h, 3, 1.0), alpha: Image::zeros(w, h, 1) };
        assert!(meter.irradiance(&none).is_none());
    }
}
