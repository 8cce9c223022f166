//! From raw surfel parameters to the discs that rays meet.

use crate::TraceConfig;
use comgs_surfel::{SurfelCloud, activation};
use glam::Vec3;

/// Centres and discs further out than this are not traced: squares of box areas must stay finite in f32.
const LARGEST_COORDINATE: f32 = 1e15;
/// Discs are boxed this much larger than they are, relative to their radius, so that a hit at the very rim that
/// rounding accepts is inside its box.
const RELATIVE_PADDING: f32 = 1e-3;
/// And this much larger relative to the coordinates themselves: a few units in the last place.
const COORDINATE_PADDING: f32 = 4.0 * f32::EPSILON;

/// Surfels that the tracer does not hold, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Peak opacity below `alpha_min`: they contribute nothing anywhere.
    pub transparent: usize,
    /// Non-finite parameters, an extent of 0 or infinity, or coordinates beyond 10¹⁵.
    pub degenerate: usize,
}

/// A surfel as the ray kernel wants it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Disc {
    /// Centre, world.
    pub centre: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Tangent over standard deviation: `u = tangent_u · (hit − centre)`.
    pub tangent_u: Vec3,
    /// As `tangent_u`, for v.
    pub tangent_v: Vec3,
    /// Natural logarithm of the peak opacity.
    pub log_opacity: f32,
    /// Index in the cloud.
    pub surfel: u32,
    /// Half extents of the padded box around `centre`.
    pub half_extent: Vec3,
}

impl Disc {
    pub fn min(&self) -> Vec3 {
        self.centre - self.half_extent
    }

    pub fn max(&self) -> Vec3 {
        self.centre + self.half_extent
    }
}

/// The discs of a cloud, in the order of its surfels.
pub(crate) fn discs(cloud: &SurfelCloud, config: &TraceConfig) -> (Vec<Disc>, LeftOut) {
    let mut left_out = LeftOut::default();
    let mut discs = Vec::with_capacity(cloud.len());
    for i in 0..cloud.len() {
        let opacity = activation::sigmoid(cloud.opacity_logits[i]);
        if opacity < config.alpha_min {
            left_out.transparent += 1;
            continue;
        }
        match disc(cloud, i, opacity, config.alpha_min) {
            Some(disc) => discs.push(disc),
            None => left_out.degenerate += 1,
        }
    }
    (discs, left_out)
}

/// The disc of surfel `i`; `None` when some parameter has no meaning.
fn disc(cloud: &SurfelCloud, i: usize, opacity: f32, alpha_min: f32) -> Option<Disc> {
    let centre = Vec3::from_array(cloud.positions[i]);
    let scale = cloud.log_scales[i].map(f32::exp);
    let inverse = scale.map(|s| 1.0 / s);
    let sound = |v: f32| v.is_finite() && v > 0.0;
    if !opacity.is_finite()
        || !cloud.rotations[i].iter().all(|v| v.is_finite())
        || !scale.into_iter().chain(inverse).all(sound)
        || !cloud.sh_of(i).iter().all(|v| v.is_finite())
    {
        return None;
    }
    let [tangent_u, tangent_v, normal] = cloud.rotation(i).to_cols_array_2d().map(Vec3::from_array);
    // Radius in standard deviations: opacity · exp(−r²/2) = alpha_min. The box of an ellipse with half axes a and b
    // has the half extents √(a² + b²), taken per coordinate.
    let radius = (2.0 * (opacity / alpha_min).ln()).max(0.0).sqrt();
    let (a, b) = (tangent_u * (radius * scale[0]), tangent_v * (radius * scale[1]));
    let extent = Vec3::new(a.x.hypot(b.x), a.y.hypot(b.y), a.z.hypot(b.z));
    let largest = a.length().max(b.length());
    let padding =
        RELATIVE_PADDING * largest + COORDINATE_PADDING * centre.abs().max_element() + f32::MIN_POSITIVE;
    let half_extent = extent + Vec3::splat(padding);
    let furthest = centre.abs() + half_extent;
    if !furthest.is_finite() || furthest.max_element() > LARGEST_COORDINATE {
        return None;
    }
    Some(Disc {
        centre,
        normal,
        tangent_u: tangent_u * inverse[0],
        tangent_v: tangent_v * inverse[1],
        log_opacity: opacity.ln(),
        surfel: i as u32,
        half_extent,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_surfel::ColorEncoding;

    fn one(log_scale: [f32; 2], rotation: [f32; 4], logit: f32) -> SurfelCloud {
        let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
        cloud.positions.push([1.0, -2.0, 3.0]);
        cloud.rotations.push(rotation);
        cloud.log_scales.push(log_scale);
        cloud.opacity_logits.push(logit);
        cloud.sh.extend([0.0; 3]);
        cloud
    }

    /// Goal: the box is the tight one of the rotated ellipse, found here by walking its rim.
    #[test]
    fn box_is_exact() {
        let cloud = one([-1.0, -3.0], [0.4, 0.2, -0.7, 0.5], 2.0);
        let config = TraceConfig::default();
        let (discs, _) = discs(&cloud, &config);
        let d = discs[0];
        let opacity = activation::sigmoid(2.0);
        let radius = (2.0 * (opacity / config.alpha_min).ln()).sqrt();
        let m = cloud.rotation(0);
        let mut largest = Vec3::ZERO;
        for k in 0..10_000 {
            let (s, c) = (k as f32 * std::f32::consts::TAU / 10_000.0).sin_cos();
            let rim = radius * (m.x_axis * (c * (-1.0f32).exp()) + m.y_axis * (s * (-3.0f32).exp()));
            largest = largest.max(rim.abs());
        }
        let slack = d.half_extent - largest;
        // Never smaller than the ellipse, and larger only by the padding.
        assert!(slack.min_element() >= 0.0, "{slack}");
        assert!(slack.max_element() < 2.0 * RELATIVE_PADDING * radius * (-1.0f32).exp(), "{slack}");
    }

    /// Goal: transparent and degenerate surfels are counted apart and not traced (hard cases 5 and 6).
    #[test]
    fn unusable_surfels_are_left_out() {
        let unit = [1.0, 0.0, 0.0, 0.0];
        let config = TraceConfig::default();
        let case = |cloud: SurfelCloud| {
            let (kept, out) = discs(&cloud, &config);
            (kept.len(), out.transparent, out.degenerate)
        };
        assert_eq!(case(one([0.0; 2], unit, 0.0)), (1, 0, 0));
        assert_eq!(case(one([0.0; 2], unit, f32::INFINITY)), (1, 0, 0));
        assert_eq!(case(one([0.0; 2], unit, -10.0)), (0, 1, 0));
        assert_eq!(case(one([0.0; 2], unit, f32::NEG_INFINITY)), (0, 1, 0));
        assert_eq!(case(one([0.0; 2], unit, f32::NAN)), (0, 0, 1));
        assert_eq!(case(one([0.0; 2], [f32::NAN, 0.0, 0.0, 1.0], 0.0)), (0, 0, 1));
        assert_eq!(case(one([0.0; 2], [0.0; 4], 0.0)), (1, 0, 0));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 200.0, -200.0, 40.0] {
            assert_eq!(case(one([0.0, bad], unit, 0.0)), (0, 0, 1), "{bad}");
        }
        assert_eq!(case(one([-40.0, 30.0], unit, 0.0)), (1, 0, 0));
        let mut nan_position = one([0.0; 2], unit, 0.0);
        nan_position.positions[0][1] = f32::NAN;
        assert_eq!(case(nan_position), (0, 0, 1));
        let mut nan_colour = one([0.0; 2], unit, 0.0);
        nan_colour.sh[1] = f32::NAN;
        assert_eq!(case(nan_colour), (0, 0, 1));
    }
}
