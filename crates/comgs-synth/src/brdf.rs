//! The reflectance model: the simplified Disney model of the pipeline (Burley 2012, reduced to albedo,
//! roughness and metalness), with sampling.
//!
//! `f = (1 − metallic)·albedo/π + D·F·G₂ / (4 cos θᵢ cos θₒ)`, with
//! * D: GGX (Trowbridge–Reitz) of width α = roughness²,
//! * G₂: height-correlated Smith masking and shadowing,
//! * F: Schlick, `F₀ + (1 − F₀)(1 − h·o)⁵` with `F₀ = mix(0.04, albedo, metallic)`.
//!
//! The two terms are added without taking from the diffuse what the highlight already reflected: that is the
//! model's own simplification. The highlight alone never gives more than it gets, and loses what light
//! would do on its second bounce between microfacets (the furnace tests state how much).

use glam::Vec3;
use std::f32::consts::PI;

/// Reflectance at one point. Directions are local: z is the shading normal, both point away from the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brdf {
    /// Base colour, linear.
    pub albedo: Vec3,
    /// Perceptual roughness in [0, 1]; widths below [`LEAST_ROUGHNESS`] are rendered as that.
    pub roughness: f32,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Only the diffuse term.
    pub matte: bool,
}

/// Smoothest surface that is rendered: below, a highlight is narrower than what f32 and a texel of the map resolve.
pub const LEAST_ROUGHNESS: f32 = 0.05;

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BrdfSample {
    /// Where the light comes from, local, unit.
    pub direction: Vec3,
    /// `f · cos θ / pdf`.
    pub weight: Vec3,
    /// Density per steradian.
    pub pdf: f32,
}

impl Brdf {
    fn alpha(&self) -> f32 {
        let r = self.roughness.clamp(LEAST_ROUGHNESS, 1.0);
        r * r
    }

    /// Reflectance at normal incidence.
    #[must_use]
    pub fn f0(&self) -> Vec3 {
        Vec3::splat(0.04).lerp(self.albedo, self.metallic)
    }

    fn diffuse(&self) -> Vec3 {
        self.albedo * if self.matte { 1.0 } else { 1.0 - self.metallic }
    }

    /// Chance of sampling the highlight, by the energy that each term is likely to carry.
    fn highlight_chance(&self, cos_out: f32) -> f32 {
        if self.matte {
            return 0.0;
        }
        let highlight = schlick(self.f0(), cos_out).max_element();
        let diffuse = self.diffuse().max_element();
        (highlight / (highlight + diffuse).max(1e-6)).clamp(0.1, 1.0)
    }

    /// The BRDF's value, without the cosine; 0 when either direction is below the surface. Symmetric.
    #[must_use]
    pub fn eval(&self, out: Vec3, light: Vec3) -> Vec3 {
        if out.z <= 0.0 || light.z <= 0.0 {
            return Vec3::ZERO;
        }
        let mut f = self.diffuse() / PI;
        if !self.matte {
            let h = (out + light).normalize();
            let a2 = self.alpha() * self.alpha();
            f += schlick(self.f0(), h.dot(out)) * (ggx(h.z, a2) * smith_visibility(out.z, light.z, a2));
        }
        f
    }

    /// Density per steradian with which [`Brdf::sample`] chooses `light`.
    #[must_use]
    pub fn pdf(&self, out: Vec3, light: Vec3) -> f32 {
        if out.z <= 0.0 || light.z <= 0.0 {
            return 0.0;
        }
        let chance = self.highlight_chance(out.z);
        let mut pdf = (1.0 - chance) * light.z / PI;
        if chance > 0.0 {
            let h = (out + light).normalize();
            let a2 = self.alpha() * self.alpha();
            // Visible normals: D_v(h) / (4 h·o) = D(h) G₁(o) / (4 o.z).
            pdf += chance * ggx(h.z, a2) * smith_g1(out.z, a2) / (4.0 * out.z);
        }
        pdf
    }

    /// Chooses a direction; `None` when it lies below the surface, where the BRDF is 0.
    #[must_use]
    pub fn sample(&self, out: Vec3, choice: f32, u: [f32; 2]) -> Option<BrdfSample> {
        if out.z <= 0.0 {
            return None;
        }
        let direction = if choice < self.highlight_chance(out.z) {
            let h = visible_normal(out, self.alpha(), u);
            2.0 * out.dot(h) * h - out
        } else {
            let r = u[0].sqrt();
            let (s, c) = (2.0 * PI * u[1]).sin_cos();
            Vec3::new(r * c, r * s, (1.0 - u[0]).max(0.0).sqrt())
        };
        let pdf = self.pdf(out, direction);
        if direction.z <= 0.0 || !(pdf > 0.0) {
            return None;
        }
        Some(BrdfSample { direction, weight: self.eval(out, direction) * (direction.z / pdf), pdf })
    }
}

fn schlick(f0: Vec3, cos: f32) -> Vec3 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    f0 + (Vec3::ONE - f0) * (m2 * m2 * m)
}

/// D of GGX, with α².
fn ggx(cos: f32, a2: f32) -> f32 {
    let d = cos * cos * (a2 - 1.0) + 1.0;
    a2 / (PI * d * d)
}

/// `G₂ / (4 cos θᵢ cos θₒ)`, height-correlated Smith.
fn smith_visibility(cos_a: f32, cos_b: f32, a2: f32) -> f32 {
    let la = cos_a * (cos_b * cos_b * (1.0 - a2) + a2).sqrt();
    let lb = cos_b * (cos_a * cos_a * (1.0 - a2) + a2).sqrt();
    0.5 / (la + lb).max(1e-12)
}

/// Smith masking of one direction.
fn smith_g1(cos: f32, a2: f32) -> f32 {
    2.0 * cos / (cos + (cos * cos * (1.0 - a2) + a2).sqrt())
}

/// A microfacet normal out of those that `out` sees (Heitz, "Sampling the GGX Distribution of Visible Normals",
/// JCGT 2018).
fn visible_normal(out: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    let stretched = Vec3::new(alpha * out.x, alpha * out.y, out.z).normalize();
    let length2 = stretched.x * stretched.x + stretched.y * stretched.y;
    let t1 = if length2 > 0.0 { Vec3::new(-stretched.y, stretched.x, 0.0) / length2.sqrt() } else { Vec3::X };
    let t2 = stretched.cross(t1);
    let r = u[0].sqrt();
    let (s, c) = (2.0 * PI * u[1]).sin_cos();
    let (p1, p2) = (r * c, r * s);
    let half = 0.5 * (1.0 + stretched.z);
    let p2 = (1.0 - half) * (1.0 - p1 * p1).max(0.0).sqrt() + half * p2;
    let n = p1 * t1 + p2 * t2 + (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt() * stretched;
    Vec3::new(alpha * n.x, alpha * n.y, n.z.max(1e-7)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;

    fn direction(cos: f32, azimuth: f32) -> Vec3 {
        let sin = (1.0 - cos * cos).sqrt();
        Vec3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
    }

    fn brdf(roughness: f32, metallic: f32, albedo: f32) -> Brdf {
        Brdf { albedo: Vec3::splat(albedo), roughness, metallic, matte: false }
    }

    /// ∫ g(l) dω over the hemisphere by midpoint rule in (θ, azimuth).
    fn hemisphere(mut g: impl FnMut(Vec3) -> f64) -> f64 {
        let (rows, columns) = (400, 400);
        let mut sum = 0.0;
        for i in 0..rows {
            let theta = (f64::from(i) + 0.5) / f64::from(rows) * std::f64::consts::FRAC_PI_2;
            for j in 0..columns {
                let azimuth = (f64::from(j) + 0.5) / f64::from(columns) * std::f64::consts::TAU;
                sum += g(direction(theta.cos() as f32, azimuth as f32)) * theta.sin();
            }
        }
        sum * std::f64::consts::FRAC_PI_2 / f64::from(rows) * std::f64::consts::TAU / f64::from(columns)
    }

    /// Goal: the model is symmetric in its two directions (reciprocity).
    #[test]
    fn reciprocity() {
        for (roughness, metallic) in [(0.1, 0.0), (0.4, 0.5), (1.0, 1.0)] {
            let b = brdf(roughness, metallic, 0.7);
            for (p, q) in
                [(direction(0.9, 0.1), direction(0.2, 3.0)), (direction(0.05, 1.0), direction(0.6, 1.2))]
            {
                let (f, g) = (b.eval(p, q), b.eval(q, p));
                assert!((f - g).abs().max_element() <= 1e-5 * f.max_element());
                assert_eq!(b.eval(-p, q), Vec3::ZERO);
            }
        }
    }

    /// Goal: the stated density is the density: it integrates to the share of samples that are not rejected, and a
    /// histogram of samples follows it (χ² over 8×8 cells of equal solid angle).
    #[test]
    fn sampling_follows_the_density() {
        for (roughness, metallic, cos) in
            [(0.3, 0.0, 0.8), (0.5, 1.0, 0.3), (0.9, 0.3, 0.95), (1.0, 1.0, 0.1)]
        {
            let b = brdf(roughness, metallic, 0.5);
            let out = direction(cos, 0.4);
            let n = 60_000;
            let mut counts = [0.0f64; 64];
            let mut rng = Rng::new(3);
            let mut kept = 0.0;
            for _ in 0..n {
                if let Some(s) = b.sample(out, rng.uniform(), [rng.uniform(), rng.uniform()]) {
                    let azimuth = s.direction.y.atan2(s.direction.x).rem_euclid(2.0 * PI) / (2.0 * PI);
                    let cell =
                        ((s.direction.z * 8.0) as usize).min(7) * 8 + ((azimuth * 8.0) as usize).min(7);
                    counts[cell] += 1.0;
                    kept += 1.0;
                }
            }
            let mut expected = [0.0f64; 64];
            // Sub-cells fine enough for the narrowest lobe above (α = 0.09).
            let fine = 96;
            for i in 0..8 * fine {
                for j in 0..8 * fine {
                    let z = (i as f32 + 0.5) / (8 * fine) as f32;
                    let azimuth = (j as f32 + 0.5) / (8 * fine) as f32 * 2.0 * PI;
                    expected[i / fine * 8 + j / fine] +=
                        f64::from(b.pdf(out, direction(z, azimuth))) * 2.0 * std::f64::consts::PI
                            / ((8 * fine) as f64).powi(2)
                            * f64::from(n);
                }
            }
            let total: f64 = expected.iter().sum();
            assert!((total - kept).abs() < 0.01 * f64::from(n), "{roughness}: {total} and {kept}");
            let (mut chi2, mut cells) = (0.0, 0.0);
            for (c, e) in counts.iter().zip(&expected) {
                if *e > 5.0 {
                    chi2 += (c - e).powi(2) / e;
                    cells += 1.0;
                }
            }
            // Mean `cells`, standard deviation √(2 cells); five of those are never passed by chance.
            assert!(
                chi2 < cells + 5.0 * (2.0f64 * cells).sqrt(),
                "{roughness} {metallic} {cos}: χ² {chi2} over {cells}"
            );
        }
    }

    /// Goal: the sampled estimate of the reflected share equals its integral by brute force.
    #[test]
    fn sampling_estimates_the_integral() {
        for (roughness, metallic, cos) in [(0.35, 0.0, 0.7), (0.6, 1.0, 0.4), (1.0, 0.2, 0.9)] {
            let b = brdf(roughness, metallic, 0.6);
            let out = direction(cos, 1.0);
            let exact = hemisphere(|l| f64::from(b.eval(out, l).x * l.z));
            let mut rng = Rng::new(9);
            let n = 40_000;
            let mut sum = 0.0;
            for _ in 0..n {
                if let Some(s) = b.sample(out, rng.uniform(), [rng.uniform(), rng.uniform()]) {
                    sum += f64::from(s.weight.x);
                }
            }
            let estimate = sum / f64::from(n);
            assert!((estimate - exact).abs() < 0.01 * exact, "{roughness}: {estimate} and {exact}");
        }
    }

    /// What white metal gives back at normal incidence, on paper. The half vector's slope `t = tan² θ` has the
    /// distribution function `t/(α² + t)`; light comes from 2θ and is masked there by Smith's G₁, or lies below the
    /// surface for t > 1.
    fn normal_albedo_of_white_metal(roughness: f64) -> f64 {
        let a2 = roughness.powi(4);
        let n = 100_000;
        let mut sum = 0.0;
        for i in 0..n {
            let t = (f64::from(i) + 0.5) / f64::from(n);
            let tangent = t.sqrt();
            let double = 2.0 * tangent / (1.0 - t);
            sum += a2 / (a2 + t).powi(2) * 2.0 / (1.0 + (1.0 + a2 * double * double).sqrt());
        }
        sum / f64::from(n)
    }

    /// Goal: white furnace. Lambert gives back exactly its albedo. White metal gives back at most 1, and at normal
    /// incidence what the formula on paper says: it loses to single scattering 0.9 % at roughness 0.3, 8 % at 0.5 and
    /// 58 % at 0.9.
    #[test]
    fn white_furnace() {
        let matte = Brdf { albedo: Vec3::splat(0.8), roughness: 0.5, metallic: 0.0, matte: true };
        let given = hemisphere(|l| f64::from(matte.eval(direction(0.5, 0.0), l).x * l.z));
        assert!((given - 0.8).abs() < 1e-4, "{given}");
        for (roughness, stated) in [(0.3, 0.991), (0.5, 0.916), (0.9, 0.420)] {
            let metal = brdf(roughness, 1.0, 1.0);
            for cos in [0.1, 0.4, 0.7, 1.0] {
                let given = hemisphere(|l| f64::from(metal.eval(direction(cos, 0.0), l).x * l.z));
                assert!(given <= 1.003, "roughness {roughness}, cos {cos}: {given}");
                if cos == 1.0 {
                    let paper = normal_albedo_of_white_metal(f64::from(roughness));
                    assert!((given - paper).abs() < 2e-3, "roughness {roughness}: {given}, on paper {paper}");
                    assert!((paper - stated).abs() < 5e-3, "roughness {roughness}: {paper}");
                }
            }
        }
    }
}
