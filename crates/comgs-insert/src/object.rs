//! The inserted object: a mesh or relightable surfels, placed in the world, as rays meet it.

use comgs_geom::Similarity;
use comgs_light::Material;
use comgs_scene::Mesh;
use comgs_surfel::{SurfelCloud, activation::sigmoid};
use comgs_trace::{MeshTracer, TraceConfig, Tracer};
use glam::{DVec3, Vec2, Vec3};
use serde::Serialize;

/// A point of the object as a ray meets it.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Share of the ray that ends here; 1 for meshes.
    pub coverage: f32,
    /// The point, world.
    pub position: Vec3,
    /// Distance along the unit direction.
    pub distance: f32,
    /// Unit geometric normal on the viewer's side.
    pub face_normal: Vec3,
    /// Unit shading normal, bent where it would look away from the viewer.
    pub normal: Vec3,
    /// What it is made of: the part's factors times `texel`, each cut to [0, 1].
    pub material: Material,
    /// Radiance that it sends out itself.
    pub emission: Vec3,
    /// Which part of the object it belongs to ([`Object::parts`]).
    pub part: u32,
    /// What the part's factors multiply: textures of a mesh, the surfels' own values.
    pub texel: Material,
}

/// The factors of a part's material, as glTF has them: each multiplies a texture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Factors {
    /// On the base colour, linear.
    pub albedo: Vec3,
    /// On the perceptual roughness.
    pub roughness: f32,
    /// On the metalness.
    pub metallic: f32,
    /// Radiance sent out, linear.
    pub emission: Vec3,
}

impl Factors {
    /// What surfels start with: their own values.
    pub const ONE: Self = Self { albedo: Vec3::ONE, roughness: 1.0, metallic: 1.0, emission: Vec3::ZERO };

    fn on(&self, texel: Material) -> Material {
        Material {
            albedo: (texel.albedo * self.albedo).clamp(Vec3::ZERO, Vec3::ONE),
            roughness: (texel.roughness * self.roughness).clamp(0.0, 1.0),
            metallic: (texel.metallic * self.metallic).clamp(0.0, 1.0),
        }
    }
}

/// Least cosine between the shading normal and the direction to the viewer.
const GRAZING: f32 = 0.02;

/// How far off a mesh's surface a ray starts, as a share of the largest coordinate: a hundred roundings of f32.
const LEAVE: f32 = 2e-5;

/// How far off a surfel a ray starts, as a share of the object's radius: surfels of one surface overlap within about that.
const LEAVE_SURFELS: f32 = 0.03;

/// Weight from which surfels are a surface.
const SURFACE_WEIGHT: f32 = 0.02;

/// What the rays meet.
#[derive(Debug)]
enum Shape {
    Mesh { tracer: MeshTracer, mesh: Box<Mesh> },
    Surfels { tracer: Box<Tracer>, normals: Vec<Vec3>, materials: Vec<Material>, factors: Factors },
}

/// An object in the world.
#[derive(Debug)]
pub struct Object {
    shape: Shape,
    /// Lowest and highest coordinates.
    pub bounds: (Vec3, Vec3),
    /// Centre of a sphere around the object.
    pub centre: Vec3,
    /// Its radius.
    pub radius: f32,
}

/// Centre and radius of the sphere around a box.
fn sphere((low, high): (Vec3, Vec3)) -> (Vec3, f32) {
    (0.5 * (low + high), 0.5 * low.distance(high))
}

impl Object {
    /// A mesh, moved to the world. `None` when it is empty.
    #[must_use]
    pub fn mesh(mesh: &Mesh, world_from_object: &Similarity) -> Option<Self> {
        let mut mesh = mesh.clone();
        let rotation = world_from_object.rotation.as_quat();
        for p in &mut mesh.positions {
            *p = world_from_object.transform_point(p.as_dvec3()).as_vec3();
        }
        for n in &mut mesh.normals {
            *n = rotation * *n;
        }
        let bounds = mesh.bounds()?;
        let (centre, radius) = sphere(bounds);
        let tracer = MeshTracer::new(&mesh.positions, &mesh.triangles);
        Some(Self { shape: Shape::Mesh { tracer, mesh: Box::new(mesh) }, bounds, centre, radius })
    }

    /// Decomposed surfels, moved to the world. `None` when there are none or they have no material.
    #[must_use]
    pub fn surfels(cloud: &SurfelCloud, world_from_object: &Similarity) -> Option<Self> {
        let cloud = cloud.transformed(world_from_object);
        let columns = cloud.material.as_ref()?;
        let materials = (0..cloud.len())
            .map(|i| Material {
                albedo: Vec3::from_array(columns.albedo_logits[i]).map(sigmoid),
                roughness: sigmoid(columns.roughness_logits[i]),
                metallic: sigmoid(columns.metallic_logits[i]),
            })
            .collect();
        let normals = (0..cloud.len()).map(|i| cloud.rotation(i).z_axis).collect();
        let bounds = cloud.bounds()?;
        let (centre, radius) = sphere(bounds);
        let tracer = Box::new(Tracer::new(&cloud, &TraceConfig::occlusion()).ok()?);
        let shape = Shape::Surfels { tracer, normals, materials, factors: Factors::ONE };
        Some(Self { shape, bounds, centre, radius })
    }

    /// Names of the parts that have a material of their own: a mesh's materials in their order (`material N` where the file
    /// names none), or `object` alone for surfels.
    #[must_use]
    pub fn parts(&self) -> Vec<String> {
        match &self.shape {
            Shape::Mesh { mesh, .. } => {
                let name = |(k, m): (usize, &comgs_scene::MeshMaterial)| {
                    if m.name.is_empty() { format!("material {k}") } else { m.name.clone() }
                };
                mesh.materials.iter().enumerate().map(name).collect()
            }
            Shape::Surfels { .. } => vec!["object".into()],
        }
    }

    /// Whether anything of the object is made of a part's material: files declare some that nothing is.
    #[must_use]
    pub fn has_part(&self, part: usize) -> bool {
        match &self.shape {
            Shape::Mesh { mesh, .. } => mesh.material_of.contains(&(part as u32)),
            Shape::Surfels { .. } => part == 0,
        }
    }

    /// The factors of a part.
    ///
    /// # Panics
    /// When there is no such part.
    #[must_use]
    pub fn factors(&self, part: usize) -> Factors {
        match &self.shape {
            Shape::Mesh { mesh, .. } => {
                let m = &mesh.materials[part];
                Factors {
                    albedo: m.albedo,
                    roughness: m.roughness,
                    metallic: m.metallic,
                    emission: m.emission,
                }
            }
            Shape::Surfels { factors, .. } => *factors,
        }
    }

    /// Changes the factors of a part; whatever was traced before no longer holds for it.
    ///
    /// # Panics
    /// When there is no such part.
    pub fn set_factors(&mut self, part: usize, new: Factors) {
        match &mut self.shape {
            Shape::Mesh { mesh, .. } => {
                let m = &mut mesh.materials[part];
                (m.albedo, m.roughness, m.metallic, m.emission) =
                    (new.albedo, new.roughness, new.metallic, new.emission);
            }
            Shape::Surfels { factors, .. } => *factors = new,
        }
    }

    /// The largest factor that a part may take on colour, roughness and metalness: 1 for a mesh, whose factors are in
    /// [0, 1] by glTF, 4 for surfels, whose own values are to be made brighter too.
    #[must_use]
    pub fn largest_factor(&self) -> f32 {
        match &self.shape {
            Shape::Mesh { .. } => 1.0,
            Shape::Surfels { .. } => 4.0,
        }
    }

    /// The first surface along a unit direction.
    #[must_use]
    pub fn surface(&self, origin: Vec3, direction: Vec3) -> Option<Surface> {
        let mut surface = match &self.shape {
            Shape::Mesh { tracer, mesh } => {
                let hit = tracer.nearest(origin, direction, 0.0)?;
                let t = mesh.triangles[hit.triangle as usize].map(|i| i as usize);
                let weights = Vec3::new(1.0 - hit.u - hit.v, hit.u, hit.v);
                let [a, b, c] = t.map(|i| mesh.positions[i]);
                let face = (b - a).cross(c - a).normalize();
                let side = if face.dot(direction) < 0.0 { 1.0 } else { -1.0 };
                let [na, nb, nc] = t.map(|i| mesh.normals[i]);
                let normal = (na * weights.x + nb * weights.y + nc * weights.z).normalize_or(face);
                let [ua, ub, uc] = t.map(|i| mesh.uvs[i]);
                let uv: Vec2 = ua * weights.x + ub * weights.y + uc * weights.z;
                let part = mesh.material_of[hit.triangle as usize];
                let (albedo, roughness, metallic) = mesh.materials[part as usize].texel(uv);
                let texel = Material { albedo, roughness, metallic };
                let factors = self.factors(part as usize);
                Surface {
                    coverage: 1.0,
                    // From the corners, which is exact to rounding; from the ray it would be off by the distance.
                    position: a * weights.x + b * weights.y + c * weights.z,
                    distance: hit.t,
                    face_normal: face * side,
                    normal: normal * side,
                    material: factors.on(texel),
                    emission: factors.emission,
                    part,
                    texel,
                }
            }
            Shape::Surfels { tracer, normals, materials, factors } => {
                let surface = blended(tracer, normals, materials, origin, direction)?;
                Surface { material: factors.on(surface.texel), emission: factors.emission, ..surface }
            }
        };
        let cosine = -surface.normal.dot(direction);
        if cosine < GRAZING {
            surface.normal =
                (surface.normal - (GRAZING - cosine) * direction).normalize_or(surface.face_normal);
        }
        Some(surface)
    }

    /// Share of light that passes the object along a unit direction.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3, direction: Vec3) -> f32 {
        match &self.shape {
            Shape::Mesh { tracer, .. } => {
                f32::from(u8::from(!tracer.occluded(origin, direction, 0.0, f32::INFINITY)))
            }
            Shape::Surfels { tracer, .. } => tracer.transmittance(origin, direction, 0.0, f32::INFINITY),
        }
    }

    /// Where a ray that leaves a surface starts.
    #[must_use]
    pub fn leave(&self, surface: &Surface) -> Vec3 {
        let off = match &self.shape {
            Shape::Mesh { .. } => LEAVE * surface.position.abs().max_element().max(self.radius),
            Shape::Surfels { .. } => LEAVE_SURFELS * self.radius,
        };
        surface.position + surface.face_normal * off
    }

    /// Whether a ray from `origin` along a unit direction can meet the object at all, by the sphere around it, widened by
    /// `slack` radians.
    #[must_use]
    pub fn may_meet(&self, origin: Vec3, direction: Vec3, slack: f32) -> bool {
        let way = self.centre - origin;
        let distance = way.length();
        if distance <= self.radius {
            return true;
        }
        let half_angle = (self.radius / distance).asin() + slack;
        half_angle >= std::f32::consts::PI || way.dot(direction) >= distance * half_angle.cos()
    }
}

/// Blended distance, normal and material of the surfels along a ray, weighted by `T α`.
fn blended(
    tracer: &Tracer,
    normals: &[Vec3],
    materials: &[Material],
    origin: Vec3,
    direction: Vec3,
) -> Option<Surface> {
    let (mut passed, mut weight, mut depth) = (1.0f32, 0.0f32, 0.0f32);
    let (mut normal, mut albedo, mut roughness, mut metallic) = (Vec3::ZERO, Vec3::ZERO, 0.0f32, 0.0f32);
    for hit in tracer.hits(origin, direction, 0.0, f32::INFINITY) {
        let w = passed * hit.alpha;
        let i = hit.surfel as usize;
        let n = normals[i];
        normal += n * (w * if n.dot(direction) < 0.0 { 1.0 } else { -1.0 });
        let m = materials[i];
        albedo += m.albedo * w;
        roughness += m.roughness * w;
        metallic += m.metallic * w;
        depth += hit.t * w;
        weight += w;
        passed *= 1.0 - hit.alpha;
        if passed < tracer.config().transmittance_min {
            break;
        }
    }
    if weight < SURFACE_WEIGHT {
        return None;
    }
    let normal = normal.normalize_or(-direction);
    let distance = depth / weight;
    let texel =
        Material { albedo: albedo / weight, roughness: roughness / weight, metallic: metallic / weight };
    Some(Surface {
        coverage: weight.min(1.0),
        position: origin + direction * distance,
        distance,
        face_normal: normal,
        normal,
        material: texel,
        emission: Vec3::ZERO,
        part: 0,
        texel,
    })
}

/// The transform that stands an object's box on the plane z = 0 at `(x, y)`: scaled, turned about z by `yaw` radians, its
/// base's middle on the point.
#[must_use]
pub fn stand((low, high): (Vec3, Vec3), at: [f64; 2], scale: f64, yaw: f64) -> Similarity {
    let base = DVec3::new(0.5 * f64::from(low.x + high.x), 0.5 * f64::from(low.y + high.y), f64::from(low.z));
    let rotation = glam::DQuat::from_rotation_z(yaw);
    let translation = DVec3::new(at[0], at[1], 0.0) - rotation * (base * scale);
    Similarity { scale, rotation, translation }
}
