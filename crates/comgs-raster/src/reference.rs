//! The specification: the same rendering in scalar f64, every surfel at every pixel, no tiles, no bounds. It shares
//! no code with the kernels (its harmonics are its own), so it can be their judge.

use crate::config::{LowPass, RasterConfig};
use comgs_geom::Camera;
use comgs_surfel::{ColorEncoding, SurfelCloud};
use glam::{DMat3, DQuat, DVec3};

/// A surfel with raw parameters in f64.
#[derive(Clone, Debug)]
pub struct ReferenceSurfel {
    /// World position.
    pub position: [f64; 3],
    /// Quaternion w, x, y, z.
    pub rotation: [f64; 4],
    /// Log scales.
    pub log_scale: [f64; 2],
    /// Opacity logit.
    pub opacity_logit: f64,
    /// Harmonics `[coefficient][rgb]`.
    pub sh: Vec<f64>,
    /// Logits of albedo RGB, roughness, metallic.
    pub material: [f64; 5],
}

/// A cloud in f64.
#[derive(Clone, Debug)]
pub struct ReferenceCloud {
    /// The surfels.
    pub surfels: Vec<ReferenceSurfel>,
    /// What the harmonics mean.
    pub encoding: ColorEncoding,
}

/// Planes of one pixel: colour 3, weight, depth, normal 3, material 5.
pub type Pixel = [f64; 13];

impl ReferenceCloud {
    /// From a cloud.
    #[must_use]
    pub fn new(cloud: &SurfelCloud) -> Self {
        let surfels = (0..cloud.len())
            .map(|i| ReferenceSurfel {
                position: cloud.positions[i].map(f64::from),
                rotation: cloud.rotations[i].map(f64::from),
                log_scale: cloud.log_scales[i].map(f64::from),
                opacity_logit: cloud.opacity_logits[i].into(),
                sh: cloud.sh_of(i).iter().map(|&v| v.into()).collect(),
                material: cloud.material.as_ref().map_or([0.0; 5], |m| {
                    let a = m.albedo_logits[i];
                    [a[0], a[1], a[2], m.roughness_logits[i], m.metallic_logits[i]].map(f64::from)
                }),
            })
            .collect();
        Self { surfels, encoding: cloud.color_encoding }
    }
}

/// Renders all planes, row by row.
#[must_use]
pub fn render(cloud: &ReferenceCloud, camera: &Camera, config: &RasterConfig) -> Vec<Pixel> {
    struct Prepared {
        p: DVec3,
        frame: DMat3,
        scale: [f64; 2],
        opacity: f64,
        centre: Option<[f64; 2]>,
        attributes: [f64; 11],
    }
    let camera_from_world = camera.camera_from_world();
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let mut prepared: Vec<Prepared> = Vec::new();
    for s in &cloud.surfels {
        let opacity = sigmoid(s.opacity_logit);
        if !(opacity >= f64::from(config.alpha_min)) {
            continue;
        }
        let position = DVec3::from_array(s.position);
        let p = camera_from_world.transform_point3(position);
        let [w, x, y, z] = s.rotation;
        let frame = camera_from_world.matrix3 * DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let facing = if frame.z_axis.dot(p) <= 0.0 { 1.0 } else { -1.0 };
        let normal = camera.world_from_camera.matrix3 * frame.z_axis * facing;
        let color = radiance(&s.sh, cloud.encoding, (position - camera.centre()).normalize());
        let m = s.material.map(sigmoid);
        let centre = (p.z >= f64::from(config.near))
            .then(|| [camera.cx + camera.fx * p.x / p.z, camera.cy + camera.fy * p.y / p.z]);
        prepared.push(Prepared {
            p,
            frame,
            scale: s.log_scale.map(|v| v.clamp(-40.0, 40.0).exp()),
            opacity,
            centre,
            attributes: [
                color[0], color[1], color[2], normal.x, normal.y, normal.z, m[0], m[1], m[2], m[3], m[4],
            ],
        });
    }
    prepared.sort_by(|a, b| (a.p.z as f32).total_cmp(&(b.p.z as f32)));
    let mut pixels = Vec::with_capacity(camera.width * camera.height);
    for row in 0..camera.height {
        for column in 0..camera.width {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            let d = camera.ray_camera(x, y);
            let mut out = [0.0; 13];
            let mut transmittance = 1.0;
            for s in &prepared {
                let n = s.frame.z_axis;
                let z = n.dot(s.p) / n.dot(d);
                let hit = d * z - s.p;
                let u = s.frame.x_axis.dot(hit) / s.scale[0];
                let v = s.frame.y_axis.dot(hit) / s.scale[1];
                let rho_exact = u * u + v * v;
                let rho_low_pass = match (s.centre, config.low_pass) {
                    (Some(c), LowPass::Sigma(sigma)) => {
                        ((x - c[0]).powi(2) + (y - c[1]).powi(2)) / f64::from(sigma).powi(2)
                    }
                    _ => f64::INFINITY,
                };
                let exact = z >= f64::from(config.near) && rho_exact <= rho_low_pass;
                let (rho, depth) = if exact { (rho_exact, z) } else { (rho_low_pass, s.p.z) };
                let response = s.opacity * (-0.5 * rho).exp();
                if !(response >= f64::from(config.alpha_min)) {
                    continue;
                }
                let alpha = response.min(f64::from(config.alpha_max));
                if transmittance * (1.0 - alpha) < f64::from(config.transmittance_min) {
                    break;
                }
                let weight = transmittance * alpha;
                transmittance *= 1.0 - alpha;
                for c in 0..3 {
                    out[c] += weight * s.attributes[c];
                }
                out[3] += weight;
                out[4] += weight * depth;
                for c in 0..8 {
                    out[5 + c] += weight * s.attributes[3 + c];
                }
            }
            pixels.push(out);
        }
    }
    pixels
}

/// Radiance along unit direction `d` from harmonics, in f64, from the associated Legendre recurrence rather than from
/// the table of polynomials that the kernels use.
fn radiance(sh: &[f64], encoding: ColorEncoding, d: DVec3) -> [f64; 3] {
    let mut sum = [0.5; 3];
    for (k, h) in sh.chunks_exact(3).enumerate() {
        let l = (k as f64).sqrt().floor() as i32;
        let m = k as i32 - l * l - l;
        let y = harmonic(l, m, d);
        for c in 0..3 {
            sum[c] += y * h[c];
        }
    }
    sum.map(|s: f64| {
        let s = s.max(0.0);
        match encoding {
            ColorEncoding::Linear => s,
            ColorEncoding::Srgb if s <= 0.04045 => s / 12.92,
            ColorEncoding::Srgb => ((s + 0.055) / 1.055).powf(2.4),
        }
    })
}

/// Real spherical harmonic with the Condon–Shortley phase.
fn harmonic(l: i32, m: i32, d: DVec3) -> f64 {
    use std::f64::consts::PI;
    let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
    let a = m.abs();
    let (x, s) = (d.z, (d.x * d.x + d.y * d.y).sqrt());
    // P_a^a, then upwards in l.
    let mut p_mm = 1.0;
    for i in 0..a {
        p_mm *= -f64::from(2 * i + 1) * s;
    }
    let mut previous = p_mm;
    let mut legendre = if l == a { p_mm } else { x * f64::from(2 * a + 1) * p_mm };
    for n in a + 2..=l {
        let next = (x * f64::from(2 * n - 1) * legendre - f64::from(n + a - 1) * previous) / f64::from(n - a);
        previous = legendre;
        legendre = next;
    }
    let norm = (f64::from(2 * l + 1) / (4.0 * PI) * factorial(l - a) / factorial(l + a)).sqrt();
    let azimuth = d.y.atan2(d.x);
    match m.signum() {
        0 => norm * legendre,
        1 => 2f64.sqrt() * norm * legendre * (f64::from(a) * azimuth).cos(),
        _ => 2f64.sqrt() * norm * legendre * (f64::from(a) * azimuth).sin(),
    }
}
