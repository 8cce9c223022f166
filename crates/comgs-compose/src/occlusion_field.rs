//! What an object occludes, baked once in its own frame and looked up under any similarity.
//!
//! ComGS § 3.2.2 bakes the occlusion of a placed object at ten thousand points of the scene, and bakes it again when the
//! object moves. But what an object hides from a point depends on nothing but the point and the direction relative to the
//! object, and along a line it depends on the line alone, up to where on it the point is. So for every direction ω of an
//! octahedral grid one parallel projection of the object along ω is stored: how opaque it is there, and how far along ω its
//! last surface lies, the one that faces the light. A point p is in the object's shadow from ω as far as that surface lies
//! beyond it:
//!
//! ```text
//! q = (u·(p − c), v·(p − c)) / r      place in the projection, centre c and radius r of the bounding sphere
//! t = ω·(p − c) / r                   depth of the point
//! O(p, ω) = Σ bilinear · α(q) · [ depth(q) > t ]
//! ```
//!
//! This is percentage-closer shadow mapping (Reeves et al. 1987) with a light in every direction at once. It is exact for
//! an opaque object up to the two resolutions; what is half transparent *and* has the point between its sheets is rounded
//! to the sheet that holds half of the opacity. A direction between grid directions takes the nearest projection, met where
//! the ray crosses the plane through the object's middle ([`crate::field_shadow`]): what is wrong then is a parallax within the
//! object, not a shift of the whole shadow. Small strong lights are split off ([`comgs_light::LightSplit`]) and traced.
//!
//! Projections are splatted, not traced: 2.0 CPU-seconds for 29,000 surfels on 128 projections of 64² pixels, 4.0 for half a
//! million rays that look for all of their hits. What it gives and what limits it: `docs/shadows.md`.

mod project;
mod serial;

pub(crate) use project::Window;
pub use serial::{FieldFormatError, from_bytes, to_bytes};

use crate::objects::bounding_sphere;
use comgs_geom::{frame::world_from_tangent, octahedral};
use comgs_surfel::SurfelCloud;
use glam::Vec3;
use rayon::prelude::*;
use thiserror::Error;

/// Largest side of the direction grid.
pub const MAX_DIRECTIONS: usize = 64;
/// Largest side of a projection.
pub const MAX_RESOLUTION: usize = 256;

/// Resolutions of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldConfig {
    /// Side of the octahedral grid of directions; even, 4 to [`MAX_DIRECTIONS`].
    pub directions: usize,
    /// Side of a projection in pixels, across the bounding sphere; 4 to [`MAX_RESOLUTION`].
    pub resolution: usize,
}

impl Default for FieldConfig {
    /// 16² directions of 64² pixels, 4.2 MB: the knee of the curve in `docs/shadows.md`.
    fn default() -> Self {
        Self { directions: 16, resolution: 64 }
    }
}

impl FieldConfig {
    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        if !(4..=MAX_DIRECTIONS).contains(&self.directions) || self.directions % 2 == 1 {
            let got = self.directions;
            problems.push(format!("directions is {got}, expected an even number from 4 to {MAX_DIRECTIONS}"));
        }
        if !(4..=MAX_RESOLUTION).contains(&self.resolution) {
            problems.push(format!("resolution is {}, expected 4 to {MAX_RESOLUTION}", self.resolution));
        }
        problems
    }
}

/// Why a field could not be baked.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FieldError {
    /// A resolution is out of range; all problems.
    #[error("unusable occlusion field: {}", .0.join("; "))]
    Config(Vec<String>),
    /// Nothing of the object can be seen.
    #[error("the object has {0} surfels, none of them visible")]
    Invisible(usize),
    /// The object cannot be traced.
    #[error("the object cannot be traced: {0}")]
    Trace(#[from] comgs_trace::TraceError),
    /// The caller asked to stop.
    #[error("baking was stopped")]
    Cancelled,
}

/// The occlusion of an object in its own frame. Memory: `4 directions² resolution²` bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct OcclusionField {
    config: FieldConfig,
    centre: Vec3,
    radius: f32,
    /// What part of the sphere's disc a direction's projection shows.
    windows: Vec<Window>,
    /// `[direction][row · resolution + column]`: opacity and depth of the surface on the light's side, each over its range
    /// in 16 bits.
    texels: Vec<[u16; 2]>,
}

/// A direction of the grid with the axes of its projection. The two directions of a line have the same axes, so that their
/// projections are pixel for pixel the same lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldDirection {
    /// Unit direction towards the light, object space.
    pub towards: Vec3,
    /// First axis of the projection.
    pub u: Vec3,
    /// Second axis.
    pub v: Vec3,
}

/// Depths reach a little beyond the sphere, in its radii.
const DEPTH_REACH: f32 = 1.02;

fn depth_code(t: f32) -> u16 {
    let unit = (t / DEPTH_REACH + 1.0) * 0.5;
    (unit.clamp(0.0, 1.0) * f32::from(u16::MAX)).round() as u16
}

/// Index of the opposite direction of the grid.
fn opposite(k: usize, side: usize) -> usize {
    octahedral::texel_of(-towards(k, side), side)
}

/// All directions of a grid of `side²`, in the order of an octahedral map's texels.
#[must_use]
pub fn grid(side: usize) -> Vec<FieldDirection> {
    (0..side * side)
        .map(|k| {
            // The tangent frame jumps at the equator, so both directions of a line take that of the same one.
            let first = opposite(k, side).min(k);
            let axes = world_from_tangent(towards(first, side));
            FieldDirection { towards: towards(k, side), u: axes.x_axis, v: axes.y_axis }
        })
        .collect()
}

/// A direction of the grid.
fn towards(k: usize, side: usize) -> Vec3 {
    octahedral::texel_direction(k % side, k / side, side)
}

impl OcclusionField {
    /// Bakes the field of an object in its own space. `cancelled` is asked now and then. Parallel, the same bytes at any
    /// thread count.
    ///
    /// # Errors
    /// [`FieldError`].
    pub fn bake(
        cloud: &SurfelCloud,
        config: FieldConfig,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Self, FieldError> {
        let problems = config.check();
        if !problems.is_empty() {
            return Err(FieldError::Config(problems));
        }
        let (centre, radius) = bounding_sphere(cloud).ok_or(FieldError::Invisible(cloud.len()))?;
        let discs = project::discs(cloud, centre, radius);
        let (side, res) = (config.directions, config.resolution);
        let directions = grid(side);
        let pairs: Vec<usize> = (0..side * side).filter(|&k| opposite(k, side) >= k).collect();
        let baked: Option<Vec<_>> = pairs
            .par_iter()
            .map(|&k| {
                if cancelled() {
                    return None;
                }
                let window = project::window(&discs, &directions[k]);
                let (forth, back) = project::project(&discs, &directions[k], &window, res);
                Some((window, forth, back))
            })
            .collect();
        let baked = baked.ok_or(FieldError::Cancelled)?;
        let mut texels = vec![[0u16; 2]; side * side * res * res];
        let mut windows = vec![Window { middle: [0.0; 2], half: [1.0; 2] }; side * side];
        let slice = |k: usize| k * res * res..(k + 1) * res * res;
        for (&k, (window, forth, back)) in pairs.iter().zip(&baked) {
            windows[k] = *window;
            windows[opposite(k, side)] = *window;
            texels[slice(k)].copy_from_slice(forth);
            texels[slice(opposite(k, side))].copy_from_slice(back);
        }
        Ok(Self { config, centre, radius, windows, texels })
    }

    /// Its resolutions.
    #[must_use]
    pub fn config(&self) -> FieldConfig {
        self.config
    }

    /// Centre and radius of the object's bounding sphere, object space.
    #[must_use]
    pub fn sphere(&self) -> (Vec3, f32) {
        (self.centre, self.radius)
    }

    /// Bytes of the projections.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.texels[..])
    }

    /// Opacity and depth of one direction's projection, row by row.
    pub(crate) fn projection(&self, direction: usize) -> &[[u16; 2]] {
        let size = self.config.resolution * self.config.resolution;
        &self.texels[direction * size..(direction + 1) * size]
    }

    /// The window of one direction's projection.
    pub(crate) fn window(&self, direction: usize) -> Window {
        self.windows[direction]
    }

    /// Share of light from a direction that the object hides from a point with place `q` in the direction's window ([−1, 1]²)
    /// and depth `t`, in [0, 1]; 0 outside of the window.
    #[inline]
    pub(crate) fn occlusion_at(projection: &[[u16; 2]], res: usize, qx: f32, qy: f32, t: f32) -> f32 {
        let scale = 0.5 * res as f32;
        let (x, y) = ((qx + 1.0) * scale - 0.5, (qy + 1.0) * scale - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        if !(x0 >= -1.0 && y0 >= -1.0 && x0 < res as f32 && y0 < res as f32) {
            return 0.0;
        }
        let (fx, fy) = (x - x0, y - y0);
        let depth = depth_code(t);
        let (x0, y0) = (x0 as isize, y0 as isize);
        let tap = |dx: isize, dy: isize| {
            let (x, y) = (x0 + dx, y0 + dy);
            if x < 0 || y < 0 || x >= res as isize || y >= res as isize {
                return 0.0;
            }
            let [alpha, surface] = projection[y as usize * res + x as usize];
            if surface > depth { f32::from(alpha) } else { 0.0 }
        };
        let top = tap(0, 0) * (1.0 - fx) + tap(1, 0) * fx;
        let bottom = tap(0, 1) * (1.0 - fx) + tap(1, 1) * fx;
        (top * (1.0 - fy) + bottom * fy) * (1.0 / f32::from(u16::MAX))
    }

    /// Transmittance from `point` towards `direction` (unit), both in object space: 1 − O of the nearest direction of the
    /// grid. Not differentiable. Reference: [`comgs_trace::Tracer::transmittance`] of the object.
    #[must_use]
    pub fn transmittance(&self, point: Vec3, direction: Vec3) -> f32 {
        let side = self.config.directions;
        let k = octahedral::texel_of(direction, side);
        let axes = world_from_tangent(towards(opposite(k, side).min(k), side));
        let p = (point - self.centre) / self.radius;
        let Window { middle, half } = self.windows[k];
        let x = (axes.x_axis.dot(p) - middle[0]) / half[0];
        let y = (axes.y_axis.dot(p) - middle[1]) / half[1];
        let t = towards(k, side).dot(p);
        1.0 - Self::occlusion_at(self.projection(k), self.config.resolution, x, y, t)
    }
}

#[cfg(test)]
mod tests;
