//! The shadow on the ground as a matrix (DiPIR Eq. 5).

use super::{Grid, Matrix};
use crate::light::LightMap;
use crate::object::Object;
use comgs_geom::{Camera, Rng};
use glam::Vec3;

/// Irradiance below which a shadow ratio has no meaning and is 1.
pub const DARK: f32 = 1e-9;

/// How the matrix is traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowConfig {
    /// Rows of the map, even.
    pub height: usize,
    /// Rays a texel that the object may hide.
    pub samples: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for ShadowConfig {
    /// Four rays a texel.
    fn default() -> Self {
        Self { height: 32, samples: 4, seed: 0 }
    }
}

/// How far a ray that leaves the ground starts above it, as a share of the object's radius.
const LEAVE: f32 = 1e-4;

/// The ground as the camera sees it, and the matrix from the map to the irradiance that the object keeps from it.
#[derive(Clone, Debug)]
pub struct Shadow {
    /// Indices (row-major) of the pixels whose ground the object may shade; the matrix' rows in this order.
    pub pixels: Vec<u32>,
    /// Irradiance that the object takes away, by texel; the same in all channels, at most [`Shadow::ground`].
    pub matrix: Matrix,
    /// ∫ max(0, cos θ) dω over every texel: times the map, the irradiance without the object.
    pub ground: Vec<f32>,
}

/// Shadow ratios by row, and what their gradient needs.
#[derive(Clone, Debug)]
pub struct Ratios {
    /// β by row, in [0, 1].
    pub beta: Vec<[f32; 3]>,
    /// Irradiance without the object.
    pub irradiance: [f32; 3],
    taken: Vec<[f32; 3]>,
}

/// Share of the light that a pixel must be able to lose to get a row.
const LEAST_SHARE: f32 = 1e-5;

/// Traces the matrix for the plane z = 0, Lambertian. `coverage` (one value a pixel) says where the object hides it
/// altogether. `check` as in [`super::trace_foreground`].
///
/// The ratio is `1 − Σ B L / Σ g L` with g a texel's share of the irradiance and B the part of it that the object takes,
/// estimated by directions drawn in proportion to the cosine within the texel and points across the pixel. B never
/// exceeds g, so the ratio stays in [0, 1] for any map.
pub fn trace_shadow(
    object: &Object,
    camera: &Camera,
    coverage: &[f32],
    config: &ShadowConfig,
    check: impl Fn(usize) -> bool + Sync,
) -> Option<Shadow> {
    assert!(config.height.is_multiple_of(2) && config.samples > 0);
    let grid = Grid::new(config.height);
    let ground = ground_shares(&grid);
    let above = grid.texels() / 2;
    // Centre of a texel to its corner, at most.
    let slack = std::f32::consts::PI / config.height as f32;
    let centres: Vec<Vec3> = (0..above)
        .map(|t| {
            comgs_geom::equirect::texel_direction(t % grid.width, t / grid.width, grid.width, grid.height)
        })
        .collect();
    let point = |x: f64, y: f64| -> Option<Vec3> {
        let ray = camera.ray_world(x, y);
        let origin = camera.centre();
        (ray.z < -1e-9).then(|| {
            let mut p = (origin - ray * (origin.z / ray.z)).as_vec3();
            p.z = LEAVE * object.radius;
            p
        })
    };
    let pixels: Vec<u32> = (0..camera.width * camera.height)
        .filter(|&i| {
            if coverage[i] >= 1.0 {
                return false;
            }
            let middle = point((i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5);
            middle.is_some_and(|p| {
                // Of the irradiance under even light, the share within the cone around the object.
                let way = object.centre - p;
                let sine = (object.radius / way.length()).min(1.0);
                sine * sine > LEAST_SHARE
            })
        })
        .map(|i| i as u32)
        .collect();
    let fill = |row: usize, dense: &mut [f32], _: &mut [f32; 3]| {
        let pixel = pixels[row] as usize;
        let (x, y) = ((pixel % camera.width) as f64, (pixel / camera.width) as f64);
        let mut rng = Rng::stream(config.seed ^ SHADOW_STREAM, pixel as u64);
        let Some(middle) = point(x + 0.5, y + 0.5) else { return };
        for texel in 0..above {
            if !object.may_meet(middle, centres[texel], slack) {
                continue;
            }
            let mut hidden = 0.0;
            for _ in 0..config.samples {
                let place = point(x + f64::from(rng.uniform()), y + f64::from(rng.uniform()));
                let direction = grid.inside_cosine(texel, &mut rng);
                hidden += 1.0 - object.transmittance(place.unwrap_or(middle), direction);
            }
            dense[texel] = ground[texel] * hidden / config.samples as f32;
        }
    };
    let matrix = Matrix::build(pixels.len(), config.height, 1, fill, check)?;
    Some(Shadow { pixels, matrix, ground })
}

/// Sets the random numbers of shadows apart from others.
const SHADOW_STREAM: u64 = 0x7368_6164_6f77_0000;

/// ∫ max(0, cos φ) over every texel: `½ Δθ (sin² φ₁ − sin² φ₀)` above the horizon.
fn ground_shares(grid: &Grid) -> Vec<f32> {
    use std::f64::consts::PI;
    let sine2 = |row: usize| (PI * row as f64 / grid.height as f64).sin().powi(2);
    let row_share = |row: usize| {
        if row < grid.height / 2 { PI / grid.width as f64 * (sine2(row + 1) - sine2(row)) } else { 0.0 }
    };
    (0..grid.texels()).map(|t| row_share(t / grid.width) as f32).collect()
}

impl Shadow {
    /// β of Eq. 5 under a map, for the rows that are `wanted` (1 for others). Gradient: [`Shadow::ratios_vjp`].
    #[must_use]
    pub fn ratios(&self, map: &LightMap, wanted: impl Fn(usize) -> bool + Sync) -> Ratios {
        let mut irradiance = [0.0f32; 3];
        for (c, sum) in irradiance.iter_mut().enumerate() {
            let exact: f64 =
                self.ground.iter().zip(map.channel(c)).map(|(g, l)| f64::from(*g) * f64::from(*l)).sum();
            *sum = exact as f32;
        }
        let taken = self.matrix.times(map, wanted);
        let ratio = |taken: f32, all: f32| if all > DARK { (1.0 - taken / all).clamp(0.0, 1.0) } else { 1.0 };
        let beta = taken.iter().map(|t| std::array::from_fn(|c| ratio(t[c], irradiance[c]))).collect();
        Ratios { beta, irradiance, taken }
    }

    /// Gradient with respect to the map, added to `grad`: `∂β/∂L = −B/E + g ΣBL/E²`. 0 where the light is dark.
    pub fn ratios_vjp(&self, ratios: &Ratios, grad_beta: &[[f32; 3]], grad: &mut LightMap) {
        let texels = grad.texels();
        let inverse = ratios.irradiance.map(|e| if e > DARK { 1.0 / e } else { 0.0 });
        let rows: Vec<[f32; 3]> =
            grad_beta.iter().map(|g| std::array::from_fn(|c| -g[c] * inverse[c])).collect();
        self.matrix.transposed(&rows, grad);
        for c in 0..3 {
            let sum: f64 =
                grad_beta.iter().zip(&ratios.taken).map(|(g, t)| f64::from(g[c]) * f64::from(t[c])).sum();
            let scale = sum as f32 * inverse[c] * inverse[c];
            let out = &mut grad.data[c * texels..(c + 1) * texels];
            for (o, g) in out.iter_mut().zip(&self.ground) {
                *o += scale * g;
            }
        }
    }

    /// Values by row as an image, 1 elsewhere.
    #[must_use]
    pub fn spread(&self, rows: &[[f32; 3]], width: usize, height: usize) -> comgs_image::Image {
        let mut out = comgs_image::Image::filled(width, height, 3, 1.0);
        for (&pixel, value) in self.pixels.iter().zip(rows) {
            out.data[3 * pixel as usize..3 * pixel as usize + 3].copy_from_slice(value);
        }
        out
    }
}
