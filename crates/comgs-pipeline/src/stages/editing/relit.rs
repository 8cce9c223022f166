//! The objects of a composition under its light.

use super::own_light::{OwnLight, is_cached, others, shading_config};
use super::{Baked, Composition, Relight, Settings};
use crate::PipelineError;
use crate::stages::relight::subject::refused;
use comgs_compose::{
    CachedRelighter, FieldShadow, Indirect, Lamp, Mirror, NearField, ObjectShader, RelightConfig,
    RelightError, Relighter, SelfOcclusion, ShadowLight, objects,
};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_light::EnvironmentMap;
use comgs_probe::ProbeSet;
use comgs_raster::Frame;
use comgs_surfel::SurfelCloud;
use comgs_trace::Tracer;
use glam::Vec3;

/// Objects that are shaded anew for every frame.
pub(crate) enum RelitObjects<'a> {
    /// By many samples a pixel.
    Sampled(Box<Relighter<'a>>),
    /// By what is kept on the surfels.
    Cached(Box<CachedRelighter<'a>>),
}

/// What objects are lit with; all of it belongs to a placement.
pub(crate) struct Lighting<'a> {
    /// The merged objects, world space.
    pub cloud: &'a SurfelCloud,
    /// Probes in world space, where [`RelitObjects::probes`] made some.
    pub probes: Option<&'a ProbeSet>,
    /// Of the merged objects, where [`RelitObjects::wants_tracer`].
    pub tracer: Option<&'a Tracer>,
    /// The light as directions and strong lights.
    pub light: &'a ShadowLight,
    /// What the objects hide of each other's light.
    pub baked: Option<&'a Baked>,
    /// What they hide of their own.
    pub own: Option<&'a OwnLight>,
    /// What the scene's nearness makes of the light.
    pub near: Option<NearField>,
}

impl<'a> RelitObjects<'a> {
    /// Probes of the objects in world space, where a single object has them and its light is sampled: probes of one object know
    /// nothing of another, so several are traced.
    pub fn probes(composition: &Composition, settings: &Settings) -> Option<ProbeSet> {
        let [object] = &composition.objects[..] else { return None };
        if settings.relight == Relight::Off || is_cached(composition, settings) {
            return None;
        }
        object.subject.probe_set().map(|set| set.transformed(&object.world_from_object))
    }

    /// Whether cached shading traces what hides the mirror image of the light: several objects, or one without probes.
    pub fn wants_tracer(composition: &Composition, settings: &Settings) -> bool {
        let probes = matches!(&composition.objects[..], [object] if object.subject.probe_set().is_some());
        settings.self_occlusion && !probes && is_cached(composition, settings)
    }

    /// `None` where the settings or an object without material say so.
    ///
    /// # Errors
    /// [`PipelineError::Input`] for what cannot be relit.
    pub fn new(
        composition: &'a Composition,
        lighting: Lighting<'a>,
        map: &EnvironmentMap,
        settings: &Settings,
    ) -> Result<Option<Self>, PipelineError> {
        if settings.relight == Relight::Off || lighting.cloud.material.is_none() {
            return Ok(None);
        }
        let made = if is_cached(composition, settings) {
            Self::cached(composition, lighting, map, settings)
        } else {
            Self::sampled(composition, &lighting, map, settings)
        };
        made.map(Some).map_err(|e| refused(&composition.objects[0].subject.path, &e))
    }

    fn sampled(
        composition: &Composition,
        lighting: &Lighting<'a>,
        map: &EnvironmentMap,
        settings: &Settings,
    ) -> Result<Self, RelightError> {
        let self_occlusion = match (settings.self_occlusion || settings.indirect, lighting.probes) {
            (false, _) => SelfOcclusion::None,
            (true, Some(_)) => SelfOcclusion::Mixed,
            (true, None) => SelfOcclusion::Trace,
        };
        let config = RelightConfig {
            self_occlusion,
            indirect: if settings.indirect { Indirect::OneBounce } else { Indirect::None },
            seed: settings.seed,
            raster: composition.raster(),
            ..shading_config(composition, settings)
        };
        let relighter = Relighter::new(lighting.cloud, lighting.probes, map, config)?;
        Ok(Self::Sampled(Box::new(relighter)))
    }

    fn cached(
        composition: &'a Composition,
        lighting: Lighting<'a>,
        map: &EnvironmentMap,
        settings: &Settings,
    ) -> Result<Self, RelightError> {
        let config = shading_config(composition, settings);
        let standing = lighting.own.map(|own| own.standing(composition)).unwrap_or_default();
        let shadows: Vec<Option<FieldShadow<'_>>> = match lighting.baked {
            Some(baked) if composition.objects.len() > 1 => others(baked, composition)
                .into_iter()
                .map(|others| Some(FieldShadow::new(lighting.light, &others)))
                .collect(),
            _ => standing.iter().map(|_| None).collect(),
        };
        let lit: Vec<_> = standing
            .into_iter()
            .zip(&shadows)
            .map(|((standing, own), others)| (standing, own, others.as_ref()))
            .collect();
        let mirror = match (lighting.tracer, &composition.objects[..]) {
            _ if lit.is_empty() => Mirror::Open,
            (Some(tracer), _) => {
                let radius = objects::bounding_sphere(lighting.cloud).map_or(0.0, |s| s.1);
                Mirror::Trace { tracer, offset: config.trace_offset * 2.0 * radius }
            }
            (None, [object]) => match object.subject.probe_set() {
                Some(set) => Mirror::Probes { set, world_from_object: object.world_from_object },
                None => Mirror::Open,
            },
            _ => Mirror::Open,
        };
        let made =
            CachedRelighter::new(lighting.cloud, &lit, lighting.light, map, mirror, lighting.near, &config)?;
        Ok(Self::Cached(Box::new(made)))
    }
}

impl ObjectShader for RelitObjects<'_> {
    fn carrier(&self) -> Option<&SurfelCloud> {
        match self {
            Self::Sampled(_) => None,
            Self::Cached(relighter) => Some(relighter.carrier()),
        }
    }

    fn shade(&self, camera: &Camera, frame: &Frame) -> Image {
        match self {
            Self::Sampled(relighter) => relighter.shade(camera, frame).radiance,
            Self::Cached(relighter) => relighter.shade(camera, frame),
        }
    }
}

/// The composition's map with its lamps painted in, as they are seen from the middle of the objects: what the objects are
/// lit by. A lamp near an object is too weak on its near side and too strong on its far side.
pub(crate) fn lit_map(composition: &Composition) -> EnvironmentMap {
    let map = &composition.map;
    if composition.lamps.is_empty() {
        return map.clone();
    }
    let small = map.height() < 64;
    let mut image = if small { map.image().resized(128, 64) } else { map.image().clone() };
    for lamp in &composition.lamps {
        let (direction, irradiance) = match *lamp {
            Lamp::Directional { direction, irradiance, .. } => (direction, irradiance),
            Lamp::Point { position, intensity, .. } => {
                let d = position - composition.middle();
                (d, intensity / d.length_squared().max(1e-12))
            }
        };
        if direction.try_normalize().is_none() {
            continue;
        }
        let (u, v) = comgs_geom::equirect::uv_from_direction(direction);
        let x = ((u * image.width as f32) as usize).min(image.width - 1);
        let y = ((v * image.height as f32) as usize).min(image.height - 1);
        let omega = comgs_geom::equirect::texel_solid_angle(y, image.width, image.height);
        let value = Vec3::from_array(image.rgb(x, y)) + irradiance / omega;
        image.pixel_mut(x, y).copy_from_slice(&value.to_array());
    }
    EnvironmentMap::from_image_repaired(&image).map_or_else(|_| map.clone(), |(map, _)| map)
}
