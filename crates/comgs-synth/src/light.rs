//! Lights that a recipe can name: skies and studios, painted into an equirectangular map.

use crate::noise::Noise;
use comgs_geom::equirect;
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Light from infinitely far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Light {
    /// The same radiance from everywhere.
    Constant {
        /// Linear radiance.
        radiance: [f32; 3],
    },
    /// A sky with sun and clouds over plain ground.
    Sky {
        /// Radiance straight up.
        zenith: [f32; 3],
        /// Radiance at the horizon.
        horizon: [f32; 3],
        /// Radiance below the horizon.
        ground: [f32; 3],
        /// Azimuth of the sun in degrees, from +x towards +y.
        sun_azimuth_deg: f32,
        /// Height of the sun above the horizon in degrees.
        sun_elevation_deg: f32,
        /// Angular radius of its disc in degrees (the real one has 0.27).
        sun_radius_deg: f32,
        /// What the sun alone gives to a surface that faces it (irradiance).
        sun_irradiance: [f32; 3],
        /// Cover and brightness of the clouds, 0 to 1.
        #[serde(default)]
        clouds: f32,
    },
    /// Soft boxes in a room of even radiance.
    Studio {
        /// Radiance of the walls.
        ambient: [f32; 3],
        /// The boxes.
        boxes: Vec<SoftBox>,
    },
}

/// A bright rectangle on the sphere of directions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SoftBox {
    /// Azimuth of its centre in degrees, from +x towards +y.
    pub azimuth_deg: f32,
    /// Elevation of its centre in degrees.
    pub elevation_deg: f32,
    /// Full width and height in degrees as seen from the centre.
    pub size_deg: [f32; 2],
    /// Linear radiance.
    pub radiance: [f32; 3],
}

/// Unit direction of an azimuth and an elevation in degrees.
#[must_use]
pub fn direction(azimuth_deg: f32, elevation_deg: f32) -> Vec3 {
    let (sa, ca) = azimuth_deg.to_radians().sin_cos();
    let (se, ce) = elevation_deg.to_radians().sin_cos();
    Vec3::new(ce * ca, ce * sa, se)
}

/// Each texel is the mean of this many directions squared, so that a sun of a few texels has its energy.
const SUB_TEXELS: usize = 6;

impl Light {
    /// The map of `2·height × height` texels, linear radiance. Same seed, same clouds.
    #[must_use]
    pub fn map(&self, height: usize, seed: u64) -> Image {
        let width = 2 * height;
        let noise = Noise::new(seed ^ 0x11_6874);
        let mut image = Image::zeros(width, height, 3);
        image.data.par_chunks_mut(3 * width).enumerate().for_each(|(row, line)| {
            for column in 0..width {
                let mut sum = Vec3::ZERO;
                for k in 0..SUB_TEXELS * SUB_TEXELS {
                    let sub = |i: usize| (i as f32 + 0.5) / SUB_TEXELS as f32;
                    let u = (column as f32 + sub(k % SUB_TEXELS)) / width as f32;
                    let v = (row as f32 + sub(k / SUB_TEXELS)) / height as f32;
                    sum += self.radiance(equirect::direction(u, v), &noise);
                }
                let mean = sum / (SUB_TEXELS * SUB_TEXELS) as f32;
                line[3 * column..3 * column + 3].copy_from_slice(&mean.to_array());
            }
        });
        image
    }

    fn radiance(&self, d: Vec3, noise: &Noise) -> Vec3 {
        match self {
            Self::Constant { radiance } => Vec3::from(*radiance),
            Self::Sky {
                zenith,
                horizon,
                ground,
                sun_azimuth_deg,
                sun_elevation_deg,
                sun_radius_deg,
                sun_irradiance,
                clouds,
            } => {
                let sun = direction(*sun_azimuth_deg, *sun_elevation_deg);
                let (zenith, horizon) = (Vec3::from(*zenith), Vec3::from(*horizon));
                if d.z < 0.0 {
                    // Ground fades into the horizon's haze.
                    return Vec3::from(*ground).lerp(horizon * 0.6, (1.0 + d.z * 8.0).clamp(0.0, 1.0));
                }
                let mut sky = horizon.lerp(zenith, d.z.sqrt());
                let towards = d.dot(sun).max(0.0);
                let sun_color = Vec3::from(*sun_irradiance);
                // A glow around the sun, a hundredth of its light.
                sky += sun_color * (0.02 * towards.powi(24) + 0.05 * towards.powi(300));
                if *clouds > 0.0 {
                    // A layer seen in perspective: features shrink towards the horizon.
                    let p = Vec3::new(d.x, d.y, 0.0) / (d.z + 0.15);
                    let n = 0.5 + 0.5 * noise.fractal(p * 1.6 + 3.0, 4);
                    let cover = ((n - 0.75 + 0.5 * clouds) * 3.0).clamp(0.0, 1.0) * (d.z * 6.0).min(1.0);
                    let lit = horizon * 1.1 + sun_color * (0.05 + 0.1 * towards);
                    sky = sky.lerp(lit, cover * 0.85);
                }
                let radius = sun_radius_deg.to_radians();
                if d.angle_between(sun) <= radius {
                    // A disc of half-angle r and radiance L gives E = π L sin² r to a surface that faces it.
                    sky += sun_color / (std::f32::consts::PI * radius.sin().powi(2));
                }
                sky
            }
            Self::Studio { ambient, boxes } => {
                let mut sum = Vec3::from(*ambient) * (0.75 + 0.25 * d.z);
                for b in boxes {
                    let centre = direction(b.azimuth_deg, b.elevation_deg);
                    let right = centre.cross(Vec3::Z).normalize_or(Vec3::Y);
                    let up = right.cross(centre);
                    let depth = d.dot(centre);
                    if depth <= 0.0 {
                        continue;
                    }
                    let half = b.size_deg.map(|s| (0.5 * s).to_radians().tan());
                    let (x, y) = (d.dot(right) / depth / half[0], d.dot(up) / depth / half[1]);
                    // Slightly brighter in the middle, as a lamp behind cloth is.
                    if x.abs() <= 1.0 && y.abs() <= 1.0 {
                        sum += Vec3::from(b.radiance) * (1.0 - 0.3 * (x * x + y * y) * 0.5);
                    }
                }
                sum
            }
        }
    }

    /// Problems, each with its field.
    pub(crate) fn problems(&self, at: &str, out: &mut Vec<String>) {
        let mut radiance = |name: String, values: &[f32; 3]| {
            if values.iter().any(|v| !(0.0..=1e5).contains(v)) {
                out.push(format!("{at}.{name}: expected values from 0 to 100000, got {values:?}"));
            }
        };
        match self {
            Self::Constant { radiance: r } => radiance("radiance".into(), r),
            Self::Sky {
                zenith,
                horizon,
                ground,
                sun_irradiance,
                sun_radius_deg,
                sun_azimuth_deg,
                sun_elevation_deg,
                clouds,
            } => {
                for (name, v) in [
                    ("zenith", zenith),
                    ("horizon", horizon),
                    ("ground", ground),
                    ("sun_irradiance", sun_irradiance),
                ] {
                    radiance(name.into(), v);
                }
                if !(0.1..=90.0).contains(sun_radius_deg) {
                    out.push(format!("{at}.sun_radius_deg: expected 0.1 to 90, got {sun_radius_deg}"));
                }
                if !(-90.0..=90.0).contains(sun_elevation_deg) || !sun_azimuth_deg.is_finite() {
                    out.push(format!(
                        "{at}: expected a finite azimuth and an elevation of −90 to 90 degrees"
                    ));
                }
                if !(0.0..=1.0).contains(clouds) {
                    out.push(format!("{at}.clouds: expected 0 to 1, got {clouds}"));
                }
            }
            Self::Studio { ambient, boxes } => {
                radiance("ambient".into(), ambient);
                for (i, b) in boxes.iter().enumerate() {
                    radiance(format!("boxes[{i}].radiance"), &b.radiance);
                }
                for (i, b) in boxes.iter().enumerate() {
                    if b.size_deg.iter().any(|s| !(*s > 0.0 && *s < 170.0)) {
                        out.push(format!(
                            "{at}.boxes[{i}].size_deg: expected 0 to 170, got {:?}",
                            b.size_deg
                        ));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the painted sun has the irradiance that was asked for, and lies in the direction that was asked for.
    #[test]
    fn the_sun_has_its_energy_and_place() {
        let light = Light::Sky {
            zenith: [0.0; 3],
            horizon: [0.0; 3],
            ground: [0.0; 3],
            sun_azimuth_deg: 40.0,
            sun_elevation_deg: 35.0,
            sun_radius_deg: 2.5,
            sun_irradiance: [3.0, 2.0, 1.0],
            clouds: 0.0,
        };
        let map = light.map(128, 1);
        let sun = direction(40.0, 35.0);
        let (mut irradiance, mut first_moment) = (0.0f64, Vec3::ZERO);
        for y in 0..128 {
            for x in 0..256 {
                let d = equirect::texel_direction(x, y, 256, 128);
                // Only the disc; the glow around it is dimmer than 10.
                if map.rgb(x, y)[0] > 10.0 {
                    let e = map.rgb(x, y)[0] * equirect::texel_solid_angle(y, 256, 128);
                    irradiance += f64::from(e * d.dot(sun));
                    first_moment += e * d;
                }
            }
        }
        assert!((irradiance - 3.0).abs() < 0.12, "{irradiance}");
        assert!(first_moment.angle_between(sun).to_degrees() < 0.2);
        let peak = map.data.iter().copied().fold(0.0, f32::max);
        assert!(peak < 65504.0);
    }

    /// Goal: a soft box is where it was put: bright along its centre, dark opposite.
    #[test]
    fn boxes_are_in_place() {
        let boxes = vec![SoftBox {
            azimuth_deg: 90.0,
            elevation_deg: 20.0,
            size_deg: [30.0, 20.0],
            radiance: [5.0; 3],
        }];
        let map = Light::Studio { ambient: [0.1; 3], boxes }.map(64, 1);
        let at = |d: Vec3| {
            let (u, v) = equirect::uv_from_direction(d);
            map.rgb((u * 128.0) as usize, (v * 64.0) as usize)[0]
        };
        assert!(at(direction(90.0, 20.0)) > 4.5);
        assert!(at(direction(90.0, 33.0)) < 0.2 && at(direction(108.0, 20.0)) < 0.2);
        assert!(at(direction(-90.0, 20.0)) < 0.2);
    }
}
