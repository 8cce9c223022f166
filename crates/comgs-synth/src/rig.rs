//! Where the cameras stand.

use comgs_geom::{Camera, Rng};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Cameras around an object at the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectRig {
    /// Distance from the origin.
    pub distance: f64,
    /// Horizontal field of view in degrees.
    pub hfov_deg: f64,
}

impl Default for ObjectRig {
    /// The unit ball in view, as the public data has it.
    fn default() -> Self {
        Self { distance: 4.0, hfov_deg: 30.0 }
    }
}

/// Cameras on the upper part of an ellipsoid, looking at its centre.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneRig {
    /// Centre of the ellipsoid: what the cameras look at.
    pub centre: [f64; 3],
    /// Its half axes.
    pub radii: [f64; 3],
    /// Lowest and highest elevation of a camera as seen from the centre, in degrees.
    pub elevation_deg: [f64; 2],
    /// Horizontal field of view in degrees.
    #[serde(default = "default_scene_hfov")]
    pub hfov_deg: f64,
}

fn default_scene_hfov() -> f64 {
    64.0
}

/// Name of a view: five digits.
#[must_use]
pub fn view_name(index: usize) -> String {
    format!("{index:05}")
}

/// The van der Corput radical inverse in a prime base.
fn radical_inverse(mut i: usize, base: usize) -> f64 {
    let (mut result, mut digit) = (0.0, 1.0 / base as f64);
    while i > 0 {
        result += (i % base) as f64 * digit;
        i /= base;
        digit /= base as f64;
    }
    result
}

fn on_sphere(azimuth: f64, z: f64) -> DVec3 {
    let r = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z)
}

impl ObjectRig {
    fn look(&self, name: &str, (width, height): (usize, usize), direction: DVec3) -> Camera {
        let eye = direction * self.distance;
        Camera::look_at(name, width, height, self.hfov_deg.to_radians(), eye, DVec3::ZERO, DVec3::Z)
    }

    /// Halton points on the upper hemisphere: every prefix is well spread.
    #[must_use]
    pub fn train(&self, count: usize, size: (usize, usize)) -> Vec<Camera> {
        (0..count)
            .map(|i| {
                let z = 0.03 + 0.94 * radical_inverse(i + 1, 3);
                self.look(&view_name(i), size, on_sphere(TAU * radical_inverse(i + 1, 2), z))
            })
            .collect()
    }

    /// Three circles of latitude at 12, 35 and 60 degrees, the azimuths interleaved.
    #[must_use]
    pub fn test(&self, count: usize, size: (usize, usize)) -> Vec<Camera> {
        const LATITUDES_DEG: [f64; 3] = [12.0, 35.0, 60.0];
        (0..count)
            .map(|i| {
                let azimuth = TAU * (i as f64 + 0.35) / count as f64;
                let z = LATITUDES_DEG[i % 3].to_radians().sin();
                self.look(&view_name(i), size, on_sphere(azimuth, z))
            })
            .collect()
    }

    pub(crate) fn problems(&self, at: &str, out: &mut Vec<String>) {
        if !(self.distance > 1.05 && self.distance < 1e4) {
            out.push(format!(
                "{at}.distance: expected more than the object's radius of 1, got {}",
                self.distance
            ));
        }
        check_fov(self.hfov_deg, at, out);
    }
}

impl SceneRig {
    fn look(
        &self,
        name: &str,
        (width, height): (usize, usize),
        azimuth: f64,
        elevation: f64,
        shrink: f64,
    ) -> Camera {
        let centre = DVec3::from(self.centre);
        let eye = centre + on_sphere(azimuth, elevation.sin()) * DVec3::from(self.radii) * shrink;
        Camera::look_at(name, width, height, self.hfov_deg.to_radians(), eye, centre, DVec3::Z)
    }

    /// One random camera in each cell of an azimuth × elevation grid.
    #[must_use]
    pub fn train(&self, count: usize, size: (usize, usize), seed: u64) -> Vec<Camera> {
        // Four times as many columns as rows: cells come out about square.
        let rows = ((count as f64 / 4.0).sqrt().round() as usize).max(1);
        let columns = count.div_ceil(rows).max(1);
        let [low, high] = self.elevation_deg.map(f64::to_radians);
        (0..count)
            .map(|i| {
                let mut rng = Rng::stream(seed, i as u64);
                let (row, column) = (i % rows, i / rows);
                let s = (column as f64 + f64::from(rng.uniform())) / columns as f64;
                let t = (row as f64 + f64::from(rng.uniform())) / rows as f64;
                self.look(&view_name(i), size, TAU * s, low + (high - low) * t, 1.0)
            })
            .collect()
    }

    /// A spiral of two turns, a little inside the ellipsoid.
    #[must_use]
    pub fn test(&self, count: usize, size: (usize, usize)) -> Vec<Camera> {
        let [low, high] = self.elevation_deg.map(f64::to_radians);
        (0..count)
            .map(|i| {
                let t = (i as f64 + 0.5) / count as f64;
                let elevation = low + (high - low) * (0.1 + 0.7 * t);
                self.look(&view_name(i), size, 0.25 * PI + 2.0 * TAU * t, elevation, 0.88)
            })
            .collect()
    }

    pub(crate) fn problems(&self, at: &str, out: &mut Vec<String>) {
        if self.radii.iter().any(|r| !(*r > 0.0 && *r < 1e6)) || self.centre.iter().any(|c| !(c.abs() < 1e6))
        {
            out.push(format!("{at}: expected positive radii and a finite centre, got {:?}", self.radii));
        }
        let [low, high] = self.elevation_deg;
        if !(-89.0 <= low && low <= high && high <= 89.0) {
            out.push(format!(
                "{at}.elevation_deg: expected two angles in order from −89 to 89, got {low} and {high}"
            ));
        }
        check_fov(self.hfov_deg, at, out);
    }
}

fn check_fov(hfov_deg: f64, at: &str, out: &mut Vec<String>) {
    if !(1.0..=150.0).contains(&hfov_deg) {
        out.push(format!("{at}.hfov_deg: expected 1 to 150, got {hfov_deg}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every camera is sound, at its distance, and has its target in the middle of the image.
    #[test]
    fn cameras_look_where_they_should() {
        let object = ObjectRig::default();
        let scene = SceneRig {
            centre: [0.3, -0.2, 0.7],
            radii: [2.0, 3.0, 1.5],
            elevation_deg: [10.0, 60.0],
            hfov_deg: 64.0,
        };
        for camera in object.train(60, (96, 96)).iter().chain(&object.test(18, (96, 96))) {
            assert!(camera.problems().is_empty());
            assert!((camera.centre().length() - 4.0).abs() < 1e-9 && camera.centre().z > 0.0);
            assert!((camera.project(DVec3::ZERO).unwrap().0 - 48.0).length() < 1e-6);
        }
        for camera in scene.train(72, (128, 72), 3).iter().chain(&scene.test(12, (128, 72))) {
            assert!(camera.problems().is_empty());
            let offset = (camera.centre() - DVec3::from(scene.centre)) / DVec3::from(scene.radii);
            assert!(offset.length() < 1.0 + 1e-9 && offset.length() > 0.87);
            assert!(
                (camera.project(scene.centre.into()).unwrap().0 - DVec3::new(64.0, 36.0, 0.0).truncate())
                    .length()
                    < 1e-6
            );
        }
        assert_eq!(scene.train(5, (8, 8), 3).len(), 5);
        assert_ne!(scene.train(5, (8, 8), 3), scene.train(5, (8, 8), 4));
    }
}
