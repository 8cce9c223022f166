//! Cumulative tables of discrete distributions.

/// Several distributions over the same number of items, each as cumulative shares from 0 to 1 in f64: in f32 the dark
/// texels of a map with a sun have shares below what a sum resolves.
#[derive(Clone, Debug)]
pub(crate) struct Cumulative {
    items: usize,
    /// `items + 1` values a table.
    shares: Vec<f64>,
    /// For `k` from 0 to `items`, the first value of the table above `k/items`, `items + 1` a table: where the search
    /// for a number between `k/items` and the next begins and ends.
    guide: Vec<u32>,
}

impl Cumulative {
    /// Tables from the items' masses, `items` a table; a table of zeros becomes uniform. Also the total of every table.
    pub(crate) fn new(masses: &[f64], items: usize) -> (Self, Vec<f64>) {
        let mut out = Self { items, shares: Vec::new(), guide: Vec::new() };
        let mut totals = Vec::new();
        for table in masses.chunks_exact(items) {
            let start = out.shares.len();
            let mut sum = 0.0;
            out.shares.push(0.0);
            for mass in table {
                sum += mass;
                out.shares.push(sum);
            }
            let shares = &mut out.shares[start..];
            for (i, share) in shares.iter_mut().enumerate() {
                *share = if sum > 0.0 { *share / sum } else { i as f64 / items as f64 };
            }
            shares[items] = 1.0;
            let mut first = 0;
            for k in 0..=items {
                while first < items && shares[first] <= k as f64 / items as f64 {
                    first += 1;
                }
                out.guide.push(first as u32);
            }
            totals.push(sum);
        }
        (out, totals)
    }

    /// Share of an item in its table.
    #[inline]
    pub(crate) fn share(&self, table: usize, item: usize) -> f64 {
        let at = table * (self.items + 1) + item;
        self.shares[at + 1] - self.shares[at]
    }

    /// Item that `u` in [0, 1) falls to, never one without mass, and where in it, in [0, 1].
    #[inline]
    pub(crate) fn invert(&self, table: usize, u: f32) -> (usize, f64) {
        let start = table * (self.items + 1);
        let shares = &self.shares[start..start + self.items + 1];
        let u = f64::from(u);
        let k = ((u * self.items as f64) as usize).min(self.items - 1);
        let (low, high) = (self.guide[start + k] as usize, self.guide[start + k + 1] as usize);
        let above = low + shares[low..high].partition_point(|&c| c <= u);
        let i = above.clamp(1, self.items) - 1;
        let width = shares[i + 1] - shares[i];
        (i, if width > 0.0 { ((u - shares[i]) / width).clamp(0.0, 1.0) } else { 0.5 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the guided search finds the item that a search over the whole table finds, also where one item takes
    /// nearly all and others nothing, and for numbers at the ends.
    #[test]
    fn the_guide_leads_to_the_item() {
        let mut rng = comgs_geom::Rng::new(1);
        for items in [1usize, 2, 5, 64] {
            let mut masses: Vec<f64> =
                (0..3 * items).map(|i| if i % 3 == 0 { 0.0 } else { f64::from(rng.uniform()) }).collect();
            masses[items + items / 2] = 1e7;
            masses[2 * items..].fill(0.0);
            let (tables, totals) = Cumulative::new(&masses, items);
            assert_eq!(totals.len(), 3);
            assert_eq!(totals[2], 0.0);
            for table in 0..3 {
                let shares = &tables.shares[table * (items + 1)..(table + 1) * (items + 1)];
                for i in 0..3000 {
                    let u =
                        [0.0, 0.5, 1.0 - f32::EPSILON / 2.0].get(i).copied().unwrap_or_else(|| rng.uniform());
                    let (item, inside) = tables.invert(table, u);
                    let u = f64::from(u);
                    assert!(shares[item] <= u && u < shares[item + 1] && (0.0..=1.0).contains(&inside));
                    assert!((shares[item] + inside * (shares[item + 1] - shares[item]) - u).abs() < 1e-12);
                }
            }
        }
    }
}
