//! The comgs command line: posed photos of an object and posed photos of a place in, frames in which the object stands
//! there out. Every command is one stage of [`comgs_pipeline`]; this crate parses arguments, shows progress, and turns
//! errors into sentences and exit codes (0 done, 1 failed, 2 wrong usage, 130 stopped).

mod args;
mod commands;
mod output;
mod terminal;
mod values;

use args::Cli;
use clap::Parser;
use comgs_pipeline::{CancelToken, PipelineError};
use std::process::ExitCode;

/// Exit code of a run that was asked to stop, as shells have it for Ctrl-C.
const STOPPED: u8 = 130;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let cancel = CancelToken::default();
    if let Err(error) = prepare(&cli, &cancel) {
        return fail(&error);
    }
    match commands::run(&cli, cancel) {
        Ok(code) => code,
        Err(error) => fail(&error),
    }
}

/// Threads and Ctrl-C.
fn prepare(cli: &Cli, cancel: &CancelToken) -> anyhow::Result<()> {
    if let Some(threads) = cli.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    let token = cancel.clone();
    ctrlc::set_handler(move || {
        if token.is_cancelled() {
            std::process::exit(i32::from(STOPPED));
        }
        token.cancel();
        eprintln!("\nstopping at the next state that can be resumed; Ctrl-C again stops at once");
    })?;
    Ok(())
}

/// Prints the chain of causes, outermost first, and chooses the exit code.
fn fail(error: &anyhow::Error) -> ExitCode {
    if let Some(PipelineError::Cancelled { .. }) = error.downcast_ref::<PipelineError>() {
        eprintln!("{error}");
        return ExitCode::from(STOPPED);
    }
    eprintln!("error: {error}");
    let mut last = error.to_string();
    for cause in error.chain().skip(1) {
        let text = cause.to_string();
        // Transparent errors repeat their source.
        if text != last && !last.contains(&text) {
            eprintln!("  because: {text}");
        }
        last = text;
    }
    ExitCode::FAILURE
}
