//! The object's radiance as a matrix (DiPIR Eq. 4).

use super::{Grid, Matrix};
use crate::light::LightMap;
use crate::object::{Object, Surface};
use comgs_geom::{Camera, Rng};
use comgs_image::Image;
use comgs_light::{Material, Shading};
use glam::Vec3;
use rayon::prelude::*;

/// How the matrix is traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForegroundConfig {
    /// Rows of the map, even.
    pub height: usize,
    /// Camera rays a pixel along each side.
    pub grid: usize,
    /// Directions in every texel a pixel.
    pub texel_samples: usize,
    /// BSDF samples a pixel, beside those in the texels.
    pub bsdf_samples: usize,
    /// Interactions along a path, D of Eq. 4: 1 is direct light.
    pub depth: usize,
    /// Seed.
    pub seed: u64,
    /// Other light paths behind the same camera rays.
    pub stream: u64,
}

impl Default for ForegroundConfig {
    /// Three interactions; 4×4 camera rays, which cost little, because the texels are dealt out among them, and without which
    /// silhouettes and highlights are noise; 32 BSDF samples beside the 2048 of a map of 32 rows.
    fn default() -> Self {
        Self { height: 32, grid: 4, texel_samples: 1, bsdf_samples: 32, depth: 3, seed: 0, stream: 0 }
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
pub(super) struct Visible {
    pub pixels: Vec<u32>,
    coverage: Image,
    albedo: Image,
    normal: Image,
    depth: Image,
}

impl Visible {
    pub fn with(self, matrix: Matrix) -> Foreground {
        let Self { pixels, coverage, albedo, normal, depth } = self;
        Foreground { pixels, coverage, albedo, normal, depth, matrix }
    }
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

pub(super) fn visible(object: &Object, camera: &Camera, grid: usize, seed: u64) -> Visible {
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
/// A pixel's radiance is estimated by directions in every texel, each at one of the pixel's surface points, and by
/// samples of the BSDF, joined by the balance heuristic (Veach & Guibas 1995): both add
///
/// ```text
/// f cos θ / (t/(k Ω) + n p_BSDF(ω))      to the texel that ω falls into,
/// ```
///
/// where Ω is the texel's solid angle, t the directions a texel, k the number of points and n the BSDF samples at the point. A light of any size is
/// therefore met by every pixel, whatever the map turns out to be, and a mirror still finds its texels. Paths that meet
/// the object again go on to `depth` interactions; there each takes every n-th texel. Light below the plane is
/// light from below: the plane is no part of this (Eq. 4).
pub fn trace_foreground(
    object: &Object,
    camera: &Camera,
    config: &ForegroundConfig,
    check: impl Fn(usize) -> bool + Sync,
) -> Option<Foreground> {
    assert!(
        config.height.is_multiple_of(2) && config.grid > 0 && config.texel_samples > 0 && config.depth > 0
    );
    let grid = Grid::new(config.height);
    let v = visible(object, camera, config.grid, config.seed);
    let fill = |row: usize, dense: &mut [f32], constant: &mut [f32; 3]| {
        let pixel = v.pixels[row] as usize;
        let (seen, _) = look(object, camera, pixel, config.grid, config.seed);
        let mut walk = Walk::new(object, &grid, config, pixel, dense, None);
        walk.pixel(&seen);
        *constant = walk.constant.to_array();
    };
    let matrix = Matrix::build(v.pixels.len(), config.height, 3, fill, check)?;
    Some(v.with(matrix))
}

/// Sets the random numbers of light apart from those of camera rays.
const TRANSPORT_STREAM: u64 = 0x7472_616e_7370_6f72;

pub(super) struct Walk<'a> {
    object: &'a Object,
    grid: &'a Grid,
    config: &'a ForegroundConfig,
    rng: Rng,
    dense: &'a mut [f32],
    /// Where the direct light of a part goes instead.
    apart: Option<Apart<'a>>,
    pub constant: Vec3,
    /// Under even light: all that was added, and what of it came by more than one interaction.
    pub total: f32,
    pub indirect: f32,
}

/// A point of a path: the first may belong to the part that is kept apart.
#[derive(Clone, Copy, PartialEq)]
enum Point {
    First,
    Further,
}

impl<'a> Walk<'a> {
    pub fn new(
        object: &'a Object,
        grid: &'a Grid,
        config: &'a ForegroundConfig,
        pixel: usize,
        dense: &'a mut [f32],
        apart: Option<Apart<'a>>,
    ) -> Self {
        let rng = Rng::stream(config.seed ^ TRANSPORT_STREAM ^ config.stream, pixel as u64);
        Self { object, grid, config, rng, dense, apart, constant: Vec3::ZERO, total: 0.0, indirect: 0.0 }
    }

    pub fn pixel(&mut self, seen: &[Seen]) {
        let k = seen.len();
        let n = self.config.bsdf_samples.div_ceil(k);
        let shadings: Vec<Shading> =
            seen.iter().map(|s| Shading::new(s.surface.material, s.surface.normal, s.view)).collect();
        for s in seen {
            if self.apart.as_ref().is_none_or(|a| a.part != s.surface.part) {
                self.constant += s.surface.emission * s.weight;
            }
        }
        let density = Density { texels: self.config.texel_samples as f32 / k as f32, bsdf: n as f32 };
        // Texels are dealt to the points in turn, from a random first one on each row.
        for _ in 0..self.config.texel_samples {
            let mut turn = 0;
            for texel in 0..self.grid.texels() {
                if texel % self.grid.width == 0 {
                    turn = self.rng.below(k);
                }
                turn = if turn + 1 == k { 0 } else { turn + 1 };
                let at = &seen[turn];
                let weight = Vec3::splat(at.weight);
                self.texel(texel, &at.surface, &shadings[turn], weight, density, Point::First);
            }
        }
        for (s, shading) in seen.iter().zip(&shadings) {
            for _ in 0..n {
                self.bsdf(&s.surface, shading, Vec3::splat(s.weight), density, 1);
            }
        }
    }

    /// One direction in a texel.
    fn texel(
        &mut self,
        texel: usize,
        at: &Surface,
        shading: &Shading,
        throughput: Vec3,
        density: Density,
        point: Point,
    ) {
        let direction = self.grid.inside(texel, &mut self.rng);
        if direction.dot(at.face_normal) <= 0.0 || !(at.normal.dot(direction) > 0.0) {
            return;
        }
        let passed = self.object.transmittance(self.object.leave(at), direction);
        if passed > 0.0 {
            let scale = passed / self.density(texel, direction, shading, density);
            self.deposit(texel, direction, at, shading, throughput * scale, point);
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
        let origin = self.object.leave(at);
        let hit = self.object.surface(origin, direction);
        let passed = 1.0 - hit.map_or(0.0, |s| s.coverage);
        if passed > 0.0 {
            let texel = self.grid.texel_of(direction);
            let scale = passed / self.density(texel, direction, shading, density);
            let point = if depth == 1 { Point::First } else { Point::Further };
            self.deposit(texel, direction, at, shading, throughput * scale, point);
        }
        let Some(next) = hit else { return };
        // Only the BSDF finds the object: no second way to weigh against.
        let f = shading.eval_cosine(direction);
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
            self.texel(texel, at, &shading, throughput, density, Point::Further);
            texel += stride;
        }
        self.bsdf(at, &shading, throughput, density, depth);
    }

    /// Samples a steradian in a direction, of both kinds together.
    fn density(&self, texel: usize, direction: Vec3, shading: &Shading, density: Density) -> f32 {
        density.texels / self.grid.omega[texel / self.grid.width] + density.bsdf * shading.pdf(direction)
    }

    /// Light from a texel by way of a surface: to the lobes of the part that is kept apart, or to the rest.
    fn deposit(
        &mut self,
        texel: usize,
        direction: Vec3,
        at: &Surface,
        shading: &Shading,
        throughput: Vec3,
        point: Point,
    ) {
        let n = self.grid.texels();
        let value = throughput * shading.eval_cosine(direction);
        let even = value.element_sum() * self.grid.omega[texel / self.grid.width];
        self.total += even;
        match (&mut self.apart, point) {
            // Nothing but the sample's weight comes before the first point, the same in all channels.
            (Some(apart), Point::First) if apart.part == at.part => {
                apart.add(n, texel, at, shading, direction, throughput.x);
                return;
            }
            (_, Point::Further) => self.indirect += even,
            _ => {}
        }
        for c in 0..3 {
            self.dense[c * n + texel] += value[c];
        }
    }
}

/// A part whose direct light is kept apart, lobe by lobe.
pub(super) struct Apart<'a> {
    pub part: u32,
    /// Factors on the roughness at which the highlight is traced: one or two.
    pub roughness: &'a [f32],
    /// Planar lobes: diffuse, then for each roughness what F₀ multiplies and what it does not.
    pub dense: &'a mut [f32],
}

impl Apart<'_> {
    fn add(
        &mut self,
        texels: usize,
        texel: usize,
        at: &Surface,
        shading: &Shading,
        direction: Vec3,
        weight: f32,
    ) {
        let n_l = at.normal.dot(direction);
        self.dense[texel] += weight * n_l * std::f32::consts::FRAC_1_PI;
        for (k, factor) in self.roughness.iter().enumerate() {
            // With F₀ = 1 a highlight is D V, with F₀ = 0 that times Schlick's fifth power: both at once, in two channels.
            let roughness = (at.texel.roughness * factor).clamp(0.0, 1.0);
            let probe = Material { albedo: Vec3::X, roughness, metallic: 1.0 };
            let highlight = Shading::new(probe, at.normal, shading.view()).eval_cosine(direction);
            self.dense[(1 + 2 * k) * texels + texel] += weight * (highlight.x - highlight.y);
            self.dense[(2 + 2 * k) * texels + texel] += weight * highlight.y;
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
    /// The same without the matrix: what a composite needs when radiance comes from elsewhere.
    #[must_use]
    pub fn outline(&self) -> Self {
        let Self { pixels, coverage, albedo, normal, depth, .. } = self;
        let (pixels, coverage) = (pixels.clone(), coverage.clone());
        let (albedo, normal, depth) = (albedo.clone(), normal.clone(), depth.clone());
        Self { pixels, coverage, albedo, normal, depth, matrix: Matrix::default() }
    }

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
