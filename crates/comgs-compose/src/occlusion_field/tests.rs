//! Against analytic silhouettes and traced rays.

use super::*;
use comgs_geom::{
    Rng,
    sampling::{hammersley, uniform_sphere},
};
use comgs_surfel::{ColorEncoding, activation::logit};
use comgs_trace::Tracer;
use glam::Vec2;

fn never() -> bool {
    false
}

/// Surfels over the surface that `place` maps directions to.
fn shell(n: u32, sigma: f32, place: impl Fn(Vec3) -> Vec3) -> SurfelCloud {
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    for k in 0..n {
        let d = uniform_sphere(hammersley(k, n, Vec2::ZERO));
        let q = glam::Quat::from_rotation_arc(Vec3::Z, d);
        cloud.positions.push(place(d).to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([sigma.ln(); 2]);
        cloud.opacity_logits.push(logit(0.98));
        cloud.sh.extend([0.0; 3]);
    }
    cloud
}

fn ball() -> SurfelCloud {
    shell(4000, 0.03, |d| 0.5 * d + Vec3::new(0.2, -0.1, 0.4))
}

/// Goal: a ball's field is its silhouette: hidden behind it, clear beside it, clear on the light's side of it. Judge: the
/// analytic ball. Within a texel of the silhouette either is right.
#[test]
fn a_ball_occludes_its_silhouette() {
    for side in [12, 16, 24] {
        silhouette_of_a_ball(side);
    }
}

fn silhouette_of_a_ball(side: usize) {
    let config = FieldConfig { directions: side, resolution: 64 };
    let field = OcclusionField::bake(&ball(), config, &never).unwrap();
    let (centre, r) = (Vec3::new(0.2, -0.1, 0.4), 0.5);
    let mut rng = Rng::new(3);
    let (mut hidden, mut clear) = (0, 0);
    for _ in 0..20_000 {
        let direction = uniform_sphere(Vec2::new(rng.uniform(), rng.uniform()));
        let k = octahedral::texel_of(direction, side);
        let direction = octahedral::texel_direction(k % side, k / side, side);
        let p = centre + 1.5 * Vec3::new(rng.normal(), rng.normal(), rng.normal());
        let away = (p - centre).reject_from(direction).length();
        let along = (centre - p).dot(direction);
        // Inside of the ball is nobody's place.
        if (away - r).abs() < 0.06 || (p - centre).length() < r + 0.06 {
            continue;
        }
        let t = field.transmittance(p, direction);
        if away < r && along > 0.0 {
            hidden += 1;
            assert!(t < 0.1, "{t} at {p} towards {direction}");
        } else {
            clear += 1;
            assert!(t > 0.99, "{t} at {p} towards {direction}");
        }
    }
    assert!(hidden > 200 && clear > 5000, "{hidden} {clear}");
}

/// Goal: an object with holes and legs, seen from points around it and *within its bounding sphere*, agrees with traced
/// rays on the grid's directions: between two sheets only the far one counts.
#[test]
fn agrees_with_traced_rays_within_the_bounding_sphere() {
    // A table: a slab on four posts.
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let mut push = |p: Vec3, n: Vec3| {
        let q = glam::Quat::from_rotation_arc(Vec3::Z, n);
        cloud.positions.push(p.to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([0.02f32.ln(); 2]);
        cloud.opacity_logits.push(logit(0.98));
        cloud.sh.extend([0.0; 3]);
    };
    for i in 0..40 {
        for j in 0..40 {
            let (x, y) = (i as f32 / 20.0 - 1.0, j as f32 / 20.0 - 1.0);
            push(Vec3::new(0.5 * x, 0.5 * y, 0.6), Vec3::Z);
            push(Vec3::new(0.5 * x, 0.5 * y, 0.55), Vec3::Z);
        }
    }
    for (x, y) in [(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)] {
        for j in 0..30 {
            for a in 0..12 {
                let d = Vec2::from_angle(a as f32 * std::f32::consts::FRAC_PI_6).extend(0.0);
                push(Vec3::new(x, y, 0.018 * j as f32) + 0.06 * d, d);
            }
        }
    }
    let field = OcclusionField::bake(&cloud, FieldConfig { directions: 16, resolution: 96 }, &never).unwrap();
    let tracer = Tracer::new(&cloud, &comgs_trace::TraceConfig::occlusion()).unwrap();
    let mut rng = Rng::new(5);
    let (mut sum, mut bad, mut n) = (0.0, 0, 0);
    for _ in 0..6000 {
        let p = Vec3::new(rng.range(-0.9, 0.9), rng.range(-0.9, 0.9), rng.range(0.02, 0.5));
        let k = rng.below(256);
        let d = octahedral::texel_direction(k % 16, k / 16, 16);
        let error = (field.transmittance(p, d) - tracer.transmittance(p, d, 0.0, f32::INFINITY)).abs();
        sum += error;
        bad += usize::from(error > 0.5);
        n += 1;
    }
    let (mean, wrong) = (sum / n as f32, bad as f32 / n as f32);
    assert!(mean < 0.03 && wrong < 0.02, "mean error {mean}, {wrong} plainly wrong");
}

/// Goal: the opposite of every grid direction is on the grid, and both share their axes (what lets one bake serve both).
#[test]
fn the_grid_is_symmetric() {
    for side in [4, 16, 24, 32] {
        let grid = grid(side);
        for (k, d) in grid.iter().enumerate() {
            let o = &grid[opposite(k, side)];
            assert!((o.towards + d.towards).length() < 1e-5 && o.u == d.u && o.v == d.v, "{side} {k}");
        }
    }
}

/// Goal: bytes survive a round trip; what is truncated, of another length or hostile is refused by a sentence (hard case
/// 34); odd grids and nothing to bake are refused.
#[test]
fn bytes_round_trip_and_bad_ones_are_refused() {
    let config = FieldConfig { directions: 4, resolution: 8 };
    let field = OcclusionField::bake(&ball(), config, &never).unwrap();
    let bytes = to_bytes(&field);
    assert_eq!(from_bytes(&bytes).unwrap(), field);
    for cut in [0, 7, 20, bytes.len() - 1] {
        assert!(from_bytes(&bytes[..cut]).is_err());
    }
    let mut huge = bytes.clone();
    huge[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(from_bytes(&huge).unwrap_err().to_string().contains("directions is 4294967295"));
    let mut other = bytes;
    other[28..32].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(from_bytes(&other).is_err());
    let odd = FieldConfig { directions: 5, resolution: 2 };
    let refused = OcclusionField::bake(&ball(), odd, &never).unwrap_err();
    assert!(matches!(refused, FieldError::Config(p) if p.len() == 2));
    let none = SurfelCloud::empty(0, ColorEncoding::Linear);
    assert_eq!(OcclusionField::bake(&none, config, &never).unwrap_err(), FieldError::Invisible(0));
    assert_eq!(OcclusionField::bake(&ball(), config, &|| true).unwrap_err(), FieldError::Cancelled);
}
