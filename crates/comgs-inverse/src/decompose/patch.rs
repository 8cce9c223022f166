//! Patches: square windows of training views, the pixel subset of a step.

use crate::view::TrainView;
use comgs_geom::{Camera, Rng};
use comgs_image::Image;
use comgs_optim::Target;
use comgs_optim::photometric::Comparison;

/// A training view as the decomposition wants it.
#[derive(Debug)]
pub(crate) struct Source {
    camera: Camera,
    /// Linear, premultiplied.
    color: Image,
    mask: Option<Image>,
    valid: Option<Image>,
    hdr: bool,
    /// Pixels that show the object, as indices.
    inside: Vec<u32>,
}

/// A window of a view.
#[derive(Debug)]
pub(crate) struct Patch {
    pub camera: Camera,
    pub target: Target,
    pub mask: Option<Image>,
}

impl Source {
    pub(crate) fn new(view: &TrainView) -> Self {
        let color = view.premultiplied();
        let shows = |i: usize| view.mask.as_ref().is_none_or(|m| m.data[i] > 0.5);
        let inside = (0..color.pixels()).filter(|&i| shows(i)).map(|i| i as u32).collect();
        Self {
            camera: view.camera.clone(),
            color,
            mask: view.mask.clone(),
            valid: view.valid.clone(),
            hdr: view.hdr,
            inside,
        }
    }

    /// Whether any pixel shows the object.
    pub(crate) fn is_useful(&self) -> bool {
        !self.inside.is_empty()
    }

    pub(crate) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Sum of the premultiplied radiance and count of the pixels that show the object.
    pub(crate) fn radiance_sum(&self) -> (glam::DVec3, usize) {
        let sum = self
            .inside
            .iter()
            .map(|&i| glam::Vec3::from_slice(&self.color.data[3 * i as usize..]).as_dvec3())
            .sum();
        (sum, self.inside.len())
    }

    /// A window of `size` pixels (or the whole width or height, where that is less) around a random pixel of the object.
    pub(crate) fn patch(&self, size: usize, rng: &mut Rng) -> Patch {
        let (width, height) = (self.color.width, self.color.height);
        let centre = self.inside[rng.below(self.inside.len())] as usize;
        let (w, h) = (size.min(width), size.min(height));
        // Anywhere around the pixel, so that borders of patches do not favour any part of it.
        let place = |centre: usize, size: usize, whole: usize, rng: &mut Rng| {
            (centre as isize - rng.below(size) as isize).clamp(0, (whole - size) as isize) as usize
        };
        let x0 = place(centre % width, w, width, rng);
        let y0 = place(centre / width, h, height, rng);
        let crop = |image: &Image| cropped(image, x0, y0, w, h);
        let camera = Camera {
            width: w,
            height: h,
            cx: self.camera.cx - x0 as f64,
            cy: self.camera.cy - y0 as f64,
            ..self.camera.clone()
        };
        let comparison = if self.hdr { Comparison::Coded } else { Comparison::Srgb };
        let valid = self.valid.as_ref().map(crop);
        Patch {
            camera,
            target: Target::new(&crop(&self.color), valid.as_ref(), comparison),
            mask: self.mask.as_ref().map(crop),
        }
    }
}

fn cropped(image: &Image, x0: usize, y0: usize, width: usize, height: usize) -> Image {
    let c = image.channels;
    let mut data = Vec::with_capacity(width * height * c);
    for y in y0..y0 + height {
        let first = (y * image.width + x0) * c;
        data.extend_from_slice(&image.data[first..first + width * c]);
    }
    Image::from_data(width, height, c, data)
}
