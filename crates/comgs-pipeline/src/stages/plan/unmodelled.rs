//! What is looked at and not simulated.

use super::Line;
use crate::stages::editing::Composition;
use comgs_geom::sh;
use glam::Vec3;

/// Lines of the plan for them.
pub(super) fn lines(composition: &Composition) -> Vec<Line> {
    let glossy = glossiness(composition);
    let line = |effect: &str, reason: String| Line {
        effect: effect.to_owned(),
        change: None,
        seconds: 0.0,
        on: false,
        reason,
    };
    vec![line(
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
    )]
}

/// Variation of the radiance with the view from which on a surface counts as glossy.
const GLOSSY: f32 = 0.35;
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
