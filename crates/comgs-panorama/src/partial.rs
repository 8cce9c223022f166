//! A panorama of which only part is known, and the trait of what completes it.

use crate::CompletionError;
use comgs_geom::equirect;
use comgs_image::Image;

/// What is known of a panorama: equirectangular maps of one size, z up.
#[derive(Clone, Debug, PartialEq)]
pub struct Partial {
    /// Linear radiance, 3 channels, straight (not multiplied by alpha).
    pub rgb: Image,
    /// How much of each texel is known, 1 channel in [0, 1].
    pub alpha: Image,
    /// Unit normals of the surfaces seen, facing the centre, 3 channels; 0 where none is known.
    pub normal: Option<Image>,
    /// 1 where the radiance is only a lower bound because the photos clipped there, else 0; 1 channel.
    pub clipped: Option<Image>,
}

impl Partial {
    /// Radiance and alpha alone.
    ///
    /// # Errors
    /// [`CompletionError::Shape`].
    pub fn new(rgb: Image, alpha: Image) -> Result<Self, CompletionError> {
        let partial = Self { rgb, alpha, normal: None, clipped: None };
        partial.check()?;
        Ok(partial)
    }

    /// Whether the maps belong together: 3, 1, 3 and 1 channels, one size, twice as wide as high.
    ///
    /// # Errors
    /// [`CompletionError::Shape`], [`CompletionError::Aspect`].
    pub fn check(&self) -> Result<(), CompletionError> {
        let size = |image: &Image| [image.width, image.height, image.channels];
        let [width, height, _] = size(&self.rgb);
        let fits = |image: &Image, channels| size(image) == [width, height, channels];
        let all = fits(&self.rgb, 3)
            && fits(&self.alpha, 1)
            && self.normal.as_ref().is_none_or(|n| fits(n, 3))
            && self.clipped.as_ref().is_none_or(|c| fits(c, 1));
        if !all || self.rgb.pixels() == 0 {
            return Err(CompletionError::Shape { rgb: size(&self.rgb), alpha: size(&self.alpha) });
        }
        if width != 2 * height {
            return Err(CompletionError::Aspect { width, height });
        }
        Ok(())
    }

    /// Share of the sphere that is known (alpha over ½).
    #[must_use]
    pub fn coverage(&self) -> f64 {
        f64::from(crate::sweep::coverage(&self.alpha))
    }

    /// Turned to the right by `texels`, as when the camera turns left.
    #[must_use]
    pub fn rolled(&self, texels: usize) -> Self {
        let angle = texels as f32 / self.rgb.width as f32 * std::f32::consts::TAU;
        // A map moved right by an angle shows directions turned by minus that angle about z.
        let turn = glam::Mat3::from_rotation_z(-angle);
        let normal = self.normal.as_ref().map(|n| {
            let mut n = roll(n, texels);
            for v in n.data.chunks_exact_mut(3) {
                v.copy_from_slice(&(turn * glam::Vec3::from_slice(v)).to_array());
            }
            n
        });
        Self {
            rgb: roll(&self.rgb, texels),
            alpha: roll(&self.alpha, texels),
            normal,
            clipped: self.clipped.as_ref().map(|c| roll(c, texels)),
        }
    }
}

/// The image moved to the right by `texels` around the azimuth.
#[must_use]
pub fn roll(image: &Image, texels: usize) -> Image {
    let row = image.width * image.channels;
    let by = texels % image.width * image.channels;
    let mut data = image.data.clone();
    for line in data.chunks_exact_mut(row) {
        line.rotate_right(by);
    }
    Image::from_data(image.width, image.height, image.channels, data)
}

/// The map at another size: area means when smaller, bilinear on the sphere when larger (around the azimuth, clamped at
/// the poles).
#[must_use]
pub fn resized(image: &Image, width: usize, height: usize) -> Image {
    if (width, height) == (image.width, image.height) {
        return image.clone();
    }
    let channels = image.channels;
    let mut out = Image::zeros(width, height, channels);
    let (sx, sy) = (image.width as f64 / width as f64, image.height as f64 / height as f64);
    let overlap = |i: usize, scale: f64, n: usize| -> Vec<(usize, f64)> {
        if scale <= 1.0 {
            let at = (i as f64 + 0.5) * scale - 0.5;
            let low = at.floor();
            let wrap = |k: f64| k.rem_euclid(n as f64) as usize;
            return vec![(wrap(low), 1.0 - (at - low)), (wrap(low + 1.0), at - low)];
        }
        let (a, b) = (i as f64 * scale, (i + 1) as f64 * scale);
        (a.floor() as usize..(b.ceil() as usize).min(n))
            .map(|k| (k, ((k + 1) as f64).min(b) - (k as f64).max(a)))
            .filter(|&(_, w)| w > 1e-9)
            .collect()
    };
    let columns: Vec<_> = (0..width).map(|x| overlap(x, sx, image.width)).collect();
    for y in 0..height {
        let rows = if sy <= 1.0 {
            let at = ((y as f64 + 0.5) * sy - 0.5).clamp(0.0, (image.height - 1) as f64);
            let low = at.floor() as usize;
            vec![(low, 1.0 - at.fract()), ((low + 1).min(image.height - 1), at.fract())]
        } else {
            overlap(y, sy, image.height)
        };
        for (x, column) in columns.iter().enumerate() {
            let mut sum = vec![0.0f64; channels];
            let mut weights = 0.0;
            for &(j, wy) in &rows {
                for &(i, wx) in column {
                    weights += wx * wy;
                    for (s, v) in sum.iter_mut().zip(image.pixel(i, j)) {
                        *s += wx * wy * f64::from(*v);
                    }
                }
            }
            for (o, s) in out.pixel_mut(x, y).iter_mut().zip(&sum) {
                *o = (s / weights) as f32;
            }
        }
    }
    out
}

/// Something that fills the unknown part of a panorama.
///
/// What is known comes back as it was: `α · rgb + (1 − α) · fill`, to the bit where alpha reaches
/// [`crate::completion::SEEN`], except clipped texels, which may become brighter (never darker).
pub trait Completer: Send + Sync {
    /// Name for reports and tables.
    fn name(&self) -> String;

    /// Linear radiance everywhere, 3 channels, of the partial's size; finite and not negative. The same seed gives the
    /// same bytes; completers without chance ignore it.
    ///
    /// # Errors
    /// [`CompletionError`].
    fn complete(&self, partial: &Partial, seed: u64) -> Result<Image, CompletionError>;
}

/// Solid-angle-weighted sums over known texels of a map: `f` is given direction, weight (steradian · alpha) and colour.
pub(crate) fn for_known(partial: &Partial, mut f: impl FnMut(glam::Vec3, f64, [f32; 3])) {
    let (width, height) = (partial.rgb.width, partial.rgb.height);
    for y in 0..height {
        let omega = f64::from(equirect::texel_solid_angle(y, width, height));
        for x in 0..width {
            let alpha = partial.alpha.data[y * width + x];
            let rgb = partial.rgb.rgb(x, y);
            let usable =
                alpha.is_finite() && alpha >= crate::completion::UNSEEN && rgb.iter().all(|v| v.is_finite());
            if usable {
                f(
                    equirect::texel_direction(x, y, width, height),
                    omega * f64::from(alpha.min(1.0)),
                    rgb.map(|v| v.max(0.0)),
                );
            }
        }
    }
}
