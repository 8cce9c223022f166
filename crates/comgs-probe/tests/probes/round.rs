//! Round clouds for the tests.

use crate::support::push;
use comgs_surfel::SurfelCloud;
use glam::Vec3;

/// Surfels over a sphere, normals outwards.
pub fn ball(cloud: &mut SurfelCloud, centre: Vec3, radius: f32, n: usize, colour: Vec3) {
    for p in fibonacci(n) {
        let scale = 0.7 * radius * (4.0 * std::f32::consts::PI / n as f32).sqrt();
        push(cloud, centre + radius * p, p, scale, 0.95, colour);
    }
}

/// Evenly spread unit vectors.
pub fn fibonacci(n: usize) -> Vec<Vec3> {
    (0..n)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f32 / n as f32;
            let (s, c) = (i as f32 * 2.399_963_2).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * c, r * s, z)
        })
        .collect()
}
