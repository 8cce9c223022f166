//! The light as shadows see it: a few hundred directions for what is smooth, single lights for what is small and strong.

use comgs_geom::{equirect, octahedral, sampling::hammersley};
use comgs_light::{EnvironmentMap, LightSplit, SplitConfig, luminance};
use glam::{DVec3, Vec2, Vec3};
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

impl Beam {
    /// Whether there is no ray to trace.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Parallel { directions: rays, .. } | Self::Points { positions: rays, .. } => rays.is_empty(),
        }
    }
}

/// Where a strong light is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StrongFrom {
    /// Unit direction towards it, world.
    Direction(Vec3),
    /// Position, world.
    Position(Vec3),
}

/// A map, and perhaps lamps, prepared for shadows.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowLight {
    /// Unit directions of the smooth light, world.
    pub directions: Vec<Vec3>,
    /// ∫ L dω of what each direction stands for.
    pub energy: Vec<Vec3>,
    /// Solid angle of what each direction stands for, steradians.
    pub solid_angles: Vec<f32>,
    /// Small strong lights.
    pub beams: Vec<Beam>,
}

/// How a map is prepared.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowLightConfig {
    /// The smooth light is cut until no direction has more than this part of its luminance: 1 / `directions`; at least 1.
    pub directions: u32,
    /// What is split off as a strong light; `None` leaves all of the map to the directions.
    pub split: Option<SplitConfig>,
    /// Rays towards a strong light or lamp, at least 1.
    pub beam_rays: u32,
}

impl Default for ShadowLightConfig {
    fn default() -> Self {
        Self { directions: 256, split: Some(SplitConfig::default()), beam_rays: 16 }
    }
}

impl ShadowLight {
    /// Prepares a map.
    ///
    /// The sum of all energies and irradiances is the map's (and the lamps'), whatever the resolution.
    ///
    /// # Errors
    /// [`LampError`] with every problem of every lamp.
    pub fn new(map: &EnvironmentMap, lamps: &[Lamp], config: &ShadowLightConfig) -> Result<Self, LampError> {
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
        let parts = cut(rest, config.directions.max(1));
        Ok(Self {
            directions: parts.iter().map(|p| p.0).collect(),
            energy: parts.iter().map(|p| p.1).collect(),
            solid_angles: parts.iter().map(|p| p.2).collect(),
            beams,
        })
    }

    /// Where the strong lights are.
    #[must_use]
    pub fn strong(&self) -> Vec<StrongFrom> {
        let mean = |list: &[Vec3]| list.iter().sum::<Vec3>() / list.len().max(1) as f32;
        self.beams
            .iter()
            .map(|b| match b {
                Beam::Parallel { directions, .. } => {
                    StrongFrom::Direction(mean(directions).normalize_or(Vec3::Z))
                }
                Beam::Points { positions, .. } => StrongFrom::Position(mean(positions)),
            })
            .collect()
    }

    /// Share of the map's luminance that is in strong lights.
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

/// Sides of the octahedral grids between which the light is cut. The finest texels are 1.6° wide.
const COARSEST: usize = 8;
const FINEST: usize = 128;

/// Energy and its first moment by luminance.
#[derive(Clone, Copy, Default)]
struct Part {
    energy: DVec3,
    middle: DVec3,
    luminous: f64,
    solid_angle: f64,
}

/// Directions with energies and solid angles, by a quadtree over the octahedral map: a texel with more than 1 / `parts` of the luminance is
/// cut in four, so a bright window gets many directions and the dark wall beside it few (as median cut does, Debevec 2005,
/// without its search). Each direction is the mean of its texel by luminance.
fn cut(map: &EnvironmentMap, parts: u32) -> Vec<(Vec3, Vec3, f32)> {
    let mut levels = vec![finest(map)];
    let mut side = FINEST;
    while side > COARSEST {
        let fine = &levels[levels.len() - 1];
        let half = side / 2;
        let mut coarse = vec![Part::default(); half * half];
        for (i, part) in fine.iter().enumerate() {
            let to = &mut coarse[(i / side / 2) * half + i % side / 2];
            to.energy += part.energy;
            to.middle += part.middle;
            to.luminous += part.luminous;
            to.solid_angle += part.solid_angle;
        }
        levels.push(coarse);
        side = half;
    }
    let total: f64 = levels[0].iter().map(|p| p.luminous).sum();
    let limit = total / f64::from(parts);
    let mut out = Vec::new();
    let mut open: Vec<(usize, usize)> =
        (0..COARSEST * COARSEST).rev().map(|i| (levels.len() - 1, i)).collect();
    while let Some((level, i)) = open.pop() {
        let part = &levels[level][i];
        let side = FINEST >> level;
        if level > 0 && part.luminous > limit {
            let (x, y) = (2 * (i % side), 2 * (i / side));
            for (dx, dy) in [(1, 1), (0, 1), (1, 0), (0, 0)] {
                open.push((level - 1, (y + dy) * 2 * side + x + dx));
            }
        } else if part.luminous > 0.0 {
            let centre = octahedral::texel_direction(i % side, i / side, side);
            let direction = part.middle.as_vec3().normalize_or(centre);
            out.push((direction, part.energy.as_vec3(), part.solid_angle as f32));
        }
    }
    out
}

/// The map on the finest grid: texels of the map, each cut until they are smaller than the grid's.
fn finest(map: &EnvironmentMap) -> Vec<Part> {
    let (w, h) = (map.width(), map.height());
    let parts = (4 * FINEST).div_ceil(w).max(1);
    let mut grid = vec![Part::default(); FINEST * FINEST];
    for y in 0..h * parts {
        let omega = f64::from(equirect::texel_solid_angle(y, w * parts, h * parts));
        for x in 0..w * parts {
            let u = (x as f32 + 0.5) / (w * parts) as f32;
            let v = (y as f32 + 0.5) / (h * parts) as f32;
            let direction = map.direction(u, v);
            let radiance = map.texel(x / parts, y / parts);
            let part = &mut grid[octahedral::texel_of(direction, FINEST)];
            let luminous = omega * f64::from(luminance(radiance));
            part.energy += omega * radiance.as_dvec3();
            part.middle += luminous * direction.as_dvec3();
            part.luminous += luminous;
            part.solid_angle += omega;
        }
    }
    grid
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

    /// Goal: nothing is lost between the map, the directions and the beams, at any number, split or not; and no direction
    /// has much more than its part, but where the finest grid ends.
    #[test]
    fn energy_is_kept() {
        let map = sunny();
        let total = map.integral();
        for directions in [1, 64, 256, 1024] {
            for split in [None, Some(SplitConfig::default())] {
                let config = ShadowLightConfig { directions, split, ..ShadowLightConfig::default() };
                let light = ShadowLight::new(&map, &[], &config).unwrap();
                let mut sum: Vec3 = light.energy.iter().sum();
                for beam in &light.beams {
                    let Beam::Parallel { irradiance, directions } = beam else { panic!() };
                    assert!(directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-5));
                    sum += *irradiance;
                }
                assert!(((sum - total) / total).abs().max_element() < 1e-4, "{sum} {total}");
                assert_eq!(light.beams.len(), usize::from(config.split.is_some()));
                if config.split.is_some() && directions >= 64 {
                    let smooth: f32 = light.energy.iter().map(|&e| luminance(e)).sum();
                    let most = light.energy.iter().map(|&e| luminance(e)).fold(0.0, f32::max);
                    assert!(most <= 1.001 * smooth / directions as f32, "{most} of {smooth}");
                    assert!(light.directions.len() < 5 * directions as usize);
                }
            }
        }
    }

    /// Goal: the irradiance of planes by directions and beams is the map's by brute force.
    #[test]
    fn irradiance_is_kept() {
        let map = sunny();
        let light = ShadowLight::new(&map, &[], &ShadowLightConfig::default()).unwrap();
        let Beam::Parallel { directions, irradiance } = &light.beams[0] else { panic!() };
        for n in [Vec3::Z, Vec3::X, Vec3::new(0.6, -0.5, 0.3).normalize()] {
            let mut e: Vec3 =
                light.directions.iter().zip(&light.energy).map(|(d, &e)| e * n.dot(*d).max(0.0)).sum();
            for d in directions {
                e += *irradiance * n.dot(*d).max(0.0) / directions.len() as f32;
            }
            let truth = map.irradiance(n);
            assert!(((e - truth) / truth).abs().max_element() < 0.01, "{n}: {e} {truth}");
        }
    }

    /// Goal: a black map has no directions; one hot texel over nearly nothing is still whole (hard cases 25, 26).
    #[test]
    fn black_and_hot_maps() {
        let black = EnvironmentMap::constant(Vec3::ZERO);
        assert!(ShadowLight::new(&black, &[], &ShadowLightConfig::default()).unwrap().directions.is_empty());
        let mut image = Image::filled(64, 32, 3, 1e-3);
        image.pixel_mut(3, 0).copy_from_slice(&[1e5; 3]);
        let map = EnvironmentMap::from_image(&image).unwrap();
        let light =
            ShadowLight::new(&map, &[], &ShadowLightConfig { split: None, ..Default::default() }).unwrap();
        let sum: Vec3 = light.energy.iter().sum();
        assert!((sum / map.integral() - 1.0).abs().max_element() < 1e-4);
    }

    /// Goal: every problem of every lamp is named at once.
    #[test]
    fn lamps_are_checked() {
        let bad = [
            Lamp::Directional { direction: Vec3::ZERO, irradiance: -Vec3::ONE, angular_radius: 2.0 },
            Lamp::Point { position: Vec3::NAN, intensity: Vec3::ONE, radius: -1.0 },
        ];
        let config = ShadowLightConfig::default();
        let error = ShadowLight::new(&sunny(), &bad, &config).unwrap_err();
        assert_eq!(error.0.len(), 5, "{error}");
        assert!(error.0[3].starts_with("lamp 2: its position"));
    }
}
