//! Small frames of a composition.
//!
//! Pilots differ in few parts, so each part is made once for all that share it: what a camera sees of the scene, what it sees of
//! the objects under one light, one shadow. A near shadow is the far one, cut off.

use super::cost::{ObjectWork, ShadowWork, Work};
use crate::stages::editing::{Baked, Composition, OwnLight, Relight, Settings, Shadow, is_cached};
use crate::stages::render_composition::{Ground, Known, Parts, Renderer, cut_off};
use crate::{Context, PipelineError};
use comgs_compose::{CacheConfig, ObjectFrame, ReceiverCloud, SceneFrame};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_inverse::Quality;
use std::cell::OnceCell;
use std::time::Instant;

/// Width of a pilot frame.
const WIDTH: usize = 128;
/// Most pilot frames.
const FRAMES: usize = 3;

/// Small cameras of a composition: some of its own, spread over the list.
pub(super) fn cameras(all: &[Camera]) -> Vec<Camera> {
    let n = all.len().min(FRAMES);
    let small = |camera: &Camera| {
        let width = camera.width.min(WIDTH);
        camera.resized(width, (camera.height * width).div_ceil(camera.width).max(1))
    };
    (0..n).map(|k| small(&all[k * all.len() / n])).collect()
}

/// Pilots of one composition.
pub(super) struct Pilots<'a> {
    /// The stand-in.
    small: &'a Composition,
    ground: &'a Ground<'a>,
    /// What its objects occlude, from the first effect on that needs it.
    baked: &'a OnceCell<Baked>,
    scenes: Vec<SceneFrame>,
    /// What the cameras see of the scene.
    cloud: OnceCell<(ReceiverCloud, f64)>,
    /// What the objects hide from themselves, without and with what it shows of them, without and with a shadow (several
    /// objects need one).
    own: [OnceCell<(Option<OwnLight>, f64)>; 4],
    /// The last ones, with the settings that they came from.
    objects: Option<(Settings, Vec<ObjectFrame>, ObjectWork)>,
    shadows: Option<(Settings, Vec<Image>, ShadowWork)>,
}

/// A pilot.
pub(super) struct Pilot {
    pub frames: Vec<Image>,
    pub work: Work,
}

impl<'a> Pilots<'a> {
    /// `ground` and `baked` are of the stand-in `small`.
    pub fn new(
        small: &'a Composition,
        ground: &'a Ground<'a>,
        baked: &'a OnceCell<Baked>,
        context: &Context<'_>,
    ) -> Result<Self, PipelineError> {
        let mut scenes = Vec::new();
        for camera in &small.cameras {
            context.check()?;
            scenes.push(ground.composer.scene_frame(camera));
        }
        let (cloud, own) = Default::default();
        Ok(Self { small, ground, baked, scenes, cloud, own, objects: None, shadows: None })
    }

    /// Pixels of a pilot's frames.
    pub fn pixels(&self) -> usize {
        self.small.cameras.iter().map(|c| c.width * c.height).sum()
    }

    /// Renders the small frames with some settings.
    pub fn render(&mut self, settings: &Settings, context: &Context<'_>) -> Result<Pilot, PipelineError> {
        context.check()?;
        let settings = &Settings { quality: Quality::Draft, ..settings.clone() };
        let (lit, shaded) = (of_objects(settings, self.small), of_shadow(settings, self.small));
        let mut objects = self.objects.take().filter(|o| o.0 == lit);
        let mut shadows = self.shadows.take().filter(|s| s.0 == shaded);
        let baked = self.baked.get().filter(|_| settings.shadow == Shadow::Auto && self.small.wants_shadow());
        let casts = baked.is_some();
        // A draft's cells would be larger than what small frames show.
        let cache = Some(CacheConfig::default());
        let parts = Parts { objects: objects.is_none(), shadow: casts && shadows.is_none(), cache };

        let nothing = ReceiverCloud::default();
        let (cloud, cloud_s) = match casts {
            true => {
                let (cloud, seconds) = once(&self.cloud, || {
                    let mut cloud = ReceiverCloud::default();
                    self.scenes.iter().for_each(|scene| cloud.add(scene.camera(), scene.receivers()));
                    Ok(cloud)
                })?;
                (cloud, *seconds)
            }
            false => (&nothing, 0.0),
        };
        let hides = casts && self.small.objects.len() > 1;
        let own = &self.own[usize::from(settings.indirect) + 2 * usize::from(hides)];
        let lights = parts.objects || (parts.shadow && settings.bounce);
        let (own, own_s) = match lights && (settings.self_occlusion || settings.indirect) {
            true => {
                let (own, seconds) = once(own, || OwnLight::new(self.small, settings))?;
                (own.as_ref(), *seconds)
            }
            false => (None, 0.0),
        };
        // The cut at a distance is done below.
        let whole = Settings { near_only: false, ..settings.clone() };
        let renderer = Renderer::for_parts(self.small, self.ground, baked, own, cloud, &whole, parts)?;
        let prepared = renderer.prepared;

        let objects = objects.take().unwrap_or_else(|| {
            let frames: Vec<ObjectFrame> = self.scenes.iter().map(|s| renderer.objects(s)).collect();
            let sum = |of: fn(&ObjectFrame) -> f64| frames.iter().map(of).sum();
            let work = ObjectWork {
                own_s,
                prepare_s: prepared.relight_s,
                shade_s: sum(|f| f.stats().relight_s),
                is_relit: renderer.is_relit(),
            };
            (lit, frames, work)
        });
        let shadows = shadows.take().unwrap_or_else(|| {
            if !casts {
                return (shaded, Vec::new(), ShadowWork::default());
            }
            let start = Instant::now();
            let ratio = |(scene, object): (&SceneFrame, &ObjectFrame)| {
                renderer.frame_over(scene, Known { object: Some(object), shadow: None }).shadow
            };
            let ratios = self.scenes.iter().zip(&objects.1).map(ratio).collect();
            let work = ShadowWork {
                casts,
                cloud_s,
                cache_s: prepared.cache_s,
                bounce_s: prepared.bounce_s,
                read_s: start.elapsed().as_secs_f64(),
            };
            (shaded, ratios, work)
        });
        let spheres = self.small.spheres();
        let frames = self.scenes.iter().zip(&objects.1).enumerate().map(|(k, (scene, object))| {
            let cut = match shadows.1.get(k) {
                Some(ratio) if settings.near_only => Some(cut_off(ratio, scene, &spheres)),
                _ => None,
            };
            let shadow = cut.as_ref().or(shadows.1.get(k));
            renderer.frame_over(scene, Known { object: Some(object), shadow }).beauty
        });
        let frames = frames.collect();
        let work = Work { objects: objects.2, shadow: shadows.2 };
        (self.objects, self.shadows) = (Some(objects), Some(shadows));
        Ok(Pilot { frames, work })
    }
}

/// What the objects' part of a frame depends on: everything but what is known to concern the scene alone.
fn of_objects(settings: &Settings, composition: &Composition) -> Settings {
    // Several objects hide each other's light by their shadows.
    let shadow = if composition.objects.len() > 1 { settings.shadow } else { Shadow::None };
    Settings { shadow, near_only: false, bounce: false, defocus: false, noise: false, ..settings.clone() }
}

/// What the shadow depends on: everything but what is known to concern the objects alone, which throw it back. That they throw
/// back a little more when light bounces on them first is passed over, unless they are then shaded in another way.
fn of_shadow(settings: &Settings, composition: &Composition) -> Settings {
    let indirect = settings.indirect && !is_cached(composition, settings);
    let whole = Settings { near_only: false, indirect, defocus: false, noise: false, ..settings.clone() };
    if settings.bounce {
        return whole;
    }
    Settings { relight: Relight::Off, self_occlusion: false, indirect: false, ..whole }
}

/// What is in the cell, made if nothing is, with the seconds of making it.
fn once<T>(
    cell: &OnceCell<(T, f64)>,
    make: impl FnOnce() -> Result<T, PipelineError>,
) -> Result<&(T, f64), PipelineError> {
    if cell.get().is_none() {
        let start = Instant::now();
        let made = make()?;
        // Nothing else fills it meanwhile.
        let _ = cell.set((made, start.elapsed().as_secs_f64()));
    }
    cell.get().ok_or_else(|| PipelineError::Internal("a pilot lost what pilots share".into()))
}
