//! Arguments of the commands that need no photos, and of `info`.

use super::Quality;
use crate::values::size;
use clap::Args;
use std::path::PathBuf;

/// Make captures with exact ground truth
///
/// Renders a recipe with a small path tracer into the SynCom layout: objects, objects under other lights, scenes,
/// compositions, ground-truth planes and light.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs synth tiny -o out/tiny
  comgs synth room -o out/room --scene-size 320x180 --samples 32
  comgs synth my_recipe.json -o out/mine --seed 7
  comgs synth list                                          names of the built-in recipes")]
pub(crate) struct Synth {
    /// A built-in recipe, a recipe file, or `list`
    pub recipe: String,

    /// Folder to write, new or empty
    #[arg(short, long, value_name = "ROOT")]
    pub output: Option<PathBuf>,

    /// Seed of everything random
    #[arg(long)]
    pub seed: Option<u64>,

    /// Size of object views
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub object_size: Option<(usize, usize)>,

    /// Size of scene and composition views
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub scene_size: Option<(usize, usize)>,

    /// Training views of each capture
    #[arg(long, value_name = "N")]
    pub train_views: Option<usize>,

    /// Test views of each capture, and views of each composition
    #[arg(long, value_name = "N")]
    pub test_views: Option<usize>,

    /// Paths a pixel
    #[arg(long, value_name = "N")]
    pub samples: Option<u32>,
}

/// Do all of it on two small captures that ship with the source
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs demo
  comgs demo -o /tmp/demo --quality balanced")]
pub(crate) struct Demo {
    /// Output folder
    #[arg(short, long, value_name = "DIR", default_value = "out/demo")]
    pub output: PathBuf,

    /// The demo's captures; assets/demo of the source when absent
    #[arg(long, value_name = "DIR")]
    pub assets: Option<PathBuf>,

    /// Time against quality
    #[arg(long, value_enum, default_value = "draft")]
    pub quality: Quality,

    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// Say what a file or folder holds
///
/// Assets, PLYs of any dialect, EXR and other pictures, captures and roots of captures, camera lists, transform.json,
/// composition.json, scores.json, recipes, reports and run.json.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs info cow.asset
  comgs info published.ply
  comgs info photos/room
  comgs info out/cow/layers/00000.exr")]
pub(crate) struct Info {
    /// What to look at
    #[arg(required = true)]
    pub paths: Vec<PathBuf>,
}
