//! Cameras without pictures: for rendering along the views of any capture or camera file.

use crate::SceneError;
use crate::capture::{CheckReport, OpenOptions, Severity, Split, ViewRecord, recognise, survey, syncom};
use crate::json;
use comgs_geom::Camera;
use std::path::Path;

/// Reads the cameras of a capture folder, a `cameras.json`, a `transforms*.json` or a COLMAP model, all splits.
///
/// Images are not needed, except where a list states no image size. A lens is ignored: these are the pinhole cameras of
/// the straightened photographs. Names are unique and usable as file names.
///
/// # Errors
/// [`SceneError::Unrecognised`], or [`SceneError::Unsound`] with every problem when any camera is unusable.
pub fn read_cameras(path: impl AsRef<Path>) -> Result<Vec<Camera>, SceneError> {
    read_cameras_of(path, Split::All)
}

/// [`read_cameras`] of one split. Captures without splits of their own have only [`Split::Train`] here, because holding
/// out depends on which images are there.
///
/// # Errors
/// As [`read_cameras`].
pub fn read_cameras_of(path: impl AsRef<Path>, split: Split) -> Result<Vec<Camera>, SceneError> {
    let recognised = recognise(path.as_ref())?;
    let survey = survey::survey(&recognised, &OpenOptions { split, images: None }, survey::Need::Cameras)?;
    let report: CheckReport = survey.report;
    if report.of(Severity::Error).next().is_some() {
        return Err(SceneError::Unsound(Box::new(report)));
    }
    Ok(survey.views.into_iter().map(|ViewRecord { camera, .. }| camera).collect())
}

/// Writes cameras as a SynCom `cameras.json`; the file is whole or unchanged. Read back by [`read_cameras`].
///
/// # Errors
/// [`SceneError::Write`].
pub fn write_cameras(path: impl AsRef<Path>, cameras: &[Camera]) -> Result<(), SceneError> {
    json::write(path.as_ref(), &syncom::to_value(cameras))
}
