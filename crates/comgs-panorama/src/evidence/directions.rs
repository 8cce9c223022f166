//! Directions in bins of equal size, and pieces of bins.

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

    pub(super) fn is_unknown(&self, b: usize) -> bool {
        self.unknown[b]
    }

    /// Steradians of a bin.
    pub(super) fn solid_angle(&self) -> f64 {
        4.0 * PI / self.len() as f64
    }

    /// Angle from a bin's middle to its rim, as if it were a disc.
    fn radius(&self) -> f64 {
        (1.0 - self.solid_angle() / (2.0 * PI)).acos()
    }

    /// Bins around a direction with weights that fall to 0 at 1.5 radii.
    pub(super) fn near(&self, d: Vec3) -> impl Iterator<Item = (usize, f64)> + '_ {
        let reach = (1.5 * self.radius()).cos();
        self.directions.iter().enumerate().filter_map(move |(b, c)| {
            let cos = f64::from(c.dot(d));
            (cos > reach).then(|| (b, ((cos - reach) / (1.0 - reach)).powi(2)))
        })
    }

    /// Pieces of some bins.
    pub(super) fn pieces(&self, split: &[usize], each: usize) -> Pieces {
        let cap = self.solid_angle();
        let mut directions = Vec::new();
        for &b in split {
            let axis = self.directions[b];
            let side = axis.any_orthonormal_vector();
            let up = axis.cross(side);
            for k in 0..each {
                // A sunflower over the bin's cap; a little wider, because its middle is only a guess.
                let share = (k as f64 + 0.5) / each as f64;
                let cos = 1.0 - 1.5 * share * cap / (2.0 * PI);
                let azimuth = PI * (1.0 + 5f64.sqrt()) * k as f64;
                let sin = (1.0 - cos * cos).max(0.0).sqrt();
                let d = side.as_dvec3() * sin * azimuth.cos()
                    + up.as_dvec3() * sin * azimuth.sin()
                    + axis.as_dvec3() * cos;
                directions.push(d.as_vec3().normalize());
            }
        }
        Pieces { directions, solid_angle: cap / each as f64 }
    }
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

/// Small discs inside bins.
pub(super) struct Pieces {
    directions: Vec<Vec3>,
    solid_angle: f64,
}

impl Pieces {
    pub(super) fn len(&self) -> usize {
        self.directions.len()
    }

    pub(super) fn direction(&self, p: usize) -> Vec3 {
        self.directions[p]
    }

    pub(super) fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// How much of a piece's light comes from `d`: a bump of about the piece's size.
    pub(super) fn weight(&self, p: usize, d: Vec3) -> f64 {
        let rim = 1.0 - 2.0 * self.solid_angle / (2.0 * PI);
        let cos = f64::from(self.directions[p].dot(d));
        if cos > rim { (cos - rim) / (1.0 - rim) } else { 0.0 }
    }
}
