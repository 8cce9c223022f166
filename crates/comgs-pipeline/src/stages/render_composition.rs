//! `render --composition`: frames of a composition, with shadows from a cache, objects under its light, and only the
//! effects that are asked for.

mod bounce;
mod ground;
mod seen;
mod stage;

pub(crate) use ground::Ground;
pub(crate) use seen::Seen;
pub use stage::{Config, Input, Output, run, run_planned};

use crate::PipelineError;
use crate::stages::editing::{
    Baked, Composition, Lighting, OwnLight, RelitObjects, Settings, Shadow, lit_map,
};
use bounce::seen_radiance;
use comgs_compose::{
    CacheConfig, CacheStatistics, CameraLook, ComposedFrame, Composer, ObjectFrame, ObjectShader,
    ReceiverCloud, SceneFrame, SceneProbeConfig, SceneProbes, ShadowCache, ShadowRatios, ShadowSource,
};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_probe::BakeObserver;
use glam::Vec3;
use std::time::Instant;

/// Seconds of preparing a composition, by part.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Prepared {
    /// Cutting the light.
    pub light_s: f64,
    /// Merging the objects.
    pub merge_s: f64,
    /// What the cameras see of the scene.
    pub receivers_s: f64,
    /// Probes in the scene, where they are used.
    pub probes_s: f64,
    /// The shadow cache.
    pub cache_s: f64,
    /// Preparing the relighting.
    pub relight_s: f64,
    /// What the objects throw back.
    pub bounce_s: f64,
}

impl Prepared {
    /// All of it.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.light_s
            + self.merge_s
            + self.receivers_s
            + self.probes_s
            + self.cache_s
            + self.relight_s
            + self.bounce_s
    }
}

/// What frames are rendered with: everything that does not depend on the camera.
pub(crate) struct Renderer<'a> {
    pub composer: &'a Composer<'a>,
    exact: Option<Box<dyn ShadowRatios + 'a>>,
    cache: Option<ShadowCache>,
    relit: Option<RelitObjects<'a>>,
    pub prepared: Prepared,
    shadow: Shadow,
    near_only: bool,
    /// What the photos' camera adds.
    look: CameraLook,
    seed: u64,
    /// Tells frames of one camera apart: the step of a movement.
    pub step: u64,
}

/// Which parts of a frame are to be made anew.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Parts {
    pub objects: bool,
    pub shadow: bool,
    /// The shadow cache, where it is not that of the quality.
    pub cache: Option<CacheConfig>,
}

/// What of a frame is known from an earlier one of the same camera.
#[derive(Clone, Copy, Default)]
pub(crate) struct Known<'a> {
    pub object: Option<&'a ObjectFrame>,
    pub shadow: Option<&'a Image>,
}

impl<'a> Renderer<'a> {
    /// Prepares shadows and shading.
    ///
    /// # Errors
    /// [`PipelineError`].
    pub fn new(
        composition: &'a Composition,
        ground: &'a Ground<'a>,
        baked: Option<&'a Baked>,
        own: Option<&'a OwnLight>,
        receivers: &ReceiverCloud,
        settings: &Settings,
    ) -> Result<Self, PipelineError> {
        let all = Parts { objects: true, shadow: true, cache: None };
        Self::for_parts(composition, ground, baked, own, receivers, settings, all)
    }

    /// [`Renderer::new`] for frames of which some parts are known: others must not be asked for.
    ///
    /// # Errors
    /// [`PipelineError`].
    pub fn for_parts(
        composition: &'a Composition,
        ground: &'a Ground<'a>,
        baked: Option<&'a Baked>,
        own: Option<&'a OwnLight>,
        receivers: &ReceiverCloud,
        settings: &Settings,
        parts: Parts,
    ) -> Result<Self, PipelineError> {
        let mut prepared = ground.prepared;
        let shadow = match composition.wants_shadow() && parts.shadow {
            true => settings.shadow,
            false => Shadow::None,
        };
        let start = Instant::now();
        // A floor in the objects' shadow sends them less light.
        let casts = settings.shadow == Shadow::Auto && composition.wants_shadow();
        let near = ground.near.as_ref().filter(|_| settings.near_field && parts.objects);
        let near = near.map(|(near, _)| match baked.filter(|_| casts) {
            Some(baked) => near.clone().with_shadow(&ground.field_shadow(composition, baked, settings)),
            None => near.clone(),
        });
        let lighting = Lighting {
            cloud: ground.composer.objects(),
            probes: ground.probes.as_ref(),
            tracer: ground.object_tracer.as_ref(),
            light: ground.light_for(settings),
            baked,
            own,
            near,
        };
        // Bounced light is the objects' own.
        let relit = match parts.objects || (settings.bounce && shadow != Shadow::None) {
            true => RelitObjects::new(composition, lighting, &lit_map(composition), settings)?,
            false => None,
        };
        prepared.relight_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let exact: Option<Box<dyn ShadowRatios + 'a>> = match (shadow, baked) {
            (Shadow::Auto, Some(baked)) => {
                let field = ground.field_shadow(composition, baked, settings);
                Some(Box::new(if settings.bounce {
                    let seen = seen_radiance(composition, &ground.composer, relit.as_ref());
                    field.with_bounce(move |_, d| seen.towards(d))
                } else {
                    field
                }))
            }
            (Shadow::Probes, _) => scene_probes(composition, ground, receivers)?,
            _ => None,
        };
        let spent = start.elapsed().as_secs_f64();
        match shadow {
            Shadow::Probes => prepared.probes_s = spent,
            _ => prepared.bounce_s = spent,
        }
        let cache = exact.as_ref().map(|exact| {
            let config = parts.cache.unwrap_or_else(|| settings.cache());
            let cache = ShadowCache::build(receivers, exact.as_ref(), &config);
            prepared.cache_s = cache.statistics().seconds;
            cache
        });
        let look = composition.look.unwrap_or_default();
        let look = CameraLook {
            defocus: look.defocus.filter(|_| settings.defocus),
            noise: look.noise.filter(|_| settings.noise),
        };
        let (composer, seed, near_only) = (&ground.composer, settings.seed, settings.near_only);
        Ok(Self { composer, exact, cache, relit, prepared, shadow, near_only, look, seed, step: 0 })
    }

    /// One frame.
    pub fn frame(&self, camera: &Camera) -> ComposedFrame {
        let scene = self.composer.scene_frame(camera);
        let mut frame = self.frame_over(&scene, Known::default());
        frame.stats.raster_s += scene.seconds();
        frame
    }

    /// One frame over a scene that was rendered before; parts that are known are taken as they are.
    pub fn frame_over(&self, scene: &SceneFrame, known: Known<'_>) -> ComposedFrame {
        let source = match (known.shadow, &self.cache, &self.exact) {
            (Some(ratio), ..) => ShadowSource::Known(ratio),
            (None, Some(cache), Some(exact)) => ShadowSource::Cached(cache, exact.as_ref()),
            _ => ShadowSource::Configured,
        };
        let made;
        let object = match known.object {
            Some(object) => object,
            None => {
                made = self.objects(scene);
                &made
            }
        };
        let mut frame = self.composer.blend(scene, object, source);
        if self.near_only && known.shadow.is_none() {
            let spheres = self.exact.as_ref().map(|exact| exact.spheres()).unwrap_or_default();
            let near = cut_off(&frame.shadow, scene, &spheres);
            let stats = frame.stats;
            frame = ComposedFrame { stats, ..self.composer.blend(scene, object, ShadowSource::Known(&near)) };
        }
        let name = &scene.camera().name;
        let name = name.bytes().fold(0u64, |h, b| h.wrapping_mul(31).wrapping_add(u64::from(b)));
        self.look.apply(&mut frame, self.seed, name.wrapping_add(self.step.wrapping_mul(0x9e37_79b9)));
        frame
    }

    /// The objects' part of a frame.
    pub fn objects(&self, scene: &SceneFrame) -> ObjectFrame {
        self.composer.object_frame(scene, self.relit.as_ref().map(|r| r as &dyn ObjectShader))
    }

    /// What the shadow cache took.
    pub fn cache(&self) -> Option<CacheStatistics> {
        self.cache.as_ref().map(ShadowCache::statistics)
    }

    /// Whether objects are shown under the composition's light.
    pub fn is_relit(&self) -> bool {
        self.relit.is_some()
    }

    /// Shadows, as they came out.
    pub fn shadow(&self) -> Shadow {
        self.shadow
    }
}

/// Shadows beyond this many radii are far.
const NEAR: f32 = 6.0;

/// A shadow without what is beyond a few radii of what casts it.
pub(crate) fn cut_off(ratio: &Image, scene: &SceneFrame, spheres: &[(Vec3, f32)]) -> Image {
    let mut near = ratio.clone();
    let is_near = |p: Vec3| spheres.iter().any(|(c, r)| (p - *c).length() < NEAR * r);
    for (pixel, point) in near.data.chunks_exact_mut(3).zip(&scene.receivers().points) {
        if !is_near(*point) {
            pixel.fill(1.0);
        }
    }
    near
}

/// Probes in the scene; `None` where no camera sees a receiver near the objects.
fn scene_probes<'a>(
    composition: &Composition,
    ground: &'a Ground<'a>,
    receivers: &ReceiverCloud,
) -> Result<Option<Box<dyn ShadowRatios + 'a>>, PipelineError> {
    let Some(tracer) = &ground.object_tracer else { return Ok(None) };
    let config = SceneProbeConfig::default();
    let spheres = composition.spheres();
    match SceneProbes::bake(receivers, &ground.light, tracer, spheres, &config, BakeObserver::silent()) {
        Ok(probes) => Ok(Some(Box::new(probes))),
        Err(comgs_probe::ProbeError::NoPoints(_)) => Ok(None),
        Err(other) => Err(PipelineError::input("scene probes", "probes", other.to_string())),
    }
}

/// The cache's knobs, named for the reports.
pub(crate) fn cache_json(config: &CacheConfig) -> serde_json::Value {
    serde_json::json!({"tolerance": config.tolerance, "pixels": config.pixels})
}
