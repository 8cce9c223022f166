//! What is known of one map, written after every method, so that a stopped run goes on from there.

use super::{Config, Row, maps::Chosen};
use crate::fingerprint::content_hash;
use crate::{Fingerprint, PipelineError};
use comgs_insert::composite::Crop;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Fingerprints of what a map's results depend on.
pub(super) struct Keys {
    map: String,
    /// With the guidance bundle; for score distillation alone.
    bundle: String,
}

impl Keys {
    /// Of a method's result.
    pub(super) fn of(&self, distilled: bool) -> &str {
        if distilled { &self.bundle } else { &self.map }
    }
}

/// The map's content and number, and every knob but how many maps there are.
pub(super) fn keys(chosen: &Chosen, config: &Config, model: Option<&Path>) -> Result<Keys, PipelineError> {
    let of = |model: Option<&Path>| {
        let mut fingerprint = Fingerprint::new("insert-eval map");
        fingerprint.path("map", &chosen.path)?;
        fingerprint.entry("number", &(chosen.number as u64).to_le_bytes());
        fingerprint.config("config", &Config { count: 0, unseen: 0, ..config.clone() })?;
        if let Some(model) = model {
            fingerprint.path("model", model)?;
        }
        Ok::<_, PipelineError>(fingerprint.finish())
    };
    Ok(Keys { map: of(None)?, bundle: of(model)? })
}

/// One method's row, and what it was made from.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Made {
    key: String,
    row: Row,
}

/// `<map>.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Saved {
    /// The map's name.
    pub map: String,
    key: String,
    /// The box around object and shadow, once the reference is there.
    pub crop: Option<Crop>,
    /// Hashes of the pictures by what they show.
    pictures: BTreeMap<String, String>,
    rows: Vec<Made>,
}

impl Saved {
    /// What an earlier run left of a map, as far as it was made from the same things and its pictures are as they were written.
    pub(super) fn read(path: &Path, keys: &Keys, file: impl Fn(&str) -> PathBuf) -> Self {
        let map = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let nothing =
            || Self { map, key: keys.map.clone(), crop: None, pictures: BTreeMap::new(), rows: Vec::new() };
        let read = || serde_json::from_slice::<Self>(&std::fs::read(path).ok()?).ok();
        let Some(mut saved) = read().filter(|s| s.key == keys.map) else { return nothing() };
        let intact = |what: &str| {
            saved.pictures.get(what).is_some_and(|hash| content_hash(&file(what)).is_ok_and(|h| h == *hash))
        };
        if !(intact("photo") && intact("reference")) {
            return nothing();
        }
        let rows = saved
            .rows
            .iter()
            .filter(|m| (m.key == keys.map || m.key == keys.bundle) && intact(&m.row.method))
            .cloned()
            .collect();
        saved.rows = rows;
        saved
    }

    pub(super) fn row(&self, method: &str) -> Option<&Row> {
        self.rows.iter().map(|m| &m.row).find(|r| r.method == method)
    }

    pub(super) fn add(&mut self, row: Row, key: &str) {
        self.rows.push(Made { key: key.to_owned(), row });
    }

    /// Notes a picture that was written.
    pub(super) fn picture(&mut self, what: &str, path: &Path) -> Result<(), PipelineError> {
        self.pictures.insert(what.to_owned(), content_hash(path)?);
        Ok(())
    }

    pub(super) fn write(&self, path: &Path) -> Result<(), PipelineError> {
        let text = serde_json::to_string_pretty(&json!(self))
            .map_err(|e| PipelineError::Internal(format!("a result has no JSON form: {e}")))?;
        super::write_text(path, &text)
    }
}
