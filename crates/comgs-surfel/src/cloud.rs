//! The cloud.

use comgs_geom::{Similarity, sh};
use glam::{DQuat, Mat3, Quat, Vec3};

/// What the spherical-harmonic sum of a surfel means.
///
/// Splatting, tracing and lighting always blend linear radiance; this says how a surfel's own sum becomes one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorEncoding {
    /// `radiance = EOTF(max(0, Σ + ½))`: the sum is an sRGB code value, as published splats store it, and
    /// any viewer shows the right colours. The EOTF is continued above 1, so HDR radiance fits.
    Srgb,
    /// `radiance = max(0, Σ + ½)`.
    Linear,
}

/// Material columns, raw: albedo, metallic and roughness are sigmoids of these.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaterialColumns {
    /// Linear base colour, logit.
    pub albedo_logits: Vec<[f32; 3]>,
    /// Metallic, logit.
    pub metallic_logits: Vec<f32>,
    /// Roughness, logit.
    pub roughness_logits: Vec<f32>,
}

/// Surfels as columns of raw (unconstrained) parameters, the form that is stored and optimised.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfelCloud {
    /// Centres, world units.
    pub positions: Vec<[f32; 3]>,
    /// Quaternions w, x, y, z; normalised on use. Columns of the rotation: tangent u, tangent v, normal.
    pub rotations: Vec<[f32; 4]>,
    /// Natural logarithm of the standard deviations along the two tangents, world units.
    pub log_scales: Vec<[f32; 2]>,
    /// Logit of the peak opacity.
    pub opacity_logits: Vec<f32>,
    /// Spherical-harmonic coefficients, `[surfel][coefficient][rgb]` flattened.
    pub sh: Vec<f32>,
    /// Degree of `sh`, 0 to 3.
    pub sh_degree: usize,
    /// What the harmonic sum means.
    pub color_encoding: ColorEncoding,
    /// Material, for decomposed objects.
    pub material: Option<MaterialColumns>,
}

impl SurfelCloud {
    /// A cloud without surfels.
    #[must_use]
    pub fn empty(sh_degree: usize, color_encoding: ColorEncoding) -> Self {
        Self {
            positions: Vec::new(),
            rotations: Vec::new(),
            log_scales: Vec::new(),
            opacity_logits: Vec::new(),
            sh: Vec::new(),
            sh_degree,
            color_encoding,
            material: None,
        }
    }

    /// Number of surfels.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Floats of `sh` a surfel: `3 (degree + 1)²`.
    #[must_use]
    pub fn sh_stride(&self) -> usize {
        3 * sh::coefficient_count(self.sh_degree)
    }

    /// The harmonics of a surfel.
    #[must_use]
    pub fn sh_of(&self, i: usize) -> &[f32] {
        let stride = self.sh_stride();
        &self.sh[i * stride..(i + 1) * stride]
    }

    /// Rotation of a surfel as a matrix (tangent u, tangent v, normal). A zero or non-finite quaternion is the
    /// identity.
    #[must_use]
    pub fn rotation(&self, i: usize) -> Mat3 {
        rotation_matrix(self.rotations[i])
    }

    /// Radiance of a surfel seen along the unit direction `d` (from the eye to the surfel).
    #[must_use]
    pub fn radiance(&self, i: usize, d: Vec3) -> Vec3 {
        let basis = sh::basis(self.sh_degree, d);
        let mut sum = Vec3::splat(0.5);
        for (k, c) in self.sh_of(i).chunks_exact(3).enumerate() {
            sum += basis[k] * Vec3::from_slice(c);
        }
        let positive = sum.max(Vec3::ZERO);
        match self.color_encoding {
            ColorEncoding::Linear => positive,
            ColorEncoding::Srgb => {
                Vec3::from_array(positive.to_array().map(comgs_image::transfer::linear_from_srgb))
            }
        }
    }

    /// Problems of the columns: lengths that disagree, non-finite values (counted by column). Empty when sound.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let n = self.len();
        let mut problems = Vec::new();
        let mut length = |name: &str, got: usize, expected: usize| {
            if got != expected {
                problems.push(format!("column {name} has {got} values, expected {expected}"));
            }
        };
        length("rotations", self.rotations.len(), n);
        length("log_scales", self.log_scales.len(), n);
        length("opacity_logits", self.opacity_logits.len(), n);
        length("sh", self.sh.len(), n * self.sh_stride());
        if let Some(m) = &self.material {
            length("albedo_logits", m.albedo_logits.len(), n);
            length("metallic_logits", m.metallic_logits.len(), n);
            length("roughness_logits", m.roughness_logits.len(), n);
        }
        let mut finite = |name: &str, bad: usize| {
            if bad > 0 {
                problems.push(format!("column {name} has {bad} non-finite values"));
            }
        };
        let bad = |values: &[f32]| values.iter().filter(|v| !v.is_finite()).count();
        finite("positions", bad(self.positions.as_flattened()));
        finite("rotations", bad(self.rotations.as_flattened()));
        finite("log_scales", self.log_scales.as_flattened().iter().filter(|v| v.is_nan()).count());
        finite("opacity_logits", self.opacity_logits.iter().filter(|v| v.is_nan()).count());
        finite("sh", bad(&self.sh));
        problems
    }

    /// Keeps the surfels for which `keep` is true, in order.
    pub fn retain(&mut self, keep: &[bool]) {
        fn filter<T: Copy>(column: &mut Vec<T>, keep: &[bool]) {
            let mut i = 0;
            column.retain(|_| {
                i += 1;
                keep[i - 1]
            });
        }
        let stride = self.sh_stride();
        filter(&mut self.positions, keep);
        filter(&mut self.rotations, keep);
        filter(&mut self.log_scales, keep);
        filter(&mut self.opacity_logits, keep);
        let mut i = 0;
        self.sh.retain(|_| {
            i += 1;
            keep[(i - 1) / stride]
        });
        if let Some(m) = &mut self.material {
            filter(&mut m.albedo_logits, keep);
            filter(&mut m.metallic_logits, keep);
            filter(&mut m.roughness_logits, keep);
        }
    }

    /// Reorders (and may repeat or drop) surfels: the new surfel `k` is the old surfel `order[k]`.
    #[must_use]
    pub fn gathered(&self, order: &[u32]) -> Self {
        fn gather<T: Copy>(column: &[T], order: &[u32]) -> Vec<T> {
            order.iter().map(|&i| column[i as usize]).collect()
        }
        let mut sh = Vec::with_capacity(order.len() * self.sh_stride());
        for &i in order {
            sh.extend_from_slice(self.sh_of(i as usize));
        }
        Self {
            positions: gather(&self.positions, order),
            rotations: gather(&self.rotations, order),
            log_scales: gather(&self.log_scales, order),
            opacity_logits: gather(&self.opacity_logits, order),
            sh,
            sh_degree: self.sh_degree,
            color_encoding: self.color_encoding,
            material: self.material.as_ref().map(|m| MaterialColumns {
                albedo_logits: gather(&m.albedo_logits, order),
                metallic_logits: gather(&m.metallic_logits, order),
                roughness_logits: gather(&m.roughness_logits, order),
            }),
        }
    }

    /// The cloud after a similarity: positions, orientations and scales move, and the harmonics turn with the
    /// object, so that every point keeps the radiance it had towards directions that turn along.
    #[must_use]
    pub fn transformed(&self, s: &Similarity) -> Self {
        let mut out = self.clone();
        let log_scale = s.scale.ln() as f32;
        for i in 0..self.len() {
            let p = Vec3::from_array(self.positions[i]).as_dvec3();
            out.positions[i] = s.transform_point(p).as_vec3().to_array();
            let [w, x, y, z] = normalised_quaternion(self.rotations[i]);
            let q = s.rotation * DQuat::from_xyzw(x.into(), y.into(), z.into(), w.into());
            out.rotations[i] = [q.w as f32, q.x as f32, q.y as f32, q.z as f32];
            for axis in 0..2 {
                out.log_scales[i][axis] += log_scale;
            }
        }
        rotate_harmonics(&mut out.sh, self.sh_degree, s.rotation);
        out
    }

    /// Smallest and largest centre coordinates; `None` when empty.
    #[must_use]
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut points = self.positions.iter().map(|&p| Vec3::from_array(p)).filter(|p| p.is_finite());
        let first = points.next()?;
        Some(points.fold((first, first), |(low, high), p| (low.min(p), high.max(p))))
    }
}

/// Unit quaternion w, x, y, z; the identity when the length is zero, denormal or not finite.
#[must_use]
pub fn normalised_quaternion(q: [f32; 4]) -> [f32; 4] {
    let largest = q.iter().fold(0.0f32, |a, v| a.max(v.abs()));
    if !(largest > 1e-30) || !q.iter().all(|v| v.is_finite()) {
        return [1.0, 0.0, 0.0, 0.0];
    }
    // Dividing by the largest entry first keeps the square from over- or underflowing.
    let scaled = q.map(|v| v / largest);
    let length = scaled.iter().map(|v| v * v).sum::<f32>().sqrt();
    scaled.map(|v| v / length)
}

/// Rotation matrix of a raw quaternion w, x, y, z.
#[must_use]
pub fn rotation_matrix(q: [f32; 4]) -> Mat3 {
    let [w, x, y, z] = normalised_quaternion(q);
    Mat3::from_quat(Quat::from_xyzw(x, y, z, w))
}

/// Turns harmonics `[surfel][coefficient][rgb]` so that `f_new(R d) = f_old(d)`.
///
/// The band matrices come from projecting the rotated basis on as many directions as a band has functions, solved
/// once per rotation; no special recursion is needed for degree ≤ 3.
fn rotate_harmonics(values: &mut [f32], degree: usize, rotation: DQuat) {
    if degree == 0 {
        return;
    }
    let inverse = rotation.inverse();
    let count = sh::coefficient_count(degree);
    // matrix[j][k] = ∫ Y_j(d) Y_k(R⁻¹ d) over the sphere, by a quadrature exact for degree ≤ 7.
    let mut matrix = vec![0.0f64; count * count];
    let (nodes, weights) = gauss_legendre_8();
    let azimuths = 16;
    for (z, wz) in nodes.iter().zip(weights) {
        for a in 0..azimuths {
            let phi = 2.0 * std::f64::consts::PI * f64::from(a) / f64::from(azimuths);
            let r = (1.0 - z * z).sqrt();
            let d = glam::DVec3::new(r * phi.cos(), r * phi.sin(), *z);
            let w = wz * 2.0 * std::f64::consts::PI / f64::from(azimuths);
            let here = sh::basis(degree, d.as_vec3());
            let there = sh::basis(degree, (inverse * d).as_vec3());
            for j in 1..count {
                for k in 1..count {
                    matrix[j * count + k] += w * f64::from(here[j]) * f64::from(there[k]);
                }
            }
        }
    }
    let mut old = vec![0.0f32; count * 3];
    for surfel in values.chunks_exact_mut(count * 3) {
        old.copy_from_slice(surfel);
        for j in 1..count {
            for c in 0..3 {
                let sum: f64 = (1..count).map(|k| matrix[j * count + k] * f64::from(old[k * 3 + c])).sum();
                surfel[j * 3 + c] = sum as f32;
            }
        }
    }
}

/// Nodes and weights of the 8-point Gauss–Legendre rule on [−1, 1], exact to polynomial degree 15.
fn gauss_legendre_8() -> ([f64; 8], [f64; 8]) {
    const X: [f64; 4] =
        [0.183_434_642_495_649_8, 0.525_532_409_916_329, 0.796_666_477_413_626_7, 0.960_289_856_497_536_2];
    const W: [f64; 4] =
        [0.362_683_783_378_362, 0.313_706_645_877_887_3, 0.222_381_034_453_374_5, 0.101_228_536_290_376_3];
    let mut nodes = [0.0; 8];
    let mut weights = [0.0; 8];
    for i in 0..4 {
        nodes[i] = -X[3 - i];
        weights[i] = W[3 - i];
        nodes[4 + i] = X[i];
        weights[4 + i] = W[i];
    }
    (nodes, weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;
    use glam::DVec3;

    fn random_cloud(n: usize, seed: u64) -> SurfelCloud {
        let mut rng = Rng::new(seed);
        let mut cloud = SurfelCloud::empty(3, ColorEncoding::Linear);
        for _ in 0..n {
            cloud.positions.push([rng.normal(), rng.normal(), rng.normal()]);
            cloud.rotations.push([rng.normal(), rng.normal(), rng.normal(), rng.normal()]);
            cloud.log_scales.push([rng.range(-4.0, -1.0), rng.range(-4.0, -1.0)]);
            cloud.opacity_logits.push(rng.normal());
            for k in 0..cloud.sh_stride() {
                cloud.sh.push(if k < 3 { 2.0 } else { 0.1 * rng.normal() });
            }
        }
        cloud
    }

    /// Goal: a transformed cloud radiates along turned directions what the original did.
    #[test]
    fn similarity_turns_radiance_along() {
        let cloud = random_cloud(5, 1);
        let s = Similarity {
            scale: 2.5,
            rotation: DQuat::from_rotation_z(0.8) * DQuat::from_rotation_x(1.1),
            translation: DVec3::new(1.0, 2.0, 3.0),
        };
        let moved = cloud.transformed(&s);
        for i in 0..cloud.len() {
            for d in [Vec3::X, Vec3::new(0.6, -0.48, 0.64), -Vec3::Z] {
                let turned = (s.rotation * d.as_dvec3()).as_vec3();
                assert!((moved.radiance(i, turned) - cloud.radiance(i, d)).length() < 1e-4);
            }
            let normal = s.rotation * cloud.rotation(i).z_axis.as_dvec3();
            assert!((moved.rotation(i).z_axis.as_dvec3() - normal).length() < 1e-5);
            assert!((moved.log_scales[i][0] - cloud.log_scales[i][0] - 2.5f32.ln()).abs() < 1e-6);
        }
    }

    /// Goal: unusable quaternions become the identity instead of NaN (hard case 6).
    #[test]
    fn hard_quaternions() {
        for q in [[0.0; 4], [f32::NAN, 0.0, 0.0, 1.0], [1e-40, 0.0, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0, 0.0]]
        {
            assert_eq!(rotation_matrix(q), Mat3::IDENTITY);
        }
        let large = rotation_matrix([1e30, 1e30, 0.0, 0.0]);
        assert!((large.determinant() - 1.0).abs() < 1e-5);
    }

    /// Goal: retain and gather agree and keep columns together.
    #[test]
    fn retain_is_a_gather() {
        let cloud = random_cloud(6, 2);
        let keep = [true, false, true, true, false, false];
        let mut kept = cloud.clone();
        kept.retain(&keep);
        assert_eq!(kept, cloud.gathered(&[0, 2, 3]));
        assert!(kept.problems().is_empty());
    }
}
