//! The 360° sweep.

use crate::{Completion, CompletionError, Partial, complete};
use comgs_geom::equirect;
use comgs_image::Image;
use comgs_trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;

/// How a sweep is taken.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepConfig {
    /// Surfels nearer to the centre than this are not seen, scene units. Captured scenes have floaters in free space,
    /// and one close to the centre would cover half the sphere; a tenth of the object's size is a good value.
    pub t_min: f32,
    /// Nor are those further than this; scene units, may be infinite.
    pub t_max: f32,
    /// A texel is the mean of `samples²` rays on a regular grid in it; 0 is taken as 1.
    pub samples: usize,
}

impl Default for SweepConfig {
    /// Everything in view, one ray through each texel's centre.
    fn default() -> Self {
        Self { t_min: 0.0, t_max: f32::INFINITY, samples: 1 }
    }
}

/// Equirectangular panoramas around a point, z up ([`comgs_geom::equirect`]), all of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Linear radiance, 3 channels, straight (divided by alpha); 0 where alpha is 0.
    pub rgb: Image,
    /// Opacity of what was met, 1 channel in [0, 1].
    pub alpha: Image,
    /// Unit normal facing the centre, world, 3 channels; 0 where nothing was met.
    pub normal: Image,
    /// Mean distance from the centre, scene units, 1 channel; 0 where nothing was met.
    pub depth: Image,
    /// Solid angle in which alpha exceeds ½, as a share of the sphere.
    pub coverage: f32,
}

impl Sweep {
    /// What a completer is given.
    ///
    /// * `clip`: radiance from which the capture's photos say only "at least this" (1 for pictures that clip at white);
    ///   texels that reach it in any channel are marked; `None` for captures in high dynamic range
    #[must_use]
    pub fn partial(&self, clip: Option<f32>) -> Partial {
        let clipped = clip.map(|level| {
            let brightest = |p: &[f32]| p.iter().copied().fold(0.0, f32::max);
            let marks = self.rgb.data.chunks_exact(3).zip(&self.alpha.data);
            let data = marks.map(|(p, &a)| f32::from(u8::from(a > 0.5 && brightest(p) >= CLIPPED * level)));
            Image::from_data(self.rgb.width, self.rgb.height, 1, data.collect())
        });
        Partial {
            rgb: self.rgb.clone(),
            alpha: self.alpha.clone(),
            normal: Some(self.normal.clone()),
            clipped,
        }
    }

    /// The radiance with its holes filled, 3 channels. See [`complete()`].
    ///
    /// # Errors
    /// [`CompletionError`] when nothing at all was seen.
    pub fn complete(&self, completion: Completion) -> Result<Image, CompletionError> {
        complete(&self.rgb, &self.alpha, completion)
    }
}

/// A reconstruction reaches the photos' white only nearly.
const CLIPPED: f32 = 0.97;

/// Looks around from `centre` (world): `width × height` texels over the whole sphere, rows in parallel, the same
/// bytes at any thread count.
///
/// A centre that is not finite sees nothing.
#[must_use]
pub fn sweep(tracer: &Tracer, centre: Vec3, width: usize, height: usize, config: &SweepConfig) -> Sweep {
    let view = tracer.view(centre);
    let samples = config.samples.max(1);
    // rgb, alpha, normal, depth of every texel of a row.
    let texel = |x: usize, y: usize| -> [f32; 8] {
        let (mut radiance, mut alpha, mut normal, mut depth) = (Vec3::ZERO, 0.0f32, Vec3::ZERO, 0.0f32);
        for sub in 0..samples * samples {
            let inside = |k: usize| (k as f32 + 0.5) / samples as f32;
            let u = (x as f32 + inside(sub % samples)) / width as f32;
            let v = (y as f32 + inside(sub / samples)) / height as f32;
            let hit = view.radiance(equirect::direction(u, v), config.t_min, config.t_max);
            radiance += hit.radiance;
            alpha += hit.alpha;
            normal += hit.normal;
            depth += hit.depth;
        }
        if alpha > 0.0 {
            radiance /= alpha;
            depth /= alpha;
            alpha /= (samples * samples) as f32;
        }
        let n = normal.normalize_or_zero();
        [radiance.x, radiance.y, radiance.z, alpha, n.x, n.y, n.z, depth]
    };
    let rows: Vec<Vec<[f32; 8]>> =
        (0..height).into_par_iter().map(|y| (0..width).map(|x| texel(x, y)).collect()).collect();
    let plane = |channels: std::ops::Range<usize>| {
        let data = rows.iter().flatten().flat_map(|texel| &texel[channels.clone()]).copied().collect();
        Image::from_data(width, height, channels.len(), data)
    };
    let alpha = plane(3..4);
    Sweep { rgb: plane(0..3), normal: plane(4..7), depth: plane(7..8), coverage: coverage(&alpha), alpha }
}

/// Share of the sphere in which a one-channel equirectangular map exceeds ½; 0 for an empty one.
#[must_use]
pub fn coverage(alpha: &Image) -> f32 {
    let mut covered = 0.0f64;
    for y in 0..alpha.height {
        let row = &alpha.data[y * alpha.width..(y + 1) * alpha.width];
        let count = row.iter().filter(|&&a| a > 0.5).count();
        covered += count as f64 * f64::from(equirect::texel_solid_angle(y, alpha.width, alpha.height));
    }
    (covered / (4.0 * std::f64::consts::PI)) as f32
}
