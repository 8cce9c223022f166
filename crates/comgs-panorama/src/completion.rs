//! Filling what a sweep has not seen.

use crate::partial::Partial;
use crate::poisson::{self, Cells};
use comgs_geom::equirect;
use comgs_image::Image;
use glam::DVec3;
use thiserror::Error;

/// How unseen directions are filled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Completion {
    /// Unseen directions stay black.
    None,
    /// [`complete_harmonic`].
    #[default]
    Harmonic,
}

/// Why a panorama could not be completed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CompletionError {
    /// The images do not belong together.
    #[error(
        "radiance is {}×{}×{} and alpha {}×{}×{}, expected 1 or 3 channels and 1 channel of the same size",
        .rgb[0], .rgb[1], .rgb[2], .alpha[0], .alpha[1], .alpha[2]
    )]
    Shape {
        /// Width, height and channels of the radiance.
        rgb: [usize; 3],
        /// Width, height and channels of alpha.
        alpha: [usize; 3],
    },
    /// No full sphere.
    #[error("the panorama is {width}×{height}; an equirectangular map is twice as wide as high")]
    Aspect {
        /// Width in texels.
        width: usize,
        /// Height in texels.
        height: usize,
    },
    /// A bank without panoramas.
    #[error("the bank holds no panorama to compare with")]
    EmptyBank,
    /// The learned model could not be run.
    #[error(transparent)]
    Model(#[from] crate::ModelError),
    /// There is nothing to continue.
    #[error("nothing was seen in any direction (largest alpha {largest}); there is no light to continue")]
    NothingSeen {
        /// Largest alpha of the panorama.
        largest: f32,
    },
    /// The solver gave up; this is a defect, not a property of the input.
    #[error(
        "the harmonic completion did not converge: residual {residual:.3e} after {iterations} iterations"
    )]
    NotConverged {
        /// Energy norm of the residual, relative to the spread of the data.
        residual: f64,
        /// Iterations made.
        iterations: usize,
    },
}

/// Opacity from which a texel counts as fully seen: it is kept to the bit.
pub const SEEN: f32 = 0.999;
/// Opacity below which a texel says nothing.
pub const UNSEEN: f32 = 0.05;
/// Radiance below this part of the mean is raised to it before the logarithm, which has no value for black.
const DARKEST: f64 = 1e-3;

/// Completes a panorama.
///
/// * `rgb`: equirectangular, linear radiance, straight, 1 or 3 channels
/// * `alpha`: same size, 1 channel; clamped to [0, 1]
///
/// Returns radiance everywhere: `α · rgb + (1 − α) · fill`, with the fill black for [`Completion::None`]. Texels of
/// alpha ≥ [`SEEN`] are `rgb` exactly. Samples that are not finite count as unseen, negative ones as 0.
///
/// # Errors
/// [`CompletionError::Shape`]; and for the harmonic completion, [`CompletionError::NothingSeen`] when no alpha
/// reaches [`UNSEEN`].
pub fn complete(rgb: &Image, alpha: &Image, completion: Completion) -> Result<Image, CompletionError> {
    match completion {
        Completion::Harmonic => complete_harmonic(rgb, alpha),
        Completion::None => {
            let texels = texels(rgb, alpha)?;
            Ok(over(rgb, &texels, &vec![DVec3::ZERO; texels.len()]))
        }
    }
}

/// Completes a panorama with the smoothest field of log radiance x on the sphere that agrees with what was seen:
///
/// ```text
/// minimise ∫ |∇x|² dω   with x = log rgb where α ≥ SEEN,
/// ```
///
/// which is Laplace's equation in between (the fill has no maxima or minima of its own). The logarithm makes a
/// fill of ratios, as fits light over several decades, and keeps it positive; radiance below a thousandth of the mean
/// counts as that. Where alpha is between [`UNSEEN`] and [`SEEN`] the texel is pulled towards what was seen
/// with the weight `t = α⁴`: it becomes `(1 − t) · (mean of its neighbours) + t · log rgb`. The fourth power because
/// half-seen texels are mostly floaters: α = ½ is trusted over 2 texels, α = 0.1 not at all over 50.
///
/// Finite volumes on the texels with the sphere's own metric: edges shrink with sin φ, so that nothing flows over a
/// pole's edge of length 0 and the polar ring is one strongly coupled whole; the azimuth wraps. Solved by conjugate
/// gradients in f64 to 1e-6 of the data's spread ([`CompletionError::NotConverged`] never hides a worse result).
///
/// For shapes and the treatment of unusable samples see [`complete()`]. Not differentiable code, though the fill is
/// linear in log rgb.
///
/// # Errors
/// [`CompletionError`].
pub fn complete_harmonic(rgb: &Image, alpha: &Image) -> Result<Image, CompletionError> {
    let texels = texels(rgb, alpha)?;
    let largest = texels.iter().map(|t| t.alpha).fold(0.0f32, f32::max);
    if largest < UNSEEN {
        return Err(CompletionError::NothingSeen { largest });
    }
    if texels.iter().all(|t| t.alpha >= SEEN) {
        return Ok(over(rgb, &texels, &vec![DVec3::ZERO; texels.len()]));
    }
    let (width, height) = (rgb.width, rgb.height);
    // The floor is one for all channels, so that it does not change the hue of dark texels' surroundings.
    let (mut sum, mut weight) = (0.0f64, 0.0f64);
    for (i, t) in texels.iter().enumerate() {
        let omega = f64::from(equirect::texel_solid_angle(i / width, width, height) * t.alpha);
        sum += omega * (t.rgb.x + t.rgb.y + t.rgb.z) / 3.0;
        weight += omega;
    }
    let mean = sum / weight;
    if mean <= 0.0 {
        // All black: black it stays.
        return Ok(over(rgb, &texels, &vec![DVec3::ZERO; texels.len()]));
    }
    let floor = DVec3::splat(DARKEST * mean);
    let trust = texels
        .iter()
        .map(|t| match t.alpha {
            a if a >= SEEN => 1.0,
            a if a < UNSEEN => 0.0,
            a => f64::from(a).powi(4),
        })
        .collect();
    let data = texels.iter().map(|t| t.rgb.max(floor).map(f64::ln)).collect();
    let cells = Cells { width, height, trust, data };
    let fill = poisson::solve(&cells)
        .map_err(|(residual, iterations)| CompletionError::NotConverged { residual, iterations })?;
    Ok(over(rgb, &texels, &fill.into_iter().map(|x| x.map(f64::exp)).collect::<Vec<_>>()))
}

/// A texel with unusable samples taken care of.
#[derive(Clone, Copy)]
struct Texel {
    rgb: DVec3,
    alpha: f32,
}

/// `α · rgb + (1 − α) · fill(x, y)` for a completer; clipped texels take the brighter of what was seen and the fill.
pub(crate) fn over_fill(
    partial: &Partial,
    fill: &dyn Fn(usize, usize) -> DVec3,
) -> Result<Image, CompletionError> {
    let texels = texels(&partial.rgb, &partial.alpha)?;
    let width = partial.rgb.width;
    let values: Vec<DVec3> = (0..texels.len()).map(|i| fill(i % width, i / width)).collect();
    let mut out = over(&partial.rgb, &texels, &values);
    if let Some(clipped) = &partial.clipped {
        for (i, &c) in clipped.data.iter().enumerate() {
            if c > 0.5 && texels[i].alpha >= UNSEEN {
                for (v, f) in out.data[3 * i..3 * i + 3].iter_mut().zip(values[i].to_array()) {
                    *v = v.max(f as f32);
                }
            }
        }
    }
    Ok(out)
}

fn texels(rgb: &Image, alpha: &Image) -> Result<Vec<Texel>, CompletionError> {
    let size = |image: &Image| [image.width, image.height, image.channels];
    if alpha.channels != 1
        || !matches!(rgb.channels, 1 | 3)
        || (rgb.width, rgb.height) != (alpha.width, alpha.height)
        || rgb.pixels() == 0
    {
        return Err(CompletionError::Shape { rgb: size(rgb), alpha: size(alpha) });
    }
    let texel = |i: usize| {
        let value = DVec3::from_array(rgb.rgb(i % rgb.width, i / rgb.width).map(f64::from));
        let alpha = alpha.data[i];
        if value.is_finite() && alpha.is_finite() {
            Texel { rgb: value.max(DVec3::ZERO), alpha: alpha.clamp(0.0, 1.0) }
        } else {
            Texel { rgb: DVec3::ZERO, alpha: 0.0 }
        }
    };
    Ok((0..rgb.pixels()).map(texel).collect())
}

/// `α · rgb + (1 − α) · fill` with as many channels as `rgb`; what is seen is copied.
fn over(rgb: &Image, texels: &[Texel], fill: &[DVec3]) -> Image {
    let mut out = Image::zeros(rgb.width, rgb.height, rgb.channels);
    for (i, (pixel, texel)) in out.data.chunks_exact_mut(rgb.channels).zip(texels).enumerate() {
        let alpha = if texel.alpha >= SEEN { 1.0 } else { f64::from(texel.alpha) };
        let value = if alpha == 1.0 { texel.rgb } else { alpha * texel.rgb + (1.0 - alpha) * fill[i] };
        for (c, v) in pixel.iter_mut().enumerate() {
            *v = value[c] as f32;
        }
    }
    out
}
