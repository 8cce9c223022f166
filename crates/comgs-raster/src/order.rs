//! The order of surfels that lie in one sheet.
//!
//! Sorting by centre depth is right for surfels of different surfaces and wrong within one. On a surface that is seen
//! at a slant, centre depth grows along the slant, so the disc on the viewer's side always comes first, and its tail
//! covers the middle of the next. The blend then shows at every pixel what belongs about one standard deviation nearer
//! to the viewer: on a convex body a normal that leans towards the viewer, by curvature times the size of the discs,
//! however long one trains.
//!
//! Within a sheet the order is therefore by offset along the normal, which does not depend on where along the sheet a
//! disc lies. For two discs with centres p_i, p_j and unit normals n_i, n_j that face the viewer, j is in front when
//!
//! ```text
//! (p_j − p_i)·(n_i + n_j) > 0.
//! ```
//!
//! For two points of one smooth surface the left side vanishes to third order in their distance (the chord is
//! perpendicular to the mean of the end normals), so curvature favours neither.

use crate::project::CameraSurfel;
use glam::Vec3;

/// What the order of a surfel depends on, camera space.
#[derive(Clone, Copy, Debug, Default)]
pub struct Placement {
    /// Centre.
    pub p: Vec3,
    /// Unit normal, facing the viewer.
    pub n: Vec3,
    /// Half the range of depth that the disc spans out to [`REACH`] standard deviations.
    pub reach: f32,
}

/// Standard deviations to which a disc counts when it is asked whether two overlap in depth.
pub const REACH: f32 = 2.0;
/// Cosine of the angle between normals up to which two surfels may be one sheet.
pub const MIN_COSINE: f32 = 0.5;
/// A surfel moves at most this many places forward.
pub const MAX_MOVES: usize = 96;

impl Placement {
    /// From camera-space geometry; `facing` is +1 when the surfel's own normal faces the camera and −1 otherwise.
    #[must_use]
    pub fn new(geometry: &CameraSurfel, facing: f32) -> Self {
        let f = &geometry.frame;
        let reach = (geometry.scale[0] * f.x_axis.z).hypot(geometry.scale[1] * f.y_axis.z);
        Self { p: geometry.p, n: f.z_axis * facing, reach: REACH * reach }
    }

    /// Whether `self`, whose centre is not nearer than `other`'s, is in front of it all the same: both span a common
    /// depth, lie within 60° of each other, and the mean of both normals says so.
    #[must_use]
    #[inline]
    pub fn is_before(&self, other: &Self) -> bool {
        let offset = self.p - other.p;
        offset.z < self.reach + other.reach
            && self.n.dot(other.n) > MIN_COSINE
            && offset.dot(self.n + other.n) > 0.0
    }
}

/// Orders one tile's list, which comes sorted by centre depth: each surfel moves forward past those in front of which it
/// is ([`Placement::is_before`]), and stops at the first that it is not. `pairs` moves along.
pub fn settle(entries: &mut [u32], pairs: &mut [u32], placements: &[Placement], scratch: &mut Vec<Placement>) {
    scratch.clear();
    scratch.extend(entries.iter().map(|&k| placements[k as usize]));
    for k in 1..entries.len() {
        let mine = scratch[k];
        let lowest = k.saturating_sub(MAX_MOVES);
        let mut to = k;
        while to > lowest && mine.is_before(&scratch[to - 1]) {
            to -= 1;
        }
        if to < k {
            scratch[to..=k].rotate_right(1);
            entries[to..=k].rotate_right(1);
            pairs[to..=k].rotate_right(1);
        }
    }
}
