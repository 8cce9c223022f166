//! Small flat clouds for the tests and the examples.

use comgs_geom::{Rng, sh};
use comgs_probe::{BakeObserver, OrientedPoints, ProbeConfig, ProbeSet, bake, place};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation};
use comgs_trace::{TraceConfig, Tracer};
use glam::{Quat, Vec3};

/// A direction, uniform on the sphere.
pub fn direction(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

/// A surfel of constant colour, opacity as given (not a logit).
pub fn push(cloud: &mut SurfelCloud, centre: Vec3, normal: Vec3, scale: f32, opacity: f32, colour: Vec3) {
    let q = Quat::from_rotation_arc(Vec3::Z, normal);
    cloud.positions.push(centre.to_array());
    cloud.rotations.push([q.w, q.x, q.y, q.z]);
    cloud.log_scales.push([scale.ln(); 2]);
    cloud.opacity_logits.push(activation::logit(opacity));
    cloud.sh.extend((colour - 0.5).to_array().map(|c| c / sh::C0));
}

/// A rectangle around `centre` of opaque overlapping surfels, `side²` of them, spanned by the half edges `u` and `v`;
/// its normal is `u × v`. Surfels lie off the plane by up to a fifth of their scale, as trained ones do.
pub fn rectangle(cloud: &mut SurfelCloud, centre: Vec3, u: Vec3, v: Vec3, side: usize, colour: Vec3) {
    let mut rng = Rng::stream(9, cloud.len() as u64);
    let normal = u.cross(v).normalize();
    let scale = 1.4 * u.length().max(v.length()) / side as f32;
    for k in 0..side * side {
        let at = |i: usize| (2 * i + 1) as f32 / side as f32 - 1.0;
        let noise = 0.2 * scale * rng.range(-1.0, 1.0);
        push(
            cloud,
            centre + at(k % side) * u + at(k / side) * v + noise * normal,
            normal,
            scale,
            0.95,
            colour,
        );
    }
}

/// A cloud without surfels whose radiance is linear.
pub fn empty() -> SurfelCloud {
    SurfelCloud::empty(0, ColorEncoding::Linear)
}

/// A tracer with the default configuration.
pub fn tracer(cloud: &SurfelCloud) -> Tracer {
    Tracer::new(cloud, &TraceConfig::default()).expect("the cloud is sound")
}

/// A grid of points on a rectangle, normal `u × v`.
pub fn rectangle_points(points: &mut OrientedPoints, centre: Vec3, u: Vec3, v: Vec3, side: usize) {
    for k in 0..side * side {
        let at = |i: usize| (2 * i + 1) as f32 / side as f32 - 1.0;
        points.positions.push(centre + at(k % side) * u + at(k / side) * v);
        points.normals.push(u.cross(v).normalize());
    }
}

/// Probes on a surface, baked.
pub fn baked(
    points: &OrientedPoints,
    tracer: &Tracer,
    config: &ProbeConfig,
    size: f32,
    rays: usize,
) -> ProbeSet {
    let mut set = place(points, config, size).expect("the points are sound");
    bake(tracer, &mut set, rays, BakeObserver::silent()).expect("nobody stops it");
    set
}
