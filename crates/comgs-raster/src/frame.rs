//! What a rendering is, and the gradient of a loss with respect to it.

use crate::Planes;
use comgs_image::Image;

/// The planes of one rendering. All are premultiplied sums Σ T α b without a background.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Linear radiance, 3 channels.
    pub color: Option<Image>,
    /// Σ T α, 1 channel, in [0, 1].
    pub weight: Image,
    /// Σ T α z, z-depth in world units, 1 channel.
    pub depth: Option<Image>,
    /// Σ T α n, world space, facing the viewer, 3 channels, not normalised.
    pub normal: Option<Image>,
    /// Albedo RGB, roughness, metallic, 5 channels.
    pub material: Option<Image>,
}

impl Frame {
    /// A frame of zeros.
    #[must_use]
    pub fn zeros(width: usize, height: usize, planes: Planes) -> Self {
        let plane = |on: bool, channels| on.then(|| Image::zeros(width, height, channels));
        Self {
            color: plane(planes.color, 3),
            weight: Image::zeros(width, height, 1),
            depth: plane(planes.depth, 1),
            normal: plane(planes.normal, 3),
            material: plane(planes.material, 5),
        }
    }

    /// Unbiased depth D / W (ComGS §3.1); 0 where the weight is below `min_weight` or there is no depth plane.
    #[must_use]
    pub fn unbiased_depth(&self, min_weight: f32) -> Image {
        let mut out = Image::zeros(self.weight.width, self.weight.height, 1);
        if let Some(depth) = &self.depth {
            for (o, (d, w)) in out.data.iter_mut().zip(depth.data.iter().zip(&self.weight.data)) {
                if *w >= min_weight.max(f32::MIN_POSITIVE) {
                    *o = d / w;
                }
            }
        }
        out
    }

    /// Colour over a constant background: `C + (1 − W) · background`.
    ///
    /// # Panics
    /// When there is no colour plane.
    #[must_use]
    pub fn color_over(&self, background: [f32; 3]) -> Image {
        let mut out = self.color.clone().expect("a colour plane");
        for (pixel, w) in out.data.chunks_exact_mut(3).zip(&self.weight.data) {
            for c in 0..3 {
                pixel[c] += (1.0 - w) * background[c];
            }
        }
        out
    }
}

/// Gradient of a loss with respect to the planes of a [`Frame`]; a missing plane is zero.
#[derive(Clone, Debug, Default)]
pub struct FrameGradient {
    /// 3 channels.
    pub color: Option<Image>,
    /// 1 channel.
    pub weight: Option<Image>,
    /// 1 channel, with respect to the premultiplied depth.
    pub depth: Option<Image>,
    /// 3 channels.
    pub normal: Option<Image>,
    /// 5 channels.
    pub material: Option<Image>,
    /// Not a gradient: a non-negative error image whose blend-weighted sum over each surfel is gathered in
    /// the same pass (for growth and pruning).
    pub error: Option<Image>,
}
