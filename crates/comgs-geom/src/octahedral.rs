//! Octahedral maps (Praun & Hoppe 2003, "Spherical parametrization and remeshing"): the sphere is projected onto
//! the octahedron |x| + |y| + |z| = 1 and unfolded into the unit square. The centre of the map is +z, the middles
//! of its edges are ±x and ±y, its four corners are all −z. A component of 0 counts as positive, whatever its sign
//! bit, so every direction has exactly one place: −z is `(1, 1)`.
//!
//! `uv` are continuous coordinates in `[0, 1]²`; texel `(column, row)` of a `size × size` map has its centre at
//! `((column + ½)/size, (row + ½)/size)` and the index `row · size + column`. A straight line in one of the map's
//! eight triangles is an arc of a great circle.
//!
//! Texels are not equally large: a solid angle per area of the map is [`jacobian`], from 4 at the octahedron's
//! vertices to 12 √3 = 20.8 at the centres of its faces (4π = 12.6 on average).

use glam::{DVec2, DVec3, Vec2, Vec3};

/// `magnitude` ≥ 0 with the sign of `x`, where 0 and −0 are positive. Bit operations: a branch on the sign of a random
/// direction is mispredicted half of the time (a footprint took twice as long with them).
#[inline]
fn signed(magnitude: f32, x: f32) -> f32 {
    magnitude.copysign(x + 0.0)
}

/// `d` over its L1 norm, and 1 over that norm; zero and non-finite vectors are +z with a factor of 0. Directions
/// whose norm is near the ends of the range of f32 are scaled first.
#[inline]
fn on_octahedron(d: Vec3) -> (Vec3, f32) {
    let norm = d.x.abs() + d.y.abs() + d.z.abs();
    if norm > 1e-30 && norm < 1e30 {
        let inverse = 1.0 / norm;
        return (d * inverse, inverse);
    }
    extreme_on_octahedron(d)
}

#[cold]
fn extreme_on_octahedron(d: Vec3) -> (Vec3, f32) {
    let largest = d.abs().max_element();
    if !d.is_finite() || largest == 0.0 {
        return (Vec3::Z, 0.0);
    }
    let d = d.as_dvec3();
    let inverse = 1.0 / (d.x.abs() + d.y.abs() + d.z.abs());
    ((d * inverse).as_vec3(), if inverse <= f64::from(f32::MAX) { inverse as f32 } else { 0.0 })
}

/// Place in the square `[−1, 1]²` of a point of the octahedron: below the equator, (1 − |y|) with the sign of x, which
/// is x moved outwards by |z|.
#[inline]
fn unfolded(p: Vec3) -> Vec2 {
    let out = (-p.z).max(0.0);
    Vec2::new(p.x + signed(out, p.x), p.y + signed(out, p.y))
}

/// `uv` in `[0, 1]²` of a direction of any length; zero and non-finite vectors are taken as +z. Inverse:
/// [`direction`]. Continuous but for the jump from one edge to the one it is folded onto.
#[inline]
#[must_use]
pub fn uv_from_direction(d: Vec3) -> Vec2 {
    (unfolded(on_octahedron(d).0) * 0.5 + 0.5).clamp(Vec2::ZERO, Vec2::ONE)
}

/// Unit direction of `uv` in `[0, 1]²`. Inverse: [`uv_from_direction`] (an edge has two places for a direction, a
/// corner four).
#[inline]
#[must_use]
pub fn direction(uv: Vec2) -> Vec3 {
    let p = uv * 2.0 - 1.0;
    let z = 1.0 - p.x.abs() - p.y.abs();
    let out = (-z).max(0.0);
    Vec3::new(p.x - signed(out, p.x), p.y - signed(out, p.y), z).normalize()
}

/// Unit direction of the centre of a texel.
#[inline]
#[must_use]
pub fn texel_direction(column: usize, row: usize, size: usize) -> Vec3 {
    direction(Vec2::new(column as f32 + 0.5, row as f32 + 0.5) / size as f32)
}

/// Index of the texel that a direction of any length falls into.
#[inline]
#[must_use]
pub fn texel_of(d: Vec3, size: usize) -> usize {
    let t = uv_from_direction(d) * size as f32;
    (t.y as usize).min(size - 1) * size + (t.x as usize).min(size - 1)
}

/// Solid angle per area of the map, dω / (du dv) = 4 (|d|₁ / |d|₂)³, of a direction of any length. (On a face of the
/// octahedron, at distance 1/√3 from the origin, dω = dx dy / |p|³.)
#[inline]
#[must_use]
pub fn jacobian(d: Vec3) -> f32 {
    let p = on_octahedron(d).0;
    let inverse = 1.0 / p.length();
    4.0 * inverse * inverse * inverse
}

/// Solid angle of a texel in steradian, exact: the texel's outline consists of arcs of great circles, cut where it
/// crosses the octahedron's edges. The texels of a map sum to 4π.
#[must_use]
pub fn texel_solid_angle(column: usize, row: usize, size: usize) -> f32 {
    exact_solid_angle(column, row, size) as f32
}

/// [`texel_solid_angle`] of all texels of a map, row by row.
#[must_use]
pub fn solid_angles(size: usize) -> Vec<f32> {
    // The map is symmetric about its two axes and its diagonal.
    let mut angles = vec![0.0; size * size];
    for row in 0..size.div_ceil(2) {
        for column in row..size.div_ceil(2) {
            let angle = texel_solid_angle(column, row, size);
            for (i, j) in [(column, row), (row, column)] {
                for (i, j) in [(i, j), (size - 1 - i, j), (i, size - 1 - j), (size - 1 - i, size - 1 - j)] {
                    angles[j * size + i] = angle;
                }
            }
        }
    }
    angles
}

fn exact_solid_angle(column: usize, row: usize, size: usize) -> f64 {
    let edge = |i: usize| 2.0 * i as f64 / size as f64 - 1.0;
    let (x0, x1, y0, y1) = (edge(column), edge(column + 1), edge(row), edge(row + 1));
    let square = [DVec2::new(x0, y0), DVec2::new(x1, y0), DVec2::new(x1, y1), DVec2::new(x0, y1)];
    let mut sum = 0.0;
    for quadrant in
        [DVec2::new(1.0, 1.0), DVec2::new(-1.0, 1.0), DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0)]
    {
        // The part in a quadrant, mirrored into the first one.
        let part = square.map(|p| p * quadrant);
        let part = clipped(&clipped(&part, |p| p.x), |p| p.y);
        for upper in [clipped(&part, |p| 1.0 - p.x - p.y), clipped(&part, |p| p.x + p.y - 1.0)] {
            let corners: Vec<DVec3> = upper
                .iter()
                .map(|p| {
                    let z = 1.0 - p.x - p.y;
                    let xy = if z < 0.0 { DVec2::new(1.0 - p.y, 1.0 - p.x) } else { *p };
                    DVec3::new(xy.x, xy.y, z).normalize()
                })
                .collect();
            for i in 2..corners.len() {
                sum += triangle_solid_angle(corners[0], corners[i - 1], corners[i]);
            }
        }
    }
    sum
}

/// The part of a convex polygon where a linear function is not negative.
fn clipped(polygon: &[DVec2], inside: impl Fn(DVec2) -> f64) -> Vec<DVec2> {
    let mut out = Vec::with_capacity(polygon.len() + 1);
    for (i, &p) in polygon.iter().enumerate() {
        let q = polygon[(i + 1) % polygon.len()];
        let (a, b) = (inside(p), inside(q));
        if a >= 0.0 {
            out.push(p);
        }
        if (a > 0.0 && b < 0.0) || (a < 0.0 && b > 0.0) {
            out.push(p + (q - p) * (a / (a - b)));
        }
    }
    out
}

/// Solid angle of a triangle of unit vectors (Van Oosterom & Strackee 1983).
fn triangle_solid_angle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

/// The four texels between whose centres a direction lies, with their bilinear weights: not negative, sum 1. Past
/// the map's edge the texels are those it is folded onto, so that the interpolation is continuous over the sphere; a
/// texel may occur twice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Indices, `row · size + column`: left and right of the upper row, left and right of the lower row.
    pub texels: [u32; 4],
    /// Weights of the texels.
    pub weights: [f32; 4],
}

impl Footprint {
    /// The interpolated value of a map of one channel.
    #[inline]
    #[must_use]
    pub fn gather(&self, map: &[f32]) -> f32 {
        let [a, b, c, d] = self.texels.map(|t| map[t as usize]);
        self.weights[0] * a + self.weights[1] * b + (self.weights[2] * c + self.weights[3] * d)
    }

    /// The interpolated value of a map of three channels, `[texel][rgb]`.
    #[inline]
    #[must_use]
    pub fn gather_rgb(&self, map: &[f32]) -> Vec3 {
        let [a, b, c, d] = self.texels.map(|t| Vec3::from_slice(&map[3 * t as usize..3 * t as usize + 3]));
        self.weights[0] * a + self.weights[1] * b + (self.weights[2] * c + self.weights[3] * d)
    }
}

/// The texels left above and right below of a place `p` in `[−1, 1]²`, and its fractions between their centres.
#[inline]
fn cell(p: Vec2, size: usize) -> (i32, i32, f32, f32) {
    // Half a texel is added, not subtracted, so that cutting off the fraction is rounding down.
    let half = 0.5 * size as f32;
    let (x, y) = (p.x * half + (half + 0.5), p.y * half + (half + 0.5));
    let (right, lower) = (x as i32, y as i32);
    (right - 1, lower - 1, x - right as f32, y - lower as f32)
}

/// Index of the texel at `(column, row)`, which may lie one step outside the map (a "one-texel border"): there it is
/// the texel that the map continues with on the sphere. Both coordinates from −1 to `size`.
#[inline]
#[must_use]
pub fn neighbour(column: isize, row: isize, size: usize) -> usize {
    wrapped(column as i32, row as i32, size as i32) as usize
}

#[inline]
fn wrapped(column: i32, row: i32, size: i32) -> u32 {
    let last = size - 1;
    let row = if column < 0 || column > last { last - row } else { row };
    let column = column.clamp(0, last);
    let column = if row < 0 || row > last { last - column } else { column };
    (row.clamp(0, last) * size + column) as u32
}

/// Bilinear footprint of a direction of any length in a `size × size` map, `size` from 1 to 32768; zero and
/// non-finite vectors are taken as +z. Piecewise smooth, with kinks where a centre line of texels, a fold or an edge
/// is crossed; gradient: [`footprint_vjp`].
#[inline]
#[must_use]
pub fn footprint(d: Vec3, size: usize) -> Footprint {
    let (column, row, fx, fy) = cell(unfolded(on_octahedron(d).0), size);
    let n = size as i32;
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let inside = (column as u32) < (n - 1) as u32 && (row as u32) < (n - 1) as u32;
    let texels = if inside {
        let first = (row * n + column) as u32;
        [first, first + 1, first + n as u32, first + n as u32 + 1]
    } else {
        border(column, row, n)
    };
    Footprint { texels, weights }
}

#[cold]
fn border(column: i32, row: i32, size: i32) -> [u32; 4] {
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| wrapped(column + x, row + y, size))
}

/// Gradient of [`footprint`] with respect to the direction, given that with respect to its weights: exact for the
/// mapping d ↦ weights as it is, without a normalisation, and so orthogonal to `d` and falling with its length. On a
/// kink it is the gradient of one side; for zero and non-finite vectors it is 0.
#[inline]
#[must_use]
pub fn footprint_vjp(d: Vec3, size: usize, grad_weights: [f32; 4]) -> Vec3 {
    let (p, inverse) = on_octahedron(d);
    let (_, _, fx, fy) = cell(unfolded(p), size);
    let [a, b, c, e] = grad_weights;
    let half = 0.5 * size as f32;
    let grad = Vec2::new((1.0 - fy) * (b - a) + fy * (e - c), (1.0 - fx) * (c - a) + fx * (e - b)) * half;
    let (sx, sy, sz) = (signed(1.0, p.x), signed(1.0, p.y), signed(1.0, p.z));
    // Below the equator both coordinates are moved outwards by −z.
    let below = 0.5 - 0.5 * sz;
    let grad_z = -below * (grad.x * sx + grad.y * sy);
    // Through the division by |x| + |y| + |z|.
    let along = grad.x * p.x + grad.y * p.y + grad_z * p.z;
    inverse * Vec3::new(grad.x - along * sx, grad.y - along * sy, grad_z - along * sz)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    /// Goal: the centre is +z, the edges' middles are the horizontal axes, the corners are −z.
    #[test]
    fn axes_are_where_the_convention_says() {
        for (uv, d) in [
            ([0.5, 0.5], Vec3::Z),
            ([1.0, 0.5], Vec3::X),
            ([0.0, 0.5], -Vec3::X),
            ([0.5, 1.0], Vec3::Y),
            ([0.5, 0.0], -Vec3::Y),
            ([1.0, 1.0], -Vec3::Z),
        ] {
            assert_eq!(direction(Vec2::from_array(uv)), d);
            assert_eq!(uv_from_direction(d).to_array(), uv);
        }
    }

    /// Goal: footprints have weights that are no negative and sum to 1, and directions of texel centres are their
    /// texel alone, for odd and even sizes down to 1.
    #[test]
    fn footprints_interpolate() {
        let mut rng = Rng::new(1);
        for size in [1usize, 2, 5, 16] {
            for row in 0..size {
                for column in 0..size {
                    let f = footprint(texel_direction(column, row, size), size);
                    let own: f32 = (0..4)
                        .filter(|&k| f.texels[k] as usize == row * size + column)
                        .map(|k| f.weights[k])
                        .sum();
                    assert!((own - 1.0).abs() < 1e-5, "{column} {row} of {size}: {f:?}");
                    assert_eq!(texel_of(texel_direction(column, row, size), size), row * size + column);
                }
            }
            for _ in 0..1000 {
                let f = footprint(Vec3::new(rng.normal(), rng.normal(), rng.normal()), size);
                assert!((f.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
                assert!(f.weights.iter().all(|&w| w >= 0.0));
                assert!(f.texels.iter().all(|&t| (t as usize) < size * size));
            }
        }
    }

    /// Goal: exact solid angles cover the sphere for odd and even sizes, the table repeats them, and small texels have
    /// the Jacobian's share.
    #[test]
    fn solid_angles_sum_to_the_sphere() {
        for size in [1usize, 2, 3, 5, 16, 33] {
            let exact: f64 = (0..size * size).map(|t| exact_solid_angle(t % size, t / size, size)).sum();
            assert!((exact - 4.0 * std::f64::consts::PI).abs() < 1e-11, "{size}: {exact}");
            let table = solid_angles(size);
            for (t, angle) in table.iter().enumerate() {
                assert_eq!(*angle, texel_solid_angle(t % size, t / size, size));
            }
        }
        // An octant's texels by eye: 2 × 2 texels are the four quarters of the sphere between the axes.
        assert!((texel_solid_angle(0, 1, 2) - std::f32::consts::PI).abs() < 1e-6);
        for (column, row) in [(3, 200), (128, 128), (70, 61)] {
            let angle = texel_solid_angle(column, row, 256) * 65536.0;
            let expected = jacobian(texel_direction(column, row, 256));
            assert!((angle / expected - 1.0).abs() < 1e-3, "{angle} {expected}");
        }
    }
}
