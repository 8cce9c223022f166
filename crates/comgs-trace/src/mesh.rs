//! Ray tracing of triangle meshes, both sides of every triangle.

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::{Ray, RayHit};
use std::time::Duration;

/// Where a ray meets a mesh first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshHit {
    /// Distance in units of the direction's length.
    pub t: f32,
    /// Barycentric coordinate of the triangle's second corner.
    pub u: f32,
    /// Barycentric coordinate of its third corner.
    pub v: f32,
    /// Index of the triangle.
    pub triangle: u32,
}

#[derive(Clone, Copy, Debug)]
struct Triangle {
    corner: Vec3A,
    edge_1: Vec3A,
    edge_2: Vec3A,
}

/// Triangles in a tree of bounding boxes. Not differentiable.
#[derive(Debug)]
pub struct MeshTracer {
    tree: Option<CwBvh>,
    /// In the tree's order, so that a leaf's triangles lie side by side.
    triangles: Vec<Triangle>,
    /// Index that a triangle of the tree was given with.
    given: Vec<u32>,
}

impl MeshTracer {
    /// A tracer of `triangles`, three indices into `positions` each. Positions are finite and bounded by 1e15, which is the
    /// caller's to check; a triangle without area is met by no ray.
    ///
    /// # Panics
    /// On an index beyond `positions`.
    #[must_use]
    pub fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let triangles: Vec<Triangle> = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| Vec3A::from(positions[i as usize]));
                Triangle { corner: a, edge_1: b - a, edge_2: c - a }
            })
            .collect();
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|t| {
                let (b, c) = (t.corner + t.edge_1, t.corner + t.edge_2);
                Aabb::new(t.corner.min(b).min(c), t.corner.max(b).max(c))
            })
            .collect();
        let tree = (!boxes.is_empty())
            .then(|| build_cwbvh(&boxes, BvhBuildParams::medium_build(), &mut Duration::default()));
        let given = tree.as_ref().map_or_else(Vec::new, |t| t.primitive_indices.clone());
        let triangles = given.iter().map(|&i| triangles[i as usize]).collect();
        Self { tree, triangles, given }
    }

    /// The nearest triangle with `t > t_min` along a ray of any non-zero direction.
    #[must_use]
    pub fn nearest(&self, origin: Vec3, direction: Vec3, t_min: f32) -> Option<MeshHit> {
        let ray = Ray::new(origin.into(), direction.into(), t_min, f32::INFINITY);
        let mut hit = RayHit::none();
        self.tree
            .as_ref()?
            .ray_traverse(ray, &mut hit, |ray, i| {
                meet(&self.triangles[i], ray).map_or(f32::INFINITY, |(t, ..)| t)
            })
            .then_some(())?;
        let (t, u, v) = meet(&self.triangles[hit.primitive_id as usize], &ray)?;
        Some(MeshHit { t, u, v, triangle: self.given[hit.primitive_id as usize] })
    }

    /// Whether any triangle lies at `t_min < t < t_max`.
    #[must_use]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> bool {
        let ray = Ray::new(origin.into(), direction.into(), t_min, t_max);
        self.tree.as_ref().is_some_and(|tree| {
            !tree.ray_traverse_miss(ray, |ray, i| {
                meet(&self.triangles[i], ray).map_or(f32::INFINITY, |(t, ..)| t)
            })
        })
    }

    /// Number of triangles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }
}

/// Distance and barycentric coordinates where a ray meets a triangle (Möller & Trumbore 1997).
fn meet(triangle: &Triangle, ray: &Ray) -> Option<(f32, f32, f32)> {
    let p = ray.direction.cross(triangle.edge_2);
    let determinant = triangle.edge_1.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = ray.origin - triangle.corner;
    let u = s.dot(p) / determinant;
    let q = s.cross(triangle.edge_1);
    let v = ray.direction.dot(q) / determinant;
    let t = triangle.edge_2.dot(q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > ray.tmin && t < ray.tmax).then_some((t, u, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;

    /// Goal: the tree finds what all triangles one by one find, in f64 and by planes and edges instead of determinants.
    #[test]
    fn tree_against_every_triangle() {
        let mut rng = Rng::new(11);
        let mut point = |scale: f32| Vec3::new(rng.normal(), rng.normal(), rng.normal()) * scale;
        let mut positions = Vec::new();
        for _ in 0..300 {
            let centre = point(1.0);
            positions.extend((0..3).map(|_| centre + point(0.15)));
        }
        let triangles: Vec<[u32; 3]> = (0..300).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let tracer = MeshTracer::new(&positions, &triangles);
        let brute = |o: Vec3, d: Vec3| -> Option<(f64, u32)> {
            let (o, d) = (o.as_dvec3(), d.as_dvec3());
            let mut best: Option<(f64, u32)> = None;
            for (k, t) in triangles.iter().enumerate() {
                let [a, b, c] = t.map(|i| positions[i as usize].as_dvec3());
                let n = (b - a).cross(c - a);
                let distance = (a - o).dot(n) / d.dot(n);
                let p = o + d * distance;
                let inside =
                    [(a, b), (b, c), (c, a)].iter().all(|(s, e)| (*e - *s).cross(p - *s).dot(n) >= 0.0);
                if inside && distance > 0.0 && best.is_none_or(|(t, _)| distance < t) {
                    best = Some((distance, k as u32));
                }
            }
            best
        };
        let (mut hits, mut same) = (0, 0);
        for _ in 0..2000 {
            let (origin, direction) = (point(2.0), point(1.0));
            let truth = brute(origin, direction);
            let found = tracer.nearest(origin, direction, 0.0);
            assert_eq!(tracer.occluded(origin, direction, 0.0, f32::INFINITY), found.is_some());
            hits += usize::from(truth.is_some());
            let agree = match (truth, found) {
                (None, None) => true,
                (Some((t, k)), Some(hit)) => {
                    hit.triangle == k && (f64::from(hit.t) - t).abs() < 1e-4 * t.max(1.0)
                }
                _ => false,
            };
            same += usize::from(agree);
        }
        // A ray through an edge may fall to either side of rounding.
        assert!(hits > 100 && same >= 1998, "{hits} hits, {same} the same");
    }

    /// Goal: no triangles, degenerate ones, and limits of the ray.
    #[test]
    fn nothing_to_hit() {
        let empty = MeshTracer::new(&[], &[]);
        assert!(
            empty.nearest(Vec3::ZERO, Vec3::X, 0.0).is_none()
                && !empty.occluded(Vec3::ZERO, Vec3::X, 0.0, 1.0)
        );
        let line = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0, Vec3::Y, Vec3::Z];
        let tracer = MeshTracer::new(&line, &[[0, 1, 2], [1, 3, 4]]);
        assert!(tracer.nearest(Vec3::new(0.5, 0.0, 1.0), -Vec3::Z, 0.0).is_none_or(|h| h.triangle == 1));
        let through = Vec3::splat(1.0 / 3.0);
        assert!(tracer.occluded(Vec3::ZERO, through, 0.0, 1.1));
        assert!(!tracer.occluded(Vec3::ZERO, through, 0.0, 0.9));
        assert!(!tracer.occluded(Vec3::ZERO, through, 1.1, 9.0));
    }
}
