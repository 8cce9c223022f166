//! From a surfel to its linear forms on the screen, and the gradient back.

use crate::RasterConfig;
use comgs_geom::Camera;
use comgs_surfel::activation::sigmoid;
use comgs_surfel::cloud::{normalised_quaternion, rotation_matrix};
use glam::{Mat3, Vec3};

/// The camera in f32, as the kernels use it.
#[derive(Clone, Copy, Debug)]
pub struct ScreenCamera {
    /// Rotation world → camera.
    pub camera_from_world: Mat3,
    /// Camera centre, world space.
    pub centre: Vec3,
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// Principal point in pixels.
    pub principal: [f32; 2],
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
}

impl ScreenCamera {
    /// From a [`Camera`].
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        Self {
            camera_from_world: camera.world_from_camera.matrix3.transpose().as_mat3(),
            centre: camera.centre().as_vec3(),
            focal: [camera.fx as f32, camera.fy as f32],
            principal: [camera.cx as f32, camera.cy as f32],
            width: camera.width,
            height: camera.height,
        }
    }

    /// Camera-space direction with z = 1 through a pixel position.
    #[must_use]
    pub fn ray(&self, x: f32, y: f32) -> Vec3 {
        Vec3::new((x - self.principal[0]) / self.focal[0], (y - self.principal[1]) / self.focal[1], 1.0)
    }
}

/// A surfel on the screen. A form `[a, b, c]` has the value `a·dx + b·dy + c` at pixel offset `(dx, dy)` from
/// `reference`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Projected {
    /// Index of the surfel in the cloud.
    pub surfel: u32,
    /// Pixel position around which the forms are expanded: the projected centre when that is in front.
    pub reference: [f32; 2],
    /// Numerator of u, scaled by 1/s_u.
    pub form_u: [f32; 3],
    /// Numerator of v, scaled by 1/s_v.
    pub form_v: [f32; 3],
    /// n·d, the common denominator.
    pub form_w: [f32; 3],
    /// n·p, the numerator of the depth.
    pub plane: f32,
    /// z-depth of the centre (may be ≤ 0 for a surfel that reaches into view from behind).
    pub depth: f32,
    /// Peak opacity in [0, 1].
    pub opacity: f32,
    /// ρ beyond which the response is below `alpha_min`: 2 ln(opacity / alpha_min).
    pub cut: f32,
    /// 1/σ² of the low-pass filter; 0 switches the filter off for this surfel (centre behind the near plane).
    pub low_pass: f32,
    /// +1 when the surfel's own normal faces the camera, −1 when it must be flipped.
    pub facing: f32,
    /// First and last pixel row (inclusive) that the surfel can touch.
    pub rows: [u16; 2],
}

/// Camera-space geometry of a surfel: what both directions of differentiation need.
#[derive(Clone, Copy, Debug)]
pub struct CameraSurfel {
    /// Centre.
    pub p: Vec3,
    /// Unit tangents and normal as columns.
    pub frame: Mat3,
    /// Standard deviations, world units.
    pub scale: [f32; 2],
}

/// Log-scales beyond this are clamped: e^±40 still squares within f32.
pub const LOG_SCALE_LIMIT: f32 = 40.0;

impl CameraSurfel {
    /// From raw parameters; `None` when the position or a scale is not finite.
    #[must_use]
    pub fn new(
        camera: &ScreenCamera,
        position: [f32; 3],
        rotation: [f32; 4],
        log_scale: [f32; 2],
    ) -> Option<Self> {
        let p = camera.camera_from_world * (Vec3::from_array(position) - camera.centre);
        if !p.is_finite() || log_scale[0].is_nan() || log_scale[1].is_nan() {
            return None;
        }
        let frame = camera.camera_from_world * rotation_matrix(rotation);
        let scale = log_scale.map(|s| s.clamp(-LOG_SCALE_LIMIT, LOG_SCALE_LIMIT).exp());
        Some(Self { p, frame, scale })
    }
}

/// Projects a surfel. `None` when it cannot contribute: not finite, too transparent, or wholly nearer than
/// the near plane. Bounds are filled in by [`crate::bounds`].
#[must_use]
pub fn project(
    camera: &ScreenCamera,
    config: &RasterConfig,
    surfel: u32,
    geometry: &CameraSurfel,
    opacity_logit: f32,
) -> Option<Projected> {
    let opacity = sigmoid(opacity_logit);
    // NaN compares false and is dropped here.
    if !(opacity >= config.alpha_min) {
        return None;
    }
    let cut = 2.0 * (opacity / config.alpha_min).ln();
    let CameraSurfel { p, frame, scale } = *geometry;
    let (tu, tv, n) = (frame.x_axis, frame.y_axis, frame.z_axis);
    let in_front = p.z >= config.near;
    let (reference, ray) = if in_front {
        let ray = p / p.z;
        let x = camera.principal[0] + camera.focal[0] * ray.x;
        let y = camera.principal[1] + camera.focal[1] * ray.y;
        ([x, y], ray)
    } else {
        (camera.principal, Vec3::Z)
    };
    if !reference[0].is_finite() || !reference[1].is_finite() {
        return None;
    }
    let a_u = tv.cross(p) / scale[0];
    let a_v = p.cross(tu) / scale[1];
    let form = |a: Vec3, at_reference: f32| [a.x / camera.focal[0], a.y / camera.focal[1], at_reference];
    // In front, the numerators vanish at the reference exactly; behind, they are evaluated.
    let (u0, v0) = if in_front { (0.0, 0.0) } else { (a_u.dot(ray), a_v.dot(ray)) };
    let plane = n.dot(p);
    Some(Projected {
        surfel,
        reference,
        form_u: form(a_u, u0),
        form_v: form(a_v, v0),
        // At the reference n·d = n·p / p.z, without the rounding of a second dot product.
        form_w: form(n, if in_front { plane / p.z } else { n.dot(ray) }),
        plane,
        depth: p.z,
        opacity,
        cut,
        low_pass: if in_front { config.low_pass_inverse_variance() } else { 0.0 },
        facing: if plane <= 0.0 { 1.0 } else { -1.0 },
        rows: [0, 0],
    })
}

/// Gradient of a loss with respect to the forms of a [`Projected`], summed over pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct ProjectedGradient {
    /// For `form_u`: Σ g dx, Σ g dy, Σ g.
    pub form_u: [f32; 3],
    /// For `form_v`.
    pub form_v: [f32; 3],
    /// For `form_w`.
    pub form_w: [f32; 3],
    /// For `plane`.
    pub plane: f32,
    /// For the projected centre (pixels), through the low-pass filter.
    pub centre: [f32; 2],
    /// For the centre's z-depth, where the low-pass filter decided the depth.
    pub depth: f32,
    /// For the opacity (after the sigmoid).
    pub opacity: f32,
}

/// Gradient with respect to raw surfel parameters.
#[derive(Clone, Copy, Debug, Default)]
pub struct GeometryGradient {
    /// World position.
    pub position: Vec3,
    /// Raw quaternion w, x, y, z; its radial part is zero.
    pub rotation: [f32; 4],
    /// Log scales.
    pub log_scale: [f32; 2],
    /// Opacity logit.
    pub opacity_logit: f32,
}

/// Gradient of [`project`]. `grad_normal_world` is the gradient with respect to the surfel's unit normal in world
/// space as blended into the normal plane (after the flip towards the viewer).
#[must_use]
pub fn project_vjp(
    camera: &ScreenCamera,
    projected: &Projected,
    geometry: &CameraSurfel,
    rotation: [f32; 4],
    log_scale: [f32; 2],
    g: &ProjectedGradient,
    grad_normal_world: Vec3,
) -> GeometryGradient {
    let CameraSurfel { p, frame, scale } = *geometry;
    let (tu, tv, n) = (frame.x_axis, frame.y_axis, frame.z_axis);
    let [fx, fy] = camera.focal;
    let ray = camera.ray(projected.reference[0], projected.reference[1]);
    // A form's value at a pixel is a·d with d = ray + (dx/fx, dy/fy, 0), so ∂/∂a = Σ g d.
    let to_vector = |m: [f32; 3]| ray * m[2] + Vec3::new(m[0] / fx, m[1] / fy, 0.0);
    let (g_u, g_v, g_w) = (to_vector(g.form_u), to_vector(g.form_v), to_vector(g.form_w));

    // a_u = (t_v × p)/s_u, a_v = (p × t_u)/s_v, w = n, plane = n·p.
    let mut grad_tu = g_v.cross(p) / scale[1];
    let mut grad_tv = p.cross(g_u) / scale[0];
    let mut grad_n = g_w + p * g.plane;
    let mut grad_p = g_u.cross(tv) / scale[0] + tu.cross(g_v) / scale[1] + n * g.plane;
    let mut grad_log_scale = [-g_u.dot(tv.cross(p)) / scale[0], -g_v.dot(p.cross(tu)) / scale[1]];
    for axis in 0..2 {
        if log_scale[axis].abs() > LOG_SCALE_LIMIT {
            grad_log_scale[axis] = 0.0;
        }
    }
    if projected.low_pass > 0.0 {
        let (gx, gy) = (g.centre[0] * fx / p.z, g.centre[1] * fy / p.z);
        grad_p += Vec3::new(gx, gy, -(gx * p.x + gy * p.y) / p.z);
    }
    grad_p.z += g.depth;

    let world_from_camera = camera.camera_from_world.transpose();
    grad_tu = world_from_camera * grad_tu;
    grad_tv = world_from_camera * grad_tv;
    grad_n = world_from_camera * grad_n + grad_normal_world * projected.facing;
    GeometryGradient {
        position: world_from_camera * grad_p,
        rotation: quaternion_vjp(rotation, Mat3::from_cols(grad_tu, grad_tv, grad_n)),
        log_scale: grad_log_scale,
        opacity_logit: g.opacity * projected.opacity * (1.0 - projected.opacity),
    }
}

/// Gradient of the rotation matrix (columns) of a normalised quaternion with respect to the raw quaternion.
fn quaternion_vjp(raw: [f32; 4], g: Mat3) -> [f32; 4] {
    let unit = normalised_quaternion(raw);
    let [w, x, y, z] = unit;
    // g[row][column] = ∂L/∂R_{row, column}
    let (c0, c1, c2) = (g.x_axis, g.y_axis, g.z_axis);
    let d_w = 2.0 * (z * (c0.y - c1.x) + y * (c2.x - c0.z) + x * (c1.z - c2.y));
    let d_x = 2.0 * (y * (c0.y + c1.x) + z * (c0.z + c2.x) + w * (c1.z - c2.y) - 2.0 * x * (c1.y + c2.z));
    let d_y = 2.0 * (x * (c0.y + c1.x) + z * (c1.z + c2.y) + w * (c2.x - c0.z) - 2.0 * y * (c0.x + c2.z));
    let d_z = 2.0 * (x * (c0.z + c2.x) + y * (c1.z + c2.y) + w * (c0.y - c1.x) - 2.0 * z * (c0.x + c1.y));
    let d = [d_w, d_x, d_y, d_z];
    let length = raw.iter().map(|v| v * v).sum::<f32>().sqrt();
    if !(length > 1e-20) || !length.is_finite() {
        return [0.0; 4];
    }
    let radial: f32 = (0..4).map(|i| d[i] * unit[i]).sum();
    std::array::from_fn(|i| (d[i] - radial * unit[i]) / length)
}
