//! A photo as training wants it.

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_optim::Target;
use comgs_optim::photometric::Comparison;
use glam::DVec3;

/// A posed photo in linear radiance.
#[derive(Clone, Debug)]
pub struct TrainView {
    /// Pinhole camera; its size is the image's.
    pub camera: Camera,
    /// 3 channels, linear, straight (not premultiplied).
    pub color: Image,
    /// Object mask, 1 channel in [0, 1]. Colour is composited over black with it.
    pub mask: Option<Image>,
    /// Pixels that count (1) or not (0), for example outside an undistorted photo.
    pub valid: Option<Image>,
    /// Whether the capture is HDR: compared linearly instead of in sRGB.
    pub hdr: bool,
}

/// A view at one resolution of the schedule.
#[derive(Clone, Debug)]
pub(crate) struct LevelView {
    pub camera: Camera,
    pub target: Target,
    pub mask: Option<Image>,
}

impl TrainView {
    /// Premultiplied colour at a resolution, with mask and validity.
    pub(crate) fn level(&self, width: usize, height: usize) -> LevelView {
        let color = self.premultiplied().resized(width, height);
        let valid = self.valid.as_ref().map(|v| v.resized(width, height).map(|x| f32::from(x > 0.999)));
        let comparison = if self.hdr { Comparison::Linear } else { Comparison::Srgb };
        LevelView {
            camera: self.camera.resized(width, height),
            target: Target::new(&color, valid.as_ref(), comparison),
            mask: self.mask.as_ref().map(|m| m.resized(width, height)),
        }
    }

    /// The part of the photo that training looks at: the box around the mask with a margin of a 25th of the larger side
    /// (at least 12 pixels), grown to multiples of 4 so that the levels divide it. Everything outside is black and
    /// outside the mask. The whole photo when there is no mask, or nothing in it.
    pub(crate) fn cropped(&self) -> Self {
        let Some(mask) = &self.mask else { return self.clone() };
        let (width, height) = (mask.width, mask.height);
        let (mut low, mut high) = ([width, height], [0, 0]);
        for (i, _) in mask.data.iter().enumerate().filter(|(_, m)| **m > 0.0) {
            let at = [i % width, i / width];
            for k in 0..2 {
                low[k] = low[k].min(at[k]);
                high[k] = high[k].max(at[k] + 1);
            }
        }
        if high[0] == 0 {
            return self.clone();
        }
        let margin = (width.max(height) / 25).max(12);
        let size = [width, height];
        for k in 0..2 {
            low[k] = low[k].saturating_sub(margin) / 4 * 4;
            high[k] = ((high[k] + margin).div_ceil(4) * 4).min(size[k]);
        }
        let [columns, rows] = [high[0] - low[0], high[1] - low[1]];
        let cut = |image: &Image| {
            let c = image.channels;
            let mut data = Vec::with_capacity(columns * rows * c);
            for y in low[1]..high[1] {
                let start = (y * width + low[0]) * c;
                data.extend_from_slice(&image.data[start..start + columns * c]);
            }
            Image::from_data(columns, rows, c, data)
        };
        Self {
            camera: Camera {
                width: columns,
                height: rows,
                cx: self.camera.cx - low[0] as f64,
                cy: self.camera.cy - low[1] as f64,
                ..self.camera.clone()
            },
            color: cut(&self.color),
            mask: Some(cut(mask)),
            valid: self.valid.as_ref().map(cut),
            hdr: self.hdr,
        }
    }

    /// Colour over black.
    pub(crate) fn premultiplied(&self) -> Image {
        let mut color = self.color.clone();
        if let Some(mask) = &self.mask {
            for (p, m) in color.data.chunks_exact_mut(3).zip(&mask.data) {
                p.iter_mut().for_each(|v| *v *= m);
            }
        }
        color
    }
}

/// Where a set of cameras looks and how far it spreads: robust against single outliers (medians).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    /// Point closest to all optical axes (or ahead of the cameras where the axes are parallel).
    pub focus: DVec3,
    /// Median distance of the cameras to `focus`.
    pub distance: f64,
    /// Median distance of the cameras to their median centre; at least 1e-3 of `distance`.
    pub spread: f64,
}

impl Rig {
    /// From cameras; `None` when there are none or their numbers are not finite.
    #[must_use]
    pub fn new(cameras: &[&Camera]) -> Option<Self> {
        if cameras.is_empty() {
            return None;
        }
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let centre = DVec3::from_array(std::array::from_fn(|k| {
            median(cameras.iter().map(|c| c.centre()[k]).collect())
        }));
        let spread = median(cameras.iter().map(|c| c.centre().distance(centre)).collect());
        // Least squares for the point nearest to all axes, damped towards a point ahead of the middle camera so that
        // parallel axes have an answer.
        let mut matrix = glam::DMat3::ZERO;
        let mut right = DVec3::ZERO;
        for c in cameras {
            let d = c.forward();
            let across = glam::DMat3::IDENTITY - glam::DMat3::from_cols(d * d.x, d * d.y, d * d.z);
            matrix += across;
            right += across * c.centre();
        }
        let forward: DVec3 =
            cameras.iter().map(|c| c.forward()).sum::<DVec3>().normalize_or(cameras[0].forward());
        let guess = centre + forward * spread.max(1e-3);
        let damping = 1e-3 * cameras.len() as f64;
        let focus = (matrix + glam::DMat3::IDENTITY * damping).inverse() * (right + guess * damping);
        let distance = median(cameras.iter().map(|c| c.centre().distance(focus)).collect());
        let rig = Self { focus, distance: distance.max(1e-6), spread: spread.max(1e-3 * distance).max(1e-9) };
        (rig.focus.is_finite() && rig.distance.is_finite()).then_some(rig)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: cameras on a ring around a point find it, and one outlier camera (hard case 11) changes nothing much.
    #[test]
    fn rig_is_robust() {
        let focus = DVec3::new(0.3, -0.2, 0.5);
        let mut cameras: Vec<Camera> = (0..24)
            .map(|i| {
                let a = f64::from(i) * 0.26;
                let eye = focus + DVec3::new(3.0 * a.cos(), 3.0 * a.sin(), 1.0);
                Camera::look_at("a", 10, 10, 0.8, eye, focus, DVec3::Z)
            })
            .collect();
        let rig = Rig::new(&cameras.iter().collect::<Vec<_>>()).unwrap();
        assert!((rig.focus - focus).length() < 0.01, "{rig:?}");
        let far = focus + DVec3::new(500.0, 10.0, 5.0);
        cameras.push(Camera::look_at("far", 10, 10, 0.8, far, focus, DVec3::Z));
        let with_outlier = Rig::new(&cameras.iter().collect::<Vec<_>>()).unwrap();
        assert!((with_outlier.focus - focus).length() < 0.02);
        assert!((with_outlier.spread / rig.spread - 1.0).abs() < 0.1);
    }

    /// Goal: the box around the mask keeps the whole mask, and a world point falls on the same sample as before.
    #[test]
    fn cropping_keeps_what_is_seen() {
        let eye = DVec3::new(3.0, 0.4, 1.0);
        let camera = Camera::look_at("a", 120, 90, 0.8, eye, DVec3::ZERO, DVec3::Z);
        let mut mask = Image::zeros(120, 90, 1);
        for (x, y) in [(70, 30), (101, 52), (85, 41)] {
            mask.pixel_mut(x, y)[0] = 1.0;
        }
        let color = Image::from_data(120, 90, 3, (0..120 * 90 * 3).map(|i| i as f32).collect());
        let view = TrainView { camera, color, mask: Some(mask), valid: None, hdr: true };
        let cut = view.cropped();
        assert!(cut.color.width < 70 && cut.color.height < 60, "{}×{}", cut.color.width, cut.color.height);
        assert_eq!((cut.color.width % 4, cut.color.height % 4), (0, 0));
        assert_eq!(cut.mask.as_ref().unwrap().data.iter().sum::<f32>(), 3.0);
        // A point behind the mask's middle.
        let p = view.camera.unproject(85.5, 41.5, 2.0);
        let at = |v: &TrainView| {
            let (pixel, _) = v.camera.project(p).unwrap();
            v.color.rgb((pixel.x - 0.5).round() as usize, (pixel.y - 0.5).round() as usize)
        };
        assert_eq!(at(&view), at(&cut));
        let bare = TrainView { mask: None, ..view.clone() };
        assert_eq!(bare.cropped().color, bare.color);
    }
}
