//! Progress at the terminal: a bar when there is one, plain lines when output goes to a file or a log.

use comgs_pipeline::{Progress, Status, progress::human_duration};
use console::Term;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// How often a log gets a line about a long stage.
const LOG_INTERVAL: Duration = Duration::from_secs(15);

/// Shows progress on standard error.
pub(crate) struct Terminal {
    quiet: bool,
    state: Mutex<State>,
}

struct State {
    bar: Option<ProgressBar>,
    stage: String,
    started: Instant,
    last_line: Instant,
}

impl Terminal {
    pub(crate) fn new(quiet: bool) -> Self {
        let now = Instant::now();
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr_with_hz(8));
            bar.set_style(spinner());
            bar
        });
        let state = State { bar, stage: String::new(), started: now, last_line: now };
        Self { quiet, state: Mutex::new(state) }
    }

    fn with<R>(&self, f: impl FnOnce(&mut State) -> R) -> R {
        // A poisoned lock means that a thread died while it printed; what it left is still a state.
        f(&mut self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    fn line(&self, state: &State, text: &str) {
        match &state.bar {
            Some(bar) => bar.suspend(|| eprintln!("{text}")),
            None => eprintln!("{text}"),
        }
    }
}

fn spinner() -> ProgressStyle {
    ProgressStyle::with_template("{spinner} {prefix:.bold} {wide_msg}")
        .unwrap_or_else(|_| ProgressStyle::default_spinner())
}

fn bar_style() -> ProgressStyle {
    ProgressStyle::with_template(&format!("{{prefix:.bold}} [{{bar:{BAR}}}] {{percent:>3}} % {{wide_msg}}"))
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ")
}

/// Columns of the bar itself.
const BAR: usize = 10;
/// Columns of a line besides stage, bar and message: brackets, percentage, spaces.
const FRAME: usize = 10;
/// Columns that the stage's name may take.
const STAGE: usize = 24;
/// Width of a terminal that does not tell.
const WIDTH: usize = 80;

/// A stage's name, shortened where it leaves no room for figures.
fn short_stage(stage: &str) -> String {
    if stage.chars().count() <= STAGE {
        return stage.to_owned();
    }
    stage.chars().take(STAGE - 1).chain(['…']).collect()
}

/// The parts of a status that fit into `columns`, the most telling first, whole or not at all; the time left comes second:
/// `27.1 dB · 1 min 35 s left · 41.2k surfels · step 300/700`. A first part that is too long stays and is cut.
fn fitting(status: &Status, columns: usize) -> String {
    let mut parts: Vec<String> =
        status.message.split(", ").filter(|part| !part.is_empty()).map(str::to_owned).collect();
    if let Some(remaining) = status.remaining {
        let left = format!("{} left", human_duration(remaining.as_secs_f64()));
        parts.insert(parts.len().min(1), left);
    }
    let mut line = String::new();
    for part in parts {
        let separator = if line.is_empty() { "" } else { " · " };
        let longer = line.chars().count() + separator.chars().count() + part.chars().count();
        if !line.is_empty() && longer > columns {
            break;
        }
        line.push_str(separator);
        line.push_str(&part);
    }
    line
}

/// One line about a status: `43 % · 27.1 dB, step 300/700 · 35 s left`.
fn describe(status: &Status) -> String {
    let mut parts = Vec::new();
    parts.extend(status.fraction.map(|f| format!("{:.0} %", 100.0 * f.clamp(0.0, 1.0))));
    if !status.message.is_empty() {
        parts.push(status.message.clone());
    }
    parts.extend(status.remaining.map(|r| format!("{} left", human_duration(r.as_secs_f64()))));
    parts.join(" · ")
}

impl Progress for Terminal {
    fn begin(&self, stage: &str) {
        self.with(|state| {
            state.stage = stage.to_owned();
            state.started = Instant::now();
            state.last_line = Instant::now();
            if let Some(bar) = &state.bar {
                bar.set_style(spinner());
                bar.set_position(0);
                bar.set_prefix(short_stage(stage));
                bar.set_message("");
                bar.enable_steady_tick(Duration::from_millis(120));
            } else if !self.quiet {
                eprintln!("{stage} …");
            }
        });
    }

    fn update(&self, status: &Status) {
        self.with(|state| {
            if let Some(bar) = &state.bar {
                if let Some(fraction) = status.fraction {
                    bar.set_style(bar_style());
                    bar.set_position((1000.0 * fraction.clamp(0.0, 1.0)) as u64);
                }
                let width = Term::stderr().size_checked().map_or(WIDTH, |(_, columns)| usize::from(columns));
                // Terminals wrap a line that fills their last column.
                let taken = 1 + short_stage(&state.stage).chars().count() + BAR + FRAME;
                bar.set_message(fitting(status, width.saturating_sub(taken)));
            } else if !self.quiet && state.last_line.elapsed() >= LOG_INTERVAL {
                state.last_line = Instant::now();
                eprintln!("  {}", describe(status));
            }
        });
    }

    fn end(&self, summary: &str) {
        self.with(|state| {
            let took = human_duration(state.started.elapsed().as_secs_f64());
            if let Some(bar) = &state.bar {
                bar.disable_steady_tick();
                bar.suspend(|| eprintln!("✓ {} ({took})  {summary}", state.stage));
                bar.set_message("");
            } else if !self.quiet {
                eprintln!("  done in {took}: {summary}");
            }
        });
    }

    fn note(&self, text: &str) {
        if !self.quiet {
            self.with(|state| self.line(state, &format!("  {text}")));
        }
    }

    fn warn(&self, text: &str) {
        self.with(|state| self.line(state, &format!("warning: {text}")));
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.with(|state| {
            if let Some(bar) = &state.bar {
                bar.finish_and_clear();
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: at 80 columns the longest training status shows PSNR, time left and surfels whole, and what does not fit is
    /// left out, not cut; a wide terminal shows everything.
    #[test]
    fn nothing_is_cut_at_80_columns() {
        let status = Status {
            fraction: Some(0.5),
            message: "27.1 dB, 123.4k surfels, step 3437/12000, quarter resolution".into(),
            remaining: Some(Duration::from_secs(12 * 60 + 30)),
        };
        let room = |stage: &str| WIDTH - 1 - short_stage(stage).chars().count() - BAR - FRAME;
        let shown = fitting(&status, room("reconstruct cow"));
        assert_eq!(shown, "27.1 dB · 12 min 30 s left · 123.4k surfels");
        assert_eq!(fitting(&status, 42), "27.1 dB · 12 min 30 s left");
        for stage in ["reconstruct a_capture_with_a_very_long_name", "light"] {
            let shown = fitting(&status, room(stage));
            assert!(shown.starts_with("27.1 dB · 12 min 30 s left"), "{shown}");
            assert!(shown.chars().count() <= room(stage), "{shown}");
        }
        let wide = fitting(&status, 200);
        assert!(wide.ends_with("step 3437/12000 · quarter resolution"), "{wide}");
        assert_eq!(
            fitting(&Status { message: "frame 00003".into(), ..Status::default() }, 40),
            "frame 00003"
        );
        assert_eq!(fitting(&Status::default(), 40), "");
    }

    /// Goal: a status is one line whatever is known.
    #[test]
    fn statuses_are_one_line() {
        let full = Status {
            fraction: Some(0.426),
            message: "step 300 of 700".into(),
            remaining: Some(Duration::from_secs(95)),
        };
        assert_eq!(describe(&full), "43 % · step 300 of 700 · 1 min 35 s left");
        assert_eq!(describe(&Status::default()), "");
    }
}
