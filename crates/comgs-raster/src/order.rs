//! The order of blending within a tile.

use crate::bounds::TILE;
use crate::project::{CameraSurfel, Projected};

/// Standard deviations to which a disc's plane is followed from its centre.
pub const REACH: f32 = 2.0;

/// Half the range of z-depth that the disc spans out to [`REACH`] standard deviations, world units.
#[must_use]
pub fn reach(geometry: &CameraSurfel) -> f32 {
    let f = &geometry.frame;
    REACH * (geometry.scale[0] * f.x_axis.z).hypot(geometry.scale[1] * f.y_axis.z)
}

/// Depth by which a surfel is sorted in the tile with its upper left corner at pixel `origin`: that of its plane on the
/// ray through the tile's middle, no farther from the centre's than the disc reaches.
#[must_use]
#[inline]
pub fn tile_depth(p: &Projected, origin: [usize; 2]) -> f32 {
    let dx = (origin[0] + TILE / 2) as f32 - p.reference[0];
    let dy = (origin[1] + TILE / 2) as f32 - p.reference[1];
    let z = p.plane / p.form_w[0].mul_add(dx, p.form_w[1].mul_add(dy, p.form_w[2]));
    // Beyond the plane's horizon z is negative, on it NaN or infinite: min and max then leave the clamp's ends.
    z.max(p.depth - p.reach).min(p.depth + p.reach)
}

/// Sorts one tile's list by [`tile_depth`], equal depths in the order they came in; `pairs` moves along.
pub fn sort_tile(
    entries: &mut [u32],
    pairs: &mut [u32],
    projected: &[Projected],
    origin: [usize; 2],
    scratch: &mut Vec<(u64, u32, u32)>,
) {
    scratch.clear();
    scratch.extend(entries.iter().zip(pairs.iter()).enumerate().map(|(i, (&k, &pair))| {
        let bits = crate::bin::sortable_bits(tile_depth(&projected[k as usize], origin));
        (u64::from(bits) << 32 | i as u64, k, pair)
    }));
    scratch.sort_unstable_by_key(|s| s.0);
    for ((entry, pair), s) in entries.iter_mut().zip(pairs.iter_mut()).zip(scratch.iter()) {
        (*entry, *pair) = (s.1, s.2);
    }
}
