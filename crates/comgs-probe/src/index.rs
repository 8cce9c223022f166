//! Which probes are near a point.

use crate::MAX_NEIGHBOURS;
use glam::{IVec3, Vec3};

/// Most cells along an axis: three coordinates share a key of 63 bits.
const MAX_CELLS: f32 = 2_000_000.0;
/// A key that no cell has.
const VACANT: u64 = u64::MAX;

/// Probes sorted into the cells of a uniform grid, found through a hash of the cell: fixed-radius nearest neighbours
/// and exact nearest neighbours. Memory is proportional to the probes, whatever the extent.
#[derive(Clone, Debug)]
pub struct ProbeIndex {
    radius: f32,
    /// Side of a cell, at least the radius.
    cell: f32,
    low: Vec3,
    /// Cells along each axis.
    cells: IVec3,
    /// Sorted by cell.
    positions: Vec<Vec3>,
    /// Number of the probe in the set, in the order of `positions`.
    probes: Vec<u32>,
    /// Open addressing, at most half full: key of a cell, first and last + 1 of its probes.
    table: Vec<(u64, u32, u32)>,
}

/// The probes nearest to a point, nearest first; of equally near ones the lower number first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nearest {
    limit: usize,
    pub(crate) count: usize,
    pub(crate) distance_squared: [f32; MAX_NEIGHBOURS],
    pub(crate) probes: [u32; MAX_NEIGHBOURS],
    pub(crate) positions: [Vec3; MAX_NEIGHBOURS],
}

impl Nearest {
    fn new(limit: usize) -> Self {
        Self {
            limit: limit.clamp(1, MAX_NEIGHBOURS),
            count: 0,
            distance_squared: [f32::INFINITY; MAX_NEIGHBOURS],
            probes: [u32::MAX; MAX_NEIGHBOURS],
            positions: [Vec3::ZERO; MAX_NEIGHBOURS],
        }
    }

    /// Farthest that still counts.
    #[inline]
    fn reach(&self) -> f32 {
        self.distance_squared[self.limit - 1]
    }

    #[inline]
    fn offer(&mut self, distance_squared: f32, probe: u32, position: Vec3) {
        let nearer = |at: usize| (distance_squared, probe) < (self.distance_squared[at], self.probes[at]);
        if !nearer(self.limit - 1) {
            return;
        }
        let mut at = self.count.min(self.limit - 1);
        self.count = (self.count + 1).min(self.limit);
        while at > 0 && (distance_squared, probe) < (self.distance_squared[at - 1], self.probes[at - 1]) {
            self.distance_squared[at] = self.distance_squared[at - 1];
            self.probes[at] = self.probes[at - 1];
            self.positions[at] = self.positions[at - 1];
            at -= 1;
        }
        self.distance_squared[at] = distance_squared;
        self.probes[at] = probe;
        self.positions[at] = position;
    }
}

fn key(cell: IVec3) -> u64 {
    (cell.x as u64) | (cell.y as u64) << 21 | (cell.z as u64) << 42
}

fn slot(key: u64, table: usize) -> usize {
    // Fibonacci hashing; the table's length is a power of two.
    (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & (table - 1)
}

impl ProbeIndex {
    /// Sorts probes for lookups within `radius` (world units). Positions that are not finite are never found.
    ///
    /// # Panics
    /// When the radius is not above 0 and finite, or there are more than `u32::MAX` positions.
    #[must_use]
    pub fn new(positions: &[Vec3], radius: f32) -> Self {
        assert!(
            radius > 0.0 && radius.is_finite(),
            "the radius is {radius}, expected a finite length above 0"
        );
        assert!(
            u32::try_from(positions.len()).is_ok(),
            "{} probes are more than 32 bits address",
            positions.len()
        );
        let finite: Vec<u32> =
            (0..positions.len() as u32).filter(|&i| positions[i as usize].is_finite()).collect();
        let (low, high) = finite.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &i| {
            (low.min(positions[i as usize]), high.max(positions[i as usize]))
        });
        // Halves, because the extent of finite numbers may be infinite.
        let extent = if finite.is_empty() { 0.0 } else { (0.5 * high - 0.5 * low).max_element() };
        let cell = radius.max(2.0 * (extent / MAX_CELLS));
        let mut index = Self {
            radius,
            cell,
            low: if finite.is_empty() { Vec3::ZERO } else { low },
            cells: IVec3::ONE,
            positions: Vec::new(),
            probes: Vec::new(),
            table: vec![(VACANT, 0, 0); (2 * finite.len()).next_power_of_two()],
        };
        let mut sorted: Vec<(u64, u32)> = Vec::with_capacity(finite.len());
        for i in finite {
            let cell = index.cell_of(positions[i as usize]);
            index.cells = index.cells.max(cell + 1);
            sorted.push((key(cell), i));
        }
        sorted.sort_unstable();
        index.positions = sorted.iter().map(|&(_, i)| positions[i as usize]).collect();
        index.probes = sorted.iter().map(|&(_, i)| i).collect();
        let mut start = 0;
        while start < sorted.len() {
            let cell = sorted[start].0;
            let end = start + sorted[start..].partition_point(|&(k, _)| k == cell);
            let mut at = slot(cell, index.table.len());
            while index.table[at].0 != VACANT {
                at = (at + 1) & (index.table.len() - 1);
            }
            index.table[at] = (cell, start as u32, end as u32);
            start = end;
        }
        index
    }

    /// Radius of [`crate::ProbeIndex::new`], world units.
    #[must_use]
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Probes that can be found.
    #[must_use]
    pub fn len(&self) -> usize {
        self.probes.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.probes.is_empty()
    }

    /// Bytes that the index holds.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.positions[..]) + size_of_val(&self.probes[..]) + size_of_val(&self.table[..])
    }

    /// Cell of a point; what is far outside lies on a cell two beyond the outermost.
    fn cell_of(&self, p: Vec3) -> IVec3 {
        let farthest = 1.01 * MAX_CELLS;
        ((p - self.low) / self.cell).clamp(Vec3::splat(-2.0), Vec3::splat(farthest)).floor().as_ivec3()
    }

    #[inline]
    fn range(&self, cell: IVec3) -> std::ops::Range<usize> {
        let key = key(cell);
        let mut at = slot(key, self.table.len());
        loop {
            let (found, start, end) = self.table[at];
            if found == key {
                return start as usize..end as usize;
            }
            if found == VACANT {
                return 0..0;
            }
            at = (at + 1) & (self.table.len() - 1);
        }
    }

    #[inline]
    fn offer_range(&self, x: Vec3, range: std::ops::Range<usize>, nearest: &mut Nearest) {
        for (position, &probe) in self.positions[range.clone()].iter().zip(&self.probes[range]) {
            let distance_squared = (*position - x).length_squared();
            if distance_squared <= nearest.reach() {
                nearest.offer(distance_squared, probe, *position);
            }
        }
    }

    /// The nearest `limit` probes that are not farther than the radius; none around a point that is not finite.
    pub(crate) fn within_radius(&self, x: Vec3, limit: usize) -> Nearest {
        let mut nearest = Nearest::new(limit);
        if !x.is_finite() || self.is_empty() {
            return nearest;
        }
        nearest.distance_squared = [self.radius * self.radius; MAX_NEIGHBOURS];
        let centre = self.cell_of(x);
        let (first, last) = ((centre - 1).max(IVec3::ZERO), (centre + 1).min(self.cells - 1));
        // The cell of the point first: what it holds shortens the reach.
        self.offer_range(x, self.range_within(centre), &mut nearest);
        for cz in first.z..=last.z {
            for cy in first.y..=last.y {
                for cx in first.x..=last.x {
                    let cell = IVec3::new(cx, cy, cz);
                    if cell != centre && self.distance_squared_to(x, cell) <= nearest.reach() {
                        self.offer_range(x, self.range(cell), &mut nearest);
                    }
                }
            }
        }
        nearest
    }

    fn range_within(&self, cell: IVec3) -> std::ops::Range<usize> {
        let inside = cell.cmpge(IVec3::ZERO).all() && cell.cmplt(self.cells).all();
        if inside { self.range(cell) } else { 0..0 }
    }

    /// A lower bound of the squared distance to what a cell holds, with room for the rounding of its place.
    #[inline]
    fn distance_squared_to(&self, x: Vec3, cell: IVec3) -> f32 {
        let low = self.low + cell.as_vec3() * self.cell;
        let outside = (low - x).max(x - (low + self.cell)).max(Vec3::ZERO);
        let slack = 1e-6 * (x.abs() + low.abs()).max_element();
        (outside - slack).max(Vec3::ZERO).length_squared()
    }

    /// The nearest `limit` probes, however far; none around a point that is not finite.
    ///
    /// Searches the cells around the point ring by ring; once a ring has more cells than there are probes, all probes
    /// are looked at instead.
    pub(crate) fn nearest(&self, x: Vec3, limit: usize) -> Nearest {
        let mut nearest = Nearest::new(limit);
        if !x.is_finite() || self.is_empty() {
            return nearest;
        }
        let centre = self.cell_of(x);
        for ring in 0i32.. {
            // The next ring begins at least `ring` cells away; a thousandth of a cell is for rounding.
            let searched = (ring as f32 - 1.001).max(0.0) * self.cell;
            if nearest.count == nearest.limit && nearest.reach() < searched * searched {
                return nearest;
            }
            let side = 2 * ring as usize + 1;
            if side * side * side > self.len().max(27) {
                break;
            }
            let (first, last) = ((centre - ring).max(IVec3::ZERO), (centre + ring).min(self.cells - 1));
            for cz in first.z..=last.z {
                for cy in first.y..=last.y {
                    for cx in first.x..=last.x {
                        let cell = IVec3::new(cx, cy, cz);
                        if (cell - centre).abs().max_element() == ring {
                            self.offer_range(x, self.range(cell), &mut nearest);
                        }
                    }
                }
            }
        }
        let mut nearest = Nearest::new(limit);
        self.offer_range(x, 0..self.len(), &mut nearest);
        nearest
    }
}
