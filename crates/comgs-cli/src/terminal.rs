//! Progress at the terminal: a bar when there is one, plain lines when output goes to a file or a log.

use comgs_pipeline::{Progress, Status, progress::human_duration};
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
    ProgressStyle::with_template("{prefix:.bold} [{bar:24}] {percent:>3} % {wide_msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ")
}

/// One line about a status: `43 % · step 300 of 700, 27.1 dB · 35 s left`.
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
                bar.set_prefix(stage.to_owned());
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
                let left = status.remaining.map(|r| format!(" · {} left", human_duration(r.as_secs_f64())));
                bar.set_message(format!("{}{}", status.message, left.unwrap_or_default()));
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
