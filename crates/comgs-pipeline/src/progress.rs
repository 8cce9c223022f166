//! How stages speak while they run, and how they are asked to stop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Where a stage stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Share that is done, in [0, 1]; `None` when unknown.
    pub fraction: Option<f64>,
    /// What is going on, one short line of parts with commas, the most telling first
    /// (`"27.1 dB, 41.2k surfels, step 300/700"`): a narrow terminal leaves out the last ones.
    pub message: String,
    /// Estimated time left.
    pub remaining: Option<Duration>,
}

/// Hears what stages have to say. Methods may be called from any thread.
pub trait Progress: Sync {
    /// A stage begins.
    fn begin(&self, stage: &str);
    /// The running stage has moved on.
    fn update(&self, status: &Status);
    /// The running stage has ended; `summary` is one line for the log.
    fn end(&self, summary: &str);
    /// A line worth keeping.
    fn note(&self, text: &str);
    /// Something the user should know.
    fn warn(&self, text: &str);
}

/// Hears nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str) {}
    fn update(&self, _: &Status) {}
    fn end(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn warn(&self, _: &str) {}
}

/// A shared request to stop at the next resumable state.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Asks for a stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether a stop was asked for.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What every stage is run with.
#[derive(Clone)]
pub struct Context<'a> {
    /// Where to report.
    pub progress: &'a dyn Progress,
    /// When to stop.
    pub cancel: CancelToken,
}

impl Context<'_> {
    /// A context that says nothing and is never cancelled.
    #[must_use]
    pub fn silent() -> Context<'static> {
        Context { progress: &Silent, cancel: CancelToken::default() }
    }

    /// An error when a stop was asked for.
    ///
    /// # Errors
    /// [`crate::PipelineError::Cancelled`].
    pub fn check(&self) -> Result<(), crate::PipelineError> {
        if self.cancel.is_cancelled() { Err(crate::PipelineError::Cancelled { kept: None }) } else { Ok(()) }
    }
}

/// A duration as a person reads it: `850 ms`, `12.3 s`, `4 min 05 s`, `1 h 02 min`.
#[must_use]
pub fn human_duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).round() as u64;
    if seconds < 1.0 {
        format!("{:.0} ms", seconds.max(0.0) * 1e3)
    } else if whole < 60 {
        format!("{seconds:.1} s")
    } else if whole < 3600 {
        format!("{} min {:02} s", whole / 60, whole % 60)
    } else {
        format!("{} h {:02} min", whole / 3600, whole % 3600 / 60)
    }
}

/// A count as a person reads it: `987`, `9870`, `41.2k`, `1.3M`.
#[must_use]
pub fn human_count(n: usize) -> String {
    match n {
        0..10_000 => n.to_string(),
        10_000..1_000_000 => format!("{:.1}k", n as f64 / 1e3),
        _ => format!("{:.1}M", n as f64 / 1e6),
    }
}

/// A size as a person reads it: `512 B`, `3.4 KiB`, `1.2 GiB`.
#[must_use]
pub fn human_bytes(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "KiB", "MiB", "GiB"] {
        if value < 1024.0 {
            return if unit == "B" { format!("{bytes} B") } else { format!("{value:.1} {unit}") };
        }
        value /= 1024.0;
    }
    format!("{value:.1} TiB")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: readable at every magnitude, and nothing like "60.0 s" or "1 min 60 s".
    #[test]
    fn durations_and_sizes() {
        let cases = [
            (0.0, "0 ms"),
            (0.85, "850 ms"),
            (12.34, "12.3 s"),
            (59.97, "1 min 00 s"),
            (245.0, "4 min 05 s"),
        ];
        for (seconds, text) in cases {
            assert_eq!(human_duration(seconds), text);
        }
        assert_eq!(human_duration(3725.0), "1 h 02 min");
        assert_eq!([9999, 41_234, 1_250_001].map(human_count), ["9999", "41.2k", "1.3M"]);
        assert_eq!(human_bytes(512), "512 B");
        assert_eq!(human_bytes(3 << 29), "1.5 GiB");
    }

    /// Goal: a cancelled token turns into an error wherever a clone of it is checked.
    #[test]
    fn cancellation_reaches_clones() {
        let context = Context::silent();
        let clone = context.clone();
        assert!(clone.check().is_ok());
        context.cancel.cancel();
        assert!(matches!(clone.check(), Err(crate::PipelineError::Cancelled { .. })));
    }
}
