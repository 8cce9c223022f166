//! How well lights explain what the points reflect: robust losses with the albedos of clusters solved along.

use super::directions::Bins;
use super::receivers::Receivers;
use comgs_trace::Tracer;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// What reaches each point: `known + scale · rest + Σ_j E_j gain_j`, irradiance over π.
pub(super) struct Testimony<'r> {
    receivers: &'r Receivers,
    /// From surfaces and sky that were seen.
    known: Vec<DVec3>,
    /// From the completed part, as the completion has it.
    rest: Vec<DVec3>,
    /// What errors are measured against, for each point and channel.
    scales: Vec<DVec3>,
    /// Loss under the completion as it is.
    prior: f64,
}

/// A light: where from, and what it gives a surface that faces it.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub direction: Vec3,
    pub irradiance: DVec3,
    /// `cos · visibility / π` of every point.
    pub gain: Vec<f64>,
    /// What the completion has around the direction, which may be this very light, blurred: what reaches every point from
    /// there, and its scale.
    pub near: Vec<DVec3>,
    /// Scale of it.
    pub near_scale: DVec3,
}

/// Relative error from which the Huber loss grows linearly.
const HUBER: f64 = 0.1;
/// Rounds of reweighting for albedo.
const REWEIGHTED: usize = 4;
/// Albedos are sought within these.
const ALBEDO: (f64, f64) = (0.01, 0.95);
/// Irradiances are tried from this part of the mean of what reaches the points, each this factor more than the last.
const WEAKEST: f64 = 0.1;
const STEP: f64 = 1.6;
const TRIED: i32 = 12;
/// Weight of the squared logarithm of the rest's scale, as a share of the loss under the completion: what cannot be explained
/// at all must not push the scale about.
const SCALE_PRIOR: f64 = 0.3;
/// The same for what surrounds a light: what stands there in the completion is likely the light itself.
const NEAR_PRIOR: f64 = 0.01;
/// How far around a light the completion may be that light, degrees.
pub(super) const NEAR_DEG: f32 = 35.0;
/// Weight of the squared logarithm of albedo over a plain surface's, as such a share, and that albedo.
const PAINT_PRIOR: f64 = 0.05;
const PLAIN: f64 = 0.4;

impl<'r> Testimony<'r> {
    /// Traces every point's view of every bin; returns what is known of the points and, for each unknown bin, its gains.
    pub(super) fn trace(tracer: &Tracer, receivers: &'r Receivers, bins: &Bins) -> (Self, Vec<Source>) {
        let scale = bins.solid_angle() / PI;
        let rows: Vec<(DVec3, DVec3, Vec<f64>)> = receivers
            .all
            .par_iter()
            .map(|r| {
                let origin = r.position + r.normal * receivers.offset;
                let (mut known, mut rest, mut gains) = (DVec3::ZERO, DVec3::ZERO, vec![0.0; bins.len()]);
                for (b, gain) in gains.iter_mut().enumerate() {
                    let d = bins.direction(b);
                    let cos = f64::from(r.normal.dot(d));
                    if cos <= 0.0 {
                        continue;
                    }
                    let hit = tracer.radiance(origin, d, 0.0, f32::INFINITY);
                    let through = cos * f64::from(1.0 - hit.alpha).max(0.0);
                    known += cos * scale * hit.radiance.as_dvec3();
                    let sky = through * scale * bins.radiance(b);
                    if bins.is_unknown(b) {
                        rest += sky
                    } else {
                        known += sky
                    }
                    *gain = through / PI;
                }
                (known, rest, gains)
            })
            .collect();
        let mean = receivers.all.iter().map(|r| r.radiance).sum::<DVec3>() / receivers.len() as f64;
        let scales =
            receivers.all.iter().map(|r| r.radiance.max(0.25 * mean).max(DVec3::splat(1e-6))).collect();
        let sources = (0..bins.len())
            .filter(|&b| bins.is_unknown(b))
            .map(|b| Source {
                direction: bins.direction(b),
                irradiance: DVec3::ZERO,
                gain: rows.iter().map(|r| r.2[b]).collect(),
                near: Vec::new(),
                near_scale: DVec3::ONE,
            })
            .collect();
        let mut testimony = Self {
            receivers,
            prior: 0.0,
            known: rows.iter().map(|r| r.0).collect(),
            rest: rows.iter().map(|r| r.1).collect(),
            scales,
        };
        testimony.prior = testimony.loss(&testimony.light(DVec3::ONE, &[]), 0..3, false);
        (testimony, sources)
    }

    /// A source in a direction that is no bin's.
    pub(super) fn source(&self, tracer: &Tracer, direction: Vec3) -> Source {
        let gain = self
            .receivers
            .all
            .par_iter()
            .map(|r| {
                let cos = f64::from(r.normal.dot(direction));
                if cos <= 0.0 {
                    return 0.0;
                }
                let origin = r.position + r.normal * self.receivers.offset;
                cos * f64::from(tracer.transmittance(origin, direction, 0.0, f32::INFINITY)) / PI
            })
            .collect();
        Source { direction, irradiance: DVec3::ZERO, gain, near: Vec::new(), near_scale: DVec3::ONE }
    }

    /// Gives a source what the completion has around it.
    ///
    /// * `candidates`: the sources of all unknown bins
    pub(super) fn surround(&self, source: &mut Source, candidates: &[Source], bins: &Bins) {
        source.near = vec![DVec3::ZERO; self.known.len()];
        for other in candidates {
            if other.direction.angle_between(source.direction) < NEAR_DEG.to_radians() {
                let radiance = bins.radiance_at(other.direction) * bins.solid_angle();
                for (near, g) in source.near.iter_mut().zip(&other.gain) {
                    *near += radiance * *g;
                }
            }
        }
    }

    /// What reaches the points under some sources.
    pub(super) fn light(&self, scale: DVec3, sources: &[Source]) -> Vec<DVec3> {
        let mut light: Vec<DVec3> = self.known.iter().zip(&self.rest).map(|(k, r)| *k + scale * *r).collect();
        for source in sources {
            for (l, g) in light.iter_mut().zip(&source.gain) {
                *l += source.irradiance * *g;
            }
            for (l, near) in light.iter_mut().zip(&source.near) {
                *l += scale * (source.near_scale - DVec3::ONE) * *near;
            }
        }
        light
    }

    /// The mean over all points of what reaches them, π-fold.
    pub(super) fn mean_irradiance(&self, light: &[DVec3]) -> DVec3 {
        light.iter().sum::<DVec3>() * PI / light.len().max(1) as f64
    }

    /// Mean Huber loss of relative errors with each cluster's albedo at its best, over the points that judge or over the
    /// others. Albedos always come from the others.
    pub(super) fn loss(&self, light: &[DVec3], channels: std::ops::Range<usize>, judges: bool) -> f64 {
        let all = &self.receivers.all;
        let (mut sum, mut n, mut plausible) = (0.0, 0.0, 0.0);
        let count = channels.len() as f64;
        for c in channels {
            let mut albedo = vec![0.3; self.receivers.clusters];
            for round in 0..REWEIGHTED {
                let mut sums = vec![(0.0, 0.0); albedo.len()];
                for (i, r) in all.iter().enumerate().filter(|(_, r)| !r.judge) {
                    let (l, s) = (light[i][c], self.scales[i][c]);
                    let off = self.off(i, albedo[r.cluster] * l, c);
                    if r.clipped && off == 0.0 && round > 0 {
                        continue;
                    }
                    let weight = if round == 0 { 1.0 } else { HUBER / off.max(HUBER) } / (s * s);
                    sums[r.cluster].0 += weight * l * r.radiance[c];
                    sums[r.cluster].1 += weight * l * l;
                }
                for (a, (xy, xx)) in albedo.iter_mut().zip(&sums) {
                    if *xx > 0.0 {
                        *a = (xy / xx).clamp(ALBEDO.0, ALBEDO.1);
                    }
                }
            }
            // How dark or bright the paint is cannot be told from uniform light; implausible paint costs a little.
            let paint = albedo.iter().map(|a| (a / PLAIN).ln().powi(2)).sum::<f64>() / albedo.len() as f64;
            plausible += self.prior * PAINT_PRIOR * if judges { 0.0 } else { paint };
            for (i, r) in all.iter().enumerate().filter(|(_, r)| r.judge == judges) {
                let off = self.off(i, albedo[r.cluster] * light[i][c], c);
                sum += if off <= HUBER { off * off } else { HUBER * (2.0 * off - HUBER) };
                n += 1.0;
            }
        }
        if n > 0.0 { sum / n + plausible / count } else { 0.0 }
    }

    /// Relative error of a prediction; brighter than a clipped point is no error.
    fn off(&self, i: usize, predicted: f64, c: usize) -> f64 {
        let r = &self.receivers.all[i];
        let off = (predicted - r.radiance[c]) / self.scales[i][c];
        if r.clipped { (-off).max(0.0) } else { off.abs() }
    }

    /// The best irradiance of one more source, of the given colour, and the loss with it.
    pub(super) fn best_irradiance(&self, light: &[DVec3], source: &Source, color: DVec3) -> (f64, f64) {
        let mean = self.mean_irradiance(light).element_sum() / 3.0;
        let with = |e: f64| -> f64 {
            let light: Vec<DVec3> =
                light.iter().zip(&source.gain).map(|(l, g)| *l + color * (e * g)).collect();
            // One channel stands for all while directions are compared.
            self.loss(&light, 1..2, false)
        };
        let mut best = (0.0, self.loss(light, 1..2, false));
        for k in 0..TRIED {
            let e = WEAKEST * mean * STEP.powi(k);
            let loss = with(e);
            if loss < best.1 {
                best = (e, loss);
            }
        }
        best
    }

    /// Scale of the rest and irradiances of the sources, channel by channel: coordinate search from where they are.
    pub(super) fn polish(&self, scale: &mut DVec3, sources: &mut [Source]) {
        for c in 0..3 {
            let mut step = 0.5;
            while step > 0.01 {
                let mut moved = false;
                for k in 0..=2 * sources.len() {
                    for factor in [1.0 + step, 1.0 / (1.0 + step)] {
                        let now = self.cost(*scale, sources, c);
                        let value = knob(scale, sources, k, c);
                        let keep = *value;
                        *value = (keep * factor).max(1e-3);
                        if self.cost(*scale, sources, c) < now * (1.0 - 1e-6) {
                            moved = true;
                        } else {
                            *knob(scale, sources, k, c) = keep;
                        }
                    }
                }
                if !moved {
                    step *= 0.5;
                }
            }
        }
    }

    fn cost(&self, scale: DVec3, sources: &[Source], c: usize) -> f64 {
        let mut prior = self.prior * SCALE_PRIOR * scale[c].max(1e-6).ln().powi(2);
        for source in sources {
            prior += self.prior * NEAR_PRIOR * source.near_scale[c].max(1e-6).ln().powi(2);
        }
        self.loss(&self.light(scale, sources), c..c + 1, false) + prior
    }
}

/// The scale, then each source's irradiance and the scale of what surrounds it.
fn knob<'v>(scale: &'v mut DVec3, sources: &'v mut [Source], k: usize, c: usize) -> &'v mut f64 {
    match k {
        0 => &mut scale[c],
        _ if k % 2 == 1 => &mut sources[(k - 1) / 2].irradiance[c],
        _ => &mut sources[(k - 1) / 2].near_scale[c],
    }
}
