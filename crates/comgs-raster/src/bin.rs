//! Depth-sorted lists of surfels for every tile.

use crate::project::Projected;

/// Tile lists: tile `t` blends `entries[offsets[t]..offsets[t + 1]]` in that order.
#[derive(Debug, Default)]
pub struct Bins {
    /// Start of each tile's list; one more entry than tiles.
    pub offsets: Vec<u32>,
    /// Indices into the projected surfels, nearest first; equal depths in the order of the cloud.
    pub entries: Vec<u32>,
    /// For every (surfel, tile) pair in the order of emission the position in `entries`: a surfel's gradient is
    /// the sum over its pairs in this fixed order.
    pub position_of_pair: Vec<u32>,
    order: Vec<u32>,
    scratch: Vec<u32>,
    keys: Vec<u32>,
    cursor: Vec<u32>,
}

impl Bins {
    /// Builds the lists. Surfel `k` touches `tiles[first_pair[k]..first_pair[k + 1]]`.
    pub fn build(&mut self, projected: &[Projected], first_pair: &[u32], tiles: &[u32], tile_count: usize) {
        self.sort_by_depth(projected);
        self.offsets.clear();
        self.offsets.resize(tile_count + 1, 0);
        for &t in tiles {
            self.offsets[t as usize + 1] += 1;
        }
        for t in 0..tile_count {
            self.offsets[t + 1] += self.offsets[t];
        }
        self.cursor.clear();
        self.cursor.extend_from_slice(&self.offsets[..tile_count]);
        self.entries.clear();
        self.entries.resize(tiles.len(), 0);
        self.position_of_pair.clear();
        self.position_of_pair.resize(tiles.len(), 0);
        // Scattering surfels in depth order leaves every tile's list sorted: no sort a tile.
        for &k in &self.order {
            for pair in first_pair[k as usize]..first_pair[k as usize + 1] {
                let cursor = &mut self.cursor[tiles[pair as usize] as usize];
                self.entries[*cursor as usize] = k;
                self.position_of_pair[pair as usize] = *cursor;
                *cursor += 1;
            }
        }
    }

    /// Stable radix sort of the indices by centre depth.
    fn sort_by_depth(&mut self, projected: &[Projected]) {
        const BITS: u32 = 11;
        let n = projected.len();
        self.keys.clear();
        self.keys.extend(projected.iter().map(|p| sortable_bits(p.depth)));
        self.order.clear();
        self.order.extend(0..n as u32);
        self.scratch.clear();
        self.scratch.resize(n, 0);
        for pass in 0..3 {
            let shift = pass * BITS;
            let mut counts = [0u32; 1 << BITS];
            for &i in &self.order {
                counts[(self.keys[i as usize] >> shift) as usize & ((1 << BITS) - 1)] += 1;
            }
            let mut sum = 0;
            for c in &mut counts {
                let here = *c;
                *c = sum;
                sum += here;
            }
            for &i in &self.order {
                let slot = &mut counts[(self.keys[i as usize] >> shift) as usize & ((1 << BITS) - 1)];
                self.scratch[*slot as usize] = i;
                *slot += 1;
            }
            std::mem::swap(&mut self.order, &mut self.scratch);
        }
    }
}

/// Bits that sort as the float does, negatives included.
fn sortable_bits(x: f32) -> u32 {
    let bits = x.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 0x8000_0000 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: lists are sorted by depth, ties keep the cloud's order, and pairs point where they stand.
    #[test]
    fn lists_are_sorted_and_stable() {
        let depths = [3.0f32, -1.0, 3.0, 0.5, 1e10, 3.0, -0.0];
        let projected: Vec<_> =
            depths.iter().map(|&depth| Projected { depth, ..Default::default() }).collect();
        let first_pair: Vec<u32> = (0..=7).map(|i| i * 2).collect();
        let tiles: Vec<u32> = (0..14).map(|i| i % 2).collect();
        let mut bins = Bins::default();
        bins.build(&projected, &first_pair, &tiles, 2);
        for t in 0..2 {
            let list = &bins.entries[bins.offsets[t] as usize..bins.offsets[t + 1] as usize];
            assert_eq!(list, &[1, 6, 3, 0, 2, 5, 4]);
        }
        for pair in 0..14u32 {
            assert_eq!(bins.entries[bins.position_of_pair[pair as usize] as usize], pair / 2);
        }
    }
}
