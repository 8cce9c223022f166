//! Metrics in plain f64: an independent witness of what the renderers and the training loop do.
//!
//! Nothing here is shared with what it judges. The crate knows only the [`comgs_image::Image`] type; transfer
//! functions, windows and filters are written again in f64. Every function refuses images of different size
//! and images with NaN or infinite samples ([`MetricError`]): a score of a broken frame is not a score.
//!
//! Images are linear Rec.709 radiance. Functions that compare what a viewer would see encode them to sRGB
//! and clip to [0, 1] first and say so. A mask is a one-channel image; a pixel counts where the mask is at
//! least ½.
//!
//! | question | function |
//! |---|---|
//! | how far are the pixels apart | [`psnr_srgb`], [`psnr_linear`], [`psnr_linear_clipped`] |
//! | is the structure the same | [`ssim()`] |
//! | would a viewer see the difference | [`flip::flip`] |
//! | all three, for parts of a composed frame | [`regions::score_regions`] |
//! | is the surface right | [`normal_error`], [`depth_error`], [`unbiased_depth_error`] |
//! | is the material right | [`material_error`] after [`align_scale`], [`plane_error`], [`unbiased_plane_error`] |
//! | is the light right | [`si_rmse`], [`normalized_rmse`], [`angular_rgb_error`] |
//! | is the silhouette right | [`coverage_iou`] |

mod check;
mod color;
pub mod coverage;
pub mod error;
pub mod flip;
pub mod geometry;
pub mod light;
pub mod material;
pub mod psnr;
pub mod regions;
pub mod spheres;
pub mod ssim;

pub use coverage::{Coverage, coverage_iou};
pub use error::MetricError;
pub use flip::{FlipConfig, flip};
pub use geometry::{DepthError, NormalError, depth_error, normal_error, unbiased_depth_error};
pub use light::{AngularRgbError, PixelWeights, angular_rgb_error, normalized_rmse, rmse, si_rmse};
pub use material::{
    AlbedoPsnr, MaterialError, PlaneError, ScaleFit, align_scale, material_error, plane_error,
    unbiased_plane_error,
};
pub use psnr::{Psnr, composite_over, psnr_linear, psnr_linear_clipped, psnr_srgb};
pub use regions::{RegionScores, Regions, Scores, ShadowRule, score, score_regions};
pub use ssim::{Border, Ssim, SsimMap, ssim, ssim_map};

/// One value a pixel, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `width · height` values.
    pub values: Vec<f64>,
}

impl Map {
    /// The mean over the pixels where the mask counts, and how many those are; `None` where none counts.
    #[must_use]
    pub fn mean(&self, mask: Option<&comgs_image::Image>) -> Option<(f64, usize)> {
        let (mut sum, mut pixels) = (0.0, 0);
        for (i, v) in self.values.iter().enumerate() {
            if check::counts(mask, i) {
                sum += v;
                pixels += 1;
            }
        }
        (pixels > 0).then(|| (sum / pixels as f64, pixels))
    }
}
