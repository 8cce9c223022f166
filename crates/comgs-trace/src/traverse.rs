//! The two walks through the tree: any order for transmittance, near to far for sorted hits.

use crate::{
    bvh::{Bvh, LEAF, WIDTH},
    kernel::{Limits, RayLanes, SLACK},
    tracer::Ray,
};
use fearless_simd::{Simd, f32x8, prelude::*};

/// A hit on its way to being sorted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RawHit {
    /// Bits of the distance (never negative, so their order is the order of the distances), then the surfel:
    /// equal distances are ordered by surfel.
    key: u64,
    pub alpha: f32,
    /// `block · WIDTH + lane`.
    pub slot: u32,
}

impl RawHit {
    fn new(t: f32, surfel: u32, alpha: f32, slot: u32) -> Self {
        // −0 + 0 = +0, whose bits sort first.
        Self { key: u64::from((t + 0.0).to_bits()) << 32 | u64::from(surfel), alpha, slot }
    }

    pub fn t(&self) -> f32 {
        f32::from_bits((self.key >> 32) as u32)
    }

    pub fn surfel(&self) -> u32 {
        self.key as u32
    }
}

/// Memory that a thread uses again for every ray.
#[derive(Default)]
pub(crate) struct Scratch {
    nodes: Vec<u32>,
    ordered: Vec<(f32, u32)>,
    pub hits: Vec<RawHit>,
}

/// Product of `1 − α` over all hits in `[t_min, t_max)`; exactly 0 as soon as it is below the stop.
///
/// Hits are taken in the order of the tree, eight products side by side that are multiplied at the end: the result
/// depends on the ray alone, not on threads or on other rays.
#[inline(always)]
pub(crate) fn transmittance<S: Simd>(
    simd: S,
    bvh: &Bvh,
    ray: &Ray,
    limits: &Limits,
    scratch: &mut Scratch,
) -> f32 {
    let one = f32x8::splat(simd, 1.0);
    let mut product = one;
    if bvh.nodes.is_empty() {
        return 1.0;
    }
    let lanes = RayLanes::new(simd, ray);
    let stack = &mut scratch.nodes;
    stack.clear();
    stack.push(0);
    while let Some(index) = stack.pop() {
        let node = &bvh.nodes[index as usize];
        let (_, entered) = lanes.enter(simd, node, ray.t_max);
        let entered = entered.to_bitmask();
        let mut inner = entered & !node.leaves;
        while inner != 0 {
            stack.push(node.children[inner.trailing_zeros() as usize & (WIDTH - 1)]);
            inner &= inner - 1;
        }
        let mut leaves = entered & node.leaves;
        if leaves == 0 {
            continue;
        }
        while leaves != 0 {
            let child = node.children[leaves.trailing_zeros() as usize & (WIDTH - 1)];
            leaves &= leaves - 1;
            let met = lanes.meet(simd, &bvh.blocks[(child & !LEAF) as usize], ray.t_max, limits);
            if met.mask.any_true() {
                product *= one - met.alpha(simd, limits);
            }
        }
        if product.reduce_product() < limits.transmittance_min {
            return 0.0;
        }
    }
    product.reduce_product()
}

/// How far past the stop the product of a partial set of hits must be before what lies behind is given up. The factor
/// keeps rounding (the product of the full set is taken in another order) from changing the result.
const MARGIN: f32 = 0.5;
/// Hits between two attempts to bring the far end nearer.
const BATCH: usize = 16;

/// All hits in `[t_min, t_max)` that can matter, sorted by distance and then by surfel, in `scratch.hits`.
///
/// Which hits do not matter: let S be the hits found so far and t′ the distance at which the product of `1 − α` over
/// S, in order, falls below `MARGIN · transmittance_min`. The hits not yet found can only lower the true product at
/// t′, so the blend has stopped by then, and everything beyond t′, found or not, is dropped. The walk goes from near
/// to far, so t′ is soon close to where the ray really stops. With `transmittance_min` 0 all hits are kept.
#[inline(always)]
pub(crate) fn sorted_hits<S: Simd>(simd: S, bvh: &Bvh, ray: &Ray, limits: &Limits, scratch: &mut Scratch) {
    let Scratch { ordered: stack, hits, .. } = scratch;
    hits.clear();
    stack.clear();
    if bvh.nodes.is_empty() {
        return;
    }
    let lanes = RayLanes::new(simd, ray);
    let stop = MARGIN * limits.transmittance_min;
    let mut t_max = ray.t_max;
    let mut product = 1.0f32;
    let mut next_attempt = BATCH;
    stack.push((ray.t_min, 0));
    while let Some((near, child)) = stack.pop() {
        if near > t_max * SLACK {
            continue;
        }
        if child & LEAF == 0 {
            let node = &bvh.nodes[child as usize];
            let (near, entered) = lanes.enter(simd, node, t_max);
            let near = near.to_array();
            let mut bits = entered.to_bitmask();
            let base = stack.len();
            while bits != 0 {
                let slot = bits.trailing_zeros() as usize & (WIDTH - 1);
                bits &= bits - 1;
                // Insertion keeps the nearest on top.
                let mut at = stack.len();
                stack.push((near[slot], node.children[slot]));
                while at > base && stack[at - 1].0 < near[slot] {
                    stack.swap(at - 1, at);
                    at -= 1;
                }
            }
            continue;
        }
        let block = child & !LEAF;
        let met = lanes.meet(simd, &bvh.blocks[block as usize], t_max, limits);
        let mut bits = met.mask.to_bitmask();
        if bits == 0 {
            continue;
        }
        let (t, alpha) = (met.t.to_array(), met.alpha(simd, limits).to_array());
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize & (WIDTH - 1);
            bits &= bits - 1;
            let slot = block * WIDTH as u32 + lane as u32;
            hits.push(RawHit::new(t[lane], bvh.surfels[slot as usize], alpha[lane], slot));
            product *= 1.0 - alpha[lane];
        }
        if product < stop && hits.len() >= next_attempt {
            (product, t_max) = drop_hidden(hits, stop, t_max);
            next_attempt = hits.len() + BATCH;
        }
    }
    hits.sort_unstable_by_key(|hit| hit.key);
}

/// Sorts, drops what lies behind the distance at which the product falls below `stop`, and returns the product of
/// what remains and the new (exclusive) end.
fn drop_hidden(hits: &mut Vec<RawHit>, stop: f32, t_max: f32) -> (f32, f32) {
    hits.sort_unstable_by_key(|hit| hit.key);
    let mut product = 1.0f32;
    for k in 0..hits.len() {
        product *= 1.0 - hits[k].alpha;
        if product < stop {
            // Hits at the same distance stay: a surfel with a lower index may still be found there.
            let t = hits[k].t();
            let keep = hits.partition_point(|hit| hit.t() <= t);
            product *= hits[k + 1..keep].iter().map(|hit| 1.0 - hit.alpha).product::<f32>();
            hits.truncate(keep);
            return (product, t.next_up().min(t_max));
        }
    }
    (product, t_max)
}
