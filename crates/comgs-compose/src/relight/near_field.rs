//! Near-field light: a map taken in one place, seen from another.
//!
//! A map is what arrives at its centre c. From a point p the same surfaces lie in other directions. The scene says how
//! far from c they are, so a ray from p is followed to the surface that it meets, and the map is read in the direction of that
//! place from c:
//!
//! ```text
//! L(p, ω) = S(q) · L_map((q − c) / |q − c|),    q = p + s ω,    |q − c| = t((q − c) / |q − c|)
//! ```
//!
//! with t the distance at which the scene is seen from c, infinite where it ends, and S the shadow of the objects on the surface
//! at q: a floor in shadow sends less light up. Radiance is kept along a ray, so nothing has to be weighted by distances and nothing
//! grows without bound (environment maps with distances: Szirmay-Kalos et al., "Approximate Ray-Tracing on the GPU with
//! Distance Impostors", 2005). Surfaces that c does not see are not there; every surface sends what it sends to c to all sides.

use crate::ShadowRatios;
use crate::shadow_light::{Beam, ShadowLight};
use comgs_geom::octahedral;
use comgs_light::{EnvironmentMap, LightSplit, MipLight, SplitConfig};
use comgs_trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;

/// Texels along a side of the distances: 2.8° on the equator.
const SIDE: usize = 64;
/// Coverage from which on a ray has met a surface.
const SOLID: f32 = 0.5;
/// Steps at most; a plane is met by the first.
const STEPS: usize = 6;
/// Distance from the surface, over its distance from the centre, that is near enough.
const CLOSE: f32 = 5e-3;
/// Doublings of the centre's distance after which a ray is taken to leave by an opening.
const DOUBLINGS: usize = 4;

/// Distances of the scene around the centre of a map, and the light that they are for.
#[derive(Clone, Debug)]
pub struct NearField {
    centre: Vec3,
    /// `[texel]`: 1 over the distance; 0 where the scene ends.
    inverse: Vec<f32>,
    /// `[texel]`: unit normals of what is seen, towards the centre; zero where the scene ends.
    normals: Vec<Vec3>,
    /// `[texel]`: share of its light that a surface keeps; empty while nothing shadows it.
    kept: Vec<Vec3>,
    /// The map without small strong lights.
    smooth: MipLight,
}

/// A point from which the near field is looked at.
#[derive(Clone, Copy, Debug)]
pub struct From {
    /// Relative to the centre.
    p: Vec3,
    /// How far outside of the surface around the centre it is, at least −1: below 0 inside.
    outside: f32,
}

impl NearField {
    /// * `scene`: tracer of the scene, without the objects
    /// * `centre`: where `map` was taken, world; surfaces nearer than `near` are passed over
    /// * `split`: what counts as a strong light, as in [`crate::ShadowLightConfig::split`]
    #[must_use]
    pub fn new(
        scene: &Tracer,
        centre: Vec3,
        near: f32,
        map: &EnvironmentMap,
        split: Option<&SplitConfig>,
    ) -> Self {
        let seen: Vec<(f32, Vec3)> = (0..SIDE * SIDE)
            .into_par_iter()
            .map(|k| {
                let direction = octahedral::texel_direction(k % SIDE, k / SIDE, SIDE);
                let hit = scene.radiance(centre, direction, near, f32::INFINITY);
                let inverse = hit.alpha / hit.depth;
                if hit.alpha >= SOLID && inverse.is_finite() {
                    (inverse, hit.normal.normalize_or(-direction))
                } else {
                    (0.0, Vec3::ZERO)
                }
            })
            .collect();
        let (inverse, normals) = seen.into_iter().unzip();
        let smooth = match split {
            Some(split) => MipLight::new(&LightSplit::new(map, split).rest),
            None => MipLight::new(map),
        };
        Self { centre, inverse, normals, kept: Vec::new(), smooth }
    }

    /// With the shadow that the objects cast on what is seen.
    #[must_use]
    pub fn with_shadow(mut self, shadow: &dyn ShadowRatios) -> Self {
        let at = |k: usize| {
            let direction = octahedral::texel_direction(k % SIDE, k / SIDE, SIDE);
            self.centre + direction / self.inverse[k]
        };
        let there: Vec<usize> = (0..SIDE * SIDE).filter(|&k| self.inverse[k] > 0.0).collect();
        let points: Vec<Vec3> = there.iter().map(|&k| at(k)).collect();
        let normals: Vec<Vec3> = there.iter().map(|&k| self.normals[k]).collect();
        self.kept = vec![Vec3::ONE; SIDE * SIDE];
        for (k, ratio) in there.into_iter().zip(shadow.ratios(&points, &normals)) {
            self.kept[k] = ratio;
        }
        self
    }

    /// Where the scene is seen from the centre, as a share of the sphere in [0, 1].
    #[must_use]
    pub fn coverage(&self) -> f32 {
        let angles = octahedral::solid_angles(SIDE);
        let covered = self.inverse.iter().zip(&angles).filter(|(i, _)| **i > 0.0).map(|(_, w)| w);
        covered.sum::<f32>() / (4.0 * std::f32::consts::PI)
    }

    /// The light with its strong lights where the scene has them, if it has anything there: parallel rays become rays to
    /// points, whose irradiance at the centre is the same.
    #[must_use]
    pub fn located(&self, mut light: ShadowLight) -> ShadowLight {
        for beam in &mut light.beams {
            let Beam::Parallel { directions, irradiance } = beam else { continue };
            let middle = directions.iter().sum::<Vec3>().normalize_or(Vec3::Z);
            let inverse = self.inverse(middle);
            if inverse > 0.0 {
                let positions = directions.iter().map(|d| self.centre + *d / inverse).collect();
                *beam = Beam::Points { positions, intensity: *irradiance / (inverse * inverse) };
            }
        }
        light
    }

    /// A point, prepared to be looked from.
    #[must_use]
    pub fn from(&self, point: Vec3) -> From {
        let p = point - self.centre;
        From { p, outside: self.outside(p) }
    }

    /// The direction in which the map shows what a point sees in a unit direction, and the share of its light that this keeps.
    /// The direction itself where the scene ends, and from a point that the centre does not see.
    #[must_use]
    pub fn towards(&self, from: &From, direction: Vec3) -> (Vec3, Vec3) {
        let found = self.crossing(from, direction);
        let looked = found.map_or(direction, |q| q.normalize_or(direction));
        let kept = match (found, self.kept.is_empty()) {
            (Some(_), false) => {
                let f = octahedral::footprint(looked, SIDE);
                (0..4).map(|k| f.weights[k] * self.kept[f.texels[k] as usize]).sum()
            }
            _ => Vec3::ONE,
        };
        (looked, kept)
    }

    /// The place, relative to the centre, where a ray leaves the space around the centre.
    ///
    /// `g(s) = |q| / t(q / |q|) − 1` is linear in s where the surface is a plane, so the secant between a point inside and one
    /// outside meets a plane at once.
    fn crossing(&self, from: &From, direction: Vec3) -> Option<Vec3> {
        let start = self.inverse(direction);
        if start == 0.0 || from.outside >= 0.0 {
            return None;
        }
        let (mut a, mut ga) = (0.0, from.outside);
        let mut b = 1.0 / start;
        let mut gb = self.outside(from.p + b * direction);
        for _ in 0..DOUBLINGS {
            if gb >= 0.0 {
                break;
            }
            (a, ga) = (b, gb);
            b *= 2.0;
            gb = self.outside(from.p + b * direction);
        }
        if gb < 0.0 {
            // Out by an opening.
            return None;
        }
        let mut last = 0.0;
        let mut s = b;
        for _ in 0..STEPS {
            s = (a * gb - b * ga) / (gb - ga);
            let g = self.outside(from.p + s * direction);
            if g.abs() < CLOSE {
                break;
            }
            // An end that stays twice in a row counts half (Illinois), or corners would be crept up to.
            if g < 0.0 {
                (a, ga) = (s, g);
                gb *= if last < 0.0 { 0.5 } else { 1.0 };
            } else {
                (b, gb) = (s, g);
                ga *= if last > 0.0 { 0.5 } else { 1.0 };
            }
            last = g;
        }
        Some(from.p + s * direction)
    }

    /// 1 over the distance in a direction of any length; 0 where most around it is open.
    fn inverse(&self, direction: Vec3) -> f32 {
        let f = octahedral::footprint(direction, SIDE);
        let (mut sum, mut weight) = (0.0, 0.0);
        for k in 0..4 {
            let inverse = self.inverse[f.texels[k] as usize];
            if inverse > 0.0 {
                sum += f.weights[k] * inverse;
                weight += f.weights[k];
            }
        }
        // 1 over the distance of a plane is linear in the direction, so means of it are.
        if weight >= 0.5 { sum / weight } else { 0.0 }
    }

    fn outside(&self, q: Vec3) -> f32 {
        q.length() * self.inverse(q) - 1.0
    }

    /// Directions for [`NearField::factor`]: the texels of an octahedral grid, turned.
    pub(super) fn grid(&self, side: usize, turn: glam::Quat) -> Grid {
        let texels = octahedral::solid_angles(side).into_iter().enumerate();
        let texel = |(t, angle): (usize, f32)| {
            let direction = turn * octahedral::texel_direction(t % side, t / side, side);
            (direction, angle, self.smooth.radiance(direction, angle))
        };
        Grid(texels.map(texel).collect())
    }

    /// What the near field makes of the irradiance of a surface, RGB: irradiance from where the surface is over that of the map
    /// at infinity, both sums over the same directions and visibilities, so that their coarseness cancels. `open` gives what of
    /// each texel of the grid is open. 1 where nothing arrives; in [1/`MAX_FACTOR`, `MAX_FACTOR`].
    pub(super) fn factor(&self, point: Vec3, normal: Vec3, grid: &Grid, open: impl Fn(usize) -> f32) -> Vec3 {
        let from = self.from(point);
        let (mut near, mut far) = (Vec3::ZERO, Vec3::ZERO);
        for (k, &(direction, angle, radiance)) in grid.0.iter().enumerate() {
            let cosine = normal.dot(direction);
            if cosine <= 0.0 {
                continue;
            }
            let weight = angle * cosine * open(k);
            if weight > 0.0 {
                let (looked, kept) = self.towards(&from, direction);
                far += weight * radiance;
                near += weight * kept * self.smooth.radiance(looked, angle);
            }
        }
        let channel = |near: f32, far: f32| {
            if far > crate::DARK { (near / far).clamp(1.0 / MAX_FACTOR, MAX_FACTOR) } else { 1.0 }
        };
        Vec3::new(channel(near.x, far.x), channel(near.y, far.y), channel(near.z, far.z))
    }
}

/// Unit directions (world) with their solid angles and the smooth light at infinity.
pub(super) struct Grid(Vec<(Vec3, f32, Vec3)>);

/// Largest factor, and one over the smallest.
const MAX_FACTOR: f32 = 16.0;

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_image::Image;

    /// Distances of a box, exact, without a tracer.
    fn room(half: Vec3, centre: Vec3, map: &EnvironmentMap) -> NearField {
        let reach = |d: Vec3| {
            let axis =
                |p: f32, d: f32, h: f32| if d == 0.0 { f32::INFINITY } else { (h * d.signum() - p) / d };
            axis(centre.x, d.x, half.x).min(axis(centre.y, d.y, half.y)).min(axis(centre.z, d.z, half.z))
        };
        let texels = (0..SIDE * SIDE).map(|k| octahedral::texel_direction(k % SIDE, k / SIDE, SIDE));
        let inverse: Vec<f32> = texels.map(|d| 1.0 / reach(d)).collect();
        NearField {
            centre,
            normals: vec![Vec3::ZERO; inverse.len()],
            inverse,
            kept: Vec::new(),
            smooth: MipLight::new(map),
        }
    }

    fn wall(half: Vec3, p: Vec3, d: Vec3) -> Vec3 {
        let axis = |p: f32, d: f32, h: f32| if d == 0.0 { f32::INFINITY } else { (h * d.signum() - p) / d };
        p + d * axis(p.x, d.x, half.x).min(axis(p.y, d.y, half.y)).min(axis(p.z, d.z, half.z))
    }

    /// Goal: in a room, rays from points well off the centre and just above the floor are found where they meet the walls on
    /// paper: within a texel of the distances (2.8°) for 95 of 100, and on average within a third of one.
    #[test]
    fn rays_meet_the_walls_of_a_room() {
        let half = Vec3::new(2.0, 1.5, 1.0);
        let centre = Vec3::new(0.1, -0.2, -0.7);
        let field = room(half, centre, &EnvironmentMap::constant(Vec3::ONE));
        let mut errors = Vec::new();
        for p in [Vec3::new(0.4, 0.1, -0.6), Vec3::new(-0.3, -0.4, -0.98), Vec3::new(0.5, -0.5, -0.2)] {
            let from = field.from(p);
            for k in 0..16 * 16 {
                let d = octahedral::texel_direction(k % 16, k / 16, 16);
                let truth = (wall(half, p, d) - centre).normalize();
                let (got, kept) = field.towards(&from, d);
                assert_eq!(kept, Vec3::ONE);
                errors.push(got.angle_between(truth).to_degrees());
            }
        }
        errors.sort_by(f32::total_cmp);
        let mean = errors.iter().sum::<f32>() / errors.len() as f32;
        let most = errors[errors.len() * 95 / 100];
        assert!(mean < 1.0 && most < 2.8, "mean {mean}°, 95 %: {most}°, worst {:?}°", errors.last());
    }

    /// Goal: the centre sees the map as it is; under even light nothing changes anywhere; where the scene ends nothing does
    /// either; and a point within a wall is left alone.
    #[test]
    fn what_does_not_change() {
        let half = Vec3::splat(1.0);
        let even = EnvironmentMap::constant(Vec3::new(0.2, 0.5, 0.9));
        let field = room(half, Vec3::ZERO, &even);
        let grid: Vec<Vec3> = (0..64).map(|k| octahedral::texel_direction(k % 8, k / 8, 8)).collect();
        for d in &grid {
            assert!(field.towards(&field.from(Vec3::ZERO), *d).0.angle_between(*d) < 1e-3);
            assert_eq!(field.towards(&field.from(Vec3::new(1.5, 0.0, 0.0)), *d).0, *d);
        }
        let straight = field.grid(8, glam::Quat::IDENTITY);
        let factor = field.factor(Vec3::new(0.5, 0.3, -0.9), Vec3::Z, &straight, |_| 1.0);
        assert!((factor - 1.0).abs().max_element() < 1e-5, "{factor}");
        let open = NearField { inverse: vec![0.0; SIDE * SIDE], ..field.clone() };
        assert_eq!(open.towards(&open.from(Vec3::new(0.5, 0.3, 0.0)), Vec3::X).0, Vec3::X);
        assert!((field.coverage() - 1.0).abs() < 1e-3 && open.coverage() == 0.0, "{}", field.coverage());
        let black = room(half, Vec3::ZERO, &EnvironmentMap::constant(Vec3::ZERO));
        let dark = black.grid(8, glam::Quat::IDENTITY);
        assert_eq!(black.factor(Vec3::ZERO, Vec3::Z, &dark, |_| 1.0), Vec3::ONE);
    }

    /// Goal: the irradiance of a floor under a glowing panel of a ceiling falls off to the side as the form factor on paper says
    /// (a rectangle parallel to a small surface; here by brute force over its area), though the map was taken elsewhere: within 5 %.
    /// The map at infinity would say the same everywhere.
    #[test]
    fn a_panel_in_a_ceiling() {
        let half = Vec3::new(2.0, 2.0, 1.0);
        let centre = Vec3::new(0.0, 0.0, -0.6);
        // The panel: |x|, |y| < 0.5 on the ceiling, radiance 1; a map of 512 × 256 as it is seen from the centre.
        let panel = |q: Vec3| q.z > 0.999 && q.x.abs() < 0.5 && q.y.abs() < 0.5;
        let mut image = Image::zeros(512, 256, 3);
        for y in 0..256 {
            for x in 0..512 {
                let d = comgs_geom::equirect::texel_direction(x, y, 512, 256);
                if panel(wall(half, centre, d)) {
                    image.pixel_mut(x, y).copy_from_slice(&[1.0; 3]);
                }
            }
        }
        let field = room(half, centre, &EnvironmentMap::from_image(&image).unwrap());
        // Turned, as the grid of a turned object is.
        let grid = field.grid(32, glam::Quat::from_rotation_y(0.7));
        let truth = |p: Vec3| {
            let n = 200;
            let mut sum = 0.0;
            for i in 0..n * n {
                let q = Vec3::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5, 0.0) / n as f32 - 0.5;
                let d = Vec3::new(q.x, q.y, 1.0) - p;
                sum += d.z * d.z / d.length_squared().powi(2) / (n * n) as f32;
            }
            sum
        };
        let at_centre = truth(centre);
        let mut factors = Vec::new();
        for x in [0.0, 0.4, 0.8] {
            let p = Vec3::new(x, 0.2, -0.8);
            let factor = field.factor(p, Vec3::Z, &grid, |_| 1.0).x;
            let expected = truth(p) / at_centre;
            assert!((factor / expected - 1.0).abs() < 0.05, "at {x}: {factor}, on paper {expected}");
            factors.push(factor);
        }
        assert!(factors[0] > 1.3 * factors[2], "{factors:?}");
    }

    /// Goal: a lamp that the map shows as a small bright spot stands on the ceiling afterwards, with the irradiance at the centre
    /// that it had; the sky's sun stays where it is.
    #[test]
    fn strong_lights_find_their_place() {
        let field = room(Vec3::new(2.0, 2.0, 1.0), Vec3::ZERO, &EnvironmentMap::constant(Vec3::ONE));
        let d = Vec3::new(0.3, 0.1, 1.0).normalize();
        let lamp = Beam::Parallel { directions: vec![d], irradiance: Vec3::splat(3.0) };
        let light = ShadowLight {
            directions: Vec::new(),
            energy: Vec::new(),
            solid_angles: Vec::new(),
            beams: vec![lamp.clone()],
        };
        let located = field.located(light.clone());
        let Beam::Points { positions, intensity } = &located.beams[0] else { panic!() };
        assert!((positions[0] - Vec3::new(0.3, 0.1, 1.0)).length() < 0.02, "{}", positions[0]);
        let irradiance = intensity.x / positions[0].length_squared();
        assert!((irradiance / 3.0 - 1.0).abs() < 1e-4);
        let open = NearField { inverse: vec![0.0; SIDE * SIDE], ..field };
        assert_eq!(open.located(light).beams[0], lamp);
    }
}
