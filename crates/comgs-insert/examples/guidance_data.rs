//! Insertions under the right light and under a wrong one, for training the small guidance model (`scripts/insert`).
//!
//! ```text
//! cargo run --release -p comgs-insert --example guidance_data -- OUT FIRST COUNT [MAPS]
//! ```
//!
//! Every seed from FIRST on is a place: a ground, things on it, one more object, a camera. With MAPS, a folder of
//! environment maps, a place is what the camera sees of a map instead; every third map by name is taken, from the third on, so that
//! those that `insert-eval` takes (from the first) and those that were held out from the completer (from the second) stay unseen.
//! Transport is traced once a place; its pictures under 8 lights are products. `NNNNN.bin` holds planes of 64 × 64 bytes: the object's mask (1),
//! its normals (3, `128 + 127 n`) and its base colour (3, sRGB-coded), then for each light the photo without the object (3), the insertion under that light (3)
//! and under another (3), sRGB-coded. What is there already is left alone.

#[path = "../tests/support/mod.rs"]
mod support;

use comgs_geom::{Camera, Rng, equirect};
use comgs_image::Image;
use comgs_image::transfer::srgb8_from_linear;
use comgs_insert::composite::{Crop, composite};
use comgs_insert::light::{Gaussian, Gaussians, LightMap};
use comgs_insert::tone::{Curves, Response, Tone};
use comgs_insert::transport::{
    Foreground, ForegroundConfig, Shadow, ShadowConfig, trace_foreground, trace_shadow,
};
use comgs_light::EnvironmentMap;
use comgs_synth::recipe::PartRecipe;
use comgs_synth::shape::Shape;
use glam::{DVec3, Vec3};
use std::f32::consts::TAU;
use std::path::{Path, PathBuf};
use support::{object, part};

const SIZE: usize = 64;
const HEIGHT: usize = 16;
const LIGHTS: usize = 8;

fn color(rng: &mut Rng) -> [f32; 3] {
    let grey = rng.range(0.08, 0.85);
    std::array::from_fn(|_| (grey * rng.range(0.55, 1.3)).clamp(0.03, 0.92))
}

fn thing(rng: &mut Rng, at: [f32; 2], scale: f32) -> PartRecipe {
    let s = scale * rng.range(0.6, 1.0);
    let (shape, z) = match rng.below(4) {
        0 => (Shape::Sphere { radius: 0.5 * s }, 0.5 * s),
        1 => {
            let h = s * rng.range(0.6, 1.4);
            (Shape::Box { size: [0.8 * s, s * rng.range(0.4, 0.9), h], rounding: 0.03 * s }, 0.5 * h)
        }
        2 => {
            let h = s * rng.range(0.6, 1.4);
            (Shape::Cylinder { radius: 0.3 * s, height: h }, 0.5 * h)
        }
        _ => {
            let knot =
                Shape::TorusKnot { turns: 2, twists: 3, radius: 0.4 * s, swing: 0.17 * s, tube: 0.11 * s };
            (knot, 0.65 * s)
        }
    };
    let metal = rng.uniform() < 0.2;
    let roughness = rng.range(0.25, 0.95);
    let mut p = part(shape, [at[0], at[1], z], color(rng), roughness, f32::from(u8::from(metal)));
    p.placement.turn_deg[2] = rng.range(0.0, 360.0);
    p
}

/// A sky, light from below, and mostly a sun.
fn light(rng: &mut Rng) -> LightMap {
    let sky = rng.range(0.15, 0.6);
    let tint = rng.range(0.0, 0.4);
    let lobe = |radiance: Vec3, direction: Vec3, sigma: f32| Gaussian { radiance, direction, sigma };
    let mut lobes = vec![
        lobe(sky * Vec3::new(1.0 - 0.5 * tint, 1.0, 1.0 + tint), Vec3::Z, rng.range(0.8, 1.4)),
        lobe(sky * rng.range(0.2, 0.8) * Vec3::new(1.0, 0.95, 0.85), -Vec3::Z, 1.2),
    ];
    if rng.uniform() < 0.85 {
        let (sin, cos) = rng.range(0.2, 1.35).sin_cos();
        let azimuth = rng.range(0.0, TAU);
        let direction = Vec3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
        let sigma = rng.range(0.1, 0.3);
        // Irradiance of two to twelve times the sky's.
        let strength = sky * rng.range(2.0, 12.0) / (2.0 * sigma * sigma);
        let warm = rng.range(0.0, 0.4);
        lobes.push(lobe(strength * Vec3::new(1.0, 1.0 - 0.4 * warm, 1.0 - warm), direction, sigma));
    }
    Gaussians::new(HEIGHT, &lobes).rasterise()
}

/// One thing or several, traced.
struct Traced {
    foreground: Foreground,
    shadow: Shadow,
}

impl Traced {
    fn new(parts: &[PartRecipe], camera: &Camera, seed: u64) -> Self {
        let object = object(parts);
        let config =
            ForegroundConfig { height: HEIGHT, grid: 3, depth: 2, seed, ..ForegroundConfig::default() };
        let foreground = trace_foreground(&object, camera, &config, |_| true).expect("not stopped");
        let config = ShadowConfig { height: HEIGHT, samples: 3, seed };
        let shadow =
            trace_shadow(&object, camera, &foreground.coverage.data, &config, |_| true).expect("not stopped");
        Self { foreground, shadow }
    }

    fn insert(&self, photo: &Image, lights: [&LightMap; 2], curves: &Curves) -> Image {
        let radiance = self.foreground.matrix.times(lights[0], |_| true);
        let beta = self.shadow.ratios(lights[1], |_| true).beta;
        let crop = Crop::whole(photo);
        composite(photo, &self.foreground, &self.shadow, &radiance, &beta, curves, crop)
    }
}

/// Sky and ground, before exposure.
fn backdrop(camera: &Camera, light: &LightMap, ground: [[f32; 3]; 2], scale: f32, shadow: &Shadow) -> Image {
    let irradiance = shadow.ratios(light, |_| false).irradiance;
    let environment = light.to_environment();
    let mut out = Image::zeros(SIZE, SIZE, 3);
    for y in 0..SIZE {
        for x in 0..SIZE {
            let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            let value = if ray.z < -1e-6 {
                let p = camera.centre() - ray * (camera.centre().z / ray.z);
                let tile = ((p.x as f32 / scale).floor() + (p.y as f32 / scale).floor()) as i64;
                let albedo = ground[tile.rem_euclid(2) as usize];
                std::array::from_fn(|c| albedo[c] * irradiance[c] / std::f32::consts::PI)
            } else {
                environment.lookup(ray.as_vec3().normalize()).to_array()
            };
            out.pixel_mut(x, y).copy_from_slice(&value);
        }
    }
    out
}

fn planes(image: &Image, code: impl Fn(f32) -> u8, out: &mut Vec<u8>) {
    for c in 0..image.channels {
        out.extend(image.data.iter().skip(c).step_by(image.channels).map(|v| code(*v)));
    }
}

/// Exposed by the 90 % quantile of its luminance, as a camera would; the factor, and the picture cut off at white.
fn exposed(bare: &Image, rng: &mut Rng) -> (f32, Image) {
    let mut sorted: Vec<f32> =
        bare.data.chunks_exact(3).map(|p| comgs_light::luminance(Vec3::from_slice(p))).collect();
    sorted.sort_by(f32::total_cmp);
    let exposure = rng.range(0.4, 0.9) / sorted[sorted.len() * 9 / 10].max(1e-6);
    (exposure, bare.map(|v| (v * exposure).min(1.0)))
}

/// What a camera sees of a map, 2 × 2 looks a pixel.
fn seen(map: &EnvironmentMap, camera: &Camera) -> Image {
    let mut out = Image::zeros(SIZE, SIZE, 3);
    for y in 0..SIZE {
        for x in 0..SIZE {
            let looks = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)];
            let ray = |(dx, dy): (f64, f64)| camera.ray_world(x as f64 + dx, y as f64 + dy).as_vec3();
            let sum: Vec3 = looks.map(|l| map.lookup(ray(l).normalize())).into_iter().sum();
            out.pixel_mut(x, y).copy_from_slice(&(0.25 * sum).to_array());
        }
    }
    out
}

/// A map, turned as it is, as light of [`HEIGHT`] rows.
fn reduced(map: &EnvironmentMap) -> LightMap {
    let (w, h) = (16 * HEIGHT, 8 * HEIGHT);
    let mut image = Image::zeros(w, h, 3);
    for y in 0..h {
        for x in 0..w {
            let value = map.lookup(equirect::texel_direction(x, y, w, h));
            image.pixel_mut(x, y).copy_from_slice(&value.to_array());
        }
    }
    LightMap::from_image(&image, HEIGHT).expect("a map was read")
}

/// A wrong light as bright as the right one up to a factor of two, and which of object and shadow it lights.
fn mistaken<'a>(wrong: &'a mut LightMap, right: &'a LightMap, rng: &mut Rng) -> [&'a LightMap; 2] {
    let sum = |m: &LightMap| m.data.iter().sum::<f32>();
    let level = sum(right) / sum(wrong).max(1e-9) * rng.range(-0.7, 0.7f32).exp();
    wrong.data.iter_mut().for_each(|v| *v *= level);
    match rng.below(4) {
        0 => [wrong, right],
        1 => [right, wrong],
        _ => [wrong, wrong],
    }
}

/// Camera, and the object that is inserted, traced.
fn scene(rng: &mut Rng, seed: u64) -> (Camera, [f32; 2], Traced) {
    let at = [rng.range(-0.4, 0.4), rng.range(-0.5, 0.5)];
    let distance = rng.range(2.0, 4.2);
    let eye = DVec3::new(f64::from(-distance), 0.0, f64::from(rng.range(0.8, 2.2)));
    let target = DVec3::new(0.0, f64::from(rng.range(-0.4, 0.4)), f64::from(rng.range(0.2, 0.8)));
    let camera = Camera::look_at("photo", SIZE, SIZE, f64::from(rng.range(0.5, 0.9)), eye, target, DVec3::Z);
    let inserted = Traced::new(&[thing(rng, at, 1.0)], &camera, seed);
    (camera, at, inserted)
}

/// The planes that all lights share.
fn outline(inserted: &Traced) -> Vec<u8> {
    let mut out = Vec::new();
    planes(&inserted.foreground.coverage, |v| (255.0 * v) as u8, &mut out);
    planes(&inserted.foreground.normal, |v| (128.0 + 127.0 * v) as u8, &mut out);
    planes(&inserted.foreground.albedo, srgb8_from_linear, &mut out);
    out
}

/// The planes of one light.
fn pictures(photo: &Image, inserted: &Traced, right: &LightMap, pair: [&LightMap; 2], out: &mut Vec<u8>) {
    let clip = Tone::identity(Response::Clip).curves();
    planes(photo, srgb8_from_linear, out);
    planes(&inserted.insert(photo, [right, right], &clip), srgb8_from_linear, out);
    planes(&inserted.insert(photo, pair, &clip), srgb8_from_linear, out);
}

/// A made-up place.
fn place(seed: u64) -> Vec<u8> {
    let mut rng = Rng::stream(seed, 0x6775_6964);
    let (camera, at, inserted) = scene(&mut rng, seed);
    let mut things = Vec::new();
    while things.len() < 2 + seed as usize % 3 {
        let spot = [rng.range(-0.9, 3.5), rng.range(-2.2, 2.2)];
        // Beside the object and behind it, never in it.
        if (spot[0] - at[0]).hypot(spot[1] - at[1]) > 1.1 {
            things.push(thing(&mut rng, spot, 1.1));
        }
    }
    let around = Traced::new(&things, &camera, seed + 1);
    let first = color(&mut rng);
    let contrast = rng.range(0.6, 1.0);
    let ground = [first, first.map(|v| v * contrast)];
    let tiles = rng.range(0.3, 1.5);
    let clip = Tone::identity(Response::Clip).curves();
    let mut out = outline(&inserted);
    for _ in 0..LIGHTS {
        let mut right = light(&mut rng);
        let bare = backdrop(&camera, &right, ground, tiles, &around.shadow);
        let (exposure, bare) = exposed(&bare, &mut rng);
        right.data.iter_mut().for_each(|v| *v *= exposure);
        let photo = around.insert(&bare, [&right, &right], &clip);
        let mut wrong = light(&mut rng);
        let pair = mistaken(&mut wrong, &right, &mut rng);
        pictures(&photo, &inserted, &right, pair, &mut out);
    }
    out
}

/// A place that was photographed.
fn photographed(seed: u64, maps: &[EnvironmentMap]) -> Vec<u8> {
    let mut rng = Rng::stream(seed, 0x6d61_7073);
    let (camera, _, inserted) = scene(&mut rng, seed);
    let mut out = outline(&inserted);
    let any = |rng: &mut Rng| {
        let map = &maps[rng.below(maps.len())];
        map.turned(rng.range(0.0, TAU))
    };
    for _ in 0..LIGHTS {
        let map = any(&mut rng);
        let (exposure, photo) = exposed(&seen(&map, &camera), &mut rng);
        let right = reduced(&map.scaled(exposure));
        let mut wrong = match rng.below(5) {
            0 => LightMap::from_image(&Image::filled(2 * HEIGHT, HEIGHT, 3, 0.3), HEIGHT).expect("a map"),
            1 | 2 => light(&mut rng),
            _ => reduced(&any(&mut rng)),
        };
        let pair = mistaken(&mut wrong, &right, &mut rng);
        pictures(&photo, &inserted, &right, pair, &mut out);
    }
    out
}

/// Every third map of a folder, from the third on.
fn read_maps(folder: &str) -> Result<Vec<EnvironmentMap>, Box<dyn std::error::Error>> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<std::io::Result<_>>()?;
    files.retain(|f| f.extension().is_some_and(|e| e == "exr" || e == "hdr"));
    files.sort();
    let read = |file: &PathBuf| -> Result<EnvironmentMap, Box<dyn std::error::Error>> {
        Ok(EnvironmentMap::from_image_repaired(&comgs_image::read(file)?.color)?.0)
    };
    let maps: Vec<EnvironmentMap> = files.iter().skip(2).step_by(3).map(read).collect::<Result<_, _>>()?;
    if maps.is_empty() { Err(format!("{folder}: expected at least three maps").into()) } else { Ok(maps) }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, first, count, rest @ ..] = arguments.as_slice() else {
        return Err("usage: guidance_data OUT FIRST COUNT [MAPS]".into());
    };
    let (first, count): (u64, u64) = (first.parse()?, count.parse()?);
    let maps = rest.first().map(|folder| read_maps(folder)).transpose()?;
    std::fs::create_dir_all(out)?;
    for seed in first..first + count {
        let path = Path::new(out).join(format!("{seed:05}.bin"));
        if !path.exists() {
            let planes = maps.as_ref().map_or_else(|| place(seed), |maps| photographed(seed, maps));
            comgs_image::atomic::write_file(&path, |w| w.write_all(&planes))?;
        }
    }
    Ok(())
}
