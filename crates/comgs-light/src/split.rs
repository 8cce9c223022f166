//! Small strong lights of an environment map apart from its smooth rest.
//!
//! A sun of a degree casts a sharp shadow that a coarse grid of directions cannot hold, and the sky around it a soft one
//! that needs no rays. The two are told apart once a map: `map = rest + Σ lights`, texel by texel, to rounding.
//!
//! 1. The level of the smooth light, `m`, is the mean of the luminance clipped at [`SplitConfig::contrast`] times itself
//!    (a fixed point, found by iteration): a sun cannot raise it.
//! 2. Texels brighter than `contrast · m` grow together over edges and corners, across the azimuth's seam.
//! 3. A group is a strong light when it is small ([`SplitConfig::max_solid_angle`]) and holds a share of the map's light
//!    ([`SplitConfig::min_share`]). What its texels have above the mean of the group's surroundings is the light; the
//!    surroundings' radiance stays in the rest, which has no hole where the sun was.

use crate::{EnvironmentMap, luminance};
use comgs_geom::equirect;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::PI;

/// What counts as a small strong light.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitConfig {
    /// Luminance of a strong texel over the mean of the smooth light; above 1.
    pub contrast: f32,
    /// Largest solid angle of a strong light in steradians; above 0. 0.06 is a disc of 16° across: a window that fills
    /// more than that casts a shadow as soft as a grid of a thousand directions makes it.
    pub max_solid_angle: f32,
    /// Least share of the map's luminance that makes extracting a light worth its rays; 0 to 1.
    pub min_share: f32,
    /// Most lights; the strongest are kept.
    pub max_lights: usize,
}

impl Default for SplitConfig {
    fn default() -> Self {
        Self { contrast: 8.0, max_solid_angle: 0.06, min_share: 0.01, max_lights: 8 }
    }
}

impl SplitConfig {
    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if !(self.contrast > 1.0 && self.contrast.is_finite()) {
            problems.push(format!("contrast is {}, expected a finite value above 1", self.contrast));
        }
        if !(self.max_solid_angle > 0.0 && self.max_solid_angle <= 4.0 * PI) {
            problems
                .push(format!("max_solid_angle is {}, expected a value in (0, 4π]", self.max_solid_angle));
        }
        if !(0.0..=1.0).contains(&self.min_share) {
            problems.push(format!("min_share is {}, expected 0 to 1", self.min_share));
        }
        problems
    }
}

/// A small strong light.
#[derive(Clone, Debug, PartialEq)]
pub struct StrongLight {
    /// Unit direction of its middle, world: the mean of its texels by energy.
    pub direction: Vec3,
    /// Solid angle of its texels in steradians.
    pub solid_angle: f32,
    /// ∫ L dω of what is above its surroundings, linear RGB: the irradiance of a surface that faces it.
    pub energy: Vec3,
    texels: Vec<StrongTexel>,
    /// Cumulative luminous energy of the texels, ends at 1.
    cumulative: Vec<f32>,
}

/// A texel of a strong light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StrongTexel {
    /// Column in the map's image.
    pub column: usize,
    /// Row in the map's image.
    pub row: usize,
    /// Radiance above the surroundings.
    pub radiance: Vec3,
}

/// A map as strong lights and a smooth rest.
#[derive(Clone, Debug, PartialEq)]
pub struct LightSplit {
    /// The strong lights, the strongest first; empty when there are none, and `rest` is then the map.
    pub strong: Vec<StrongLight>,
    /// Everything else.
    pub rest: EnvironmentMap,
}

impl StrongLight {
    /// Its texels.
    #[must_use]
    pub fn texels(&self) -> &[StrongTexel] {
        &self.texels
    }

    /// Unit direction for two random numbers in [0, 1), distributed as its luminous energy is: each of `n` such samples
    /// stands for `energy / n`. `map` must be the map that it was split from.
    #[must_use]
    pub fn sample(&self, map: &EnvironmentMap, u: Vec2) -> Vec3 {
        let i = self.cumulative.partition_point(|&c| c <= u.x).min(self.texels.len() - 1);
        let low = if i == 0 { 0.0 } else { self.cumulative[i - 1] };
        let width = self.cumulative[i] - low;
        let inside = if width > 0.0 { ((u.x - low) / width).clamp(0.0, 1.0) } else { 0.5 };
        let texel = &self.texels[i];
        // Uniform in the azimuth and the polar angle: within one texel the solid angle hardly varies but at the poles.
        let at = |k: usize, inside: f32, count: usize| (k as f32 + inside) / count as f32;
        map.direction(at(texel.column, inside, map.width()), at(texel.row, u.y, map.height()))
    }
}

impl LightSplit {
    /// Splits a map.
    ///
    /// A map without strong light comes back as it is; a black one too. Not differentiable.
    ///
    /// # Panics
    /// When the configuration is out of range ([`SplitConfig::check`]).
    #[must_use]
    pub fn new(map: &EnvironmentMap, config: &SplitConfig) -> Self {
        let problems = config.check();
        assert!(problems.is_empty(), "unusable split: {}", problems.join("; "));
        let (w, h) = (map.width(), map.height());
        let texels: Vec<Vec3> =
            (0..w * h).map(|i| Vec3::from_slice(&map.image().data[3 * i..3 * i + 3])).collect();
        let omega: Vec<f32> = (0..h).map(|row| equirect::texel_solid_angle(row, w, h)).collect();
        let bright: Vec<f32> = texels.iter().map(|&t| luminance(t)).collect();
        let threshold = config.contrast * smooth_level(&bright, &omega, w, config.contrast);
        let total: f64 = bright.iter().enumerate().map(|(i, &l)| f64::from(l * omega[i / w])).sum();
        if !(threshold > 0.0) || !bright.iter().any(|&l| l > threshold) {
            return Self { strong: Vec::new(), rest: map.clone() };
        }
        let mut strong: Vec<(StrongLight, Vec<usize>, Vec3)> = Vec::new();
        for group in groups(&bright, threshold, w) {
            let size: f32 = group.iter().map(|&i| omega[i / w]).sum();
            if size > config.max_solid_angle {
                continue;
            }
            let around = surroundings(&group, &texels, &bright, threshold, w, h);
            let light = light_of(&group, &texels, &omega, around, map);
            if f64::from(luminance(light.energy)) >= f64::from(config.min_share) * total {
                strong.push((light, group, around));
            }
        }
        strong.sort_by(|a, b| luminance(b.0.energy).total_cmp(&luminance(a.0.energy)));
        strong.truncate(config.max_lights);
        let mut rest = map.clone();
        for (_, group, around) in &strong {
            for &i in group {
                let kept = texels[i].min(*around);
                rest.set_texel(i % w, i / w, kept);
            }
        }
        Self { strong: strong.into_iter().map(|s| s.0).collect(), rest }
    }

    /// Rest and lights put together again.
    #[must_use]
    pub fn sum(&self) -> EnvironmentMap {
        let mut map = self.rest.clone();
        for texel in self.strong.iter().flat_map(|l| &l.texels) {
            let value = map.texel(texel.column, texel.row) + texel.radiance;
            map.set_texel(texel.column, texel.row, value);
        }
        map
    }
}

/// Mean luminance, by solid angle, of a map clipped at `contrast` times this mean: the fixed point from above, 0 for a black
/// map. The iteration shrinks towards it; 32 rounds leave less than a percent of a sun of 10⁵ over 10⁻³.
fn smooth_level(bright: &[f32], omega: &[f32], w: usize, contrast: f32) -> f32 {
    let mut clip = f64::INFINITY;
    let mut mean = 0.0f64;
    for _ in 0..32 {
        let sum: f64 =
            bright.iter().enumerate().map(|(i, &l)| f64::from(l).min(clip) * f64::from(omega[i / w])).sum();
        let next = sum / (4.0 * std::f64::consts::PI);
        if clip.is_finite() && (next - mean).abs() <= 1e-4 * mean {
            return next as f32;
        }
        mean = next;
        clip = f64::from(contrast) * mean;
    }
    mean as f32
}

/// Eight neighbours of a texel; across the azimuth's seam, not across the poles.
fn neighbours(i: usize, w: usize, h: usize) -> impl Iterator<Item = usize> {
    let (x, y) = ((i % w) as isize, (i / w) as isize);
    (-1..=1).flat_map(move |dy| {
        (-1..=1).filter_map(move |dx| {
            let row = y + dy;
            ((dx, dy) != (0, 0) && (0..h as isize).contains(&row))
                .then(|| row as usize * w + (x + dx).rem_euclid(w as isize) as usize)
        })
    })
}

/// Connected groups of texels brighter than a threshold, texels in ascending order.
fn groups(bright: &[f32], threshold: f32, w: usize) -> Vec<Vec<usize>> {
    let h = bright.len() / w;
    let mut seen = vec![false; bright.len()];
    let mut groups = Vec::new();
    for start in 0..bright.len() {
        if seen[start] || !(bright[start] > threshold) {
            continue;
        }
        seen[start] = true;
        let mut group = vec![start];
        let mut next = 0;
        while next < group.len() {
            for j in neighbours(group[next], w, h) {
                if !seen[j] && bright[j] > threshold {
                    seen[j] = true;
                    group.push(j);
                }
            }
            next += 1;
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

/// Mean radiance of the texels around a group that are not brighter than the threshold; 0 where there are none.
fn surroundings(
    group: &[usize],
    texels: &[Vec3],
    bright: &[f32],
    threshold: f32,
    w: usize,
    h: usize,
) -> Vec3 {
    let mut ring: Vec<usize> =
        group.iter().flat_map(|&i| neighbours(i, w, h)).filter(|&j| bright[j] <= threshold).collect();
    ring.sort_unstable();
    ring.dedup();
    let sum: DVec3 = ring.iter().map(|&j| texels[j].as_dvec3()).sum();
    if ring.is_empty() { Vec3::ZERO } else { (sum / ring.len() as f64).as_vec3() }
}

fn light_of(
    group: &[usize],
    texels: &[Vec3],
    omega: &[f32],
    around: Vec3,
    map: &EnvironmentMap,
) -> StrongLight {
    let (w, h) = (map.width(), map.height());
    let mut energy = DVec3::ZERO;
    let mut middle = DVec3::ZERO;
    let mut luminous = 0.0f64;
    let mut cumulative = Vec::with_capacity(group.len());
    let mut list = Vec::with_capacity(group.len());
    for &i in group {
        let (column, row) = (i % w, i / w);
        let radiance = texels[i] - texels[i].min(around);
        let part = radiance.as_dvec3() * f64::from(omega[row]);
        let weight = f64::from(luminance(radiance)) * f64::from(omega[row]);
        let centre = map.direction((column as f32 + 0.5) / w as f32, (row as f32 + 0.5) / h as f32);
        energy += part;
        middle += weight * centre.as_dvec3();
        luminous += weight;
        cumulative.push(luminous);
        list.push(StrongTexel { column, row, radiance });
    }
    let first = list[0];
    let fallback = map.direction((first.column as f32 + 0.5) / w as f32, (first.row as f32 + 0.5) / h as f32);
    StrongLight {
        direction: middle.as_vec3().normalize_or(fallback),
        solid_angle: group.iter().map(|&i| omega[i / w]).sum(),
        energy: energy.as_vec3(),
        texels: list,
        cumulative: cumulative.iter().map(|c| (c / luminous.max(f64::MIN_POSITIVE)) as f32).collect(),
    }
}
