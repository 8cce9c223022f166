//! The runs of a sweep, one after the other.

use super::{Row, Sweep};
use crate::{Context, PipelineError, Status};
use std::collections::BTreeMap;
use std::path::Path;

/// A value of a knob, and the way in which the stage goes about it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Setting<W> {
    pub knob: &'static str,
    pub label: String,
    pub is_default: bool,
    pub way: W,
}

/// Seconds and measures of a run.
pub(crate) type Measured = (f64, BTreeMap<String, f64>);

/// The settings of some knobs, of all when none is named.
///
/// # Errors
/// [`PipelineError::Input`] for a knob that is none.
pub(crate) fn chosen<W>(
    settings: Vec<Setting<W>>,
    knobs: &[String],
    known: &[&str],
) -> Result<Vec<Setting<W>>, PipelineError> {
    if let Some(unknown) = knobs.iter().find(|k| !known.contains(&k.as_str())) {
        return Err(PipelineError::input("--knobs", known.join(", "), unknown.clone()));
    }
    let wanted = |s: &Setting<W>| knobs.is_empty() || knobs.iter().any(|k| k == s.knob);
    Ok(settings.into_iter().filter(wanted).collect())
}

/// Measures all settings and writes one table and one plot, after every run anew: an interrupted sweep leaves its first rows.
/// Settings that go the same way are one and the same run.
///
/// # Errors
/// Those of `measure` and of [`Sweep::write`]; [`PipelineError::Cancelled`].
pub(crate) fn drive<W: PartialEq>(
    mut sweep: Sweep,
    settings: &[Setting<W>],
    folder: &Path,
    stem: &str,
    context: &Context<'_>,
    mut measure: impl FnMut(&Setting<W>) -> Result<Measured, PipelineError>,
) -> Result<Sweep, PipelineError> {
    let mut known: Vec<(&W, Measured)> = Vec::new();
    for (i, setting) in settings.iter().enumerate() {
        context.check()?;
        context.progress.update(&Status {
            fraction: Some(i as f64 / settings.len() as f64),
            message: format!("{} {}", setting.knob, setting.label),
            remaining: None,
        });
        let (seconds, values) = match known.iter().find(|k| *k.0 == setting.way) {
            Some((_, measured)) => measured.clone(),
            None => {
                let measured = measure(setting)?;
                known.push((&setting.way, measured.clone()));
                measured
            }
        };
        sweep.rows.push(Row {
            group: setting.knob.into(),
            label: setting.label.clone(),
            is_default: setting.is_default,
            seconds,
            values,
        });
        sweep.write(folder, stem)?;
    }
    context.progress.end(&format!(
        "{} runs; {}",
        sweep.rows.len(),
        folder.join(format!("{stem}.md")).display()
    ));
    Ok(sweep)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tradeoff::{Better, Metric};

    /// Goal: a way that two knobs share is measured once and has a row of each; knobs are chosen by name, and one that is none is
    /// refused.
    #[test]
    fn a_way_is_measured_once() {
        let of = |knob, label: &str, way| Setting { knob, label: label.into(), is_default: way == 1, way };
        let all = || vec![of("a", "1", 1), of("a", "2", 2), of("b", "x", 1), of("b", "y", 3)];
        let settings = chosen(all(), &[], &["a", "b"]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let sweep = Sweep {
            title: "t".into(),
            command: "c".into(),
            machine: "m".into(),
            metrics: vec![Metric::new("v", "v", "", Better::Up, 1)],
            rows: Vec::new(),
        };
        let mut runs = Vec::new();
        let made = drive(sweep, &settings, folder.path(), "s", &Context::silent(), |s| {
            runs.push(s.way);
            Ok((f64::from(s.way), BTreeMap::from([("v".to_owned(), f64::from(10 * s.way))])))
        });
        assert_eq!(runs, [1, 2, 3]);
        let rows: Vec<_> =
            made.unwrap().rows.into_iter().map(|r| (r.group, r.seconds, r.is_default)).collect();
        let row = |g: &str, s, d| (g.to_owned(), s, d);
        assert_eq!(
            rows,
            [row("a", 1.0, true), row("a", 2.0, false), row("b", 1.0, true), row("b", 3.0, false)]
        );
        assert!(folder.path().join("s.csv").is_file());
        assert_eq!(chosen(all(), &["b".into()], &["a", "b"]).unwrap().len(), 2);
        let error = chosen(all(), &["c".into()], &["a", "b"]).unwrap_err().to_string();
        assert!(error.contains("a, b") && error.contains('c'), "{error}");
    }
}
