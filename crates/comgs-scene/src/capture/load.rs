//! Pixels of a capture.

use super::{Capture, Split, ViewRecord};
use crate::SceneError;
use crate::undistort::Undistortion;
use comgs_geom::Camera;
use comgs_image::{Encoding, Image};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// At which size images are wanted. They are never enlarged.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum Size {
    /// As they are.
    #[default]
    Full,
    /// At most this many pixels wide.
    MaxWidth(usize),
    /// Smaller by this factor (≥ 1) along both sides.
    Downscale(f64),
}

impl Size {
    /// The size of an image of `width × height` under this choice.
    #[must_use]
    pub fn apply(self, width: usize, height: usize) -> (usize, usize) {
        let factor = match self {
            Self::Full => 1.0,
            Self::MaxWidth(limit) => width as f64 / limit.max(1) as f64,
            Self::Downscale(factor) => factor,
        };
        if !(factor > 1.0) {
            return (width, height);
        }
        let scaled = |v: usize| ((v as f64 / factor).round() as usize).max(1);
        (scaled(width), scaled(height))
    }
}

/// How to load.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct LoadOptions {
    /// Image size.
    pub size: Size,
}

/// A step of loading, for progress bars.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoadProgress<'a> {
    /// Views that are ready, this one included.
    pub done: usize,
    /// Views in all.
    pub total: usize,
    /// The view that just became ready.
    pub name: &'a str,
}

/// A photograph, straightened, in linear radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Pinhole camera of exactly these pixels.
    pub camera: Camera,
    /// Three channels, linear Rec.709. Where there is alpha the colour is straight (not premultiplied).
    pub color: Image,
    /// Coverage by the object in [0, 1], from the mask file, or else the image's alpha.
    pub alpha: Option<Image>,
    /// 1 where the photograph has something to say, 0 where a pixel must be ignored (outside a straightened photograph,
    /// or non-finite in the file); `None` when all pixels count.
    pub valid: Option<Image>,
    /// Whether the file was a clipped sRGB photograph or linear HDR.
    pub encoding: Encoding,
    /// [`Split::Train`] or [`Split::Test`].
    pub split: Split,
    /// Pixels of the file that were NaN or infinite; they are 0 and not `valid`.
    pub repaired: usize,
}

/// Pixels that are decoded at the same time; what is decoded beyond the finished views is bounded by about fifty bytes
/// times this (or one image, if that is larger).
const PIXELS_IN_FLIGHT: usize = 1 << 25;

impl Capture {
    /// Loads the views in parallel, in list order.
    ///
    /// # Errors
    /// [`SceneError::Image`] for the first view, in list order, that cannot be read.
    pub fn load(&self, options: &LoadOptions) -> Result<Vec<View>, SceneError> {
        self.load_with(options, &|_| {})
    }

    /// [`Capture::load`] with a progress callback, which is called from several threads.
    ///
    /// # Errors
    /// As [`Capture::load`].
    pub fn load_with(
        &self,
        options: &LoadOptions,
        progress: &(dyn Fn(LoadProgress<'_>) + Sync),
    ) -> Result<Vec<View>, SceneError> {
        let done = AtomicUsize::new(0);
        let mut views = Vec::with_capacity(self.views.len());
        let mut rest = self.views.as_slice();
        while !rest.is_empty() {
            let (batch, later) = rest.split_at(batch_length(rest));
            rest = later;
            let loaded: Vec<Result<View, SceneError>> = batch
                .par_iter()
                .map(|record| {
                    let view = record.load(options)?;
                    let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                    progress(LoadProgress { done, total: self.views.len(), name: &view.camera.name });
                    Ok(view)
                })
                .collect();
            for view in loaded {
                views.push(view?);
            }
        }
        Ok(views)
    }

    /// Bytes that [`Capture::load`] returns, roughly: five floats a pixel.
    #[must_use]
    pub fn memory_bytes(&self, options: &LoadOptions) -> u64 {
        let pixels = |v: &ViewRecord| {
            let (w, h) = options.size.apply(v.camera.width, v.camera.height);
            w as u64 * h as u64
        };
        self.views.iter().map(|v| pixels(v) * 20).sum()
    }
}

/// How many of the records may be decoded at once.
fn batch_length(records: &[ViewRecord]) -> usize {
    let mut pixels = 0usize;
    let fits = records
        .iter()
        .take_while(|r| {
            pixels = pixels.saturating_add(r.camera.width.saturating_mul(r.camera.height));
            pixels <= PIXELS_IN_FLIGHT
        })
        .count();
    fits.max(1)
}

impl ViewRecord {
    /// Loads this view.
    ///
    /// # Errors
    /// [`SceneError::Image`] when image or mask cannot be read, [`SceneError::Malformed`] when their size has changed
    /// since the capture was opened.
    pub fn load(&self, options: &LoadOptions) -> Result<View, SceneError> {
        let loaded = comgs_image::read(&self.image)?;
        let encoding = loaded.encoding;
        let expected = (self.camera.width, self.camera.height);
        let same_size = |image: &Image, path: &std::path::Path| {
            if (image.width, image.height) == expected {
                return Ok(());
            }
            let (w, h) = expected;
            Err(SceneError::malformed(
                path,
                format!("{}×{} pixels, expected {w}×{h}", image.width, image.height),
            ))
        };
        same_size(&loaded.color, &self.image)?;
        let mut color = match loaded.color.channels {
            3 => loaded.color,
            _ => loaded.color.select(&[0, 0, 0]),
        };
        let mut alpha = loaded.alpha;
        if let Some(path) = &self.mask {
            let mask = comgs_image::read(path)?;
            same_size(&mask.color, path)?;
            alpha = Some(mask_values(mask));
        }
        let mut valid = None;
        let repaired = repair(&mut color, alpha.as_mut(), &mut valid);

        let (width, height) = options.size.apply(expected.0, expected.1);
        let straightens = !self.lens.is_pinhole();
        if straightens || (width, height) != expected {
            // Colours are averaged by how much of them there is, or the background would leak in at edges.
            premultiply(&mut color, alpha.as_ref());
            if straightens {
                let map = Undistortion::new(&self.lens, &self.camera);
                color = map.apply(&color);
                alpha = alpha.map(|a| map.apply(&a));
                let seen = map.valid();
                valid = match (valid.map(|v| map.apply(&v)), seen) {
                    (Some(a), Some(b)) => Some(and(a, &b)),
                    (a, b) => a.or(b),
                };
            }
            if (width, height) != expected {
                color = color.resized(width, height);
                alpha = alpha.map(|a| a.resized(width, height));
                valid = valid.map(|v| v.resized(width, height));
            }
            unpremultiply(&mut color, alpha.as_ref());
            // A pixel that any ignored one has a share in is ignored.
            valid = valid.map(|v| v.map(|v| if v > 0.999 { 1.0 } else { 0.0 }));
        }
        let camera = if (width, height) == expected {
            self.camera.clone()
        } else {
            self.camera.resized(width, height)
        };
        Ok(View { camera, color, alpha, valid, encoding, split: self.split, repaired })
    }
}

/// A mask file's values: its alpha when it has one that says something, else its grey codes as stored (a mask is not a
/// picture, so the sRGB curve is undone again).
fn mask_values(mask: comgs_image::Loaded) -> Image {
    if let Some(alpha) = mask.alpha.filter(|a| a.data.iter().any(|&v| v < 1.0)) {
        return alpha;
    }
    let grey = mask.color.select(&[0]);
    match mask.encoding {
        Encoding::Srgb => grey.map(|v| comgs_image::transfer::srgb_from_linear(v).clamp(0.0, 1.0)),
        Encoding::Linear => grey.map(|v| v.clamp(0.0, 1.0)),
    }
}

/// Zeroes pixels with non-finite values and marks them invalid. Returns their number.
fn repair(color: &mut Image, alpha: Option<&mut Image>, valid: &mut Option<Image>) -> usize {
    let mut alpha = alpha;
    let mut repaired = 0;
    for i in 0..color.pixels() {
        let pixel = &mut color.data[i * 3..i * 3 + 3];
        let coverage = alpha.as_ref().map_or(1.0, |a| a.data[i]);
        if pixel.iter().all(|v| v.is_finite()) && coverage.is_finite() {
            continue;
        }
        pixel.fill(0.0);
        if let Some(alpha) = alpha.as_mut() {
            alpha.data[i] = 0.0;
        }
        valid.get_or_insert_with(|| Image::filled(color.width, color.height, 1, 1.0)).data[i] = 0.0;
        repaired += 1;
    }
    repaired
}

fn and(mut a: Image, b: &Image) -> Image {
    for (a, b) in a.data.iter_mut().zip(&b.data) {
        *a = a.min(*b);
    }
    a
}

fn premultiply(color: &mut Image, alpha: Option<&Image>) {
    if let Some(alpha) = alpha {
        for (pixel, a) in color.data.chunks_exact_mut(3).zip(&alpha.data) {
            pixel.iter_mut().for_each(|v| *v *= a);
        }
    }
}

fn unpremultiply(color: &mut Image, alpha: Option<&Image>) {
    if let Some(alpha) = alpha {
        for (pixel, &a) in color.data.chunks_exact_mut(3).zip(&alpha.data) {
            let scale = if a > 1e-6 { 1.0 / a } else { 0.0 };
            pixel.iter_mut().for_each(|v| *v *= scale);
        }
    }
}
