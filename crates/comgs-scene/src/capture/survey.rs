//! From camera lists to views: files are found, sizes reconciled, cameras checked, splits made. Shared by opening,
//! checking and reading of cameras alone.

use super::files::{Folders, orphan_masks};
use super::frame::{Frame, Listing};
use super::recognise::{Part, Recognised, recognise};
use super::{
    Capture, CheckReport, Format, HOLD_OUT_EVERY, OpenOptions, Problem, ProblemKind, Severity, Split,
    ViewRecord, colmap, syncom, transforms,
};
use crate::SceneError;
use crate::json;
use comgs_geom::Camera;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// What a walk over a capture's lists and file headers gives.
pub(crate) struct Survey {
    pub views: Vec<ViewRecord>,
    pub report: CheckReport,
    pub held_out: bool,
    pub up: DVec3,
    pub points_path: Option<PathBuf>,
}

/// Whether images are needed or only cameras.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    Images,
    Cameras,
}

pub(super) fn open(path: &Path, options: &OpenOptions) -> Result<Capture, SceneError> {
    let recognised = recognise(path)?;
    let mut survey = survey(&recognised, options, Need::Images)?;
    if survey.views.is_empty() && survey.report.is_sound() {
        let message = format!("no usable view in the split {:?}", options.split.name());
        survey.report.problems.push(Problem {
            severity: Severity::Error,
            kind: ProblemKind::Views,
            path: recognised.root.clone(),
            location: String::new(),
            message,
        });
    }
    if !survey.report.is_sound() {
        return Err(SceneError::Unsound(Box::new(survey.report)));
    }
    Ok(Capture {
        root: recognised.root,
        format: recognised.format,
        split: options.split,
        held_out: survey.held_out,
        views: survey.views,
        up: survey.up,
        report: survey.report,
        points_path: survey.points_path,
    })
}

/// Walks the lists of a capture. Problems of frames go to the report; `Err` is for a list that cannot be read at all.
pub(crate) fn survey(
    recognised: &Recognised,
    options: &OpenOptions,
    need: Need,
) -> Result<Survey, SceneError> {
    let mut walk = Walk { format: recognised.format, need, problems: Vec::new(), left_out: Vec::new() };
    let mut views: Vec<ViewRecord> = Vec::new();
    let mut held_out = false;
    let mut points_path = None;
    let mut ups = Vec::new();
    for part in &recognised.parts {
        let wanted = options.split == Split::All || part.split.is_none_or(|s| s == options.split);
        if !wanted {
            continue;
        }
        let listing = read_list(part, recognised.format)?;
        points_path = points_path.or_else(|| find_points(recognised, part, &listing));
        ups.extend(listing.frames.iter().map(|f| -f.world_from_camera.matrix3.y_axis));
        let splits: Vec<Option<Split>> = listing.frames.iter().map(|f| f.split).collect();
        let found = walk.part(part, &listing, options);
        let has_own = splits.iter().any(Option::is_some);
        let hold_out =
            part.split.is_none() && !has_own && found.len() >= HOLD_OUT_EVERY && need == Need::Images;
        held_out |= hold_out;
        for (i, (index, mut view)) in found.into_iter().enumerate() {
            view.split = match (part.split, has_own) {
                (Some(split), _) => split,
                // A frame that the list puts in no split is not used at all.
                (None, true) => match splits[index] {
                    Some(split) => split,
                    None => continue,
                },
                (None, false) if hold_out && i % HOLD_OUT_EVERY == 0 => Split::Test,
                (None, false) => Split::Train,
            };
            if options.split == Split::All || options.split == view.split {
                views.push(view);
            }
        }
    }
    unique_across_splits(&mut views);
    let count = |split| views.iter().filter(|v| v.split == split).count();
    let report = CheckReport {
        root: recognised.root.clone(),
        format: Some(recognised.format),
        train_views: count(Split::Train),
        test_views: count(Split::Test),
        left_out: walk.left_out,
        problems: walk.problems,
    };
    let up = match recognised.format {
        Format::Colmap => mean_direction(&ups),
        _ => DVec3::Z,
    };
    Ok(Survey { views, report, held_out, up, points_path })
}

/// Mean of unit vectors; +z when they cancel.
fn mean_direction(directions: &[DVec3]) -> DVec3 {
    let mean = directions.iter().sum::<DVec3>() / directions.len().max(1) as f64;
    if mean.length() > 0.2 { mean.normalize() } else { DVec3::Z }
}

/// Reads and parses a part's list.
pub(super) fn read_list(part: &Part, format: Format) -> Result<Listing, SceneError> {
    match format {
        Format::SynCom => syncom::parse(&json::read_limited(&part.list, json::MAX_BYTES)?, &part.list),
        Format::Transforms => {
            transforms::parse(&json::read_limited(&part.list, json::MAX_BYTES)?, &part.list)
        }
        Format::Colmap => {
            let binary = part.list.join("images.bin").is_file() && part.list.join("cameras.bin").is_file();
            let file = |name: &str| {
                let path = part.list.join(format!("{name}.{}", if binary { "bin" } else { "txt" }));
                let file = std::fs::File::open(&path).map_err(SceneError::io(&path))?;
                let length = file.metadata().map_err(SceneError::io(&path))?.len();
                Ok::<_, SceneError>((BufReader::with_capacity(1 << 16, file), length, path))
            };
            let ((cameras, cameras_length, cameras_path), (images, images_length, images_path)) =
                (file("cameras")?, file("images")?);
            let (cameras, images) = if binary {
                (
                    colmap::parse_cameras_binary(cameras, cameras_length, &cameras_path)?,
                    colmap::parse_images_binary(images, images_length, &images_path)?,
                )
            } else {
                (
                    colmap::parse_cameras_text(cameras, &cameras_path)?,
                    colmap::parse_images_text(images, &images_path)?,
                )
            };
            Ok(colmap::listing(&cameras, images))
        }
    }
}

fn find_points(recognised: &Recognised, part: &Part, listing: &Listing) -> Option<PathBuf> {
    let candidates = match recognised.format {
        Format::Colmap => {
            ["points3D.bin", "points3D.txt", "points3D.ply"].map(|n| part.list.join(n)).to_vec()
        }
        _ => {
            let mut candidates: Vec<PathBuf> = listing.points.iter().map(|p| part.base.join(p)).collect();
            for folder in [&recognised.root, &part.base] {
                candidates.extend(["points3d.ply", "points3D.ply"].map(|n| folder.join(n)));
            }
            candidates
        }
    };
    candidates.into_iter().find(|p| p.is_file())
}

/// Views of different splits may share names (SynCom numbers both from 0); together they must not.
fn unique_across_splits(views: &mut [ViewRecord]) {
    let mut owners: HashMap<String, HashSet<&'static str>> = HashMap::new();
    for view in views.iter() {
        owners.entry(view.camera.name.clone()).or_default().insert(view.split.name());
    }
    if owners.values().any(|splits| splits.len() > 1) {
        for view in views {
            view.camera.name = format!("{}_{}", view.split.name(), view.camera.name);
        }
    }
}

struct Walk {
    format: Format,
    need: Need,
    problems: Vec<Problem>,
    left_out: Vec<String>,
}

impl Walk {
    /// The usable views of a part, each with its frame's index.
    fn part(&mut self, part: &Part, listing: &Listing, options: &OpenOptions) -> Vec<(usize, ViewRecord)> {
        for fault in &listing.faults {
            self.problems.push(Problem {
                severity: fault.severity,
                kind: fault.kind,
                path: part.list.clone(),
                location: fault.location.clone(),
                message: fault.message.clone(),
            });
        }
        self.duplicates(part, listing);
        let folders = Folders::new(self.format, &part.base, options.images.as_deref());
        let (format, need) = (self.format, self.need);
        // Headers are read in parallel; results keep list order.
        let resolved: Vec<Resolved> =
            listing.frames.par_iter().map(|frame| resolve(frame, part, &folders, format, need)).collect();
        let mut views = Vec::new();
        let mut stems = HashSet::new();
        let mut used = HashSet::new();
        for (index, (frame, resolved)) in listing.frames.iter().zip(resolved).enumerate() {
            self.problems.extend(resolved.problems);
            stems.extend(resolved.image.and_then(|i| i.file_name()?.to_str().map(|n| stem(n).to_owned())));
            match resolved.view {
                Some(view) => {
                    used.extend(view.mask.clone());
                    views.push((index, view));
                }
                None => self.left_out.push(frame.name.clone()),
            }
        }
        let alternatives = match listing.frames.first() {
            Some(first) if views.is_empty() && need == Need::Images => folders.alternatives(&first.file),
            _ => Vec::new(),
        };
        if !alternatives.is_empty() {
            self.problems.push(Problem {
                severity: Severity::Error,
                kind: ProblemKind::MissingImage,
                path: folders.expected(""),
                location: String::new(),
                message: format!(
                    "no image was found; folders beside it that hold such images: {}",
                    alternatives.join(", ")
                ),
            });
        }
        if need == Need::Images {
            let mut mask_folders: Vec<PathBuf> =
                views.iter().flat_map(|(_, v)| folders.mask_folders(&v.image)).collect();
            mask_folders.sort();
            mask_folders.dedup();
            for path in orphan_masks(&mask_folders, &stems, &used) {
                self.problems.push(Problem {
                    severity: Severity::Warning,
                    kind: ProblemKind::OrphanMask,
                    path,
                    location: String::new(),
                    message: "a mask without its image".into(),
                });
            }
        }
        views
    }

    fn duplicates(&mut self, part: &Part, listing: &Listing) {
        let mut first: HashMap<&str, &Frame> = HashMap::new();
        for frame in &listing.frames {
            if let Some(other) = first.insert(&frame.name, frame) {
                self.problems.push(Problem {
                    severity: Severity::Error,
                    kind: ProblemKind::DuplicateName,
                    path: part.list.clone(),
                    location: frame.location.clone(),
                    message: format!("the name {:?} is also that of {}", frame.name, other.location),
                });
            }
        }
    }
}

fn stem(file: &str) -> &str {
    super::frame::without_extension(file)
}

#[derive(Default)]
struct Resolved {
    view: Option<ViewRecord>,
    /// The image, also where the frame cannot be used.
    image: Option<PathBuf>,
    problems: Vec<Problem>,
}

impl Resolved {
    fn problem(&mut self, severity: Severity, kind: ProblemKind, path: &Path, at: &str, message: String) {
        let location = at.to_owned();
        self.problems.push(Problem { severity, kind, path: path.to_owned(), location, message });
    }
}

/// Finds a frame's files, reads their headers, and makes its camera.
fn resolve(frame: &Frame, part: &Part, folders: &Folders, format: Format, need: Need) -> Resolved {
    let mut out = Resolved::default();
    let at = frame.location.as_str();
    let must_open = need == Need::Images || frame.size.is_none();
    let image = if must_open { folders.image(&frame.file) } else { None };
    out.image.clone_from(&image);
    if must_open && image.is_none() {
        let (severity, message) = match need {
            Need::Images => (Severity::Warning, "the image is missing; its frame is left out"),
            Need::Cameras => (Severity::Error, "no image size is stated and the image is missing"),
        };
        let expected = folders.expected(&frame.file);
        out.problem(severity, ProblemKind::MissingImage, &expected, at, message.into());
        return out;
    }
    let actual = match &image {
        None => None,
        Some(image) => match comgs_image::read::dimensions(image) {
            Ok(size) => Some(size),
            Err(error) => {
                out.problem(Severity::Error, ProblemKind::UnreadableImage, image, at, image_reason(&error));
                return out;
            }
        },
    };
    let Some(declared) = frame.size.or(actual) else { return out };
    let camera = camera(frame, declared);
    let mut broken = false;
    for message in camera.problems() {
        let (kind, field) = match message.split_whitespace().next() {
            Some("pose") => (ProblemKind::Pose, pose_field(format)),
            Some("image") => (ProblemKind::ImageSize, ""),
            _ => (ProblemKind::Intrinsics, intrinsics_field(format)),
        };
        out.problem(Severity::Error, kind, &part.list, &format!("{at}{field}"), message);
        broken = true;
    }
    for message in camera.oddities() {
        let at = format!("{at}{}", intrinsics_field(format));
        out.problem(Severity::Warning, ProblemKind::Intrinsics, &part.list, &at, message);
    }
    let size = actual.unwrap_or(declared);
    let image = image.unwrap_or_default();
    if size != declared {
        let (w, h) = size;
        let (dw, dh) = declared;
        // The same picture at another resolution: one pixel of rounding is allowed along either side.
        let same_shape = (w as f64 * dh as f64 - h as f64 * dw as f64).abs() <= dw.max(dh) as f64 * 1.01;
        let downscaled = format == Format::Colmap && w < dw;
        if !same_shape {
            let message = format!("the image is {w}×{h}, declared as {dw}×{dh}");
            out.problem(Severity::Error, ProblemKind::ImageSize, &image, at, message);
            broken = true;
        } else if !downscaled {
            let message = format!("the image is {w}×{h}, declared as {dw}×{dh}; the intrinsics are rescaled");
            out.problem(Severity::Warning, ProblemKind::ImageSize, &image, at, message);
        }
    }
    let mask =
        if need == Need::Images { find_mask(frame, folders, &image, size, &mut out) } else { Ok(None) };
    if let (Ok(mask), false) = (mask, broken) {
        out.view = Some(ViewRecord {
            camera: if size == declared { camera } else { camera.resized(size.0, size.1) },
            lens: frame.lens,
            image,
            mask,
            split: Split::Train,
            list: part.list.clone(),
            location: frame.location.clone(),
        });
    }
    out
}

fn camera(frame: &Frame, (width, height): (usize, usize)) -> Camera {
    let [fx, fy, cx, cy] = frame.intrinsics.resolve(width, height);
    let world_from_camera = frame.world_from_camera;
    Camera { name: frame.name.clone(), width, height, fx, fy, cx, cy, world_from_camera }
}

fn pose_field(format: Format) -> &'static str {
    match format {
        Format::SynCom => ".extr",
        Format::Transforms => ".transform_matrix",
        Format::Colmap => "",
    }
}

fn intrinsics_field(format: Format) -> &'static str {
    if format == Format::SynCom { ".intr" } else { "" }
}

/// A frame's mask, its size checked. `Err` when it cannot be used.
fn find_mask(
    frame: &Frame,
    folders: &Folders,
    image: &Path,
    size: (usize, usize),
    out: &mut Resolved,
) -> Result<Option<PathBuf>, ()> {
    let at = frame.location.as_str();
    let mask = match &frame.mask {
        Some(listed) => {
            let path = folders.base.join(listed);
            if !path.is_file() {
                out.problem(
                    Severity::Warning,
                    ProblemKind::MissingMask,
                    &path,
                    at,
                    "the mask is missing".into(),
                );
                return Ok(None);
            }
            Some(path)
        }
        None => folders.mask(image, &frame.file),
    };
    let Some(mask) = mask else { return Ok(None) };
    match comgs_image::read::dimensions(&mask) {
        Ok(found) if found == size => Ok(Some(mask)),
        Ok((w, h)) => {
            let message = format!("the mask is {w}×{h}, its image {}×{}", size.0, size.1);
            out.problem(Severity::Error, ProblemKind::Mask, &mask, at, message);
            Err(())
        }
        Err(error) => {
            out.problem(Severity::Error, ProblemKind::Mask, &mask, at, image_reason(&error));
            Err(())
        }
    }
}

/// An image error without the path that the problem states anyway.
pub(super) fn image_reason(error: &comgs_image::ReadError) -> String {
    use comgs_image::ReadError;
    match error {
        ReadError::Io { reason, .. } => reason.to_string(),
        ReadError::Decode { reason, .. } => format!("not a readable image ({reason})"),
        ReadError::TooLarge { width, height, .. } => format!("{width}×{height} pixels are too many"),
    }
}
