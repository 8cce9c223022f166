//! Arguments of `comgs tradeoff`.

use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Measure time against error, knob by knob
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs tradeoff shadow --composition out/composition.json -o docs/tradeoff
  comgs tradeoff relight --composition out/composition.json -o docs/tradeoff
  comgs tradeoff reconstruct photos/cow -o docs/tradeoff
  comgs tradeoff shadow --help")]
pub(crate) struct Tradeoff {
    #[command(subcommand)]
    pub what: TradeoffWhat,
}

/// What is swept.
#[derive(Debug, Subcommand)]
pub(crate) enum TradeoffWhat {
    Shadow(TradeoffShadow),
    Relight(TradeoffRelight),
    Reconstruct(TradeoffReconstruct),
}

/// Every way to a shadow, one knob at a time
///
/// Writes shadow.csv, shadow.md, shadow.svg and shadow.png: seconds of a frame and of its preparation, error against
/// converged rays and, with --against, against ground truth.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs tradeoff shadow --composition out/composition.json -o docs/tradeoff
  comgs tradeoff shadow --composition out/composition.json --against composition/room_with_cow --knobs way,cache -o out")]
pub(crate) struct TradeoffShadow {
    /// composition.json, as `comgs compose` writes it
    #[arg(long, value_name = "FILE")]
    pub composition: PathBuf,

    /// Composition with ground truth
    #[arg(long, value_name = "DIR")]
    pub against: Option<PathBuf>,

    /// Output folder
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Knobs to turn; all when absent: way, quality, field, directions, split, cache, probes, neighbours
    #[arg(long, value_name = "KNOB,…", value_delimiter = ',')]
    pub knobs: Vec<String>,

    /// Cameras, at most
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub views: usize,

    /// Rays a pixel of the reference
    #[arg(long, value_name = "N", default_value_t = 1024)]
    pub reference_rays: u32,

    /// Frames of which the fastest counts
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub repeats: usize,

    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// Every way to the objects' light, one knob at a time
///
/// Writes relight.csv, relight.md, relight.svg and relight.png: seconds that a frame spends on the objects, preparation, error
/// against converged samples and, with --against, against ground truth.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs tradeoff relight --composition out/composition.json -o docs/tradeoff
  comgs tradeoff relight --composition out/composition.json --against composition/room_with_cow --knobs way,indirect -o out")]
pub(crate) struct TradeoffRelight {
    /// composition.json, as `comgs compose` writes it; its objects need material (`comgs decompose`)
    #[arg(long, value_name = "FILE")]
    pub composition: PathBuf,

    /// Composition with ground truth
    #[arg(long, value_name = "DIR")]
    pub against: Option<PathBuf>,

    /// Output folder
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Knobs to turn; all when absent: way, quality, samples, highlight, self-occlusion, indirect
    #[arg(long, value_name = "KNOB,…", value_delimiter = ',')]
    pub knobs: Vec<String>,

    /// Cameras, at most
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub views: usize,

    /// Samples a pixel of the reference
    #[arg(long, value_name = "N", default_value_t = 2048)]
    pub reference_rays: u32,

    /// Frames of which the fastest counts
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub repeats: usize,

    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// Steps, image size and surfels of a reconstruction, one knob at a time
///
/// Writes reconstruct.csv, reconstruct.md, reconstruct.svg and reconstruct.png: seconds, and scores at held-out views. It is long, and
/// may be interrupted: the same command goes on where it was.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs tradeoff reconstruct photos/cow -o docs/tradeoff
  comgs tradeoff reconstruct photos/cow --iterations 300 --knobs iterations,width --assets cows -o out
  comgs tradeoff reconstruct photos/cow --knobs quality -o out")]
pub(crate) struct TradeoffReconstruct {
    /// Any capture
    pub capture: PathBuf,

    /// Output folder
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Folder for the assets; `assets` in the output folder when absent
    #[arg(long, value_name = "DIR")]
    pub assets: Option<PathBuf>,

    /// Knobs to turn: iterations, width, surfels (these when absent), quality
    #[arg(long, value_name = "KNOB,…", value_delimiter = ',')]
    pub knobs: Vec<String>,

    /// Steps where another knob is turned
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub iterations: u32,

    /// Width of the photos where another knob is turned
    #[arg(long, value_name = "PIXELS", default_value_t = 400)]
    pub width: usize,

    /// Surfels at most where another knob is turned
    #[arg(long, value_name = "N", default_value_t = 20_000)]
    pub surfels: usize,

    /// Runs with other seeds of which the mean is shown
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub repeats: u64,

    /// First seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}
