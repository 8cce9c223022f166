//! Polygons of an implicit surface: naive surface nets (Gibson 1998), one corner in every grid cell that the surface
//! crosses, one quadrilateral for every grid edge that it crosses.

use crate::mesh::Mesh;
use glam::Vec3;

/// Meshes `{p : field(p) = 0}` inside the box from `low` to `high`; negative is inside. `cells` counts along the
/// longest side. The surface must not reach the box's border. Normals are the field's gradient.
pub(crate) fn mesh_of(field: impl Fn(Vec3) -> f32, low: Vec3, high: Vec3, cells: usize) -> Mesh {
    let step = (high - low).max_element() / cells as f32;
    let n = ((high - low) / step).ceil().as_uvec3().max(glam::UVec3::ONE);
    let (nx, ny, nz) = (n.x as usize, n.y as usize, n.z as usize);
    let point = |x: usize, y: usize, z: usize| low + step * Vec3::new(x as f32, y as f32, z as f32);
    let mut values = Vec::with_capacity((nx + 1) * (ny + 1) * (nz + 1));
    for z in 0..=nz {
        for y in 0..=ny {
            for x in 0..=nx {
                values.push(field(point(x, y, z)));
            }
        }
    }
    let value = |x: usize, y: usize, z: usize| values[(z * (ny + 1) + y) * (nx + 1) + x];
    let gradient = |p: Vec3| {
        let h = 0.05 * step;
        let d = |axis: Vec3| field(p + h * axis) - field(p - h * axis);
        Vec3::new(d(Vec3::X), d(Vec3::Y), d(Vec3::Z)).normalize_or(Vec3::Z)
    };

    let mut mesh = Mesh::default();
    const NONE: u32 = u32::MAX;
    let mut corner_of = vec![NONE; nx * ny * nz];
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                // The mean of the crossings on the cell's twelve edges.
                let (mut sum, mut crossings) = (Vec3::ZERO, 0);
                for axis in 0..3 {
                    for side in 0..4 {
                        let (s, t) = (side & 1, side >> 1);
                        let (a, b) = match axis {
                            0 => ((x, y + s, z + t), (x + 1, y + s, z + t)),
                            1 => ((x + s, y, z + t), (x + s, y + 1, z + t)),
                            _ => ((x + s, y + t, z), (x + s, y + t, z + 1)),
                        };
                        let (va, vb) = (value(a.0, a.1, a.2), value(b.0, b.1, b.2));
                        if (va < 0.0) != (vb < 0.0) {
                            sum += point(a.0, a.1, a.2).lerp(point(b.0, b.1, b.2), va / (va - vb));
                            crossings += 1;
                        }
                    }
                }
                if crossings > 0 {
                    let mut p = sum / crossings as f32;
                    // Two Newton steps put the corner on the surface itself instead of inside its chords.
                    for _ in 0..2 {
                        let g = gradient(p);
                        p -= g * field(p).clamp(-0.3 * step, 0.3 * step);
                    }
                    corner_of[(z * ny + y) * nx + x] = mesh.corner(p, gradient(p));
                }
            }
        }
    }
    let corner = |x: usize, y: usize, z: usize| corner_of[(z * ny + y) * nx + x];
    for z in 1..nz {
        for y in 1..ny {
            for x in 1..nx {
                let inside = value(x, y, z) < 0.0;
                // The four cells around each edge that leaves this point, counter-clockwise seen against its axis.
                let around = [
                    (value(x + 1, y, z), [(x, y - 1, z - 1), (x, y, z - 1), (x, y, z), (x, y - 1, z)]),
                    (value(x, y + 1, z), [(x - 1, y, z - 1), (x - 1, y, z), (x, y, z), (x, y, z - 1)]),
                    (value(x, y, z + 1), [(x - 1, y - 1, z), (x, y - 1, z), (x, y, z), (x - 1, y, z)]),
                ];
                for (other, cells) in around {
                    if inside != (other < 0.0) {
                        let [a, b, c, d] = cells.map(|(x, y, z)| corner(x, y, z));
                        if inside { mesh.quad(a, b, c, d) } else { mesh.quad(d, c, b, a) }
                    }
                }
            }
        }
    }
    mesh
}
