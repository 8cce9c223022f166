//! The tracer with a fixed eye.

use crate::{RadianceHit, Ray, Tracer, bvh::WIDTH};
use glam::Vec3;
use rayon::prelude::*;

/// A [`Tracer`] for rays that all leave one point. A surfel's colour depends on the eye alone, so it is worked out
/// once a surfel instead of once a hit. Made by [`Tracer::view`].
pub struct TracerView<'a> {
    tracer: &'a Tracer,
    origin: Vec3,
    /// By surfel of the cloud; black for surfels that are not traced.
    colours: Vec<Vec3>,
}

impl<'a> TracerView<'a> {
    pub(crate) fn new(tracer: &'a Tracer, origin: Vec3) -> Self {
        let bvh = &tracer.bvh;
        let by_slot: Vec<Vec3> = bvh
            .surfels
            .par_iter()
            .enumerate()
            .with_min_len(256)
            .map(|(slot, &surfel)| {
                if surfel == u32::MAX {
                    return Vec3::ZERO;
                }
                let [x, y, z] = bvh.blocks[slot / WIDTH].centre.map(|row| row[slot % WIDTH]);
                tracer.colour(surfel, Vec3::new(x, y, z), origin, Vec3::Z)
            })
            .collect();
        let surfels = tracer.colours.sh.len() / tracer.colours.sh_stride();
        let mut colours = vec![Vec3::ZERO; surfels];
        for (&surfel, colour) in bvh.surfels.iter().zip(by_slot) {
            if surfel != u32::MAX {
                colours[surfel as usize] = colour;
            }
        }
        Self { tracer, origin, colours }
    }

    /// The eye.
    #[must_use]
    pub fn origin(&self) -> Vec3 {
        self.origin
    }

    /// As [`Tracer::radiance`] from the eye. Where the eye is exactly a surfel's centre, that surfel shows the colour
    /// it has along +z.
    #[must_use]
    pub fn radiance(&self, direction: Vec3, t_min: f32, t_max: f32) -> RadianceHit {
        let ray = Ray { origin: self.origin, direction, t_min, t_max };
        self.tracer.blend(&ray, |surfel, _| self.colours[surfel as usize])
    }
}
