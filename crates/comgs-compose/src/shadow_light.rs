//! The light as shadows see it: a grid of directions for what is smooth, single lights for what is small and strong.

use crate::occlusion_field::grid;
use comgs_geom::{equirect, octahedral, sampling::hammersley};
use comgs_light::{EnvironmentMap, LightSplit, SplitConfig, luminance};
use glam::{DQuat, Vec2, Vec3};
use thiserror::Error;

/// A light that is added to the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lamp {
    /// From infinitely far away.
    Directional {
        /// Towards the light, any length above 0, world.
        direction: Vec3,
        /// Irradiance of a surface that faces it, linear RGB, at least 0.
        irradiance: Vec3,
        /// Half of the angle it is seen under, radians, 0 (a hard edge) to 0.5.
        angular_radius: f32,
    },
    /// From a small sphere.
    Point {
        /// World.
        position: Vec3,
        /// Radiant intensity, linear RGB per steradian, at least 0: irradiance at distance d is `intensity / d²`.
        intensity: Vec3,
        /// Radius of the sphere, world units, at least 0.
        radius: f32,
    },
}

/// Lamps that are none; all problems, each with its number.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("unusable lamps: {}", .0.join("; "))]
pub struct LampError(pub Vec<String>);

impl Lamp {
    /// Values out of range.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let colour = |v: &Vec3| v.is_finite() && v.min_element() >= 0.0;
        match self {
            Self::Directional { direction, irradiance, angular_radius } => {
                if direction.try_normalize().is_none() {
                    problems.push(format!("its direction is {direction}, expected a vector with a length"));
                }
                if !colour(irradiance) {
                    problems.push(format!("its irradiance is {irradiance}, expected values of at least 0"));
                }
                if !(0.0..=0.5).contains(angular_radius) {
                    problems.push(format!("its angular radius is {angular_radius}, expected 0 to 0.5"));
                }
            }
            Self::Point { position, intensity, radius } => {
                if !position.is_finite() {
                    problems.push(format!("its position is {position}, expected finite numbers"));
                }
                if !colour(intensity) {
                    problems.push(format!("its intensity is {intensity}, expected values of at least 0"));
                }
                if !(*radius >= 0.0 && radius.is_finite()) {
                    problems.push(format!("its radius is {radius}, expected a finite length of at least 0"));
                }
            }
        }
        problems
    }
}

/// A light that rays are traced to.
#[derive(Clone, Debug, PartialEq)]
pub enum Beam {
    /// Parallel rays: unit directions, each with the same part of the irradiance of a surface that faces it.
    Parallel {
        /// Towards the light, world.
        directions: Vec<Vec3>,
        /// Irradiance of all of them together.
        irradiance: Vec3,
    },
    /// Rays to points, each with the same part of the intensity.
    Points {
        /// On the lamp, world.
        positions: Vec<Vec3>,
        /// Intensity of all of them together.
        intensity: Vec3,
    },
}

/// A map, and perhaps lamps, prepared for shadows.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowLight {
    /// Side of the grid of directions.
    pub side: usize,
    /// From grid space to the world: the grid follows an object, so that its occlusion field is met on its own directions.
    pub world_from_grid: DQuat,
    /// ∫ L dω of the smooth light over every texel of the grid.
    pub energy: Vec<Vec3>,
    /// Small strong lights.
    pub beams: Vec<Beam>,
}

/// How a map is prepared.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowLightConfig {
    /// Side of the grid of directions, as the occlusion fields'.
    pub side: usize,
    /// What is split off as a strong light; `None` keeps all of the map on the grid.
    pub split: Option<SplitConfig>,
    /// Rays towards a strong light or lamp, at least 1.
    pub beam_rays: u32,
}

impl Default for ShadowLightConfig {
    fn default() -> Self {
        Self { side: 24, split: Some(SplitConfig::default()), beam_rays: 16 }
    }
}

impl ShadowLight {
    /// Prepares a map. `world_from_grid` turns the grid, usually the rotation of the first object.
    ///
    /// The sum of all energies and irradiances is the map's (and the lamps'), whatever the resolution.
    ///
    /// # Errors
    /// [`LampError`] with every problem of every lamp.
    pub fn new(
        map: &EnvironmentMap,
        lamps: &[Lamp],
        world_from_grid: DQuat,
        config: &ShadowLightConfig,
    ) -> Result<Self, LampError> {
        let problems: Vec<String> = lamps
            .iter()
            .enumerate()
            .flat_map(|(i, lamp)| lamp.check().into_iter().map(move |p| format!("lamp {}: {p}", i + 1)))
            .collect();
        if !problems.is_empty() {
            return Err(LampError(problems));
        }
        let split = config.split.as_ref().map(|split| LightSplit::new(map, split));
        let rest = split.as_ref().map_or(map, |s| &s.rest);
        let n = config.beam_rays.max(1);
        let mut beams = Vec::new();
        for light in split.iter().flat_map(|s| &s.strong) {
            let directions = (0..n).map(|k| light.sample(map, hammersley(k, n, Vec2::splat(0.5 / n as f32))));
            beams.push(Beam::Parallel { directions: directions.collect(), irradiance: light.energy });
        }
        beams.extend(lamps.iter().map(|lamp| beam_of(lamp, n)));
        Ok(Self {
            side: config.side,
            world_from_grid,
            energy: grid_energy(rest, config.side, world_from_grid),
            beams,
        })
    }

    /// Unit directions of the grid, world.
    #[must_use]
    pub fn directions(&self) -> Vec<Vec3> {
        let turn = self.world_from_grid.as_quat();
        grid(self.side).iter().map(|d| turn * d.towards).collect()
    }

    /// Share of the luminance that is in strong lights, lamps left out, at their full irradiance.
    #[must_use]
    pub fn strong_share(&self) -> f32 {
        let smooth: f32 = self.energy.iter().map(|&e| luminance(e)).sum();
        let strong: f32 = self
            .beams
            .iter()
            .map(|b| match b {
                Beam::Parallel { irradiance, .. } => luminance(*irradiance),
                Beam::Points { .. } => 0.0,
            })
            .sum();
        if smooth + strong > 0.0 { strong / (smooth + strong) } else { 0.0 }
    }
}

fn beam_of(lamp: &Lamp, n: u32) -> Beam {
    let disc = |k: u32| {
        let u = hammersley(k, n, Vec2::splat(0.5 / n as f32));
        Vec2::from_angle(std::f32::consts::TAU * u.y) * u.x.sqrt()
    };
    match *lamp {
        Lamp::Directional { direction, irradiance, angular_radius } => {
            let axes = comgs_geom::frame::world_from_tangent(direction.normalize());
            let size = angular_radius.tan();
            let n = if size > 0.0 { n } else { 1 };
            let directions = (0..n).map(|k| axes * (size * disc(k)).extend(1.0).normalize()).collect();
            Beam::Parallel { directions, irradiance }
        }
        Lamp::Point { position, intensity, radius } => {
            let n = if radius > 0.0 { n } else { 1 };
            let on = |k: u32| {
                let u = hammersley(k, n, Vec2::splat(0.5 / n as f32));
                position + radius * comgs_geom::sampling::uniform_sphere(u)
            };
            Beam::Points { positions: (0..n).map(on).collect(), intensity }
        }
    }
}

/// ∫ L dω over every texel of a turned octahedral grid, by the map's texels, each cut into 2 × 2.
fn grid_energy(map: &EnvironmentMap, side: usize, world_from_grid: DQuat) -> Vec<Vec3> {
    let (w, h) = (map.width(), map.height());
    let grid_from_world = world_from_grid.inverse().as_quat();
    // A coarse map is cut finer, so that the grid's texels are filled evenly.
    let parts = (8 * side).div_ceil(w).max(2);
    let mut energy = vec![glam::DVec3::ZERO; side * side];
    for y in 0..h * parts {
        let omega = f64::from(equirect::texel_solid_angle(y, w * parts, h * parts));
        for x in 0..w * parts {
            let u = (x as f32 + 0.5) / (w * parts) as f32;
            let v = (y as f32 + 0.5) / (h * parts) as f32;
            let k = octahedral::texel_of(grid_from_world * map.direction(u, v), side);
            energy[k] += omega * map.texel(x / parts, y / parts).as_dvec3();
        }
    }
    energy.into_iter().map(|e| e.as_vec3()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_image::Image;

    fn sunny() -> EnvironmentMap {
        let mut image = Image::zeros(64, 32, 3);
        for y in 0..32 {
            for x in 0..64 {
                let d = equirect::texel_direction(x, y, 64, 32);
                image.pixel_mut(x, y).copy_from_slice(&[0.4 + 0.2 * d.x, 0.5, 0.8 + 0.3 * d.z]);
            }
        }
        image.pixel_mut(20, 9).copy_from_slice(&[900.0, 850.0, 800.0]);
        EnvironmentMap::from_image(&image).unwrap()
    }

    /// Goal: nothing is lost between the map, the grid and the beams, at any turn and side, split or not.
    #[test]
    fn energy_is_kept() {
        let map = sunny();
        let total = map.integral();
        for side in [4, 16, 24] {
            for split in [None, Some(SplitConfig::default())] {
                let config = ShadowLightConfig { side, split, ..ShadowLightConfig::default() };
                let light = ShadowLight::new(&map, &[], DQuat::from_rotation_x(0.7), &config).unwrap();
                let mut sum: Vec3 = light.energy.iter().sum();
                for beam in &light.beams {
                    let Beam::Parallel { irradiance, directions } = beam else { panic!() };
                    assert!(directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-5));
                    sum += *irradiance;
                }
                assert!(((sum - total) / total).abs().max_element() < 1e-4, "{sum} {total}");
                assert_eq!(light.beams.len(), usize::from(config.split.is_some()));
            }
        }
    }

    /// Goal: energy lands on the texel of its direction whatever the grid's turn: the irradiance of planes by the grid is
    /// the map's by brute force within what 24² directions resolve.
    #[test]
    fn irradiance_survives_the_turn() {
        let map = sunny();
        for turn in [DQuat::IDENTITY, DQuat::from_rotation_y(1.1) * DQuat::from_rotation_z(0.4)] {
            let light = ShadowLight::new(&map, &[], turn, &ShadowLightConfig::default()).unwrap();
            let Beam::Parallel { directions, irradiance } = &light.beams[0] else { panic!() };
            for n in [Vec3::Z, Vec3::X, Vec3::new(0.6, -0.5, 0.3).normalize()] {
                let mut e: Vec3 =
                    light.directions().iter().zip(&light.energy).map(|(d, &e)| e * n.dot(*d).max(0.0)).sum();
                for d in directions {
                    e += *irradiance * n.dot(*d).max(0.0) / directions.len() as f32;
                }
                let truth = map.irradiance(n);
                assert!(((e - truth) / truth).abs().max_element() < 0.01, "{n}: {e} {truth}");
            }
        }
    }

    /// Goal: every problem of every lamp is named at once.
    #[test]
    fn lamps_are_checked() {
        let bad = [
            Lamp::Directional { direction: Vec3::ZERO, irradiance: -Vec3::ONE, angular_radius: 2.0 },
            Lamp::Point { position: Vec3::NAN, intensity: Vec3::ONE, radius: -1.0 },
        ];
        let config = ShadowLightConfig::default();
        let error = ShadowLight::new(&sunny(), &bad, DQuat::IDENTITY, &config).unwrap_err();
        assert_eq!(error.0.len(), 5, "{error}");
        assert!(error.0[3].starts_with("lamp 2: its position"));
    }
}
