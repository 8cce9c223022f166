//! The light that is optimised: an equirectangular map made from parameters, with the gradient back to them.

mod gaussians;
mod map;
mod texels;

pub use gaussians::{Gaussian, Gaussians};
pub use map::LightMap;
pub use texels::Texels;

use comgs_optim::{Adam, AdamConfig};

/// A light with parameters. Both kinds give a map of positive radiance and take the gradient with respect to it.
#[derive(Clone, Debug)]
pub enum Light {
    /// Spherical Gaussians (DiPIR Eq. 2–3).
    Gaussians(Gaussians),
    /// One free radiance a texel, held together by a smoothness prior.
    Texels(Texels),
}

impl Light {
    /// The map.
    #[must_use]
    pub fn rasterise(&self) -> LightMap {
        match self {
            Self::Gaussians(g) => g.rasterise(),
            Self::Texels(t) => t.rasterise(),
        }
    }

    /// Gradient with respect to the parameters from that with respect to the map's radiance. `map` is what
    /// [`Light::rasterise`] returned.
    #[must_use]
    pub fn rasterise_vjp(&self, map: &LightMap, grad: &LightMap) -> Vec<f32> {
        match self {
            Self::Gaussians(g) => g.rasterise_vjp(grad),
            Self::Texels(_) => Texels::rasterise_vjp(map, grad),
        }
    }

    /// The light's own prior: 0 for Gaussians, the smoothness of free texels. Adds the gradient to `grad`.
    pub fn prior(&self, weight: f32, grad: &mut [f32]) -> f32 {
        match self {
            Self::Gaussians(_) => 0.0,
            Self::Texels(t) => t.smoothness(weight, grad),
        }
    }

    /// The parameters as one column.
    #[must_use]
    pub fn parameters(&self) -> &[f32] {
        match self {
            Self::Gaussians(g) => &g.parameters,
            Self::Texels(t) => &t.log_radiance,
        }
    }

    /// One step of Adam (`step` counts from 1). `rate` is that of logarithms; directions turn at a fifth of it.
    pub fn step(&mut self, adam: &mut Adam, grad: &[f32], rate: f32, step: u32) -> usize {
        let config = AdamConfig::default();
        match self {
            Self::Gaussians(g) => {
                let (turn, width) = (TURN_SHARE * rate, WIDTH_SHARE * rate);
                let rates = [rate, rate, rate, turn, turn, turn, width];
                let dropped = adam.step_rows(&mut g.parameters, grad, &rates, step, &config);
                g.normalise();
                dropped
            }
            Self::Texels(t) => adam.step(&mut t.log_radiance, grad, rate, step, &config),
        }
    }
}

/// Learning rate of a lobe's direction and of the logarithm of its width, as shares of the colours'.
const TURN_SHARE: f32 = 0.2;
const WIDTH_SHARE: f32 = 0.4;
