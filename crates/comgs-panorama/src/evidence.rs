//! Evidence from the scene: a lit scene itself says how bright its lights are, and where.
//!
//! Surfaces near the placement were photographed under the light that is sought. A point of albedo ρ reflects
//!
//! ```text
//! r = ρ/π ( K + s R + Σ_j E_j cos_j V_j ),   K = ∫ L_scene cos dω,   R = ∫ L_completed V cos dω
//! ```
//!
//! K is what reaches it from surfaces and sky that the scene's radiance field knows, R what the completion says of the rest,
//! with a scale s, and E_j the irradiance of strong lights in directions that nobody saw or that the photos clipped; the
//! visibilities V are traced through the scene's own surfels. Points of like albedo that see more or less of a light differ by
//! what it adds: a shadow on the floor tells the sun's direction and energy although no photo shows the sun.
//!
//! [`refine`] looks in every direction for the one light that explains the points best (a robust Huber loss, the albedos of
//! clusters of alike points solved along, nothing negative), looks closer around it, and goes on with the next while the loss
//! falls. A convex fit of all directions at once was tried and is worse: with few points in shadow it raises the whole sky
//! and the albedos with it. A fifth of the points has no say and judges: when their loss does not fall by
//! [`Config::least_gain`], the completion is left as it was.

mod directions;
mod receivers;
mod solve;

use crate::{Partial, Sweep, SweepConfig, sweep};
use comgs_geom::equirect;
use comgs_image::Image;
use comgs_trace::Tracer;
use directions::{Bins, around};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use receivers::Receivers;
use solve::{NEAR_DEG, Source, Testimony};

/// Knobs.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Surface points that are looked at.
    pub points: usize,
    /// Directions over the whole sphere that are tried.
    pub bins: usize,
    /// Clusters of like albedo.
    pub clusters: usize,
    /// Strong lights at most.
    pub lights: usize,
    /// How far the loss must fall, as a share, for a light to count: that of the points with a say for each light, and that of
    /// the judges for all of it.
    pub least_gain: f64,
    /// Radiance from which the capture's photos say only "at least this"; `None` for high dynamic range.
    pub clip: Option<f32>,
    /// Angular radius of the discs that the lights become in the map, degrees.
    pub disc_deg: f64,
    /// Seed of the choice of points.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            points: 1500,
            clip: None,
            bins: 600,
            clusters: 8,
            lights: 3,
            least_gain: 0.15,
            disc_deg: 2.5,
            seed: 0,
        }
    }
}

/// A strong light that the scene tells of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StrongLight {
    /// Where it comes from, unit, world.
    pub direction: Vec3,
    /// Irradiance (RGB) on a surface that faces it.
    pub irradiance: [f32; 3],
}

/// What the scene says.
#[derive(Clone, Debug, PartialEq)]
pub struct Evidence {
    /// The completion, with lights added and the unseen rest scaled where the evidence is strong.
    pub environment: Image,
    /// Whether it was changed.
    pub used: bool,
    /// Points that could be used.
    pub points: usize,
    /// Directions that were tried.
    pub directions: usize,
    /// Loss of the judging points: under the completion, and under the result.
    pub loss: [f64; 2],
    /// The lights, strongest first; empty when not used.
    pub lights: Vec<StrongLight>,
    /// Factor on the completed part, RGB.
    pub scale: [f32; 3],
}

/// A bin is fixed when more than this share of it was seen and not clipped.
const SEEN: f64 = 0.5;
/// Fewer points than this say nothing.
const FEWEST: usize = 60;
/// A light is told only when none further away than this explains more than that share of what it explains.
const ELSEWHERE_DEG: f32 = 35.0;
const MOST_ELSEWHERE: f64 = 0.8;
/// A light that gives less than this share of what reaches the points is none.
const WEAK: f64 = 0.15;
/// Directions of each closer look, and how much the cap shrinks.
const CLOSER: usize = 19;
const LOOKS: [f64; 3] = [1.3, 0.65, 0.3];

/// Changes a completion to what the scene's lit surfaces say.
///
/// * `tracer`: the scene
/// * `seen`: the sweep around `centre`, any size
/// * `partial`: what was given to the completer, of the completion's size
/// * `completed`: the completion, linear radiance
///
/// Deterministic for a seed, at any thread count. Not differentiable. Light is taken to come from infinitely far, which holds
/// for points near the placement; the scene is taken to be Lambertian, which the robust loss forgives where it is not.
#[must_use]
pub fn refine(
    tracer: &Tracer,
    seen: &Sweep,
    centre: Vec3,
    partial: &Partial,
    completed: &Image,
    config: &Config,
) -> Evidence {
    let bins = Bins::of(config.bins, partial, completed, SEEN);
    let receivers = Receivers::choose(&viewpoints(tracer, seen, centre), config);
    let unchanged = |directions, loss| Evidence {
        environment: completed.clone(),
        used: false,
        points: receivers.len(),
        directions,
        loss,
        lights: Vec::new(),
        scale: [1.0; 3],
    };
    let directions = (0..bins.len()).filter(|&b| bins.is_unknown(b)).count();
    if receivers.len() < FEWEST || directions == 0 {
        return unchanged(directions, [0.0; 2]);
    }
    let (testimony, candidates) = Testimony::trace(tracer, &receivers, &bins);
    let mut scale = DVec3::ONE;
    let mut sources: Vec<Source> = Vec::new();
    let before = testimony.loss(&testimony.light(scale, &[]), 0..3, true);
    // First what no light is needed for.
    testimony.polish(&mut scale, &mut sources);
    let mut own = testimony.loss(&testimony.light(scale, &[]), 0..3, false);
    for _ in 0..config.lights {
        let light = testimony.light(scale, &sources);
        let color = DVec3::ONE;
        let alone = testimony.loss(&light, 1..2, false);
        let Some((mut best, mut loss, elsewhere)) = strongest(&testimony, &light, candidates.clone(), color)
        else {
            break;
        };
        for look in LOOKS {
            let near = around(best.direction, look * bins.radius(), CLOSER);
            let near = near.into_iter().map(|d| testimony.source(tracer, d)).chain([best.clone()]).collect();
            if let Some((closer, less, _)) = strongest(&testimony, &light, near, color) {
                (best, loss) = (closer, less);
            }
        }
        // Where the points see no shadow every direction explains them alike, and none is told.
        if alone - elsewhere > MOST_ELSEWHERE * (alone - loss) {
            break;
        }
        let keep = (scale, sources.clone());
        testimony.surround(&mut best, &candidates, &bins);
        sources.push(best);
        testimony.polish(&mut scale, &mut sources);
        let light = testimony.light(scale, &sources);
        let now = testimony.loss(&light, 0..3, false);
        let weak = sources.last().is_some_and(|s| {
            s.irradiance.element_sum() < WEAK * testimony.mean_irradiance(&light).element_sum()
        });
        if weak || now > own * (1.0 - config.least_gain) {
            (scale, sources) = keep;
            break;
        }
        own = now;
    }
    let after = testimony.loss(&testimony.light(scale, &sources), 0..3, true);
    let telling = after <= before * (1.0 - config.least_gain) && after.is_finite();
    if !telling {
        return unchanged(directions, [before, after]);
    }
    sources.sort_by(|a, b| b.irradiance.element_sum().total_cmp(&a.irradiance.element_sum()));
    let lights: Vec<StrongLight> = sources
        .iter()
        .map(|s| StrongLight { direction: s.direction, irradiance: s.irradiance.as_vec3().to_array() })
        .collect();
    let scale = scale.as_vec3().to_array();
    let near: Vec<[f32; 3]> = sources.iter().map(|s| s.near_scale.as_vec3().to_array()).collect();
    Evidence {
        environment: paint(completed, partial, &lights, &near, scale, config.disc_deg),
        used: true,
        points: receivers.len(),
        directions,
        loss: [before, after],
        lights,
        scale,
    }
}

/// Half a panorama's rows of the further sweeps.
const ROWS: usize = 48;

/// The sweep, and further ones from above and around the centre wherever the way there is free: what stands beside the centre
/// hides its own shadow from it.
fn viewpoints(tracer: &Tracer, seen: &Sweep, centre: Vec3) -> Vec<(Vec3, Sweep)> {
    let mut depths: Vec<f32> = seen.depth.data.iter().copied().filter(|d| *d > 0.0).collect();
    depths.sort_by(f32::total_cmp);
    let reach = depths.get(depths.len() / 2).copied().unwrap_or(0.0);
    let mut sweeps = vec![(centre, seen.clone())];
    for away in [Vec3::ZERO, Vec3::X, Vec3::Y, -Vec3::X, -Vec3::Y] {
        let to = reach * (1.6 * Vec3::Z + 1.2 * away);
        let free = tracer.transmittance(centre, to.normalize_or_zero(), 0.0, to.length());
        if reach > 0.0 && free > 0.8 {
            let config = SweepConfig { t_min: 0.1 * reach, ..SweepConfig::default() };
            sweeps.push((centre + to, sweep(tracer, centre + to, 2 * ROWS, ROWS, &config)));
        }
    }
    sweeps
}

/// The source that explains the points best at its best irradiance, the loss with it, and the least loss with one from far
/// elsewhere; `None` when none is better than nothing.
fn strongest(
    testimony: &Testimony<'_>,
    light: &[DVec3],
    candidates: Vec<Source>,
    color: DVec3,
) -> Option<(Source, f64, f64)> {
    let tried: Vec<(f64, f64)> =
        candidates.par_iter().map(|s| testimony.best_irradiance(light, s, color)).collect();
    let best = (0..tried.len()).min_by(|&a, &b| tried[a].1.total_cmp(&tried[b].1).then(a.cmp(&b)))?;
    let direction = candidates[best].direction;
    let far = |s: &Source| s.direction.angle_between(direction).to_degrees() > ELSEWHERE_DEG;
    let elsewhere =
        candidates.iter().zip(&tried).filter(|(s, _)| far(s)).map(|(_, t)| t.1).fold(f64::INFINITY, f64::min);
    let mut source = candidates.into_iter().nth(best)?;
    source.irradiance = color * tried[best].0;
    (tried[best].0 > 0.0).then_some((source, tried[best].1, elsewhere))
}

/// The completion with its completed part scaled and discs for the lights. A disc that falls on what was seen is painted all
/// the same: it is what the photos clipped, or lies behind an edge of the mask.
fn paint(
    completed: &Image,
    partial: &Partial,
    lights: &[StrongLight],
    near: &[[f32; 3]],
    scale: [f32; 3],
    disc_deg: f64,
) -> Image {
    let mut out = completed.clone();
    let (width, height) = (out.width, out.height);
    for (i, pixel) in out.data.chunks_exact_mut(3).enumerate() {
        let free = 1.0 - partial.alpha.data[i].clamp(0.0, 1.0);
        let d = equirect::texel_direction(i % width, i / width, width, height);
        let mut scale = scale;
        for (light, near) in lights.iter().zip(near) {
            // Without an edge in the map: the cone's rim fades over its outer half.
            let inside =
                (2.0 - 2.0 * d.angle_between(light.direction).to_degrees() / NEAR_DEG).clamp(0.0, 1.0);
            for (s, n) in scale.iter_mut().zip(near) {
                *s *= 1.0 + inside * (n - 1.0);
            }
        }
        for (v, s) in pixel.iter_mut().zip(scale) {
            *v *= 1.0 + free * (s - 1.0);
        }
    }
    // At least one texel wide.
    let radius = disc_deg.to_radians().max(1.5 * std::f64::consts::PI / height as f64) as f32;
    for light in lights {
        // Falls off towards the rim, so that a disc between texels keeps its place.
        let weight = |x: usize, y: usize| {
            let angle = equirect::texel_direction(x, y, width, height).angle_between(light.direction);
            (1.0 - angle / radius).max(0.0)
        };
        let mut total = 0.0f64;
        for y in 0..height {
            let omega = f64::from(equirect::texel_solid_angle(y, width, height));
            total += (0..width).map(|x| omega * f64::from(weight(x, y))).sum::<f64>();
        }
        for y in 0..height {
            for x in 0..width {
                let w = f64::from(weight(x, y));
                if w > 0.0 {
                    for (v, e) in out.pixel_mut(x, y).iter_mut().zip(light.irradiance) {
                        *v += (w / total * f64::from(e)) as f32;
                    }
                }
            }
        }
    }
    out
}
