//! Where results go: whether it can be written there at all, asked before any work.

use crate::PipelineError;
use comgs_image::atomic;
use std::path::{Component, Path, PathBuf};

/// The folder that a file lies in; `.` for a bare name.
#[must_use]
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether a folder can be made and written into. Leaves nothing behind: folders that were not there are removed again.
///
/// # Errors
/// [`PipelineError::Output`] with the system's words.
pub fn check_folder(folder: &Path) -> Result<(), PipelineError> {
    let failed = |doing| move |reason| PipelineError::Output { doing, folder: folder.to_owned(), reason };
    // The system says "exists" here, which is no reason.
    if let Some(file) = folder.ancestors().find(|p| p.is_file()) {
        let reason = std::io::Error::other(format!("{} is a file", file.display()));
        return Err(failed("create")(reason));
    }
    let mut made: Vec<&Path> =
        folder.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists()).collect();
    let result = std::fs::create_dir_all(folder).map_err(failed("create")).and_then(|()| {
        // A staged file that is dropped is gone.
        atomic::stage_file(&folder.join("probe"), |_| Ok(())).map(drop).map_err(failed("write into"))
    });
    for folder in made.drain(..) {
        // Innermost first; one that somebody has used in the meantime is not empty and stays.
        let _ = std::fs::remove_dir(folder);
    }
    result
}

/// Whether a file can be written: it is no folder, and its folder can be made and written into. Leaves nothing behind.
///
/// # Errors
/// [`PipelineError::Output`] or [`PipelineError::Input`].
pub fn check_file(path: &Path) -> Result<(), PipelineError> {
    if path.is_dir() {
        return Err(PipelineError::input("the output", "a file", format!("a folder, {}", path.display())));
    }
    check_folder(folder_of(path))
}

/// An output folder that is an input would overwrite it; `what` is the input's name for the message. A list (JSON) stands
/// for the folder it lies in.
///
/// # Errors
/// [`PipelineError::Input`].
pub fn refuse_input(output: &Path, what: &str, input: &Path) -> Result<(), PipelineError> {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    let list = input.is_file() && crate::source::extension(input) == "json";
    let folder = if list { folder_of(input) } else { input };
    match (real(folder), real(output)) {
        (Some(from), Some(to)) if from == to => Err(PipelineError::input(
            "-o",
            format!("another output than the {what}'s, which would be overwritten"),
            output.display().to_string(),
        )),
        _ => Ok(()),
    }
}

/// Whether a path that a record names stays below the record's folder: not absolute, without `..`.
pub(crate) fn is_below(relative: &str) -> bool {
    let path = PathBuf::from(relative);
    path.components().next().is_some() && path.components().all(|c| matches!(c, Component::Normal(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: a folder that can be made is accepted and not made; one below a file is refused in a sentence; a folder is
    /// no file.
    #[test]
    fn folders_are_tried_and_left_alone() {
        let root = tempfile::tempdir().unwrap();
        let deep = root.path().join("a/b/c");
        check_folder(&deep).unwrap();
        check_file(&deep.join("t.json")).unwrap();
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 0);
        check_folder(root.path()).unwrap();
        assert!(root.path().is_dir());

        let file = root.path().join("file");
        std::fs::write(&file, b"x").unwrap();
        for folder in [file.clone(), file.join("out")] {
            let text = check_folder(&folder).unwrap_err().to_string();
            let start = format!("cannot create the output folder {}: ", folder.display());
            assert!(text.starts_with(&start) && text.len() > start.len(), "{text}");
        }
        assert!(check_file(root.path()).unwrap_err().to_string().contains("a folder"));
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 1);
    }

    /// Goal: an input is recognised under another spelling, and by a file in it.
    #[test]
    fn inputs_are_recognised() {
        let root = tempfile::tempdir().unwrap();
        let cow = root.path().join("cow");
        std::fs::create_dir_all(cow.join("train")).unwrap();
        std::fs::write(cow.join("cameras.json"), b"[]").unwrap();
        for input in [cow.clone(), cow.join("train/.."), cow.join("cameras.json")] {
            let text = refuse_input(&cow, "capture", &input).unwrap_err().to_string();
            assert!(text.contains("capture's") && text.ends_with("cow"), "{text}");
        }
        refuse_input(&root.path().join("new"), "capture", &cow).unwrap();
        refuse_input(&cow.join("train"), "capture", &cow).unwrap();
    }

    /// Goal: paths that lead out of a folder are told from those that do not.
    #[test]
    fn paths_that_lead_out() {
        for inside in ["a", "frames/a.png", "..a/b..c"] {
            assert!(is_below(inside), "{inside}");
        }
        for outside in ["", "/etc/x", "..", "../x", "a/../../x", "./../x"] {
            assert!(!is_below(outside), "{outside}");
        }
    }
}
