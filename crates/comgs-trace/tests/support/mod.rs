//! Small clouds for the tests.
#![allow(dead_code)]

use comgs_geom::{Rng, sh};
use comgs_surfel::{ColorEncoding, SurfelCloud, activation};
use comgs_trace::{RadianceHit, Ray, TraceConfig, Tracer, reference};
use glam::{DVec3, Quat, Vec3};

/// A surfel of constant colour, opacity as given (not a logit).
pub fn push(
    cloud: &mut SurfelCloud,
    centre: Vec3,
    rotation: Quat,
    scale: [f32; 2],
    opacity: f32,
    colour: Vec3,
) {
    cloud.positions.push(centre.to_array());
    cloud.rotations.push([rotation.w, rotation.x, rotation.y, rotation.z]);
    cloud.log_scales.push(scale.map(f32::ln));
    cloud.opacity_logits.push(activation::logit(opacity));
    let stride = cloud.sh_stride();
    cloud.sh.extend((colour - 0.5).to_array().map(|c| c / sh::C0));
    cloud.sh.extend(std::iter::repeat_n(0.0, stride - 3));
}

/// A direction, uniform on the sphere.
pub fn direction(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()
}

/// Surfels of all sizes, aspects and opacities in the unit ball, with harmonics of degree 3.
pub fn soup(n: usize, seed: u64, encoding: ColorEncoding) -> SurfelCloud {
    let mut rng = Rng::new(seed);
    let mut cloud = SurfelCloud::empty(3, encoding);
    for _ in 0..n {
        let centre = direction(&mut rng) * rng.uniform().cbrt();
        cloud.positions.push(centre.to_array());
        cloud.rotations.push([rng.normal(), rng.normal(), rng.normal(), rng.normal()]);
        cloud.log_scales.push([rng.range(-6.0, -1.5), rng.range(-6.0, -1.5)]);
        cloud.opacity_logits.push(rng.range(-7.0, 5.0));
        for k in 0..cloud.sh_stride() {
            cloud.sh.push(if k < 3 { rng.range(-1.0, 2.0) } else { 0.2 * rng.normal() });
        }
    }
    cloud
}

/// Rays through the unit ball, from outside and from within, towards everything and along the axes.
pub fn rays(n: usize, seed: u64) -> Vec<Ray> {
    let mut rng = Rng::new(seed);
    (0..n)
        .map(|i| {
            let origin = direction(&mut rng) * rng.range(0.0, 3.0);
            let target = direction(&mut rng) * rng.uniform().cbrt();
            let d = match i % 8 {
                0 => [Vec3::X, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_X][i / 8 % 4],
                _ => (target - origin) * rng.range(0.1, 4.0),
            };
            let t_min = if i % 3 == 0 { rng.range(0.0, 1.0) } else { 0.0 };
            let t_max = if i % 5 == 0 { t_min + rng.range(0.0, 2.0) } else { f32::INFINITY };
            Ray::between(origin, d, t_min, t_max)
        })
        .collect()
}

/// Relative width of the band around a threshold (rim of a disc, end of a ray) in which f32 may decide otherwise.
const BAND: f64 = 1e-3;
/// What f32 sums may be off by, relative to the largest value that a quantity can have here.
const TOLERANCE: f64 = 2e-4;

/// Holds one ray of a tracer against the reference. Returns the number of hits of the reference.
///
/// Surfels in the band around a threshold may or may not be hit in f32; what they could change (at most their α,
/// and then the order of what follows) is added to the tolerance.
pub fn judge(tracer: &Tracer, cloud: &SurfelCloud, ray: &Ray) -> usize {
    let config = tracer.config().clone();
    let (origin, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let cutoff = f64::from(config.alpha_min);
    let (t_min, t_max) = (f64::from(ray.t_min), f64::from(ray.t_max));
    let reach = origin.length() + 2.0;
    let slip = 1e-5 * reach / d.length();
    let of = |sign: f64| {
        let cutoff = cutoff * (1.0 + sign * BAND);
        reference::hits(cloud, &config, cutoff, origin, d, t_min + sign * slip, t_max - sign * slip)
    };
    let (wide, narrow) = (of(-1.0), of(1.0));
    let exact = reference::hits(cloud, &config, cutoff, origin, d, t_min, t_max);
    let unsure: f64 = wide.iter().map(|h| h.alpha).sum::<f64>() - narrow.iter().map(|h| h.alpha).sum::<f64>();
    // Two surfels closer together than rounding may swap: the blend then changes by at most the product of their α.
    let swaps: f64 =
        exact.windows(2).filter(|p| p[1].t - p[0].t < slip).map(|p| p[0].alpha * p[1].alpha).sum();

    // Grazing hits multiply rounding of the position by 1/cos θ: α itself is then unsure.
    let grazing: f64 = exact
        .iter()
        .map(|h| {
            let cosine = h.normal.dot(d.normalize()).abs();
            let scale = cloud.log_scales[h.surfel].iter().fold(f32::INFINITY, |a, &s| a.min(s)).exp();
            h.alpha * (1e-6 * reach / (cosine * f64::from(scale))).min(1.0)
        })
        .sum();
    let slack = TOLERANCE + unsure + grazing;

    let got = f64::from(tracer.transmittance(ray.origin, ray.direction, ray.t_min, ray.t_max));
    let expected = reference::transmittance(&exact);
    let stop = f64::from(config.transmittance_min);
    assert!((got - expected).abs() <= slack + stop, "{ray:?}: transmittance {got}, expected {expected}");

    let got = tracer.radiance(ray.origin, ray.direction, ray.t_min, ray.t_max);
    let expected = reference::blend(cloud, &exact, origin);
    let slack = slack + swaps + stop;
    let brightest = 30.0;
    assert!(
        (f64::from(got.alpha) - expected.alpha).abs() <= slack,
        "{ray:?}: {got:?}, expected {expected:?}"
    );
    let radiance = (got.radiance.as_dvec3() - expected.radiance).abs().max_element();
    assert!(radiance <= brightest * slack, "{ray:?}: {got:?}, expected {expected:?}");
    let depth = (f64::from(got.depth) - expected.depth).abs() * d.length();
    assert!(depth <= 2.0 * reach * slack, "{ray:?}: {got:?}, expected {expected:?}");
    let normal = (got.normal.as_dvec3() - expected.normal).length();
    assert!(normal <= 2.0 * slack, "{ray:?}: {got:?}, expected {expected:?}");
    exact.len()
}

/// A wall of surfels across the x axis, one behind the other.
pub fn stack(n: usize, opacity: f32, spacing: f32) -> SurfelCloud {
    let mut rng = Rng::new(11);
    let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
    let facing_x = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
    let mut order: Vec<usize> = (0..n).collect();
    rng.shuffle(&mut order);
    for k in order {
        let colour = Vec3::new(k as f32 / n as f32, 1.0 - k as f32 / n as f32, 0.5);
        push(
            &mut cloud,
            Vec3::new(1.0 + k as f32 * spacing, 0.0, 0.0),
            facing_x,
            [0.5, 0.5],
            opacity,
            colour,
        );
    }
    cloud
}

/// The empty hit.
pub fn nothing() -> RadianceHit {
    RadianceHit::default()
}

/// A tracer with the default configuration.
pub fn tracer(cloud: &SurfelCloud) -> Tracer {
    Tracer::new(cloud, &TraceConfig::default()).expect("the configuration is sound")
}

/// f64 of a vector.
pub fn wide(v: Vec3) -> DVec3 {
    v.as_dvec3()
}
