//! What a camera sees of the scene and of the objects, apart from one another: the parts that a frame is blended from.
//!
//! The scene's part stays whatever stands in it, the objects' part whatever shadow falls: [`Composer::scene_frame`],
//! [`Composer::object_frame`] and [`Composer::blend`] let whoever renders a camera twice keep what does not change.
//! [`Composer::frame_with`] runs all three.
//!
//! [`Composer::scene_frame`]: crate::Composer::scene_frame
//! [`Composer::object_frame`]: crate::Composer::object_frame
//! [`Composer::blend`]: crate::Composer::blend
//! [`Composer::frame_with`]: crate::Composer::frame_with

use crate::field_shadow::ShadowRatios;
use crate::frame::FrameStats;
use crate::over::Front;
use crate::receivers::Receivers;
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_raster::{Frame, Planes, RasterConfig};
use comgs_surfel::SurfelCloud;
use comgs_trace::{EyeColours, Tracer, TracerView};
use glam::Vec3;
use std::sync::OnceLock;
use std::time::Instant;

/// Scene weight under which a pixel has no surface to receive a shadow.
const MIN_WEIGHT: f32 = 0.5;

/// What a camera sees of the scene. It serves every composer of the same scene, tracer and rasterisation.
pub struct SceneFrame {
    pub(crate) camera: Camera,
    pub(crate) planes: Frame,
    /// Colours of the scene's surfels as this eye sees them.
    eye: OnceLock<EyeColours>,
    receivers: OnceLock<Receivers>,
    /// Of the scene.
    surfels: usize,
    seconds: f64,
}

impl SceneFrame {
    pub(crate) fn new(scene: &SurfelCloud, camera: &Camera, raster: &RasterConfig) -> Self {
        let start = Instant::now();
        let planes = comgs_raster::render(scene, camera, Planes::GEOMETRY, raster);
        let (eye, receivers) = (OnceLock::new(), OnceLock::new());
        let (camera, surfels, seconds) = (camera.clone(), scene.len(), start.elapsed().as_secs_f64());
        Self { camera, planes, eye, receivers, surfels, seconds }
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Its pixels as points that receive shadows; worked out when first asked for.
    pub fn receivers(&self) -> &Receivers {
        self.receivers.get_or_init(|| self.receivers_above(MIN_WEIGHT))
    }

    pub(crate) fn receivers_above(&self, min_weight: f32) -> Receivers {
        Receivers::from_planes(
            &self.camera,
            &self.planes.unbiased_depth(min_weight),
            plane(&self.planes.normal),
        )
    }

    pub(crate) fn view<'a>(&'a self, tracer: &'a Tracer) -> TracerView<'a> {
        tracer.view_with(self.eye.get_or_init(|| tracer.eye_colours(self.camera.centre().as_vec3())))
    }

    /// Seconds of rendering the scene.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Bytes it holds, and may come to hold when a frame is made of it.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        // Colour, weight, depth, normal, and points and normals of the receivers.
        4 * (8 + 6) * self.camera.width * self.camera.height + 12 * self.surfels
    }
}

/// What a camera sees of the objects, shaded, and what of the scene lies in front of them.
pub struct ObjectFrame {
    pub(crate) planes: Frame,
    pub(crate) fronts: Vec<Front>,
    pub(crate) stats: FrameStats,
}

impl ObjectFrame {
    /// What it cost.
    #[must_use]
    pub fn stats(&self) -> FrameStats {
        self.stats
    }
}

/// The ratio of every pixel that shows a surface.
pub(crate) fn all_ratios(receivers: &Receivers, exact: &dyn ShadowRatios) -> Image {
    let mut ratio = Image::filled(receivers.width, receivers.height, 3, 1.0);
    let pixels: Vec<usize> = (0..receivers.points.len()).filter(|&i| receivers.is_surface(i)).collect();
    let points: Vec<Vec3> = pixels.iter().map(|&i| receivers.points[i]).collect();
    let normals: Vec<Vec3> = pixels.iter().map(|&i| receivers.normals[i]).collect();
    for (i, value) in pixels.iter().zip(exact.ratios(&points, &normals)) {
        ratio.data[3 * i..3 * i + 3].copy_from_slice(&value.to_array());
    }
    ratio
}

/// A plane that was asked for.
pub(crate) fn plane(plane: &Option<Image>) -> &Image {
    plane.as_ref().expect("the rasteriser returns every plane it was asked for")
}
