//! Finding the files that a camera list refers to.

use super::{Format, frame::without_extension};
use std::path::{Path, PathBuf};

/// Extensions of images, in the order in which they are tried: the one with the most information first.
pub(super) const EXTENSIONS: [&str; 5] = ["exr", "hdr", "png", "jpg", "jpeg"];

/// Image folders of COLMAP captures, in the order in which they are tried.
const COLMAP_FOLDERS: [&str; 5] = ["images", "images_2", "images_4", "images_8", "input"];

/// Where a list's images may be.
#[derive(Clone, Debug)]
pub(super) struct Folders {
    /// The folder that listed paths are relative to.
    pub base: PathBuf,
    /// The folders that hold images, in order of preference.
    pub images: Vec<PathBuf>,
    /// Whether the folder was asked for by name, so that paths are reduced to their last part.
    pub chosen: bool,
}

impl Folders {
    pub(super) fn new(format: Format, base: &Path, chosen: Option<&Path>) -> Self {
        let images = match (chosen, format) {
            (Some(folder), _) => vec![base.join(folder)],
            (None, Format::SynCom) => vec![base.join("images"), base.to_owned()],
            (None, Format::Transforms) => vec![base.to_owned()],
            (None, Format::Colmap) => COLMAP_FOLDERS.iter().map(|f| base.join(f)).collect(),
        };
        Self { base: base.to_owned(), images, chosen: chosen.is_some() }
    }

    /// The image that a list calls `file`.
    pub(super) fn image(&self, file: &str) -> Option<PathBuf> {
        let listed = file.replace('\\', "/");
        let name = if self.chosen { listed.rsplit('/').next().unwrap_or(&listed) } else { &listed };
        self.images.iter().find_map(|folder| with_extension(folder, name, self.chosen))
    }

    /// Where the image was expected first, for messages.
    pub(super) fn expected(&self, file: &str) -> PathBuf {
        self.images.first().unwrap_or(&self.base).join(file.trim_start_matches("./"))
    }

    /// Names of folders that hold an image of this name, for a message when none was found where it should be.
    pub(super) fn alternatives(&self, file: &str) -> Vec<String> {
        let name = file.rsplit(['/', '\\']).next().unwrap_or(file);
        let Ok(entries) = std::fs::read_dir(&self.base) else { return Vec::new() };
        let mut names: Vec<String> = entries
            .take(1000)
            .flatten()
            .filter(|e| with_extension(&e.path(), name, true).is_some())
            .filter_map(|e| e.file_name().into_string().ok())
            .collect();
        names.sort();
        names
    }

    /// The folders in which masks of these images may lie.
    pub(super) fn mask_folders(&self, image: &Path) -> Vec<PathBuf> {
        let mut folders = vec![self.base.join("masks")];
        if let Some(beside) = image.parent().and_then(Path::parent) {
            let beside = beside.join("masks");
            if !folders.contains(&beside) {
                folders.push(beside);
            }
        }
        folders
    }

    /// The mask beside an image: `masks/<name>.png`, `masks/<file>.png` (COLMAP's `IMG.jpg.png`),
    /// `masks/<listed path>…`, `<name>.mask.png`.
    pub(super) fn mask(&self, image: &Path, listed: &str) -> Option<PathBuf> {
        let file = image.file_name()?.to_str()?;
        let listed = listed.trim_start_matches("./");
        for folder in self.mask_folders(image) {
            if !folder.is_dir() {
                continue;
            }
            for name in [listed, without_extension(listed), file, without_extension(file)] {
                let candidate = folder.join(format!("{name}.png"));
                if candidate.is_file() {
                    return Some(candidate);
                }
            }
        }
        let beside = image.with_file_name(format!("{}.mask.png", without_extension(file)));
        beside.is_file().then_some(beside)
    }
}

/// `folder/name`, as it is or with one of the known extensions, in small or capital letters.
fn with_extension(folder: &Path, name: &str, replace: bool) -> Option<PathBuf> {
    let exact = folder.join(name);
    if !replace && without_extension(name) != name && exact.is_file() {
        return Some(exact);
    }
    // A listed `.jpg` may lie there as `.png` when the folder was chosen (another rendering of the same view).
    let stem = if replace { without_extension(name) } else { name };
    for extension in EXTENSIONS {
        for extension in [extension.to_owned(), extension.to_uppercase()] {
            let candidate = folder.join(format!("{stem}.{extension}"));
            if candidate.is_file() {
                return Some(candidate);
            }
        }
    }
    None
}

/// Masks in the given folders that belong to none of the image stems. At most ten thousand entries are looked at.
pub(super) fn orphan_masks(
    folders: &[PathBuf],
    stems: &std::collections::HashSet<String>,
    used: &std::collections::HashSet<PathBuf>,
) -> Vec<PathBuf> {
    let mut orphans = Vec::new();
    for folder in folders {
        let Ok(entries) = std::fs::read_dir(folder) else { continue };
        for entry in entries.take(10_000).flatten() {
            let path = entry.path();
            let Some(name) = path.file_name().and_then(|n| n.to_str()) else { continue };
            let stem = without_extension(without_extension(name));
            let is_png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
            if is_png && !used.contains(&path) && !stems.contains(stem) {
                orphans.push(path);
            }
        }
    }
    orphans.sort();
    orphans
}
