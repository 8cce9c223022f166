//! Arguments of the commands that work on a composition.

use super::{Quality, Switch};
use crate::values::{duration, positive};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Where shadows on the scene come from.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ShadowFrom {
    /// Occlusion of the objects, baked once, and rays to strong lights; cached where the frames need it
    Auto,
    /// Probes in the scene, as in the paper
    Probes,
    /// Rays for every pixel of every frame
    Trace,
    /// No shadow
    None,
}

/// Whether objects take the scene's light.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum RelightObjects {
    /// Where they have material
    Auto,
    /// They keep the light of their captures
    Off,
}

/// How objects under the scene's light are shaded.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ShadeBy {
    /// Cached, and sampled with `--quality reference`
    Auto,
    /// The matte part kept on the surfels, the highlight from few directions
    Cached,
    /// Samples of light and reflectance at every pixel of every frame
    Sampled,
}

/// What is simulated, and how finely.
#[derive(Debug, Args)]
pub(crate) struct Editing {
    /// Where shadows on the scene come from
    #[arg(long, value_enum, default_value = "auto")]
    pub shadow: ShadowFrom,

    /// Whether the objects take the scene's light
    #[arg(long, value_enum, default_value = "auto")]
    pub relight: RelightObjects,

    /// How that light is worked out
    #[arg(long, value_enum, default_value = "auto")]
    pub shading: ShadeBy,

    /// What objects hide from themselves and each other
    #[arg(long, value_enum, default_value = "on")]
    pub self_occlusion: Switch,

    /// Light from the scene's surfaces where they are, instead of a map infinitely far away
    #[arg(long, value_enum, default_value = "off")]
    pub near_field: Switch,

    /// Light that bounces between the objects' surfaces
    #[arg(long, value_enum, default_value = "off")]
    pub indirect: Switch,

    /// Light that the objects throw back on the scene
    #[arg(long, value_enum, default_value = "off")]
    pub bounce: Switch,

    /// Photos of the scene (its capture): give the objects their defocus and the frames their noise
    #[arg(long, value_name = "DIR")]
    pub photos: Option<PathBuf>,

    /// Point on the curve of time against error [default: balanced; with a budget, the finest that fits]
    #[arg(long, value_enum)]
    pub quality: Option<Quality>,

    /// Same seed, same bytes
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}

/// Bake what the objects of a composition occlude
///
/// Done once an object: it serves any place, turn and size, and any light.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs shadow --composition out/composition.json -o cache
  comgs render --composition out/composition.json --cache cache -o frames")]
pub(crate) struct Shadow {
    /// composition.json, as `comgs compose` writes it
    #[arg(long, value_name = "FILE")]
    pub composition: PathBuf,

    /// Folder of the occlusion fields
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Resolution of the fields
    #[arg(long, value_enum, default_value = "balanced")]
    pub quality: Quality,
}

/// Render a composition whose objects move
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs animate --composition out/composition.json --path poses --cameras one_camera.json -o frames
  comgs animate --composition out/composition.json --path poses --cache cache --relight off -o frames

A pose is a file like transform.json; the steps go in the order of the files' names. An object that a step does not name
stays where it is.")]
pub(crate) struct Animate {
    /// composition.json, as `comgs compose` writes it
    #[arg(long, value_name = "FILE")]
    pub composition: PathBuf,

    /// Folder of poses, one file a step
    #[arg(long, value_name = "DIR")]
    pub path: PathBuf,

    /// One camera, or one for every step
    #[arg(long)]
    pub cameras: Option<PathBuf>,

    /// Folder of occlusion fields made by `comgs shadow`
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,

    /// Output folder: frames/<step>.png, preview.gif
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    #[command(flatten)]
    pub editing: Editing,
}

/// Tell which effects a composition calls for, why, and at what cost
///
/// Every effect is tried on small frames with and without it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs plan --composition out/composition.json
  comgs plan --composition out/composition.json --tolerance 0.002
  comgs plan --composition out/composition.json --budget 10s")]
pub(crate) struct Plan {
    /// composition.json, as `comgs compose` writes it
    #[arg(long, value_name = "FILE")]
    pub composition: PathBuf,

    /// Cameras instead of the composition's
    #[arg(long)]
    pub cameras: Option<PathBuf>,

    /// Folder of occlusion fields made by `comgs shadow`: what lies there costs nothing
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,

    /// Least change of the picture that calls for an effect: mean over the pixels it touches, 1 is white
    #[arg(long, value_name = "T", default_value = "0.004", allow_negative_numbers = true, value_parser = positive)]
    pub tolerance: f64,

    /// Time for reading, preparation and all frames (10s)
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub budget: Option<f64>,

    /// Photos of the scene (its capture), whose defocus and noise frames may call for
    #[arg(long, value_name = "DIR")]
    pub photos: Option<PathBuf>,

    /// Point on the curve of time against error [default: balanced; with a budget, the finest that fits]
    #[arg(long, value_enum)]
    pub quality: Option<Quality>,

    /// Same seed, same bytes
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
}
