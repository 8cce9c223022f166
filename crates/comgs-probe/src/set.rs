//! The probes.

use crate::{OrientedPoints, ProbeConfig, ProbeError, ProbeIndex, farthest_points};
use comgs_geom::{Similarity, octahedral};
use glam::Vec3;

/// Most texels along a side of a texture.
pub const MAX_RESOLUTION: usize = 128;

/// Surface octahedral probes (ComGS § 3.1.2): points near a surface, each with an octahedral map
/// ([`comgs_geom::octahedral`]) of what it sees.
///
/// A probe takes `24 + 24 res²` bytes, 6168 at the default resolution of 16: 5000 probes are 30.8 MB
/// ([`ProbeSet::memory_bytes`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeSet {
    /// World.
    pub positions: Vec<Vec3>,
    /// Unit normal of the surface next to a probe, world.
    pub normals: Vec<Vec3>,
    /// Side of the textures in texels.
    pub resolution: usize,
    /// `[probe][row · resolution + column]`: linear radiance that arrives from the surfels, L_in, premultiplied by
    /// their opacity, and occlusion O, the share of light from beyond that does not arrive, in [0, 1].
    pub texels: Vec<[f32; 4]>,
    /// Same layout: mean and mean square of the distance that a ray travels, world units; see
    /// [`ProbeSet::far_distance`].
    pub moments: Vec<[f32; 2]>,
    /// Median distance from a probe to the nearest other one, world units; the scale of the lookup.
    pub spacing: f32,
    /// Distances are cut off here, and rays that escape travel this far; world units.
    pub far_distance: f32,
}

impl ProbeSet {
    /// Number of probes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Texels of a probe, `resolution²`.
    #[must_use]
    pub fn texture_len(&self) -> usize {
        self.resolution * self.resolution
    }

    /// Radiance and occlusion of a probe.
    #[must_use]
    pub fn texture(&self, probe: usize) -> &[[f32; 4]] {
        &self.texels[probe * self.texture_len()..(probe + 1) * self.texture_len()]
    }

    /// Distance moments of a probe.
    #[must_use]
    pub fn moments_of(&self, probe: usize) -> &[[f32; 2]] {
        &self.moments[probe * self.texture_len()..(probe + 1) * self.texture_len()]
    }

    /// Radius of the lookup that a configuration asks for, world units.
    #[must_use]
    pub fn radius(&self, config: &ProbeConfig) -> f32 {
        config.radius * self.spacing
    }

    /// The index for the lookup that a configuration asks for.
    #[must_use]
    pub fn index(&self, config: &ProbeConfig) -> ProbeIndex {
        ProbeIndex::new(&self.positions, self.radius(config))
    }

    /// The set under a similarity: positions and distances scale, normals turn, and textures are sampled anew in the turned
    /// directions (bilinear, so a turn blurs them by up to half a texel; without a turn they stay as they are).
    #[must_use]
    pub fn transformed(&self, s: &Similarity) -> Self {
        let turn = s.rotation.as_quat();
        let scale = s.scale as f32;
        let mut out = self.clone();
        out.positions = self.positions.iter().map(|p| s.transform_point(p.as_dvec3()).as_vec3()).collect();
        out.normals = self.normals.iter().map(|n| turn * *n).collect();
        (out.spacing, out.far_distance) = (self.spacing * scale, self.far_distance * scale);
        let side = self.resolution;
        let is_turned = turn.w.abs() < 1.0 - 1e-7;
        let footprints: Vec<octahedral::Footprint> = (0..self.texture_len())
            .map(|t| {
                let d = octahedral::texel_direction(t % side, t / side, side);
                octahedral::footprint(turn.inverse() * d, side)
            })
            .collect();
        if is_turned {
            let n = self.texture_len();
            for probe in 0..self.len() {
                let (texels, moments) = (self.texture(probe), self.moments_of(probe));
                for (t, f) in footprints.iter().enumerate() {
                    let mut texel = [0.0; 4];
                    let mut moment = [0.0; 2];
                    for (&k, &w) in f.texels.iter().zip(&f.weights) {
                        (0..4).for_each(|c| texel[c] += w * texels[k as usize][c]);
                        (0..2).for_each(|c| moment[c] += w * moments[k as usize][c]);
                    }
                    texel[3] = texel[3].clamp(0.0, 1.0);
                    out.texels[probe * n + t] = texel;
                    out.moments[probe * n + t] = moment;
                }
            }
        }
        for m in &mut out.moments {
            *m = [m[0] * scale, m[1] * scale * scale];
        }
        out
    }

    /// Bytes of all columns.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.positions[..])
            + size_of_val(&self.normals[..])
            + size_of_val(&self.texels[..])
            + size_of_val(&self.moments[..])
    }

    /// Makes radiance not negative and occlusion a share: what an optimiser has to do after its step. What is not
    /// finite becomes 0.
    pub fn clamp_to_range(&mut self) {
        for texel in &mut self.texels {
            for (c, v) in texel.iter_mut().enumerate() {
                let high = if c == 3 { 1.0 } else { f32::MAX };
                *v = if v.is_finite() { v.clamp(0.0, high) } else { 0.0 };
            }
        }
    }

    /// Contradictions: lengths of columns, values that are not finite or out of range (counted). Empty when sound.
    #[must_use]
    pub fn problems(&self) -> Vec<String> {
        let (n, texels) = (self.len(), self.len() * self.texture_len());
        let mut problems = Vec::new();
        if !(2..=MAX_RESOLUTION).contains(&self.resolution) {
            problems.push(format!("resolution is {}, expected 2 to {MAX_RESOLUTION}", self.resolution));
        }
        for (name, got, expected) in [
            ("normals", self.normals.len(), n),
            ("texels", self.texels.len(), texels),
            ("moments", self.moments.len(), texels),
        ] {
            if got != expected {
                problems.push(format!("column {name} has {got} values, expected {expected}"));
            }
        }
        for (name, v) in [("spacing", self.spacing), ("far_distance", self.far_distance)] {
            if !(v > 0.0 && v.is_finite()) {
                problems.push(format!("{name} is {v}, expected a finite length above 0"));
            }
        }
        let mut count = |name: &str, bad: usize, what: &str| {
            if bad > 0 {
                problems.push(format!("column {name} has {bad} values that are {what}"));
            }
        };
        let unit = |v: &Vec3| (v.length_squared() - 1.0).abs() < 1e-3;
        // NaN fails every range.
        let light =
            |t: &[f32; 4]| t[..3].iter().all(|v| *v >= 0.0 && v.is_finite()) && (0.0..=1.0).contains(&t[3]);
        let distance = |m: &[f32; 2]| m.iter().all(|v| *v >= 0.0 && v.is_finite());
        count("positions", self.positions.iter().filter(|p| !p.is_finite()).count(), "not finite");
        count("normals", self.normals.iter().filter(|v| !unit(v)).count(), "no unit vectors");
        count(
            "texels",
            self.texels.iter().filter(|t| !light(t)).count(),
            "no radiance with an occlusion in [0, 1]",
        );
        count("moments", self.moments.iter().filter(|m| !distance(m)).count(), "no distance moments");
        problems
    }
}

/// Places probes on a surface (ComGS § 3.1.2 "Automatic Placement"): `config.count` points by farthest point sampling
/// ([`farthest_points`]), each moved along its normal by `config.offset · size`. `size` is the object's, world units,
/// the longest side of its bounding box. Points that are not finite or have no normal are passed over.
///
/// Textures are empty (no radiance, no occlusion, everything far) until they are baked. The lookup's radius follows
/// from the spacing of the probes that were placed, not from the object's size, so that it fits any count.
///
/// # Errors
/// [`ProbeError::Config`], [`ProbeError::Size`], [`ProbeError::NoPoints`].
pub fn place(points: &OrientedPoints, config: &ProbeConfig, size: f32) -> Result<ProbeSet, ProbeError> {
    let problems = config.check();
    if !problems.is_empty() {
        return Err(ProbeError::Config(problems));
    }
    if !(size > 0.0 && size.is_finite()) {
        return Err(ProbeError::Size(size));
    }
    let usable: Vec<(Vec3, Vec3)> = points
        .positions
        .iter()
        .zip(&points.normals)
        .filter_map(|(&p, n)| Some((p, n.try_normalize()?)).filter(|_| p.is_finite()))
        .collect();
    let candidates: Vec<Vec3> = usable.iter().map(|(p, _)| *p).collect();
    let chosen = farthest_points(&candidates, config.count).indices;
    if chosen.is_empty() {
        return Err(ProbeError::NoPoints(points.positions.len()));
    }
    let offset = config.offset * size;
    let normals: Vec<Vec3> = chosen.iter().map(|&i| usable[i as usize].1).collect();
    let positions: Vec<Vec3> =
        chosen.iter().zip(&normals).map(|(&i, n)| usable[i as usize].0 + offset * n).collect();
    let spacing = median_spacing(&chosen.iter().map(|&i| candidates[i as usize]).collect::<Vec<_>>(), size);
    let far_distance = config.far * config.radius * spacing;
    let texels = vec![[0.0; 4]; positions.len() * config.resolution * config.resolution];
    let moments = vec![[far_distance, far_distance * far_distance]; texels.len()];
    Ok(ProbeSet { positions, normals, resolution: config.resolution, texels, moments, spacing, far_distance })
}

/// Median distance to the nearest other point; `size` for a single point.
fn median_spacing(points: &[Vec3], size: f32) -> f32 {
    if points.len() < 2 {
        return size;
    }
    // A cell of about one point where the points cover a surface of this size.
    let index = ProbeIndex::new(points, size / (points.len() as f32).sqrt());
    // The points are distinct, so the nearest is the point itself.
    let mut distances: Vec<f32> =
        points.iter().map(|&p| index.nearest(p, 2).distance_squared[1].sqrt()).collect();
    let middle = distances.len() / 2;
    let median = *distances.select_nth_unstable_by(middle, f32::total_cmp).1;
    if median > 0.0 && median.is_finite() { median } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use glam::{DQuat, DVec3};

    /// A probe whose occlusion and mean distance vary smoothly with the direction.
    fn smooth(resolution: usize) -> ProbeSet {
        let value = |t: usize| {
            let d = octahedral::texel_direction(t % resolution, t / resolution, resolution);
            (0.5 + 0.3 * d.x - 0.2 * d.z, 1.0 + 0.4 * d.y)
        };
        let texels = resolution * resolution;
        ProbeSet {
            positions: vec![Vec3::new(0.1, 0.2, 0.3)],
            normals: vec![Vec3::Y],
            resolution,
            texels: (0..texels).map(|t| [0.1, 0.2, 0.3, value(t).0]).collect(),
            moments: (0..texels).map(|t| [value(t).1, value(t).1.powi(2)]).collect(),
            spacing: 0.1,
            far_distance: 2.0,
        }
    }

    /// Goal: a set under a similarity says of a turned direction what it said of the direction before, lengths scale with
    /// it, and without a turn no texel changes.
    #[test]
    fn sets_move_turn_and_scale() {
        let set = smooth(16);
        let translation = DVec3::new(1.0, -2.0, 0.5);
        let still = Similarity { scale: 3.0, rotation: DQuat::IDENTITY, translation };
        let moved = set.transformed(&still);
        assert_eq!(moved.texels, set.texels);
        assert!((moved.moments[7][0] - 3.0 * set.moments[7][0]).abs() < 1e-5);
        assert!((moved.moments[7][1] - 9.0 * set.moments[7][1]).abs() < 1e-4);
        assert!((moved.positions[0] - Vec3::new(1.3, -1.4, 1.4)).length() < 1e-5);
        assert!((moved.spacing - 0.3).abs() < 1e-6 && (moved.far_distance - 6.0).abs() < 1e-5);
        let s = Similarity { rotation: DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(2.0), ..still };
        let turned = set.transformed(&s);
        assert!(turned.problems().is_empty(), "{:?}", turned.problems());
        let turn = s.rotation.as_quat();
        assert!((turned.normals[0] - turn * Vec3::Y).length() < 1e-6);
        for k in 0..200 {
            let u = glam::Vec2::new((k as f32 + 0.5) / 200.0, (k as f32 * 0.618).fract());
            let d = comgs_geom::sampling::uniform_sphere(u);
            let (a, b) = (sample(set.texture(0), 16, d), sample(turned.texture(0), 16, turn * d));
            // Two bilinear look-ups of a field that bends by less than this over a texel.
            assert!((a[3] - b[3]).abs() < 0.02, "{d}: {a:?} {b:?}");
        }
    }
}
