//! Where training starts: near the answer, so that few steps are needed.

pub mod background;
pub mod hull;
pub mod sweep;

use comgs_image::transfer::srgb_from_linear;
use comgs_surfel::activation::logit;
use comgs_surfel::{ColorEncoding, SurfelCloud};
use glam::{Quat, Vec3};

/// A point on a surface from which a surfel is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// World position.
    pub position: Vec3,
    /// Unit normal, world space.
    pub normal: Vec3,
    /// Linear radiance.
    pub radiance: Vec3,
    /// Distance to its neighbours: the surfel's standard deviation is half of it.
    pub spacing: f32,
}

/// Peak opacity of a new surfel.
const INITIAL_OPACITY: f32 = 0.6;

/// Surfels of degree 0 at surface points.
#[must_use]
pub fn surfels(points: &[SurfacePoint], encoding: ColorEncoding) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, encoding);
    for p in points {
        let normal = p.normal.normalize_or(Vec3::Z);
        let q = Quat::from_rotation_arc(Vec3::Z, normal);
        cloud.positions.push(p.position.to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        let log_scale = (0.5 * p.spacing).max(1e-12).ln();
        cloud.log_scales.push([log_scale; 2]);
        cloud.opacity_logits.push(logit(INITIAL_OPACITY));
        for c in p.radiance.to_array() {
            let code = match encoding {
                ColorEncoding::Srgb => srgb_from_linear(c.max(0.0)),
                ColorEncoding::Linear => c,
            };
            cloud.sh.push((code - 0.5) / comgs_geom::sh::C0);
        }
    }
    cloud
}

/// Surface points from structure-from-motion points: spacing from the mean distance of the three nearest neighbours,
/// normals towards the mean camera. Duplicates (distance 0) and non-finite points are dropped (hard case 11).
#[must_use]
pub fn from_points(positions: &[Vec3], radiance: &[Vec3], towards: Vec3, largest: f32) -> Vec<SurfacePoint> {
    let mut seen = std::collections::HashSet::new();
    let keep: Vec<usize> = (0..positions.len())
        .filter(|&i| positions[i].is_finite() && seen.insert(positions[i].to_array().map(f32::to_bits)))
        .collect();
    let points: Vec<Vec3> = keep.iter().map(|&i| positions[i]).collect();
    let spacing = neighbour_distance(&points, largest);
    keep.iter()
        .zip(spacing)
        .map(|(&i, spacing)| SurfacePoint {
            position: positions[i],
            normal: (towards - positions[i]).normalize_or(Vec3::Z),
            radiance: radiance.get(i).copied().unwrap_or(Vec3::splat(0.2)),
            spacing,
        })
        .collect()
}

/// Mean distance to the three nearest neighbours, at most `largest`, by a hash grid of that cell size or finer.
fn neighbour_distance(points: &[Vec3], largest: f32) -> Vec<f32> {
    use rayon::prelude::*;
    use std::collections::HashMap;
    if points.is_empty() {
        return Vec::new();
    }
    let (low, high) = points.iter().fold((points[0], points[0]), |(l, h), p| (l.min(*p), h.max(*p)));
    let volume_cell = (high - low).max_element() / (points.len() as f32).sqrt().max(1.0) * 2.0;
    let cell = volume_cell.min(largest).max(1e-9);
    let key = |p: Vec3| ((p - low) / cell).floor().as_i64vec3();
    let mut grid: HashMap<glam::I64Vec3, Vec<u32>> = HashMap::new();
    for (i, p) in points.iter().enumerate() {
        grid.entry(key(*p)).or_default().push(i as u32);
    }
    points
        .par_iter()
        .enumerate()
        .map(|(i, p)| {
            let centre = key(*p);
            let mut best = [f32::INFINITY; 3];
            for dz in -1..=1 {
                for dy in -1..=1 {
                    for dx in -1..=1 {
                        for &j in grid.get(&(centre + glam::I64Vec3::new(dx, dy, dz))).map_or(&[][..], |v| v)
                        {
                            if j as usize == i {
                                continue;
                            }
                            let d = points[j as usize].distance(*p);
                            if d < best[2] {
                                best[2] = d;
                                best.sort_by(f32::total_cmp);
                            }
                        }
                    }
                }
            }
            let found: Vec<f32> = best.iter().copied().filter(|d| d.is_finite()).collect();
            if found.is_empty() {
                cell
            } else {
                (found.iter().sum::<f32>() / found.len() as f32).min(largest)
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hard case 11. Goal: duplicate and non-finite points are dropped, spacing is positive and bounded.
    #[test]
    fn points_with_duplicates() {
        let mut positions: Vec<Vec3> = (0..50).map(|i| Vec3::new(i as f32 * 0.1, 0.0, 0.0)).collect();
        positions.extend([positions[3], positions[3], Vec3::NAN, Vec3::splat(1e6)]);
        let points = from_points(&positions, &[], Vec3::new(0.0, -5.0, 0.0), 2.0);
        assert_eq!(points.len(), 51);
        for p in &points {
            assert!(p.spacing > 0.0 && p.spacing <= 2.0 && p.normal.is_normalized());
        }
        assert!((points[20].spacing - 0.1333).abs() < 0.02, "{}", points[20].spacing);
    }

    /// Goal: a surfel has the point's colour in both encodings.
    #[test]
    fn surfels_have_the_points_colour() {
        let point = SurfacePoint {
            position: Vec3::ZERO,
            normal: Vec3::X,
            radiance: Vec3::new(0.2, 0.01, 3.0),
            spacing: 0.1,
        };
        for encoding in [ColorEncoding::Srgb, ColorEncoding::Linear] {
            let cloud = surfels(&[point], encoding);
            assert!((cloud.radiance(0, Vec3::Y) - point.radiance).length() < 1e-4);
            assert!((cloud.rotation(0).z_axis - Vec3::X).length() < 1e-5);
        }
    }
}
