//! Every problem of a capture at once, before any work.

use super::survey::{Need, Survey, image_reason, survey};
use super::{
    CheckReport, MIN_VIEWS, OpenOptions, Problem, ProblemKind, Severity, Split, ViewRecord, extent, recognise,
};
use crate::SceneError;
use comgs_geom::Camera;
use comgs_image::transfer;
use glam::DVec3;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// How far a check looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckDepth {
    /// Lists and file headers: takes milliseconds.
    Headers,
    /// Also decodes every image: finds broken, black, saturated, textureless and non-finite ones.
    Pixels,
}

/// A camera this many times farther from the others than they are from each other (median distances) is an outlier.
const OUTLIER_DISTANCE: f64 = 20.0;
/// Standard deviation of sRGB codes below which an image has no texture: a quarter of an 8-bit step.
const TEXTURELESS: f64 = 0.25 / 255.0;

/// What is said of a black image.
const BLACK: &str = "the image is black";

/// Lists every problem of the capture at `path`, from lists and file headers. Never fails: what cannot be read is
/// itself a problem.
#[must_use]
pub fn check(path: impl AsRef<Path>) -> CheckReport {
    check_with(path, CheckDepth::Headers)
}

/// [`check`] with a choice of depth.
#[must_use]
pub fn check_with(path: impl AsRef<Path>, depth: CheckDepth) -> CheckReport {
    let path = path.as_ref();
    let found = recognise(path).and_then(|recognised| {
        let options = OpenOptions { split: Split::All, images: None };
        survey(&recognised, &options, Need::Images)
    });
    match found {
        Err(error) => unreadable(path, &error),
        Ok(survey) => {
            let mut report = judge(&survey, path);
            if depth == CheckDepth::Pixels {
                let content: Vec<Vec<Problem>> = survey.views.par_iter().map(content).collect();
                let train = |(view, _): &(&ViewRecord, &Vec<Problem>)| view.split == Split::Train;
                let mut photos = survey.views.iter().zip(&content).filter(train).peekable();
                if photos.peek().is_some()
                    && photos.all(|(_, problems)| problems.iter().any(|p| p.message == BLACK))
                {
                    let (kind, message) = (ProblemKind::Content, "all training images are black".to_owned());
                    report.problems.push(problem(Severity::Error, kind, path.to_owned(), "", message));
                }
                report.problems.extend(content.into_iter().flatten());
            }
            report
        }
    }
}

fn unreadable(path: &Path, error: &SceneError) -> CheckReport {
    let (file, location) = match error {
        SceneError::Json { path, location, .. } => (path.clone(), location.clone()),
        SceneError::Io { path, .. } | SceneError::Malformed { path, .. } => (path.clone(), String::new()),
        _ => (path.to_owned(), String::new()),
    };
    let message = match error {
        SceneError::Unrecognised { looked_for, .. } => {
            format!("no capture found; looked for {}", looked_for.join(", "))
        }
        other => other.reason(),
    };
    CheckReport {
        root: path.to_owned(),
        format: None,
        train_views: 0,
        test_views: 0,
        left_out: Vec::new(),
        problems: vec![problem(Severity::Error, ProblemKind::Record, file, &location, message)],
    }
}

fn problem(severity: Severity, kind: ProblemKind, path: PathBuf, location: &str, message: String) -> Problem {
    Problem { severity, kind, path, location: location.to_owned(), message }
}

/// The survey's report and what only the views together show.
fn judge(survey: &Survey, path: &Path) -> CheckReport {
    let mut report = survey.report.clone();
    let train: Vec<&ViewRecord> = survey.views.iter().filter(|v| v.split == Split::Train).collect();
    let cameras: Vec<&Camera> = train.iter().map(|v| &v.camera).collect();
    let mut add = |severity, message: &str| {
        report.problems.push(problem(severity, ProblemKind::Views, path.to_owned(), "", message.to_owned()));
    };
    match diversity(&cameras) {
        Diversity::None => add(Severity::Error, "no usable training view"),
        Diversity::One => add(Severity::Error, "one training view only: depth cannot be told from it"),
        Diversity::Identical => {
            add(Severity::Error, "all training cameras are identical: depth cannot be told")
        }
        Diversity::OneCentre => add(
            Severity::Error,
            "all training cameras stand in the same place: depth cannot be told from turning alone",
        ),
        Diversity::Enough if train.len() < MIN_VIEWS => {
            let n = train.len();
            add(Severity::Error, &format!("{n} training views only: at least {MIN_VIEWS} are needed"));
        }
        Diversity::Enough => {}
    }
    let (centre, radius) = extent(cameras.iter().map(|c| c.centre()));
    for view in &train {
        let distance = view.camera.centre().distance(centre);
        if radius > 0.0 && distance > OUTLIER_DISTANCE * radius {
            let message = format!(
                "the camera {:?} stands {:.0} times farther out than most: a misplaced pose?",
                view.camera.name,
                distance / radius
            );
            let list = view.list.clone();
            let kind = ProblemKind::OutlierCamera;
            report.problems.push(problem(Severity::Warning, kind, list, &view.location, message));
        }
    }
    report
}

#[derive(Debug, PartialEq)]
enum Diversity {
    None,
    One,
    Identical,
    OneCentre,
    Enough,
}

/// Whether the cameras see the world from more than one place.
fn diversity(cameras: &[&Camera]) -> Diversity {
    let [first, rest @ ..] = cameras else { return Diversity::None };
    if rest.is_empty() {
        return Diversity::One;
    }
    let scale = cameras.iter().map(|c| c.centre().length()).fold(1e-30, f64::max);
    let near = |a: DVec3, b: DVec3, size: f64| a.distance(b) <= 1e-9 * size;
    if rest.iter().any(|c| !near(c.centre(), first.centre(), scale)) {
        return Diversity::Enough;
    }
    let turned = |c: &Camera| {
        let (a, b) = (c.world_from_camera.matrix3, first.world_from_camera.matrix3);
        !near(a.z_axis, b.z_axis, 1.0) || !near(a.x_axis, b.x_axis, 1.0)
    };
    if rest.iter().any(|c| turned(c)) { Diversity::OneCentre } else { Diversity::Identical }
}

/// Problems of one image's pixels. Pixels outside the mask do not count.
fn content(view: &ViewRecord) -> Vec<Problem> {
    let warn = |message: String| {
        vec![problem(Severity::Warning, ProblemKind::Content, view.image.clone(), &view.location, message)]
    };
    let loaded = match comgs_image::read(&view.image) {
        Ok(loaded) => loaded,
        Err(error) => {
            let kind = ProblemKind::UnreadableImage;
            let message = image_reason(&error);
            return vec![problem(Severity::Error, kind, view.image.clone(), &view.location, message)];
        }
    };
    let bad = loaded.color.non_finite();
    if bad > 0 {
        return warn(format!("{bad} values are NaN or infinite; those pixels are ignored"));
    }
    let (mut count, mut sum, mut squares, mut saturated) = (0usize, 0.0f64, 0.0f64, 0usize);
    for (i, pixel) in loaded.color.data.chunks_exact(loaded.color.channels).enumerate() {
        if loaded.alpha.as_ref().is_some_and(|a| a.data[i] < 0.5) {
            continue;
        }
        let mean = pixel.iter().sum::<f32>() / pixel.len() as f32;
        let code = f64::from(transfer::srgb_from_linear(mean));
        count += 1;
        sum += code;
        squares += code * code;
        saturated += usize::from(pixel.iter().all(|&v| v >= 0.999));
    }
    if count == 0 {
        return warn("the mask is empty: nothing of the object is in the image".into());
    }
    let mean = sum / count as f64;
    let deviation = (squares / count as f64 - mean * mean).max(0.0).sqrt();
    if mean < 1.0 / 255.0 && deviation < 1.0 / 255.0 {
        warn(BLACK.into())
    } else if saturated as f64 > 0.98 * count as f64 {
        warn("the image is saturated".into())
    } else if deviation < TEXTURELESS {
        warn("the image has no texture".into())
    } else {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: one camera, identical cameras and turning on the spot are told apart (hard case 14).
    #[test]
    fn diversity_of_cameras() {
        let camera = |x: f64, y: f64| {
            let eye = DVec3::new(x, 0.0, 1.0);
            Camera::look_at("a", 8, 8, 1.0, eye, eye + DVec3::new(1.0, y, 0.0), DVec3::Z)
        };
        let cameras = [camera(0.0, 0.0), camera(0.0, 0.0), camera(0.0, 0.5), camera(1.0, 0.0)];
        let [a, same, turned, moved] = &cameras;
        assert_eq!(diversity(&[]), Diversity::None);
        assert_eq!(diversity(&[a]), Diversity::One);
        assert_eq!(diversity(&[a, same]), Diversity::Identical);
        assert_eq!(diversity(&[a, same, turned]), Diversity::OneCentre);
        assert_eq!(diversity(&[a, turned, moved]), Diversity::Enough);
    }
}
