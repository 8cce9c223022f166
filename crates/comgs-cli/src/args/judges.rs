//! Arguments of the commands that measure.

use super::Quality;
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Score an asset or frames against ground truth
///
/// An asset is rendered at a capture's held-out views and compared with the photos (PSNR, SSIM, FLIP), and with normals,
/// depths and material where the capture has them. Frames are compared with pictures of the same names; a composition with
/// mask/ and empty/ is scored by region (object, shadow, elsewhere), beside the empty scene as a baseline.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs eval cow.asset --against photos/cow
  comgs eval cow.asset --against data/object/cow --relit data/object_relit/cow
  comgs eval out/cow_in_room --against composition/room_with_cow --json scores.json")]
pub(crate) struct Eval {
    /// Asset, PLY, or folder of frames
    pub subject: PathBuf,

    /// Capture or composition
    #[arg(long, value_name = "TRUTH")]
    pub against: PathBuf,

    /// The object under other lights (object_relit/NAME): relight a decomposed asset and score that too
    #[arg(long, value_name = "ROOT")]
    pub relit: Option<PathBuf>,

    /// Write the scores as JSON too
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Measure what a stage's choices cost in time and memory, and what they give
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs ablate decompose data/object/cow --asset cow.asset -o out/ablation
  comgs ablate decompose --help")]
pub(crate) struct Ablate {
    #[command(subcommand)]
    pub what: AblateWhat,
}

/// What is swept.
#[derive(Debug, Subcommand)]
pub(crate) enum AblateWhat {
    Decompose(AblateDecompose),
}

/// Decompose an object again and again, turning one knob at a time
///
/// Writes decompose.csv, decompose.md, decompose.svg and decompose.png: albedo, relighting, normals, seconds, milliseconds a
/// step and megabytes for each setting of visibility, probe offset, number of probes, texture size, rays and Chebyshev
/// weight. The capture needs ground-truth albedo; relighting is scored where object_relit/NAME lies beside object/NAME.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs ablate decompose data/object/cow --asset cow.asset -o out/ablation
  comgs ablate decompose data/object/cow -o out/ablation --iterations 200 --knobs visibility,probes")]
pub(crate) struct AblateDecompose {
    /// Object capture with ground truth
    pub capture: PathBuf,

    /// Its reconstruction; made first when absent
    #[arg(long)]
    pub asset: Option<PathBuf>,

    /// The object under other lights (object_relit/NAME); looked for beside the capture when absent
    #[arg(long, value_name = "ROOT")]
    pub relit: Option<PathBuf>,

    /// Output folder
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Knobs to turn; all when absent: visibility, offset, probes, texture, rays, chebyshev
    #[arg(long, value_name = "KNOB,…", value_delimiter = ',')]
    pub knobs: Vec<String>,

    /// Steps of every decomposition
    #[arg(long, value_name = "N", default_value_t = 400)]
    pub iterations: u32,

    /// Cameras under each other light, at most
    #[arg(long, value_name = "N", default_value_t = 6)]
    pub relit_views: usize,

    /// How the object is reconstructed, when there is no asset
    #[arg(long, value_enum, default_value = "balanced")]
    pub quality: Quality,

    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}
