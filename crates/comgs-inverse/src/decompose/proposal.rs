//! Directions that the light proposes: a pool drawn once a step, of which every shading point takes an even share.
//!
//! Drawing from a table costs more than all else that is done for a sample (a fifth of a step when each point drew its own
//! from a bilinear table), and the density must be evaluated for every sample of the BRDF too. So the table is piecewise
//! constant, and its samples are shared: the pool is one stratified set, and a point takes every n-th of it from a random
//! start, which is again a stratified set.

use comgs_geom::Rng;
use comgs_geom::octahedral::{direction, jacobian, uv_from_direction};
use comgs_light::{OctahedralLight, luminance};
use glam::{Vec2, Vec3};

/// A proposed direction.
#[derive(Clone, Copy, Debug)]
pub struct Proposed {
    /// Unit direction towards the light, world.
    pub direction: Vec3,
    /// Density per steradian of the table there.
    pub pdf: f32,
    /// The light's radiance there.
    pub radiance: Vec3,
}

/// A piecewise constant table over the octahedral map, and a pool of directions drawn from it.
#[derive(Clone, Debug)]
pub struct Proposal {
    size: usize,
    /// Density per area of the map, mean 1.
    density: Vec<f32>,
    pool: Vec<Proposed>,
}

/// Side of the table in texels; the light's own where that is smaller.
const TABLE: usize = 64;
/// Directions in the pool.
const POOL: usize = 4096;
/// Share of the density that is even over the map, so that it vanishes nowhere.
const EVEN: f32 = 0.1;

impl Proposal {
    /// Builds the table of a light and draws the pool. Same light and seed, same pool.
    #[must_use]
    pub fn new(light: &OctahedralLight, seed: u64) -> Self {
        let size = TABLE.min(light.size());
        let block = light.size() / size;
        // Flux of each cell: luminance times the solid angle per area of the map.
        let mut density = vec![0.0f32; size * size];
        for (i, texel) in light.texels().chunks_exact(3).enumerate() {
            let (x, y) = (i % light.size() / block, i / light.size() / block);
            density[y * size + x] += luminance(Vec3::from_slice(texel));
        }
        let centre = |i: usize| {
            let at = |k: usize| (k as f32 + 0.5) / size as f32;
            direction(Vec2::new(at(i % size), at(i / size)))
        };
        for (i, d) in density.iter_mut().enumerate() {
            *d *= jacobian(centre(i));
        }
        let total: f64 = density.iter().map(|d| f64::from(*d)).sum();
        let scale = if total > 0.0 { (density.len() as f64 / total) as f32 } else { 0.0 };
        let even = if total > 0.0 { EVEN } else { 1.0 };
        for d in &mut density {
            *d = even + (1.0 - even) * scale * *d;
        }
        let mut out = Self { size, density, pool: Vec::with_capacity(POOL) };
        out.draw(light, seed);
        out
    }

    /// One walk along the cumulative table, a stratum at a time.
    fn draw(&mut self, light: &OctahedralLight, seed: u64) {
        let mut rng = Rng::new(seed);
        let cells = self.density.len();
        let (mut cell, mut passed) = (0, 0.0f64);
        for k in 0..POOL {
            let goal = (k as f64 + f64::from(rng.uniform())) / POOL as f64 * cells as f64;
            while cell + 1 < cells && passed + f64::from(self.density[cell]) <= goal {
                passed += f64::from(self.density[cell]);
                cell += 1;
            }
            let corner = Vec2::new((cell % self.size) as f32, (cell / self.size) as f32);
            let uv = (corner + Vec2::new(rng.uniform(), rng.uniform())) / self.size as f32;
            let direction = direction(uv);
            self.pool.push(Proposed {
                direction,
                pdf: self.density[cell] / jacobian(direction),
                radiance: light.radiance(direction),
            });
        }
    }

    /// Density per steradian with which the pool was drawn in a unit direction; > 0 everywhere.
    #[inline(always)]
    #[must_use]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let uv = uv_from_direction(direction) * self.size as f32;
        let (x, y) = ((uv.x as usize).min(self.size - 1), (uv.y as usize).min(self.size - 1));
        self.density[y * self.size + x] / jacobian(direction)
    }

    /// Sample `s` of the `count` that a point takes, `start` being its random number in [0, 1).
    #[inline]
    #[must_use]
    pub fn sample(&self, s: u32, count: u32, start: f32) -> Proposed {
        let step = (self.pool.len() / count as usize).max(1);
        let first = (start * self.pool.len() as f32) as usize;
        self.pool[(first + s as usize * step) % self.pool.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::octahedral::texel_solid_angle;

    fn spotted() -> OctahedralLight {
        let mut texels = OctahedralLight::constant(128, Vec3::new(0.2, 0.1, 0.3)).texels().to_vec();
        for i in [700, 701, 9000] {
            texels[3 * i] = 500.0;
        }
        OctahedralLight::from_texels(128, texels).expect("sound texels")
    }

    /// Goal: the density integrates to 1 over the sphere, and is above 0 for a black light too.
    #[test]
    fn density_is_one() {
        for light in [spotted(), OctahedralLight::constant(32, Vec3::ZERO)] {
            let proposal = Proposal::new(&light, 1);
            let n = 512;
            let mut sum = 0.0f64;
            for i in 0..n * n {
                let d = comgs_geom::octahedral::texel_direction(i % n, i / n, n);
                let pdf = proposal.pdf(d);
                assert!(pdf > 0.0);
                sum += f64::from(pdf) * f64::from(texel_solid_angle(i % n, i / n, n));
            }
            // Midpoints of texels of 1/512 on a density whose Jacobian varies.
            assert!((sum - 1.0).abs() < 2e-3, "{sum}");
        }
    }

    /// Goal: the pool estimates the light's integral (the mean over many pools, for its noise), its densities are those that
    /// [`Proposal::pdf`] states, and a point's share of it estimates the same.
    #[test]
    fn pool_is_unbiased() {
        let light = spotted();
        let truth = luminance(light.integral());
        let (mut whole, mut shares) = (0.0f64, 0.0f64);
        let pools = 40;
        for seed in 0..pools {
            let proposal = Proposal::new(&light, seed);
            let value = |p: &Proposed| f64::from(luminance(p.radiance) / p.pdf);
            whole += proposal.pool.iter().map(value).sum::<f64>() / proposal.pool.len() as f64;
            let start = Rng::stream(9, seed).uniform();
            shares += (0..32).map(|s| value(&proposal.sample(s, 32, start))).sum::<f64>() / 32.0;
            for p in proposal.pool.iter().step_by(97) {
                // A direction at a cell's edge may round into its neighbour; none of these does.
                assert!((proposal.pdf(p.direction) / p.pdf - 1.0).abs() < 1e-3);
            }
        }
        let n = f64::from(pools as u32);
        assert!((whole / n / f64::from(truth) - 1.0).abs() < 0.02, "{} {truth}", whole / n);
        assert!((shares / n / f64::from(truth) - 1.0).abs() < 0.15, "{} {truth}", shares / n);
    }
}
