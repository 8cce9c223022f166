//! Arguments of the commands that make frames.

use super::{Editing, Quality};
use crate::values::{duration, positive, size};
use clap::{ArgGroup, Args, ValueEnum};
use std::path::PathBuf;

/// Render an asset as cameras see it, or a composition with its shadows
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("subject").required(true).args(["asset", "composition"]),
    after_help = "\
Examples:
  comgs render cow.asset --cameras photos/cow/test/cameras.json -o out/cow
  comgs render published.ply --cameras photos/room -o out/room --layers
  comgs render --composition out/composition.json -o frames                      objects under the scene's light
  comgs render --composition out/composition.json --cache cache --quality draft -o frames
  comgs render --composition out/composition.json --budget 20s -o frames         only the effects that pay"
)]
pub(crate) struct Render {
    /// Asset, or a PLY of surfels
    pub asset: Option<PathBuf>,

    /// composition.json, as `comgs compose` writes it
    #[arg(long, value_name = "FILE")]
    pub composition: Option<PathBuf>,

    /// Any camera list or capture; a composition has its own
    #[arg(long, required_unless_present = "composition")]
    pub cameras: Option<PathBuf>,

    /// Output folder: frames/<camera>.png
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Also write layers/<camera>.exr: beauty, depth, normal, material
    #[arg(long)]
    pub layers: bool,

    #[command(flatten)]
    pub editing: Editing,

    /// Folder of occlusion fields made by `comgs shadow`; what is missing is baked and kept there
    #[arg(long, value_name = "DIR", requires = "composition")]
    pub cache: Option<PathBuf>,

    /// Simulate what changes the picture by at least this (linear mean over the pixels that an effect touches)
    #[arg(long, value_name = "T", requires = "composition", allow_negative_numbers = true, value_parser = positive)]
    pub tolerance: Option<f64>,

    /// Simulate what pays most within this time (20s), at the finest quality that fits unless --quality says one
    #[arg(long, value_name = "TIME", requires = "composition", value_parser = duration)]
    pub budget: Option<f64>,
}

/// What an object hides from itself.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum SelfShadow {
    /// Probes, with traced rays towards the light: sharp shadows of small lights
    Mixed,
    /// Probes alone: two to three times as fast, soft shadows
    Probes,
    /// A traced ray for every sample
    Trace,
    /// Nothing
    None,
}

/// Show a decomposed object under another light
///
/// Needs the material that `comgs decompose` adds. Light and surface both propose the directions that are looked at, so a
/// polished object under a small sun is as free of noise as a matte one under a cloudy sky.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("views").required(true).args(["cameras", "turntable"]),
    after_help = "\
Examples:
  comgs relight cow.asset --env sunset.exr --turntable 36 -o out/cow
  comgs relight cow.asset --env sunset.exr --cameras photos/cow/test/cameras.json -o out/cow --layers
  comgs relight cow.asset --turntable 24 --background -o out/cow            the light it was captured under
  comgs relight cow.asset --env studio.exr --turntable 12 --indirect --quality reference -o out/cow"
)]
pub(crate) struct Relight {
    /// Asset made with `comgs decompose`, or a PLY of surfels with material
    pub asset: PathBuf,

    /// Environment map: equirectangular EXR or HDR, z up; the recovered light of the capture when absent
    #[arg(long, value_name = "EXR")]
    pub env: Option<PathBuf>,

    /// Any camera list or capture
    #[arg(long)]
    pub cameras: Option<PathBuf>,

    /// This many cameras around the object instead, and a preview.gif of the turn
    #[arg(long, value_name = "N", value_parser = views)]
    pub turntable: Option<usize>,

    /// Size of turntable frames
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = size)]
    pub size: (usize, usize),

    /// Output folder: frames/<camera>.png
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Also write layers/<camera>.exr: beauty, diffuse, specular, indirect, visibility, depth, normal, material
    #[arg(long)]
    pub layers: bool,

    /// Show the light behind the object instead of black
    #[arg(long)]
    pub background: bool,

    /// What the object hides from itself; an object without probes is traced
    #[arg(long, value_enum, default_value = "mixed")]
    pub visibility: SelfShadow,

    /// Add light that bounces once between the object's own surfaces
    #[arg(long)]
    pub indirect: bool,

    /// Time against noise: 32, 128 or 512 samples a pixel
    #[arg(long, value_enum, default_value = "balanced")]
    pub quality: Quality,

    /// Samples a pixel instead of the quality's
    #[arg(long, value_name = "N", value_parser = rays)]
    pub rays: Option<u32>,

    /// Same seed, same bytes
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

fn views(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(n) if (1..=100_000).contains(&n) => Ok(n),
        _ => Err("expected a number of frames from 1 to 100000".into()),
    }
}

/// Put objects into a scene, with their shadows
///
/// Captures are reconstructed first, into the output folder. Writes frames, the empty scene, a preview, composition.json
/// and a report to look at.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs compose --scene room.asset --object cow.asset --transform transform.json --cameras cameras.json -o out/cow
  comgs compose --scene photos/room --object photos/cow --transform t.json --cameras photos/room -o out --layers
  comgs compose --scene room.asset --object cow.asset --object cow.asset --transform two.json --cameras c.json -o out
  comgs compose … --against composition/room_with_cow       also score against ground truth")]
pub(crate) struct Compose {
    /// Capture, asset or PLY of the scene
    #[arg(long)]
    pub scene: PathBuf,

    /// Capture, asset or PLY of an object; may be given several times
    #[arg(long = "object", required = true)]
    pub objects: Vec<PathBuf>,

    /// Where the objects stand: made by `comgs place`, or from a SynCom composition
    #[arg(long, value_name = "FILE")]
    pub transform: PathBuf,

    /// Any camera list or capture
    #[arg(long)]
    pub cameras: PathBuf,

    /// Output folder
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Environment map instead of a sweep of the scene
    #[arg(long, value_name = "EXR")]
    pub light: Option<PathBuf>,

    /// Composition with ground truth, to score the frames
    #[arg(long, value_name = "DIR")]
    pub against: Option<PathBuf>,

    /// Also write layers/<camera>.exr: beauty, object, scene, shadow, depth, normal, mask
    #[arg(long)]
    pub layers: bool,

    /// Leave the scene without the objects' shadows
    #[arg(long)]
    pub no_shadow: bool,

    /// Light samples a pixel for the shadow
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = rays)]
    pub shadow_rays: u32,

    /// Leave the shadow as noisy as it was traced
    #[arg(long)]
    pub no_denoise: bool,

    /// Order scene and object by a depth test: faster, with fringes at scene edges
    #[arg(long)]
    pub depth_test: bool,

    /// How captures are reconstructed
    #[arg(long, value_enum, default_value = "balanced")]
    pub quality: Quality,

    /// Time for each capture to be reconstructed (5m)
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time_budget: Option<f64>,

    /// Same seed, same bytes
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

fn rays(text: &str) -> Result<u32, String> {
    match text.parse::<u32>() {
        Ok(n) if (1..=65_536).contains(&n) => Ok(n),
        _ => Err("expected a number of rays from 1 to 65536".into()),
    }
}
