//! Surfaces of revolution and tubes.

use crate::mesh::Mesh;
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// Steps that a smooth profile takes between two of its points.
const STEPS: usize = 6;

/// One stretch of the profile: points with the outward normal in the (r, z) half-plane.
type Stretch = Vec<(Vec2, Vec2)>;

/// Revolves a profile of `[radius, z]` points around z. The outside is on the right of the profile's direction, so
/// a vase goes from the bottom's centre outwards and up (and, if it is open, over the rim and down inside). A
/// smooth profile is a Catmull–Rom curve, with a crease where a point is given twice; otherwise the points
/// are joined by straight, flat-shaded stretches.
pub(crate) fn lathe(profile: &[[f32; 2]], segments: usize, smooth: bool) -> Mesh {
    let points: Vec<Vec2> = profile.iter().map(|&p| Vec2::from(p)).collect();
    let stretches = if smooth { smooth_stretches(&points) } else { straight_stretches(&points) };
    let mut mesh = Mesh::default();
    for stretch in stretches {
        mesh.grid(segments, stretch.len() - 1, |i, j| {
            // The seam's two columns lie on the same points to the last bit.
            let angle = TAU * (i % segments) as f32 / segments as f32;
            let (s, c) = angle.sin_cos();
            let (p, n) = stretch[j];
            (Vec3::new(p.x * c, p.x * s, p.y), Vec3::new(n.x * c, n.x * s, n.y))
        });
    }
    mesh
}

/// The right-hand normal of a direction in the (r, z) half-plane.
fn outward(tangent: Vec2) -> Vec2 {
    Vec2::new(tangent.y, -tangent.x).normalize_or(Vec2::X)
}

fn straight_stretches(points: &[Vec2]) -> Vec<Stretch> {
    points
        .windows(2)
        .filter(|w| w[0] != w[1])
        .map(|w| {
            let n = outward(w[1] - w[0]);
            vec![(w[0], n), (w[1], n)]
        })
        .collect()
}

fn smooth_stretches(points: &[Vec2]) -> Vec<Stretch> {
    let mut stretches = Vec::new();
    let mut start = 0;
    for end in 1..=points.len() {
        if end == points.len() || points[end] == points[end - 1] {
            if end - start >= 2 {
                stretches.push(catmull_rom(&points[start..end]));
            }
            start = end;
        }
    }
    stretches
}

fn catmull_rom(points: &[Vec2]) -> Stretch {
    let n = points.len();
    // End points are mirrored, which lets the curve leave along the chord.
    let at = |i: isize| -> Vec2 {
        if i < 0 {
            2.0 * points[0] - points[1]
        } else if i as usize >= n {
            2.0 * points[n - 1] - points[n - 2]
        } else {
            points[i as usize]
        }
    };
    let mut out = Vec::with_capacity((n - 1) * STEPS + 1);
    for k in 0..n - 1 {
        let [p0, p1, p2, p3] = [-1, 0, 1, 2].map(|d| at(k as isize + d));
        let steps = if k == n - 2 { STEPS + 1 } else { STEPS };
        for i in 0..steps {
            let t = i as f32 / STEPS as f32;
            let (a, b) = (p2 - p0, 2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3);
            let c = 3.0 * p1 - p0 - 3.0 * p2 + p3;
            let position = p1 + 0.5 * (a * t + b * t * t + c * t * t * t);
            let tangent = 0.5 * (a + 2.0 * b * t + 3.0 * c * t * t);
            out.push((Vec2::new(position.x.max(0.0), position.y), outward(tangent)));
        }
    }
    out
}

/// A tube around the (p, q) torus knot: `p` turns around the z axis while `q` turns around the ring. q = 0, p = 1
/// is a plain torus of ring radius `radius + swing`.
pub(crate) fn torus_knot(
    p: u32,
    q: u32,
    radius: f32,
    swing: f32,
    tube: f32,
    segments: usize,
    sides: usize,
) -> Mesh {
    let (p, q) = (p as f32, q as f32);
    let curve = |phi: f32| {
        let r = radius + swing * (q * phi).cos();
        Vec3::new(r * (p * phi).cos(), r * (p * phi).sin(), swing * (q * phi).sin())
    };
    let mut mesh = Mesh::default();
    mesh.grid(segments, sides, |i, j| {
        let phi = TAU * (i % segments) as f32 / segments as f32;
        let (sq, cq) = (q * phi).sin_cos();
        let (sp, cp) = (p * phi).sin_cos();
        let r = radius + swing * cq;
        let tangent =
            Vec3::new(-swing * q * sq * cp - r * p * sp, -swing * q * sq * sp + r * p * cp, swing * q * cq)
                .normalize();
        // The curve lies on a torus, whose normal is perpendicular to it everywhere: a frame without twist jumps.
        let across = Vec3::new(cq * cp, cq * sp, sq);
        let side = across.cross(tangent);
        let (s, c) = (TAU * (j % sides) as f32 / sides as f32).sin_cos();
        let normal = c * across + s * side;
        (curve(phi) + tube * normal, normal)
    });
    mesh
}
