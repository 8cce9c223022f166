//! What a stage was made from, as one number: contents of its input files, resolved configuration, version.

use crate::PipelineError;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Collects what a result depends on. Equal fingerprints mean: running again would give the same bytes.
pub struct Fingerprint {
    hasher: blake3::Hasher,
}

impl Fingerprint {
    /// For a stage of this version of comgs.
    #[must_use]
    pub fn new(stage: &str) -> Self {
        let mut fingerprint = Self { hasher: blake3::Hasher::new() };
        fingerprint.entry("version", crate::VERSION.as_bytes());
        fingerprint.entry("stage", stage.as_bytes());
        fingerprint
    }

    /// Adds a named value; names and lengths are part of the hash, so that entries cannot run into each other.
    pub fn entry(&mut self, name: &str, value: &[u8]) {
        for part in [name.as_bytes(), value] {
            self.hasher.update(&(part.len() as u64).to_le_bytes());
            self.hasher.update(part);
        }
    }

    /// Adds a configuration by its JSON.
    ///
    /// # Errors
    /// When the value has no JSON form.
    pub fn config(&mut self, name: &str, value: &impl Serialize) -> Result<(), PipelineError> {
        let json = serde_json::to_vec(value)
            .map_err(|e| PipelineError::Internal(format!("{name} cannot be written as JSON: {e}")))?;
        self.entry(name, &json);
        Ok(())
    }

    /// Adds a file's content, or the names and contents of everything in a folder, whatever it is called outside:
    /// a moved or touched capture is still the same capture. Files and folders whose names begin with a dot, run
    /// records and checkpoints are left out.
    ///
    /// # Errors
    /// [`PipelineError::Io`] when something cannot be read.
    pub fn path(&mut self, name: &str, path: &Path) -> Result<(), PipelineError> {
        let mut files = Vec::new();
        if path.is_dir() {
            list(path, Path::new(""), &mut files)?;
            files.sort();
        } else {
            files.push(PathBuf::new());
        }
        // Contents are hashed in parallel and combined in the order of the names.
        let hashes: Vec<Result<blake3::Hash, PipelineError>> = files
            .par_iter()
            .map(|file| {
                let full = if file.as_os_str().is_empty() { path.to_owned() } else { path.join(file) };
                hash_file(&full)
            })
            .collect();
        self.entry(name, &(files.len() as u64).to_le_bytes());
        for (file, hash) in files.iter().zip(hashes) {
            // `/` on every system, so that a record moves between machines.
            let text = file.to_string_lossy().replace('\\', "/");
            self.entry(&text, hash?.as_bytes());
        }
        Ok(())
    }

    /// Adds the contents of files under names of their own.
    ///
    /// # Errors
    /// [`PipelineError::Io`] when something cannot be read.
    pub fn files(&mut self, name: &str, files: &[(String, PathBuf)]) -> Result<(), PipelineError> {
        let hashes: Vec<_> = files.par_iter().map(|(_, path)| hash_file(path)).collect();
        self.entry(name, &(files.len() as u64).to_le_bytes());
        for ((name, _), hash) in files.iter().zip(hashes) {
            self.entry(name, hash?.as_bytes());
        }
        Ok(())
    }

    /// The number, as 64 hexadecimal digits.
    #[must_use]
    pub fn finish(&self) -> String {
        self.hasher.finalize().to_hex().to_string()
    }
}

/// Names that say nothing about what an input holds.
fn is_incidental(name: &str) -> bool {
    name.starts_with('.') || name == "run.json" || name.ends_with(".run.json") || name == "checkpoint"
}

fn list(root: &Path, inside: &Path, files: &mut Vec<PathBuf>) -> Result<(), PipelineError> {
    let folder = root.join(inside);
    let io = |e| PipelineError::io(&folder, e);
    for entry in std::fs::read_dir(&folder).map_err(io)? {
        let entry = entry.map_err(io)?;
        if is_incidental(&entry.file_name().to_string_lossy()) {
            continue;
        }
        let path = inside.join(entry.file_name());
        // Symbolic links are followed: captures are often linked together.
        if root.join(&path).is_dir() {
            // A loop of links would otherwise recurse for ever.
            if path.components().count() < 16 {
                list(root, &path, files)?;
            }
        } else {
            files.push(path);
        }
    }
    Ok(())
}

fn hash_file(path: &Path) -> Result<blake3::Hash, PipelineError> {
    let mut hasher = blake3::Hasher::new();
    let mut file = std::fs::File::open(path).map_err(|e| PipelineError::io(path, e))?;
    std::io::copy(&mut file, &mut hasher).map_err(|e| PipelineError::io(path, e))?;
    Ok(hasher.finalize())
}

/// Hash of one file's content as hexadecimal digits.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn content_hash(path: &Path) -> Result<String, PipelineError> {
    Ok(hash_file(path)?.to_hex().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(path: &Path) -> String {
        let mut f = Fingerprint::new("test");
        f.path("input", path).unwrap();
        f.finish()
    }

    /// Goal: content and names count; place, time and incidental files do not.
    #[test]
    fn content_counts_and_place_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        for root in [&a, &b] {
            std::fs::create_dir_all(root.join("images")).unwrap();
            std::fs::write(root.join("images/0.png"), b"one").unwrap();
            std::fs::write(root.join("cameras.json"), b"{}").unwrap();
        }
        assert_eq!(of(&a), of(&b));
        std::fs::write(b.join("run.json"), b"whatever").unwrap();
        assert_eq!(of(&a), of(&b));
        std::fs::rename(b.join("images/0.png"), b.join("images/1.png")).unwrap();
        assert_ne!(of(&a), of(&b));
        std::fs::rename(b.join("images/1.png"), b.join("images/0.png")).unwrap();
        assert_eq!(of(&a), of(&b));
        std::fs::write(b.join("images/0.png"), b"two").unwrap();
        assert_ne!(of(&a), of(&b));
    }

    /// Goal: entries cannot run into each other, and a missing input is an error with its path.
    #[test]
    fn entries_are_separated() {
        let mut one = Fingerprint::new("s");
        one.entry("ab", b"c");
        let mut two = Fingerprint::new("s");
        two.entry("a", b"bc");
        assert_ne!(one.finish(), two.finish());
        let missing = Fingerprint::new("s").path("x", Path::new("/nonexistent/thing")).unwrap_err();
        assert!(missing.to_string().contains("/nonexistent/thing"), "{missing}");
    }
}
