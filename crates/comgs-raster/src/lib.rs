//! The differentiable multi-target rasteriser of Gaussian surfels (ComGS §3.1, Eq. 1; 2D Gaussian splatting,
//! Huang et al. 2024).
//!
//! One pass blends colour, weight, depth, normal and material planes front to back,
//!
//! ```text
//! B = Σ_i T_i α_i b_i,   T_i = Π_{j<i} (1 − α_j),   α_i = min(α_max, o_i exp(−ρ_i / 2)),
//! ```
//!
//! and a second pass returns exact gradients to every surfel parameter. What is not asked for is not computed.
//!
//! The modules stand in pipeline order: [`config`] → [`project`] (surfel to screen) → [`bounds`] (which tiles)
//! → [`bin`] (depth-sorted tile lists) → [`blend`] (one tile) → [`blend_vjp`] (its gradient) → [`mod@render`] (the
//! whole). [`reference`](mod@reference) says the same in scalar f64 without tiles, early-outs or bounds, and is
//! the specification.
//!
//! # The intersection
//!
//! In camera space let p be a surfel's centre, t_u, t_v its unit tangents, n = t_u × t_v its normal, s its
//! scales, and d = ((x − c_x)/f_x, (y − c_y)/f_y, 1) the ray through pixel position (x, y). The ray meets the
//! surfel's plane at depth and local coordinates
//!
//! ```text
//! z = (n·p) / (n·d),   u = ((t_v × p)·d) / (s_u n·d),   v = ((p × t_u)·d) / (s_v n·d).
//! ```
//!
//! All three are ratios of linear forms in the pixel position. Because (t_v × p)·p = 0, the numerators are
//! expanded around the projected centre, where they vanish exactly: there is no cancellation far from the
//! image's origin and none for surfels that are small or far away.

pub mod bin;
pub mod blend;
pub mod blend_vjp;
pub mod bounds;
pub mod color;
pub mod config;
pub mod frame;
pub mod project;
pub mod reference;
pub mod render;
mod simd;
pub mod surface;

pub use config::{LowPass, Planes, RasterConfig};
pub use frame::{Frame, FrameGradient};
pub use render::{SurfelGradients, Workspace, backward, forward, render};
pub use surface::surface_normals;
