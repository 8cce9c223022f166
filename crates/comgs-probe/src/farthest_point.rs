//! Farthest point sampling: an even subset of a point cloud.

use glam::{DVec3, Vec3};

/// Most points of a leaf of the tree. Measured on 10⁶ points of a sphere, n = 5000: 16, 32, 64, 128 and 256 points take
/// 0.40, 0.38, 0.37, 0.36 and 0.35 s; with n = 100,000 128 is the best.
const LEAF: usize = 128;

/// Largest coordinate of a point: squares of differences stay finite.
const FARTHEST: f32 = 1e18;

/// A subset chosen by [`farthest_points`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FarthestPoints {
    /// Indices into the cloud, in the order in which they were chosen: the first m of them are the choice of m points.
    pub indices: Vec<u32>,
    /// Largest distance from a point of the cloud to the nearest chosen one; 0 when all were chosen. No two chosen
    /// points are closer together than this.
    pub covering_radius: f32,
}

/// Chooses `n` points, each the farthest from those chosen before (Eldar et al. 1997, "The farthest point strategy
/// for progressive image sampling"); the first is the farthest from the mean. Of equally far points the one with the
/// lowest index is taken, so the choice has no freedom. Exactly the greedy choice, not an approximation: distances
/// are those of f32 arithmetic.
///
/// Fewer than `n` are chosen where there are no more distinct points: a point that coincides with a chosen one never
/// is. Points with a coordinate that is not finite or beyond 1e18 are passed over. No points, or `n = 0`, give none.
///
/// The plain algorithm visits all N points for each choice. Here they are sorted into a balanced kd-tree whose nodes
/// know their box and their farthest point: a choice descends only where it is nearer than that, and the next one is
/// read from the root. On a surface that visits about N log n instead of N n points. `examples/probe_cost.rs` prints
/// the time.
///
/// # Panics
/// When there are more than `u32::MAX` points.
#[must_use]
pub fn farthest_points(points: &[Vec3], n: usize) -> FarthestPoints {
    assert!(u32::try_from(points.len()).is_ok(), "{} points are more than 32 bits address", points.len());
    // NaN fails the comparison.
    let usable = |p: Vec3| p.abs().cmple(Vec3::splat(FARTHEST)).all();
    let finite: Vec<u32> = (0..points.len() as u32).filter(|&i| usable(points[i as usize])).collect();
    if finite.is_empty() || n == 0 {
        return FarthestPoints::default();
    }
    let sum: DVec3 = finite.iter().map(|&i| points[i as usize].as_dvec3()).sum();
    let mean = (sum / finite.len() as f64).as_vec3();
    let mut tree = Tree::new(points, finite);
    let mut chosen = FarthestPoints { indices: vec![tree.farthest_from(mean)], covering_radius: 0.0 };
    loop {
        tree.choose(points[*chosen.indices.last().expect("one was chosen") as usize]);
        let (distance_squared, next) = tree.farthest[1];
        // 0 is a duplicate, or nearer than f32 can tell.
        if chosen.indices.len() >= n || !(distance_squared > 0.0) {
            chosen.covering_radius = distance_squared.sqrt();
            return chosen;
        }
        chosen.indices.push(next);
    }
}

/// A complete binary tree: node 1 is the root, node k has the children 2k and 2k + 1, the last `leaves` nodes are the
/// leaves. Points lie leaf by leaf, within a leaf by index.
struct Tree {
    leaves: usize,
    /// `leaves + 1` offsets into the points.
    starts: Vec<usize>,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Squared distance to the nearest chosen point.
    distance_squared: Vec<f32>,
    index: Vec<u32>,
    /// Box of each node.
    low: Vec<Vec3>,
    high: Vec<Vec3>,
    /// Largest `distance_squared` of each node and the lowest index that has it.
    farthest: Vec<(f32, u32)>,
}

impl Tree {
    fn new(points: &[Vec3], mut order: Vec<u32>) -> Self {
        let leaves = order.len().div_ceil(LEAF).next_power_of_two();
        let mut starts = vec![0; leaves + 1];
        starts[leaves] = order.len();
        sort_into_leaves(points, &mut order, 0, &mut starts[..leaves]);
        let coordinate = |c: usize| order.iter().map(|&i| points[i as usize][c]).collect();
        let mut tree = Self {
            leaves,
            x: coordinate(0),
            y: coordinate(1),
            z: coordinate(2),
            distance_squared: vec![f32::INFINITY; order.len()],
            low: vec![Vec3::INFINITY; 2 * leaves],
            high: vec![Vec3::NEG_INFINITY; 2 * leaves],
            // A node without points is never the farthest.
            farthest: vec![(f32::NEG_INFINITY, u32::MAX); 2 * leaves],
            index: order,
            starts,
        };
        for leaf in 0..leaves {
            for i in tree.starts[leaf]..tree.starts[leaf + 1] {
                let p = Vec3::new(tree.x[i], tree.y[i], tree.z[i]);
                tree.low[leaves + leaf] = tree.low[leaves + leaf].min(p);
                tree.high[leaves + leaf] = tree.high[leaves + leaf].max(p);
                tree.farthest[leaves + leaf].0 = f32::INFINITY;
            }
        }
        for node in (1..leaves).rev() {
            tree.low[node] = tree.low[2 * node].min(tree.low[2 * node + 1]);
            tree.high[node] = tree.high[2 * node].max(tree.high[2 * node + 1]);
            tree.farthest[node] = farther(tree.farthest[2 * node], tree.farthest[2 * node + 1]);
        }
        tree
    }

    fn farthest_from(&self, p: Vec3) -> u32 {
        let distance = |i: usize| squared(self.x[i] - p.x, self.y[i] - p.y, self.z[i] - p.z);
        let best = (0..self.index.len()).map(|i| (distance(i), self.index[i])).reduce(farther);
        best.expect("the tree has points").1
    }

    /// Takes a chosen point into account.
    fn choose(&mut self, p: Vec3) {
        self.visit(1, p);
    }

    fn visit(&mut self, node: usize, p: Vec3) {
        // Subtraction, squares and sums are monotonic under rounding, so no distance in the box is below this one.
        let outside = (self.low[node] - p).max(p - self.high[node]).max(Vec3::ZERO);
        if squared(outside.x, outside.y, outside.z) >= self.farthest[node].0 {
            return;
        }
        if node >= self.leaves {
            self.farthest[node] = self.visit_leaf(node - self.leaves, p);
        } else {
            self.visit(2 * node, p);
            self.visit(2 * node + 1, p);
            self.farthest[node] = farther(self.farthest[2 * node], self.farthest[2 * node + 1]);
        }
    }

    fn visit_leaf(&mut self, leaf: usize, p: Vec3) -> (f32, u32) {
        let range = self.starts[leaf]..self.starts[leaf + 1];
        let (x, y, z) = (&self.x[range.clone()], &self.y[range.clone()], &self.z[range.clone()]);
        let distances = &mut self.distance_squared[range.clone()];
        for i in 0..distances.len() {
            let d = squared(x[i] - p.x, y[i] - p.y, z[i] - p.z);
            distances[i] = if d < distances[i] { d } else { distances[i] };
        }
        let mut best = (f32::NEG_INFINITY, u32::MAX);
        for (&d, &i) in distances.iter().zip(&self.index[range]) {
            // Indices rise, so the first of equals stays.
            if d > best.0 {
                best = (d, i);
            }
        }
        best
    }
}

fn squared(x: f32, y: f32, z: f32) -> f32 {
    x * x + y * y + z * z
}

fn farther(a: (f32, u32), b: (f32, u32)) -> (f32, u32) {
    if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
}

/// Splits `order` at the median of its longest axis until there is one part for each of `starts`, which receive where
/// the parts begin.
fn sort_into_leaves(points: &[Vec3], order: &mut [u32], offset: usize, starts: &mut [usize]) {
    if starts.len() == 1 {
        starts[0] = offset;
        order.sort_unstable();
        return;
    }
    let (low, high) = order.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &i| {
        (low.min(points[i as usize]), high.max(points[i as usize]))
    });
    let axis = (high - low).max_position();
    let middle = order.len() / 2;
    if middle > 0 {
        let key = |i: u32| points[i as usize][axis];
        order.select_nth_unstable_by(middle, |&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
    }
    let (left, right) = order.split_at_mut(middle);
    let (left_starts, right_starts) = starts.split_at_mut(starts.len() / 2);
    rayon::join(
        || sort_into_leaves(points, left, offset, left_starts),
        || sort_into_leaves(points, right, offset + middle, right_starts),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;

    /// The algorithm as it is written in books, with the same rule for ties.
    fn brute_force(points: &[Vec3], n: usize) -> Vec<u32> {
        let mean = (points.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / points.len() as f64).as_vec3();
        let mut distance: Vec<f32> = points.iter().map(|p| (*p - mean).length_squared()).collect();
        let mut chosen = Vec::new();
        while chosen.len() < n {
            let best = (0..points.len()).fold(0, |b, i| if distance[i] > distance[b] { i } else { b });
            if chosen.is_empty() {
                distance.fill(f32::INFINITY);
            } else if distance[best] <= 0.0 {
                break;
            }
            chosen.push(best as u32);
            for (d, p) in distance.iter_mut().zip(points) {
                let v = *p - points[best];
                *d = d.min(squared(v.x, v.y, v.z));
            }
        }
        chosen
    }

    fn clouds() -> Vec<Vec<Vec3>> {
        let mut rng = Rng::new(4);
        let mut ball: Vec<Vec3> =
            (0..3000).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
        let sphere: Vec<Vec3> = ball.iter().map(|p| p.normalize()).collect();
        // Many equal distances: a regular grid, every point twice.
        let grid: Vec<Vec3> = (0..1000)
            .map(|i| Vec3::new((i % 10) as f32, (i / 10 % 10) as f32, (i / 100 % 5) as f32))
            .collect();
        ball[7] = Vec3::new(1e4, 0.0, -3.0);
        vec![ball, sphere, grid, vec![Vec3::ONE; 300], vec![Vec3::X, Vec3::Y], vec![Vec3::NEG_Z]]
    }

    /// Goal: the tree's choice is the textbook's, point by point, with ties, duplicates, an outlier and n ≥ N.
    #[test]
    fn same_choice_as_brute_force() {
        for (k, cloud) in clouds().iter().enumerate() {
            for n in [1, 2, 200, 2000] {
                let got = farthest_points(cloud, n);
                assert_eq!(got.indices, brute_force(cloud, n), "cloud {k}, {n} points");
            }
        }
    }

    /// Goal: the covering radius is what it says: no point is farther from the choice, no two chosen are nearer to
    /// each other.
    #[test]
    fn covering_radius_covers_and_separates() {
        let cloud = &clouds()[1];
        let got = farthest_points(cloud, 150);
        let chosen: Vec<Vec3> = got.indices.iter().map(|&i| cloud[i as usize]).collect();
        let nearest = |p: Vec3| chosen.iter().map(|c| c.distance(p)).fold(f32::INFINITY, f32::min);
        let covering = cloud.iter().map(|&p| nearest(p)).fold(0.0, f32::max);
        assert!((covering - got.covering_radius).abs() < 1e-6, "{covering} {}", got.covering_radius);
        for (i, a) in chosen.iter().enumerate() {
            assert!(chosen[..i].iter().all(|b| b.distance(*a) >= got.covering_radius));
        }
        // A disc of the covering radius around each must tile the sphere, and discs of half of it fit on it.
        let (r, n) = (got.covering_radius, chosen.len() as f32);
        assert!(n * r * r > 4.0 && n * r * r / 4.0 < 4.0, "{r}");
    }

    /// Goal: nothing, n = 0, only duplicates and values that are not finite are survived.
    #[test]
    fn degenerate_clouds() {
        assert!(farthest_points(&[], 5).indices.is_empty());
        assert!(farthest_points(&[Vec3::X], 0).indices.is_empty());
        assert_eq!(farthest_points(&[Vec3::ONE; 300], 5).indices, [0]);
        let got = farthest_points(&[Vec3::NAN, Vec3::X, Vec3::INFINITY, Vec3::Y, Vec3::splat(-1e30)], 9);
        assert_eq!((got.indices, got.covering_radius), (vec![1, 3], 0.0));
    }
}
