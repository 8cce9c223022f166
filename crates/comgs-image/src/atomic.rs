//! Files that are whole or not there: write beside the target, then rename.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A file that is completely written but does not have its name yet; dropped without [`Staged::commit`] it is gone.
///
/// Several files that belong together are staged first and committed last, so that a full disk is met while
/// all of the old files still stand.
#[derive(Debug)]
pub struct Staged {
    file: tempfile::NamedTempFile,
    path: PathBuf,
}

impl Staged {
    /// Gives the file its name, replacing what had it.
    ///
    /// # Errors
    /// Whatever the file system says; the temporary file is removed.
    pub fn commit(self) -> io::Result<()> {
        self.file.persist(&self.path).map_err(|e| e.error)?;
        Ok(())
    }
}

/// Writes a file beside `path`, without touching what is there. Creates the folder.
///
/// # Errors
/// Whatever the file system says; the temporary file is removed.
pub fn stage_file(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<Staged> {
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder)?;
    let mut file = tempfile::Builder::new().prefix(".comgs-").suffix(".part").tempfile_in(folder)?;
    {
        let mut writer = io::BufWriter::new(file.as_file_mut());
        fill(&mut writer)?;
        writer.flush()?;
    }
    make_readable(file.as_file())?;
    Ok(Staged { file, path: path.to_owned() })
}

/// Writes a file so that a crash or a full disk leaves either the old file or the new one. Creates the folder.
///
/// # Errors
/// Whatever the file system says; the temporary file is removed.
pub fn write_file(path: &Path, fill: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    stage_file(path, fill)?.commit()
}

/// Temporary files are private to their owner; results should have ordinary permissions.
#[cfg(unix)]
fn make_readable(file: &std::fs::File) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(std::fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn make_readable(_: &std::fs::File) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: a failed write leaves the old content and no litter.
    #[test]
    fn failure_leaves_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/a.txt");
        write_file(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_file(&path, |w| {
            w.write_all(b"new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    /// Goal: a staged file changes nothing until it is committed, and leaves nothing when it is not.
    #[test]
    fn staged_until_committed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_file(&path, |w| w.write_all(b"old")).unwrap();
        let staged = stage_file(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        drop(staged);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        stage_file(&path, |w| w.write_all(b"new")).unwrap().commit().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }
}
