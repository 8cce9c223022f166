//! Relighting whose matte part is worked out once a light and read every frame.
//!
//! ```text
//! L_o = (1 − metallic) albedo/π · E(n) · ratio + Σ_s f_spec cos θ / (m q) · (V L̄ + (1 − V) L_glow)
//! ```
//!
//! * E(n) is the irradiance of the open surface by the pixel's own normal, a lookup ([`MipLight::irradiance`]).
//! * `ratio` is what the object's shadow on itself, a near lamp and bounced light make of it. It belongs to the surfels
//!   ([`SurfelLight`]), is splatted with the G-buffer as their colour ([`CachedRelighter::carrier`]), and knows the surfel's normal
//!   only as far as occlusion depends on it, so that the surfels' rough normals do not show.
//! * The highlight is a handful of directions of its own lobe, the same set at every pixel and therefore without noise, each
//!   with the mean radiance L̄ of the solid angle that it stands for ([`MipLight::radiance`]), V from the probes around
//!   the point (one lookup a direction; a ray without probes).

use super::points::{self, Point};
use super::{NearField, RelightConfig, RelightError, SelfVisibility, Standing, SurfelLight};
use crate::FieldShadow;
use crate::shadow_light::ShadowLight;
use comgs_geom::sampling::hammersley;
use comgs_geom::{Camera, Similarity};
use comgs_image::Image;
use comgs_light::brdf::DIELECTRIC_F0;
use comgs_light::{EnvironmentMap, Material, MipLight, Shading};
use comgs_probe::{LookupConfig, ProbeConfig, ProbeIndex, ProbeSet};
use comgs_raster::{Frame, surface_normals};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use comgs_trace::Tracer;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;

/// Roughness from which on the highlight takes all of its directions.
const ALL_FROM: f32 = 0.3;
/// Points that a thread shades in one go.
const CHUNK: usize = 64;

/// What hides the mirror image of the light.
pub enum Mirror<'a> {
    /// Nothing.
    Open,
    /// The probes of a single object, in its own space.
    Probes {
        /// Its probes.
        set: &'a ProbeSet,
        /// Its place.
        world_from_object: Similarity,
    },
    /// Rays through all objects, world space.
    Trace {
        /// Of the merged objects.
        tracer: &'a Tracer,
        /// Height above the surface at which rays start, world units.
        offset: f32,
    },
}

#[allow(clippy::large_enum_variant, reason = "there is one a relighter")]
enum Hidden<'a> {
    Open,
    Probes {
        set: &'a ProbeSet,
        index: ProbeIndex,
        lookup: LookupConfig,
        object_from_world: Similarity,
        /// Mean radiance of what each probe sees of the object; empty without bounced light.
        glow: Vec<Vec3>,
    },
    Trace {
        tracer: &'a Tracer,
        offset: f32,
    },
}

/// Objects and a light, prepared to be seen by any camera.
pub struct CachedRelighter<'a> {
    light: MipLight,
    carrier: SurfelCloud,
    hidden: Hidden<'a>,
    near: Option<NearField>,
    /// Directions of the highlight at most.
    samples: u32,
}

impl<'a> CachedRelighter<'a> {
    /// * `cloud`: the merged objects in world space, with material; what [`CachedRelighter::shade`] is handed must be a
    ///   rendering of [`CachedRelighter::carrier`]
    /// * `objects`: where each stands and what it hides from itself, in the order in which they were merged; empty without
    ///   self-occlusion
    /// * `shadow_light`: the light as directions and strong lights (lamps included); `map`: all of it as the objects see it
    /// * the last of each object: the shadow of the other objects under `shadow_light`, where there are such
    /// * `near`: what the scene's nearness makes of the light; applied where `objects` are given
    ///
    /// # Errors
    /// [`RelightError`]: no material, a configuration out of range, surfels that `objects` do not add up to.
    pub fn new(
        cloud: &SurfelCloud,
        objects: &[(Standing<'_>, &SelfVisibility, Option<&FieldShadow<'_>>)],
        shadow_light: &ShadowLight,
        map: &EnvironmentMap,
        mirror: Mirror<'a>,
        near: Option<NearField>,
        config: &RelightConfig,
    ) -> Result<Self, RelightError> {
        super::check(cloud, config)?;
        let light = MipLight::new(map);
        let middle = objects.iter().map(|o| o.0.middle()).sum::<Vec3>() / objects.len().max(1) as f32;
        let mut lights: Vec<SurfelLight> = Vec::new();
        for (standing, own, others) in objects {
            let made = own.light(standing, shadow_light, &light, middle, *others, near.as_ref());
            lights.push(made);
        }
        let count: usize = lights.iter().map(|l| l.ratios.len()).sum();
        if !objects.is_empty() && count != cloud.len() {
            let text = format!("the objects have {count} surfels, merged they have {}", cloud.len());
            return Err(RelightError::Cloud(vec![text]));
        }
        let hidden = match mirror {
            Mirror::Open => Hidden::Open,
            Mirror::Trace { tracer, offset } => Hidden::Trace { tracer, offset },
            Mirror::Probes { set, world_from_object } => {
                let set = super::sound(set)?;
                let probes = ProbeConfig {
                    neighbours: config.neighbours,
                    radius: config.radius,
                    visibility: config.hidden_probes,
                    ..ProbeConfig::default()
                };
                Hidden::Probes {
                    set,
                    index: set.index(&probes),
                    lookup: LookupConfig::new(set, &probes),
                    object_from_world: world_from_object.inverse(),
                    glow: lights.first_mut().map(|l| std::mem::take(&mut l.glow)).unwrap_or_default(),
                }
            }
        };
        let ratios: Vec<Vec3> = if lights.is_empty() {
            vec![Vec3::ONE; cloud.len()]
        } else {
            lights.into_iter().flat_map(|l| l.ratios).collect()
        };
        let carrier = carrier(cloud, &ratios);
        Ok(Self { light, carrier, hidden, near, samples: config.highlight_rays.max(1) })
    }

    /// The cloud whose colours are the ratios: what frames are to be rendered of, all planes.
    #[must_use]
    pub fn carrier(&self) -> &SurfelCloud {
        &self.carrier
    }

    /// Premultiplied linear radiance, 3 channels, of a rendering of the carrier with all planes. Parallel over pixels, the same
    /// bytes at any thread count. Not differentiable. Reference: [`super::Relighter::shade`] at many samples.
    #[must_use]
    pub fn shade(&self, camera: &Camera, frame: &Frame) -> Image {
        let mut out = Image::zeros(frame.weight.width, frame.weight.height, 3);
        let Some(ratio) = &frame.color else { return out };
        let normals = surface_normals(frame, camera);
        let lit: Vec<(u32, Vec3)> = points::points(frame, camera, normals.as_ref())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|(pixel, point)| {
                let i = pixel as usize;
                // The ratio's plane is premultiplied already, so the matte term comes out so too.
                let matte = self.matte(&point) * Vec3::from_slice(&ratio.data[3 * i..]);
                (pixel, matte + frame.weight.data[i] * self.highlight(&point))
            })
            .collect();
        for (pixel, radiance) in lit {
            let i = 3 * pixel as usize;
            out.data[i..i + 3].copy_from_slice(&radiance.to_array());
        }
        out
    }

    /// The matte term of the open surface.
    fn matte(&self, point: &Point) -> Vec3 {
        let m = point.material;
        (1.0 - m.metallic) * FRAC_1_PI * m.albedo * self.light.irradiance(point.normal)
    }

    /// The highlight.
    fn highlight(&self, point: &Point) -> Vec3 {
        let m = point.material;
        let f0 = Vec3::splat(DIELECTRIC_F0).lerp(m.albedo, m.metallic);
        // A metal of this reflectance has the same highlight and nothing else, so that every direction is one of its lobe.
        let shading = Shading::new(Material { albedo: f0, metallic: 1.0, ..m }, point.normal, point.view);
        let share = (m.roughness / ALL_FROM).clamp(0.0, 1.0);
        let samples = (self.samples as f32 * share).ceil().clamp(1.0, self.samples as f32) as u32;
        let near = match &self.hidden {
            Hidden::Probes { set, index, lookup, object_from_world, .. } => {
                let own = object_from_world.transform_point(point.position.as_dvec3()).as_vec3();
                let turn = object_from_world.rotation.as_quat();
                Some((index.query(own, turn * point.normal, set, lookup), turn))
            }
            _ => None,
        };
        let from = self.near.as_ref().map(|field| field.from(point.position));
        let mut sum = Vec3::ZERO;
        for s in 0..samples {
            let Some(direction) =
                shading.sample(0.0, hammersley(s, samples, Vec2::splat(0.5 / samples as f32)))
            else {
                continue;
            };
            let Some(reflection) = shading.reflect(direction) else { continue };
            let density = samples as f32 * shading.pdf(direction);
            if !(density > 0.0) {
                continue;
            }
            let mut radiance = match (&self.near, &from) {
                (Some(field), Some(from)) => {
                    let (looked, kept) = field.towards(from, direction);
                    kept * self.light.radiance(looked, 1.0 / density)
                }
                _ => self.light.radiance(direction, 1.0 / density),
            };
            match (&self.hidden, &near) {
                (Hidden::Probes { set, glow, .. }, Some((near, turn))) => {
                    let hidden = set.lookup(near, *turn * direction)[3].clamp(0.0, 1.0);
                    radiance *= 1.0 - hidden;
                    if !glow.is_empty() {
                        radiance += hidden * near.iter().map(|(probe, w)| w * glow[probe]).sum::<Vec3>();
                    }
                }
                (Hidden::Trace { tracer, offset }, _) => {
                    let origin = point.position + *offset * point.normal;
                    radiance *= tracer.transmittance(origin, direction, 0.0, f32::INFINITY);
                }
                _ => {}
            }
            sum += reflection.specular / density * radiance;
        }
        sum
    }
}

impl Standing<'_> {
    /// The middle of the object's bounding sphere, world.
    fn middle(&self) -> Vec3 {
        let (centre, _) = crate::objects::bounding_sphere(self.cloud).unwrap_or_default();
        self.world_from_object.transform_point(centre.as_dvec3()).as_vec3()
    }

    /// Surfels' centres, world.
    pub(super) fn points(&self) -> Vec<Vec3> {
        let to_world =
            |p: &[f32; 3]| self.world_from_object.transform_point(Vec3::from_array(*p).as_dvec3()).as_vec3();
        self.cloud.positions.iter().map(to_world).collect()
    }
}

/// The cloud with ratios as its only colour.
fn carrier(cloud: &SurfelCloud, ratios: &[Vec3]) -> SurfelCloud {
    let constant = comgs_geom::sh::basis(0, Vec3::Z)[0];
    SurfelCloud {
        positions: cloud.positions.clone(),
        rotations: cloud.rotations.clone(),
        log_scales: cloud.log_scales.clone(),
        opacity_logits: cloud.opacity_logits.clone(),
        sh: ratios.iter().flat_map(|c| c.to_array().map(|v| (v - 0.5) / constant)).collect(),
        sh_degree: 0,
        color_encoding: ColorEncoding::Linear,
        material: cloud.material.clone(),
    }
}
