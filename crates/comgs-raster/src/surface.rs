//! Normals of the surface that a frame shows.

use crate::Frame;
use comgs_geom::Camera;
use comgs_image::Image;
use glam::Vec3;
use rayon::prelude::*;

/// Weight of a pixel below which its depth is a mixture of surface and nothing.
const MIN_WEIGHT: f32 = 0.5;
/// Depths of one surface differ by at most this many pixel widths from a pixel to its neighbour (83° of tilt) and
/// across the whole window.
const MAX_JUMP: f32 = 8.0;
/// Normals of one surface agree to 45°, within the window and between depth and blend.
const MIN_COSINE: f32 = std::f32::consts::FRAC_1_SQRT_2;
/// Standard deviation of the window, in pixels.
const SIGMA_PX: f32 = 2.0;
/// Half the side of the window.
const RADIUS: usize = 4;

/// Unit normals, world space, of the surface through the unbiased depths D/W; 3 channels, zero where the weight is zero
/// or there is no normal. `None` without depth and normal planes.
///
/// Use these to shade and to measure, and the blended plane N/W to train. N/W leans towards the eye on every curved surface,
/// whatever the surfels' own normals: of the discs that overlap at a pixel those nearer to the eye come first, and these are the
/// ones that face it more (on the captured cow by 3° at surfels of 3 pixels). The depths have no such lean, only noise, so a pixel's
/// normal is
///
/// ```text
/// n_i = Σ_j g(|x_j − x_i|) m_j, normalised
/// m_j = (x_down − x_up) × (x_right − x_left), normalised, from the unbiased depths of the four neighbours of j
/// ```
///
/// with a Gaussian g of 2 pixels over the pixels j of one surface with i: depths within 8 pixel widths, m_j and m_i within 45°.
/// Where a neighbour lies beyond a depth jump or has a weight below ½, or where m_j and the blended normal differ by more than
/// 45°, the blended normal takes the place of m_j: silhouettes, contacts, things thinner than two pixels.
///
/// Scale-free. Not differentiated: optimisers take it as a constant and bind the blended plane to the depths by a loss of
/// its own (ComGS Eq. 3).
#[must_use]
pub fn surface_normals(frame: &Frame, camera: &Camera) -> Option<Image> {
    let blended = frame.normal.as_ref()?;
    frame.depth.as_ref()?;
    let depth = frame.unbiased_depth(MIN_WEIGHT);
    let (width, height) = (depth.width, depth.height);
    let rotation = camera.world_from_camera.matrix3.as_mat3();
    let (fx, fy) = (camera.fx as f32, camera.fy as f32);
    let (cx, cy) = (camera.cx as f32, camera.cy as f32);
    let point = |x: usize, y: usize| {
        Vec3::new((x as f32 + 0.5 - cx) / fx, (y as f32 + 0.5 - cy) / fy, 1.0) * depth.data[y * width + x]
    };
    let jump = MAX_JUMP / fx.min(fy);
    let one_surface = |i: usize, j: usize| {
        let (a, b) = (depth.data[i], depth.data[j]);
        a > 0.0 && b > 0.0 && (a - b).abs() <= jump * a.min(b)
    };
    let local: Vec<Vec3> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let n = Vec3::from_slice(&blended.data[3 * i..]).normalize_or_zero();
            let (x, y) = (i % width, i / width);
            if x == 0 || y == 0 || x + 1 >= width || y + 1 >= height {
                return n;
            }
            if ![i - 1, i + 1, i - width, i + width].iter().all(|&j| one_surface(i, j)) {
                return n;
            }
            let across = point(x + 1, y) - point(x - 1, y);
            let down = point(x, y + 1) - point(x, y - 1);
            // x right, y down, z forward: down × across points back at the camera.
            let m = rotation * down.cross(across).normalize_or_zero();
            if m.dot(n) >= MIN_COSINE { m } else { n }
        })
        .collect();
    let gaussian: Vec<f32> = (0..=RADIUS).map(|d| (-0.5 * (d as f32 / SIGMA_PX).powi(2)).exp()).collect();
    let mut out = Image::zeros(width, height, 3);
    out.data.par_chunks_mut((3 * width).max(1)).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
            let i = y * width + x;
            let centre = local[i];
            if centre == Vec3::ZERO {
                continue;
            }
            let mut sum = centre;
            for v in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
                for u in x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width) {
                    let j = v * width + u;
                    if j != i && one_surface(i, j) && local[j].dot(centre) >= MIN_COSINE {
                        sum += gaussian[u.abs_diff(x)] * gaussian[v.abs_diff(y)] * local[j];
                    }
                }
            }
            pixel.copy_from_slice(&sum.normalize_or_zero().to_array());
        }
    });
    Some(out)
}
