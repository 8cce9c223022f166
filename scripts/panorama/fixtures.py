"""Steps of the schedulers of `diffusers`, for the test that compares ours with them step by step.

    python fixtures.py ../../crates/comgs-panorama/tests/data/schedulers.json
"""

import json
import sys

import torch
from diffusers import DDIMScheduler, DPMSolverMultistepScheduler


def walk(scheduler, steps):
    """A made-up network: its output is a fixed function of sample and step."""
    scheduler.set_timesteps(steps)
    x = torch.tensor([0.3, -1.1, 0.8, 1.7], dtype=torch.float64)
    samples, times = [x.tolist()], []
    for i, t in enumerate(scheduler.timesteps):
        times.append(int(t))
        output = torch.sin(x * 1.3 + i) * 0.7
        x = scheduler.step(output, t, x).prev_sample
        samples.append(x.tolist())
    return {"times": times, "samples": samples}


def main():
    cases = []
    for beta in ("linear", "scaled_linear"):
        for prediction in ("epsilon", "v_prediction", "sample"):
            for spacing in ("leading", "trailing", "linspace"):
                for zero in (False, True):
                    if zero and prediction == "epsilon":
                        continue
                    common = dict(num_train_timesteps=1000, beta_start=0.00085, beta_end=0.012, beta_schedule=beta,
                                  prediction_type=prediction, timestep_spacing=spacing, rescale_betas_zero_snr=zero)
                    # The DDIM of diffusers steps by T / n whatever steps it visits: with linspace, or where n does not divide
                    # T, it goes to a step beside the next visited one. Ours goes to the next visited one.
                    ddim = DDIMScheduler(**common, clip_sample=False, set_alpha_to_one=True, steps_offset=1)
                    if spacing != "linspace":
                        cases.append({"solver": "ddim", "betas": beta, "prediction": prediction, "spacing": spacing,
                                      "zero_terminal_snr": zero, "steps_offset": 1, **walk(ddim, 8)})
                    if zero:
                        # diffusers replaces a terminal signal of 0 by 2^-24 in this solver; ours keeps 0.
                        continue
                    dpm = DPMSolverMultistepScheduler(**common, algorithm_type="dpmsolver++", solver_order=2,
                                                      final_sigmas_type="zero", steps_offset=1)
                    cases.append({"solver": "dpm_solver_multistep", "betas": beta, "prediction": prediction,
                                  "spacing": spacing, "zero_terminal_snr": zero, "steps_offset": 1, **walk(dpm, 8)})
    with open(sys.argv[1], "w") as f:
        json.dump(cases, f)
        f.write("\n")
    print(len(cases), "cases")


if __name__ == "__main__":
    main()
