//! A map that answers how bright a cone of it is, and how much light falls on a surface, at the price of a lookup.
//!
//! Relighting by many samples asks the map a hundred times a pixel. A few samples are enough when each knows how much of the
//! sphere it stands for and reads the mean over that much (filtered importance sampling, Křivánek and Colbert 2008), and
//! the matte part of a surface asks for one number a normal.

use crate::EnvironmentMap;
use comgs_geom::{equirect, octahedral};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Side of the coarsest level.
const COARSEST: usize = 8;
/// Most texels along a side.
const FINEST: usize = 256;
/// Texels along a side of the table of irradiance, and of the light that it is a sum of: 2.8° on the equator.
const IRRADIANCE: usize = 64;

/// Octahedral maps of falling resolution, each the mean of the one before, and a table of irradiance. Not differentiable.
#[derive(Clone, Debug)]
pub struct MipLight {
    /// Sides, largest first, each twice the next.
    sides: Vec<usize>,
    /// `[level][texel][rgb]`, linear radiance.
    levels: Vec<Vec<f32>>,
    /// `[texel][rgb]` over the normals.
    irradiance: Vec<f32>,
}

impl MipLight {
    /// Resamples a map: levels from the map's height (8 to 256) down to 8, all with its integral to rounding.
    #[must_use]
    pub fn new(map: &EnvironmentMap) -> Self {
        let finest = map.height().next_power_of_two().clamp(2 * COARSEST, FINEST);
        let mut sides = vec![finest];
        let mut levels = vec![splatted(map, finest)];
        while sides[sides.len() - 1] > COARSEST {
            let side = sides[sides.len() - 1];
            levels.push(halved(&levels[levels.len() - 1], side));
            sides.push(side / 2);
        }
        let source = sides.iter().position(|&s| s <= IRRADIANCE).unwrap_or(0);
        let irradiance = irradiance_table(&levels[source], sides[source]);
        Self { sides, levels, irradiance }
    }

    /// Mean radiance of about `solid_angle` steradians around a unit direction, bilinear in the two levels next to it; the
    /// finest level for smaller and the coarsest for larger solid angles.
    #[must_use]
    pub fn radiance(&self, direction: Vec3, solid_angle: f32) -> Vec3 {
        let finest = self.sides[0] as f32;
        let texel = 4.0 * PI / (finest * finest);
        let last = (self.levels.len() - 1) as f32;
        let level = (0.5 * (solid_angle / texel).max(1.0).log2()).min(last);
        let below = level.floor();
        let read = |k: usize| octahedral::footprint(direction, self.sides[k]).gather_rgb(&self.levels[k]);
        let fine = read(below as usize);
        let part = level - below;
        if part > 0.0 { fine.lerp(read(below as usize + 1), part) } else { fine }
    }

    /// ∫ L max(0, n · ω) dω for a unit normal, bilinear in a table of 64² normals. Reference:
    /// [`EnvironmentMap::irradiance`]; where a small strong light sets, the table rounds the edge over 3°.
    #[must_use]
    pub fn irradiance(&self, normal: Vec3) -> Vec3 {
        octahedral::footprint(normal, IRRADIANCE).gather_rgb(&self.irradiance)
    }

    /// Irradiance of a surface in the mean radiance of the whole sphere: a scale to call something dark by.
    #[must_use]
    pub fn mean_irradiance(&self) -> Vec3 {
        let last = self.levels.len() - 1;
        let angles = octahedral::solid_angles(self.sides[last]);
        let sum: Vec3 =
            self.levels[last].chunks_exact(3).zip(angles).map(|(c, w)| w * Vec3::from_slice(c)).sum();
        sum / 4.0
    }
}

/// A map on an octahedral grid: every texel of the map, cut until it is half as large as the grid's, is spread over the four
/// centres around it; a texel of the grid that nothing reached (there is none from 4 parts on) stays black.
fn splatted(map: &EnvironmentMap, side: usize) -> Vec<f32> {
    let (w, h) = (map.width(), map.height());
    let parts = (2 * side).div_ceil(h).max(1);
    // What each texel stands for under the same spreading stands beside, so that a constant stays constant.
    let mut sums = vec![(DVec3::ZERO, 0.0f64); side * side];
    for row in 0..h * parts {
        let omega = f64::from(equirect::texel_solid_angle(row, w * parts, h * parts));
        for column in 0..w * parts {
            let u = (column as f32 + 0.5) / (w * parts) as f32;
            let v = (row as f32 + 0.5) / (h * parts) as f32;
            let footprint = octahedral::footprint(map.direction(u, v), side);
            let radiance = map.texel(column / parts, row / parts).as_dvec3();
            for (texel, weight) in footprint.texels.into_iter().zip(footprint.weights) {
                let weight = omega * f64::from(weight);
                sums[texel as usize].0 += weight * radiance;
                sums[texel as usize].1 += weight;
            }
        }
    }
    let mean = |&(sum, covered): &(DVec3, f64)| if covered > 0.0 { sum / covered } else { DVec3::ZERO };
    let texels: Vec<DVec3> = sums.iter().map(mean).collect();
    // The texels' own solid angles differ a little from what was spread over them.
    let angles = octahedral::solid_angles(side);
    let integral: DVec3 = texels.iter().zip(&angles).map(|(t, a)| *t * f64::from(*a)).sum();
    let total: DVec3 = sums.iter().map(|s| s.0).sum();
    let factor =
        DVec3::from_array([0, 1, 2].map(|c| if integral[c] > 0.0 { total[c] / integral[c] } else { 0.0 }));
    texels.iter().flat_map(|t| (*t * factor).as_vec3().to_array()).collect()
}

/// Means of two by two texels by their solid angles.
fn halved(fine: &[f32], side: usize) -> Vec<f32> {
    let (half, angles) = (side / 2, octahedral::solid_angles(side));
    let own = octahedral::solid_angles(half);
    let mut out = Vec::with_capacity(3 * half * half);
    for i in 0..half * half {
        let (x, y) = (2 * (i % half), 2 * (i / half));
        let mut sum = Vec3::ZERO;
        for t in [y * side + x, y * side + x + 1, (y + 1) * side + x, (y + 1) * side + x + 1] {
            sum += angles[t] * Vec3::from_slice(&fine[3 * t..]);
        }
        out.extend((sum / own[i]).to_array());
    }
    out
}

/// Σ L max(0, n · ω) Ω over a level's texels for every normal of the table.
fn irradiance_table(level: &[f32], side: usize) -> Vec<f32> {
    let light: Vec<(Vec3, f32, Vec3)> = octahedral::solid_angles(side)
        .into_iter()
        .enumerate()
        .map(|(t, w)| {
            let d = octahedral::texel_direction(t % side, t / side, side);
            (d, w, w * Vec3::from_slice(&level[3 * t..]))
        })
        .collect();
    (0..IRRADIANCE * IRRADIANCE)
        .into_par_iter()
        .with_min_len(IRRADIANCE)
        .flat_map_iter(|t| {
            let n = octahedral::texel_direction(t % IRRADIANCE, t / IRRADIANCE, IRRADIANCE);
            let (mut sum, mut cosines) = (Vec3::ZERO, 0.0f32);
            for (d, w, energy) in &light {
                let cosine = n.dot(*d).max(0.0);
                sum += cosine * *energy;
                cosines += cosine * w;
            }
            // The cosine's own integral by the same texels is π but for their size.
            (sum * (PI / cosines)).to_array()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_image::Image;

    /// A sky with a sun of one texel, turned.
    fn sunny() -> EnvironmentMap {
        let mut image = Image::zeros(128, 64, 3);
        for y in 0..64 {
            for x in 0..128 {
                let d = equirect::texel_direction(x, y, 128, 64);
                image.pixel_mut(x, y).copy_from_slice(&[0.4 + 0.2 * d.x, 0.5, 0.8 + 0.3 * d.z]);
            }
        }
        image.pixel_mut(40, 18).copy_from_slice(&[900.0, 850.0, 800.0]);
        EnvironmentMap::from_image(&image).unwrap().turned(0.7)
    }

    /// Goal: a constant map is that constant in every direction, at every size, and π times it on every surface; black is
    /// black.
    #[test]
    fn a_constant_stays_constant() {
        let light = MipLight::new(&EnvironmentMap::constant(Vec3::new(0.5, 1.0, 2.0)));
        let black = MipLight::new(&EnvironmentMap::constant(Vec3::ZERO));
        for k in 0..50 {
            let d = octahedral::texel_direction(k % 7, k / 7, 8);
            for solid_angle in [0.0, 1e-4, 0.01, 0.3, 4.0 * PI] {
                let got = light.radiance(d, solid_angle);
                assert!((got - Vec3::new(0.5, 1.0, 2.0)).abs().max_element() < 2e-3, "{got}");
            }
            let got = light.irradiance(d) / PI;
            assert!((got - Vec3::new(0.5, 1.0, 2.0)).abs().max_element() < 5e-3, "{got}");
            assert_eq!(black.radiance(d, 0.1) + black.irradiance(d), Vec3::ZERO);
        }
        assert!((light.mean_irradiance() / PI - Vec3::new(0.5, 1.0, 2.0)).abs().max_element() < 2e-3);
    }

    /// Goal: no level loses light, a sun of one texel included; and irradiance is the map's own to a percent of what the sun
    /// alone gives, away from the edge where it sets.
    #[test]
    fn light_is_kept() {
        let map = sunny();
        let light = MipLight::new(&map);
        for (level, &side) in light.levels.iter().zip(&light.sides) {
            let angles = octahedral::solid_angles(side);
            let sum: Vec3 = level.chunks_exact(3).zip(angles).map(|(c, w)| w * Vec3::from_slice(c)).sum();
            assert!(((sum - map.integral()) / map.integral()).abs().max_element() < 1e-3, "{side}: {sum}");
        }
        let sun = map.direction(40.5 / 128.0, 18.5 / 64.0);
        for k in 0..64 {
            let n = octahedral::texel_direction(k % 8, k / 8, 8);
            let (got, expected) = (light.irradiance(n), map.irradiance(n));
            // 3° of a cosine of the sun where it sets.
            let slack = if n.dot(sun).abs() < 0.06 { 0.03 } else { 0.01 };
            let most = map.irradiance(sun);
            assert!(((got - expected) / most).abs().max_element() < slack, "{n}: {got} {expected}");
        }
    }

    /// Goal: a cone's mean follows its size: towards the sun it falls from the sun's own to the whole sphere's as the cone
    /// grows, never rising.
    #[test]
    fn wider_cones_are_dimmer_towards_the_sun() {
        let map = sunny();
        let light = MipLight::new(&map);
        let sun = map.direction(40.5 / 128.0, 18.5 / 64.0);
        let values: Vec<f32> =
            [1e-5, 1e-3, 1e-2, 0.1, 1.0].iter().map(|&s| light.radiance(sun, s).x).collect();
        assert!(values.windows(2).all(|v| v[1] <= v[0] * 1.001), "{values:?}");
        assert!(values[0] > 100.0 && values[4] < 30.0, "{values:?}");
    }
}
