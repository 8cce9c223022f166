//! What a composition stands on: composer, light, near field, the objects' tracer and probes.

use super::Prepared;
use crate::PipelineError;
use crate::stages::editing::{Baked, Composition, RelitObjects, Settings, Shadow};
use comgs_compose::{ComposeConfig, Composer, FieldShadow, NearField, ShadowConfig, ShadowLight};
use comgs_light::EnvironmentSampler;
use comgs_probe::ProbeSet;
use comgs_trace::{TraceConfig, Tracer};
use std::time::Instant;

/// Surfaces nearer to the light's centre than this many radii of the smallest object send it no light of their own: what
/// floats where the object will stand.
const NEAR_CLIP: f32 = 0.2;

/// What must outlive a [`Renderer`].
pub(crate) struct Ground<'a> {
    pub composer: Composer<'a>,
    pub light: ShadowLight,
    /// The near field, and the light with its strong lights where the scene has them.
    pub near: Option<(NearField, ShadowLight)>,
    scene_tracer: &'a Tracer,
    pub object_tracer: Option<Tracer>,
    pub probes: Option<ProbeSet>,
    pub prepared: Prepared,
}

impl<'a> Ground<'a> {
    /// Composer, light, probes of the objects.
    ///
    /// # Errors
    /// [`PipelineError`].
    pub fn new(
        composition: &'a Composition,
        scene_tracer: &'a Tracer,
        sampler: &'a EnvironmentSampler,
        settings: &Settings,
    ) -> Result<Self, PipelineError> {
        Self::with_near(composition, scene_tracer, sampler, settings, None)
    }

    /// [`Ground::new`] with the near field of an earlier one, which does not depend on where the objects stand.
    ///
    /// # Errors
    /// [`PipelineError`].
    pub fn with_near(
        composition: &'a Composition,
        scene_tracer: &'a Tracer,
        sampler: &'a EnvironmentSampler,
        settings: &Settings,
        known: Option<NearField>,
    ) -> Result<Self, PipelineError> {
        let mut prepared = Prepared::default();
        let start = Instant::now();
        let light =
            ShadowLight::new(&composition.map, &composition.lamps, &settings.light()).map_err(|e| {
                PipelineError::input("the composition's lamps", "lights that can shine", e.to_string())
            })?;
        let near = settings.near_field.then(|| {
            let radius = composition.spheres().iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
            let (centre, split) = (composition.light_centre(), settings.light().split);
            let near = known.unwrap_or_else(|| {
                NearField::new(scene_tracer, centre, NEAR_CLIP * radius, &composition.map, split.as_ref())
            });
            let located = near.located(light.clone());
            (near, located)
        });
        prepared.light_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let traced = settings.shadow == Shadow::Trace && composition.wants_shadow();
        let shadow =
            ShadowConfig { rays: settings.shadow_rays(), seed: settings.seed, ..ShadowConfig::default() };
        let config = ComposeConfig {
            raster: composition.raster(),
            shadow: traced.then_some(shadow),
            ..ComposeConfig::default()
        };
        let composer =
            Composer::new(&composition.scene.surfels, scene_tracer, &composition.placed(), sampler, config)?;
        let traced = settings.shadow == Shadow::Probes || RelitObjects::wants_tracer(composition, settings);
        let object_tracer =
            traced.then(|| Tracer::new(composer.objects(), &TraceConfig::occlusion())).transpose()?;
        prepared.merge_s = start.elapsed().as_secs_f64();
        Ok(Self {
            composer,
            light,
            near,
            scene_tracer,
            object_tracer,
            probes: RelitObjects::probes(composition, settings),
            prepared,
        })
    }
}

impl Ground<'_> {
    /// The light for some settings, which may do without the near field.
    pub fn light_for(&self, settings: &Settings) -> &ShadowLight {
        self.near.as_ref().filter(|_| settings.near_field).map_or(&self.light, |(_, located)| located)
    }

    /// The objects' shadow from their fields, past the scene's own.
    pub fn field_shadow<'b>(
        &'b self,
        composition: &Composition,
        baked: &'b Baked,
        settings: &Settings,
    ) -> FieldShadow<'b> {
        let smallest = composition.spheres().iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
        FieldShadow::new(self.light_for(settings), &baked.placed(composition))
            .with_scene(self.scene_tracer, CLEARANCE * smallest)
    }
}

/// Radii of the smallest object within which the scene does not hide a strong light from its own surface, whose surfels lie
/// about it rather than on it.
const CLEARANCE: f32 = 0.3;
