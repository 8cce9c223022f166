//! What the objects look like from all sides: the light that they throw back on the scene.

use crate::stages::editing::{Composition, RelitObjects};
use comgs_compose::{Composer, ObjectShader, objects};
use comgs_geom::Camera;
use glam::{DVec3, Vec3};

/// Mean radiance of the objects by direction.
pub(super) struct SeenRadiance(Vec<(Vec3, Vec3)>);

impl SeenRadiance {
    /// Of the nearest direction that was looked in.
    pub fn towards(&self, direction: Vec3) -> Vec3 {
        let nearest = self.0.iter().max_by(|a, b| a.0.dot(direction).total_cmp(&b.0.dot(direction)));
        nearest.map_or(Vec3::ZERO, |n| n.1)
    }
}

/// Width of the pictures that the mean radiance is taken from.
const SEEN_WIDTH: usize = 24;

/// Looks at the objects from 26 directions.
pub(super) fn seen_radiance(
    composition: &Composition,
    composer: &Composer<'_>,
    relit: Option<&RelitObjects<'_>>,
) -> SeenRadiance {
    let cloud = composer.objects();
    let Some((centre, radius)) = objects::bounding_sphere(cloud) else { return SeenRadiance(Vec::new()) };
    let mut seen = Vec::new();
    for k in (0..27).filter(|&k| k != 13) {
        let step = |v: i32| f64::from(v % 3 - 1);
        let from = DVec3::new(step(k), step(k / 3), step(k / 9)).normalize();
        let eye = centre.as_dvec3() + from * f64::from(radius) * 6.0;
        let up = if from.z.abs() > 0.9 { DVec3::X } else { DVec3::Z };
        let camera = Camera::look_at(
            "seen",
            SEEN_WIDTH,
            SEEN_WIDTH,
            2.2 * (1.0f64 / 6.0).atan(),
            eye,
            centre.as_dvec3(),
            up,
        );
        let raster = composition.raster();
        let seen_of = relit.and_then(ObjectShader::carrier).unwrap_or(cloud);
        let frame = comgs_raster::render(seen_of, &camera, comgs_raster::Planes::ALL, &raster);
        let color = match (relit, &frame.color) {
            (Some(relit), _) => relit.shade(&camera, &frame),
            (None, Some(color)) => color.clone(),
            (None, None) => continue,
        };
        let weight: f32 = frame.weight.data.iter().sum();
        let sum: Vec3 = color.data.chunks_exact(3).map(Vec3::from_slice).sum();
        if weight > 0.0 {
            seen.push((-from.as_vec3(), sum / weight));
        }
    }
    SeenRadiance(seen)
}
