//! Arguments of the commands that make and change assets.

use super::{Kind, Quality, Switch};
use crate::values::{GreyCard, duration, factors, grey_card};
use clap::{ArgGroup, Args, ValueEnum};
use comgs_pipeline::stages::material::AlbedoEdit;
use std::path::PathBuf;

/// Make an asset (surfels) from a capture (posed photos)
///
/// A capture is a folder in one of the usual forms: COLMAP (`sparse/`), Blender/NeRF (`transforms.json` or
/// `transforms_train.json`), or SynCom (`cameras.json` or `train/cameras.json`). Masks come from the images' alpha or
/// from mask files beside them; lens distortion is removed on load.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs reconstruct photos/cow -o cow.asset
  comgs reconstruct photos/room -o room.asset --quality draft --time-budget 5m
  comgs reconstruct photos/room -o room.asset --resume      continue what was interrupted
  comgs reconstruct --check photos/room                     list every problem, do nothing")]
pub(crate) struct Reconstruct {
    /// Folder of the capture, or its camera list
    pub capture: PathBuf,

    /// Folder of the asset to make
    #[arg(short, long, value_name = "ASSET", required_unless_present = "check")]
    pub output: Option<PathBuf>,

    /// What the capture shows; when absent, photos with masks show an object
    #[arg(long, value_enum)]
    pub kind: Option<Kind>,

    /// Time against quality
    #[arg(long, value_enum, default_value = "balanced")]
    pub quality: Quality,

    /// End after this time with the best model so far (90s, 5m, 1h30m)
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time_budget: Option<f64>,

    /// Same seed, same bytes (without a time budget)
    #[arg(long, default_value_t = 0)]
    pub seed: u64,

    /// Hard limit on the number of surfels instead of the quality's own
    #[arg(long, value_name = "N")]
    pub budget_surfels: Option<usize>,

    /// Reduce photos to this width in pixels
    #[arg(long, value_name = "PX", default_value_t = 1600)]
    pub max_width: usize,

    /// Continue from the checkpoint that an interrupted run left
    #[arg(long)]
    pub resume: bool,

    /// Only list every problem of the capture, each with its path
    #[arg(long)]
    pub check: bool,
}

/// Where occlusion and light from the object itself come from.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Visibility {
    /// Interpolated from probes on the surface
    Probes,
    /// A traced ray for every light sample: slow, what probes stand for
    Trace,
    /// Nothing is occluded
    None,
}

/// Make an object relightable: separate its material from the light of its capture
///
/// Adds albedo, roughness and metallic to the asset's surfels, and to the asset the light it was captured under (env.exr)
/// and the probes that know what each spot of it sees. Photos cannot tell a bright surface in dim light from a dark one in
/// bright light: a prior decides unless --albedo-scale or --grey-card does.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs decompose cow.asset --capture photos/cow
  comgs decompose cow.asset --capture photos/cow -o cow_relightable.asset --time-budget 3m
  comgs decompose cow.asset --capture photos/cow --grey-card 00012,210,140
  comgs decompose cow.asset --capture photos/cow --visibility trace      what the probes save")]
pub(crate) struct Decompose {
    /// Object asset, made by `comgs reconstruct`
    pub asset: PathBuf,

    /// The capture it was made from
    #[arg(long, value_name = "CAPTURE")]
    pub capture: PathBuf,

    /// Asset to make; the same folder when absent
    #[arg(short, long, value_name = "ASSET")]
    pub output: Option<PathBuf>,

    /// Where occlusion and light from the object itself come from
    #[arg(long, value_enum, default_value = "probes")]
    pub visibility: Visibility,

    /// Number of probes [default: by quality, 5000 when balanced]
    #[arg(long, value_name = "N")]
    pub probes: Option<usize>,

    /// Side of a probe's texture in texels
    #[arg(long, value_name = "TEXELS", default_value_t = 16)]
    pub probe_res: usize,

    /// Distance of probes from the surface, as a share of the object's size
    #[arg(long, value_name = "SHARE", default_value_t = 0.01)]
    pub probe_offset: f32,

    /// Let probes count only as far as they see the shading point (DDGI's Chebyshev weight)
    #[arg(long, value_enum, default_value = "off")]
    pub chebyshev: Switch,

    /// Light samples a shading point [default: by quality, 128 when balanced]
    #[arg(long, value_name = "N")]
    pub rays: Option<u32>,

    /// Number of steps [default: by quality]
    #[arg(long, value_name = "N")]
    pub iterations: Option<u32>,

    /// Multiply the albedo that the prior finds by one factor or three (and divide the light)
    #[arg(long, value_name = "S|R,G,B", value_parser = factors, conflicts_with = "grey_card")]
    pub albedo_scale: Option<[f32; 3]>,

    /// A pixel of a training photo that shows a grey card (albedo 0.18 when none is given)
    #[arg(long, value_name = "VIEW,X,Y[,ALBEDO]", value_parser = grey_card)]
    pub grey_card: Option<GreyCard>,

    /// Time against quality
    #[arg(long, value_enum, default_value = "balanced")]
    pub quality: Quality,

    /// End after this time with the best result so far (90s, 3m)
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time_budget: Option<f64>,

    /// Reduce photos to this width in pixels
    #[arg(long, value_name = "PX", default_value_t = 1600)]
    pub max_width: usize,

    /// Same seed, same bytes (without a time budget)
    #[arg(long, default_value_t = 0)]
    pub seed: u64,

    /// Continue from the checkpoint that an interrupted run left
    #[arg(long)]
    pub resume: bool,
}

/// Materials with a name.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Preset {
    /// Brushed copper: metal, albedo 1.00 0.65 0.53, roughness 0.3
    Copper,
    /// Polished silver: metal, albedo 0.99 0.98 0.97, roughness 0.15
    Silver,
    /// Grey stone, roughness 0.9, with the light and dark pattern of the object
    Stone,
    /// Red paint, albedo 0.60 0.04 0.03, roughness 0.85
    RedMatte,
    /// The same paint under a clear coat, roughness 0.12
    RedGlossy,
}

fn unit(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(v) if (0.0..=1.0).contains(&v) => Ok(v),
        _ => Err("expected a number from 0 to 1".into()),
    }
}

/// Give a decomposed asset another material
///
/// Writes a new asset with the albedo, roughness or metallic changed; geometry, probes and light come along. A preset comes
/// first, single values then replace its own. The captured colours stay: `comgs relight` shows the edit, `comgs render` does
/// not.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("edit").required(true).multiple(true).args(["albedo", "roughness", "metallic", "preset"]),
    after_help = "\
Examples:
  comgs material cow.asset --preset copper -o copper_cow.asset
  comgs material cow.asset --preset copper --roughness 0.05 -o mirror_cow.asset
  comgs material cow.asset --albedo 0.9,0.2,0.2 -o red_cow.asset       one linear colour
  comgs material cow.asset --albedo 1.2 -o brighter_cow.asset          the old colours times 1.2
  comgs material cow.asset --roughness 0.1 --metallic 0 -o glazed_cow.asset"
)]
pub(crate) struct Material {
    /// Asset made with `comgs decompose`, or a PLY of surfels with material
    pub asset: PathBuf,

    /// A linear colour to set (three numbers from 0 to 1), or a factor for the old ones (one number)
    #[arg(long, value_name = "R,G,B|SCALE")]
    pub albedo: Option<AlbedoEdit>,

    /// Roughness everywhere: 0 is a mirror, 1 is chalk
    #[arg(long, value_name = "R", value_parser = unit)]
    pub roughness: Option<f64>,

    /// Metallic everywhere: 0 or 1, and between for mixtures
    #[arg(long, value_name = "M", value_parser = unit)]
    pub metallic: Option<f64>,

    /// A material with a name
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,

    /// Folder of the asset to make
    #[arg(short, long, value_name = "ASSET")]
    pub output: PathBuf,
}

/// Write an asset's surfels as a PLY for other programs
///
/// As they are, with material, or for viewers of 3D Gaussian splatting: with a thin third scale and harmonics padded to
/// degree 3, without material.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs export cow.asset -o cow.ply
  comgs export cow.asset -o cow_view.ply --viewer")]
pub(crate) struct Export {
    /// Asset, or a PLY of surfels
    pub asset: PathBuf,

    /// The PLY to write
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,

    /// For viewers of 3D Gaussian splatting, which expect three scales
    #[arg(long)]
    pub viewer: bool,
}
