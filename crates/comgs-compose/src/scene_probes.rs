//! Occlusion probes in the scene, around a placement (ComGS § 3.2.2): what the objects hide, baked at points of the
//! surfaces that receive shadows and interpolated between them.
//!
//! It is the paper's way, kept to be measured against: a field in the object's frame ([`crate::field_shadow`]) is baked once
//! instead of once a placement, and answers at the receiver itself instead of between probes. Region and density follow from
//! the objects instead of a factor chosen by hand: points of the scene are thinned by farthest-point sampling in a space
//! that is compressed with the distance from the nearest object ([`warp`]), where the occlusion changes slowly.

use crate::field_shadow::{ShadowRatios, StrongFrom};
use crate::shadow::DARK;
use crate::shadow_cache::ReceiverCloud;
use crate::shadow_light::{Beam, ShadowLight};
use comgs_probe::{
    BakeObserver, LookupConfig, ProbeConfig, ProbeError, ProbeIndex, ProbeSet, VisibilityWeight,
    bake_occlusion, farthest_points, sample,
};
use comgs_trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;

/// How probes are spread over the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Density {
    /// The same everywhere in the region, as in the paper.
    Uniform,
    /// Falling with the distance from the objects.
    Adaptive,
}

/// Knobs of the probes.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneProbeConfig {
    /// Probes, at most; above 0.
    pub count: usize,
    /// Side of the octahedral textures.
    pub resolution: usize,
    /// Probes that a point is interpolated from, at most.
    pub neighbours: usize,
    /// Offset from the surface as a share of the objects' radius.
    pub offset: f32,
    /// Region: so many radii around the objects. The paper takes six times the object's size.
    pub region: f32,
    /// Spread.
    pub density: Density,
}

impl Default for SceneProbeConfig {
    fn default() -> Self {
        Self {
            count: 10_000,
            resolution: 16,
            neighbours: 8,
            offset: 0.02,
            region: 6.0,
            density: Density::Adaptive,
        }
    }
}

/// Shadow ratios from probes in the scene.
pub struct SceneProbes<'a> {
    light: &'a ShadowLight,
    spheres: Vec<(Vec3, f32)>,
    tracer: &'a Tracer,
    /// Positions are warped where the density is adaptive.
    set: ProbeSet,
    index: ProbeIndex,
    lookup: LookupConfig,
    config: SceneProbeConfig,
}

/// Compresses space around spheres: the distance d from the nearest centre becomes `r ln(1 + d / r)`, along the same line.
/// The identity at a centre, logarithmic far away.
#[must_use]
pub fn warp(point: Vec3, spheres: &[(Vec3, f32)]) -> Vec3 {
    let nearest = spheres
        .iter()
        .min_by(|a, b| ((point - a.0).length() / a.1).total_cmp(&((point - b.0).length() / b.1)));
    let Some(&(centre, radius)) = nearest else { return point };
    let offset = point - centre;
    let distance = offset.length();
    if distance > 0.0 { centre + offset * (radius * (distance / radius).ln_1p() / distance) } else { point }
}

impl<'a> SceneProbes<'a> {
    /// Places and bakes probes on the receivers around objects.
    ///
    /// * `tracer`: of all objects, in world space
    /// * `spheres`: around the objects, world
    ///
    /// # Errors
    /// [`ProbeError::NoPoints`] when no receiver is in the region, [`ProbeError::Cancelled`] and what baking refuses.
    pub fn bake(
        receivers: &ReceiverCloud,
        light: &'a ShadowLight,
        tracer: &'a Tracer,
        spheres: Vec<(Vec3, f32)>,
        config: &SceneProbeConfig,
        observer: BakeObserver<'_>,
    ) -> Result<Self, ProbeError> {
        let inside = |p: &Vec3| spheres.iter().any(|(c, r)| (*p - *c).length() < config.region * r);
        let chosen: Vec<usize> = (0..receivers.len()).filter(|&i| inside(&receivers.points[i])).collect();
        if chosen.is_empty() {
            return Err(ProbeError::NoPoints(receivers.len()));
        }
        let place = |p: Vec3| match config.density {
            Density::Uniform => p,
            Density::Adaptive => warp(p, &spheres),
        };
        let warped: Vec<Vec3> = chosen.iter().map(|&i| place(receivers.points[i])).collect();
        let picked = farthest_points(&warped, config.count).indices;
        let radius = spheres.iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
        let probe = ProbeConfig {
            count: config.count,
            resolution: config.resolution,
            neighbours: config.neighbours,
            visibility: VisibilityWeight::None,
            ..ProbeConfig::default()
        };
        let normals: Vec<Vec3> = picked.iter().map(|&k| receivers.normals[chosen[k as usize]]).collect();
        let lifted: Vec<Vec3> = picked
            .iter()
            .zip(&normals)
            .map(|(&k, n)| receivers.points[chosen[k as usize]] + config.offset * radius * *n)
            .collect();
        let points = comgs_probe::OrientedPoints {
            positions: picked.iter().map(|&k| warped[k as usize]).collect(),
            normals: normals.clone(),
        };
        // The spacing of the lookup is that of the warped points; what is traced starts at the real ones.
        let mut set = comgs_probe::place(&points, &ProbeConfig { offset: 0.0, ..probe.clone() }, radius)?;
        let order = farthest_points(&points.positions, config.count).indices;
        let in_space: Vec<Vec3> = order.iter().map(|&k| lifted[k as usize]).collect();
        let in_warp = std::mem::replace(&mut set.positions, in_space);
        bake_occlusion(tracer, &mut set, 1, observer)?;
        set.positions = in_warp;
        let (index, lookup) = (set.index(&probe), LookupConfig::new(&set, &probe));
        Ok(Self { light, spheres, tracer, set, index, lookup, config: config.clone() })
    }

    /// The probes; positions are warped where the density is adaptive.
    #[must_use]
    pub fn set(&self) -> &ProbeSet {
        &self.set
    }

    fn ratio(&self, point: Vec3, normal: Vec3, texture: &mut [[f32; 4]]) -> Vec3 {
        if !self.spheres.iter().any(|(c, r)| (point - *c).length() < self.config.region * r) {
            return Vec3::ONE;
        }
        let at = match self.config.density {
            Density::Uniform => point,
            Density::Adaptive => warp(point, &self.spheres),
        };
        self.set.blend(&self.index.query(at, normal, &self.set, &self.lookup), texture);
        let (mut lit, mut hidden) = (Vec3::ZERO, Vec3::ZERO);
        let mut add = |towards: Vec3, energy: Vec3, occlusion: f32| {
            let light = energy * normal.dot(towards).max(0.0);
            lit += light;
            hidden += light * occlusion;
        };
        for (&d, &e) in self.light.directions.iter().zip(&self.light.energy) {
            add(d, e, sample(texture, self.set.resolution, d)[3]);
        }
        for beam in &self.light.beams {
            match beam {
                Beam::Parallel { directions, irradiance } => {
                    for &d in directions {
                        let t = self.tracer.transmittance(point, d, 0.0, f32::INFINITY);
                        add(d, *irradiance / directions.len() as f32, 1.0 - t);
                    }
                }
                Beam::Points { positions, intensity } => {
                    for &p in positions {
                        let (d, distance) = ((p - point).normalize_or_zero(), (p - point).length());
                        let t = self.tracer.transmittance(point, d, 0.0, distance);
                        let each = *intensity / positions.len() as f32;
                        add(d, each / (distance * distance).max(1e-12), 1.0 - t);
                    }
                }
            }
        }
        let channel =
            |hidden: f32, lit: f32| if lit < DARK { 1.0 } else { (1.0 - hidden / lit).clamp(0.0, 1.0) };
        Vec3::new(channel(hidden.x, lit.x), channel(hidden.y, lit.y), channel(hidden.z, lit.z))
    }
}

impl ShadowRatios for SceneProbes<'_> {
    fn ratios(&self, points: &[Vec3], normals: &[Vec3]) -> Vec<Vec3> {
        points
            .par_iter()
            .zip(normals)
            .with_min_len(64)
            .map_init(
                || vec![[0.0; 4]; self.set.texture_len()],
                |texture, (p, n)| self.ratio(*p, *n, texture),
            )
            .collect()
    }

    fn spheres(&self) -> Vec<(Vec3, f32)> {
        self.spheres.clone()
    }

    fn strong(&self) -> Vec<StrongFrom> {
        self.light.strong()
    }
}

#[cfg(test)]
mod tests;
