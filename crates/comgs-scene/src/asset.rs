//! Assets: a folder with `asset.json` and the binary files it vouches for.
//!
//! `asset.json` lists every file with its size and BLAKE3 checksum. It is committed last and nothing is replaced before
//! all new files are completely written, so a crash or a full disk leaves the old asset, and whatever is torn
//! does not load.

use crate::SceneError;
use crate::capture::Format;
use crate::json;
use comgs_image::atomic::{self, Staged};
use comgs_surfel::{ColorEncoding, PlyReport, PlyStyle, SurfelCloud, ply};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Version of `asset.json` that is written, and the newest that is read.
pub const ASSET_VERSION: u64 = 1;
/// Name of the record in an asset's folder.
pub const ASSET_FILE: &str = "asset.json";
/// Name of the surfels in an asset's folder.
pub const SURFELS_FILE: &str = "surfels.ply";
/// Largest accepted `asset.json`.
const MAX_RECORD_BYTES: u64 = 4 << 20;

/// What an asset is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AssetKind {
    /// A thing that can be placed, cut out of its background.
    Object,
    /// A place with its surroundings.
    Scene,
}

/// Unit of an asset's coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// The capture knows its scale.
    Metre,
    /// The capture's own unit.
    #[default]
    Unknown,
}

/// Axis-aligned box of the surfel centres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Smallest coordinates.
    pub low: [f32; 3],
    /// Largest coordinates.
    pub high: [f32; 3],
}

/// Where an asset's photographs came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CaptureRecord {
    /// Name of the capture's folder.
    pub name: String,
    /// Its format.
    pub format: Format,
    /// Views that were trained on.
    pub views: usize,
    /// Size of the training images in pixels.
    pub image_size: [usize; 2],
    /// Whether the photographs were linear HDR.
    pub hdr: bool,
    /// Names of listed frames that were left out.
    #[serde(default)]
    pub left_out: Vec<String>,
}

/// How an asset was trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Version of the program.
    pub program: String,
    /// Seed.
    pub seed: u64,
    /// Optimiser steps.
    pub iterations: u64,
    /// Wall-clock time.
    pub seconds: f64,
    /// The resolved configuration, whole.
    pub config: serde_json::Value,
    /// Measured figures, by name (`train_psnr_db`, …).
    #[serde(default)]
    pub metrics: BTreeMap<String, f64>,
}

/// A file of an asset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Size.
    pub bytes: u64,
    /// Checksum, 64 hexadecimal digits.
    pub blake3: String,
}

/// The content of `asset.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AssetRecord {
    /// [`ASSET_VERSION`].
    pub version: u64,
    /// What it is.
    pub kind: AssetKind,
    /// Box of the surfels; absent when there are none.
    pub bounds: Option<Bounds>,
    /// Unit vector towards the sky in the asset's coordinates.
    pub up: [f64; 3],
    /// Unit of the coordinates.
    pub unit: Unit,
    /// What the surfels' harmonics mean: `srgb` or `linear`.
    pub color_encoding: EncodingName,
    /// Provenance.
    pub capture: Option<CaptureRecord>,
    /// Training.
    pub training: Option<TrainingRecord>,
    /// The files beside `asset.json`, by name.
    pub files: BTreeMap<String, FileRecord>,
}

/// [`ColorEncoding`] by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EncodingName {
    /// [`ColorEncoding::Srgb`].
    Srgb,
    /// [`ColorEncoding::Linear`].
    Linear,
}

impl From<ColorEncoding> for EncodingName {
    fn from(encoding: ColorEncoding) -> Self {
        match encoding {
            ColorEncoding::Srgb => Self::Srgb,
            ColorEncoding::Linear => Self::Linear,
        }
    }
}

/// Parses and checks an `asset.json`; `path` is only for messages.
///
/// # Errors
/// [`SceneError::NewerVersion`], or [`SceneError::Json`] with the place.
pub fn parse_record(bytes: &[u8], path: &Path) -> Result<AssetRecord, SceneError> {
    #[derive(Deserialize)]
    struct Probe {
        version: u64,
    }
    let Probe { version } = json::parse(bytes, "", path)?;
    if version > ASSET_VERSION {
        return Err(SceneError::NewerVersion {
            path: path.to_owned(),
            found: version,
            supported: ASSET_VERSION,
        });
    }
    let record: AssetRecord = json::parse(bytes, "", path)?;
    let length = record.up.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !((length - 1.0).abs() < 1e-3) {
        return Err(SceneError::json(path, "up", format!("{:?} has length {length}, expected 1", record.up)));
    }
    if let Some(b) = &record.bounds
        && !(0..3).all(|i| b.low[i] <= b.high[i])
    {
        return Err(SceneError::json(path, "bounds", format!("{:?} is above {:?}", b.low, b.high)));
    }
    for (name, file) in &record.files {
        let at = format!("files.{name}");
        if !crate::capture::frame::is_plain_name(name) {
            return Err(SceneError::json(path, at, "not a plain file name"));
        }
        if file.blake3.len() != 64 || !file.blake3.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(SceneError::json(path, format!("{at}.blake3"), "expected 64 hexadecimal digits"));
        }
    }
    if !record.files.contains_key(SURFELS_FILE) {
        return Err(SceneError::json(path, "files", format!("{SURFELS_FILE} is not listed")));
    }
    Ok(record)
}

/// A file to be saved with an asset, under its plain name.
pub type ExtraFile<'a> = (&'a str, &'a dyn Fn(&mut dyn Write) -> io::Result<()>);

/// A loaded asset.
#[derive(Clone, Debug)]
pub struct Asset {
    /// Its record.
    pub record: AssetRecord,
    /// Its surfels.
    pub surfels: SurfelCloud,
    /// Its folder; empty before it is saved.
    pub root: PathBuf,
}

impl Asset {
    /// A new asset in memory, z up, of unknown unit.
    #[must_use]
    pub fn new(kind: AssetKind, surfels: SurfelCloud) -> Self {
        let record = AssetRecord {
            version: ASSET_VERSION,
            kind,
            bounds: None,
            up: [0.0, 0.0, 1.0],
            unit: Unit::Unknown,
            color_encoding: surfels.color_encoding.into(),
            capture: None,
            training: None,
            files: BTreeMap::new(),
        };
        Self { record, surfels, root: PathBuf::new() }
    }

    /// Whether a folder claims to be an asset.
    #[must_use]
    pub fn is_asset(path: &Path) -> bool {
        path.join(ASSET_FILE).is_file()
    }

    /// Loads an asset's folder and verifies every listed file.
    ///
    /// # Errors
    /// [`SceneError::Io`] when `asset.json` is not there, [`SceneError::Json`] and [`SceneError::NewerVersion`] for its
    /// content, [`SceneError::Damaged`] when a file is missing or is not the one that was saved.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        Self::load_with_report(path).map(|(asset, _)| asset)
    }

    /// [`Asset::load`], with what the PLY reader has to say.
    ///
    /// # Errors
    /// As [`Asset::load`].
    pub fn load_with_report(path: impl AsRef<Path>) -> Result<(Self, PlyReport), SceneError> {
        let root = path.as_ref();
        let record_path = root.join(ASSET_FILE);
        let record = parse_record(&json::read_limited(&record_path, MAX_RECORD_BYTES)?, &record_path)?;
        for (name, expected) in &record.files {
            verify(&root.join(name), expected)?;
        }
        let (surfels, report) = ply::read_surfels(&root.join(SURFELS_FILE))?;
        Ok((Self { record, surfels, root: root.to_owned() }, report))
    }

    /// A listed file of the asset.
    #[must_use]
    pub fn file(&self, name: &str) -> Option<PathBuf> {
        self.record.files.contains_key(name).then(|| self.root.join(name))
    }

    /// Saves the asset into a folder, which is made if need be. Bounds, encoding and file list of the record are brought
    /// up to date. A crash or a full disk leaves the asset that was there before, or one that does not load.
    ///
    /// # Errors
    /// [`SceneError::Write`].
    pub fn save(&mut self, path: impl AsRef<Path>) -> Result<(), SceneError> {
        self.save_with(path, &[])
    }

    /// [`Asset::save`] with further files (`env.exr`, probes); files that the asset had before stay listed when it is
    /// saved where it was.
    ///
    /// # Errors
    /// [`SceneError::Write`], also for an extra name that is no plain file name or is taken; [`SceneError::Json`] when
    /// the record holds what could not be read back (an `up` that is no unit vector).
    pub fn save_with(&mut self, path: impl AsRef<Path>, extra: &[ExtraFile<'_>]) -> Result<(), SceneError> {
        let root = path.as_ref();
        let mut record = self.record.clone();
        record.version = ASSET_VERSION;
        record.color_encoding = self.surfels.color_encoding.into();
        record.bounds =
            self.surfels.bounds().map(|(low, high)| Bounds { low: low.to_array(), high: high.to_array() });
        if self.root != root {
            record.files.clear();
        }
        // JSON has no NaN and no infinity (the PSNR of a perfect image); such figures are left out.
        if let Some(training) = &mut record.training {
            training.metrics.retain(|_, v| v.is_finite());
        }
        let mut staged: Vec<(PathBuf, Staged)> = Vec::new();
        let mut stage = |name: &str, fill: &dyn Fn(&mut dyn Write) -> io::Result<()>| {
            let path = root.join(name);
            let (mut hasher, mut bytes) = (blake3::Hasher::new(), 0);
            let file = atomic::stage_file(&path, |inner| {
                fill(&mut Summed { inner, hasher: &mut hasher, bytes: &mut bytes })
            })
            .map_err(SceneError::write(&path))?;
            let file_record = FileRecord { bytes, blake3: hasher.finalize().to_hex().to_string() };
            staged.push((path, file));
            Ok::<_, SceneError>(file_record)
        };
        let surfels = stage(SURFELS_FILE, &|w| ply::write_surfels_to(w, &self.surfels, PlyStyle::Asset))?;
        record.files.insert(SURFELS_FILE.to_owned(), surfels);
        for (name, fill) in extra {
            if !crate::capture::frame::is_plain_name(name) || [ASSET_FILE, SURFELS_FILE].contains(name) {
                let reason = io::Error::new(io::ErrorKind::InvalidInput, "not a free plain file name");
                return Err(SceneError::Write { path: root.join(name), reason });
            }
            let file_record = stage(name, fill)?;
            record.files.insert((*name).to_owned(), file_record);
        }
        let record_path = root.join(ASSET_FILE);
        let text = json::to_text(&record).map_err(SceneError::write(&record_path))?;
        // What would not load must not be written.
        parse_record(text.as_bytes(), &record_path)?;
        let last = atomic::stage_file(&record_path, |w| w.write_all(text.as_bytes()))
            .map_err(SceneError::write(&record_path))?;
        staged.push((record_path, last));
        for (path, file) in staged {
            file.commit().map_err(SceneError::write(&path))?;
        }
        self.record = record;
        self.root = root.to_owned();
        Ok(())
    }
}

/// A writer that counts and hashes what passes.
struct Summed<'a> {
    inner: &'a mut dyn Write,
    hasher: &'a mut blake3::Hasher,
    bytes: &'a mut u64,
}

impl Write for Summed<'_> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.inner.write(buffer)?;
        self.hasher.update(&buffer[..written]);
        *self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// Compares a file with its record.
fn verify(path: &Path, expected: &FileRecord) -> Result<(), SceneError> {
    let damaged = |reason: String| SceneError::Damaged { path: path.to_owned(), reason };
    let mut file = match std::fs::File::open(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Err(damaged("the file is missing".into())),
        other => other.map_err(SceneError::io(path))?,
    };
    let bytes = file.metadata().map_err(SceneError::io(path))?.len();
    if bytes != expected.bytes {
        return Err(damaged(format!("{bytes} bytes, expected {}", expected.bytes)));
    }
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0u8; 1 << 16];
    loop {
        match file.read(&mut buffer).map_err(SceneError::io(path))? {
            0 => break,
            n => hasher.update(&buffer[..n]),
        };
    }
    let found = hasher.finalize().to_hex();
    if !found.as_str().eq_ignore_ascii_case(&expected.blake3) {
        return Err(damaged(format!("the checksum is {found}, expected {}", expected.blake3)));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
