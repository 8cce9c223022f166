//! Directions: bins of equal size over the sphere, and a closer look around one.

use crate::Partial;
use comgs_geom::equirect;
use comgs_image::Image;
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// Points of a Fibonacci lattice, each with its share of the sphere.
pub(super) struct Bins {
    directions: Vec<Vec3>,
    /// Mean radiance of the map in each.
    radiance: Vec<DVec3>,
    unknown: Vec<bool>,
}

fn lattice(n: usize) -> Vec<Vec3> {
    (0..n)
        .map(|i| {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
            let azimuth = PI * (1.0 + 5f64.sqrt()) * (i as f64 + 0.5);
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z).as_vec3()
        })
        .collect()
}

impl Bins {
    /// `n` bins; unknown where less than `seen` of it was seen and not clipped.
    pub(super) fn of(n: usize, partial: &Partial, map: &Image, seen: f64) -> Self {
        let directions = lattice(n);
        let (width, height) = (map.width, map.height);
        let mut sums = vec![(DVec3::ZERO, 0.0, 0.0); n];
        for y in 0..height {
            let omega = f64::from(equirect::texel_solid_angle(y, width, height));
            for x in 0..width {
                let i = y * width + x;
                let b = nearest(&directions, equirect::texel_direction(x, y, width, height));
                let clipped = partial.clipped.as_ref().is_some_and(|c| c.data[i] > 0.5);
                let known = if clipped { 0.0 } else { f64::from(partial.alpha.data[i].clamp(0.0, 1.0)) };
                sums[b].0 += omega * Vec3::from(map.rgb(x, y)).as_dvec3();
                sums[b].1 += omega;
                sums[b].2 += omega * known;
            }
        }
        let radiance = sums.iter().map(|s| if s.1 > 0.0 { s.0 / s.1 } else { DVec3::ZERO }).collect();
        let unknown = sums.iter().map(|s| s.2 < seen * s.1).collect();
        Self { directions, radiance, unknown }
    }

    pub(super) fn len(&self) -> usize {
        self.directions.len()
    }

    pub(super) fn direction(&self, b: usize) -> Vec3 {
        self.directions[b]
    }

    pub(super) fn radiance(&self, b: usize) -> DVec3 {
        self.radiance[b]
    }

    /// Radiance of the bin that a direction falls into.
    pub(super) fn radiance_at(&self, d: Vec3) -> DVec3 {
        self.radiance[nearest(&self.directions, d)]
    }

    pub(super) fn is_unknown(&self, b: usize) -> bool {
        self.unknown[b]
    }

    /// Steradians of a bin.
    pub(super) fn solid_angle(&self) -> f64 {
        4.0 * PI / self.len() as f64
    }

    /// Angle from a bin's middle to its rim, as if it were a disc.
    pub(super) fn radius(&self) -> f64 {
        (1.0 - self.solid_angle() / (2.0 * PI)).acos()
    }
}

/// Directions within `radius` of an axis: a sunflower over the cap.
pub(super) fn around(axis: Vec3, radius: f64, count: usize) -> Vec<Vec3> {
    let axis = axis.as_dvec3();
    let side = axis.any_orthonormal_vector();
    let up = axis.cross(side);
    (0..count)
        .map(|k| {
            let cos = 1.0 - (k as f64 + 0.5) / count as f64 * (1.0 - radius.cos());
            let azimuth = PI * (1.0 + 5f64.sqrt()) * k as f64;
            let sin = (1.0 - cos * cos).max(0.0).sqrt();
            (side * (sin * azimuth.cos()) + up * (sin * azimuth.sin()) + axis * cos).as_vec3().normalize()
        })
        .collect()
}

fn nearest(directions: &[Vec3], d: Vec3) -> usize {
    let mut best = (f32::MIN, 0);
    for (b, c) in directions.iter().enumerate() {
        let cos = c.dot(d);
        if cos > best.0 {
            best = (cos, b);
        }
    }
    best.1
}
