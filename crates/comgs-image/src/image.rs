//! The image type.

/// Rows of interleaved f32 samples, row 0 at the top; sample `(x, y, c)` is at `(y · width + x) · channels + c`.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Samples a pixel.
    pub channels: usize,
    /// `width · height · channels` samples.
    pub data: Vec<f32>,
}

impl Image {
    /// An image of one value.
    #[must_use]
    pub fn filled(width: usize, height: usize, channels: usize, value: f32) -> Self {
        Self { width, height, channels, data: vec![value; width * height * channels] }
    }

    /// An image of zeros.
    #[must_use]
    pub fn zeros(width: usize, height: usize, channels: usize) -> Self {
        Self::filled(width, height, channels, 0.0)
    }

    /// Wraps samples.
    ///
    /// # Panics
    /// When the number of samples is not `width · height · channels`.
    #[must_use]
    pub fn from_data(width: usize, height: usize, channels: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), width * height * channels, "{width}×{height}×{channels} samples expected");
        Self { width, height, channels, data }
    }

    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// The samples of a pixel.
    #[must_use]
    pub fn pixel(&self, x: usize, y: usize) -> &[f32] {
        let i = (y * self.width + x) * self.channels;
        &self.data[i..i + self.channels]
    }

    /// The samples of a pixel, mutable.
    pub fn pixel_mut(&mut self, x: usize, y: usize) -> &mut [f32] {
        let i = (y * self.width + x) * self.channels;
        &mut self.data[i..i + self.channels]
    }

    /// The first three channels of a pixel as an array; a one-channel image is grey.
    #[must_use]
    pub fn rgb(&self, x: usize, y: usize) -> [f32; 3] {
        let p = self.pixel(x, y);
        if self.channels >= 3 { [p[0], p[1], p[2]] } else { [p[0]; 3] }
    }

    /// A new image made of some channels of this one, in the order given.
    #[must_use]
    pub fn select(&self, channels: &[usize]) -> Self {
        let mut data = Vec::with_capacity(self.pixels() * channels.len());
        for pixel in self.data.chunks_exact(self.channels) {
            data.extend(channels.iter().map(|&c| pixel[c]));
        }
        Self::from_data(self.width, self.height, channels.len(), data)
    }

    /// Applies a function to every sample.
    #[must_use]
    pub fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self { data: self.data.iter().map(|&v| f(v)).collect(), ..*self }
    }

    /// Rescales by area averaging (exact box filter), which conserves the mean; also enlarges, as nearest
    /// neighbour blended at the seams.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let columns = box_weights(self.width, width);
        let rows = box_weights(self.height, height);
        let c = self.channels;
        let mut narrow = Self::zeros(width, self.height, c);
        for y in 0..self.height {
            let source = &self.data[y * self.width * c..(y + 1) * self.width * c];
            let target = &mut narrow.data[y * width * c..(y + 1) * width * c];
            for (x, (first, weights)) in columns.iter().enumerate() {
                for (k, w) in weights.iter().enumerate() {
                    for ch in 0..c {
                        target[x * c + ch] += w * source[(first + k) * c + ch];
                    }
                }
            }
        }
        let mut out = Self::zeros(width, height, c);
        for (y, (first, weights)) in rows.iter().enumerate() {
            let target = &mut out.data[y * width * c..(y + 1) * width * c];
            for (k, w) in weights.iter().enumerate() {
                let source = &narrow.data[(first + k) * width * c..(first + k + 1) * width * c];
                for (t, s) in target.iter_mut().zip(source) {
                    *t += w * s;
                }
            }
        }
        out
    }

    /// Bilinear sample at continuous pixel coordinates (pixel centres at +½), clamped at the border; writes
    /// `channels` values.
    pub fn sample_bilinear(&self, x: f32, y: f32, out: &mut [f32]) {
        let fx = (x - 0.5).clamp(0.0, (self.width - 1) as f32);
        let fy = (y - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (fx as usize, fy as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (tx, ty) = (fx - x0 as f32, fy - y0 as f32);
        let (a, b, c, d) = (self.pixel(x0, y0), self.pixel(x1, y0), self.pixel(x0, y1), self.pixel(x1, y1));
        for k in 0..self.channels {
            let top = a[k] + (b[k] - a[k]) * tx;
            let bottom = c[k] + (d[k] - c[k]) * tx;
            out[k] = top + (bottom - top) * ty;
        }
    }

    /// Number of NaN or infinite samples.
    #[must_use]
    pub fn non_finite(&self) -> usize {
        self.data.iter().filter(|v| !v.is_finite()).count()
    }
}

/// For every target cell its first source cell and the weights (sum 1) of the source cells it covers.
fn box_weights(source: usize, target: usize) -> Vec<(usize, Vec<f32>)> {
    let ratio = source as f64 / target as f64;
    (0..target)
        .map(|i| {
            let (start, end) = (i as f64 * ratio, ((i + 1) as f64 * ratio).min(source as f64));
            let first = start.floor() as usize;
            let last = (end.ceil() as usize).min(source).max(first + 1);
            let weights = (first..last)
                .map(|k| (((k + 1) as f64).min(end) - (k as f64).max(start)).max(0.0) / (end - start))
                .map(|w| w as f32)
                .collect();
            (first, weights)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: area averaging keeps the mean for integer and fractional ratios, and averages 2×2 blocks exactly.
    #[test]
    fn resize_conserves_the_mean() {
        let data: Vec<f32> = (0..12 * 9).map(|i| (i * 7 % 13) as f32).collect();
        let image = Image::from_data(12, 9, 1, data);
        let mean = |im: &Image| im.data.iter().sum::<f32>() / im.data.len() as f32;
        for (w, h) in [(6, 3), (5, 4), (12, 9), (7, 9)] {
            assert!((mean(&image.resized(w, h)) - mean(&image)).abs() < 1e-4);
        }
        let block = Image::from_data(2, 2, 1, vec![1.0, 2.0, 3.0, 6.0]).resized(1, 1);
        assert_eq!(block.data, vec![3.0]);
    }

    /// Goal: a bilinear sample at a pixel's centre is the pixel, between centres the mean.
    #[test]
    fn bilinear_hits_centres() {
        let image = Image::from_data(2, 1, 1, vec![1.0, 3.0]);
        let mut out = [0.0];
        image.sample_bilinear(0.5, 0.5, &mut out);
        assert_eq!(out, [1.0]);
        image.sample_bilinear(1.0, 0.5, &mut out);
        assert_eq!(out, [2.0]);
        image.sample_bilinear(9.0, -3.0, &mut out);
        assert_eq!(out, [3.0]);
    }
}
