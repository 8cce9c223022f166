//! Arguments of the commands that look at a place.

use crate::values::{Pixel, distance, number, pixel, point, positive};
use clap::{Args, ValueEnum};
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
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Completion {
    /// The smoothest light that agrees with what was seen
    Harmonic,
    /// Black
    None,
}

/// Find the light that falls on a place
///
/// Looks around in the scene's radiance field and fills what was never seen. Writes an equirectangular HDR map and
/// pictures of it, of what was seen, and of how much that was.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs light --scene room.asset --at 0.3,-1.2,0.25 -o env.exr
  comgs light --scene room.asset --at 0.3,-1.2,0.25 -o env.exr --completion none --height 256")]
pub(crate) struct Light {
    /// Scene asset, or a PLY of surfels
    #[arg(long)]
    pub scene: PathBuf,

    /// Where to look around from: the middle of the object, not its base
    #[arg(long, value_name = "X,Y,Z", value_parser = point, allow_hyphen_values = true)]
    pub at: [f64; 3],

    /// How the unseen part is filled
    #[arg(long, value_enum, default_value = "harmonic")]
    pub completion: Completion,

    /// Height of the map in texels; it is twice as wide
    #[arg(long, default_value_t = 128, value_parser = map_height)]
    pub height: usize,

    /// Do not see surfels nearer than this (scene units), such as floaters
    #[arg(long, value_name = "DISTANCE", default_value_t = 0.0, allow_hyphen_values = true, value_parser = distance)]
    pub near: f64,

    /// The map to write: .exr or .hdr; pictures go beside it
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

fn map_height(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(n) if (2..=4096).contains(&n) => Ok(n),
        _ => Err("expected a height from 2 to 4096 texels".into()),
    }
}
