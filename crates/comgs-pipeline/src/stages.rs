//! The stages, one module each, in the order of the flow.

pub mod ablate;
pub mod animate;
pub mod completers;
pub mod compose;
pub mod decompose;
pub mod demo;
pub mod editing;
pub mod eval;
pub mod export;
pub mod info;
pub mod insert;
pub mod insert_eval;
pub mod light;
pub mod material;
pub mod model;
pub mod panorama;
pub mod panorama_eval;
pub mod place;
pub mod plan;
pub mod reconstruct;
pub mod relight;
pub mod render;
pub mod render_composition;
pub mod shadow;
pub mod synth;
pub mod tradeoff_reconstruct;
pub mod tradeoff_relight;
pub mod tradeoff_shadow;

pub(crate) mod frames;
