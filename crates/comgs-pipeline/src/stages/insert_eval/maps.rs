//! Which maps are taken, and which of them the shipped completer has seen.

use crate::PipelineError;
use std::path::{Path, PathBuf};

/// Maps of Poly Haven that the shipped completer was trained on or validated with (`scripts/panorama/data.py`, `hdri_split`).
/// Maps by any other name it has never seen.
const SEEN: [&str; 23] = [
    "adams_place_bridge",
    "aristea_wreck_puresky",
    "autoshop_01",
    "brown_photostudio_01",
    "brown_photostudio_02",
    "brown_photostudio_07",
    "chinese_garden",
    "circus_arena",
    "city",
    "drachenfels_cellar",
    "hilly_terrain_01",
    "leadenhall_market",
    "lobby",
    "narrow_moonlit_road",
    "noon_grass",
    "peppermint_powerplant",
    "phalzer_forest_01",
    "sepulchral_chapel_rotunda",
    "sky",
    "studio",
    "studio_small_05",
    "vestibule",
    "workshop",
];

/// A map of the benchmark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Chosen {
    pub path: PathBuf,
    pub name: String,
    /// Its number: it decides the heading and the object.
    pub number: usize,
    /// Whether the shipped completer has never seen it.
    pub unseen: bool,
}

/// `count` maps spread evenly over a folder's sorted maps, and up to `unseen` further ones that the shipped completer never
/// saw; the file itself for a file.
pub(super) fn chosen(path: &Path, count: usize, unseen: usize) -> Result<Vec<Chosen>, PipelineError> {
    let maps = if path.is_file() { vec![path.to_owned()] } else { listed(path)? };
    let even = count.min(maps.len());
    let mut taken: Vec<usize> = (0..even).map(|k| k * maps.len() / even).collect();
    let name = |k: usize| maps[k].file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let new = |k: usize| !SEEN.contains(&name(k).as_str());
    let more: Vec<usize> = (0..maps.len()).filter(|k| !taken.contains(k) && new(*k)).take(unseen).collect();
    taken.extend(more);
    if taken.is_empty() {
        let expected = "environment maps (.exr, .hdr), and a number of them to take";
        return Err(PipelineError::input(path.display().to_string(), expected, "none"));
    }
    let one =
        |(number, k): (usize, usize)| Chosen { path: maps[k].clone(), name: name(k), number, unseen: new(k) };
    Ok(taken.into_iter().enumerate().map(one).collect())
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>, PipelineError> {
    let entries = std::fs::read_dir(folder).map_err(|e| PipelineError::io(folder, e))?;
    let mut maps: Vec<PathBuf> = entries
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| matches!(crate::source::extension(p).as_str(), "exr" | "hdr"))
        .collect();
    maps.sort();
    Ok(maps)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: unseen maps are added to the evenly spread ones without changing their numbers, and no map is taken twice.
    #[test]
    fn unseen_maps_come_after_the_spread_ones() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a_new.exr", "city.exr", "mine.hdr", "sky.exr", "notes.txt"] {
            std::fs::write(folder.path().join(name), b"").unwrap();
        }
        let names = |count, unseen| -> Vec<(String, usize, bool)> {
            let all = chosen(folder.path(), count, unseen).unwrap();
            all.into_iter().map(|c| (c.name, c.number, c.unseen)).collect()
        };
        let of = |name: &str, number, unseen| (name.to_owned(), number, unseen);
        assert_eq!(names(2, 0), [of("a_new", 0, true), of("mine", 1, true)]);
        assert_eq!(names(4, 9).len(), 4);
        assert_eq!(names(1, 9), [of("a_new", 0, true), of("mine", 1, true)]);
        assert_eq!(names(0, 1), [of("a_new", 0, true)]);
        let error = chosen(folder.path(), 0, 0).unwrap_err().to_string();
        assert!(error.contains("environment maps"), "{error}");
        let one = chosen(&folder.path().join("sky.exr"), 11, 11).unwrap();
        assert_eq!((one.len(), one[0].unseen), (1, false));
        let mut sorted = SEEN;
        sorted.sort_unstable();
        assert_eq!(sorted, SEEN);
    }
}
