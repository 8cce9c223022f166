//! The object's radiance as a matrix (DiPIR Eq. 4).

use super::{Grid, Matrix};
use crate::light::LightMap;
use crate::object::{Object, Surface};
use comgs_geom::{Camera, Rng};
use comgs_image::Image;
use comgs_light::Shading;
use glam::Vec3;
use rayon::prelude::*;

/// How the matrix is traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForegroundConfig {
    /// Rows of the map, even.
    pub height: usize,
    /// Camera rays a pixel along each side.
    pub grid: usize,
    /// BSDF samples a pixel, beside one sample a texel.
    pub bsdf_samples: usize,
    /// Interactions along a path, D of Eq. 4: 1 is direct light.
    pub depth: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for ForegroundConfig {
    /// Three interactions; 4×4 camera rays, which cost little, because the texels are dealt out among them, and without which
    /// silhouettes and highlights are noise; 32 BSDF samples beside the 2048 of a map of 32 rows.
    fn default() -> Self {
        Self { height: 32, grid: 4, bsdf_samples: 32, depth: 3, seed: 0 }
    }
}

/// The object as the camera sees it, and the matrix from the map to its radiance.
#[derive(Clone, Debug)]
pub struct Foreground {
    /// Indices (row-major) of the pixels that show the object; the matrix' rows in this order.
    pub pixels: Vec<u32>,
    /// Share of a pixel that is the object, V of Eq. 6 (1 channel, whole image).
    pub coverage: Image,
    /// Mean base colour where covered, straight (3 channels).
    pub albedo: Image,
    /// Mean shading normal where covered, unit, world (3 channels).
    pub normal: Image,
    /// z-depth where covered, 0 elsewhere (1 channel).
    pub depth: Image,
    /// Radiance of the covered part of a pixel, straight, by texel.
    pub matrix: Matrix,
}

/// A camera ray of a pixel that met the object.
pub(crate) struct Seen {
    pub surface: Surface,
    /// Towards the camera.
    pub view: Vec3,
    /// Share of the pixel's covered part.
    pub weight: f32,
}

/// What a camera sees of an object: everything of [`Foreground`] but the matrix.
struct Visible {
    pixels: Vec<u32>,
    coverage: Image,
    albedo: Image,
    normal: Image,
    depth: Image,
}

fn camera_ray(camera: &Camera, x: f64, y: f64) -> (Vec3, Vec3) {
    (camera.centre().as_vec3(), camera.ray_world(x, y).normalize().as_vec3())
}

/// The surfaces of a pixel through `grid²` jittered camera rays, and the share of the pixel that they cover. The rays
/// depend on the seed and the pixel alone, so both passes see the same.
pub(crate) fn look(
    object: &Object,
    camera: &Camera,
    pixel: usize,
    grid: usize,
    seed: u64,
) -> (Vec<Seen>, f32) {
    let mut rng = Rng::stream(seed, pixel as u64);
    let (x, y) = (pixel % camera.width, pixel / camera.width);
    let mut seen = Vec::with_capacity(grid * grid);
    let mut covered = 0.0;
    for k in 0..grid * grid {
        let jitter = |cell: usize, u: f32| (cell as f64 + f64::from(u)) / grid as f64;
        let (dx, dy) = (jitter(k % grid, rng.uniform()), jitter(k / grid, rng.uniform()));
        let (origin, direction) = camera_ray(camera, x as f64 + dx, y as f64 + dy);
        if !object.may_meet(origin, direction, 0.0) {
            continue;
        }
        if let Some(surface) = object.surface(origin, direction) {
            covered += surface.coverage;
            seen.push(Seen { surface, view: -direction, weight: surface.coverage });
        }
    }
    seen.iter_mut().for_each(|s| s.weight /= covered);
    (seen, covered / (grid * grid) as f32)
}

fn visible(object: &Object, camera: &Camera, grid: usize, seed: u64) -> Visible {
    let (w, h) = (camera.width, camera.height);
    // Coverage, albedo, normal, depth.
    let mut data = vec![0.0f32; w * h * 8];
    data.par_chunks_mut(8).enumerate().for_each(|(pixel, out)| {
        let (seen, coverage) = look(object, camera, pixel, grid, seed);
        if coverage == 0.0 {
            return;
        }
        let sum = |f: &dyn Fn(&Seen) -> Vec3| seen.iter().map(|s| f(s) * s.weight).sum::<Vec3>();
        let albedo = sum(&|s| s.surface.material.albedo);
        let normal = sum(&|s| s.surface.normal).normalize_or_zero();
        let z = camera.forward().as_vec3();
        let depth = sum(&|s| Vec3::splat(-s.view.dot(z) * s.surface.distance)).x;
        out[0] = coverage;
        out[1..4].copy_from_slice(&albedo.to_array());
        out[4..7].copy_from_slice(&normal.to_array());
        out[7] = depth;
    });
    let all = Image::from_data(w, h, 8, data);
    let coverage = all.select(&[0]);
    let pixels = (0..w * h).filter(|&i| coverage.data[i] > 0.0).map(|i| i as u32).collect();
    Visible {
        pixels,
        coverage,
        albedo: all.select(&[1, 2, 3]),
        normal: all.select(&[4, 5, 6]),
        depth: all.select(&[7]),
    }
}

/// How many pixels show the object: what the matrix' memory is in proportion to.
#[must_use]
pub fn count_pixels(object: &Object, camera: &Camera, config: &ForegroundConfig) -> usize {
    visible(object, camera, config.grid, config.seed).pixels.len()
}

/// Traces the matrix. `check` is asked with numbers of pixels done, in any order, and stops the work (`None`) when it
/// says `false`.
///
/// A pixel's radiance is estimated by one direction in every texel, each at one of the pixel's surface points, and by
/// samples of the BSDF, joined by the balance heuristic (Veach & Guibas 1995): both add
///
/// ```text
/// f cos θ / (1/(k Ω) + n p_BSDF(ω))      to the texel that ω falls into,
/// ```
///
/// where Ω is the texel's solid angle, k the number of points and n the BSDF samples at the point. A light of any size is
/// therefore met by every pixel, whatever the map turns out to be, and a mirror still finds its texels. Paths that meet
/// the object again go on to `depth` interactions; there each takes every n-th texel. Light below the plane is
/// light from below: the plane is no part of this (Eq. 4).
pub fn trace_foreground(
    object: &Object,
    camera: &Camera,
    config: &ForegroundConfig,
    check: impl Fn(usize) -> bool + Sync,
) -> Option<Foreground> {
    assert!(config.height.is_multiple_of(2) && config.grid > 0 && config.depth > 0);
    let grid = Grid::new(config.height);
    let v = visible(object, camera, config.grid, config.seed);
    let fill = |row: usize, dense: &mut [f32], constant: &mut [f32; 3]| {
        let pixel = v.pixels[row] as usize;
        let (seen, _) = look(object, camera, pixel, config.grid, config.seed);
        let rng = Rng::stream(config.seed ^ TRANSPORT_STREAM, pixel as u64);
        let mut walk = Walk { object, grid: &grid, config, rng, dense, constant: Vec3::ZERO };
        walk.pixel(&seen);
        *constant = walk.constant.to_array();
    };
    let matrix = Matrix::build(v.pixels.len(), config.height, 3, fill, check)?;
    let Visible { pixels, coverage, albedo, normal, depth } = v;
    Some(Foreground { pixels, coverage, albedo, normal, depth, matrix })
}

/// Sets the random numbers of light apart from those of camera rays.
const TRANSPORT_STREAM: u64 = 0x7472_616e_7370_6f72;

struct Walk<'a> {
    object: &'a Object,
    grid: &'a Grid,
    config: &'a ForegroundConfig,
    rng: Rng,
    dense: &'a mut [f32],
    constant: Vec3,
}

impl Walk<'_> {
    fn pixel(&mut self, seen: &[Seen]) {
        let k = seen.len();
        let n = self.config.bsdf_samples.div_ceil(k);
        let shadings: Vec<Shading> =
            seen.iter().map(|s| Shading::new(s.surface.material, s.surface.normal, s.view)).collect();
        for s in seen {
            self.constant += s.surface.emission * s.weight;
        }
        // Texels are dealt to the points in turn, from a random first one on each row.
        let mut turn = 0;
        for texel in 0..self.grid.texels() {
            if texel % self.grid.width == 0 {
                turn = self.rng.below(k);
            }
            turn = if turn + 1 == k { 0 } else { turn + 1 };
            let at = &seen[turn];
            let light = Density { texels: 1.0 / k as f32, bsdf: n as f32 };
            self.texel(texel, &at.surface, &shadings[turn], Vec3::splat(at.weight), light);
        }
        for (s, shading) in seen.iter().zip(&shadings) {
            let density = Density { texels: 1.0 / k as f32, bsdf: n as f32 };
            for _ in 0..n {
                self.bsdf(&s.surface, shading, Vec3::splat(s.weight), density, 1);
            }
        }
    }

    /// One direction in a texel.
    fn texel(&mut self, texel: usize, at: &Surface, shading: &Shading, throughput: Vec3, density: Density) {
        let direction = self.grid.inside(texel, &mut self.rng);
        if direction.dot(at.face_normal) <= 0.0 {
            return;
        }
        let f = shading.eval_cosine(direction);
        if f == Vec3::ZERO {
            return;
        }
        let passed = self.object.transmittance(self.object.leave(at), direction);
        if passed > 0.0 {
            self.add(texel, throughput * f * (passed / self.density(texel, direction, shading, density)));
        }
    }

    /// One direction of the BSDF, and where it meets the object again, the path from there.
    fn bsdf(&mut self, at: &Surface, shading: &Shading, throughput: Vec3, density: Density, depth: usize) {
        let choice = self.rng.uniform();
        let u = glam::Vec2::new(self.rng.uniform(), self.rng.uniform());
        let Some(direction) = shading.sample(choice, u) else { return };
        if direction.dot(at.face_normal) <= 0.0 {
            return;
        }
        let f = shading.eval_cosine(direction);
        let origin = self.object.leave(at);
        let hit = self.object.surface(origin, direction);
        let passed = 1.0 - hit.map_or(0.0, |s| s.coverage);
        if passed > 0.0 {
            let texel = self.grid.texel_of(direction);
            self.add(texel, throughput * f * (passed / self.density(texel, direction, shading, density)));
        }
        let Some(next) = hit else { return };
        // Only the BSDF finds the object: no second way to weigh against.
        let throughput = throughput * f * (next.coverage / (density.bsdf * shading.pdf(direction)));
        self.constant += throughput * next.emission;
        if depth < self.config.depth {
            self.vertex(&next, -direction, throughput, depth + 1);
        }
    }

    /// A further point of a path: every n-th texel, and one BSDF sample.
    fn vertex(&mut self, at: &Surface, view: Vec3, throughput: Vec3, depth: usize) {
        let stride = self.config.bsdf_samples.max(1);
        let shading = Shading::new(at.material, at.normal, view);
        let density = Density { texels: 1.0 / stride as f32, bsdf: 1.0 };
        let mut texel = self.rng.below(stride);
        while texel < self.grid.texels() {
            self.texel(texel, at, &shading, throughput, density);
            texel += stride;
        }
        self.bsdf(at, &shading, throughput, density, depth);
    }

    /// Samples a steradian in a direction, of both kinds together.
    fn density(&self, texel: usize, direction: Vec3, shading: &Shading, density: Density) -> f32 {
        density.texels / self.grid.omega[texel / self.grid.width] + density.bsdf * shading.pdf(direction)
    }

    fn add(&mut self, texel: usize, value: Vec3) {
        let n = self.grid.texels();
        for c in 0..3 {
            self.dense[c * n + texel] += value[c];
        }
    }
}

/// How many samples a point takes: a texel's worth of directions, and of the BSDF.
#[derive(Clone, Copy)]
struct Density {
    texels: f32,
    bsdf: f32,
}

impl Foreground {
    /// Radiance of the object under a map, straight, 0 where it is not (3 channels).
    #[must_use]
    pub fn radiance(&self, map: &LightMap) -> Image {
        self.spread(&self.matrix.times(map, |_| true))
    }

    /// Values by row as an image.
    #[must_use]
    pub fn spread(&self, rows: &[[f32; 3]]) -> Image {
        let mut out = Image::zeros(self.coverage.width, self.coverage.height, 3);
        for (&pixel, value) in self.pixels.iter().zip(rows) {
            out.data[3 * pixel as usize..3 * pixel as usize + 3].copy_from_slice(value);
        }
        out
    }
}
