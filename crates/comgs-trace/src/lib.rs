//! Ray tracing of Gaussian surfels on the CPU: exactly ordered radiance over any number of hits, order-free
//! transmittance with early exit, and parallel batches of both.
//!
//! A surfel answers a ray as it answers the rasteriser, without the rasteriser's screen-space low-pass filter:
//! the ray meets the surfel's plane in one point, whose tangent coordinates in standard deviations are `(u, v)`, and
//!
//! ```text
//! α = min(α_max, opacity · exp(−(u² + v²) / 2)),   nothing where opacity · exp(…) < α_min
//! ```
//!
//! The surfel is therefore a disc of radius `√(2 ln(opacity / α_min))` standard deviations. The boxes of these discs
//! go through `obvhs`' builder (PLOC and reinsertion); the binary tree is then collapsed to eight children a node
//! and eight discs a leaf, one SIMD lane each.
//!
//! [`mod@reference`] is the specification: all surfels, no tree, f64.
//!
//! [`MeshTracer`] does the same for triangles, for objects that come as meshes.

mod bvh;
mod collapse;
mod config;
mod disc;
mod kernel;
mod mesh;
pub mod reference;
mod tracer;
mod traverse;
mod view;

pub use config::{TraceConfig, TraceError};
pub use disc::LeftOut;
pub use mesh::{MeshHit, MeshTracer};
pub use tracer::{Hit, RadianceHit, Ray, Tracer};
pub use view::{EyeColours, TracerView};
