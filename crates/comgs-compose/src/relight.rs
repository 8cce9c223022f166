//! A decomposed object under another light (ComGS § 3.3).
//!
//! ```text
//! L_o(v, x) = ∫ f(v, ω, x) ((1 − O(ω)) L_dir(ω) + L_in(ω)) max(0, n·ω) dω          Eq. 6, 8
//! ```
//!
//! A G-buffer is rasterised, its pixels become shading [`points`] at unbiased depth, and the integral is estimated at each
//! of them. The paper draws directions by the light alone (Eq. 18), which drowns in noise where a polished surface
//! mirrors what the light table seldom visits. Here light and BRDF both propose directions and share the integral by
//! multiple importance sampling ([`Heuristic`]): a matte surface under a small sun and a polished one under a sky are
//! both quiet. The map is piecewise constant ([`EnvironmentMap::radiance`]) and the light's density exact, so one texel of
//! 10⁵ costs no more than any other (`tests/relight.rs`).
//!
//! O comes from the object's probes, from rays, or from both ([`SelfOcclusion`]); L_in, which the paper leaves out here, from [`bounce`] on request.
//!
//! Frames of a placement whose light stays are cheaper by [`cached`]: the matte part kept on the surfels, the highlight from few
//! directions. [`Relighter`] is what it is judged by.
//!
//! [`mod@reference`] says the same in f64 by brute force over all texels.

pub mod bounce;
pub mod cached;
mod config;
mod frame;
mod layers;
mod light_sets;
pub mod near_field;
pub mod points;
pub mod reference;
pub mod self_visibility;
mod shade;
mod strong;
mod surroundings;

pub use cached::{CachedRelighter, Mirror};
pub use config::{Heuristic, Indirect, RelightConfig, RelightError, SelfOcclusion};
pub use frame::{RelitFrame, RelitLayers, RelitStats};
pub use layers::write_relit_layers;
pub use near_field::NearField;
pub use points::Point;
pub use self_visibility::{SelfVisibility, Standing, SurfelLight};
pub use shade::Lit;

use crate::objects::bounding_sphere;
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_light::{EnvironmentMap, EnvironmentSampler};
use comgs_probe::{BakeObserver, ProbeError, ProbeSet};
use comgs_raster::{Frame, Planes, surface_normals};
use comgs_surfel::{MaterialColumns, SurfelCloud};
use comgs_trace::{TraceConfig, Tracer};
use light_sets::LightSets;
use rayon::prelude::*;
use shade::streams;
use std::borrow::Cow;
use std::time::Instant;
use surroundings::{Around, Probes, Surroundings};

/// Samples a pixel for [`RelitLayers::visibility`].
const VISIBILITY_RAYS: u32 = 64;
/// Points that a thread shades in one go.
const CHUNK: usize = 32;

/// An object and a light, prepared to be seen by any camera.
pub struct Relighter<'a> {
    cloud: &'a SurfelCloud,
    light: EnvironmentSampler,
    sets: LightSets,
    surroundings: Surroundings<'a>,
    config: RelightConfig,
    preparation: Preparation,
}

/// Seconds of [`Relighter::new`] by part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Preparation {
    /// Checks, the light's tables, the probes' index.
    pub tables_s: f64,
    /// Trees for tracing.
    pub trees_s: f64,
    /// Light that the surfels scatter.
    pub bounce_s: f64,
    /// Probes that are baked under it.
    pub bake_s: f64,
}

impl Preparation {
    /// All of it.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.tables_s + self.trees_s + self.bounce_s + self.bake_s
    }
}

impl<'a> Relighter<'a> {
    /// Prepares an object in world space and a light.
    ///
    /// `probes` are looked at only with [`SelfOcclusion::Probes`] and [`SelfOcclusion::Mixed`]. With [`Indirect::OneBounce`] their radiance is baked
    /// anew in a copy; their occlusion stays as it is.
    ///
    /// # Errors
    /// [`RelightError`]: no material, no probes where they are needed, an unsound configuration, cloud or probe set.
    pub fn new(
        cloud: &'a SurfelCloud,
        probes: Option<&'a ProbeSet>,
        light: &EnvironmentMap,
        config: RelightConfig,
    ) -> Result<Self, RelightError> {
        Self::prepare(cloud, probes, light, config, BakeObserver::silent())
    }

    /// [`Relighter::new`], which `observer` may stop while probes are baked.
    ///
    /// # Errors
    /// As [`Relighter::new`]; [`RelightError::Probes`] with [`ProbeError::Cancelled`] when stopped.
    pub fn prepare(
        cloud: &'a SurfelCloud,
        probes: Option<&'a ProbeSet>,
        light: &EnvironmentMap,
        config: RelightConfig,
        observer: BakeObserver<'_>,
    ) -> Result<Self, RelightError> {
        let mut preparation = Preparation::default();
        let start = Instant::now();
        let (material, diameter) = check(cloud, &config)?;
        let light = EnvironmentSampler::new(light);
        let sets = LightSets::new(&light, config.light_rays, config.seed, streams::LIGHT);
        let mut surroundings = surroundings(cloud, probes, &config, diameter, &mut preparation)?;
        preparation.tables_s = start.elapsed().as_secs_f64() - preparation.trees_s;
        if config.indirect == Indirect::OneBounce {
            let start = Instant::now();
            let glowing = bounce::glowing(cloud, material, &surroundings, &light, &config);
            preparation.bounce_s = start.elapsed().as_secs_f64();
            let start = Instant::now();
            let glowing = tracer(&glowing)?;
            preparation.trees_s += start.elapsed().as_secs_f64();
            let start = Instant::now();
            surroundings = lit_by(surroundings, glowing, observer)?;
            preparation.bake_s = start.elapsed().as_secs_f64();
        }
        Ok(Self { cloud, light, sets, surroundings, config, preparation })
    }

    /// What the preparation cost.
    #[must_use]
    pub fn preparation(&self) -> Preparation {
        self.preparation
    }

    /// The configuration it was made with.
    #[must_use]
    pub fn config(&self) -> &RelightConfig {
        &self.config
    }

    /// One frame. Parallel over pixels, the same bytes at any thread count.
    #[must_use]
    pub fn render(&self, camera: &Camera) -> RelitFrame {
        let start = Instant::now();
        let frame = comgs_raster::render(self.cloud, camera, Planes::ALL, &self.config.raster);
        let raster_s = start.elapsed().as_secs_f64();
        let mut out = self.shade(camera, &frame);
        out.stats.raster_s = raster_s;
        out
    }

    /// [`Relighter::render`] from a G-buffer of all planes that the camera has already seen.
    #[must_use]
    pub fn shade(&self, camera: &Camera, frame: &Frame) -> RelitFrame {
        let start = Instant::now();
        let normals = surface_normals(frame, camera);
        let lit: Vec<(u32, Lit, f32)> = points::points(frame, camera, normals.as_ref())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map_init(
                || Around::new(&self.surroundings),
                |around, (pixel, point)| {
                    let (lit, visibility) = self.shade_point(&point, u64::from(pixel), around);
                    (pixel, lit, visibility)
                },
            )
            .collect();
        let mut out = RelitFrame::assemble(frame, normals.as_ref(), &lit, self.config.layers);
        out.stats.shade_s = start.elapsed().as_secs_f64();
        out
    }

    /// Radiance that leaves one point, with the random rotations of stream `stream` (in a frame, the number of the pixel).
    /// Unbiased for the surroundings that were prepared; reference: [`reference::radiance`].
    #[must_use]
    pub fn radiance(&self, point: &Point, stream: u64) -> Lit {
        self.shade_point(point, stream, &mut Around::new(&self.surroundings)).0
    }

    /// 1 − O and L_in at a point with a unit normal, from a unit direction (ComGS Eq. 8).
    #[must_use]
    pub fn incident(&self, point: &Point, direction: glam::Vec3) -> (f32, glam::Vec3) {
        let mut around = Around::new(&self.surroundings);
        around.go_to(point.position, point.normal);
        around.look(direction)
    }

    fn shade_point(&self, point: &Point, stream: u64, around: &mut Around<'_>) -> (Lit, f32) {
        around.go_to(point.position, point.normal);
        let lit = shade::shade(point, stream, &self.light, &self.sets, around, &self.config);
        let visibility = if self.config.layers {
            let stream = streams::VISIBILITY + stream;
            shade::visibility(point.normal, stream, around, VISIBILITY_RAYS, self.config.seed)
        } else {
            0.0
        };
        (lit, visibility)
    }

    /// What the camera sees of the light behind the object: the map, bilinear, 3 channels.
    #[must_use]
    pub fn background(&self, camera: &Camera) -> Image {
        background(self.light.map(), camera)
    }
}

/// What a camera sees of a map, bilinear ([`EnvironmentMap::lookup`]), 3 channels.
#[must_use]
pub fn background(map: &EnvironmentMap, camera: &Camera) -> Image {
    let mut out = Image::zeros(camera.width, camera.height, 3);
    out.data.par_chunks_exact_mut(3 * camera.width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            pixel.copy_from_slice(&map.lookup(ray.as_vec3()).to_array());
        }
    });
    out
}

/// The material and the diameter of an object's bounding sphere, when all is sound.
fn check<'a>(
    cloud: &'a SurfelCloud,
    config: &RelightConfig,
) -> Result<(&'a MaterialColumns, f32), RelightError> {
    let problems = config.check();
    if !problems.is_empty() {
        return Err(RelightError::Config(problems));
    }
    let mut problems = cloud.problems();
    let material = cloud.material.as_ref().ok_or(RelightError::NoMaterial)?;
    let logits = [
        material.albedo_logits.as_flattened(),
        &material.roughness_logits[..],
        &material.metallic_logits[..],
    ];
    for (name, logits) in ["albedo_logits", "roughness_logits", "metallic_logits"].into_iter().zip(logits) {
        let bad = logits.iter().filter(|v| v.is_nan()).count();
        if bad > 0 {
            problems.push(format!("column {name} has {bad} values that are not numbers"));
        }
    }
    if !problems.is_empty() {
        return Err(RelightError::Cloud(problems));
    }
    let (_, radius) = bounding_sphere(cloud).ok_or(RelightError::Invisible(cloud.len()))?;
    Ok((material, 2.0 * radius))
}

/// What the object hides, without what it sends.
fn surroundings<'a>(
    cloud: &SurfelCloud,
    probes: Option<&'a ProbeSet>,
    config: &RelightConfig,
    diameter: f32,
    preparation: &mut Preparation,
) -> Result<Surroundings<'a>, RelightError> {
    let offset = config.trace_offset * diameter;
    let start = Instant::now();
    let tracer = match config.self_occlusion {
        SelfOcclusion::Trace | SelfOcclusion::Mixed => Some(tracer(cloud)?),
        SelfOcclusion::Probes | SelfOcclusion::None => None,
    };
    preparation.trees_s = start.elapsed().as_secs_f64();
    Ok(match (config.self_occlusion, tracer) {
        (SelfOcclusion::Trace, Some(tracer)) => Surroundings::Trace { tracer, offset, glowing: false },
        (SelfOcclusion::Probes | SelfOcclusion::Mixed, tracer) => {
            let set = sound(probes.ok_or(RelightError::NoProbes)?)?;
            Surroundings::Probes(Probes { rays: tracer.map(|t| (t, offset)), ..Probes::new(set, config) })
        }
        (SelfOcclusion::Trace | SelfOcclusion::None, _) => Surroundings::Open,
    })
}

/// Probes that can be looked up.
fn sound(set: &ProbeSet) -> Result<&ProbeSet, RelightError> {
    let problems = set.problems();
    if !problems.is_empty() {
        return Err(RelightError::Probes(ProbeError::Set(problems)));
    }
    if set.is_empty() { Err(RelightError::NoProbes) } else { Ok(set) }
}

fn tracer(cloud: &SurfelCloud) -> Result<Tracer, RelightError> {
    Tracer::new(cloud, &TraceConfig::occlusion()).map_err(RelightError::Trace)
}

/// The surroundings when the object has the colours of `glowing`.
fn lit_by<'a>(
    surroundings: Surroundings<'a>,
    glowing: Tracer,
    observer: BakeObserver<'_>,
) -> Result<Surroundings<'a>, RelightError> {
    Ok(match surroundings {
        Surroundings::Open => Surroundings::Open,
        Surroundings::Trace { offset, .. } => Surroundings::Trace { tracer: glowing, offset, glowing: true },
        Surroundings::Probes(probes) => {
            let mut set = probes.set.into_owned();
            let occlusion: Vec<f32> = set.texels.iter().map(|t| t[3]).collect();
            let moments = set.moments.clone();
            comgs_probe::bake(&glowing, &mut set, 1, observer).map_err(RelightError::Probes)?;
            // What was learnt about occlusion stays.
            set.texels.iter_mut().zip(occlusion).for_each(|(t, o)| t[3] = o);
            set.moments = moments;
            Surroundings::Probes(Probes { set: Cow::Owned(set), glowing: true, ..probes })
        }
    })
}
