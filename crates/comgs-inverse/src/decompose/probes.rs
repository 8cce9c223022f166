//! Where the probes of an object stand and what they see (ComGS §3.1.2, "Automatic Placement of SOPs").

use super::{DecomposeConfig, DecomposeReport};
use crate::TrainError;
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_probe::{DepthView, FusionConfig, ProbeConfig, ProbeError, ProbeSet, VisibilityWeight, fuse};
use comgs_raster::{Planes, RasterConfig, render};
use comgs_surfel::SurfelCloud;
use glam::Vec3;

/// Longest side of the G-buffers that are fused, in pixels: 60 views of 300 × 300 give hundreds of points for each of
/// 5000 probes.
const FUSION_SIDE: usize = 300;
/// Weight of a pixel below which it has no depth for fusion.
const FUSION_WEIGHT: f32 = 0.8;

/// Views that must agree where too few do for the usual number.
const RELAXED_VIEWS: usize = 3;

/// Size of an object: the longest side of the box around the central 98 % of its surfels, by axis, so that stray surfels do
/// not count. World units.
#[must_use]
pub fn object_size(cloud: &SurfelCloud) -> f32 {
    let n = cloud.len();
    if n == 0 {
        return 0.0;
    }
    let mut size = Vec3::ZERO;
    for k in 0..3 {
        let mut values: Vec<f32> = cloud.positions.iter().map(|p| p[k]).collect();
        values.sort_by(f32::total_cmp);
        size[k] = values[(n - 1) - n / 100] - values[n / 100];
    }
    size.max_element()
}

/// Probes without light: G-buffers of all views are fused to oriented points, of which the farthest from one another are
/// taken, moved outwards.
///
/// # Errors
/// [`TrainError::Probes`] when no points are consistent between views.
pub fn place(
    cameras: &[&Camera],
    cloud: &SurfelCloud,
    config: &DecomposeConfig,
    raster: &RasterConfig,
    report: &mut DecomposeReport,
) -> Result<ProbeSet, TrainError> {
    let views: Vec<DepthView> = cameras.iter().map(|c| depth_view(c, cloud, raster)).collect();
    let strict = FusionConfig::default();
    let (points, fusion) = fuse(&views, &strict).or_else(|first| {
        // Sparse captures: three views that agree are still a surface, and better than none.
        let relaxed = FusionConfig { min_consistent_views: RELAXED_VIEWS, ..strict };
        let found = fuse(&views, &relaxed).map_err(|_| error(first))?;
        report.warnings.push(format!(
            "no point is consistent in {} views; probes stand where {RELAXED_VIEWS} agree",
            FusionConfig::default().min_consistent_views
        ));
        Ok(found)
    })?;
    report.fused_points = points.positions.len();
    report.fused_share = fusion.points() as f32 / fusion.usable.max(1) as f32;
    comgs_probe::place(&points, &probe_config(config), object_size(cloud)).map_err(error)
}

/// The probe part of a configuration.
#[must_use]
pub fn probe_config(config: &DecomposeConfig) -> ProbeConfig {
    ProbeConfig {
        count: config.probes,
        resolution: config.probe_resolution,
        offset: config.probe_offset,
        neighbours: config.probe_neighbours,
        visibility: if config.chebyshev { VisibilityWeight::Chebyshev } else { VisibilityWeight::None },
        ..ProbeConfig::default()
    }
}

fn error(e: ProbeError) -> TrainError {
    TrainError::Probes(e.to_string())
}

fn depth_view(camera: &Camera, cloud: &SurfelCloud, raster: &RasterConfig) -> DepthView {
    let longest = camera.width.max(camera.height);
    let scaled = |side: usize| (side * FUSION_SIDE / longest).max(1);
    let camera = if longest > FUSION_SIDE {
        camera.resized(scaled(camera.width), scaled(camera.height))
    } else {
        camera.clone()
    };
    let frame = render(cloud, &camera, Planes::GEOMETRY, raster);
    let depth = frame.unbiased_depth(FUSION_WEIGHT);
    // The blended ones: they lean towards each eye by some degrees, within what fusion allows, and over several views the
    // leans cancel; those of the surface are too rough for it where discs are seen by only a few pixels.
    let normal = frame.normal.unwrap_or_else(|| Image::zeros(camera.width, camera.height, 3));
    DepthView { camera, depth, normal }
}
