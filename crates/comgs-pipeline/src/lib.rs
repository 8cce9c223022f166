//! The typed stages of comgs.
//!
//! Every stage is a function `run(&Input, &Config, &Context) -> Result<Output, PipelineError>` that reads and writes the
//! common scene format, so stages can be chained in a script, replaced, or called alone:
//!
//! | stage | in | out |
//! |---|---|---|
//! | [`stages::reconstruct`] | capture | asset |
//! | [`stages::decompose`] | object asset, its capture | the asset with material, `env.exr`, probes |
//! | [`stages::material`] | decomposed asset | one of another material |
//! | [`stages::place`] | scene, object, a point or pixel | `transform.json` |
//! | [`stages::light`] | scene, a point | `env.exr` and pictures of how it came about |
//! | [`stages::render`] | asset, cameras | frames, layers |
//! | [`stages::relight`] | decomposed asset, environment map, cameras | frames, layers, turntable |
//! | [`stages::compose`] | scene, object, transform, cameras | frames, layers, `composition.json`, `report.html` |
//! | [`stages::insert`] | photo, mesh or decomposed asset | composite, layers, `env.exr`, tone curves, `report.html` |
//! | [`stages::shadow`] | composition | occlusion of its objects |
//! | [`stages::plan`] | composition | which effects it calls for |
//! | [`stages::render_composition`] | composition, occlusion | frames, layers |
//! | [`stages::animate`] | composition, poses | frames, a moving picture |
//! | [`stages::tradeoff_shadow`] | composition, ground truth | table and plot of what shadows cost |
//! | [`stages::eval`] | asset or frames, ground truth | scores |
//! | [`stages::ablate`] | object capture with ground truth | table and plot of what choices cost |
//! | [`stages::export`] | asset | a PLY for other programs |
//! | [`stages::synth`] | recipe | captures with ground truth |
//! | [`stages::demo`] | the captures in `assets/demo` | all of the above |
//! | [`stages::info`] | anything | what it holds |
//!
//! A stage whose inputs, configuration and outputs are unchanged since its last run is not run again: [`Fingerprint`]
//! says what a result was made from, [`record`] keeps it in `run.json` with timings, warnings and memory. Stages speak
//! through [`Progress`] and stop when their [`CancelToken`] says so.

pub mod error;
pub mod fingerprint;
pub mod output;
pub mod plot;
pub mod progress;
pub mod record;
pub mod report;
pub mod source;
pub mod stages;
pub mod tradeoff;

pub use error::PipelineError;
pub use fingerprint::Fingerprint;
pub use progress::{CancelToken, Context, Progress, Silent, Status};
pub use record::{Run, RunRecord, StageTime};

/// Version of comgs; part of every fingerprint, since another version may give other bytes.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
