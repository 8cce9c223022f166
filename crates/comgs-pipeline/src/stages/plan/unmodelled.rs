//! What is looked at and not simulated.

use super::Line;
use crate::stages::editing::Composition;
use comgs_geom::sampling::{cosine_hemisphere, hammersley};
use comgs_geom::{frame::world_from_tangent, sh};
use comgs_trace::Tracer;
use glam::{Vec2, Vec3};

/// Lines of the plan for them.
pub(super) fn lines(composition: &Composition, scene: &Tracer) -> Vec<Line> {
    let (near, glossy) = (near_field(composition, scene), glossiness(composition));
    let line = |effect: &str, reason: String| Line {
        effect: effect.to_owned(),
        change: None,
        seconds: 0.0,
        on: false,
        reason,
    };
    vec![
        line(
            "near-field light",
            match near {
                Some(spread) => format!(
                    "not modelled: light from the scene's surfaces differs by {:.0} % over the object",
                    100.0 * spread
                ),
                None => "not modelled: the scene's surfaces send no light to the object".to_owned(),
            },
        ),
        line(
            "glossy receiver",
            match glossy {
                Some(g) if g > GLOSSY => format!(
                    "not modelled: the surface under the object looks glossy (its radiance varies by {:.0} % with the view)",
                    100.0 * g
                ),
                Some(g) => format!(
                    "not modelled, and not called for: radiance varies by {:.0} % with the view",
                    100.0 * g
                ),
                None => "not modelled: no surface of the scene is near the object".to_owned(),
            },
        ),
        line("defocus and noise", "not modelled: frames are sharp and free of the photos' noise".to_owned()),
    ]
}

/// Variation of the radiance with the view from which on a surface counts as glossy.
const GLOSSY: f32 = 0.35;
/// Rays a normal for the near field.
const RAYS: u32 = 64;

/// How much the irradiance from the scene's surfaces differs between opposite ends of the objects: the largest difference over
/// six normals at the ends of three axes, over the mean. A map at infinity has no such difference.
fn near_field(composition: &Composition, scene: &Tracer) -> Option<f32> {
    let mut most = None;
    for (centre, radius) in composition.spheres() {
        let irradiance = |at: Vec3, normal: Vec3| {
            let frame = world_from_tangent(normal);
            let sum: Vec3 = (0..RAYS)
                .map(|k| {
                    let d = frame * cosine_hemisphere(hammersley(k, RAYS, Vec2::splat(0.25)));
                    // What is nearer than the object's own radius may be the floor it stands on.
                    scene.radiance(at, d, 0.2 * radius, f32::INFINITY).radiance
                })
                .sum();
            sum.dot(Vec3::splat(1.0 / 3.0)) / RAYS as f32
        };
        let normals = [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z];
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let ends = [centre + 0.8 * radius * axis, centre - 0.8 * radius * axis];
            let values = ends.map(|at| normals.map(|n| irradiance(at, n)));
            let mean = values.iter().flatten().sum::<f32>() / 12.0;
            let difference = (0..6).map(|k| (values[0][k] - values[1][k]).abs()).fold(0.0, f32::max);
            if mean > 0.0 {
                let spread = difference / mean;
                most = Some(most.map_or(spread, |m: f32| m.max(spread)));
            }
        }
    }
    most
}

/// Mean relative deviation of the scene's radiance over views, by harmonics beyond the mean, of surfels within three radii.
fn glossiness(composition: &Composition) -> Option<f32> {
    let cloud = &composition.scene.surfels;
    let spheres = composition.spheres();
    let (mut sum, mut n) = (0.0, 0);
    for i in 0..cloud.len() {
        let p = Vec3::from_array(cloud.positions[i]);
        if !spheres.iter().any(|(c, r)| (p - *c).length() < 3.0 * r) {
            continue;
        }
        let coefficients = cloud.sh_of(i).chunks_exact(3);
        // Harmonics are orthonormal: the sum of squares beyond the first is 4π times the variance over the sphere.
        let square: f32 = coefficients.clone().skip(1).flatten().map(|v| v * v).sum();
        let deviation = (square / 3.0 / (4.0 * std::f32::consts::PI)).sqrt();
        let mean =
            0.5 + coefficients.take(1).flatten().map(|v| v * sh::basis(0, Vec3::Z)[0]).sum::<f32>() / 3.0;
        if mean > 0.02 {
            sum += deviation / mean;
            n += 1;
        }
    }
    (n > 0).then(|| sum / n as f32)
}
