//! Initial points of a capture.

use super::{Capture, colmap};
use crate::SceneError;
use comgs_surfel::{PointCloud, ply};
use std::collections::{HashMap, HashSet};
use std::io::BufReader;

/// Points from structure from motion, cleaned of what breaks nearest-neighbour distances.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialPoints {
    /// The points that were kept.
    pub cloud: PointCloud,
    /// Points left out because an earlier one has the very same position.
    pub duplicates: usize,
    /// Points left out because they lie in a camera's centre.
    pub at_cameras: usize,
}

/// A point nearer to a camera than this share of the cameras' extent lies in its centre.
const CAMERA_SHARE: f64 = 1e-4;

pub(super) fn read(capture: &Capture) -> Result<Option<InitialPoints>, SceneError> {
    let Some(path) = &capture.points_path else { return Ok(None) };
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let cloud = if extension == "ply" {
        ply::read_points(path)?
    } else {
        let file = std::fs::File::open(path).map_err(SceneError::io(path))?;
        let length = file.metadata().map_err(SceneError::io(path))?.len();
        let reader = BufReader::with_capacity(1 << 16, file);
        match extension {
            "bin" => colmap::parse_points_binary(reader, length, path)?,
            _ => colmap::parse_points_text(reader, path)?,
        }
    };
    let (_, radius) = capture.extent();
    let centres: Vec<[f64; 3]> = capture.views.iter().map(|v| v.camera.centre().to_array()).collect();
    Ok(Some(cleaned(cloud, &centres, CAMERA_SHARE * radius)))
}

/// Removes exact duplicates and points within `distance` of a camera centre; order is kept.
fn cleaned(cloud: PointCloud, centres: &[[f64; 3]], distance: f64) -> InitialPoints {
    // Cameras in a grid of cells of that size: a point only meets those of its own and the adjoining cells.
    let cell_size = distance.max(1e-12);
    let cell = |p: [f64; 3]| p.map(|v| (v / cell_size).floor() as i64);
    let mut cameras: HashMap<[i64; 3], Vec<[f64; 3]>> = HashMap::new();
    for &centre in centres {
        let [x, y, z] = cell(centre);
        for i in 0..27 {
            let near =
                [x.saturating_add(i % 3 - 1), y.saturating_add(i / 3 % 3 - 1), z.saturating_add(i / 9 - 1)];
            cameras.entry(near).or_default().push(centre);
        }
    }
    let mut seen = HashSet::with_capacity(cloud.len());
    let (mut duplicates, mut at_cameras) = (0, 0);
    let keep: Vec<bool> = cloud
        .positions
        .iter()
        .map(|p| {
            // Adding zero makes −0 equal to 0.
            if !seen.insert(p.map(|v| (v + 0.0).to_bits())) {
                duplicates += 1;
                return false;
            }
            let p = p.map(f64::from);
            let near =
                |c: &[f64; 3]| (0..3).map(|i| (c[i] - p[i]).powi(2)).sum::<f64>() <= cell_size * cell_size;
            let inside = cameras.get(&cell(p)).is_some_and(|centres| centres.iter().any(near));
            at_cameras += usize::from(inside);
            !inside
        })
        .collect();
    let filter = |column: Vec<[f32; 3]>| -> Vec<[f32; 3]> {
        column.into_iter().zip(&keep).filter_map(|(v, &keep)| keep.then_some(v)).collect()
    };
    let cloud = PointCloud {
        positions: filter(cloud.positions),
        colors: cloud.colors.map(filter),
        normals: cloud.normals.map(filter),
    };
    InitialPoints { cloud, duplicates, at_cameras }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: duplicates (±0 included) and points at camera centres go, the rest keeps its order and colours (hard case
    /// 11).
    #[test]
    fn degenerate_points_are_left_out() {
        let positions =
            vec![[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0], [3.0, 0.0, 0.0], [3.0001, 0.0, 0.0], [3.1, 0.0, 0.0]];
        let colors = (0..5).map(|i| [i as f32; 3]).collect();
        let cloud = PointCloud { positions, colors: Some(colors), normals: None };
        let points = cleaned(cloud, &[[3.0, 0.0, 0.0], [9.0, 9.0, 9.0]], 0.01);
        assert_eq!((points.duplicates, points.at_cameras), (1, 2));
        assert_eq!(points.cloud.positions, [[0.0, 1.0, 2.0], [3.1, 0.0, 0.0]]);
        assert_eq!(points.cloud.colors.unwrap(), [[0.0; 3], [4.0; 3]]);
    }
}
