//! The steps of an insertion that its stage and its benchmark share.

use crate::composite::Crop;
use crate::error::InsertError;
use crate::guidance::{Guidance, Panorama};
use crate::light::{Gaussians, Light, LightMap, Texels};
use crate::object::Object;
use crate::optimise::{Outcome, Settings, State, optimise};
use crate::render::Layers;
use crate::tone::{Curves, Response, Tone};
use crate::transport::{
    Foreground, ForegroundConfig, Shadow, ShadowConfig, count_pixels, most_bytes, trace_foreground,
    trace_shadow,
};
use comgs_geom::Camera;
use comgs_image::Image;
use glam::Vec3;
use serde::Serialize;

/// How light is described.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum LightKind {
    /// So many spherical Gaussians.
    Gaussians(usize),
    /// Free texels.
    Texels,
}

impl LightKind {
    /// Even light.
    #[must_use]
    pub fn even(self, height: usize, radiance: Vec3) -> Light {
        match self {
            Self::Gaussians(count) => Light::Gaussians(Gaussians::uniform(height, count, radiance)),
            Self::Texels => Light::Texels(Texels::uniform(height, radiance)),
        }
    }
}

/// How transport is traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct TransportConfig {
    /// Rows of the map, even; halved where the matrix would not fit.
    pub height: usize,
    /// Bytes that the object's matrix may take.
    pub memory: usize,
    /// Interactions along a path.
    pub depth: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for TransportConfig {
    /// 64×32 texels of 5.6°, 2 GiB, three interactions.
    fn default() -> Self {
        Self { height: 32, memory: 2 << 30, depth: 3, seed: 0 }
    }
}

/// Rows of the smallest map that is worth tracing: texels of 22.5°.
const LEAST_HEIGHT: usize = 8;

/// Traced transport.
#[derive(Clone, Debug)]
pub struct Transport {
    /// The object.
    pub foreground: Foreground,
    /// Its shadow.
    pub shadow: Shadow,
    /// Rows of the map; less than asked for where memory was short.
    pub height: usize,
}

/// Largest number of rows, halving from `wanted`, whose matrices of `channels` values an entry for `pixels` pixels are sure
/// to fit into `memory` bytes.
///
/// # Errors
/// [`InsertError::Memory`].
pub fn fitting_height(
    pixels: usize,
    wanted: usize,
    channels: usize,
    memory: usize,
) -> Result<usize, InsertError> {
    let mut height = wanted;
    while most_bytes(pixels, height, channels) > memory {
        if height / 2 < LEAST_HEIGHT || !(height / 2).is_multiple_of(2) {
            let needed = most_bytes(pixels, height, channels);
            return Err(InsertError::Memory { pixels, height, needed, limit: memory });
        }
        height /= 2;
    }
    Ok(height)
}

/// Traces object and shadow, after the matrix has been sized. `check` is asked with numbers of rows done.
///
/// # Errors
/// [`InsertError::Memory`], [`InsertError::Stopped`], or [`InsertError::Input`] for an object out of the frame.
pub fn trace(
    object: &Object,
    camera: &Camera,
    config: &TransportConfig,
    check: impl Fn(usize) -> bool + Sync,
) -> Result<Transport, InsertError> {
    let mut fg = ForegroundConfig { depth: config.depth, seed: config.seed, ..ForegroundConfig::default() };
    let pixels = count_pixels(object, camera, &fg);
    if pixels == 0 {
        return Err(out_of_frame(object, camera));
    }
    let height = fitting_height(pixels, config.height, 3, config.memory)?;
    fg.height = height;
    let foreground = trace_foreground(object, camera, &fg, &check).ok_or(InsertError::Stopped)?;
    let sh = ShadowConfig { height, seed: config.seed, ..ShadowConfig::default() };
    let shadow =
        trace_shadow(object, camera, &foreground.coverage.data, &sh, &check).ok_or(InsertError::Stopped)?;
    Ok(Transport { foreground, shadow, height })
}

/// The error of an object that no pixel shows, with where it is instead.
#[must_use]
pub fn out_of_frame(object: &Object, camera: &Camera) -> InsertError {
    let got = match camera.project(object.centre.as_dvec3()) {
        Some((p, _)) => {
            format!("its middle at pixel ({:.0}, {:.0}) of {}×{}", p.x, p.y, camera.width, camera.height)
        }
        None => "its middle behind the camera".into(),
    };
    InsertError::Input { what: "the object's place", expected: "a place in the frame".into(), got }
}

/// Mean radiance that a photo shows, its response undone.
#[must_use]
pub fn mean_radiance(photo: &Image, response: Response, most: f32) -> Vec3 {
    let sum: glam::DVec3 = photo
        .data
        .chunks_exact(3)
        .map(|p| Vec3::new(p[0], p[1], p[2]).map(|v| response.invert(v, most)).as_dvec3())
        .sum();
    (sum / photo.pixels() as f64).as_vec3()
}

/// Fits a light to a map that is given ([`Panorama`]). Free texels are the map itself.
///
/// # Errors
/// As [`optimise`].
pub fn fit(
    target: &LightMap,
    kind: LightKind,
    iterations: usize,
    check: impl FnMut(usize) -> bool,
) -> Result<Outcome, InsertError> {
    let tone = Tone::identity(Response::default());
    if kind == LightKind::Texels {
        let light = Light::Texels(Texels::from_map(target));
        let state = State { foreground: light.clone(), shadow: light, tone };
        return Ok(Outcome { light: target.clone(), state, losses: Vec::new(), dropped: 0 });
    }
    let omega = target.solid_angles();
    let mean: Vec3 =
        (0..omega.len()).map(|i| target.texel(i) * omega[i]).sum::<Vec3>() / (4.0 * std::f32::consts::PI);
    let light = kind.even(target.height, mean.max(Vec3::splat(1e-4)));
    let state = State { foreground: light.clone(), shadow: light, tone };
    let mut guidance = Panorama::new(target);
    debug_assert!(!guidance.looks_at_composite());
    optimise(None, state, &mut guidance, &Settings { iterations, ..Settings::for_maps() }, check)
}

/// The composite (Eq. 6) of rendered layers: `(1 − V) · β̂ · I_bg + V · Î_fg`, linear.
#[must_use]
pub fn compose_layers(photo: &Image, layers: &Layers, curves: &Curves) -> Image {
    let mut out = photo.clone();
    for (i, &v) in layers.coverage.data.iter().enumerate() {
        for c in 0..3 {
            let k = 3 * i + c;
            let under = out.data[k] * curves.ratio(c, layers.ratio.data[k]);
            let object = if v > 0.0 { curves.object(layers.radiance.data[k]) } else { 0.0 };
            out.data[k] = (1.0 - v) * under + v * object;
        }
    }
    out
}

/// The pixels where an insertion may differ from its photo: the object's and its shadow's box, grown by a tenth.
#[must_use]
pub fn touched(layers: &Layers) -> Crop {
    let (w, h) = (layers.coverage.width, layers.coverage.height);
    let mut crop = Crop { x0: w, y0: h, x1: 0, y1: 0 };
    for i in 0..w * h {
        let dark = layers.ratio.data[3 * i..3 * i + 3].iter().any(|r| *r < 0.98);
        if layers.coverage.data[i] > 0.0 || dark {
            let (x, y) = (i % w, i / w);
            crop = Crop {
                x0: crop.x0.min(x),
                y0: crop.y0.min(y),
                x1: crop.x1.max(x + 1),
                y1: crop.y1.max(y + 1),
            };
        }
    }
    if crop.x0 >= crop.x1 {
        return Crop { x0: 0, y0: 0, x1: w, y1: h };
    }
    let (dx, dy) = ((crop.x1 - crop.x0) / 10 + 1, (crop.y1 - crop.y0) / 10 + 1);
    Crop {
        x0: crop.x0.saturating_sub(dx),
        y0: crop.y0.saturating_sub(dy),
        x1: (crop.x1 + dx).min(w),
        y1: (crop.y1 + dy).min(h),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the map is made coarser until its matrix is sure to fit, and what never fits is refused with numbers.
    #[test]
    fn matrices_are_sized_before_they_are_made() {
        assert_eq!(fitting_height(1000, 32, 3, 1 << 30).unwrap(), 32);
        assert_eq!(fitting_height(1000, 32, 3, 8 << 20).unwrap(), 16);
        let error = fitting_height(1_000_000, 32, 3, 1 << 20).unwrap_err();
        assert!(matches!(error, InsertError::Memory { height: 8, pixels: 1_000_000, .. }), "{error}");
        assert!(error.to_string().contains("--memory"));
    }

    /// Goal: Gaussians fitted to a map that is made of Gaussians come close to it, and free texels are the map.
    #[test]
    fn lights_are_fitted_to_maps() {
        let lobes = [
            crate::light::Gaussian { radiance: Vec3::new(0.4, 0.5, 0.7), direction: Vec3::Z, sigma: 0.9 },
            crate::light::Gaussian {
                radiance: Vec3::new(6.0, 5.0, 4.0),
                direction: Vec3::new(0.5, 0.5, 0.7).normalize(),
                sigma: 0.25,
            },
        ];
        let target = Gaussians::new(16, &lobes).rasterise();
        assert_eq!(fit(&target, LightKind::Texels, 10, |_| true).unwrap().light, target);
        let fitted = fit(&target, LightKind::Gaussians(24), 400, |_| true).unwrap();
        let omega = target.solid_angles();
        let energy = |m: &LightMap| -> f32 { m.luminance().iter().zip(&omega).map(|(l, w)| l * w).sum() };
        let ratio = energy(&fitted.light) / energy(&target);
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
        assert!(fitted.losses.last().unwrap().guidance < 0.02 * fitted.losses[0].guidance);
        assert!(matches!(fit(&target, LightKind::Gaussians(4), 9, |i| i < 3), Err(InsertError::Stopped)));
    }
}
