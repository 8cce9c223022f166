//! One composed frame: scene, object, order, shadow.

use crate::field_shadow::ShadowRatios;
use crate::objects::{self, MergeError, PlacedObject};
use crate::over::{self, Front, Ordering};
use crate::placement::{SurfaceHit, Surfaces};
use crate::scene_frame::{ObjectFrame, SceneFrame, all_ratios, plane};
use crate::shadow::{self, LightSource, Occluder, ShadowConfig};
use crate::shadow_cache::ShadowCache;
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_raster::{Frame, Planes, RasterConfig};
use comgs_surfel::SurfelCloud;
use comgs_trace::{TraceConfig, TraceError, Tracer};
use glam::Vec3;
use rayon::prelude::*;
use thiserror::Error;

/// Knobs of a composition.
#[derive(Clone, Debug)]
pub struct ComposeConfig {
    /// Rasterisation. The near plane is the scene's; an object may stand nearer than the scene was ever trained to be
    /// seen, so its own is a hundredth of its radius, where that is less.
    pub raster: RasterConfig,
    /// How scene and object are ordered within a pixel.
    pub ordering: Ordering,
    /// Scene that lies in front of the object by less than this share of the object's bounding radius counts as
    /// behind it, so that noise in the reconstructed floor does not eat the object's foot.
    pub contact_bias: f32,
    /// The shadow; `None` leaves the scene as it is.
    pub shadow: Option<ShadowConfig>,
}

impl Default for ComposeConfig {
    fn default() -> Self {
        Self {
            raster: RasterConfig::default(),
            ordering: Ordering::Split,
            contact_bias: 0.01,
            shadow: Some(ShadowConfig::default()),
        }
    }
}

/// Why a composition cannot be set up.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ComposeError {
    /// Objects that cannot be one cloud, or no object.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// A cloud that cannot be traced.
    #[error("the {what} cannot be traced")]
    Trace {
        /// `scene` or `object`.
        what: &'static str,
        /// Why.
        #[source]
        reason: TraceError,
    },
    /// An object all of whose surfels are invisible.
    #[error("the object has {0} surfels, none of them visible")]
    Invisible(usize),
}

/// Where a frame's shadow comes from.
#[derive(Clone, Copy)]
pub enum ShadowSource<'a> {
    /// As [`ComposeConfig::shadow`] says: traced for every pixel, or none.
    Configured,
    /// The ratio of every pixel's point.
    Exact(&'a dyn ShadowRatios),
    /// A cache, and what works out the pixels that it does not know.
    Cached(&'a ShadowCache, &'a dyn ShadowRatios),
    /// The ratio of every pixel, 3 channels, as an earlier frame of the camera had it ([`ComposedFrame::shadow`]).
    Known(&'a Image),
}

/// Something that gives an object's pixels another radiance than its surfels have.
pub trait ObjectShader: Sync {
    /// What the G-buffer is rendered of in place of the merged objects: the same surfels with other colours. `None` for the
    /// objects themselves.
    fn carrier(&self) -> Option<&SurfelCloud> {
        None
    }

    /// Premultiplied linear radiance, 3 channels, of a G-buffer of all planes that the camera has seen of the merged
    /// objects (or of the carrier). Pixels it leaves black are black.
    fn shade(&self, camera: &Camera, frame: &Frame) -> Image;
}

/// Scene and objects, prepared to be composed from any camera.
pub struct Composer<'a> {
    scene: &'a SurfelCloud,
    scene_tracer: &'a Tracer,
    object: SurfelCloud,
    /// Only for a shadow that is traced for every pixel.
    object_tracer: Option<Tracer>,
    object_bounds: (Vec3, f32),
    light: &'a dyn LightSource,
    config: ComposeConfig,
}

/// The planes of one composed frame. Colours are linear; `beauty = object.rgb + scene · shadow`.
#[derive(Clone, Debug)]
pub struct ComposedFrame {
    /// The picture, 3 channels, over black.
    pub beauty: Image,
    /// Weight of everything that is seen, 1 channel.
    pub weight: Image,
    /// The object, premultiplied, after occlusion by the scene, 4 channels.
    pub object: Image,
    /// The scene that is still seen, before its shadow, premultiplied, 3 channels.
    pub scene: Image,
    /// The scene without the object, 3 channels, over black.
    pub empty: Image,
    /// Shadow ratio on the scene, 3 channels in [0, 1]; exactly 1 where nothing is in shadow.
    pub shadow: Image,
    /// z-depth, mean of object and scene by their weights, 1 channel, 0 where undefined.
    pub depth: Image,
    /// World normal, mean of object and scene by their weights, unit length, zero where undefined.
    pub normal: Image,
    /// Coverage of the object after occlusion, 1 channel.
    pub mask: Image,
    /// What the frame cost.
    pub stats: FrameStats,
}

impl ComposedFrame {
    /// The first value that is not finite: its plane, pixel and channel, in words; planes in the order in which they are
    /// made. `None` when all is sound.
    #[must_use]
    pub fn first_non_finite(&self) -> Option<String> {
        let planes = [
            ("empty", &self.empty),
            ("scene", &self.scene),
            ("object", &self.object),
            ("shadow", &self.shadow),
            ("mask", &self.mask),
            ("weight", &self.weight),
            ("depth", &self.depth),
            ("normal", &self.normal),
            ("beauty", &self.beauty),
        ];
        planes.into_iter().find_map(|(name, plane)| {
            let at = plane.data.iter().position(|v| !v.is_finite())?;
            let (pixel, channel) = (at / plane.channels, at % plane.channels);
            let (x, y) = (pixel % plane.width, pixel / plane.width);
            Some(format!("plane {name} is {} at pixel ({x}, {y}), channel {channel}", plane.data[at]))
        })
    }
}

/// What a frame cost and shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameStats {
    /// Seconds for both rasterisations.
    pub raster_s: f64,
    /// Seconds for ordering and blending.
    pub order_s: f64,
    /// Seconds for shading the object anew.
    pub relight_s: f64,
    /// Seconds for the shadow.
    pub shadow_s: f64,
    /// Pixels that a shadow cache did not know.
    pub shadow_missed: usize,
    /// Rays traced for the shadow.
    pub shadow_rays: u64,
    /// Rays traced for the order.
    pub order_rays: u64,
    /// Sum of the object's coverage before occlusion by the scene, in pixels.
    pub object_px: f64,
    /// Sum of the object's coverage after occlusion by the scene, in pixels.
    pub visible_px: f64,
}

/// The tracer of the merged objects as an occluder.
struct TracedObject<'a> {
    tracer: &'a Tracer,
    bounds: (Vec3, f32),
}

impl Occluder for TracedObject<'_> {
    fn transmittance(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        self.tracer.transmittance(origin, direction, 0.0, t_max)
    }

    fn bounding_sphere(&self) -> (Vec3, f32) {
        self.bounds
    }
}

impl Surfaces for Tracer {
    fn hit(&self, origin: Vec3, direction: Vec3, t_max: f32) -> SurfaceHit {
        let hit = self.radiance(origin, direction, 0.0, t_max);
        let distance = if hit.alpha > 0.0 { hit.depth / hit.alpha } else { 0.0 };
        SurfaceHit { alpha: hit.alpha, distance, normal: hit.normal }
    }
}

impl<'a> Composer<'a> {
    /// Places and merges the objects and builds their tracer.
    ///
    /// `scene_tracer` must be of `scene`; it is passed in because a sweep has usually built it already.
    ///
    /// # Errors
    /// [`ComposeError`] when there is no visible object, encodings differ, or the object cannot be traced.
    pub fn new(
        scene: &'a SurfelCloud,
        scene_tracer: &'a Tracer,
        objects: &[PlacedObject<'_>],
        light: &'a dyn LightSource,
        config: ComposeConfig,
    ) -> Result<Self, ComposeError> {
        let object = objects::merge(objects)?;
        let object_bounds = objects::bounding_sphere(&object).ok_or(ComposeError::Invisible(object.len()))?;
        let object_tracer = match config.shadow {
            Some(_) => Some(
                Tracer::new(&object, &TraceConfig::occlusion())
                    .map_err(|reason| ComposeError::Trace { what: "object", reason })?,
            ),
            None => None,
        };
        Ok(Self { scene, scene_tracer, object, object_tracer, object_bounds, light, config })
    }

    /// Centre and radius of a sphere around all objects.
    #[must_use]
    pub fn object_bounds(&self) -> (Vec3, f32) {
        self.object_bounds
    }

    /// All objects in world space.
    #[must_use]
    pub fn objects(&self) -> &SurfelCloud {
        &self.object
    }

    /// What a camera sees of the scene: for [`Composer::frame_over`] of this and any other composer of the same scene, tracer
    /// and rasterisation.
    #[must_use]
    pub fn scene_frame(&self, camera: &Camera) -> SceneFrame {
        SceneFrame::new(self.scene, camera, &self.config.raster)
    }

    /// Composes one frame. Deterministic at any thread count.
    #[must_use]
    pub fn frame(&self, camera: &Camera) -> ComposedFrame {
        self.frame_with(camera, ShadowSource::Configured, None)
    }

    /// Composes one frame with a shadow and perhaps a shading of the object from elsewhere. Deterministic at any thread
    /// count.
    #[must_use]
    pub fn frame_with(
        &self,
        camera: &Camera,
        shadow: ShadowSource<'_>,
        shader: Option<&dyn ObjectShader>,
    ) -> ComposedFrame {
        let scene = self.scene_frame(camera);
        let mut frame = self.frame_over(&scene, shadow, shader);
        frame.stats.raster_s += scene.seconds();
        frame
    }

    /// [`Composer::frame_with`] over a scene that was rendered before: the same pixels.
    #[must_use]
    pub fn frame_over(
        &self,
        scene: &SceneFrame,
        shadow: ShadowSource<'_>,
        shader: Option<&dyn ObjectShader>,
    ) -> ComposedFrame {
        self.blend(scene, &self.object_frame(scene, shader), shadow)
    }

    /// Renders and shades the objects, and finds what of the scene lies in front of them.
    #[must_use]
    pub fn object_frame(&self, scene: &SceneFrame, shader: Option<&dyn ObjectShader>) -> ObjectFrame {
        let camera = &scene.camera;
        let start = std::time::Instant::now();
        let near = self.config.raster.near.min(0.01 * self.object_bounds.1).max(f32::MIN_POSITIVE);
        let object_raster = RasterConfig { near, ..self.config.raster };
        let planes = if shader.is_some() { Planes::ALL } else { Planes::GEOMETRY };
        let cloud = shader.and_then(ObjectShader::carrier).unwrap_or(&self.object);
        let mut object = comgs_raster::render(cloud, camera, planes, &object_raster);
        let mut stats = FrameStats { raster_s: start.elapsed().as_secs_f64(), ..FrameStats::default() };

        let start = std::time::Instant::now();
        if let Some(shader) = shader {
            object.color = Some(shader.shade(camera, &object));
        }
        stats.relight_s = start.elapsed().as_secs_f64();

        let start = std::time::Instant::now();
        let (fronts, rays) = self.fronts(scene, &object);
        stats.order_rays = rays;
        stats.order_s = start.elapsed().as_secs_f64();
        ObjectFrame { planes: object, fronts, stats }
    }

    /// Casts the shadow and blends: `beauty = object + scene · shadow`.
    #[must_use]
    pub fn blend(&self, scene: &SceneFrame, object: &ObjectFrame, shadow: ShadowSource<'_>) -> ComposedFrame {
        let mut stats = object.stats;
        let start = std::time::Instant::now();
        let shadow = match shadow {
            ShadowSource::Configured => self.shadow(scene, &mut stats),
            ShadowSource::Exact(exact) => all_ratios(scene.receivers(), exact),
            ShadowSource::Cached(cache, exact) => {
                let read = cache.read(scene.receivers(), exact);
                stats.shadow_missed = read.missed;
                read.ratio
            }
            ShadowSource::Known(ratio) => ratio.clone(),
        };
        stats.shadow_s = start.elapsed().as_secs_f64();

        let camera = &scene.camera;
        let frame = assemble(camera, &scene.planes, &object.planes, &object.fronts, shadow, stats);
        // Release builds do not look: a composed frame is finite when its parts are.
        #[cfg(debug_assertions)]
        if let Some(bad) = frame.first_non_finite() {
            panic!("camera {}: {bad}", camera.name);
        }
        frame
    }

    /// The scene in front of the object, for every pixel.
    fn fronts(&self, of: &SceneFrame, object: &Frame) -> (Vec<Front>, u64) {
        let (camera, scene) = (&of.camera, &of.planes);
        let width = camera.width;
        let bias = self.config.contact_bias * self.object_bounds.1;
        let alpha_min = self.config.raster.alpha_min;
        let scene_depth = scene.unbiased_depth(alpha_min);
        let object_depth = object.unbiased_depth(alpha_min);
        let scene_color = plane(&scene.color);
        // All rays leave the eye, so a surfel's colour is worked out once.
        let view = of.view(self.scene_tracer);
        let rows: Vec<(Vec<Front>, u64)> = (0..camera.height)
            .into_par_iter()
            .map(|y| {
                let mut fronts = vec![Front::default(); width];
                let mut rays = 0;
                for (x, front) in fronts.iter_mut().enumerate() {
                    let i = y * width + x;
                    let z = object_depth.data[i];
                    let (color, weight) = (scene_color.rgb(x, y), scene.weight.data[i]);
                    if z <= 0.0 || weight < alpha_min {
                        continue;
                    }
                    if self.config.ordering == Ordering::DepthTest {
                        *front = over::front_by_depth_test(color, weight, scene_depth.data[i], z - bias);
                        continue;
                    }
                    let direction = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5).as_vec3();
                    let traced = |t_max: f32| {
                        let near = self.config.raster.near;
                        let hit = view.radiance(direction, near, t_max);
                        Front { color: hit.radiance.to_array(), weight: hit.alpha }
                    };
                    rays += 1;
                    // The direction has z = 1 in camera space, so ray parameters are z-depths.
                    let part = traced(z - bias);
                    if part.weight >= alpha_min {
                        rays += 1;
                        *front = over::reconcile(part, traced(f32::INFINITY), color, weight);
                    }
                }
                (fronts, rays)
            })
            .collect();
        let rays = rows.iter().map(|r| r.1).sum();
        (rows.into_iter().flat_map(|r| r.0).collect(), rays)
    }

    fn shadow(&self, scene: &SceneFrame, stats: &mut FrameStats) -> Image {
        let (Some(config), Some(tracer)) = (&self.config.shadow, &self.object_tracer) else {
            return Image::filled(scene.camera.width, scene.camera.height, 3, 1.0);
        };
        let receivers = scene.receivers_above(config.min_weight);
        let occluder = TracedObject { tracer, bounds: self.object_bounds };
        let traced = shadow::trace_shadow(&receivers, self.light, &occluder, config);
        stats.shadow_rays = traced.rays_traced;
        crate::denoise::denoise(&traced, &receivers, &config.denoise)
    }
}

/// Blends all planes with the weights of scene and object.
fn assemble(
    camera: &Camera,
    scene: &Frame,
    object: &Frame,
    fronts: &[Front],
    shadow: Image,
    mut stats: FrameStats,
) -> ComposedFrame {
    let (width, height) = (camera.width, camera.height);
    let (scene_color, object_color) = (plane(&scene.color), plane(&object.color));
    let scene_depth = scene.unbiased_depth(f32::MIN_POSITIVE);
    let object_depth = object.unbiased_depth(f32::MIN_POSITIVE);
    let image = |channels| Image::zeros(width, height, channels);
    let mut out = ComposedFrame {
        beauty: image(3),
        weight: image(1),
        object: image(4),
        scene: image(3),
        empty: scene_color.clone(),
        shadow,
        depth: image(1),
        normal: image(3),
        mask: image(1),
        stats: FrameStats::default(),
    };
    for i in 0..width * height {
        let (x, y) = (i % width, i / width);
        let alpha = object.weight.data[i];
        let p = over::compose_pixel(
            scene_color.rgb(x, y),
            scene.weight.data[i],
            fronts[i],
            object_color.rgb(x, y),
            alpha,
        );
        for c in 0..3 {
            out.scene.data[3 * i + c] = p.scene[c];
            out.object.data[4 * i + c] = p.object[c];
            out.beauty.data[3 * i + c] = p.object[c] + p.scene[c] * out.shadow.data[3 * i + c];
        }
        out.object.data[4 * i + 3] = p.object_weight;
        out.mask.data[i] = p.object_weight;
        let total = p.scene_weight + p.object_weight;
        out.weight.data[i] = total;
        stats.object_px += f64::from(alpha);
        stats.visible_px += f64::from(p.object_weight);
        if total > 0.0 {
            let depth = p.scene_weight * scene_depth.data[i] + p.object_weight * object_depth.data[i];
            out.depth.data[i] = depth / total;
            let unit = |frame: &Frame| Vec3::from_array(plane(&frame.normal).rgb(x, y)).normalize_or_zero();
            let normal = p.scene_weight * unit(scene) + p.object_weight * unit(object);
            out.normal.data[3 * i..3 * i + 3].copy_from_slice(&normal.normalize_or_zero().to_array());
        }
    }
    out.stats = stats;
    out
}
