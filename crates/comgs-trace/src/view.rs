//! The tracer with a fixed eye.

use crate::{RadianceHit, Ray, Tracer, bvh::WIDTH};
use glam::Vec3;
use rayon::prelude::*;
use std::borrow::Cow;

/// Colours of a tracer's surfels as one eye sees them. They outlive the view, so that who looks from the same point again
/// need not work them out again. Made by [`Tracer::eye_colours`].
#[derive(Clone, Debug)]
pub struct EyeColours {
    origin: Vec3,
    /// By surfel of the cloud; black for surfels that are not traced.
    colours: Vec<Vec3>,
}

impl EyeColours {
    pub(crate) fn new(tracer: &Tracer, origin: Vec3) -> Self {
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
        Self { origin, colours }
    }
}

/// A [`Tracer`] for rays that all leave one point. A surfel's colour depends on the eye alone, so it is worked out
/// once a surfel instead of once a hit. Made by [`Tracer::view`] and [`Tracer::view_with`].
pub struct TracerView<'a> {
    tracer: &'a Tracer,
    eye: Cow<'a, EyeColours>,
}

impl<'a> TracerView<'a> {
    pub(crate) fn new(tracer: &'a Tracer, eye: Cow<'a, EyeColours>) -> Self {
        Self { tracer, eye }
    }

    /// The eye.
    #[must_use]
    pub fn origin(&self) -> Vec3 {
        self.eye.origin
    }

    /// As [`Tracer::radiance`] from the eye. Where the eye is exactly a surfel's centre, that surfel shows the colour
    /// it has along +z.
    #[must_use]
    pub fn radiance(&self, direction: Vec3, t_min: f32, t_max: f32) -> RadianceHit {
        let ray = Ray { origin: self.eye.origin, direction, t_min, t_max };
        self.tracer.blend(&ray, |surfel, _| self.eye.colours[surfel as usize])
    }
}
