"""Trains the panorama completer. See README.md for the commands of the shipped file."""

import argparse
import json
import math
import time

import numpy as np
import torch

from data import Library
from losses import Losses, total
from model import CONDITION, HEIGHT, WIDTH, Completer, alphas_bar, decode, encode, pull_push


def batch_of(samples, direction, dual, normals):
    stack = lambda k: torch.from_numpy(np.stack([s[k] for s in samples]))
    batch = {k: stack(k) for k in ("truth", "partial", "normal")}
    batch["known"] = stack("known")[:, None]
    batch["clipped"] = stack("clipped")[:, None]
    n = len(samples)
    given = (batch["known"] | batch["clipped"]).float()
    condition = torch.cat(
        [
            encode(batch["partial"]) * given,
            batch["known"].float(),
            batch["clipped"].float(),
            batch["normal"] if normals else torch.zeros_like(batch["normal"]),
            direction.expand(n, -1, -1, -1),
        ],
        1,
    )
    assert condition.shape[1] == len(CONDITION)
    batch["target"] = encode(batch["truth"], dual)
    return batch, condition


def simple_fill(batch):
    """The pull-push fill: what the network starts from, as a baseline."""
    log = torch.log(batch["partial"].clamp(min=0) + 0.01)
    known = (batch["known"] | batch["clipped"]).float()
    return torch.exp(pull_push(log, known)) - 0.01


def main():
    p = argparse.ArgumentParser()
    p.add_argument("--hdri", required=True)
    p.add_argument("--synthetic", required=True)
    p.add_argument("-o", "--output", required=True)
    p.add_argument("--steps", type=int, default=4000)
    p.add_argument("--minutes", type=float, default=1e9, help="stop, with the rates' decay finished, after this time")
    p.add_argument("--batch", type=int, default=16)
    p.add_argument("--rate", type=float, default=2e-3)
    p.add_argument("--hdri-share", type=float, default=0.3, help="share of examples from photographs")
    p.add_argument("--blended", type=float, default=0.5, help="share of the photographs that are mixed with another one")
    p.add_argument("--regression-share", type=float, default=0.65, help="share of examples at the last time step")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--limit", type=int, help="use that many synthetic panoramas")
    p.add_argument("--no-normals", action="store_true")
    p.add_argument("--no-dual", action="store_true")
    a = p.parse_args()
    torch.set_num_threads(a.threads)
    torch.manual_seed(a.seed)
    rng = np.random.default_rng(a.seed)
    library = Library(a.hdri, a.synthetic, a.limit, a.blended)
    dual, normals = not a.no_dual, not a.no_normals
    model = Completer(dual=dual)
    ema = {k: v.clone() for k, v in model.state_dict().items()}
    losses = Losses(dual)
    bar = alphas_bar()
    direction = torch.from_numpy(library.direction)[None]
    print(json.dumps({"parameters": sum(p.numel() for p in model.parameters()), "maps": len(library.maps),
                      "panoramas": len(library.synthetic), **vars(a)}), flush=True)
    optimiser = torch.optim.AdamW(model.parameters(), lr=a.rate, betas=(0.9, 0.98), weight_decay=1e-3)
    check_rng = np.random.default_rng(12345)
    checks = [batch_of([library.sample(check_rng, 0.5, True) for _ in range(24)], direction, dual, normals) for _ in range(3)]

    def validate(state):
        keep = {k: v.clone() for k, v in model.state_dict().items()}
        model.load_state_dict(state)
        model.eval()
        sums = {}
        with torch.no_grad():
            for batch, condition in checks:
                n = condition.shape[0]
                code = model(torch.zeros(n, 6, HEIGHT, WIDTH), torch.ones(n), condition)
                for name, c in (("net", code), ("fill", encode(simple_fill(batch), dual))):
                    for k, v in losses(c, batch["target"], batch).items():
                        sums.setdefault(f"{name}_{k}", []).append(v.mean().item())
        model.train()
        model.load_state_dict(keep)
        return {k: round(float(np.mean(v)), 4) for k, v in sums.items()}

    started, running, step, progress = time.time(), [], 0, 0.0
    best = float("inf")
    while progress < 1:
        progress = max(step / a.steps, (time.time() - started) / (60 * a.minutes))
        rate = a.rate * min(1, (step + 1) / 100) * (0.5 + 0.5 * math.cos(math.pi * min(1, progress))) + 1e-5
        for group in optimiser.param_groups:
            group["lr"] = rate
        batch, condition = batch_of(
            [library.sample(rng, a.hdri_share) for _ in range(a.batch)], direction, dual, normals
        )
        n = condition.shape[0]
        last = torch.rand(n) < a.regression_share
        t = torch.where(last, torch.full((n,), len(bar) - 1), torch.randint(0, len(bar) - 1, (n,)))
        signal = bar[t][:, None, None, None]
        noise = torch.randn_like(batch["target"])
        noisy = signal.sqrt() * batch["target"] + (1 - signal).sqrt() * noise
        # At the last step the input tells nothing: zeros, so that one step is the mean and nothing else.
        noisy = torch.where(last[:, None, None, None], torch.zeros_like(noisy), noisy)
        code = model(noisy, (t + 1).float() / len(bar), condition)
        parts = losses(code, batch["target"], batch)
        loss = total(parts).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        with torch.no_grad():
            decay = min(0.998, (step + 1) / (step + 10))
            for k, v in model.state_dict().items():
                ema[k].lerp_(v, 1 - decay)
        running.append([loss.item()] + [parts[k][last].mean().item() if last.any() else 0 for k in parts])
        step += 1
        if step % 50 == 0:
            means = np.mean(running, 0)
            running = []
            line = {"step": step, "minutes": round((time.time() - started) / 60, 2), "rate": round(rate, 6),
                    **dict(zip(["loss", *parts], [round(float(v), 4) for v in means]))}
            if step % 250 == 0:
                library.refresh()
                scores = validate(ema)
                line.update(scores)
                # Twenty maps are learned by heart in the end: the state whose diffuse sphere validates best is kept.
                if scores["net_diffuse"] < best:
                    best = scores["net_diffuse"]
                    torch.save({"model": ema, "dual": dual, "step": step, "arguments": vars(a)}, a.output)
            print(json.dumps(line), flush=True)
    print(json.dumps({"final": validate(ema), "steps": step, "minutes": (time.time() - started) / 60}), flush=True)


if __name__ == "__main__":
    main()
