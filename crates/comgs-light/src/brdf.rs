//! The reflectance model of inverse rendering and relighting: the simplified Disney BRDF of ComGS (Sec. 3.1.2;
//! Burley 2012 reduced to albedo, roughness and metalness), with sampling and gradients.
//!
//! `f = (1 − metallic) · albedo/π + D F G₂ / (4 n·l n·v)`, where with the half vector `h = (v + l)/|v + l|`
//! * `D = α² / (π ((n·h)² (α² − 1) + 1)²)`, GGX with `α = roughness²`,
//! * `G₂ / (4 n·l n·v) = ½ / (n·l √((n·v)² (1 − α²) + α²) + n·v √((n·l)² (1 − α²) + α²))`, Smith's masking and
//!   shadowing, correlated by height (Heitz 2014, "Understanding the masking-shadowing function"),
//! * `F = F₀ + (1 − F₀)(1 − v·h)⁵`, Schlick, with `F₀ = 0.04 + metallic · (albedo − 0.04)`.
//!
//! Everything is in world space; no tangent frame is built to evaluate. [`Shading`] holds what does not depend on the
//! light and is what a loop over lights should use; [`eval_cosine`] and its companions are for single calls.
//!
//! The two terms are added as they are: that the highlight takes light from the diffuse below it is not modelled, nor
//! is light that bounces twice between microfacets. The highlight alone never gives more than it gets; with F = 1 it
//! loses 0.9 % at normal incidence at roughness 0.3, 8 % at 0.5, 58 % at 0.9 (white furnace, `tests/brdf.rs`).

use comgs_geom::frame;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, TAU};

/// Roughness below this is shaded as this, without a gradient: a narrower highlight is beyond what f32 and the texels
/// of a map resolve.
pub const LEAST_ROUGHNESS: f32 = 0.05;

/// Reflectance of a dielectric at normal incidence (an index of refraction of 1.5).
pub const DIELECTRIC_F0: f32 = 0.04;

/// Least denominator of the visibility; reached only where n·v and n·l are both below 10⁻⁹.
const LEAST_DENOMINATOR: f32 = 1e-12;

/// Where a diffuse term is left, both lobes are sampled with at least this chance.
const LEAST_CHANCE: f32 = 0.1;

/// What a surface is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Base colour, linear Rec.709, in [0, 1].
    pub albedo: Vec3,
    /// Perceptual roughness in [0, 1]; clamped to [[`LEAST_ROUGHNESS`], 1] on use.
    pub roughness: f32,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
}

/// Gradient with respect to a [`Material`] and the unit normal it is shaded with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialGradient {
    /// With respect to [`Material::albedo`].
    pub albedo: Vec3,
    /// With respect to [`Material::roughness`]; 0 where the clamp bites.
    pub roughness: f32,
    /// With respect to [`Material::metallic`].
    pub metallic: f32,
    /// With respect to the normal, world space: the formula's, which knows the normal only by n·v, n·l and n·h. Not
    /// projected onto the sphere's tangent; the normalisation that made the normal does that.
    pub normal: Vec3,
}

/// A surface point seen from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Shading {
    material: Material,
    normal: Vec3,
    view: Vec3,
    n_v: f32,
    /// α².
    a2: f32,
    /// dα²/droughness.
    a2_slope: f32,
    f0: Vec3,
    /// Diffuse BRDF.
    diffuse: Vec3,
    /// √((n·v)² (1 − α²) + α²).
    masking: f32,
    /// Chance of sampling the highlight.
    chance: f32,
}

/// The reflectance towards one light, and what its gradient needs ([`Shading::accumulate`]).
#[derive(Clone, Copy, Debug)]
pub struct Reflection {
    /// Diffuse term times n·l.
    pub diffuse: Vec3,
    /// Highlight times n·l.
    pub specular: Vec3,
    light: Vec3,
    n_l: f32,
    /// √((n·l)² (1 − α²) + α²).
    shadowing: f32,
    /// v + l.
    double_half: Vec3,
    /// n·(v + l) over `spread`.
    n_h_over_spread: f32,
    n_h: f32,
    /// D.
    distribution: f32,
    /// G₂ / (4 n·v), that is, visibility times n·l.
    visibility: f32,
    /// 1 over the two terms of the visibility's denominator.
    inverse_denominator: f32,
    /// (1 − v·h)⁵.
    fresnel: f32,
}

impl Reflection {
    /// f · n·l.
    #[inline]
    #[must_use]
    pub fn value(&self) -> Vec3 {
        self.diffuse + self.specular
    }
}

impl Shading {
    /// Prepares a point with unit `normal`, seen from the unit direction `view` (away from the surface).
    #[inline]
    #[must_use]
    pub fn new(material: Material, normal: Vec3, view: Vec3) -> Self {
        let roughness = material.roughness.clamp(LEAST_ROUGHNESS, 1.0);
        let square = roughness * roughness;
        let a2 = square * square;
        let n_v = normal.dot(view);
        let f0 = Vec3::splat(DIELECTRIC_F0) + material.metallic * (material.albedo - DIELECTRIC_F0);
        let diffuse = material.albedo * ((1.0 - material.metallic) * FRAC_1_PI);
        // By the share of energy that each lobe is likely to carry.
        let m = (1.0 - n_v).clamp(0.0, 1.0);
        let specular = (f0 + (1.0 - f0) * (m * m) * (m * m) * m).element_sum();
        let matte = std::f32::consts::PI * diffuse.element_sum();
        let chance = if matte > 0.0 {
            (specular / (specular + matte)).clamp(LEAST_CHANCE, 1.0 - LEAST_CHANCE)
        } else {
            1.0
        };
        let a2_slope = if roughness == material.roughness { 4.0 * square * roughness } else { 0.0 };
        let masking = (n_v * n_v * (1.0 - a2) + a2).sqrt();
        Self { material, normal, view, n_v, a2, a2_slope, f0, diffuse, masking, chance }
    }

    /// D for `v + l` with its part along the normal given, and `n·(v + l)` over what D divides by.
    ///
    /// `(n·h)² (α² − 1) + 1` is `|t|² + α² (n·h)²` with the part t of h in the surface's plane; the first form loses
    /// all digits for smooth surfaces, whose α² is of the order of f32's rounding.
    #[inline]
    fn distribution(&self, double_half: Vec3, n_h: f32) -> (f32, f32) {
        let across = (double_half - self.normal * n_h).length_squared();
        let length2 = double_half.length_squared();
        // Never below α² |v + l|² but by rounding; the second bound is for v = −l.
        let spread = (across + self.a2 * n_h * n_h).max(self.a2 * length2).max(1e-30);
        let ratio = length2 / spread;
        (self.a2 * FRAC_1_PI * ratio * ratio, n_h / spread)
    }

    /// The reflectance towards the unit direction `light` (away from the surface); `None` where n·v ≤ 0 or n·l ≤ 0
    /// (or either is NaN), where both value and gradient are 0.
    #[inline]
    #[must_use]
    pub fn reflect(&self, light: Vec3) -> Option<Reflection> {
        let n_l = self.normal.dot(light);
        if !(self.n_v > 0.0 && n_l > 0.0) {
            return None;
        }
        let double_half = self.view + light;
        let n_h = self.n_v + n_l;
        let (distribution, n_h_over_spread) = self.distribution(double_half, n_h);
        let shadowing = (n_l * n_l * (1.0 - self.a2) + self.a2).sqrt();
        let inverse_denominator = 1.0 / (n_l * self.masking + self.n_v * shadowing).max(LEAST_DENOMINATOR);
        let visibility = 0.5 * n_l * inverse_denominator;
        // v·h = |v + l|/2 for unit vectors.
        let m = (1.0 - 0.5 * double_half.length()).max(0.0);
        let fresnel = (m * m) * (m * m) * m;
        Some(Reflection {
            diffuse: self.diffuse * n_l,
            specular: (self.f0 + (1.0 - self.f0) * fresnel) * (distribution * visibility),
            light,
            n_l,
            shadowing,
            double_half,
            n_h_over_spread,
            n_h,
            distribution,
            visibility,
            inverse_denominator,
            fresnel,
        })
    }

    /// f · max(0, n·l); 0 where n·v ≤ 0 or n·l ≤ 0. Finite for every unit `light`, at most
    /// `1/(2π α³) + 1/π` (the highlight's peak at grazing view). Gradient: [`Shading::vjp`].
    #[inline]
    #[must_use]
    pub fn eval_cosine(&self, light: Vec3) -> Vec3 {
        self.reflect(light).map_or(Vec3::ZERO, |r| r.value())
    }

    /// Adds the gradient of `grad · f n·l`, where `grad` is that with respect to [`Shading::eval_cosine`].
    /// Differentiable but at the horizon (n·l = 0, n·v = 0), where it is cut off, and at the roughness' clamp.
    #[inline]
    pub fn vjp(&self, light: Vec3, grad: Vec3, out: &mut MaterialGradient) {
        if let Some(r) = self.reflect(light) {
            self.accumulate(&r, grad, out);
        }
    }

    /// [`Shading::vjp`] for a reflection that has been evaluated already.
    #[inline]
    pub fn accumulate(&self, r: &Reflection, grad: Vec3, out: &mut MaterialGradient) {
        let Material { albedo, metallic, .. } = self.material;
        let lobe = r.distribution * r.visibility;
        // Through F₀ and the diffuse term to albedo and metallic.
        let grad_diffuse = grad * (r.n_l * FRAC_1_PI);
        let grad_f0 = grad * (lobe * (1.0 - r.fresnel));
        out.albedo += grad_diffuse * (1.0 - metallic) + grad_f0 * metallic;
        out.metallic += grad_f0.dot(albedo - DIELECTRIC_F0) - grad_diffuse.dot(albedo);
        // Through D and the visibility to α² and the normal.
        let grad_lobe = grad.dot(self.f0 + (1.0 - self.f0) * r.fresnel);
        let (d, v) = (grad_lobe * r.distribution, grad_lobe * lobe * r.inverse_denominator);
        let (n_v, n_l, flat) = (self.n_v, r.n_l, 1.0 - self.a2);
        let masking_slope = n_l * (1.0 - n_v * n_v) / self.masking;
        let shadowing_slope = n_v * (1.0 - n_l * n_l) / r.shadowing;
        let by_distribution = d * r.visibility * (1.0 / self.a2 - 2.0 * r.n_h * r.n_h_over_spread);
        out.roughness += self.a2_slope * (by_distribution - 0.5 * v * (masking_slope + shadowing_slope));
        let along_light = grad.dot(self.diffuse) + 0.5 * d * r.inverse_denominator
            - v * (self.masking + n_v * n_l * flat / r.shadowing);
        let along_view = -v * (r.shadowing + n_v * n_l * flat / self.masking);
        let along_half = 4.0 * d * r.visibility * flat * r.n_h_over_spread;
        out.normal += r.light * along_light + self.view * along_view + r.double_half * along_half;
    }

    /// Draws a light direction: with the chance of [`Shading::specular_chance`] (`choice` in [0, 1) decides) the
    /// mirror image of the view at a visible microfacet, else from the cosine lobe; `u` are two numbers in [0, 1).
    /// `None` where the direction lies below the surface, or the view does: such a sample counts as 0. Density:
    /// [`Shading::pdf`].
    ///
    /// Visible normals: Dupuy & Benyoub 2023, "Sampling visible GGX normals with spherical caps".
    #[inline]
    #[must_use]
    pub fn sample(&self, choice: f32, u: Vec2) -> Option<Vec3> {
        if !(self.n_v > 0.0) {
            return None;
        }
        let frame = frame::world_from_tangent(self.normal);
        let (sin, cos) = (TAU * u.y).sin_cos();
        let light = if choice < self.chance {
            // Stretched so that the microfacets are a hemisphere; there, mirror directions are uniform on a cap.
            let alpha = self.a2.sqrt();
            let along = self.normal * self.n_v;
            let view = (alpha * (self.view - along) + along).normalize();
            let z = 1.0 - u.x * (1.0 + view.dot(self.normal).min(1.0));
            let r = (1.0 - z * z).max(0.0).sqrt();
            let double_half = frame * Vec3::new(r * cos, r * sin, z) + view;
            let along = self.normal * double_half.dot(self.normal);
            let half = (alpha * (double_half - along) + along).normalize_or(self.normal);
            half * (2.0 * self.view.dot(half)) - self.view
        } else {
            let r = u.x.sqrt();
            frame * Vec3::new(r * cos, r * sin, (1.0 - u.x).max(0.0).sqrt())
        };
        let light = light.normalize();
        (self.normal.dot(light) > 0.0).then_some(light)
    }

    /// [`Shading::sample`] from two numbers: the first chooses the lobe and, stretched, the place in it, so that a
    /// low-discrepancy set stays one within each lobe. Density: [`Shading::pdf`].
    #[inline]
    #[must_use]
    pub fn sample_stretched(&self, u: Vec2) -> Option<Vec3> {
        let x = if u.x < self.chance { u.x / self.chance } else { (u.x - self.chance) / (1.0 - self.chance) };
        self.sample(u.x, Vec2::new(x.min(1.0 - f32::EPSILON / 2.0), u.y))
    }

    /// Density per steradian of [`Shading::sample`] in the unit direction `light`; 0 below the horizon and where the
    /// view is below it. Integrates to the share of samples that are not `None`.
    #[inline]
    #[must_use]
    pub fn pdf(&self, light: Vec3) -> f32 {
        let n_l = self.normal.dot(light);
        if !(self.n_v > 0.0 && n_l > 0.0) {
            return 0.0;
        }
        // Visible normals D G₁ v·h / n·v, over 4 v·h for the reflection; G₁ / n·v = 2 / (n·v + masking).
        let (distribution, _) = self.distribution(self.view + light, self.n_v + n_l);
        let specular = distribution / (2.0 * (self.n_v + self.masking));
        self.chance * specular + (1.0 - self.chance) * n_l * FRAC_1_PI
    }

    /// Chance with which [`Shading::sample`] chooses the highlight: its share of the reflectance as seen from `view`,
    /// in [0.1, 0.9]; 1 where there is no diffuse term.
    #[inline]
    #[must_use]
    pub fn specular_chance(&self) -> f32 {
        self.chance
    }

    /// The material.
    #[must_use]
    pub fn material(&self) -> Material {
        self.material
    }

    /// The unit direction it is seen from, away from the surface.
    #[must_use]
    pub fn view(&self) -> Vec3 {
        self.view
    }

    /// n·v.
    #[inline]
    #[must_use]
    pub fn n_v(&self) -> f32 {
        self.n_v
    }
}

/// [`Shading::eval_cosine`] for a single light.
#[must_use]
pub fn eval_cosine(material: Material, normal: Vec3, view: Vec3, light: Vec3) -> Vec3 {
    Shading::new(material, normal, view).eval_cosine(light)
}

/// [`Shading::vjp`] for a single light.
pub fn eval_cosine_vjp(
    material: Material,
    normal: Vec3,
    view: Vec3,
    light: Vec3,
    grad: Vec3,
    out: &mut MaterialGradient,
) {
    Shading::new(material, normal, view).vjp(light, grad, out);
}

/// [`Shading::sample`] for a single direction.
#[must_use]
pub fn sample(material: Material, normal: Vec3, view: Vec3, choice: f32, u: Vec2) -> Option<Vec3> {
    Shading::new(material, normal, view).sample(choice, u)
}

/// [`Shading::pdf`] for a single direction.
#[must_use]
pub fn pdf(material: Material, normal: Vec3, view: Vec3, light: Vec3) -> f32 {
    Shading::new(material, normal, view).pdf(light)
}
