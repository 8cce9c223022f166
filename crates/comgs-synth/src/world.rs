//! What the rays meet: triangles in a bounding-volume hierarchy, their materials, and the lights.

use crate::brdf::Brdf;
use crate::environment::Environment;
use crate::material::Material;
use crate::mesh::Mesh;
use crate::noise::Noise;
use comgs_geom::Similarity;
use glam::{Affine3A, DVec3, Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::ray::{Ray, RayHit};
use std::sync::Arc;

/// A mesh with its material and place.
#[derive(Clone, Debug)]
pub struct Part {
    /// The surface in the part's own coordinates, in which its pattern lives too.
    pub mesh: Arc<Mesh>,
    /// What it is made of.
    pub material: Material,
    /// Own to world coordinates.
    pub placement: Similarity,
    /// Whether it belongs to the inserted object: object parts are what masks show, and have no say in how lights are
    /// sampled, so that a scene with and without its object uses the same random numbers for the same things.
    pub inserted: bool,
}

impl Part {
    /// The part moved along with what it belongs to.
    #[must_use]
    pub fn moved(&self, transform: &Similarity, inserted: bool) -> Self {
        Self { placement: transform.compose(&self.placement), inserted, ..self.clone() }
    }

    /// Its corners in world space.
    pub fn points(&self) -> impl Iterator<Item = DVec3> {
        let affine = self.placement.to_affine();
        self.mesh.positions.iter().map(move |p| affine.transform_point3(p.as_dvec3()))
    }
}

#[derive(Clone, Copy, Debug)]
struct Triangle {
    corner: Vec3A,
    edge_1: Vec3A,
    edge_2: Vec3A,
}

#[derive(Clone, Copy, Debug)]
struct Attributes {
    normals: [Vec3; 3],
    part: u32,
}

#[derive(Clone, Debug)]
struct PartRecord {
    material: Material,
    own_from_world: Affine3A,
    inserted: bool,
}

/// A lamp: one triangle of an emitting part.
#[derive(Clone, Copy, Debug)]
struct Lamp {
    corner: Vec3,
    edge_1: Vec3,
    edge_2: Vec3,
    radiance: Vec3,
}

/// A scene ready to be traced.
#[derive(Debug)]
pub struct World {
    bvh: Option<CwBvh>,
    triangles: Vec<Triangle>,
    attributes: Vec<Attributes>,
    parts: Vec<PartRecord>,
    environment: Environment,
    lamps: Vec<Lamp>,
    /// Running sum of the lamps' shares, ending with 1.
    lamp_shares: Vec<f32>,
    /// Sum of area times radiance; points of lamps are chosen with density `radiance / lamp_power` per square metre.
    lamp_power: f32,
    /// Share of the light samples that goes to the environment.
    environment_share: f32,
    noise: Noise,
}

/// A point on a surface, seen from somewhere.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// The point, world.
    pub position: Vec3,
    /// Distance along the ray.
    pub distance: f32,
    /// Unit normal of the triangle on the viewer's side.
    pub face_normal: Vec3,
    /// Unit shading normal on the viewer's side of the triangle, as interpolated: what ground truth shows.
    pub normal: Vec3,
    /// The shading normal bent towards the viewer where it would look away: what light is computed with.
    pub shading_normal: Vec3,
    /// Whether the triangle's front is seen.
    pub front: bool,
    part: u32,
    triangle: u32,
}

/// Light that a lamp or the environment sends towards a point.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// How far a shadow ray goes.
    pub distance: f32,
    /// Radiance from there, if nothing is in the way.
    pub radiance: Vec3,
    /// Density per steradian, the choice among lights included.
    pub pdf: f32,
}

impl World {
    /// Builds the hierarchy and the light tables. `seed` is that of the patterns' noise.
    #[must_use]
    pub fn new(parts: &[Part], environment: Environment, seed: u64) -> Self {
        let (mut triangles, mut attributes) = (Vec::new(), Vec::new());
        let mut records = Vec::new();
        let (mut low, mut high) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
        for (index, part) in parts.iter().enumerate() {
            let affine = part.placement.to_affine();
            let rotation = part.placement.rotation.as_quat();
            let points: Vec<Vec3> = part.points().map(|p| p.as_vec3()).collect();
            if !part.inserted {
                for &p in &points {
                    (low, high) = (low.min(p), high.max(p));
                }
            }
            for t in &part.mesh.triangles {
                let [a, b, c] = t.map(|i| Vec3A::from(points[i as usize]));
                triangles.push(Triangle { corner: a, edge_1: b - a, edge_2: c - a });
                let normals = t.map(|i| rotation * part.mesh.normals[i as usize]);
                attributes.push(Attributes { normals, part: index as u32 });
            }
            records.push(PartRecord {
                material: part.material.clone(),
                own_from_world: affine.inverse().as_affine3a(),
                inserted: part.inserted,
            });
        }
        let mut lamps = Vec::new();
        let mut shares = Vec::new();
        let mut lamp_power = 0.0f32;
        for (t, a) in triangles.iter().zip(&attributes) {
            let record = &records[a.part as usize];
            // Lamps on inserted parts shine, but are only found by rays that hit them.
            if record.material.emits() && !record.inserted {
                let (edge_1, edge_2) = (Vec3::from(t.edge_1), Vec3::from(t.edge_2));
                let radiance = Vec3::from(record.material.emission);
                let power = 0.5 * edge_1.cross(edge_2).length() * radiance.max_element();
                lamp_power += power;
                shares.push(lamp_power);
                lamps.push(Lamp { corner: t.corner.into(), edge_1, edge_2, radiance });
            }
        }
        for s in &mut shares {
            *s /= lamp_power;
        }
        if let Some(last) = shares.last_mut() {
            *last = 1.0;
        }
        // π·L·A of the lamps against what the environment sends through a disc of the scene's size.
        let radius = if low.x <= high.x { 0.5 * low.distance(high) } else { 1.0 };
        let sky = environment.power() * 0.25 * radius * radius;
        let environment_share = match (sky > 0.0, lamps.is_empty()) {
            (_, true) => 1.0,
            (false, false) => 0.0,
            (true, false) => (sky / (sky + lamp_power)).clamp(0.15, 0.85),
        };

        let (bvh, order) = if triangles.is_empty() {
            (None, Vec::new())
        } else {
            let boxes: Vec<Aabb> = triangles
                .iter()
                .map(|t| {
                    let mut bounds = Aabb::from_points(&[t.corner, t.corner + t.edge_1, t.corner + t.edge_2]);
                    // A box without thickness may be missed by rounding.
                    let pad = Vec3A::splat(1e-6) + bounds.max.abs().max(bounds.min.abs()) * 1e-6;
                    bounds.min -= pad;
                    bounds.max += pad;
                    bounds
                })
                .collect();
            let bvh =
                build_cwbvh(&boxes, BvhBuildParams::medium_build(), &mut std::time::Duration::default());
            let order = bvh.primitive_indices.clone();
            (Some(bvh), order)
        };
        Self {
            bvh,
            triangles: order.iter().map(|&i| triangles[i as usize]).collect(),
            attributes: order.iter().map(|&i| attributes[i as usize]).collect(),
            parts: records,
            environment,
            lamps,
            lamp_shares: shares,
            lamp_power,
            environment_share,
            noise: Noise::new(seed),
        }
    }

    /// The light from infinitely far.
    #[must_use]
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// The nearest surface along a ray; the direction is unit.
    #[must_use]
    pub fn intersect(&self, origin: Vec3, direction: Vec3) -> Option<Surface> {
        let ray = Ray::new(origin.into(), direction.into(), 0.0, f32::INFINITY);
        let mut hit = RayHit::none();
        self.bvh
            .as_ref()?
            .ray_traverse(ray, &mut hit, |ray, i| {
                intersect_triangle(&self.triangles[i], ray).map_or(f32::INFINITY, |h| h.0)
            })
            .then_some(())?;
        let index = hit.primitive_id as usize;
        let triangle = &self.triangles[index];
        let (t, u, v) = intersect_triangle(triangle, &ray)?;
        let attributes = &self.attributes[index];
        let face = Vec3::from(triangle.edge_1.cross(triangle.edge_2)).normalize();
        let front = face.dot(direction) < 0.0;
        let side = if front { 1.0 } else { -1.0 };
        let [n0, n1, n2] = attributes.normals;
        let normal = side * (n0 * (1.0 - u - v) + n1 * u + n2 * v).normalize_or(face);
        // From its corner and edges the point lies on the triangle to rounding; from the ray it would be off by the distance.
        let position = Vec3::from(triangle.corner + triangle.edge_1 * u + triangle.edge_2 * v);
        let cos = normal.dot(-direction);
        let shading_normal =
            if cos < GRAZING { (normal - (GRAZING - cos) * direction).normalize() } else { normal };
        Some(Surface {
            position,
            distance: t,
            face_normal: side * face,
            normal,
            shading_normal,
            front,
            part: attributes.part,
            triangle: hit.primitive_id,
        })
    }

    /// Whether nothing lies between `origin` and the point at `distance` (may be infinite) along a unit direction.
    #[must_use]
    pub fn visible(&self, origin: Vec3, direction: Vec3, distance: f32) -> bool {
        let ray = Ray::new(origin.into(), direction.into(), 0.0, distance);
        self.bvh.as_ref().is_none_or(|bvh| {
            bvh.ray_traverse_miss(ray, |ray, i| {
                intersect_triangle(&self.triangles[i], ray).map_or(f32::INFINITY, |h| h.0)
            })
        })
    }

    /// The reflectance at a surface point.
    #[must_use]
    pub fn brdf(&self, surface: &Surface) -> Brdf {
        let part = &self.parts[surface.part as usize];
        part.material.at(part.own_from_world.transform_point3(surface.position), &self.noise)
    }

    /// Whether the surface belongs to an inserted object.
    #[must_use]
    pub fn inserted(&self, surface: &Surface) -> bool {
        self.parts[surface.part as usize].inserted
    }

    /// Radiance that the surface itself sends to the viewer (only from its front).
    #[must_use]
    pub fn emission(&self, surface: &Surface) -> Vec3 {
        if surface.front {
            Vec3::from(self.parts[surface.part as usize].material.emission)
        } else {
            Vec3::ZERO
        }
    }

    /// Chooses a light and a direction towards it from a point.
    #[must_use]
    pub fn sample_light(&self, from: Vec3, choice: f32, u: [f32; 2]) -> Option<LightSample> {
        if choice < self.environment_share {
            let s = self.environment.sample(u);
            return Some(LightSample {
                direction: s.direction,
                distance: f32::INFINITY,
                radiance: s.radiance,
                pdf: s.pdf * self.environment_share,
            });
        }
        let share = ((choice - self.environment_share) / (1.0 - self.environment_share)).min(1.0 - 1e-7);
        let lamp =
            self.lamps.get(self.lamp_shares.partition_point(|&c| c <= share).min(self.lamps.len() - 1))?;
        let s = u[0].sqrt();
        let point = lamp.corner + lamp.edge_1 * (s * (1.0 - u[1])) + lamp.edge_2 * (s * u[1]);
        let way = point - from;
        let distance = way.length();
        let direction = way / distance;
        let cos = -lamp.edge_1.cross(lamp.edge_2).normalize().dot(direction);
        if !(cos > 1e-6 && distance > 1e-6) {
            return None;
        }
        Some(LightSample {
            direction,
            // Just short of the lamp itself.
            distance: distance * (1.0 - 1e-4),
            radiance: lamp.radiance,
            pdf: self.lamp_density(lamp.radiance) * distance * distance / cos,
        })
    }

    /// Density per steradian with which [`World::sample_light`] chooses a direction that leaves the scene.
    #[must_use]
    pub fn environment_pdf(&self, direction: Vec3) -> f32 {
        self.environment_share * self.environment.pdf(direction)
    }

    /// Density per steradian with which [`World::sample_light`] chooses the direction that met this lamp surface.
    #[must_use]
    pub fn lamp_pdf(&self, surface: &Surface, direction: Vec3) -> f32 {
        let part = &self.parts[surface.part as usize];
        if part.inserted || self.lamps.is_empty() {
            return 0.0;
        }
        let t = &self.triangles[surface.triangle as usize];
        let cos = -Vec3::from(t.edge_1.cross(t.edge_2)).normalize().dot(direction);
        let density = self.lamp_density(Vec3::from(part.material.emission));
        density * surface.distance * surface.distance / cos.max(1e-6)
    }

    /// Density per square metre of light samples on a lamp of this radiance.
    fn lamp_density(&self, radiance: Vec3) -> f32 {
        (1.0 - self.environment_share) * radiance.max_element() / self.lamp_power
    }

    /// Where a ray that leaves a surface starts: off the surface on its own side, far enough for rounding.
    #[must_use]
    pub fn leave(surface: &Surface, direction: Vec3) -> Vec3 {
        let scale = surface.position.abs().max_element().max(1.0);
        let side = if direction.dot(surface.face_normal) >= 0.0 { 1.0 } else { -1.0 };
        surface.position + surface.face_normal * (side * scale * LEAVE)
    }
}

/// Least cosine between the shading normal and the direction to the viewer.
const GRAZING: f32 = 0.02;

/// How far off the surface a ray starts, as a share of the largest coordinate (at least 1): a hundred roundings of f32.
const LEAVE: f32 = 2e-5;

/// Möller–Trumbore, both sides: distance and the two barycentric coordinates.
fn intersect_triangle(triangle: &Triangle, ray: &Ray) -> Option<(f32, f32, f32)> {
    let p = ray.direction.cross(triangle.edge_2);
    let det = triangle.edge_1.dot(p);
    if det == 0.0 {
        return None;
    }
    let inverse = 1.0 / det;
    let s = ray.origin - triangle.corner;
    let u = s.dot(p) * inverse;
    let q = s.cross(triangle.edge_1);
    let v = ray.direction.dot(q) * inverse;
    let t = triangle.edge_2.dot(q) * inverse;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > ray.tmin && t < ray.tmax).then_some((t, u, v))
}
