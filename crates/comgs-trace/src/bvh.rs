//! The tree: `obvhs` builds a binary one, which is collapsed to nodes of eight children and leaves of eight discs.
//!
//! Measured on 2 cores (AVX2), occlusion rays among 50,000 and 500,000 surfels: see `examples/rays_per_second.rs`,
//! which traverses all three trees.

use crate::{collapse::collapse, disc::Disc};
use comgs_geom::Rng;
use glam::Vec3;
use obvhs::{
    aabb::Aabb,
    bvh2::{Bvh2, reinsertion::ReinsertionOptimizer},
    ploc::{PlocBuilder, PlocSearchDistance, SortPrecision},
};

/// Children a node and discs a leaf.
pub(crate) const WIDTH: usize = 8;
/// Set in a child reference that is a leaf; the other bits are the index of its block.
pub(crate) const LEAF: u32 = 1 << 31;

/// Eight boxes and what is inside them. Absent children have an inside-out box that no ray enters.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub(crate) struct Node {
    /// `[min x, min y, min z, max x, max y, max z][child]`.
    pub bounds: [[f32; WIDTH]; 6],
    /// Index of a node, or of a block with [`LEAF`] set.
    pub children: [u32; WIDTH],
    /// One bit for each child that is a leaf.
    pub leaves: u64,
}

/// Eight discs, one a lane. Absent discs have a log opacity of −∞, so that no ray meets them.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub(crate) struct Block {
    pub centre: [[f32; WIDTH]; 3],
    pub normal: [[f32; WIDTH]; 3],
    pub tangent_u: [[f32; WIDTH]; 3],
    pub tangent_v: [[f32; WIDTH]; 3],
    pub log_opacity: [f32; WIDTH],
}

impl Node {
    pub const EMPTY: Self = {
        let (high, low) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        Self { bounds: [high, high, high, low, low, low], children: [0; WIDTH], leaves: 0 }
    };
}

impl Block {
    pub const EMPTY: Self = Self {
        centre: [[0.0; WIDTH]; 3],
        normal: [[0.0; WIDTH]; 3],
        tangent_u: [[0.0; WIDTH]; 3],
        tangent_v: [[0.0; WIDTH]; 3],
        log_opacity: [f32::NEG_INFINITY; WIDTH],
    };

    pub fn set(&mut self, lane: usize, disc: &Disc) {
        for axis in 0..3 {
            self.centre[axis][lane] = disc.centre[axis];
            self.normal[axis][lane] = disc.normal[axis];
            self.tangent_u[axis][lane] = disc.tangent_u[axis];
            self.tangent_v[axis][lane] = disc.tangent_v[axis];
        }
        self.log_opacity[lane] = disc.log_opacity;
    }
}

/// The tree over the discs of a cloud.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bvh {
    /// Node 0 is the root; empty when there are no discs.
    pub nodes: Vec<Node>,
    pub blocks: Vec<Block>,
    /// Surfel of every lane of every block (`block · WIDTH + lane`), `u32::MAX` where the lane is absent.
    pub surfels: Vec<u32>,
}

impl Bvh {
    pub fn new(discs: &[Disc]) -> Self {
        if discs.is_empty() {
            return Self::default();
        }
        let boxes: Vec<Aabb> = discs.iter().map(uneven_box).collect();
        let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
            PlocSearchDistance::Medium,
            &boxes,
            (0..boxes.len() as u32).collect(),
            SortPrecision::U64,
            3,
        );
        let ratio = REINSERTION_RATIO.min(REINSERTION_WORK / (boxes.len() as f32 * overlap(&binary)));
        ReinsertionOptimizer::default().run(&mut binary, ratio, None);
        collapse(&binary, discs)
    }
}

/// Share of the binary tree's nodes that reinsertion tries to move.
const REINSERTION_RATIO: f32 = 0.05;
/// Most nodes that reinsertion may look at in all (about 2 s). Where boxes overlap without end, the search for a
/// better place cannot prune, and without this bound a hundred thousand identical surfels take ten minutes.
const REINSERTION_WORK: f32 = 2e8;

/// The box of a disc, each face moved out by its own small part of the padding.
///
/// PLOC joins two nodes when each is the other's best partner. Equal boxes, or boxes on a regular grid, have equal
/// costs everywhere, one pair is joined in each pass over all of them, and the build is quadratic; uneven
/// boxes have no ties.
fn uneven_box(disc: &Disc) -> Aabb {
    let mut rng = Rng::stream(0, u64::from(disc.surfel));
    let mut outwards = || {
        let part = Vec3::new(rng.uniform(), rng.uniform(), rng.uniform());
        disc.half_extent * (1.0 + UNEVENNESS * part)
    };
    Aabb::new((disc.centre - outwards()).into(), (disc.centre + outwards()).into())
}

/// Largest relative growth of a box by [`uneven_box`]; well above rounding, well below anything a ray notices.
const UNEVENNESS: f32 = 2e-3;

/// How many nodes of the tree a random line through the root's box enters (the sum of their areas over its own).
fn overlap(binary: &Bvh2) -> f32 {
    let root = binary.nodes[0].aabb().half_area();
    let sum: f64 = binary.nodes.iter().map(|n| f64::from(n.aabb().half_area() / root)).sum();
    if sum.is_finite() { sum as f32 } else { f32::MAX }
}
