//! Shapes that a recipe can name, and their meshes.

use crate::mesh::Mesh;
use crate::{lathe, surface_nets};
use comgs_geom::Similarity;
use glam::{DQuat, EulerRot, Vec3};
use serde::{Deserialize, Serialize};

/// A shape in its own coordinates, centred on the origin unless stated. Sizes are in the part's units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// A sphere, smooth to the eye: shading normals are exact.
    Sphere {
        /// Radius.
        radius: f32,
    },
    /// A box; with `rounding` its edges and corners are round.
    Box {
        /// Full size along x, y, z.
        size: [f32; 3],
        /// Radius of the edges, at most half of the smallest side.
        #[serde(default)]
        rounding: f32,
    },
    /// A rectangle in the plane z = 0 that faces +z.
    Rectangle {
        /// Full size along x and y.
        size: [f32; 2],
    },
    /// A profile revolved around z; z as the profile has it.
    Lathe {
        /// `[radius, z]` points from the bottom's centre outwards and up. The outside is on the right-hand side.
        profile: Vec<[f32; 2]>,
        /// A smooth curve through the points (creased where a point is repeated) instead of straight stretches.
        #[serde(default)]
        smooth: bool,
    },
    /// A cylinder with flat ends.
    Cylinder {
        /// Radius.
        radius: f32,
        /// Height along z.
        height: f32,
    },
    /// A tube along a torus knot: `turns` around the z axis, `twists` around the ring.
    TorusKnot {
        /// Turns around the z axis, at least 1.
        turns: u32,
        /// Turns around the ring; 0 is a plain torus.
        twists: u32,
        /// Radius of the ring.
        radius: f32,
        /// Distance of the tube's axis from the ring.
        swing: f32,
        /// Radius of the tube.
        tube: f32,
    },
    /// Limbs that melt into each other: plants, animals, pebbles.
    Blob {
        /// The limbs.
        limbs: Vec<Limb>,
        /// Over what distance they melt.
        blend: f32,
        /// Grid cells along the longest side, 8 to 256.
        #[serde(default = "default_cells")]
        cells: usize,
    },
}

fn default_cells() -> usize {
    56
}

/// A straight limb with round ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limb {
    /// Centre of one end.
    pub from: [f32; 3],
    /// Centre of the other end.
    pub to: [f32; 3],
    /// Radii of the two ends.
    pub radius: [f32; 2],
}

/// Where a part stands: scaled, then turned, then moved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Placement {
    /// Where the shape's origin goes.
    pub at: [f32; 3],
    /// Turns in degrees around the fixed x, y and z axes, in this order.
    pub turn_deg: [f32; 3],
    /// Uniform scale.
    pub scale: f32,
}

impl Default for Placement {
    fn default() -> Self {
        Self { at: [0.0; 3], turn_deg: [0.0; 3], scale: 1.0 }
    }
}

impl Placement {
    /// As a similarity transform.
    #[must_use]
    pub fn similarity(&self) -> Similarity {
        let [x, y, z] = self.turn_deg.map(|d| f64::from(d).to_radians());
        Similarity {
            scale: f64::from(self.scale),
            // Fixed axes x, y, z in this order are the moving axes z, y, x.
            rotation: DQuat::from_euler(EulerRot::ZYX, z, y, x),
            translation: Vec3::from(self.at).as_dvec3(),
        }
    }
}

const SPHERE_COLUMNS: usize = 96;
const LATHE_COLUMNS: usize = 72;

impl Shape {
    /// The mesh, in the shape's own coordinates.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        match self {
            Self::Sphere { radius } => {
                let mut mesh = Mesh::default();
                let rows = SPHERE_COLUMNS / 2;
                mesh.grid(SPHERE_COLUMNS, rows, |i, j| {
                    let azimuth = std::f32::consts::TAU * (i % SPHERE_COLUMNS) as f32 / SPHERE_COLUMNS as f32;
                    let polar = std::f32::consts::PI * (1.0 - j as f32 / rows as f32);
                    // Exactly on the axis, where the sine of a rounded π is not.
                    let sin = if j == 0 || j == rows { 0.0 } else { polar.sin() };
                    let n = Vec3::new(sin * azimuth.cos(), sin * azimuth.sin(), polar.cos());
                    (*radius * n, n)
                });
                mesh
            }
            Self::Box { size, rounding } => rounded_box(Vec3::from(*size), *rounding),
            Self::Rectangle { size } => {
                let (x, y) = (0.5 * size[0], 0.5 * size[1]);
                let mut mesh = Mesh::default();
                let [a, b, c, d] = [(-x, -y), (x, -y), (x, y), (-x, y)]
                    .map(|(x, y)| mesh.corner(Vec3::new(x, y, 0.0), Vec3::Z));
                mesh.quad(a, b, c, d);
                mesh
            }
            Self::Lathe { profile, smooth } => lathe::lathe(profile, LATHE_COLUMNS, *smooth),
            Self::Cylinder { radius, height } => {
                let h = 0.5 * height;
                lathe::lathe(&[[0.0, -h], [*radius, -h], [*radius, h], [0.0, h]], LATHE_COLUMNS, false)
            }
            Self::TorusKnot { turns, twists, radius, swing, tube } => {
                let segments = 96 * (*turns.max(twists) as usize).clamp(1, 8);
                lathe::torus_knot(*turns, *twists, *radius, *swing, *tube, segments, 32)
            }
            Self::Blob { limbs, blend, cells } => {
                let (mut low, mut high) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
                for limb in limbs {
                    for (centre, r) in [(limb.from, limb.radius[0]), (limb.to, limb.radius[1])] {
                        low = low.min(Vec3::from(centre) - r);
                        high = high.max(Vec3::from(centre) + r);
                    }
                }
                // Melting swells the surface by at most a quarter of the blend distance a pair; grid cells for the border.
                let margin = blend + 3.0 * (high - low).max_element() / *cells as f32;
                surface_nets::mesh_of(|p| blob_field(limbs, *blend, p), low - margin, high + margin, *cells)
            }
        }
    }

    /// Problems, each with its field.
    pub(crate) fn problems(&self, at: &str, out: &mut Vec<String>) {
        let mut positive = |name: &str, values: &[f32]| {
            if values.iter().any(|v| !(*v > 0.0 && *v < 1e6)) {
                out.push(format!("{at}.{name}: expected positive sizes below 10⁶, got {values:?}"));
            }
        };
        match self {
            Self::Sphere { radius } => positive("radius", &[*radius]),
            Self::Box { size, rounding } => {
                positive("size", size);
                let most = 0.5 * size.iter().copied().fold(f32::MAX, f32::min);
                if !(0.0..=most).contains(rounding) {
                    out.push(format!("{at}.rounding: expected 0 to {most}, got {rounding}"));
                }
            }
            Self::Rectangle { size } => positive("size", size),
            Self::Cylinder { radius, height } => positive("radius, height", &[*radius, *height]),
            Self::Lathe { profile, .. } => {
                if profile.len() < 2 || profile.len() > 1000 {
                    out.push(format!("{at}.profile: expected 2 to 1000 points, got {}", profile.len()));
                }
                if profile.iter().any(|p| !(p[0] >= 0.0 && p[0] < 1e6 && p[1].abs() < 1e6)) {
                    out.push(format!("{at}.profile: expected finite points with a radius of at least 0"));
                }
            }
            Self::TorusKnot { turns, twists, radius, swing, tube } => {
                positive("radius, tube", &[*radius, *tube]);
                if !(0.0..1e6).contains(swing) {
                    out.push(format!("{at}.swing: expected at least 0, got {swing}"));
                }
                if *turns == 0 || *turns > 20 || *twists > 20 {
                    out.push(format!(
                        "{at}: expected 1 to 20 turns and 0 to 20 twists, got {turns} and {twists}"
                    ));
                }
            }
            Self::Blob { limbs, blend, cells } => {
                for limb in limbs {
                    positive("limbs.radius", &limb.radius);
                }
                let finite = |p: [f32; 3]| p.iter().all(|v| v.abs() < 1e6);
                if limbs.is_empty()
                    || limbs.len() > 200
                    || !limbs.iter().all(|l| finite(l.from) && finite(l.to))
                {
                    out.push(format!(
                        "{at}.limbs: expected 1 to 200 limbs at finite places, got {}",
                        limbs.len()
                    ));
                }
                if !(0.0..1e6).contains(blend) {
                    out.push(format!("{at}.blend: expected at least 0, got {blend}"));
                }
                if !(8..=256).contains(cells) {
                    out.push(format!("{at}.cells: expected 8 to 256, got {cells}"));
                }
            }
        }
    }
}

/// A box of a given full size whose edges are quarter cylinders and whose corners are eighths of a sphere.
fn rounded_box(size: Vec3, rounding: f32) -> Mesh {
    let half = 0.5 * size;
    let inner = half - rounding;
    // Along each side: the cube's coordinate, with arcs at both ends. On a face of the cube a distance r·tan θ from the
    // inner box is seen from it under the angle θ.
    let arc = if rounding > 0.0 { 4 } else { 0 };
    let line = |axis: usize| -> Vec<f32> {
        let mut line = Vec::new();
        for i in (0..=arc).rev() {
            line.push(
                -inner[axis] - rounding * (std::f32::consts::FRAC_PI_4 * i as f32 / arc.max(1) as f32).tan(),
            );
        }
        for i in 0..=arc {
            line.push(
                inner[axis] + rounding * (std::f32::consts::FRAC_PI_4 * i as f32 / arc.max(1) as f32).tan(),
            );
        }
        line
    };
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            // u × v = the face's outward normal.
            let (u, v) =
                if sign > 0.0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
            let (lu, lv) = (line(u), line(v));
            mesh.grid(lu.len() - 1, lv.len() - 1, |i, j| {
                let mut p = Vec3::ZERO;
                p[axis] = sign * half[axis];
                p[u] = lu[i];
                p[v] = lv[j];
                if rounding > 0.0 {
                    let c = p.clamp(-inner, inner);
                    let n = (p - c).normalize();
                    (c + rounding * n, n)
                } else {
                    let mut n = Vec3::ZERO;
                    n[axis] = sign;
                    (p, n)
                }
            });
        }
    }
    mesh
}

/// Signed distance (nearly) of the melted limbs.
fn blob_field(limbs: &[Limb], blend: f32, p: Vec3) -> f32 {
    let mut field = f32::MAX;
    for limb in limbs {
        let (a, b) = (Vec3::from(limb.from), Vec3::from(limb.to));
        let axis = b - a;
        let length2 = axis.length_squared();
        let t = if length2 > 0.0 { ((p - a).dot(axis) / length2).clamp(0.0, 1.0) } else { 0.0 };
        let d = (p - a - t * axis).length() - (limb.radius[0] + (limb.radius[1] - limb.radius[0]) * t);
        field = if field == f32::MAX { d } else { smooth_minimum(field, d, blend) };
    }
    field
}

/// The minimum, rounded where the two are within `k` of each other.
fn smooth_minimum(a: f32, b: f32, k: f32) -> f32 {
    if k <= 0.0 {
        return a.min(b);
    }
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - 0.25 * k * h * h
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::collections::HashMap;

    fn closed_shapes() -> Vec<(&'static str, Shape, Option<f64>)> {
        use std::f64::consts::PI;
        vec![
            ("sphere", Shape::Sphere { radius: 0.5 }, Some(PI / 6.0)),
            ("box", Shape::Box { size: [1.0, 2.0, 0.5], rounding: 0.0 }, Some(1.0)),
            // A cube of side 1 with rounding r: inner cube, six slabs, twelve quarter cylinders, one ball.
            (
                "rounded box",
                Shape::Box { size: [1.0; 3], rounding: 0.2 },
                Some(0.216 + 6.0 * 0.36 * 0.2 + 3.0 * PI * 0.04 * 0.6 + 4.0 / 3.0 * PI * 0.008),
            ),
            ("cylinder", Shape::Cylinder { radius: 0.5, height: 2.0 }, Some(PI / 2.0)),
            (
                "torus",
                Shape::TorusKnot { turns: 1, twists: 0, radius: 0.4, swing: 0.1, tube: 0.1 },
                Some(2.0 * PI * PI * 0.5 * 0.01),
            ),
            ("knot", Shape::TorusKnot { turns: 2, twists: 3, radius: 0.5, swing: 0.2, tube: 0.08 }, None),
            (
                "vase",
                Shape::Lathe {
                    profile: vec![[0.0, 0.0], [0.3, 0.0], [0.5, 0.5], [0.2, 1.0], [0.0, 1.0]],
                    smooth: true,
                },
                None,
            ),
            (
                "ball blob",
                Shape::Blob {
                    limbs: vec![Limb { from: [0.1, 0.0, 0.0], to: [0.1, 0.0, 0.0], radius: [0.5, 0.5] }],
                    blend: 0.0,
                    cells: 40,
                },
                Some(PI / 6.0),
            ),
            (
                "two limbs",
                Shape::Blob {
                    limbs: vec![
                        Limb { from: [-0.3, 0.0, 0.0], to: [0.3, 0.0, 0.0], radius: [0.2, 0.1] },
                        Limb { from: [0.3, 0.0, 0.0], to: [0.4, 0.3, 0.2], radius: [0.1, 0.15] },
                    ],
                    blend: 0.1,
                    cells: 40,
                },
                None,
            ),
        ]
    }

    /// Goal: closed shapes enclose the volume known on paper (within the facets' chords), with fronts outwards and
    /// shading normals on the side of the front.
    #[test]
    fn volumes_and_orientation() {
        for (name, shape, volume) in closed_shapes() {
            let mesh = shape.mesh();
            let got = mesh.signed_volume();
            assert!(got > 0.0, "{name} is inside out: {got}");
            if let Some(expected) = volume {
                assert!((got / expected - 1.0).abs() < 0.01, "{name}: {got}, expected {expected}");
            }
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                let face = (b - a).cross(c - a).normalize();
                for i in t {
                    let n = mesh.normals[*i as usize];
                    assert!((n.length() - 1.0).abs() < 1e-4, "{name}");
                    assert!(n.dot(face) > 0.3, "{name}: normal {n} against face {face}");
                }
            }
        }
    }

    /// Goal: closed shapes are closed: every edge (by position) is used once in each direction, so no ray leaks.
    #[test]
    fn no_holes() {
        for (name, shape, _) in closed_shapes() {
            let mesh = shape.mesh();
            let scale = 1e5;
            let key = |i: u32| (mesh.positions[i as usize] * scale).round().as_ivec3().to_array();
            let mut edges: HashMap<([i32; 3], [i32; 3]), i32> = HashMap::new();
            for t in &mesh.triangles {
                for k in 0..3 {
                    let (a, b) = (key(t[k]), key(t[(k + 1) % 3]));
                    *edges.entry((a, b)).or_default() += 1;
                    *edges.entry((b, a)).or_default() -= 1;
                }
            }
            let open = edges.values().filter(|&&v| v != 0).count();
            assert_eq!(open, 0, "{name} has open edges");
        }
    }

    /// Goal: a placement turns around the fixed axes x, y, z in this order, after scaling.
    #[test]
    fn placement_order() {
        let placement = Placement { at: [1.0, 2.0, 3.0], turn_deg: [90.0, 0.0, 90.0], scale: 2.0 };
        // y → (turn x by 90°) z → (turn z by 90°) z.
        let p = placement.similarity().transform_point(DVec3::Y);
        assert!((p - DVec3::new(1.0, 2.0, 5.0)).length() < 1e-6, "{p}");
    }
}
