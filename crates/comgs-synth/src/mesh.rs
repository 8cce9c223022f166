//! Triangle meshes with smooth normals.

use glam::Vec3;

/// Triangles with a normal at each corner. Fronts are counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners.
    pub positions: Vec<Vec3>,
    /// Unit shading normals, one a corner, pointing outwards.
    pub normals: Vec<Vec3>,
    /// Three corner indices a triangle.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Adds a corner and returns its index.
    pub fn corner(&mut self, position: Vec3, normal: Vec3) -> u32 {
        self.positions.push(position);
        self.normals.push(normal);
        (self.positions.len() - 1) as u32
    }

    /// Adds a triangle, unless it has no area.
    pub fn triangle(&mut self, a: u32, b: u32, c: u32) {
        let p = |i: u32| self.positions[i as usize];
        let area2 = (p(b) - p(a)).cross(p(c) - p(a)).length();
        let longest = p(a).distance(p(b)).max(p(b).distance(p(c))).max(p(c).distance(p(a)));
        if area2 > 1e-6 * longest * longest {
            self.triangles.push([a, b, c]);
        }
    }

    /// Adds the quadrilateral a, b, c, d (counter-clockwise) as two triangles.
    pub fn quad(&mut self, a: u32, b: u32, c: u32, d: u32) {
        self.triangle(a, b, c);
        self.triangle(a, c, d);
    }

    /// A grid of `columns × rows` cells over `[0, 1]²`; `at(s, t)` gives position and normal. Counter-clockwise as seen
    /// from where s runs right and t runs up.
    pub(crate) fn grid(&mut self, columns: usize, rows: usize, at: impl Fn(usize, usize) -> (Vec3, Vec3)) {
        let first = self.positions.len() as u32;
        for j in 0..=rows {
            for i in 0..=columns {
                let (p, n) = at(i, j);
                self.corner(p, n);
            }
        }
        let index = |i: usize, j: usize| first + (j * (columns + 1) + i) as u32;
        for j in 0..rows {
            for i in 0..columns {
                self.quad(index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1));
            }
        }
    }

    /// Lowest and highest coordinates; `None` for an empty mesh.
    #[must_use]
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let first = *self.positions.first()?;
        Some(self.positions.iter().fold((first, first), |(lo, hi), &p| (lo.min(p), hi.max(p))))
    }

    /// Six times the enclosed volume would be the sum of the triangles' spanned boxes; this is the volume, positive
    /// for a closed mesh whose fronts look outwards.
    #[must_use]
    pub fn signed_volume(&self) -> f64 {
        self.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| self.positions[i as usize].as_dvec3());
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }
}
