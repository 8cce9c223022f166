//! Cells in a hash table, from the largest down.

use glam::Vec3;

/// Finest level.
pub(super) const MAX_LEVEL: u32 = 14;
/// Cells along an axis on either side of the origin at the finest level.
const REACH: i64 = 1 << 17;
/// No cell.
const NONE: u32 = u32::MAX;
/// A cell that has been cut.
pub(super) const CUT: u32 = u32::MAX - 1;

/// Class of a normal, 0 to 5: its largest component and that one's sign.
pub(super) fn class_of(normal: Vec3) -> u32 {
    let a = normal.abs();
    let axis = if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    };
    2 * axis + u32::from(normal[axis as usize] < 0.0)
}

/// A cell's four corners over the two axes that its class is flat in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    /// Lower corner along the two axes.
    low: [f32; 2],
    inverse_size: f32,
    axes: [u8; 2],
    /// (0, 0), (1, 0), (0, 1), (1, 1), numbers of ratios.
    pub corners: [u32; 4],
}

impl Cell {
    pub(super) fn new(key: Key, lattice: &Lattice, corners: [u32; 4]) -> Self {
        let axes = key.flat_axes();
        let low = lattice.low(key);
        let size = lattice.size(key.level);
        Self { low: axes.map(|a| low[a]), inverse_size: 1.0 / size, axes: axes.map(|a| a as u8), corners }
    }

    /// Bilinear ratio at a point of the cell.
    #[inline]
    pub(super) fn interpolate(&self, point: Vec3, ratios: &[Vec3]) -> Vec3 {
        let at =
            |k: usize| ((point[usize::from(self.axes[k])] - self.low[k]) * self.inverse_size).clamp(0.0, 1.0);
        let (x, y) = (at(0), at(1));
        let [a, b, c, d] = self.corners.map(|i| ratios[i as usize]);
        a.lerp(b, x).lerp(c.lerp(d, x), y)
    }
}

/// A cell by its level, class and place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub level: u32,
    pub class: u32,
    pub at: [i32; 3],
}

impl Key {
    /// The axis its class is steep in.
    pub(super) fn steep_axis(self) -> usize {
        self.class as usize / 2
    }

    /// The two others.
    pub(super) fn flat_axes(self) -> [usize; 2] {
        match self.steep_axis() {
            0 => [1, 2],
            1 => [0, 2],
            _ => [0, 1],
        }
    }

    fn packed(self) -> u64 {
        let part = |v: i32| (i64::from(v) + REACH) as u64;
        let [x, y, z] = self.at.map(part);
        (u64::from(self.level) << 57) | (u64::from(self.class) << 54) | (x << 36) | (y << 18) | z
    }
}

/// Where cells lie.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Lattice {
    pub origin: Vec3,
    /// Side of cells of level 0.
    pub largest: f32,
}

impl Lattice {
    pub(super) fn size(&self, level: u32) -> f32 {
        self.largest / (1u32 << level) as f32
    }

    /// The cell of a point; `None` when it is too far away for the table.
    pub(super) fn key(&self, level: u32, class: u32, point: Vec3) -> Option<Key> {
        let p = (point - self.origin) / self.size(level);
        let inside = p.abs().max_element() < (REACH - 1) as f32;
        inside.then(|| Key { level, class, at: p.to_array().map(|v| v.floor() as i32) })
    }

    pub(super) fn low(&self, key: Key) -> Vec3 {
        self.origin + Vec3::from_array(key.at.map(|v| v as f32)) * self.size(key.level)
    }
}

/// Open addressing: sound because nothing is ever taken out.
#[derive(Clone, Debug, Default)]
struct Table {
    keys: Vec<u64>,
    values: Vec<u32>,
    held: usize,
}

impl Table {
    fn slot(keys: &[u64], key: u64) -> usize {
        // Keys are stored plus one, so that 0 is an empty slot.
        let mask = keys.len() - 1;
        let mut i = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & mask;
        while keys[i] != 0 && keys[i] != key + 1 {
            i = (i + 1) & mask;
        }
        i
    }

    fn get(&self, key: u64) -> u32 {
        if self.keys.is_empty() {
            return NONE;
        }
        let i = Self::slot(&self.keys, key);
        if self.keys[i] == 0 { NONE } else { self.values[i] }
    }

    fn set(&mut self, key: u64, value: u32) {
        if 2 * (self.held + 1) > self.keys.len() {
            let size = (2 * self.keys.len()).max(1024);
            let (mut keys, mut values) = (vec![0; size], vec![NONE; size]);
            for (k, v) in self.keys.iter().zip(&self.values).filter(|(k, _)| **k != 0) {
                let i = Self::slot(&keys, k - 1);
                (keys[i], values[i]) = (*k, *v);
            }
            (self.keys, self.values) = (keys, values);
        }
        let i = Self::slot(&self.keys, key);
        self.held += usize::from(self.keys[i] == 0);
        (self.keys[i], self.values[i]) = (key + 1, value);
    }
}

/// The last cell of a row of pixels: neighbours mostly share it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Found {
    key: Key,
    cell: u32,
    some: bool,
}

/// All cells.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    pub lattice: Lattice,
    table: Table,
    list: Vec<Cell>,
}

impl Cells {
    pub(super) fn new(lattice: Lattice) -> Self {
        Self { lattice, ..Self::default() }
    }

    pub(super) fn len(&self) -> usize {
        self.list.len()
    }

    pub(super) fn cut(&mut self, key: Key) {
        self.table.set(key.packed(), CUT);
    }

    pub(super) fn insert(&mut self, key: Key, corners: [u32; 4]) {
        self.table.set(key.packed(), self.list.len() as u32);
        self.list.push(Cell::new(key, &self.lattice, corners));
    }

    /// The cell that covers a point of a surface with this normal.
    #[inline]
    pub(super) fn find(&self, point: Vec3, normal: Vec3, last: &mut Found) -> Option<&Cell> {
        let class = class_of(normal);
        if last.some
            && last.key.class == class
            && self.lattice.key(last.key.level, class, point) == Some(last.key)
        {
            return Some(&self.list[last.cell as usize]);
        }
        for level in 0..=MAX_LEVEL {
            let key = self.lattice.key(level, class, point)?;
            match self.table.get(key.packed()) {
                NONE => return None,
                CUT => {}
                cell => {
                    *last = Found { key, cell, some: true };
                    return Some(&self.list[cell as usize]);
                }
            }
        }
        None
    }

    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.list[..]) + size_of_val(&self.table.keys[..]) + size_of_val(&self.table.values[..])
    }

    pub(super) fn sizes(&self) -> (f32, f32) {
        let sizes = self.list.iter().map(|c| 1.0 / c.inverse_size);
        let (mut sum, mut least) = (0.0, f32::INFINITY);
        for s in sizes {
            sum += s;
            least = least.min(s);
        }
        (sum / self.list.len().max(1) as f32, if least.is_finite() { least } else { 0.0 })
    }
}
