//! What says how the insertion should look, behind one trait.

use crate::composite::Crop;
use crate::error::InsertError;
use crate::light::LightMap;
use comgs_image::Image;
use comgs_image::transfer::{srgb_from_linear, srgb_slope};

/// What a guidance sees of an iteration.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Iteration, from 0.
    pub iteration: usize,
    /// From 0 at the first to 1 at the last iteration.
    pub progress: f32,
    /// The composite, linear, valid inside `crop`. `None` for a guidance that does not look at it.
    pub composite: Option<&'a Image>,
    /// The part of the image that is looked at.
    pub crop: Crop,
    /// The maps that light the object and the shadow.
    pub light: [&'a LightMap; 2],
}

/// A loss and its gradients.
#[derive(Clone, Debug, Default)]
pub struct Pull {
    /// The loss.
    pub loss: f32,
    /// With respect to the composite (linear), 0 outside the crop.
    pub composite: Option<Image>,
    /// With respect to both maps.
    pub light: Option<[LightMap; 2]>,
}

/// A source of gradients. Implementations are deterministic in their own seed.
pub trait Guidance {
    /// Its name in records.
    fn name(&self) -> &'static str;

    /// Whether it looks at the composite; rendering is skipped for one that does not.
    fn looks_at_composite(&self) -> bool;

    /// Loss and gradients of one iteration.
    ///
    /// # Errors
    /// [`InsertError`] of its own inputs.
    fn pull(&mut self, view: &View<'_>) -> Result<Pull, InsertError>;
}

/// The loss to a composite that is given: squared differences of sRGB values, summed over the crop and divided by the
/// object's pixels, so that its weight against the regularisers does not depend on the photo's size.
#[derive(Clone, Debug)]
pub struct Reference {
    target: Image,
    weight: f32,
}

/// Weight of the image loss. At the end a composite differs by about 0.01; with this weight that is still a hundred times
/// what the regularisers pull.
const REFERENCE_WEIGHT: f32 = 300.0;

impl Reference {
    /// A target of the photo's size, linear.
    #[must_use]
    pub fn new(target: &Image, object_pixels: usize) -> Self {
        let coded = target.map(|v| srgb_from_linear(v.clamp(0.0, 1.0)));
        Self { target: coded, weight: REFERENCE_WEIGHT / object_pixels.max(1) as f32 }
    }
}

impl Guidance for Reference {
    fn name(&self) -> &'static str {
        "reference"
    }

    fn looks_at_composite(&self) -> bool {
        true
    }

    fn pull(&mut self, view: &View<'_>) -> Result<Pull, InsertError> {
        let composite = view.composite.expect("a composite was asked for");
        let mut grad = Image::zeros(composite.width, composite.height, 3);
        let mut loss = 0.0f64;
        for y in view.crop.y0..view.crop.y1 {
            for x in view.crop.x0..view.crop.x1 {
                let at = 3 * (y * composite.width + x);
                for k in at..at + 3 {
                    let value = composite.data[k];
                    // Beyond white there is nothing to see, and nothing to pull.
                    let seen = value.clamp(0.0, 1.0);
                    let d = srgb_from_linear(seen) - self.target.data[k];
                    loss += f64::from(d * d);
                    if value <= 1.0 || d > 0.0 {
                        grad.data[k] = 2.0 * self.weight * d * srgb_slope(seen);
                    }
                }
            }
        }
        Ok(Pull { loss: self.weight * loss as f32, composite: Some(grad), light: None })
    }
}

/// The loss to a map that is given, for both maps: `½ Σ (log(L + ε) − log(T + ε))² ΔΩ` over all channels, so that errors
/// count as ratios; ε is a twentieth of the target's mean radiance, below which ratios do not matter.
#[derive(Clone, Debug)]
pub struct Panorama {
    log_target: Vec<f32>,
    floor: f32,
    omega: Vec<f32>,
}

/// ε as a share of the mean radiance.
const FLOOR: f32 = 0.05;

impl Panorama {
    /// A target map.
    #[must_use]
    pub fn new(target: &LightMap) -> Self {
        let omega = target.solid_angles();
        let n = omega.len();
        let sum: f64 = target.data.iter().enumerate().map(|(i, l)| f64::from(l * omega[i % n])).sum();
        let mean = sum / (12.0 * std::f64::consts::PI);
        let floor = (FLOOR * mean as f32).max(1e-6);
        Self { log_target: target.data.iter().map(|l| (l.max(0.0) + floor).ln()).collect(), floor, omega }
    }
}

impl Guidance for Panorama {
    fn name(&self) -> &'static str {
        "panorama"
    }

    fn looks_at_composite(&self) -> bool {
        false
    }

    fn pull(&mut self, view: &View<'_>) -> Result<Pull, InsertError> {
        let n = self.omega.len();
        let mut loss = 0.0f64;
        let light = view.light.map(|map| {
            let mut grad = LightMap::zeros(map.height);
            for (i, (l, t)) in map.data.iter().zip(&self.log_target).enumerate() {
                let lifted = l.max(0.0) + self.floor;
                let d = lifted.ln() - t;
                let w = self.omega[i % n];
                loss += f64::from(0.5 * w * d * d);
                grad.data[i] = w * d / lifted;
            }
            grad
        });
        Ok(Pull { loss: loss as f32, composite: None, light: Some(light) })
    }
}
