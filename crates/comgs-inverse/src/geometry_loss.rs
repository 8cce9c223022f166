//! The geometric terms: depth-normal consistency (ComGS Eq. 3) and mask cross-entropy (Eq. 4), with gradients.

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_raster::Frame;
use glam::Vec3;
use rayon::prelude::*;

/// Weights below this are too thin to have a depth.
const MIN_WEIGHT: f32 = 0.3;
/// Neighbours whose depths differ by more than this many times the width of a pixel there lie on different surfaces: no
/// normal across the jump (8: a surface tilted by 83°).
const MAX_SLOPE: f32 = 8.0;

/// Mean over all pixels of `W · (1 − N̂ · N_d)`, the gradients of which are added to the premultiplied normal and depth
/// planes and the weight plane.
///
/// N_d is the normal of the surface through the unbiased depths D/W of the four neighbours, facing the camera; N̂ = N/W is
/// the blended normal. Pixels at the image's border, where a neighbour's weight is below 0.3, or across a depth jump of
/// more than eight times a pixel's width have no normal from depth and do not count. The factor W in front is taken as a constant (as in
/// 2DGS), so that the term cannot be lowered by fading the surface out. Scale-free: the same scene ×1000 gives the same
/// value.
///
/// Returns the value. Kinks only where a pixel enters or leaves the set that counts.
pub fn depth_normal(
    frame: &Frame,
    camera: &Camera,
    weight: f32,
    grad_normal: &mut Image,
    grad_depth: &mut Image,
    grad_weight: &mut Image,
) -> f32 {
    let (Some(normal), Some(depth)) = (&frame.normal, &frame.depth) else { return 0.0 };
    let (width, height) = (depth.width, depth.height);
    if width < 3 || height < 3 {
        return 0.0;
    }
    let rotation = camera.world_from_camera.matrix3.as_mat3();
    let world = |v: Vec3| rotation * v;
    let (fx, fy) = (camera.fx as f32, camera.fy as f32);
    let (cx, cy) = (camera.cx as f32, camera.cy as f32);
    let unbiased: Vec<f32> = depth
        .data
        .iter()
        .zip(&frame.weight.data)
        .map(|(d, w)| if *w >= MIN_WEIGHT { d / w } else { 0.0 })
        .collect();
    let ray = |x: usize, y: usize| Vec3::new((x as f32 + 0.5 - cx) / fx, (y as f32 + 0.5 - cy) / fy, 1.0);
    let scale = weight / (width * height) as f32;
    let max_jump = MAX_SLOPE / fx.min(fy);

    // Per pixel: the gradient with respect to the four neighbours' unbiased depths (left, right, up, down).
    let mut to_neighbours = vec![[0.0f32; 4]; width * height];
    let value: f64 = to_neighbours
        .par_chunks_mut(width)
        .zip(grad_normal.data.par_chunks_mut(3 * width))
        .enumerate()
        .map(|(y, (to_neighbours, grad_normal))| {
            let mut sum = 0.0f64;
            if y == 0 || y + 1 == height {
                return 0.0;
            }
            for x in 1..width - 1 {
                let i = y * width + x;
                let here = unbiased[i];
                let z = [unbiased[i - 1], unbiased[i + 1], unbiased[i - width], unbiased[i + width]];
                if here <= 0.0 || z.iter().any(|z| *z <= 0.0 || (z - here).abs() > max_jump * here) {
                    continue;
                }
                let rays = [ray(x - 1, y), ray(x + 1, y), ray(x, y - 1), ray(x, y + 1)];
                let a = rays[1] * z[1] - rays[0] * z[0];
                let b = rays[3] * z[3] - rays[2] * z[2];
                // x right, y down, z forward: b × a points back at the camera.
                let c = b.cross(a);
                let length = c.length();
                // Too small for a direction (denormal), relative to the size of the factors.
                if !(length > 1e-12 * (a.length() * b.length()).max(1e-30)) {
                    continue;
                }
                let n_depth = c / length;
                let w = frame.weight.data[i];
                let n = Vec3::from_slice(&normal.data[3 * i..3 * i + 3]) / w;
                let n_depth_world = world(n_depth);
                sum += f64::from(w * (1.0 - n.dot(n_depth_world)));
                // L = W̄ (1 − N·N_d / W): the outer W̄ cancels the 1/W of the normal.
                let g = -scale * n_depth_world;
                for k in 0..3 {
                    grad_normal[3 * x + k] += g[k];
                }
                let g_direction = rotation.transpose() * (-scale * w * n);
                let g_c = (g_direction - n_depth * n_depth.dot(g_direction)) / length;
                // c = b × a: ∂/∂b = a × g, ∂/∂a = g × b
                let (g_b, g_a) = (a.cross(g_c), g_c.cross(b));
                to_neighbours[x] = [-g_a.dot(rays[0]), g_a.dot(rays[1]), -g_b.dot(rays[2]), g_b.dot(rays[3])];
            }
            sum
        })
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    // Gather what each pixel got from its neighbours, and go through D/W.
    grad_depth.data.par_chunks_mut(width).zip(grad_weight.data.par_chunks_mut(width)).enumerate().for_each(
        |(y, (grad_depth, grad_weight))| {
            for x in 0..width {
                let i = y * width + x;
                let z = unbiased[i];
                if z <= 0.0 {
                    continue;
                }
                let mut g = 0.0;
                if x + 1 < width {
                    g += to_neighbours[i + 1][0];
                }
                if x > 0 {
                    g += to_neighbours[i - 1][1];
                }
                if y + 1 < height {
                    g += to_neighbours[i + width][2];
                }
                if y > 0 {
                    g += to_neighbours[i - width][3];
                }
                let w = frame.weight.data[i];
                grad_depth[x] += g / w;
                grad_weight[x] -= g * z / w;
            }
        },
    );
    weight * (value / (width * height) as f64) as f32
}

/// Weights are kept this far from 0 and 1 inside the logarithms.
const CLAMP: f32 = 1e-4;

/// Mean of `−K log W − (1 − K) log(1 − W)` (Eq. 4); the gradient is added. W is clamped to [1e-4, 1 − 1e-4], and the
/// gradient is 0 where the clamp bites and the mask agrees.
pub fn mask_cross_entropy(rendered: &Image, mask: &Image, weight: f32, grad_weight: &mut Image) -> f32 {
    let n = rendered.pixels().max(1) as f32;
    let mut sum = 0.0f64;
    for ((w, k), g) in rendered.data.iter().zip(&mask.data).zip(&mut grad_weight.data) {
        let c = w.clamp(CLAMP, 1.0 - CLAMP);
        sum -= f64::from(k * c.ln() + (1.0 - k) * (1.0 - c).ln());
        let agrees = (*w <= CLAMP && *k <= CLAMP) || (*w >= 1.0 - CLAMP && *k >= 1.0 - CLAMP);
        if !agrees {
            *g += weight / n * (-k / c + (1.0 - k) / (1.0 - c));
        }
    }
    weight * (sum / f64::from(n)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;
    use comgs_raster::Planes;
    use glam::DVec3;

    fn camera() -> Camera {
        Camera::look_at("a", 12, 10, 0.8, DVec3::new(1.0, -3.0, 1.0), DVec3::ZERO, DVec3::Z)
    }

    /// A frame that shows the plane through the origin with unit normal `n` (world).
    fn plane_frame(camera: &Camera, n: DVec3, scale: f64) -> Frame {
        let mut frame = Frame::zeros(camera.width, camera.height, Planes::GEOMETRY);
        let mut rng = Rng::new(3);
        for y in 0..camera.height {
            for x in 0..camera.width {
                let i = y * camera.width + x;
                let d = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
                let z = -n.dot(camera.centre()) / n.dot(d) * scale;
                let w = rng.range(0.6, 1.0);
                frame.weight.data[i] = w;
                frame.depth.as_mut().unwrap().data[i] = w * z as f32;
                for k in 0..3 {
                    frame.normal.as_mut().unwrap().data[3 * i + k] = w * n[k] as f32;
                }
            }
        }
        frame
    }

    fn evaluate(frame: &Frame, camera: &Camera) -> (f32, Image, Image, Image) {
        let zero = |c| Image::zeros(camera.width, camera.height, c);
        let (mut n, mut d, mut w) = (zero(3), zero(1), zero(1));
        let value = depth_normal(frame, camera, 1.0, &mut n, &mut d, &mut w);
        (value, n, d, w)
    }

    /// Goal: a plane agrees with itself (value 0), the opposite normal costs 2 a pixel, whatever the scale.
    #[test]
    fn a_plane_agrees_with_itself() {
        let camera = camera();
        let n = DVec3::new(0.2, -0.9, 0.4).normalize();
        for scale in [1.0, 1e-3, 1e3] {
            let frame = plane_frame(&camera, n, scale);
            assert!(evaluate(&frame, &camera).0.abs() < 1e-4, "{}", evaluate(&frame, &camera).0);
        }
        let mut flipped = plane_frame(&camera, n, 1.0);
        flipped.normal.as_mut().unwrap().data.iter_mut().for_each(|v| *v = -*v);
        assert!(evaluate(&flipped, &camera).0 > 1.0);
    }

    /// Goal: gradients of value with respect to normal, depth and weight planes match central differences; the outer weight is a
    /// constant by definition, so it is held fixed through its ratio.
    #[test]
    fn gradients_match_differences() {
        let camera = camera();
        let mut frame = plane_frame(&camera, DVec3::new(0.2, -0.9, 0.4).normalize(), 1.0);
        let mut rng = Rng::new(8);
        for v in &mut frame.normal.as_mut().unwrap().data {
            *v += 0.3 * rng.normal();
        }
        for v in &mut frame.depth.as_mut().unwrap().data {
            *v *= rng.range(0.99, 1.01);
        }
        let (_, gn, gd, gw) = evaluate(&frame, &camera);
        let h = 1e-3f32;
        for i in (0..camera.width * camera.height).step_by(5) {
            let check = |name: &str, analytic: f32, change: &dyn Fn(&mut Frame, f32), size: f32| {
                let (mut plus, mut minus) = (frame.clone(), frame.clone());
                change(&mut plus, h * size);
                change(&mut minus, -h * size);
                let numeric = (evaluate(&plus, &camera).0 - evaluate(&minus, &camera).0) / (2.0 * h * size);
                assert!(
                    (numeric - analytic).abs() < 0.03 * numeric.abs().max(0.02),
                    "{name} {i}: {numeric} {analytic}"
                );
            };
            check("normal", gn.data[3 * i + 1], &|f, h| f.normal.as_mut().unwrap().data[3 * i + 1] += h, 1.0);
            check("depth", gd.data[i], &|f, h| f.depth.as_mut().unwrap().data[i] += h, 1.0);
        }
        // Scaling weight and depth of a pixel together leaves D/W; the weight's gradient must be the opposite of the depth's
        // along that direction.
        for i in 0..camera.width * camera.height {
            let along =
                gd.data[i] * frame.depth.as_ref().unwrap().data[i] + gw.data[i] * frame.weight.data[i];
            assert!(along.abs() < 1e-5);
        }
        assert!(gd.data.iter().any(|v| v.abs() > 1e-3));
    }

    /// Hard case 12. Goal: empty frames, thin weights and depth jumps give no gradient and no NaN.
    #[test]
    fn holes_borders_and_jumps() {
        let camera = camera();
        let empty = Frame::zeros(12, 10, Planes::GEOMETRY);
        let (value, n, d, w) = evaluate(&empty, &camera);
        assert_eq!(value, 0.0);
        assert!(n.data.iter().chain(&d.data).chain(&w.data).all(|v| *v == 0.0));
        let mut jump = plane_frame(&camera, DVec3::new(0.0, -1.0, 0.0), 1.0);
        for y in 0..10 {
            for x in 6..12 {
                jump.depth.as_mut().unwrap().data[y * 12 + x] *= 3.0;
            }
        }
        let (_, _, d, _) = evaluate(&jump, &camera);
        for y in 1..9 {
            // Columns 5 and 6 are neighbours across the jump: their centres do not count.
            assert!(d.data[y * 12 + 5].is_finite() && d.data[y * 12 + 6].is_finite());
        }
        assert!(evaluate(&jump, &camera).0 < 1e-3);
    }

    /// Hard case 12. Goal: cross-entropy at weights and masks of exactly 0 and 1 is finite, zero where they agree, and its
    /// gradient points the right way where they do not.
    #[test]
    fn mask_extremes() {
        let rendered = Image::from_data(4, 1, 1, vec![0.0, 1.0, 0.0, 1.0]);
        let mask = Image::from_data(4, 1, 1, vec![0.0, 1.0, 1.0, 0.0]);
        let mut g = Image::zeros(4, 1, 1);
        let value = mask_cross_entropy(&rendered, &mask, 1.0, &mut g);
        assert!(value.is_finite() && value > 1.0);
        assert_eq!(&g.data[..2], &[0.0, 0.0]);
        assert!(g.data[2] < 0.0 && g.data[3] > 0.0 && g.data.iter().all(|v| v.is_finite()));
    }
}
