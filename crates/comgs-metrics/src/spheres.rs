//! Three spheres under a light: how panoramas of light are compared (LeGendre et al. 2019, DiffusionLight, LuxDiT).
//!
//! A mirror, a glossy and a diffuse sphere, white, seen by an orthographic camera that looks along +x, lit by the map from
//! infinitely far without shadows. Errors of the three pictures weigh what light does: the mirror shows where it comes from,
//! the diffuse sphere how much. The glossy one is GGX of roughness 0.4, prefiltered around the mirror direction as seen from
//! there (Karis 2013): `Σ L(ω) D(h) (r·ω) dω` over its weights' sum, `h` half-way between `r` and `ω`.

use crate::{MetricError, PixelWeights, angular_rgb_error, check, normalized_rmse, rmse, si_rmse};
use comgs_image::Image;
use serde::Serialize;

/// Side of the pictures in pixels.
const SIDE: usize = 64;
/// Roughness of the glossy sphere.
const ROUGHNESS: f64 = 0.4;
/// The truth is exposed so that its diffuse sphere has this mean.
const EXPOSED: f64 = 0.5;
/// The mirror sees maps of at most this many rows.
const MIRROR_ROWS: usize = 64;
/// The lobes gather from maps of at most this many rows: a texel of 5.6° is finer than either.
const LOBE_ROWS: usize = 32;
/// Normals at which irradiance is compared.
const NORMALS: u32 = 128;

/// Which sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Sphere {
    /// A perfect mirror.
    Mirror,
    /// GGX, roughness 0.4.
    Glossy,
    /// Lambert.
    Diffuse,
}

/// The three, in the order of tables.
pub const SPHERES: [Sphere; 3] = [Sphere::Mirror, Sphere::Glossy, Sphere::Diffuse];

/// How the maps are treated before they light the spheres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// Linear radiance.
    #[default]
    Linear,
    /// As published code of DiffusionLight and its successors: the maps are gamma-compressed (`(x / p99)^(1/2.4)`, clipped
    /// to 1) before they light the spheres, and RMSE sums over channels instead of averaging.
    Legacy,
}

/// Errors of one sphere's picture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SphereErrors {
    /// Which sphere.
    pub sphere: Sphere,
    /// RMSE, both exposed alike.
    pub rmse: f64,
    /// Scale-invariant RMSE.
    pub si_rmse: f64,
    /// Mean angle between RGB vectors, degrees.
    pub angular_deg: f64,
    /// RMSE after mapping the 0.1 and 99.9 percentiles of each to 0 and 1.
    pub normalized_rmse: f64,
}

/// Errors of a map of light.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LightErrors {
    /// One a sphere, in the order of [`SPHERES`].
    pub spheres: Vec<SphereErrors>,
    /// `Σ |E − E*| / Σ E*` over all directions of a normal: irradiance, whole sphere, no scale taken out.
    pub irradiance: f64,
    /// Angle between the directions of the brightest light of the two, degrees (see [`peak_direction`]).
    pub peak_deg: f64,
}

fn texels(map: &Image) -> Vec<([f64; 3], f64, [f64; 3])> {
    use std::f64::consts::PI;
    let (w, h) = (map.width, map.height);
    (0..w * h)
        .map(|i| {
            let (x, y) = (i % w, i / w);
            let theta = PI - 2.0 * PI * (x as f64 + 0.5) / w as f64;
            let phi = PI * (y as f64 + 0.5) / h as f64;
            let d = [phi.sin() * theta.cos(), phi.sin() * theta.sin(), phi.cos()];
            let edge = |row: usize| (PI * row as f64 / h as f64).cos();
            let omega = 2.0 * PI / w as f64 * (edge(y) - edge(y + 1));
            (d, omega, [0, 1, 2].map(|c| f64::from(map.data[3 * i + c])))
        })
        .collect()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Area means down to at most so many rows.
fn reduced(map: &Image, rows: usize) -> Image {
    let factor = map.height.div_ceil(rows);
    if factor <= 1 || !map.height.is_multiple_of(factor) || !map.width.is_multiple_of(factor) {
        return map.clone();
    }
    let (w, h) = (map.width / factor, map.height / factor);
    let mut out = Image::zeros(w, h, 3);
    for y in 0..h {
        for x in 0..w {
            for c in 0..3 {
                let mut sum = 0.0f64;
                for v in 0..factor {
                    for u in 0..factor {
                        sum += f64::from(map.data[3 * ((y * factor + v) * map.width + x * factor + u) + c]);
                    }
                }
                out.data[3 * (y * w + x) + c] = (sum / (factor * factor) as f64) as f32;
            }
        }
    }
    out
}

/// Normals of the sphere's visible half, row by row, `None` outside of its disc. The camera looks along +x: it sees the
/// side of −x, with +y on the left and +z up.
fn normals() -> impl Iterator<Item = Option<[f64; 3]>> {
    (0..SIDE * SIDE).map(|i| {
        let at = |k: usize| 2.0 * (k as f64 + 0.5) / SIDE as f64 - 1.0;
        let (y, z) = (-at(i % SIDE), -at(i / SIDE));
        let x2 = 1.0 - y * y - z * z;
        (x2 > 0.0).then(|| [-x2.sqrt(), y, z])
    })
}

/// The picture of a sphere under a map (3 channels, equirectangular, z up), `64 × 64`, and the mask of its disc.
#[must_use]
pub fn picture(map: &Image, sphere: Sphere) -> (Image, Image) {
    let map = reduced(map, if sphere == Sphere::Mirror { MIRROR_ROWS } else { LOBE_ROWS });
    let light = texels(&map);
    let mut image = Image::zeros(SIDE, SIDE, 3);
    let mut mask = Image::zeros(SIDE, SIDE, 1);
    for (i, normal) in normals().enumerate() {
        let Some(n) = normal else { continue };
        mask.data[i] = 1.0;
        // Mirror direction of the viewing ray (1, 0, 0).
        let r = [1.0 - 2.0 * n[0] * n[0], -2.0 * n[0] * n[1], -2.0 * n[0] * n[2]];
        let color = match sphere {
            Sphere::Mirror => {
                let theta = r[1].atan2(r[0]);
                let u = (std::f64::consts::PI - theta) / (2.0 * std::f64::consts::PI);
                let v = r[2].clamp(-1.0, 1.0).acos() / std::f64::consts::PI;
                let x = ((u * map.width as f64) as usize).min(map.width - 1);
                let y = ((v * map.height as f64) as usize).min(map.height - 1);
                [0, 1, 2].map(|c| f64::from(map.data[3 * (y * map.width + x) + c]))
            }
            Sphere::Glossy => gathered(&light, |d| {
                let cos = dot(r, d);
                let alpha2 = ROUGHNESS.powi(4);
                // (n·h)² of the half vector between r and d is (1 + cos) / 2.
                let lobe = alpha2 / (0.5 * (1.0 + cos) * (alpha2 - 1.0) + 1.0).powi(2);
                lobe * cos.max(0.0)
            }),
            Sphere::Diffuse => gathered(&light, |d| dot(n, d).max(0.0)),
        };
        for (o, v) in image.data[3 * i..3 * i + 3].iter_mut().zip(color) {
            *o = v as f32;
        }
    }
    (image, mask)
}

/// `Σ L w dω / Σ w dω`.
fn gathered(light: &[([f64; 3], f64, [f64; 3])], weight: impl Fn([f64; 3]) -> f64) -> [f64; 3] {
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for (d, omega, radiance) in light {
        let w = weight(*d) * omega;
        total += w;
        for c in 0..3 {
            sum[c] += w * radiance[c];
        }
    }
    sum.map(|v| v / total)
}

/// Where the brightest light comes from: the direction of the largest luminance after a blur of about 10° (a GGX lobe of
/// roughness 0.4), as a unit vector. What a shadow's direction depends on.
#[must_use]
pub fn peak_direction(map: &Image) -> [f64; 3] {
    let map = reduced(map, LOBE_ROWS);
    let light = texels(&map);
    let luminance = |c: &[f64; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    let mut best = (f64::MIN, [0.0, 0.0, 1.0]);
    for (at, _, _) in &light {
        let mut sum = 0.0;
        for (d, omega, radiance) in &light {
            let cos = dot(*at, *d);
            if cos > 0.94 {
                sum += omega * luminance(radiance) * (60.0 * (cos - 1.0)).exp();
            }
        }
        if sum > best.0 {
            best = (sum, *at);
        }
    }
    best.1
}

/// A true map of light, ready to judge estimates of it: what does not depend on the estimate is computed once.
#[derive(Clone, Debug)]
pub struct Judge {
    protocol: Protocol,
    gain: f32,
    pictures: [Image; 3],
    mask: Image,
    irradiance: Vec<[f64; 3]>,
    peak: [f64; 3],
}

impl Judge {
    /// The judge of estimates of `truth`: 3 channels, equirectangular, any size.
    ///
    /// # Errors
    /// [`MetricError`] on other channel counts, non-finite samples, or a black truth.
    pub fn new(truth: &Image, protocol: Protocol) -> Result<Self, MetricError> {
        let truth = prepared(truth, "ground truth", protocol)?;
        let (diffuse, mask) = picture(&truth, Sphere::Diffuse);
        let covered: f64 = mask.data.iter().map(|&m| f64::from(m)).sum();
        let mean = diffuse.data.iter().map(|&v| f64::from(v)).sum::<f64>() / (3.0 * covered);
        if mean <= 0.0 {
            return Err(MetricError::NothingToMeasure { metric: "spheres" });
        }
        let gain = (EXPOSED / mean) as f32;
        let truth = truth.map(|v| v * gain);
        let pictures = SPHERES.map(|s| picture(&truth, s).0);
        let (irradiance, peak) = (irradiance(&truth), peak_direction(&truth));
        Ok(Self { protocol, gain, pictures, mask, irradiance, peak })
    }

    /// Errors of an estimate: 3 channels, equirectangular, any size. Both maps are exposed so that the *truth's* diffuse sphere
    /// has a mean of 0.5, so that errors of dark and bright places can be averaged.
    ///
    /// # Errors
    /// [`MetricError`] on other channel counts and non-finite samples.
    pub fn errors(&self, estimate: &Image) -> Result<LightErrors, MetricError> {
        let estimate = prepared(estimate, "estimate", self.protocol)?.map(|v| v * self.gain);
        let channels = if self.protocol == Protocol::Legacy { 3f64.sqrt() } else { 1.0 };
        let mut spheres = Vec::new();
        for (sphere, b) in SPHERES.into_iter().zip(&self.pictures) {
            let a = picture(&estimate, sphere).0;
            let (weights, mask) = (PixelWeights::Uniform, Some(&self.mask));
            spheres.push(SphereErrors {
                sphere,
                rmse: channels * rmse(&a, b, weights, mask)?,
                si_rmse: channels * si_rmse(&a, b, weights, mask)?,
                // A black estimate has no colour to compare: as far off as can be.
                angular_deg: angular_rgb_error(&a, b, weights, mask).map_or(90.0, |e| e.mean_deg),
                normalized_rmse: channels * normalized_rmse(&a, b, weights, mask)?,
            });
        }
        let (mut off, mut total) = (0.0, 0.0);
        for (e, t) in irradiance(&estimate).iter().zip(&self.irradiance) {
            for c in 0..3 {
                off += (e[c] - t[c]).abs();
                total += t[c];
            }
        }
        let peak = dot(peak_direction(&estimate), self.peak);
        Ok(LightErrors {
            spheres,
            irradiance: off / total,
            peak_deg: peak.clamp(-1.0, 1.0).acos().to_degrees(),
        })
    }
}

/// [`Judge`] of one estimate.
///
/// # Errors
/// As [`Judge::new`] and [`Judge::errors`].
pub fn light_errors(estimate: &Image, truth: &Image, protocol: Protocol) -> Result<LightErrors, MetricError> {
    Judge::new(truth, protocol)?.errors(estimate)
}

fn prepared(map: &Image, what: &'static str, protocol: Protocol) -> Result<Image, MetricError> {
    if map.channels != 3 {
        return Err(MetricError::Channels { what, expected: "3", got: map.channels });
    }
    check::finite(what, map)?;
    if map.pixels() == 0 {
        return Err(MetricError::NothingToMeasure { metric: "spheres" });
    }
    let map = reduced(map, MIRROR_ROWS);
    Ok(if protocol == Protocol::Legacy { compressed(&map) } else { map })
}

/// Irradiance over π at evenly spread normals.
fn irradiance(map: &Image) -> Vec<[f64; 3]> {
    let light = texels(&reduced(map, LOBE_ROWS));
    (0..NORMALS)
        .map(|i| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(NORMALS);
            let theta = std::f64::consts::PI * (1.0 + 5f64.sqrt()) * (f64::from(i) + 0.5);
            let r = (1.0 - z * z).sqrt();
            let n = [r * theta.cos(), r * theta.sin(), z];
            gathered(&light, |d| dot(n, d).max(0.0))
        })
        .collect()
}

fn compressed(map: &Image) -> Image {
    let mut values: Vec<f32> = map.data.clone();
    values.sort_by(f32::total_cmp);
    let p99 = values[((values.len() - 1) as f64 * 0.99) as usize].max(1e-12);
    map.map(|v| (v.max(0.0) / p99).min(1.0).powf(1.0 / 2.4))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn constant(rgb: [f32; 3]) -> Image {
        Image::from_data(32, 16, 3, rgb.repeat(512))
    }

    /// Goal: under even light all three spheres are even, of the light's own colour.
    #[test]
    fn even_light() {
        for sphere in SPHERES {
            let (image, mask) = picture(&constant([0.2, 0.5, 0.9]), sphere);
            for (i, m) in mask.data.iter().enumerate() {
                let expected = if *m > 0.0 { [0.2, 0.5, 0.9] } else { [0.0; 3] };
                for c in 0..3 {
                    assert!((image.data[3 * i + c] - expected[c]).abs() < 1e-5, "{sphere:?}");
                }
            }
        }
    }

    /// Goal: a small light at the zenith gives the diffuse sphere max(n·z, 0) and lights the mirror where n is half-way
    /// between the camera and the zenith.
    #[test]
    fn a_light_overhead() {
        let mut map = Image::zeros(128, 64, 3);
        map.data[..3 * 128].fill(100.0);
        let (diffuse, _) = picture(&map, Sphere::Diffuse);
        let at = |x: usize, y: usize| diffuse.data[3 * (y * SIDE + x)];
        let height = |y: usize| 1.0 - 2.0 * (y as f32 + 0.5) / SIDE as f32;
        let ratio = at(32, 10) / at(32, 25);
        assert!((ratio - height(10) / height(25)).abs() < 0.01, "{ratio}");
        assert!(at(32, 50) < 1e-3 * at(32, 10));
        let (mirror, _) = picture(&map, Sphere::Mirror);
        let row = (0..SIDE).find(|y| mirror.data[3 * (y * SIDE + 32)] > 0.0).unwrap();
        // n = (−1, 0, 1)/√2: at height 1/√2.
        assert!((height(row) - std::f32::consts::FRAC_1_SQRT_2).abs() < 0.06, "{row}");
        assert!(dot(peak_direction(&map), [0.0, 0.0, 1.0]) > 0.99);
    }

    /// Goal: the same map has no error; exposure is no scale-invariant error but one of irradiance; a turned light is
    /// found as a peak error of that angle.
    #[test]
    fn errors_mean_what_they_say() {
        let spot = |column: usize| {
            let mut map = constant([0.1, 0.1, 0.1]);
            let i = 3 * (7 * 32 + column);
            map.data[i..i + 3].fill(60.0);
            map
        };
        let truth = spot(8);
        let same = light_errors(&truth, &truth, Protocol::Linear).unwrap();
        assert!(same.irradiance < 1e-9 && same.peak_deg < 1e-3);
        let brighter = light_errors(&truth.map(|v| 1.5 * v), &truth, Protocol::Linear).unwrap();
        assert!((brighter.irradiance - 0.5).abs() < 1e-5);
        for s in &brighter.spheres {
            assert!(s.si_rmse < 1e-5 * s.rmse.max(1.0), "{s:?}");
            assert!(s.rmse > 0.01, "{s:?}");
        }
        let turned = light_errors(&spot(12), &truth, Protocol::Linear).unwrap();
        assert!((turned.peak_deg - 45.0).abs() < 3.0, "{}", turned.peak_deg);
        assert!(turned.spheres[2].si_rmse > 0.05);
        assert!(light_errors(&truth, &constant([0.0; 3]), Protocol::Linear).is_err());
        assert!(light_errors(&truth, &truth, Protocol::Legacy).unwrap().irradiance < 1e-9);
    }
}
