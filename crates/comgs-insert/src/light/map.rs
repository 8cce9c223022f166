//! The map that light is transported from.

use comgs_geom::equirect;
use comgs_image::Image;
use comgs_light::{EnvError, EnvironmentMap};
use glam::Vec3;

/// Radiance from everywhere: equirectangular, `2 height × height` texels, constant within a texel, channels planar
/// (all red texels, then green, then blue), so that a row of transport meets each channel as one slice. Also
/// the shape of gradients with respect to radiance.
#[derive(Clone, Debug, PartialEq)]
pub struct LightMap {
    /// Rows.
    pub height: usize,
    /// `3 · texels` values.
    pub data: Vec<f32>,
}

impl LightMap {
    /// Black.
    #[must_use]
    pub fn zeros(height: usize) -> Self {
        Self { height, data: vec![0.0; 6 * height * height] }
    }

    /// The same radiance from everywhere.
    #[must_use]
    pub fn constant(height: usize, radiance: Vec3) -> Self {
        let n = 2 * height * height;
        Self { height, data: radiance.to_array().iter().flat_map(|&v| std::iter::repeat_n(v, n)).collect() }
    }

    /// A map averaged to `height` rows by solid angle.
    #[must_use]
    pub fn from_environment(map: &EnvironmentMap, height: usize) -> Self {
        // A turn is not part of the stored texels; texels of a turned map are looked up.
        let resized = map.resized(height);
        let mut out = Self::zeros(height);
        let n = out.texels();
        for i in 0..n {
            let value = if map.turn() == 0.0 {
                resized.texel(i % (2 * height), i / (2 * height))
            } else {
                resized.lookup(out.direction(i))
            };
            for c in 0..3 {
                out.data[c * n + i] = value[c];
            }
        }
        out
    }

    /// From an image of three channels, twice as wide as high.
    ///
    /// # Errors
    /// [`EnvError`] where it is no environment map.
    pub fn from_image(image: &Image, height: usize) -> Result<Self, EnvError> {
        Ok(Self::from_environment(&EnvironmentMap::from_image(image)?, height))
    }

    /// As an environment map; what is not a radiance (never, for a rasterised light) counts as 0.
    #[must_use]
    pub fn to_environment(&self) -> EnvironmentMap {
        EnvironmentMap::from_image_repaired(&self.to_image())
            .expect("twice as wide as high, three channels")
            .0
    }

    /// As an image of three channels.
    #[must_use]
    pub fn to_image(&self) -> Image {
        let n = self.texels();
        let data = (0..n).flat_map(|i| (0..3).map(move |c| c * n + i)).map(|k| self.data[k]).collect();
        Image::from_data(2 * self.height, self.height, 3, data)
    }

    /// Texels of the map.
    #[must_use]
    pub fn texels(&self) -> usize {
        2 * self.height * self.height
    }

    /// One channel.
    #[must_use]
    pub fn channel(&self, c: usize) -> &[f32] {
        let n = self.texels();
        &self.data[c * n..(c + 1) * n]
    }

    /// Radiance of a texel.
    #[must_use]
    pub fn texel(&self, i: usize) -> Vec3 {
        let n = self.texels();
        Vec3::new(self.data[i], self.data[n + i], self.data[2 * n + i])
    }

    /// Direction of a texel's centre.
    #[must_use]
    pub fn direction(&self, i: usize) -> Vec3 {
        let width = 2 * self.height;
        equirect::texel_direction(i % width, i / width, width, self.height)
    }

    /// Solid angle of every texel in steradian; they sum to 4π.
    #[must_use]
    pub fn solid_angles(&self) -> Vec<f32> {
        let width = 2 * self.height;
        (0..self.texels()).map(|i| equirect::texel_solid_angle(i / width, width, self.height)).collect()
    }

    /// Luminance of every texel.
    #[must_use]
    pub fn luminance(&self) -> Vec<f32> {
        (0..self.texels()).map(|i| comgs_light::luminance(self.texel(i))).collect()
    }
}
