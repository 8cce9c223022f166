//! Surface octahedral probes (ComGS § 3.1.2): points near a surface that know what arrives there from every direction,
//! so that shading interpolates instead of tracing rays.
//!
//! 1. [`fuse`] turns depth maps into oriented surface points.
//! 2. [`place`] chooses some of them evenly ([`farthest_points`]) and lifts them off the surface: a [`ProbeSet`].
//! 3. [`bake`] traces their textures: incoming radiance, occlusion, distance moments.
//! 4. [`ProbeIndex::query`] finds the probes around a shading point and their weights, [`ProbeSet::blend`] and
//!    [`sample()`] (or [`ProbeSet::lookup`]) read them; [`sample_vjp`] and [`ProbeSet::blend_vjp`] are their gradients.
//! 5. [`to_bytes`] and [`from_bytes`] store them.
//!
//! [`mod@reference`] is the specification of the lookup: brute force, f64.

mod bake;
mod config;
mod error;
mod farthest_point;
mod fusion;
mod index;
mod lookup;
pub mod reference;
mod serial;
mod set;
mod weights;

pub use bake::{BakeObserver, bake, bake_occlusion};
pub use config::{LookupConfig, ProbeConfig, VisibilityWeight};
pub use error::ProbeError;
pub use farthest_point::{FarthestPoints, farthest_points};
pub use fusion::{DepthView, FusionConfig, FusionReport, OrientedPoints, fuse};
pub use index::ProbeIndex;
pub use lookup::{sample, sample_vjp};
pub use serial::{from_bytes, to_bytes};
pub use set::{MAX_RESOLUTION, ProbeSet, place};
pub use weights::Neighbours;

/// Most probes that a shading point is interpolated from.
pub const MAX_NEIGHBOURS: usize = 16;
