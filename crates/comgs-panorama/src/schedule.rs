//! Diffusion schedules and their samplers, in f64.
//!
//! A model's manifest says how noise was added in training ([`Schedule`]); [`Sampler`] walks it backwards with DDIM (Song
//! et al. 2021) or the second-order multistep DPM-Solver++(2M) (Lu et al. 2022). Each is checked step by step against
//! values of the Python library `diffusers` (`tests/schedulers.rs`, made by `scripts/panorama/fixtures.py`).

use serde::{Deserialize, Serialize};

/// How betas run over the training steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Betas {
    /// Linear from `start` to `end`.
    Linear {
        /// First.
        start: f64,
        /// Last.
        end: f64,
    },
    /// The square of what runs linearly between the square roots (Stable Diffusion).
    ScaledLinear {
        /// First.
        start: f64,
        /// Last.
        end: f64,
    },
    /// ᾱ is a squared cosine (Nichol & Dhariwal 2021), `cos²(π/2 · (t/T + s)/(1 + s))` over its value at 0, s = 0.008.
    SquaredCosine,
}

/// What the network's output is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Prediction {
    /// The noise.
    Epsilon,
    /// `√ᾱ ε − √(1−ᾱ) x₀` (Salimans & Ho 2022).
    V,
    /// The clean sample.
    X0,
}

/// Which training steps the sampler visits (Lin et al. 2024, table 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spacing {
    /// Multiples of T/n; the last step is never visited.
    Leading,
    /// Evenly from the last step down; the last step is visited.
    Trailing,
    /// Evenly from the first to the last, both visited.
    Linspace,
}

/// The way back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Solver {
    /// Deterministic DDIM (η = 0).
    #[default]
    Ddim,
    /// DPM-Solver++(2M): second order from the second step on, first order at the last.
    DpmSolverMultistep,
}

/// How noise was added in training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Number of training steps T.
    pub timesteps: usize,
    /// Their betas.
    pub betas: Betas,
    /// What the network's output is.
    pub prediction: Prediction,
    /// Which steps are visited.
    pub spacing: Spacing,
    /// Whether ᾱ was rescaled so that nothing of the sample is left at the last step (Lin et al. 2024, algorithm 1).
    #[serde(default)]
    pub zero_terminal_snr: bool,
    /// Added to leading steps.
    #[serde(default)]
    pub steps_offset: usize,
    /// Whether the step after the last visited one is ᾱ = 1 (true) or ᾱ of the first training step (false).
    #[serde(default)]
    pub final_alpha_one: bool,
}

impl Schedule {
    /// Problems of values read from a file.
    pub(crate) fn problems(&self, out: &mut Vec<String>) {
        if !(1..=100_000).contains(&self.timesteps) {
            out.push(format!("schedule.timesteps: expected 1 to 100000, got {}", self.timesteps));
        }
        if let Betas::Linear { start, end } | Betas::ScaledLinear { start, end } = self.betas
            && !(0.0 < start && start <= end && end < 1.0)
        {
            out.push(format!("schedule.betas: expected 0 < start ≤ end < 1, got {start} and {end}"));
        }
    }

    /// ᾱ of every training step, falling.
    #[must_use]
    pub fn alphas_bar(&self) -> Vec<f64> {
        let n = self.timesteps;
        let along = |i: usize, a: f64, b: f64| {
            if n > 1 { a + (b - a) * i as f64 / (n - 1) as f64 } else { a }
        };
        let mut bar: Vec<f64> = match self.betas {
            Betas::SquaredCosine => {
                let f = |t: f64| (std::f64::consts::FRAC_PI_2 * (t + 0.008) / 1.008).cos().powi(2);
                (1..=n).map(|i| f(i as f64 / n as f64) / f(0.0)).collect()
            }
            Betas::Linear { start, end } => running_product((0..n).map(|i| 1.0 - along(i, start, end))),
            Betas::ScaledLinear { start, end } => {
                running_product((0..n).map(|i| 1.0 - along(i, start.sqrt(), end.sqrt()).powi(2)))
            }
        };
        if self.zero_terminal_snr && n > 1 {
            // √ᾱ is shifted so that the last is 0 and scaled so that the first stays.
            let (first, last) = (bar[0].sqrt(), bar[n - 1].sqrt());
            for b in &mut bar {
                *b = ((b.sqrt() - last) * first / (first - last)).powi(2);
            }
        }
        bar
    }

    /// The training steps that a sampler of `n` steps visits, from the noisiest on. `n` is cut to 1 … T.
    ///
    /// The multistep solver leaves out the lowest step of leading and linspace and spreads the others wider, as `diffusers`
    /// does: its last step ends at the sample, so it would stand still on the way from there.
    #[must_use]
    pub fn visited(&self, solver: Solver, n: usize) -> Vec<usize> {
        let total = self.timesteps;
        let n = n.clamp(1, total);
        let skipped = usize::from(solver == Solver::DpmSolverMultistep);
        let mut steps: Vec<usize> = match self.spacing {
            Spacing::Leading => (skipped..n + skipped)
                .rev()
                .map(|i| (i * (total / (n + skipped)) + self.steps_offset).min(total - 1))
                .collect(),
            Spacing::Trailing => {
                let ratio = total as f64 / n as f64;
                (0..n).map(|i| ((total as f64 - i as f64 * ratio).round() as usize).max(1) - 1).collect()
            }
            Spacing::Linspace => {
                let intervals = (n + skipped - 1).max(1) as f64;
                let at = |i: usize| (i as f64 * (total - 1) as f64 / intervals).round() as usize;
                (skipped..n + skipped).rev().map(at).collect()
            }
        };
        steps.dedup();
        steps
    }
}

fn running_product(factors: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut product = 1.0;
    factors
        .map(|f| {
            product *= f;
            product
        })
        .collect()
}

/// Walks from noise to a sample.
#[derive(Clone, Debug)]
pub struct Sampler {
    schedule: Schedule,
    solver: Solver,
    bar: Vec<f64>,
    steps: Vec<usize>,
    /// x₀ of the step before, and its λ.
    before: Option<(Vec<f64>, f64)>,
}

/// ᾱ is kept this far from 0 where a ratio to it is needed.
const LEAST: f64 = 1e-12;

impl Sampler {
    /// A sampler of `n` steps.
    #[must_use]
    pub fn new(schedule: &Schedule, solver: Solver, n: usize) -> Self {
        let (bar, steps) = (schedule.alphas_bar(), schedule.visited(solver, n));
        Self { schedule: *schedule, solver, bar, steps, before: None }
    }

    /// The training steps it visits, in order.
    #[must_use]
    pub fn steps(&self) -> &[usize] {
        &self.steps
    }

    /// ᾱ of visited step `i`; for the number of steps, what follows the last.
    #[must_use]
    pub fn signal(&self, i: usize) -> f64 {
        match self.steps.get(i) {
            Some(&t) => self.bar[t],
            None if self.schedule.final_alpha_one => 1.0,
            None => self.bar[0],
        }
    }

    /// The clean sample and the noise that an output of the network at visited step `i` stands for.
    #[must_use]
    pub fn split(&self, i: usize, sample: &[f64], output: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let bar = self.signal(i);
        let (a, s) = (bar.sqrt(), (1.0 - bar).sqrt());
        let pair = |(&x, &o): (&f64, &f64)| match self.schedule.prediction {
            Prediction::Epsilon => ((x - s * o) / a.max(LEAST), o),
            Prediction::V => (a * x - s * o, a * o + s * x),
            Prediction::X0 => (o, if s > 0.0 { (x - a * o) / s } else { 0.0 }),
        };
        sample.iter().zip(output).map(pair).unzip()
    }

    /// One step: from `sample` at visited step `i` and the network's output there to the sample at the next.
    #[must_use]
    pub fn step(&mut self, i: usize, sample: &[f64], output: &[f64]) -> Vec<f64> {
        let (clean, noise) = self.split(i, sample, output);
        let (now, next) = (self.signal(i), self.signal(i + 1));
        let (a_next, s_next) = (next.sqrt(), (1.0 - next).sqrt());
        if self.solver == Solver::Ddim {
            return clean.iter().zip(&noise).map(|(c, n)| a_next * c + s_next * n).collect();
        }
        let s = (1.0 - now).sqrt();
        let lambda = |bar: f64| 0.5 * (bar.max(LEAST * LEAST) / (1.0 - bar).max(LEAST * LEAST)).ln();
        let (l_now, l_next) = (lambda(now), lambda(next));
        let h = l_next - l_now;
        let last = i + 1 >= self.steps.len();
        // At the end the step is infinite in λ: the first-order formula has the limit a x₀.
        let decay = if s_next > 0.0 { s_next / s } else { 0.0 };
        let gain = if last && s_next == 0.0 { a_next } else { a_next * -(-h).exp_m1() };
        let direction: Vec<f64> = match &self.before {
            Some((before, l_before)) if !last => {
                let r = (l_now - l_before) / h;
                clean.iter().zip(before).map(|(c, b)| c + (c - b) / (2.0 * r)).collect()
            }
            _ => clean.clone(),
        };
        self.before = Some((clean, l_now));
        sample.iter().zip(&direction).map(|(x, d)| decay * x + gain * d).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STABLE_DIFFUSION: Schedule = Schedule {
        timesteps: 1000,
        betas: Betas::ScaledLinear { start: 0.00085, end: 0.012 },
        prediction: Prediction::V,
        spacing: Spacing::Trailing,
        zero_terminal_snr: true,
        steps_offset: 0,
        final_alpha_one: true,
    };

    /// Goal: with the true answer as the network's output every solver, prediction and spacing ends at that answer.
    #[test]
    fn an_oracle_leads_to_the_sample() {
        let truth = [0.3, -1.2, 2.0];
        let noise = [0.7, 0.1, -0.4];
        for prediction in [Prediction::Epsilon, Prediction::V, Prediction::X0] {
            for spacing in [Spacing::Leading, Spacing::Trailing, Spacing::Linspace] {
                for solver in [Solver::Ddim, Solver::DpmSolverMultistep] {
                    // ε says nothing where no signal is left.
                    let zero_terminal_snr = prediction != Prediction::Epsilon;
                    let schedule = Schedule { prediction, spacing, zero_terminal_snr, ..STABLE_DIFFUSION };
                    let mut sampler = Sampler::new(&schedule, solver, 12);
                    let at = |bar: f64| -> Vec<f64> {
                        (0..3).map(|k| bar.sqrt() * truth[k] + (1.0 - bar).sqrt() * noise[k]).collect()
                    };
                    let mut x = at(sampler.signal(0));
                    for i in 0..sampler.steps().len() {
                        let (a, s) = (sampler.signal(i).sqrt(), (1.0 - sampler.signal(i)).sqrt());
                        let output: Vec<f64> = (0..3)
                            .map(|k| match prediction {
                                Prediction::Epsilon => noise[k],
                                Prediction::V => a * noise[k] - s * truth[k],
                                Prediction::X0 => truth[k],
                            })
                            .collect();
                        x = sampler.step(i, &x, &output);
                        let expected = at(sampler.signal(i + 1));
                        for k in 0..3 {
                            let off = (x[k] - expected[k]).abs();
                            assert!(
                                off < 1e-9,
                                "{prediction:?} {spacing:?} {solver:?} step {i}: off by {off}"
                            );
                        }
                    }
                    assert!((x[1] - truth[1]).abs() < 1e-9);
                }
            }
        }
    }

    /// Goal: trailing visits the last step, leading never, linspace both ends; one step is allowed; zero terminal SNR is 0.
    #[test]
    fn spacings() {
        let with = |spacing| Schedule { spacing, ..STABLE_DIFFUSION };
        assert_eq!(with(Spacing::Trailing).visited(Solver::Ddim, 4), [999, 749, 499, 249]);
        assert_eq!(with(Spacing::Leading).visited(Solver::Ddim, 4), [750, 500, 250, 0]);
        assert_eq!(with(Spacing::Linspace).visited(Solver::Ddim, 4), [999, 666, 333, 0]);
        assert_eq!(with(Spacing::Trailing).visited(Solver::Ddim, 1), [999]);
        assert!(STABLE_DIFFUSION.alphas_bar()[999].abs() < 1e-15);
        assert!(STABLE_DIFFUSION.alphas_bar().windows(2).all(|w| w[0] > w[1]));
    }
}
