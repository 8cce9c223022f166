//! Straightening of photographs: resampling into the pinhole camera that renderers know.

use comgs_geom::{Camera, Lens};
use comgs_image::Image;
use glam::DVec2;
use rayon::prelude::*;

/// Where every pixel of the straight image lies in the photograph; made once, applied to colour and mask.
#[derive(Clone, Debug)]
pub struct Undistortion {
    width: usize,
    height: usize,
    /// Pixel positions in the photograph; NaN where there is none.
    source: Vec<[f32; 2]>,
    missing: usize,
}

impl Undistortion {
    /// For photographs of `camera`'s size taken through `lens`. The straight image has the same size, focal length and
    /// principal point, so its camera is `camera` itself.
    ///
    /// A pixel has no source when it maps outside the photograph or beyond the lens model's fold
    /// ([`Lens::valid_radius`]), where the model would show a ghost.
    #[must_use]
    pub fn new(lens: &Lens, camera: &Camera) -> Self {
        let (width, height) = (camera.width, camera.height);
        let limit = lens.valid_radius();
        let mut source = vec![[f32::NAN; 2]; width * height];
        source.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, row)| {
            for (x, target) in row.iter_mut().enumerate() {
                let ray = camera.ray_camera(x as f64 + 0.5, y as f64 + 0.5);
                let ideal = DVec2::new(ray.x, ray.y);
                if ideal.length() >= limit {
                    continue;
                }
                let bent = lens.distort(ideal);
                let (u, v) = (camera.cx + camera.fx * bent.x, camera.cy + camera.fy * bent.y);
                if u >= 0.0 && v >= 0.0 && u <= width as f64 && v <= height as f64 {
                    *target = [u as f32, v as f32];
                }
            }
        });
        let missing = source.iter().filter(|p| p[0].is_nan()).count();
        Self { width, height, source, missing }
    }

    /// Bilinear resampling; pixels without a source are 0. The image must have the camera's size.
    #[must_use]
    pub fn apply(&self, image: &Image) -> Image {
        let channels = image.channels;
        let mut out = Image::zeros(self.width, self.height, channels);
        out.data.par_chunks_mut((self.width * channels).max(1)).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                let [u, v] = self.source[y * self.width + x];
                if !u.is_nan() {
                    image.sample_bilinear(u, v, pixel);
                }
            }
        });
        out
    }

    /// 1 where the photograph has something to say, 0 elsewhere; `None` when that is everywhere.
    #[must_use]
    pub fn valid(&self) -> Option<Image> {
        (self.missing > 0).then(|| {
            let data = self.source.iter().map(|p| if p[0].is_nan() { 0.0 } else { 1.0 }).collect();
            Image::from_data(self.width, self.height, 1, data)
        })
    }
}

/// Straightens one photograph of `camera` taken through `lens`.
///
/// Returns the straight image (bilinear, same size), the pinhole camera it belongs to (the same focal length, so its
/// border pixels may see past the photograph), and a one-channel mask of the pixels that were seen (`None` when all
/// were). [`Undistortion`] does several images of one camera.
#[must_use]
pub fn undistort_image(image: &Image, lens: &Lens, camera: &Camera) -> (Image, Camera, Option<Image>) {
    let camera = camera.clone();
    if lens.is_pinhole() {
        return (image.clone(), camera, None);
    }
    let map = Undistortion::new(lens, &camera);
    (map.apply(image), camera, map.valid())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn camera(width: usize, height: usize) -> Camera {
        Camera::look_at("a", width, height, 1.2, DVec3::X, DVec3::ZERO, DVec3::Z)
    }

    /// Goal: a smooth pattern on the ideal image plane, photographed through a strong lens, comes back straight.
    #[test]
    fn a_bent_pattern_comes_back_straight() {
        let camera = camera(160, 120);
        let lens = Lens::open_cv([-0.25, 0.06, 0.0, 0.0, 0.0, 0.0], [0.002, -0.001]);
        let pattern = |p: DVec2| (0.5 + 0.5 * (9.0 * p.x).sin() * (7.0 * p.y).cos()) as f32;
        let ideal = |x: usize, y: usize| {
            let ray = camera.ray_camera(x as f64 + 0.5, y as f64 + 0.5);
            DVec2::new(ray.x, ray.y)
        };
        let mut photo = Image::zeros(160, 120, 1);
        for y in 0..120 {
            for x in 0..160 {
                photo.pixel_mut(x, y)[0] = lens.undistort(ideal(x, y)).map_or(0.0, pattern);
            }
        }
        let (straight, same, valid) = undistort_image(&photo, &lens, &camera);
        assert_eq!(same, camera);
        let valid = valid.unwrap_or_else(|| Image::filled(160, 120, 1, 1.0));
        let (mut worst, mut seen) = (0.0f32, 0);
        for y in 0..120 {
            for x in 0..160 {
                if valid.pixel(x, y)[0] > 0.0 {
                    worst = worst.max((straight.pixel(x, y)[0] - pattern(ideal(x, y))).abs());
                    seen += 1;
                }
            }
        }
        // Bilinear interpolation of this pattern errs by less than h² f''/8 ≈ 0.01 (half a pixel more at the border).
        assert!(worst < 0.03, "{worst}");
        assert!(seen > 160 * 120 * 9 / 10);
    }

    /// Goal: a barrel lens seen past its photograph marks those pixels invalid, and pixels beyond the fold are invalid
    /// although the polynomial sends them back into the photograph (the ghost).
    #[test]
    fn pixels_without_a_source_are_masked() {
        let camera = camera(100, 100);
        let pincushion = Lens::open_cv([0.4, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]);
        let white = Image::filled(100, 100, 3, 1.0);
        let (image, _, valid) = undistort_image(&white, &pincushion, &camera);
        let valid = valid.expect("corners map outside");
        assert_eq!((valid.pixel(0, 0)[0], valid.pixel(50, 50)[0]), (0.0, 1.0));
        assert_eq!((image.rgb(0, 0), image.rgb(50, 50)), ([0.0; 3], [1.0; 3]));

        let folding = Lens::open_cv([-1.2, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]);
        let (_, _, valid) = undistort_image(&white, &folding, &camera);
        let corner = camera.ray_camera(0.5, 0.5);
        assert!(folding.distort(DVec2::new(corner.x, corner.y)).length() < 0.6, "the ghost is inside");
        assert_eq!(valid.expect("the fold is in the picture").pixel(0, 0)[0], 0.0);
    }

    /// Goal: without distortion nothing is touched.
    #[test]
    fn pinhole_is_untouched() {
        let image = Image::filled(8, 4, 3, 0.3);
        let (same, _, valid) = undistort_image(&image, &Lens::Pinhole, &camera(8, 4));
        assert_eq!((same, valid), (image, None));
    }
}
