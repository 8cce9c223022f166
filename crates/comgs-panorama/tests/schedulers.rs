//! Our samplers against those of the Python library `diffusers`, step by step. The values were made by
//! `scripts/panorama/fixtures.py`; its made-up network is `0.7 sin(1.3 x + i)`.

use comgs_panorama::schedule::{Betas, Prediction, Sampler, Schedule, Solver, Spacing};
use serde::Deserialize;

#[derive(Deserialize)]
struct Case {
    solver: String,
    betas: String,
    prediction: String,
    spacing: String,
    zero_terminal_snr: bool,
    steps_offset: usize,
    times: Vec<usize>,
    samples: Vec<Vec<f64>>,
}

/// `diffusers` keeps its tables in single precision.
const TOLERANCE: f64 = 2e-4;

/// Goal: the same steps are visited, and every sample on the way is the same.
#[test]
fn every_step_is_that_of_diffusers() {
    let cases: Vec<Case> = serde_json::from_str(include_str!("data/schedulers.json")).unwrap();
    assert!(cases.len() >= 30);
    for (number, case) in cases.iter().enumerate() {
        let (start, end) = (0.00085, 0.012);
        let schedule = Schedule {
            timesteps: 1000,
            betas: match case.betas.as_str() {
                "linear" => Betas::Linear { start, end },
                _ => Betas::ScaledLinear { start, end },
            },
            prediction: match case.prediction.as_str() {
                "epsilon" => Prediction::Epsilon,
                "v_prediction" => Prediction::V,
                _ => Prediction::X0,
            },
            spacing: match case.spacing.as_str() {
                "leading" => Spacing::Leading,
                "trailing" => Spacing::Trailing,
                _ => Spacing::Linspace,
            },
            zero_terminal_snr: case.zero_terminal_snr,
            steps_offset: case.steps_offset,
            final_alpha_one: true,
        };
        let solver = if case.solver == "ddim" { Solver::Ddim } else { Solver::DpmSolverMultistep };
        let about = format!("case {number}: {solver:?} {schedule:?}");
        let mut sampler = Sampler::new(&schedule, solver, case.times.len());
        assert_eq!(sampler.steps(), case.times, "{about}");
        let mut x = case.samples[0].clone();
        for i in 0..case.times.len() {
            let output: Vec<f64> = x.iter().map(|v| 0.7 * (1.3 * v + i as f64).sin()).collect();
            x = sampler.step(i, &x, &output);
            for (a, b) in x.iter().zip(&case.samples[i + 1]) {
                assert!(
                    (a - b).abs() < TOLERANCE * b.abs().max(1.0),
                    "{about}: step {i}: {a} instead of {b}"
                );
            }
        }
    }
}
