//! Places that never were: rooms and open grounds from a seed, with cameras that walked around a point in them.
//!
//! They teach a panorama completer what light rooms and skies have, and what a capture usually sees of it: each comes
//! with the panorama around its point, the normals and depths of what surrounds it, and the mask of the directions that
//! its cameras saw. Rooms have windows with a sky outside, lamps, furniture and two or three coats of paint; grounds have
//! a sky, walls and trees. Same seed, same bytes.

use crate::environment::Environment;
use crate::light::{Light, direction};
use crate::material::{Finish, Material, Pattern};
use crate::path;
use crate::sequence::Sequence;
use crate::shape::{Placement, Shape};
use crate::world::{Part, World};
use comgs_geom::{Rng, equirect};
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Arc;

/// What a place is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlaceKind {
    /// Four walls and a ceiling.
    Room,
    /// Ground under a sky.
    Ground,
}

/// A camera of the walk around the point.
#[derive(Clone, Copy, Debug)]
struct Viewpoint {
    position: Vec3,
    forward: Vec3,
    right: Vec3,
    /// Tangents of half the field of view, horizontal and vertical.
    tangent: [f32; 2],
}

/// A place and the point in it where an object could stand.
#[derive(Debug)]
pub struct Place {
    /// Which kind it is.
    pub kind: PlaceKind,
    world: World,
    centre: Vec3,
    viewpoints: Vec<Viewpoint>,
}

/// What is around the point of a [`Place`]: equirectangular maps, z up, all of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct Surroundings {
    /// Linear radiance, 3 channels.
    pub radiance: Image,
    /// Unit normals towards the point, 3 channels; 0 where the sky is.
    pub normal: Image,
    /// Distance in metres, 1 channel; 0 where the sky is.
    pub depth: Image,
    /// 1 in the directions whose first surface (or sky) at least one camera saw, else 0.
    pub seen: Image,
}

/// Sky maps have this many rows: a texel is 2.8°.
const SKY_ROWS: usize = 64;

impl Place {
    /// The place of a seed; about three rooms for every two grounds.
    #[must_use]
    pub fn from_seed(seed: u64) -> Self {
        let mut rng = Rng::stream(seed, 0x706c_6163);
        if rng.uniform() < 0.6 { room(&mut rng, seed) } else { ground(&mut rng, seed) }
    }

    /// Renders what is around the point: `2·height × height` texels, `samples` paths each, their noise smoothed away.
    #[must_use]
    pub fn surroundings(&self, height: usize, samples: u32, seed: u64) -> Surroundings {
        let width = 2 * height;
        let texels: Vec<Texel> = (0..width * height)
            .into_par_iter()
            .map(|i| self.texel(i % width, i / width, [width, height], samples, Rng::stream(seed, i as u64)))
            .collect();
        let reflected = smooth_irradiance(&texels, width, height);
        let plane = |channels: usize, of: &dyn Fn(usize) -> Vec3| {
            let data = (0..texels.len()).flat_map(|i| of(i).to_array()[..channels].to_vec()).collect();
            Image::from_data(width, height, channels, data)
        };
        Surroundings {
            radiance: plane(3, &|i| texels[i].emitted + reflected[i]),
            normal: plane(3, &|i| texels[i].normal),
            depth: plane(1, &|i| Vec3::splat(texels[i].depth)),
            seen: plane(1, &|i| Vec3::splat(f32::from(u8::from(texels[i].seen)))),
        }
    }

    fn texel(&self, x: usize, y: usize, size: [usize; 2], samples: u32, mut rng: Rng) -> Texel {
        let stream = rng.next_u32();
        let (mut emitted, mut reflected, mut albedo) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
        for sample in 0..samples {
            let mut numbers = Sequence::new(stream, sample);
            let [dx, dy] = numbers.next_2d();
            let d = equirect::direction((x as f32 + dx) / size[0] as f32, (y as f32 + dy) / size[1] as f32);
            let straight = self.world.intersect(self.centre, d).map_or_else(
                || self.world.environment().radiance(d),
                |surface| self.world.emission(&surface),
            );
            let path = path::trace(&self.world, self.centre, d, &mut numbers);
            emitted += straight;
            reflected += (path.radiance - straight).max(Vec3::ZERO);
            albedo += path.first.map_or(Vec3::ZERO, |first| first.brdf.albedo);
        }
        let d = equirect::texel_direction(x, y, size[0], size[1]);
        let (normal, depth) =
            self.world.intersect(self.centre, d).map_or((Vec3::ZERO, 0.0), |s| (s.normal, s.distance));
        let n = samples.max(1) as f32;
        Texel {
            emitted: emitted / n,
            reflected: reflected / n,
            albedo: albedo / n,
            point: d * depth,
            normal,
            depth,
            seen: self.seen(d, depth),
        }
    }

    /// Whether a camera sees what lies at `depth` (0 for the sky) along `d` from the centre.
    fn seen(&self, d: Vec3, depth: f32) -> bool {
        self.viewpoints.iter().any(|v| {
            let (to, distance) = if depth > 0.0 {
                let to = self.centre + d * depth - v.position;
                (to.normalize_or(d), to.length())
            } else {
                (d, f32::INFINITY)
            };
            let z = to.dot(v.forward);
            let up = v.right.cross(v.forward);
            z > 0.0
                && to.dot(v.right).abs() <= z * v.tangent[0]
                && to.dot(up).abs() <= z * v.tangent[1]
                && self.world.visible(v.position, to, distance * 0.998 - 1e-3)
        })
    }
}

struct Texel {
    /// Light straight from a lamp or the sky.
    emitted: Vec3,
    /// All other light, with the path tracer's noise.
    reflected: Vec3,
    albedo: Vec3,
    /// First surface, relative to the point.
    point: Vec3,
    normal: Vec3,
    depth: f32,
    seen: bool,
}

/// Steps between the taps of the four passes of the filter, texels.
const STRIDES: [isize; 4] = [1, 2, 4, 1];

/// Reflected light with the noise of few paths smoothed away: irradiance (reflected light over albedo) is averaged with
/// that of near texels on the same plane, in passes of growing stride (the à-trous filter of Dammertz et al. 2010).
/// Texels brighter than four times the median around them are first cut to that, which costs a little energy.
fn smooth_irradiance(texels: &[Texel], width: usize, height: usize) -> Vec<Vec3> {
    let albedo = |i: usize| texels[i].albedo.max(Vec3::splat(0.01));
    let mut irradiance: Vec<Vec3> = (0..texels.len()).map(|i| texels[i].reflected / albedo(i)).collect();
    let same_plane = |i: usize, j: usize| {
        let (a, b) = (&texels[i], &texels[j]);
        a.depth > 0.0
            && b.depth > 0.0
            && a.normal.dot(b.normal) > 0.95
            && (b.point - a.point).dot(a.normal).abs() < 0.03 * a.depth
    };
    let around = |i: usize, stride: isize| {
        let (x, y) = ((i % width) as isize, (i / width) as isize);
        (-2..=2isize).flat_map(move |v| (-2..=2isize).map(move |u| (u, v))).filter_map(move |(u, v)| {
            let row = y + v * stride;
            let column = (x + u * stride).rem_euclid(width as isize);
            let inside = (0..height as isize).contains(&row);
            inside.then_some((row as usize * width + column as usize, (-0.4 * (u * u + v * v) as f32).exp()))
        })
    };
    irradiance = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let mut levels: Vec<f32> = around(i, 1)
                .filter(|&(j, _)| j == i || same_plane(i, j))
                .map(|(j, _)| irradiance[j].max_element())
                .collect();
            levels.sort_by(f32::total_cmp);
            let limit = 4.0 * levels[levels.len() / 2];
            let own = irradiance[i].max_element();
            if levels.len() > 4 && own > limit { irradiance[i] * (limit / own) } else { irradiance[i] }
        })
        .collect();
    for stride in STRIDES {
        irradiance = (0..texels.len())
            .into_par_iter()
            .map(|i| {
                let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
                for (j, weight) in around(i, stride).filter(|&(j, _)| j == i || same_plane(i, j)) {
                    sum += irradiance[j] * weight;
                    weights += weight;
                }
                sum / weights
            })
            .collect();
    }
    (0..texels.len()).map(|i| irradiance[i] * albedo(i)).collect()
}

fn pick<T: Copy>(rng: &mut Rng, from: &[T]) -> T {
    from[rng.below(from.len())]
}

fn jittered(rng: &mut Rng, color: [f32; 3], by: f32) -> [f32; 3] {
    color.map(|c| (c * (1.0 + by * (2.0 * rng.uniform() - 1.0))).clamp(0.01, 0.92))
}

/// From 10^low to 10^high, evenly in the exponent.
fn decades(rng: &mut Rng, low: f32, high: f32) -> f32 {
    10f32.powf(rng.range(low, high))
}

/// White of lamps from incandescent to cold.
fn tint(rng: &mut Rng) -> Vec3 {
    let t = rng.uniform();
    let warm = Vec3::new(1.35, 0.95, 0.55);
    let cold = Vec3::new(0.9, 1.0, 1.12);
    warm.lerp(cold, t)
}

fn paint(rng: &mut Rng) -> Material {
    let walls = [
        [0.78, 0.76, 0.72],
        [0.7, 0.68, 0.62],
        [0.55, 0.5, 0.42],
        [0.42, 0.5, 0.52],
        [0.6, 0.42, 0.34],
        [0.32, 0.36, 0.3],
        [0.2, 0.2, 0.22],
    ];
    let color = pick(rng, &walls);
    Material::plain(jittered(rng, color, 0.15), rng.range(0.4, 0.9), 0.0).grainy(rng.range(0.0, 0.25), 0.2)
}

fn floor_material(rng: &mut Rng) -> Material {
    let tones = [
        [0.42, 0.28, 0.17],
        [0.24, 0.15, 0.09],
        [0.55, 0.5, 0.45],
        [0.3, 0.3, 0.31],
        [0.62, 0.56, 0.46],
        [0.2, 0.26, 0.16],
    ];
    let (a, b) = (pick(rng, &tones), pick(rng, &tones));
    let (a, b) = (jittered(rng, a, 0.2), jittered(rng, b, 0.2));
    let pattern = match rng.below(4) {
        0 => Pattern::Planks { width: 0.14, length: 1.4, gap: 0.006 },
        1 => Pattern::Tiles { size: [0.4, 0.4], gap: 0.01, shift: 0.0 },
        2 => Pattern::Noise { size: 0.5, contrast: 2.0 },
        _ => Pattern::Plain,
    };
    Material::mixed(a, b, rng.range(0.25, 0.9), pattern)
}

fn thing_material(rng: &mut Rng) -> Material {
    let hue = Vec3::new(rng.uniform(), rng.uniform(), rng.uniform());
    let grey = Vec3::splat(hue.dot(Vec3::splat(1.0 / 3.0)));
    let color = grey.lerp(hue, rng.range(0.2, 1.0)) * rng.range(0.1, 0.85);
    let metallic = if rng.uniform() < 0.08 { 1.0 } else { 0.0 };
    Material::plain(color.to_array().map(|c| c.clamp(0.02, 0.9)), rng.range(0.2, 0.9), metallic)
}

fn lamp_material(radiance: Vec3) -> Material {
    Material { emission: radiance.to_array(), ..Material::plain([0.7; 3], 0.8, 0.0) }
}

fn part(shape: &Shape, material: Material, at: [f32; 3], turn_deg: [f32; 3]) -> Part {
    let placement = Placement { at, turn_deg, scale: 1.0 }.similarity();
    Part { mesh: Arc::new(shape.mesh()), material, placement, inserted: false }
}

fn block(size: [f32; 3], material: Material, at: [f32; 3], yaw_deg: f32) -> Part {
    part(&Shape::Box { size, rounding: 0.0 }, material, at, [0.0, 0.0, yaw_deg])
}

/// A sky of any hour and weather. `sun` scales what its sun gives.
fn sky(rng: &mut Rng, sun: f32) -> Light {
    let overcast = rng.uniform() < 0.35;
    let elevation = if rng.uniform() < 0.3 { rng.range(1.0, 15.0) } else { rng.range(15.0, 75.0) };
    let low = (1.0 - elevation / 40.0).clamp(0.0, 1.0);
    let blue = if overcast { Vec3::new(0.75, 0.8, 0.88) } else { Vec3::new(0.22, 0.42, 0.85) };
    let rim = if overcast { Vec3::new(0.6, 0.63, 0.66) } else { Vec3::new(0.8, 0.88, 0.95) };
    let warm = Vec3::new(1.1, 0.75, 0.45);
    let level = rng.range(0.5, 1.5);
    let sun_level = if overcast { rng.range(0.0, 0.3) } else { decades(rng, -0.2, 0.9) };
    let sun_color = Vec3::new(1.05, 1.0, 0.92).lerp(Vec3::new(1.3, 0.85, 0.5), low);
    let ground = pick(rng, &[[0.12, 0.13, 0.08], [0.25, 0.22, 0.18], [0.3, 0.3, 0.3], [0.5, 0.48, 0.44]]);
    Light::Sky {
        zenith: (blue * level).to_array(),
        horizon: (rim.lerp(warm, 0.6 * low) * level * rng.range(0.8, 1.6)).to_array(),
        ground: ground.map(|c| c * level),
        sun_azimuth_deg: rng.range(0.0, 360.0),
        sun_elevation_deg: elevation,
        sun_radius_deg: rng.range(0.8, 2.2),
        sun_irradiance: (sun_color * sun_level * sun * level).to_array(),
        clouds: if overcast { rng.range(0.6, 1.0) } else { rng.range(0.0, 0.6) },
    }
}

/// Cameras that walk around the centre: an arc of a circle, all of it in half of the cases.
fn walk(rng: &mut Rng, centre: Vec3, inside: impl Fn(Vec3) -> Vec3) -> Vec<Viewpoint> {
    let count = 8 + rng.below(25);
    let arc = if rng.uniform() < 0.5 { 360.0 } else { rng.range(70.0, 300.0) };
    let start = rng.range(0.0, 360.0);
    let (radius, height) = (rng.range(0.7, 2.8), rng.range(0.3, 1.6));
    let tangent_x = (0.5 * rng.range(45.0, 85.0)).to_radians().tan();
    let tangent = [tangent_x, tangent_x * pick(rng, &[0.5625, 0.75, 1.0, 1.333])];
    let wander = rng.range(0.05, 0.5);
    // Some people also look around.
    let look_around = pick(rng, &[0.0, 0.0, 0.25, 0.5]);
    (0..count)
        .map(|i| {
            let azimuth = start + arc * (i as f32 + 0.5 * rng.uniform()) / count as f32;
            let out = direction(azimuth, 0.0) * radius * rng.range(0.85, 1.15);
            let position = inside(centre + out + Vec3::Z * (height + 0.15 * rng.normal()));
            let target = centre + wander * Vec3::new(rng.normal(), rng.normal(), 0.6 * rng.normal());
            let forward = if rng.uniform() < look_around {
                direction(rng.range(0.0, 360.0), rng.range(-20.0, 45.0))
            } else {
                (target - position).normalize_or(-out.normalize_or(Vec3::X))
            };
            Viewpoint { position, forward, right: forward.cross(Vec3::Z).normalize_or(Vec3::X), tangent }
        })
        .collect()
}

const WALL: f32 = 0.15;

/// A wall of `length × height` in its own plane, with a hole `[x0, x1, z0, z1]`, as boxes `[x, z, width, height]`.
fn around_hole(length: f32, height: f32, hole: Option<[f32; 4]>) -> Vec<[f32; 4]> {
    let Some([x0, x1, z0, z1]) = hole else { return vec![[0.0, 0.5 * height, length, height]] };
    let half = 0.5 * length;
    let piece = |a: f32, b: f32, c: f32, d: f32| [0.5 * (a + b), 0.5 * (c + d), b - a, d - c];
    [
        piece(-half, x0, 0.0, height),
        piece(x1, half, 0.0, height),
        piece(x0, x1, 0.0, z0),
        piece(x0, x1, z1, height),
    ]
    .into_iter()
    .filter(|p| p[2] > 0.0 && p[3] > 0.0)
    .collect()
}

fn room(rng: &mut Rng, seed: u64) -> Place {
    let (w, d, h) = (rng.range(3.0, 9.0), rng.range(3.0, 9.0), rng.range(2.3, 4.2));
    let mut parts = vec![block([w, d, WALL], floor_material(rng), [0.0, 0.0, -0.5 * WALL], 0.0)];
    let ceiling = if rng.uniform() < 0.8 { Material::plain([0.8; 3], 0.8, 0.0) } else { paint(rng) };
    parts.push(block([w + 1.0, d + 1.0, WALL], ceiling, [0.0, 0.0, h + 0.5 * WALL], 0.0));
    let main_paint = paint(rng);
    // Daylight, lamps, or both; at least one.
    let daylight = rng.uniform() < 0.7;
    let lamps = !daylight || rng.uniform() < 0.5;
    let mut windows = 0;
    for side in 0..4 {
        let (length, away) = if side % 2 == 0 { (d, 0.5 * w) } else { (w, 0.5 * d) };
        let yaw = 90.0 * side as f32;
        let last_chance = side == 3 && windows == 0;
        let hole = (daylight && (last_chance || rng.uniform() < 0.4)).then(|| {
            windows += 1;
            let width = rng.range(0.7, 0.8 * length);
            let x = rng.range(-0.5 * (length - width) + 0.05, 0.5 * (length - width) - 0.05);
            let sill = if rng.uniform() < 0.3 { 0.05 } else { rng.range(0.6, 1.1) };
            [x - 0.5 * width, x + 0.5 * width, sill, rng.range(sill + 0.5, h - 0.1)]
        });
        let material = if rng.uniform() < 0.8 { main_paint.clone() } else { paint(rng) };
        let out = direction(yaw, 0.0);
        let along = direction(yaw + 90.0, 0.0);
        let mut put = |[x, z, width, height]: [f32; 4], thick: f32, material: Material| {
            let at = out * (away + 0.5 * WALL) + along * x + Vec3::Z * z;
            parts.push(block([thick, width, height], material, at.to_array(), yaw));
        };
        for piece in around_hole(length + 2.0 * WALL, h, hole) {
            put(piece, WALL, material.clone());
        }
        if let Some([x0, x1, z0, z1]) = hole {
            for i in 1..=rng.below(4) {
                let x = x0 + (x1 - x0) * i as f32 / 4.0;
                put([x, 0.5 * (z0 + z1), 0.05, z1 - z0], 0.05, Material::plain([0.7; 3], 0.5, 0.0));
            }
        }
    }
    let centre = Vec3::new(rng.range(-0.3, 0.3) * w, rng.range(-0.3, 0.3) * d, rng.range(0.1, 0.9));
    if lamps {
        let level = decades(rng, 0.5, 1.9);
        let color = tint(rng);
        for _ in 0..1 + rng.below(5) {
            let (x, y) = (rng.range(-0.45, 0.45) * w, rng.range(-0.45, 0.45) * d);
            let material = lamp_material(color * level);
            if rng.uniform() < 0.7 {
                let size = [rng.range(0.08, 0.3), rng.range(0.08, 1.3)];
                let drop = if rng.uniform() < 0.5 { 0.02 } else { rng.range(0.1, 0.8) };
                parts.push(part(&Shape::Rectangle { size }, material, [x, y, h - drop], [180.0, 0.0, 0.0]));
            } else {
                let (size, z) = (rng.range(0.1, 0.3), rng.range(0.5, 1.8));
                let shade = lamp_material(color * level * 0.2);
                parts.push(block([size, size, size], shade, [x, y, z], rng.range(0.0, 90.0)));
                parts.push(block([0.03, 0.03, z], thing_material(rng), [x, y, 0.5 * z], 0.0));
            }
        }
    }
    for _ in 0..2 + rng.below(10) {
        let mut at = Vec3::new(rng.range(-0.46, 0.46) * w, rng.range(-0.46, 0.46) * d, 0.0);
        let size = [rng.range(0.2, 1.6), rng.range(0.2, 0.9), rng.range(0.3, 0.8 * h)];
        let clear = 0.5 * size[0].hypot(size[1]) + 0.35;
        if (at - centre).truncate().length() < clear {
            continue;
        }
        at.z = 0.5 * size[2];
        let yaw = if rng.uniform() < 0.7 { 90.0 * rng.below(4) as f32 } else { rng.range(0.0, 90.0) };
        parts.push(block(size, thing_material(rng), at.to_array(), yaw));
    }
    if centre.z > 0.4 {
        // The object's table.
        let top = [rng.range(0.7, 1.6), rng.range(0.7, 1.2), 0.04];
        let z = centre.z - rng.range(0.06, 0.3);
        parts.push(block(top, thing_material(rng), [centre.x, centre.y, z], rng.range(0.0, 90.0)));
    }
    let limit = Vec3::new(0.5 * w - 0.2, 0.5 * d - 0.2, h - 0.2);
    let viewpoints = walk(rng, centre, |p| p.clamp(Vec3::new(-limit.x, -limit.y, 0.3), limit));
    let outside = if daylight { sky(rng, 1.0) } else { Light::Constant { radiance: [0.004; 3] } };
    let map = outside.map(SKY_ROWS, seed).map(|v| v * if daylight { 3.0 } else { 1.0 });
    Place {
        kind: PlaceKind::Room,
        world: World::new(&parts, Environment::new(map), seed),
        centre,
        viewpoints,
    }
}

fn ground(rng: &mut Rng, seed: u64) -> Place {
    let mut parts =
        vec![part(&Shape::Rectangle { size: [120.0, 120.0] }, floor_material(rng), [0.0; 3], [0.0; 3])];
    let centre = Vec3::new(0.0, 0.0, rng.range(0.1, 0.9));
    let bricks = Material::mixed(
        [0.45, 0.24, 0.16],
        [0.6, 0.5, 0.42],
        0.8,
        Pattern::Noise { size: 1.5, contrast: 2.0 },
    );
    for _ in 0..rng.below(16) {
        let (azimuth, distance) = (rng.range(0.0, 360.0), rng.range(2.5, 30.0));
        let at = direction(azimuth, 0.0) * distance;
        let height = distance * rng.range(0.1, 1.0);
        if rng.uniform() < 0.5 {
            let size = [distance * rng.range(0.1, 0.8), distance * rng.range(0.1, 0.8), height];
            if 0.5 * size[0].hypot(size[1]) + 0.6 > distance {
                continue;
            }
            let material = if rng.uniform() < 0.5 { bricks.clone() } else { paint(rng) };
            parts.push(block(size, material, [at.x, at.y, 0.5 * height], rng.range(0.0, 90.0)));
        } else {
            let crown = (0.35 * height).min(0.4 * distance);
            let leaves = Material {
                b: Some(Finish { color: [0.3, 0.38, 0.12], roughness: 0.7, metallic: 0.0 }),
                pattern: Pattern::Noise { size: 0.3 * crown, contrast: 3.0 },
                ..Material::plain([0.05, 0.1, 0.03], 0.7, 0.0)
            };
            let trunk = Material::plain([0.2, 0.14, 0.09], 0.9, 0.0);
            parts.push(block([0.1 * crown, 0.1 * crown, height], trunk, [at.x, at.y, 0.5 * height], 0.0));
            for _ in 0..3 {
                let off = Vec3::new(rng.normal(), rng.normal(), rng.normal()) * 0.35 * crown;
                let at = at + Vec3::Z * height + off;
                let radius = crown * rng.range(0.5, 0.9);
                parts.push(part(&Shape::Sphere { radius }, leaves.clone(), at.to_array(), [0.0; 3]));
            }
        }
    }
    let viewpoints = walk(rng, centre, |p| Vec3::new(p.x, p.y, p.z.max(0.3)));
    let map = sky(rng, 1.0).map(SKY_ROWS, seed);
    Place {
        kind: PlaceKind::Ground,
        world: World::new(&parts, Environment::new(map), seed),
        centre,
        viewpoints,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the same seed gives the same bytes; every place is finite, lit, and seen in part but not whole by its
    /// cameras; normals face the point.
    #[test]
    fn places_are_sound() {
        for seed in 0..12 {
            let place = Place::from_seed(seed);
            let s = place.surroundings(16, 4, seed);
            assert_eq!(s, Place::from_seed(seed).surroundings(16, 4, seed), "seed {seed}");
            assert_eq!(s.radiance.non_finite(), 0);
            let sum: f32 = s.radiance.data.iter().sum();
            assert!(sum > 0.1, "seed {seed}: {sum}");
            let seen = s.seen.data.iter().sum::<f32>() / s.seen.pixels() as f32;
            assert!((0.02..=1.0).contains(&seen), "seed {seed}: {seen} seen");
            for i in 0..s.normal.pixels() {
                let (x, y) = (i % 32, i / 32);
                let n = Vec3::from(s.normal.rgb(x, y));
                let d = equirect::texel_direction(x, y, 32, 16);
                assert!(n == Vec3::ZERO || n.dot(d) < 1e-3, "seed {seed}: {n} along {d}");
            }
            if place.kind == PlaceKind::Room {
                let zenith = s.depth.data[..32].iter().all(|&v| v > 0.0);
                assert!(zenith, "seed {seed}: a room without a ceiling");
            }
        }
    }
}
