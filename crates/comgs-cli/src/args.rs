#![allow(
    rustdoc::invalid_html_tags,
    reason = "doc comments here are help texts, where <camera> is a placeholder"
)]

//! Arguments and help. Help teaches: every command says what it makes and shows how it is called.

mod editing;
mod frames;
mod insert;
mod judges;
mod objects;
mod places;
mod synth;
mod tradeoff;

use clap::{Parser, Subcommand, ValueEnum};

pub(crate) use editing::{Animate, Editing, Plan, RelightObjects, ShadeBy, Shadow, ShadowFrom};
pub(crate) use frames::{Compose, Relight, Render, SelfShadow};
pub(crate) use insert::{
    CameraArgument, FillArgument, GuidanceArgument, Insert, InsertEval, ObjUp, Plane, ResponseArgument,
};
pub(crate) use judges::{Ablate, AblateWhat, Eval};
pub(crate) use objects::{Decompose, Export, Material, Preset, Reconstruct, Visibility};
pub(crate) use places::{
    Completion, Light, Model, ModelCommand, ModelWhat, Panorama, PanoramaWhat, Place, SphereProtocol,
};
pub(crate) use synth::{Demo, Info, Synth};
pub(crate) use tradeoff::{Tradeoff, TradeoffWhat};

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
    Panorama(Panorama),
    Model(ModelCommand),
    Render(Render),
    Relight(Relight),
    Compose(Compose),
    Insert(Box<Insert>),
    InsertEval(InsertEval),
    Shadow(Shadow),
    Plan(Plan),
    Animate(Animate),
    Material(Material),
    Eval(Eval),
    Ablate(Ablate),
    Tradeoff(Tradeoff),
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

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Switch {
    /// Yes
    On,
    /// No
    Off,
}
