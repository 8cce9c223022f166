//! The surfels that training starts with.

use super::report::TrainError;
use crate::config::{Kind, TrainConfig};
use crate::init::sweep::{SweepConfig, plane_sweep};
use crate::init::{self, SurfacePoint, background, hull};
use crate::train::Observer;
use crate::view::{Rig, TrainView};
use comgs_surfel::{ColorEncoding, SurfelCloud};
use glam::Vec3;

/// From the visual hull for objects; from a plane sweep, the capture's own points and a far shell for scenes.
pub(super) fn initialise(
    views: &[TrainView],
    points: Option<(&[Vec3], &[Vec3])>,
    rig: &Rig,
    config: &TrainConfig,
    warnings: &mut Vec<String>,
    observer: &dyn Observer,
) -> Result<SurfelCloud, TrainError> {
    let start = config.initial_surfels.min(config.max_surfels);
    let cancelled = || observer.cancelled();
    let mut surface: Vec<SurfacePoint> = match config.kind {
        Kind::Object => {
            let mut hull = hull::visual_hull(views, rig, start);
            if hull.is_empty() {
                return Err(TrainError::EmptyHull);
            }
            thin_to(&mut hull, start);
            hull
        }
        Kind::Scene => {
            let shell_count = (start / 8).min(6_000);
            let room = start - shell_count;
            let mut found = plane_sweep(views, rig, &SweepConfig::default(), room, &cancelled);
            if observer.cancelled() {
                return Err(TrainError::Cancelled(0));
            }
            if let Some((positions, radiance)) = points {
                let mut sfm =
                    init::from_points(positions, radiance, rig.focus.as_vec3(), rig.distance as f32);
                thin_to(&mut sfm, room.saturating_sub(found.len()));
                found.extend(sfm);
            }
            if found.len() < room / 20 {
                warnings.push(format!(
                    "only {} surface points were found by matching: little texture or little overlap",
                    found.len()
                ));
            }
            found.extend(background::shell(views, rig, 10.0, shell_count * 2));
            found
        }
    };
    surface.retain(|p| p.position.is_finite() && p.radiance.is_finite() && p.spacing.is_finite());
    thin_to(&mut surface, config.max_surfels);
    if surface.is_empty() {
        return Err(TrainError::Vanished);
    }
    Ok(init::surfels(&surface, ColorEncoding::Srgb))
}

/// Keeps `count` entries evenly spread over the list; spacings grow to fill the gaps.
fn thin_to(points: &mut Vec<SurfacePoint>, count: usize) {
    let n = points.len();
    if n <= count {
        return;
    }
    let widen = (n as f32 / count.max(1) as f32).sqrt();
    let mut i = 0;
    points.retain(|_| {
        let keep = (i * count) / n != ((i + 1) * count) / n;
        i += 1;
        keep
    });
    points.iter_mut().for_each(|p| p.spacing *= widen);
}
