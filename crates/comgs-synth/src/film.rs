//! Cameras and panoramas: many paths a pixel, box filter, ground-truth planes beside the colour.

use crate::path;
use crate::sequence::Sequence;
use crate::world::World;
use comgs_geom::{Camera, Rng, equirect};
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;

/// A rendered view. All planes have the camera's size.
#[derive(Clone, Debug)]
pub struct Film {
    /// Mean linear radiance of all samples, environment included: the picture of a scene (3 channels).
    pub color: Image,
    /// Mean radiance of the samples that hit a surface, divided by coverage: the straight colour of an object
    /// (3 channels, 0 where coverage is at most 1/255).
    pub straight: Image,
    /// Share of the samples that hit a surface (1 channel).
    pub coverage: Image,
    /// Share of the samples that hit an inserted object (1 channel).
    pub mask: Image,
    /// Mean base colour of the samples that hit (3 channels, straight).
    pub albedo: Image,
    /// Mean shading normal of the samples that hit, unit, world space, facing the viewer; 0 where nothing was hit.
    pub normal: Image,
    /// z-depth through the pixel's centre, not antialiased; 0 where nothing is there (1 channel).
    pub depth: Image,
    /// Mean roughness of the samples that hit (1 channel, straight).
    pub roughness: Image,
    /// Mean metalness of the samples that hit (1 channel, straight).
    pub metallic: Image,
}

/// Values a pixel: colour, straight colour, coverage, mask, albedo, normal, depth, roughness, metallic.
const CHANNELS: usize = 3 + 3 + 1 + 1 + 3 + 3 + 1 + 1 + 1;

/// Coverage up to which a pixel counts as empty: half a code value would round to 0, a whole one is the data's own limit.
const EMPTY: f32 = 1.0 / 255.0;

/// Renders a view with `samples` paths a pixel. Same seed, same picture, at any thread count.
#[must_use]
pub fn render(world: &World, camera: &Camera, samples: u32, seed: u64) -> Film {
    let (width, height) = (camera.width, camera.height);
    let mut data = vec![0.0f32; width * height * CHANNELS];
    data.par_chunks_mut(CHANNELS).enumerate().for_each(|(i, out)| {
        out.copy_from_slice(&pixel(world, camera, i % width, i / width, samples, seed));
    });
    let all = Image::from_data(width, height, CHANNELS, data);
    Film {
        color: all.select(&[0, 1, 2]),
        straight: all.select(&[3, 4, 5]),
        coverage: all.select(&[6]),
        mask: all.select(&[7]),
        albedo: all.select(&[8, 9, 10]),
        normal: all.select(&[11, 12, 13]),
        depth: all.select(&[14]),
        roughness: all.select(&[15]),
        metallic: all.select(&[16]),
    }
}

fn pixel(world: &World, camera: &Camera, x: usize, y: usize, samples: u32, seed: u64) -> [f32; CHANNELS] {
    let origin = camera.centre().as_vec3();
    let stream = Rng::stream(seed, (y * camera.width + x) as u64).next_u32();
    let (mut color, mut surface, mut albedo, mut normal) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
    let (mut hits, mut inserted, mut roughness, mut metallic) = (0u32, 0u32, 0.0, 0.0);
    for sample in 0..samples {
        let mut numbers = Sequence::new(stream, sample);
        let [dx, dy] = numbers.next_2d();
        let ray = camera.ray_world(x as f64 + f64::from(dx), y as f64 + f64::from(dy));
        let found = path::trace(world, origin, ray.normalize().as_vec3(), &mut numbers);
        color += found.radiance;
        if let Some(first) = found.first {
            hits += 1;
            inserted += u32::from(first.inserted);
            surface += found.radiance;
            albedo += first.brdf.albedo;
            normal += first.normal;
            roughness += first.brdf.roughness;
            metallic += first.brdf.metallic;
        }
    }
    let centre = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
    let depth = world
        .intersect(origin, centre.normalize().as_vec3())
        // The ray with z = 1 has the length by which a distance is longer than its depth.
        .map_or(0.0, |s| s.distance / centre.length() as f32);

    let n = samples as f32;
    let coverage = hits as f32 / n;
    let per_hit = if coverage > EMPTY { 1.0 / hits as f32 } else { 0.0 };
    let mut out = [0.0; CHANNELS];
    let mut at = 0;
    let mut put = |values: &[f32]| {
        out[at..at + values.len()].copy_from_slice(values);
        at += values.len();
    };
    put(&(color / n).to_array());
    put(&(surface * per_hit).to_array());
    put(&[coverage, inserted as f32 / n]);
    put(&(albedo * per_hit).to_array());
    put(&if per_hit > 0.0 { normal.normalize_or_zero() } else { Vec3::ZERO }.to_array());
    put(&[depth, roughness * per_hit, metallic * per_hit]);
    out
}

/// The radiance that arrives at a point from all around: an equirectangular map of `2·height × height` texels.
#[must_use]
pub fn panorama(world: &World, centre: Vec3, height: usize, samples: u32, seed: u64) -> Image {
    let width = 2 * height;
    let mut image = Image::zeros(width, height, 3);
    image.data.par_chunks_mut(3).enumerate().for_each(|(i, out)| {
        let (x, y) = (i % width, i / width);
        let stream = Rng::stream(seed, i as u64).next_u32();
        let mut sum = Vec3::ZERO;
        for sample in 0..samples {
            let mut numbers = Sequence::new(stream, sample);
            let [dx, dy] = numbers.next_2d();
            let direction =
                equirect::direction((x as f32 + dx) / width as f32, (y as f32 + dy) / height as f32);
            sum += path::trace(world, centre, direction, &mut numbers).radiance;
        }
        out.copy_from_slice(&(sum / samples as f32).to_array());
    });
    image
}

/// A picture's straight colour and coverage as one image of four channels.
#[must_use]
pub fn with_alpha(color: &Image, coverage: &Image) -> Image {
    let data =
        color.data.chunks_exact(3).zip(&coverage.data).flat_map(|(c, &a)| [c[0], c[1], c[2], a]).collect();
    Image::from_data(color.width, color.height, 4, data)
}
