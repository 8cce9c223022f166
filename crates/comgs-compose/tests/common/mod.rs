//! Small clouds made of surfels, for the composition tests.

use comgs_geom::{Camera, Similarity, sampling::uniform_sphere};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation::logit};
use glam::{DQuat, DVec3, Vec2, Vec3};

/// Appends a round surfel of one colour.
pub fn push(cloud: &mut SurfelCloud, p: Vec3, normal: Vec3, sigma: f32, alpha: f32, rgb: [f32; 3]) {
    let q = glam::Quat::from_rotation_arc(Vec3::Z, normal.normalize());
    cloud.positions.push(p.to_array());
    cloud.rotations.push([q.w, q.x, q.y, q.z]);
    cloud.log_scales.push([sigma.ln(); 2]);
    cloud.opacity_logits.push(logit(alpha));
    cloud.sh.extend(rgb.map(|c| (c - 0.5) / comgs_geom::sh::basis(0, Vec3::Z)[0]));
}

pub fn empty() -> SurfelCloud {
    SurfelCloud::empty(0, ColorEncoding::Linear)
}

/// A rectangle of `n × m` surfels spanned by `u` and `v` from `corner`; its colour is a checker of two.
pub fn rectangle(
    cloud: &mut SurfelCloud,
    corner: Vec3,
    u: Vec3,
    v: Vec3,
    (n, m): (usize, usize),
    rgb: [[f32; 3]; 2],
) {
    let normal = u.cross(v).normalize();
    let sigma = 0.65 * (u.length() / n as f32).max(v.length() / m as f32);
    for i in 0..n * m {
        let (a, b) = (i % n, i / n);
        let p = corner + u * ((a as f32 + 0.5) / n as f32) + v * ((b as f32 + 0.5) / m as f32);
        push(cloud, p, normal, sigma, 0.97, rgb[(a / 3 + b / 3) % 2]);
    }
}

/// A floor at z = 0, 8 × 8.
pub fn floor() -> SurfelCloud {
    let mut cloud = empty();
    let rgb = [[0.6, 0.5, 0.4], [0.3, 0.35, 0.4]];
    rectangle(&mut cloud, Vec3::new(-4.0, -4.0, 0.0), Vec3::X * 8.0, Vec3::Y * 8.0, (48, 48), rgb);
    cloud
}

/// A ball of radius ½ around the origin.
pub fn ball(rgb: [f32; 3]) -> SurfelCloud {
    let mut cloud = empty();
    let n = 900;
    for i in 0..n {
        let golden = 0.618_034 * i as f32;
        let d = uniform_sphere(Vec2::new((i as f32 + 0.5) / n as f32, golden - golden.floor()));
        push(&mut cloud, 0.5 * d, d, 0.035, 0.97, rgb);
    }
    cloud
}

pub fn at(x: f64, y: f64, z: f64, scale: f64) -> Similarity {
    Similarity { scale, rotation: DQuat::from_rotation_z(0.3), translation: DVec3::new(x, y, z) }
}

pub fn camera(width: usize, height: usize) -> Camera {
    Camera::look_at("a", width, height, 0.9, DVec3::new(3.0, -2.5, 2.0), DVec3::new(0.0, 0.0, 0.3), DVec3::Z)
}

/// Appends all of `other` (same degree).
pub fn append(cloud: &mut SurfelCloud, other: &SurfelCloud) {
    cloud.positions.extend(&other.positions);
    cloud.rotations.extend(&other.rotations);
    cloud.log_scales.extend(&other.log_scales);
    cloud.opacity_logits.extend(&other.opacity_logits);
    cloud.sh.extend(&other.sh);
}
