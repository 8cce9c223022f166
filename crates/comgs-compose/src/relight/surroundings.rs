//! What the object hides from a point on it, and what it sends there.

use comgs_probe::{LookupConfig, Neighbours, ProbeConfig, ProbeIndex, ProbeSet};
use comgs_trace::Tracer;
use glam::Vec3;
use std::borrow::Cow;

/// The object as seen from its own surface: O and L_in of ComGS Eq. 8.
#[allow(clippy::large_enum_variant, reason = "there is one a relighter")]
pub(super) enum Surroundings<'a> {
    /// Nothing is hidden, nothing arrives.
    Open,
    /// Interpolated probe textures.
    Probes(Probes<'a>),
    /// A ray for every direction.
    Trace {
        tracer: Tracer,
        /// Height above the surface at which rays start, world units.
        offset: f32,
        /// Whether the tracer's surfels have the colours of the light that is scattered.
        glowing: bool,
    },
}

/// Probes, ready to be looked up.
pub(super) struct Probes<'a> {
    pub set: Cow<'a, ProbeSet>,
    pub index: ProbeIndex,
    pub lookup: LookupConfig,
    /// Whether the textures' radiance is that of the light that is scattered.
    pub glowing: bool,
    /// Rays for the samples that the light proposes, and the height above the surface at which they start.
    pub rays: Option<(Tracer, f32)>,
}

impl<'a> Probes<'a> {
    pub fn new(set: &'a ProbeSet, config: &super::RelightConfig) -> Self {
        let config = ProbeConfig {
            neighbours: config.neighbours,
            radius: config.radius,
            visibility: config.hidden_probes,
            ..ProbeConfig::default()
        };
        let (index, lookup) = (set.index(&config), LookupConfig::new(set, &config));
        Self { set: Cow::Borrowed(set), index, lookup, glowing: false, rays: None }
    }

    pub fn near(&self, position: Vec3, normal: Vec3) -> Neighbours {
        self.index.query(position, normal, &self.set, &self.lookup)
    }
}

/// [`Surroundings`] at one point; moved from point to point, because it holds room for a texture.
pub(super) struct Around<'s> {
    surroundings: &'s Surroundings<'s>,
    /// Blended texture of the probes near the point.
    texture: Vec<[f32; 4]>,
    /// Where rays start.
    origin: Vec3,
}

impl<'s> Around<'s> {
    pub fn new(surroundings: &'s Surroundings<'s>) -> Self {
        let texels = match surroundings {
            Surroundings::Probes(probes) => probes.set.texture_len(),
            _ => 0,
        };
        Self { surroundings, texture: vec![[0.0; 4]; texels], origin: Vec3::ZERO }
    }

    /// Goes to a surface point with a unit normal.
    pub fn go_to(&mut self, position: Vec3, normal: Vec3) {
        match self.surroundings {
            Surroundings::Open => {}
            Surroundings::Probes(probes) => {
                probes.set.blend(&probes.near(position, normal), &mut self.texture);
                let offset = probes.rays.as_ref().map_or(0.0, |(_, offset)| *offset);
                self.origin = position + offset * normal;
            }
            Surroundings::Trace { offset, .. } => self.origin = position + *offset * normal,
        }
    }

    /// 1 − O in 255ths towards every texel of an octahedral map on the side of `normal`; all of it on the other, where nobody
    /// asks. The texture itself where there are probes.
    pub fn open_texels(&self, directions: &[Vec3], normal: Vec3) -> Vec<u8> {
        let share = |open: f32| (255.0 * open.clamp(0.0, 1.0)).round() as u8;
        match self.surroundings {
            Surroundings::Probes(_) => self.texture.iter().map(|t| share(1.0 - t[3])).collect(),
            // A texel around the horizon is read by directions above it.
            _ => directions
                .iter()
                .map(|d| if normal.dot(*d) > -0.2 { share(self.look(*d).0) } else { 255 })
                .collect(),
        }
    }

    /// [`Around::look`] for a direction that the light proposed: traced, where such are.
    #[inline]
    pub fn look_at_light(&self, direction: Vec3) -> (f32, Vec3) {
        match self.surroundings {
            Surroundings::Probes(Probes { rays: Some((tracer, _)), glowing, .. }) => {
                let incoming = if *glowing { self.look(direction).1 } else { Vec3::ZERO };
                (tracer.transmittance(self.origin, direction, 0.0, f32::INFINITY), incoming)
            }
            _ => self.look(direction),
        }
    }

    /// 1 − O in [0, 1] and L_in from a unit direction.
    #[inline]
    pub fn look(&self, direction: Vec3) -> (f32, Vec3) {
        match self.surroundings {
            Surroundings::Open => (1.0, Vec3::ZERO),
            Surroundings::Probes(probes) => {
                let [r, g, b, occlusion] =
                    comgs_probe::sample(&self.texture, probes.set.resolution, direction);
                let incoming = if probes.glowing { Vec3::new(r, g, b) } else { Vec3::ZERO };
                ((1.0 - occlusion).clamp(0.0, 1.0), incoming)
            }
            Surroundings::Trace { tracer, glowing: false, .. } => {
                (tracer.transmittance(self.origin, direction, 0.0, f32::INFINITY), Vec3::ZERO)
            }
            Surroundings::Trace { tracer, glowing: true, .. } => {
                let hit = tracer.radiance(self.origin, direction, 0.0, f32::INFINITY);
                (1.0 - hit.alpha, hit.radiance)
            }
        }
    }
}

impl Surroundings<'_> {
    /// The normal of a surfel turned outwards: to the side of the probes around it; without probes to the side from which
    /// more of `directions` (about +z, the same for both sides) is open. A surfel's own normal has no side.
    pub fn outward(&self, position: Vec3, normal: Vec3, directions: &[Vec3]) -> Vec3 {
        let turned = match self {
            Surroundings::Open => false,
            Surroundings::Probes(probes) => {
                // Without a normal the weights do not depend on the side.
                let near = probes.near(position, Vec3::ZERO);
                near.iter().map(|(probe, w)| w * probes.set.normals[probe].dot(normal)).sum::<f32>() < 0.0
            }
            Surroundings::Trace { tracer, offset, .. } => {
                let open = |side: Vec3| -> f32 {
                    let frame = comgs_geom::frame::world_from_tangent(side);
                    let origin = position + *offset * side;
                    directions
                        .iter()
                        .map(|d| tracer.transmittance(origin, frame * *d, 0.0, f32::INFINITY))
                        .sum()
                };
                open(-normal) > open(normal)
            }
        };
        if turned { -normal } else { normal }
    }
}
