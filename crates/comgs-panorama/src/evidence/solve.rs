//! Robust non-negative least squares for radiance, alternating with albedo.

use super::Config;
use super::directions::{Bins, Pieces};
use super::receivers::Receivers;
use comgs_trace::Tracer;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// What each point would reflect: `albedo_cluster · (known + Σ_k gains_k e_k)`, all over π.
pub(super) struct Problem {
    /// Irradiance over π from what is known.
    known: Vec<DVec3>,
    /// `cos V Δω / π` for every point (rows) and unknown.
    gains: Vec<Vec<f64>>,
    radiance: Vec<DVec3>,
    cluster: Vec<usize>,
    judge: Vec<bool>,
    clusters: usize,
    prior: f64,
    /// Weight of each unknown's prior: its share of a bin.
    stiffness: Vec<f64>,
}

/// Radiance of the unknowns, and albedo of each cluster.
pub(super) struct Solution {
    pub radiance: Vec<DVec3>,
    pub albedo: Vec<DVec3>,
}

/// Relative residual from which the Huber loss grows linearly.
const HUBER: f64 = 0.08;
/// Alternations between radiance and albedo.
const ROUNDS: usize = 40;
/// Sweeps of coordinate descent in each.
const SWEEPS: usize = 4;
/// Albedos are sought up to this.
const WHITEST: f64 = 0.95;

impl Problem {
    /// Traces every point's view of every bin.
    pub(super) fn trace(
        tracer: &Tracer,
        receivers: &Receivers,
        bins: &Bins,
        unknown: &[usize],
        config: &Config,
    ) -> Self {
        let mut index = vec![usize::MAX; bins.len()];
        for (k, &b) in unknown.iter().enumerate() {
            index[b] = k;
        }
        let scale = bins.solid_angle() / std::f64::consts::PI;
        let rows: Vec<(DVec3, Vec<f64>)> = receivers
            .all
            .par_iter()
            .map(|r| {
                let origin = r.position + r.normal * receivers.offset;
                let (mut known, mut gains) = (DVec3::ZERO, vec![0.0; unknown.len()]);
                for b in 0..bins.len() {
                    let d = bins.direction(b);
                    let cos = f64::from(r.normal.dot(d));
                    if cos <= 0.0 {
                        continue;
                    }
                    let hit = tracer.radiance(origin, d, 0.0, f32::INFINITY);
                    let through = f64::from(1.0 - hit.alpha).max(0.0);
                    known += cos * scale * hit.radiance.as_dvec3();
                    if index[b] == usize::MAX {
                        known += cos * scale * through * bins.radiance(b);
                    } else {
                        gains[index[b]] = cos * scale * through;
                    }
                }
                (known, gains)
            })
            .collect();
        let (known, gains) = rows.into_iter().unzip();
        Self {
            known,
            gains,
            radiance: receivers.all.iter().map(|r| r.radiance).collect(),
            cluster: receivers.all.iter().map(|r| r.cluster).collect(),
            judge: receivers.all.iter().map(|r| r.judge).collect(),
            clusters: receivers.clusters,
            prior: config.prior,
            stiffness: vec![1.0; unknown.len()],
        }
    }

    /// The same with pieces of the unknowns `split` added after the rest.
    pub(super) fn trace_closer(
        tracer: &Tracer,
        receivers: &Receivers,
        coarse: &Self,
        split: &[usize],
        pieces: &Pieces,
        config: &Config,
    ) -> Self {
        let scale = pieces.solid_angle() / std::f64::consts::PI;
        let gains = receivers
            .all
            .par_iter()
            .zip(&coarse.gains)
            .map(|(r, row)| {
                let origin = r.position + r.normal * receivers.offset;
                let mut row = row.clone();
                row.extend((0..pieces.len()).map(|p| {
                    let d: Vec3 = pieces.direction(p);
                    let cos = f64::from(r.normal.dot(d));
                    if cos <= 0.0 {
                        return 0.0;
                    }
                    cos * scale * f64::from(tracer.transmittance(origin, d, 0.0, f32::INFINITY))
                }));
                row
            })
            .collect();
        let mut stiffness = coarse.stiffness.clone();
        for &k in split {
            // What a split bin gained belongs to its pieces now.
            stiffness[k] = 100.0;
        }
        stiffness.extend(std::iter::repeat_n(0.1, pieces.len()));
        Self {
            known: coarse.known.clone(),
            gains,
            radiance: coarse.radiance.clone(),
            cluster: coarse.cluster.clone(),
            judge: coarse.judge.clone(),
            clusters: coarse.clusters,
            prior: config.prior,
            stiffness,
        }
    }

    fn light(&self, i: usize, radiance: &[DVec3]) -> DVec3 {
        self.known[i] + self.gains[i].iter().zip(radiance).map(|(g, e)| *g * *e).sum::<DVec3>()
    }

    /// Albedo of each cluster under a given light: the weighted median of what points reflect over what reaches them.
    pub(super) fn fit_albedo(&self, radiance: &[DVec3]) -> Vec<DVec3> {
        let lights: Vec<DVec3> = (0..self.known.len()).map(|i| self.light(i, radiance)).collect();
        (0..self.clusters)
            .map(|cluster| {
                let mut albedo = DVec3::splat(0.3);
                for c in 0..3 {
                    let mut ratios: Vec<f64> = (0..lights.len())
                        .filter(|&i| self.cluster[i] == cluster && !self.judge[i] && lights[i][c] > 1e-9)
                        .map(|i| self.radiance[i][c] / lights[i][c])
                        .collect();
                    ratios.sort_by(f64::total_cmp);
                    if let Some(median) = ratios.get(ratios.len() / 2) {
                        albedo[c] = median.min(WHITEST);
                    }
                }
                albedo
            })
            .collect()
    }

    /// Mean Huber loss of the judging points' relative errors, as a root.
    pub(super) fn residual(&self, albedo: &[DVec3], radiance: &[DVec3]) -> f64 {
        let (mut sum, mut n) = (0.0, 0.0);
        for i in (0..self.known.len()).filter(|&i| self.judge[i]) {
            let predicted = albedo[self.cluster[i]] * self.light(i, radiance);
            for c in 0..3 {
                let off = (predicted[c] - self.radiance[i][c]).abs() / self.scale(i)[c];
                sum += if off <= HUBER { off * off } else { HUBER * (2.0 * off - HUBER) };
                n += 1.0;
            }
        }
        if n > 0.0 { f64::sqrt(sum / n) } else { 0.0 }
    }

    /// What an error is measured against: the point's own radiance, but not less than a tenth of the mean.
    fn scale(&self, i: usize) -> DVec3 {
        let mean = self.radiance.iter().sum::<DVec3>() / self.radiance.len() as f64;
        self.radiance[i].max(0.1 * mean).max(DVec3::splat(1e-6))
    }

    /// Radiance and albedo, from a prior.
    pub(super) fn solve(&self, prior: &[DVec3]) -> Solution {
        let channels: Vec<(Vec<f64>, Vec<f64>)> = (0..3)
            .into_par_iter()
            .map(|c| {
                let prior: Vec<f64> = prior.iter().map(|v| v[c]).collect();
                self.solve_channel(c, &prior)
            })
            .collect();
        let gather = |k: usize, of: fn(&(Vec<f64>, Vec<f64>)) -> &Vec<f64>| {
            DVec3::new(of(&channels[0])[k], of(&channels[1])[k], of(&channels[2])[k])
        };
        Solution {
            radiance: (0..prior.len()).map(|k| gather(k, |c| &c.0)).collect(),
            albedo: (0..self.clusters).map(|k| gather(k, |c| &c.1)).collect(),
        }
    }

    fn solve_channel(&self, c: usize, prior: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let points: Vec<usize> = (0..self.known.len()).filter(|&i| !self.judge[i]).collect();
        let all: Vec<DVec3> = prior.iter().map(|v| DVec3::splat(*v)).collect();
        let mut albedo: Vec<f64> = self.fit_albedo(&all).iter().map(|a| a[c]).collect();
        let mut e = prior.to_vec();
        let scales: Vec<f64> = points.iter().map(|&i| self.scale(i)[c]).collect();
        let mut light: Vec<f64> = points
            .iter()
            .map(|&i| self.known[i][c] + self.gains[i].iter().zip(&e).map(|(g, e)| g * e).sum::<f64>())
            .collect();
        // A bin's prior is as wide as the mean radiance reflected, so that dark and bright scenes are alike.
        let width = {
            let mean = self.radiance.iter().map(|r| r[c]).sum::<f64>() / self.radiance.len() as f64;
            prior.iter().map(|m| m.max(mean) * 3.0).collect::<Vec<f64>>()
        };
        for _ in 0..ROUNDS {
            let weights: Vec<f64> = points
                .iter()
                .enumerate()
                .map(|(row, &i)| {
                    let off =
                        (albedo[self.cluster[i]] * light[row] - self.radiance[i][c]).abs() / scales[row];
                    (HUBER / off.max(HUBER)) / scales[row].powi(2)
                })
                .collect();
            for _ in 0..SWEEPS {
                for k in 0..e.len() {
                    let stiff = self.prior * self.stiffness[k] * HUBER / width[k].powi(2);
                    let (mut slope, mut curve) = (stiff * (e[k] - prior[k]), stiff);
                    for (row, &i) in points.iter().enumerate() {
                        let g = self.gains[i][k];
                        if g > 0.0 {
                            let a = albedo[self.cluster[i]] * g;
                            slope += weights[row]
                                * a
                                * (albedo[self.cluster[i]] * light[row] - self.radiance[i][c]);
                            curve += weights[row] * a * a;
                        }
                    }
                    let next = (e[k] - slope / curve).max(0.0);
                    let change = next - e[k];
                    if change != 0.0 {
                        e[k] = next;
                        for (row, &i) in points.iter().enumerate() {
                            light[row] += self.gains[i][k] * change;
                        }
                    }
                }
            }
            // Albedo by weighted least squares, held towards what a plain surface has when nothing says otherwise.
            let mut sums = vec![(0.0, 0.0); self.clusters];
            for (row, &i) in points.iter().enumerate() {
                let s = &mut sums[self.cluster[i]];
                s.0 += weights[row] * light[row] * self.radiance[i][c];
                s.1 += weights[row] * light[row] * light[row];
            }
            for (a, (xy, xx)) in albedo.iter_mut().zip(&sums) {
                if *xx > 0.0 {
                    *a = (xy / xx).clamp(0.01, WHITEST);
                }
            }
        }
        (e, albedo)
    }
}
