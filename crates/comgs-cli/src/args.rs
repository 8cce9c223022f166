#![allow(
    rustdoc::invalid_html_tags,
    reason = "doc comments here are help texts, where <camera> is a placeholder"
)]

//! Arguments and help. Help teaches: every command says what it makes and shows how it is called.

use crate::values::{
    GreyCard, Pixel, distance, duration, factors, grey_card, number, pixel, point, positive, size,
};
use clap::{ArgGroup, Args, Parser, Subcommand, ValueEnum};
use comgs_pipeline::stages::material::AlbedoEdit;
use std::path::PathBuf;

const OVERVIEW: &str = "\
The way from two captures to a picture:
  comgs reconstruct photos/cow  -o cow.asset
  comgs reconstruct photos/room -o room.asset
  comgs place   --scene room.asset --object cow.asset --pixel 00003,256,180 -o transform.json
  comgs compose --scene room.asset --object cow.asset --transform transform.json \\
                --cameras photos/room -o out/cow_in_room
  open out/cow_in_room/report.html

`comgs demo` does all of it on two small captures that ship with the source. A stage whose inputs did not change is not
run again. Ctrl-C stops at the next state that can be resumed.";

/// Put captured objects into captured scenes.
///
/// Give posed photos of an object and posed photos of a place, say where the object goes, and get frames in which it
/// stands there, with its shadow.
#[derive(Debug, Parser)]
#[command(name = "comgs", version, max_term_width = 100, after_long_help = OVERVIEW, after_help = OVERVIEW)]
pub(crate) struct Cli {
    /// Number of threads; all cores when absent
    #[arg(long, global = true, value_name = "N", value_parser = threads)]
    pub threads: Option<usize>,

    /// Say nothing but warnings and results
    #[arg(long, short, global = true)]
    pub quiet: bool,

    #[command(subcommand)]
    pub command: Command,
}

fn threads(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(n) if (1..=1024).contains(&n) => Ok(n),
        _ => Err("expected a number of threads from 1 to 1024".into()),
    }
}

/// The commands, in the order of the work.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Reconstruct(Reconstruct),
    Decompose(Decompose),
    Place(Place),
    Light(Light),
    Render(Render),
    Relight(Relight),
    Compose(Compose),
    Material(Material),
    Eval(Eval),
    Ablate(Ablate),
    Export(Export),
    Synth(Synth),
    Demo(Demo),
    Info(Info),
}

/// What a capture shows.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Kind {
    /// One thing, cut out by masks, cameras around it
    Object,
    /// A place that fills the frames
    Scene,
}

/// Time against quality.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Quality {
    /// A look at the result, in about a minute
    Draft,
    /// The default
    Balanced,
    /// As good as it gets on this machine
    Reference,
}

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

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Switch {
    /// Yes
    On,
    /// No
    Off,
}

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

/// Render an asset as cameras see it
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs render cow.asset --cameras photos/cow/test/cameras.json -o out/cow
  comgs render published.ply --cameras photos/room -o out/room --layers")]
pub(crate) struct Render {
    /// Asset, or a PLY of surfels
    pub asset: PathBuf,

    /// Any camera list or capture
    #[arg(long)]
    pub cameras: PathBuf,

    /// Output folder: frames/<camera>.png
    #[arg(short, long, value_name = "DIR")]
    pub output: PathBuf,

    /// Also write layers/<camera>.exr: beauty, depth, normal, material
    #[arg(long)]
    pub layers: bool,
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
