//! Arguments of the commands that look at a place.

use super::Switch;
use crate::values::{Pixel, distance, number, pixel, point, positive};
use clap::{ArgGroup, Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Say where an object stands in a scene
///
/// The object's base (the lowest point of its body) is put on the point given, upright. The local ground is looked at:
/// floating, sunk, sloping and unobserved places are warned of, with figures.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs place --scene room.asset --object cow.asset --pixel 00003,256,180 -o transform.json
  comgs place --scene room.asset --object cow.asset --at 0.3,-1.2,0 --size 0.5 --yaw 30 -o transform.json")]
pub(crate) struct Place {
    /// Scene asset, or a PLY of surfels
    #[arg(long)]
    pub scene: PathBuf,

    /// Object asset, or a PLY of surfels
    #[arg(long)]
    pub object: PathBuf,

    /// Point of the scene's world
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true,
          required_unless_present = "pixel", conflicts_with = "pixel")]
    pub at: Option<[f64; 3]>,

    /// What a view shows at a pixel (x right, y down)
    #[arg(long, value_name = "VIEW,X,Y", value_parser = pixel)]
    pub pixel: Option<Pixel>,

    /// Camera list for --pixel, when the scene does not know its own
    #[arg(long)]
    pub cameras: Option<PathBuf>,

    /// Largest extent of the object in scene units; a share of the cameras' distance when absent
    #[arg(long, allow_hyphen_values = true, value_parser = positive)]
    pub size: Option<f64>,

    /// Turn about up, counter-clockwise seen from above
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true, value_parser = number)]
    pub yaw: f64,

    /// The transform.json to write
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

/// How the unseen part of the light is filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Completion {
    /// By a learned model, the one that ships with comgs unless --model names another
    Diffusion,
    /// Smoothly, from what was seen
    Harmonic,
    /// By spherical harmonics fitted to what was seen
    Sh,
    /// With the mean of what was seen
    Constant,
    /// Black
    None,
}

/// How a learned model is run.
#[derive(Debug, Args)]
pub(crate) struct Model {
    /// Folder of a model bundle (model.json and graphs) instead of the shipped one
    #[arg(long, value_name = "DIR")]
    pub model: Option<PathBuf>,

    /// Run graphs in this ONNX Runtime library (1.24 or later) instead of the embedded runtime; about twice as fast
    #[arg(long, value_name = "LIBRARY", env = "ORT_DYLIB_PATH")]
    pub onnxruntime: Option<PathBuf>,

    /// Sampling steps; one gives the mean of what may be there [default: the model's own]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub steps: Option<u32>,

    /// Complete this often and take the mean; the spread is reported
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub samples: u32,

    /// Seed of the first sample: same seed, same bytes
    #[arg(long, default_value_t = 0)]
    pub seed: u64,

    /// What to use, with a warning, when the model cannot be run
    #[arg(long, value_enum, value_name = "COMPLETION")]
    pub fallback: Option<Completion>,
}

/// Find the light that falls on a place
///
/// Looks around in the scene's radiance field and completes what was never seen: the ceiling nobody filmed, the sun behind
/// the camera. Writes an equirectangular HDR map and pictures of it, of what was seen, and of how much that was.
#[derive(Debug, Args)]
#[command(
    group(ArgGroup::new("where").required(true).args(["at", "transform"])),
    after_help = "\
Examples:
  comgs light --scene room.asset --at 0.3,-1.2,0.25 -o env.exr
  comgs light --scene room.asset --transform transform.json --object cow.asset -o env.exr --report light
  comgs light --scene room.asset --at 0.3,-1.2,0.25 -o env.exr --steps 8 --samples 8 --report light
  comgs light --scene room.asset --at 0.3,-1.2,0.25 -o env.exr --completion none --height 256")]
pub(crate) struct Light {
    /// Scene asset, or a PLY of surfels
    #[arg(long)]
    pub scene: PathBuf,

    /// Where to look around from: the middle of the object, not its base
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub at: Option<[f64; 3]>,

    /// Look around from where this file puts the object
    #[arg(long, value_name = "FILE")]
    pub transform: Option<PathBuf>,

    /// The object that --transform places: its middle is the centre, and surfels within half its size are not seen
    #[arg(long, value_name = "ASSET", requires = "transform")]
    pub object: Option<PathBuf>,

    /// How the unseen part is filled
    #[arg(long, value_enum, default_value = "diffusion")]
    pub completion: Completion,

    #[command(flatten)]
    pub model: Model,

    /// Ask the scene's own lit and shadowed surfaces for strong lights and for the scale of what was completed: it has found
    /// lights and has made some up, so look at its --report (docs/lighting.md)
    #[arg(long, value_enum, default_value = "off")]
    pub evidence: Switch,

    /// Height of the map in texels; it is twice as wide
    #[arg(long, default_value_t = 128, value_parser = map_height)]
    pub height: usize,

    /// Do not see surfels nearer than this (scene units), such as floaters
    #[arg(long, value_name = "DISTANCE", allow_hyphen_values = true, value_parser = distance)]
    pub near: Option<f64>,

    /// The map to write: .exr or .hdr; pictures go beside it
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,

    /// Write pictures of every step, and of spheres under the light, into this folder
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
}

/// Complete panoramas, and measure how well
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs panorama complete --input partial.exr --mask mask.png -o env.exr
  comgs panorama eval hdri --masks assets/panorama/masks --held-out")]
pub(crate) struct Panorama {
    #[command(subcommand)]
    pub what: PanoramaWhat,
}

/// What is done with panoramas.
#[derive(Debug, Subcommand)]
pub(crate) enum PanoramaWhat {
    Complete(PanoramaComplete),
    Eval(PanoramaEval),
}

/// Complete a partial panorama
///
/// Equirectangular, z up, twice as wide as high. What is known stays as it is; the rest is filled.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs panorama complete --input partial.exr --mask mask.png -o env.exr
  comgs panorama complete --input partial.exr --mask mask.png -o env.exr --completion harmonic")]
pub(crate) struct PanoramaComplete {
    /// The panorama: EXR or HDR, linear radiance; with alpha, no mask is needed
    #[arg(long, value_name = "FILE")]
    pub input: PathBuf,

    /// What is known of it: white
    #[arg(long, value_name = "FILE")]
    pub mask: Option<PathBuf>,

    /// World normals of what is known (EXR)
    #[arg(long, value_name = "FILE")]
    pub normals: Option<PathBuf>,

    /// What fills the rest
    #[arg(long, value_enum, default_value = "diffusion")]
    pub completion: Completion,

    #[command(flatten)]
    pub model: Model,

    /// The map to write: .exr or .hdr
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

/// Which numbers are compared.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum SphereProtocol {
    /// Linear radiance
    Linear,
    /// As published code does: gamma-compressed maps, summed channels
    Legacy,
}

/// Judge completers on panoramas that are known whole
///
/// Each map is hidden under each mask and completed; a mirror, a glossy and a diffuse sphere lit by the result are compared
/// with those under the whole map. Prints a table by coverage of the masks.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs panorama eval hdri --masks assets/panorama/masks --held-out
  comgs panorama eval hdri --masks assets/panorama/masks --more-steps 4,16 --json scores.json")]
pub(crate) struct PanoramaEval {
    /// Folder of panoramas (EXR or HDR)
    pub maps: PathBuf,

    /// Folder of masks (PNG or EXR, white = known)
    #[arg(long, value_name = "DIR")]
    pub masks: PathBuf,

    /// Panoramas for the nearest-of-a-bank completer; the maps that are not judged when absent
    #[arg(long, value_name = "DIR")]
    pub bank: Option<PathBuf>,

    /// Judge every third map by name, from the second on: of the project's maps those that the shipped model never saw
    #[arg(long)]
    pub held_out: bool,

    /// Which numbers are compared
    #[arg(long, value_enum, default_value = "linear")]
    pub protocol: SphereProtocol,

    #[command(flatten)]
    pub model: Model,

    /// Judge the model with these numbers of steps too
    #[arg(long, value_name = "N,…", value_delimiter = ',')]
    pub more_steps: Vec<usize>,

    /// Judge the mean of this many samples too, at the largest number of steps
    #[arg(long, value_name = "N,…", value_delimiter = ',')]
    pub more_samples: Vec<usize>,

    /// Leave out the simple completers
    #[arg(long)]
    pub model_only: bool,

    /// Judge as well what exposure brackets and the model's codes can hold of a whole map
    #[arg(long)]
    pub representations: bool,

    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Look at model bundles
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs model check                                         the model that ships with comgs
  comgs model check my_model")]
pub(crate) struct ModelCommand {
    #[command(subcommand)]
    pub what: ModelWhat,
}

/// What is done with bundles.
#[derive(Debug, Subcommand)]
pub(crate) enum ModelWhat {
    Check(ModelCheck),
}

/// Say what a model bundle holds, whether it runs, and how fast
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs model check                                         the model that ships with comgs
  comgs model check my_model --onnxruntime libonnxruntime.so")]
pub(crate) struct ModelCheck {
    /// Folder of the bundle; the shipped one when absent
    pub bundle: Option<PathBuf>,

    /// Try this ONNX Runtime library as well
    #[arg(long, value_name = "LIBRARY", env = "ORT_DYLIB_PATH")]
    pub onnxruntime: Option<PathBuf>,
}

fn map_height(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(n) if (2..=4096).contains(&n) => Ok(n),
        _ => Err("expected a height from 2 to 4096 texels".into()),
    }
}
