//! A prior on the blended normals: they vary linearly across a surface, with gradients.

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_raster::Frame;
use glam::Vec3;
use rayon::prelude::*;

/// Weights below this are too thin to have a normal.
const MIN_WEIGHT: f32 = 0.3;
/// Two pixels whose unbiased depths differ by more than this many times their distance on the surface seen head-on lie
/// on different surfaces (8: tilted by 83°).
const MAX_SLOPE: f32 = 8.0;

/// Mean over all pixels and both image axes of `W̄ · φ(|N̂(x−k) − 2 N̂(x) + N̂(x+k)|²)`, N̂ = N/W, with the robust error
/// of Lorentz, `φ(s) = σ/2 · ln(1 + s/σ²)`; the gradients are added to the planes of premultiplied normal and weight.
///
/// * `stride`: k in pixels
/// * `scale`: σ; second differences well above it (creases) are hardly pulled at, those below are smoothed
///
/// A sphere or a cylinder costs next to nothing: their normals bend by the square of k over the radius. What costs is a
/// normal that leaves its neighbours' course and returns, as a texture's edge leaves in a surface when splats shift or
/// tilt to sharpen it. The image is not asked: an edge of the texture must not switch the term off just there.
///
/// Triples that touch a weight below 0.3 or a depth step of more than eight times the pixels' distance do not count. The
/// factor W̄ in front is the centre's weight, held constant. Smooth except where a triple enters or leaves the set that
/// counts. Returns the value times `weight`.
pub fn normal_bend(
    frame: &Frame,
    camera: &Camera,
    weight: f32,
    stride: usize,
    scale: f32,
    grad_normal: &mut Image,
    grad_weight: &mut Image,
) -> f32 {
    let (Some(normal), Some(depth)) = (&frame.normal, &frame.depth) else { return 0.0 };
    let (width, height) = (depth.width, depth.height);
    let n = width * height;
    if stride == 0 || n == 0 || weight == 0.0 {
        return 0.0;
    }
    let unit: Vec<Vec3> = normal
        .data
        .chunks_exact(3)
        .zip(&frame.weight.data)
        .map(|(n, w)| if *w >= MIN_WEIGHT { Vec3::from_slice(n) / *w } else { Vec3::ZERO })
        .collect();
    let z: Vec<f32> = depth
        .data
        .iter()
        .zip(&frame.weight.data)
        .map(|(d, w)| if *w >= MIN_WEIGHT { d / w } else { 0.0 })
        .collect();
    let step = [MAX_SLOPE * stride as f32 / camera.fx as f32, MAX_SLOPE * stride as f32 / camera.fy as f32];
    let factor = weight / (2 * n) as f32;
    // For each pixel as a centre the derivative by the second difference along x and along y; zero where none counts.
    let mut by_bend = vec![[Vec3::ZERO; 2]; n];
    let value: f64 = by_bend
        .par_chunks_mut(width)
        .enumerate()
        .map(|(y, row)| {
            let mut sum = 0.0f64;
            for (x, out) in row.iter_mut().enumerate() {
                let i = y * width + x;
                let here = z[i];
                if here <= 0.0 {
                    continue;
                }
                for axis in 0..2 {
                    let (at, size, offset) =
                        if axis == 0 { (x, width, stride) } else { (y, height, stride * width) };
                    if at < stride || at + stride >= size {
                        continue;
                    }
                    let (a, b) = (i - offset, i + offset);
                    let far = step[axis] * here;
                    if z[a] <= 0.0 || z[b] <= 0.0 || (z[a] - here).abs() > far || (z[b] - here).abs() > far {
                        continue;
                    }
                    let bend = unit[a] - 2.0 * unit[i] + unit[b];
                    let s = bend.length_squared();
                    let w = frame.weight.data[i];
                    sum += f64::from(w * 0.5 * scale * (s / (scale * scale)).ln_1p());
                    out[axis] = bend * (factor * w * scale / (scale * scale + s));
                }
            }
            sum
        })
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    grad_normal
        .data
        .par_chunks_mut(3 * width)
        .zip(grad_weight.data.par_chunks_mut(width))
        .enumerate()
        .for_each(|(y, (grad_normal, grad_weight))| {
            for x in 0..width {
                let i = y * width + x;
                let w = frame.weight.data[i];
                if w < MIN_WEIGHT {
                    continue;
                }
                let mut g = -2.0 * (by_bend[i][0] + by_bend[i][1]);
                if x >= stride {
                    g += by_bend[i - stride][0];
                }
                if x + stride < width {
                    g += by_bend[i + stride][0];
                }
                if y >= stride {
                    g += by_bend[i - stride * width][1];
                }
                if y + stride < height {
                    g += by_bend[i + stride * width][1];
                }
                for k in 0..3 {
                    grad_normal[3 * x + k] += g[k] / w;
                }
                grad_weight[x] -= g.dot(unit[i]) / w;
            }
        });
    weight * (value / (2 * n) as f64) as f32
}
