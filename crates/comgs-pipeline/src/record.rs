//! `run.json`: what was run, with what, how long it took, and what came out.
//!
//! A record belongs to one stage, and a stage cleans up only after itself: what an earlier run wrote is removed at the end
//! of a run of the *same* stage, when it was not written again, nobody has changed it, and no other record claims it.
//!
//! | output | record |
//! |---|---|
//! | folder `out` | `out/run.json`; `out/<stage>.run.json` when another stage's record is there already |
//! | file `env.exr` | `env.exr.<stage>.run.json` beside it |
//! | folder that must hold nothing else | `<folder>.<stage>.run.json` beside it |

use crate::{PipelineError, fingerprint::content_hash, output};
use comgs_scene::Asset;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// One timed part of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    /// Name of the part.
    pub stage: String,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Whether an earlier result was used instead of running.
    #[serde(default)]
    pub reused: bool,
}

/// A file that a run wrote.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Relative to the record's folder, with `/`.
    pub path: String,
    /// BLAKE3 of the content.
    pub blake3: String,
    /// Size.
    pub bytes: u64,
}

/// The record of one run of one stage, written last: a folder without it is unfinished.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Version of comgs.
    pub comgs: String,
    /// Stage name.
    pub stage: String,
    /// Hash of inputs, configuration and version ([`crate::Fingerprint`]).
    pub fingerprint: String,
    /// Inputs by name, as given.
    pub inputs: Value,
    /// Resolved configuration: every knob, defaults included.
    pub config: Value,
    /// Seed, where the stage draws random numbers.
    pub seed: Option<u64>,
    /// Threads that were available.
    pub threads: usize,
    /// Wall-clock seconds of the whole run.
    pub seconds: f64,
    /// Seconds by part, in the order they ran.
    pub timings: Vec<StageTime>,
    /// Largest resident memory of the process so far in bytes, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Warnings, as shown.
    pub warnings: Vec<String>,
    /// Figures the stage reports.
    pub results: Value,
    /// Files written.
    pub outputs: Vec<OutputFile>,
}

/// Stages whose output folder is an asset. Others may not write into an asset, whose files are vouched for.
const ASSET_STAGES: [&str; 3] = ["reconstruct", "decompose", "material"];

/// What a run writes.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Target {
    /// Files in the run's folder.
    Folder,
    /// One file, perhaps with others beside it.
    File(PathBuf),
    /// A folder in the run's folder.
    Beside,
}

/// A run in progress: collects timings and warnings, and becomes a [`RunRecord`].
pub struct Run {
    record: RunRecord,
    folder: PathBuf,
    file: PathBuf,
    target: Target,
    started: Instant,
    /// What the run of this stage before this one wrote.
    previous: Vec<OutputFile>,
}

/// What an interrupted run had finished: kept beside the record until the run ends.
#[derive(Serialize, Deserialize)]
struct Partial {
    fingerprint: String,
    outputs: Vec<OutputFile>,
}

impl Run {
    /// Starts a run whose output is the folder `folder`, recorded in `folder/run.json`, or in `folder/<stage>.run.json`
    /// when `run.json` is not this stage's.
    #[must_use]
    pub fn in_folder(stage: &str, folder: &Path) -> Self {
        let (shared, own) = (folder.join("run.json"), folder.join(format!("{stage}.run.json")));
        let free = !shared.exists() || read_record(&shared).is_some_and(|r| r.stage == stage);
        let file = if free && !own.exists() { shared } else { own };
        Self::new(stage, folder.to_owned(), file, Target::Folder)
    }

    /// Starts a run whose output is the file `path`, recorded beside it in `<file name>.<stage>.run.json`.
    #[must_use]
    pub fn for_file(stage: &str, path: &Path) -> Self {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let folder = output::folder_of(path).to_owned();
        let file = folder.join(format!("{name}.{stage}.run.json"));
        Self::new(stage, folder, file, Target::File(path.to_owned()))
    }

    /// Starts a run whose output is a folder that must hold nothing else; recorded beside it in
    /// `<folder>.<stage>.run.json`.
    #[must_use]
    pub fn beside(stage: &str, folder: &Path) -> Self {
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let parent = output::folder_of(folder).to_owned();
        let file = parent.join(format!("{name}.{stage}.run.json"));
        Self::new(stage, parent, file, Target::Beside)
    }

    fn new(stage: &str, folder: PathBuf, file: PathBuf, target: Target) -> Self {
        let record = RunRecord {
            comgs: crate::VERSION.to_owned(),
            stage: stage.to_owned(),
            fingerprint: String::new(),
            inputs: Value::Null,
            config: Value::Null,
            seed: None,
            threads: rayon::current_num_threads(),
            seconds: 0.0,
            timings: Vec::new(),
            peak_memory_bytes: None,
            warnings: Vec::new(),
            results: Value::Null,
            outputs: Vec::new(),
        };
        Self { record, folder, file, target, started: Instant::now(), previous: Vec::new() }
    }

    /// Where the record is or will be.
    #[must_use]
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The output folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The record of an earlier run with the same fingerprint whose outputs are all still as they were written.
    #[must_use]
    pub fn reusable(&self, fingerprint: &str) -> Option<RunRecord> {
        let record = read_record(&self.file)?;
        let same = record.stage == self.record.stage && record.fingerprint == fingerprint;
        (same && record.outputs.iter().all(|output| self.is_intact(output))).then_some(record)
    }

    /// Whether a file is still as it was written. One outside the folder never is: a record is data that anybody may have
    /// written.
    fn is_intact(&self, output: &OutputFile) -> bool {
        let path = self.folder.join(&output.path);
        output::is_below(&output.path)
            && std::fs::metadata(&path).is_ok_and(|m| m.len() == output.bytes)
            && content_hash(&path).is_ok_and(|hash| hash == output.blake3)
    }

    /// Whether the output can be written and is nobody else's: asked before any work, and leaves nothing behind.
    ///
    /// # Errors
    /// [`PipelineError::Output`] when the folder cannot be made or written into; [`PipelineError::Input`] when it is an
    /// asset and this stage makes none, or when the file is one of an asset's.
    pub fn check_output(&self) -> Result<(), PipelineError> {
        let stage = &self.record.stage;
        if self.target == Target::Folder
            && Asset::is_asset(&self.folder)
            && !ASSET_STAGES.contains(&stage.as_str())
        {
            return Err(PipelineError::input(
                format!("the output of `{stage}`"),
                "a folder of its own",
                format!("an asset, {}", self.folder.display()),
            ));
        }
        let Target::File(path) = &self.target else { return output::check_folder(&self.folder) };
        let ours = || {
            read_record(&self.file).is_some_and(|r| {
                r.stage == *stage && r.outputs.iter().any(|o| self.folder.join(&o.path) == *path)
            })
        };
        if Asset::is_asset(&self.folder) && path.exists() && !ours() {
            return Err(PipelineError::input(
                format!("the output of `{stage}`"),
                "a file of its own",
                format!("a file of an asset, {}", path.display()),
            ));
        }
        output::check_file(path)
    }

    /// Where an interrupted run keeps what it had finished.
    fn partial_file(&self) -> PathBuf {
        let name = self.file.file_name().unwrap_or_default().to_string_lossy();
        self.folder.join(format!(".{name}.partial"))
    }

    /// Takes over what an interrupted run with the same fingerprint (see [`Run::describe`]) had finished; returns the
    /// paths, relative to the folder.
    pub fn resume(&mut self) -> Vec<String> {
        let read =
            || -> Option<Partial> { serde_json::from_slice(&std::fs::read(self.partial_file()).ok()?).ok() };
        let Some(partial) = read().filter(|p| p.fingerprint == self.record.fingerprint) else {
            return Vec::new();
        };
        let intact: Vec<OutputFile> = partial.outputs.into_iter().filter(|o| self.is_intact(o)).collect();
        let paths = intact.iter().map(|o| o.path.clone()).collect();
        self.record.outputs.extend(intact);
        paths
    }

    /// Keeps what is finished so far for [`Run::resume`].
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn keep(&self) -> Result<(), PipelineError> {
        let partial =
            Partial { fingerprint: self.record.fingerprint.clone(), outputs: self.record.outputs.clone() };
        write_json(&self.partial_file(), &partial)
    }

    /// Removes this stage's old record before outputs are touched, so that an interrupted run leaves none. What the old
    /// run wrote stays until the new one ends, and is then removed where it was not written again.
    ///
    /// # Errors
    /// As [`Run::check_output`], and [`PipelineError::Io`] when the record cannot be removed.
    pub fn invalidate(&mut self) -> Result<(), PipelineError> {
        self.check_output()?;
        std::fs::create_dir_all(&self.folder).map_err(|e| PipelineError::io(&self.folder, e))?;
        if let Some(old) = read_record(&self.file).filter(|old| old.stage == self.record.stage) {
            self.previous = old.outputs;
        }
        match std::fs::remove_file(&self.file) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(PipelineError::io(&self.file, e)),
            _ => Ok(()),
        }
    }

    /// Sets what the run was made from.
    ///
    /// # Errors
    /// [`PipelineError::Internal`] when the configuration has no JSON form.
    pub fn describe(
        &mut self,
        fingerprint: String,
        inputs: Value,
        config: &impl Serialize,
        seed: Option<u64>,
    ) -> Result<(), PipelineError> {
        self.record.fingerprint = fingerprint;
        self.record.inputs = inputs;
        self.record.config = serde_json::to_value(config)
            .map_err(|e| PipelineError::Internal(format!("the configuration has no JSON form: {e}")))?;
        self.record.seed = seed;
        Ok(())
    }

    /// Runs and times a part.
    ///
    /// # Errors
    /// Whatever the part returns.
    pub fn time<T, E>(&mut self, stage: &str, part: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let start = Instant::now();
        let result = part();
        self.add_time(stage, start.elapsed().as_secs_f64(), false);
        result
    }

    /// Adds a timing.
    pub fn add_time(&mut self, stage: &str, seconds: f64, reused: bool) {
        self.record.timings.push(StageTime { stage: stage.to_owned(), seconds, reused });
    }

    /// Adds a warning (and says it).
    pub fn warn(&mut self, context: &crate::Context<'_>, text: String) {
        context.progress.warn(&text);
        self.record.warnings.push(text);
    }

    /// Sets the reported figures.
    pub fn results(&mut self, results: Value) {
        self.record.results = results;
    }

    /// Adds a file that was written.
    ///
    /// # Errors
    /// [`PipelineError::Io`] when it cannot be read back.
    pub fn output(&mut self, path: &Path) -> Result<(), PipelineError> {
        let relative = path.strip_prefix(&self.folder).unwrap_or(path);
        let bytes = std::fs::metadata(path).map_err(|e| PipelineError::io(path, e))?.len();
        self.record.outputs.push(OutputFile {
            path: relative.to_string_lossy().replace('\\', "/"),
            blake3: content_hash(path)?,
            bytes,
        });
        Ok(())
    }

    /// Adds every file of a folder that was written.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn output_folder(&mut self, folder: &Path) -> Result<(), PipelineError> {
        let io = |e| PipelineError::io(folder, e);
        let mut paths: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(io)? {
            paths.push(entry.map_err(io)?.path());
        }
        paths.sort();
        for path in paths {
            if path.is_dir() {
                self.output_folder(&path)?;
            } else if !is_record(&path) {
                self.output(&path)?;
            }
        }
        Ok(())
    }

    /// Warnings so far.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.record.warnings
    }

    /// Timings so far.
    #[must_use]
    pub fn timings(&self) -> &[StageTime] {
        &self.record.timings
    }

    /// What the other records of the folder claim.
    fn others(&self) -> BTreeSet<String> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let records = entries.map(|e| e.path()).filter(|path| *path != self.file && is_record(path));
        records.filter_map(|path| read_record(&path)).flat_map(|r| r.outputs).map(|o| o.path).collect()
    }

    /// Writes the record.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn finish(mut self) -> Result<RunRecord, PipelineError> {
        self.record.seconds = self.started.elapsed().as_secs_f64();
        self.record.peak_memory_bytes = peak_memory_bytes();
        // Frames of cameras that are gone would look like results of this run. Files that somebody has changed since are
        // theirs.
        let mut left: Vec<&OutputFile> = self.previous.iter().collect();
        left.retain(|old| !self.record.outputs.iter().any(|new| new.path == old.path) && self.is_intact(old));
        if !left.is_empty() {
            let others = self.others();
            for old in left.iter().filter(|old| !others.contains(&old.path)) {
                let _ = std::fs::remove_file(self.folder.join(&old.path));
            }
        }
        let _ = std::fs::remove_file(self.partial_file());
        write_json(&self.file, &self.record)?;
        Ok(self.record)
    }
}

/// Whether a file is named as records are.
pub(crate) fn is_record(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name == "run.json" || name.ends_with(".run.json")
}

/// Reads a record; `None` when there is none or it is damaged.
#[must_use]
pub fn read_record(file: &Path) -> Option<RunRecord> {
    serde_json::from_slice(&std::fs::read(file).ok()?).ok()
}

/// Brings what a record says of some of its outputs up to date, after a later stage has written them anew in place, so that
/// the earlier stage still counts as done. A record that is not there, or is another stage's, is left alone.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn refresh(file: &Path, stage: &str, outputs: &[&str]) -> Result<(), PipelineError> {
    let Some(mut record) = read_record(file).filter(|r| r.stage == stage) else { return Ok(()) };
    let folder = file.parent().unwrap_or(Path::new("."));
    for output in record.outputs.iter_mut().filter(|o| outputs.contains(&o.path.as_str())) {
        let path = folder.join(&output.path);
        output.bytes = std::fs::metadata(&path).map_err(|e| PipelineError::io(&path, e))?.len();
        output.blake3 = content_hash(&path)?;
    }
    write_json(file, &record)
}

/// Writes pretty JSON, whole or not at all.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), PipelineError> {
    let mut text = serde_json::to_string_pretty(value)
        .map_err(|e| PipelineError::Internal(format!("{} has no JSON form: {e}", path.display())))?;
    text.push('\n');
    comgs_image::atomic::write_file(path, |w| w.write_all(text.as_bytes()))
        .map_err(|e| PipelineError::io(path, e))
}

/// Largest resident memory of this process so far (`VmHWM`), where the system tells.
#[must_use]
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write_run(folder: &Path, fingerprint: &str) {
        let mut run = Run::in_folder("test", folder);
        run.invalidate().unwrap();
        run.describe(fingerprint.into(), Value::Null, &1, Some(7)).unwrap();
        std::fs::create_dir_all(folder.join("frames")).unwrap();
        std::fs::write(folder.join("frames/a.png"), b"picture").unwrap();
        run.time("part", || Ok::<_, ()>(())).unwrap();
        run.output_folder(folder).unwrap();
        run.finish().unwrap();
    }

    /// Goal: a result is reused exactly when fingerprint, stage and every output are unchanged.
    #[test]
    fn reuse_needs_intact_outputs() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let reusable = |f: &str| Run::in_folder("test", folder).reusable(f).is_some();
        assert!(!reusable("x"));
        write_run(folder, "x");
        assert!(reusable("x") && !reusable("y"));
        assert!(Run::in_folder("other", folder).reusable("x").is_none());
        std::fs::write(folder.join("frames/a.png"), b"changed").unwrap();
        assert!(!reusable("x"), "an output that was edited is made again");
        write_run(folder, "x");
        std::fs::remove_file(folder.join("frames/a.png")).unwrap();
        assert!(!reusable("x"));
        write_run(folder, "x");
        Run::in_folder("test", folder).invalidate().unwrap();
        assert!(!reusable("x"), "an interrupted run leaves no record");
        std::fs::write(folder.join("run.json"), b"{ damaged").unwrap();
        assert!(!reusable("x"));
    }

    /// Goal: an interrupted run's finished files are taken over under the same fingerprint only, and what a run does
    /// not write again is removed unless somebody changed it.
    #[test]
    fn interrupted_runs_resume_and_old_files_go() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let start = |fingerprint: &str| {
            let mut run = Run::in_folder("test", folder);
            run.describe(fingerprint.into(), Value::Null, &1, None).unwrap();
            run.invalidate().unwrap();
            run
        };
        let write = |run: &mut Run, name: &str| {
            std::fs::write(folder.join(name), name).unwrap();
            run.output(&folder.join(name)).unwrap();
        };
        let mut run = start("x");
        write(&mut run, "a");
        run.keep().unwrap();
        drop(run);
        assert!(start("y").resume().is_empty());
        let mut run = start("x");
        assert_eq!(run.resume(), ["a"]);
        write(&mut run, "b");
        write(&mut run, "c");
        assert_eq!(run.finish().unwrap().outputs.len(), 3);
        assert!(start("x").resume().is_empty(), "a finished run leaves nothing to resume");

        write_run(folder, "w");
        let mut run = start("x");
        assert!(folder.join("frames/a.png").exists(), "old results stay until the new ones are there");
        write(&mut run, "b");
        run.finish().unwrap();
        assert!(!folder.join("frames/a.png").exists());
    }

    /// Goal: a stage removes what it wrote itself and nothing else: not another stage's files in the same folder, not
    /// what another record claims, not what a record names outside its folder.
    #[test]
    fn a_stage_cleans_up_only_after_itself() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("out");
        let run = |stage: &str, names: &[&str]| {
            let mut run = Run::in_folder(stage, &folder);
            run.invalidate().unwrap();
            for name in names {
                std::fs::write(folder.join(name), name).unwrap();
                run.output(&folder.join(name)).unwrap();
            }
            run.finish().unwrap();
        };
        let there = |name: &str| folder.join(name).exists();
        run("render", &["a", "b", "shared"]);
        run("compose", &["c", "shared"]);
        assert!(there("a") && there("b"), "the first stage's files are not the second's to remove");
        assert_eq!(read_record(&folder.join("run.json")).unwrap().stage, "render");
        assert_eq!(read_record(&folder.join("compose.run.json")).unwrap().stage, "compose");
        run("render", &["a"]);
        assert!(there("a") && !there("b") && there("c"), "its own files that are gone are removed");
        assert!(there("shared"), "what another record claims stays");

        // A record is data: one that names a file elsewhere has it neither reused nor removed.
        let precious = root.path().join("precious");
        std::fs::write(&precious, b"precious").unwrap();
        for path in ["../precious", precious.to_str().unwrap()] {
            let mut record = read_record(&folder.join("run.json")).unwrap();
            record.fingerprint = "x".into();
            record.outputs =
                vec![OutputFile { path: path.into(), blake3: content_hash(&precious).unwrap(), bytes: 8 }];
            write_json(&folder.join("run.json"), &record).unwrap();
            assert!(Run::in_folder("render", &folder).reusable("x").is_none());
            run("render", &["a"]);
            assert!(precious.exists(), "{path}");
        }
    }

    /// Goal: two files of one stem have records of their own; a file of an asset is not overwritten, and a stage that
    /// makes no assets does not write into one.
    #[test]
    fn records_and_assets_are_kept_apart() {
        let root = tempfile::tempdir().unwrap();
        let (json, exr) = (root.path().join("foo.json"), root.path().join("foo.exr"));
        let files =
            [Run::for_file("place", &json), Run::for_file("light", &exr), Run::beside("synth", &json)];
        let mut names: Vec<_> = files.iter().map(|r| r.file().to_owned()).collect();
        names.dedup();
        assert_eq!(names.len(), 3, "{names:?}");

        let asset = root.path().join("cow.asset");
        std::fs::create_dir_all(&asset).unwrap();
        std::fs::write(asset.join("asset.json"), b"{}").unwrap();
        let text = Run::in_folder("render", &asset).invalidate().unwrap_err().to_string();
        assert!(text.contains("an asset, ") && text.ends_with("cow.asset"), "{text}");
        Run::in_folder("reconstruct", &asset).check_output().unwrap();
        assert!(Run::for_file("place", &asset.join("asset.json")).check_output().is_err());
        let new = asset.join("transform.json");
        for _ in 0..2 {
            let mut run = Run::for_file("place", &new);
            run.invalidate().unwrap();
            std::fs::write(&new, b"{}").unwrap();
            run.output(&new).unwrap();
            run.finish().unwrap();
        }
    }

    /// Goal: the record holds what the issue asks for.
    #[test]
    fn record_is_complete() {
        let folder = tempfile::tempdir().unwrap();
        write_run(folder.path(), "x");
        let record = read_record(&folder.path().join("run.json")).unwrap();
        assert_eq!((record.comgs.as_str(), record.seed), (crate::VERSION, Some(7)));
        assert_eq!(record.timings[0].stage, "part");
        assert_eq!(record.outputs[0].path, "frames/a.png");
        if cfg!(target_os = "linux") {
            assert!(record.peak_memory_bytes.unwrap() > 1 << 20);
        }
    }
}
