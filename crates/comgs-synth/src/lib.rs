//! Synthetic captures with exact ground truth, from a seed.
//!
//! A [`Recipe`] describes objects, scenes and compositions of the two; [`generate`] renders it into the SynCom
//! layout (`docs/synth.md`), [`write_root()`] puts that on disk. The renderer is a small unbiased path
//! tracer over triangle meshes that shares no code with the pipeline's rasteriser and tracer, so that it can
//! judge them.
//!
//! ```no_run
//! let recipe = comgs_synth::builtin::recipe("tiny").unwrap();
//! comgs_synth::write_root(&recipe, std::path::Path::new("root"), &mut |progress| {
//!     println!("{:3.0} % {}", 100.0 * progress.fraction, progress.doing);
//!     std::ops::ControlFlow::Continue(())
//! })?;
//! # Ok::<(), comgs_synth::SynthError>(())
//! ```
//!
//! Modules in the order of the work: what is described ([`recipe`], [`builtin`], [`shape`], [`material`],
//! [`light`]), what is built from it ([`mesh`], [`environment`], [`world`]), how it is rendered ([`brdf`],
//! [`path`], [`film`], [`rig`]), and what comes out ([`produce`], [`write_root`](mod@write_root)).
//!
//! Same recipe, same bytes, at any thread count: every pixel of every view has its own random stream.

pub mod brdf;
pub mod builtin;
mod builtin_scenes;
pub mod environment;
pub mod error;
pub mod film;
mod lathe;
pub mod light;
pub mod material;
pub mod mesh;
mod noise;
pub mod path;
pub mod places;
pub mod produce;
pub mod recipe;
pub mod rig;
mod sequence;
pub mod shape;
mod surface_nets;
pub mod world;
pub mod write_root;

pub use error::SynthError;
pub use produce::{Content, Output, Progress, generate};
pub use recipe::{Overrides, Recipe};
pub use world::World;
pub use write_root::{Summary, write_root};
