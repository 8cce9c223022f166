//! What is asked of views before any work.

use super::report::{MIN_VIEWS, TrainError};
use crate::config::{Kind, TrainConfig};
use crate::view::{Rig, TrainView};

/// What tells one set of views from another, for checkpoints.
pub(super) fn identity(views: &[TrainView]) -> String {
    let mut sum = 0.0f64;
    for v in views {
        sum +=
            v.color.data.iter().step_by(97).map(|&x| f64::from(x)).sum::<f64>() + v.camera.centre().length();
    }
    format!("{} views, {}×{}, {sum:.6e}", views.len(), views[0].camera.width, views[0].camera.height)
}

/// Refuses captures that cannot work, and finds out where their cameras look.
pub(super) fn check(
    views: &[TrainView],
    config: &TrainConfig,
    warnings: &mut Vec<String>,
) -> Result<Rig, TrainError> {
    if let Some(problem) = config.check().into_iter().next() {
        return Err(TrainError::Config(problem));
    }
    if views.len() < MIN_VIEWS {
        return Err(TrainError::TooFewViews(views.len()));
    }
    for v in views {
        let problem = |problem: String| Err(TrainError::View { name: v.camera.name.clone(), problem });
        if let Some(p) = v.camera.problems().into_iter().next() {
            return problem(p);
        }
        if (v.color.width, v.color.height, v.color.channels) != (v.camera.width, v.camera.height, 3) {
            return problem(format!(
                "image is {}×{}×{}, expected {}×{}×3",
                v.color.width, v.color.height, v.color.channels, v.camera.width, v.camera.height
            ));
        }
        let bad = v.color.non_finite();
        if bad > 0 {
            return problem(format!("{bad} samples are not finite"));
        }
    }
    let cameras: Vec<_> = views.iter().map(|v| &v.camera).collect();
    let first = cameras[0].centre();
    let farthest = cameras.iter().map(|c| c.centre().distance(first)).fold(0.0, f64::max);
    let rig = Rig::new(&cameras).ok_or(TrainError::TooFewViews(0))?;
    if farthest < 1e-6 * rig.distance.max(first.length()).max(1e-9) {
        return Err(TrainError::NoParallax(views.len()));
    }
    if views.iter().all(|v| v.color.data.iter().all(|x| *x <= 1e-4)) {
        return Err(TrainError::Black);
    }
    if config.kind == Kind::Object {
        let missing = views.iter().filter(|v| v.mask.is_none()).count();
        if missing > 0 {
            return Err(TrainError::NoMasks { missing, total: views.len() });
        }
    }
    let saturated = views
        .iter()
        .filter(|v| !v.hdr && v.color.data.iter().filter(|x| **x >= 0.99).count() * 2 > v.color.data.len())
        .count();
    if saturated > 0 {
        warnings.push(format!("{saturated} views are clipped in more than half of their samples"));
    }
    Ok(rig)
}
