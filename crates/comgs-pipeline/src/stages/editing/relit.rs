//! The objects of a composition under its light.

use super::{Composition, Relight, Settings};
use crate::PipelineError;
use crate::stages::relight::subject::refused;
use comgs_compose::{Indirect, Lamp, ObjectShader, RelightConfig, Relighter, SelfOcclusion};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_inverse::Quality;
use comgs_light::EnvironmentMap;
use comgs_probe::ProbeSet;
use comgs_raster::Frame;
use comgs_surfel::SurfelCloud;
use glam::Vec3;

/// Objects that are shaded anew for every frame.
pub(crate) struct RelitObjects<'a> {
    relighter: Relighter<'a>,
}

impl<'a> RelitObjects<'a> {
    /// Probes of the objects in world space, where a single object has them: probes of one object know nothing of another,
    /// so several are traced.
    pub fn probes(composition: &Composition) -> Option<ProbeSet> {
        let [object] = &composition.objects[..] else { return None };
        object.subject.probe_set().map(|set| set.transformed(&object.world_from_object))
    }

    /// `None` where the settings or an object without material say so. `cloud` is the merged objects in world space.
    ///
    /// # Errors
    /// [`PipelineError::Input`] for what cannot be relit.
    pub fn new(
        composition: &Composition,
        cloud: &'a SurfelCloud,
        probes: Option<&'a ProbeSet>,
        map: &EnvironmentMap,
        settings: &Settings,
    ) -> Result<Option<Self>, PipelineError> {
        if settings.relight == Relight::Off || cloud.material.is_none() {
            return Ok(None);
        }
        let preset = match settings.quality {
            Quality::Draft => RelightConfig::draft(),
            Quality::Balanced => RelightConfig::balanced(),
            Quality::Reference => RelightConfig::reference(),
        };
        let lookup = composition.objects[0].subject.probes.as_ref();
        let preset = lookup.map_or(preset.clone(), |(_, lookup)| preset.with_lookup(lookup));
        let self_occlusion = match (settings.self_occlusion || settings.indirect, probes) {
            (false, _) => SelfOcclusion::None,
            (true, Some(_)) => SelfOcclusion::Mixed,
            (true, None) => SelfOcclusion::Trace,
        };
        let config = RelightConfig {
            self_occlusion,
            indirect: if settings.indirect { Indirect::OneBounce } else { Indirect::None },
            seed: settings.seed,
            raster: composition.raster(),
            ..preset
        };
        let relighter = Relighter::new(cloud, probes, map, config)
            .map_err(|e| refused(&composition.objects[0].subject.path, &e))?;
        Ok(Some(Self { relighter }))
    }
}

impl ObjectShader for RelitObjects<'_> {
    fn shade(&self, camera: &Camera, frame: &Frame) -> Image {
        self.relighter.shade(camera, frame).radiance
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
