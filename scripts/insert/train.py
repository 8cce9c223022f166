"""Trains the small guidance network on insertions under right and wrong light (guidance_data)."""

import argparse
import glob
import os
import time

import numpy as np
import torch

import model as m


def read(folder, first=0, last=10**9):
    """(places, planes of their own, lights, 9 planes) as bytes."""
    names = sorted(n for n in glob.glob(os.path.join(folder, "*.bin")) if first <= int(os.path.basename(n)[:5]) < last)
    all_ = np.stack([np.fromfile(n, np.uint8).reshape(-1, m.SIZE, m.SIZE) for n in names])
    return torch.from_numpy(all_[:, :4]), torch.from_numpy(all_[:, 4:].reshape(len(names), -1, 9, m.SIZE, m.SIZE))


def batch(data, n, rng):
    """Condition, insertion under the right light and flag-dependent target insertion."""
    own, pictures = data
    place = torch.from_numpy(rng.integers(0, len(own), n))
    light = torch.from_numpy(rng.integers(0, pictures.shape[1], n))
    p = pictures[place, light].float() / 127.5 - 1
    mask, normal = own[place, :1].float() / 255, (own[place, 1:].float() - 128) / 127
    flag = torch.from_numpy((rng.random((n, 1)) < 0.5).astype(np.float32))
    # Without the flag half of the insertions are lit wrongly.
    right = (flag > 0) | torch.from_numpy(rng.random((n, 1)) < 0.5)
    x = torch.where(right[..., None, None], p[:, 3:6], p[:, 6:9])
    return torch.cat([p[:, :3], mask, normal * (mask > 0)], 1), x, flag


def noised(x, t, bar, noise):
    a = bar[t][:, None, None, None]
    return a.sqrt() * x + (1 - a).sqrt() * noise


def main():
    p = argparse.ArgumentParser()
    p.add_argument("data")
    p.add_argument("-o", "--output", required=True)
    p.add_argument("--minutes", type=float, default=12)
    p.add_argument("--batch", type=int, default=16)
    p.add_argument("--rate", type=float, default=1.5e-3)
    p.add_argument("--threads", type=int, default=1)
    p.add_argument("--held-out", type=int, default=24, help="places that training does not see: the last ones")
    p.add_argument("--resume", help="weights to go on from")
    p.add_argument("--seed", type=int, default=0)
    a = p.parse_args()
    torch.set_num_threads(a.threads)
    torch.manual_seed(a.seed)
    rng = np.random.default_rng(a.seed)
    own, pictures = read(a.data)
    train, held = (own[: -a.held_out], pictures[: -a.held_out]), (own[-a.held_out :], pictures[-a.held_out :])
    net, bar = m.Guide(), m.alphas_bar()
    if a.resume:
        net.load_state_dict(torch.load(a.resume, weights_only=True)["model"])
    print(sum(w.numel() for w in net.parameters()), "parameters,", len(train[0]), "places", flush=True)
    optimiser = torch.optim.AdamW(net.parameters(), a.rate, weight_decay=1e-3)
    strongest = int(m.STRONGEST * m.TIMESTEPS)
    started, step, running = time.time(), 0, None

    def loss_of(data, n, rng, generator=None):
        condition, x, flag = batch(data, n, rng)
        t = torch.from_numpy(rng.integers(0, strongest, n))
        noisy = noised(x, t, bar, torch.randn(x.shape, generator=generator))
        out = net(noisy, t.float() / m.TIMESTEPS, condition, flag)
        # What differs from the photo is where there is something to learn.
        weight = 0.2 + (x - condition[:, :3]).abs().amax(1, keepdim=True).clamp(max=0.4) / 0.1
        return (weight * (out - x).abs()).mean()

    while (gone := (time.time() - started) / 60 / a.minutes) < 1:
        for g in optimiser.param_groups:
            g["lr"] = a.rate * min(1, step / 100) * (0.02 + 0.98 * 0.5 * (1 + np.cos(np.pi * gone)))
        loss = loss_of(train, a.batch, rng)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        running = loss.item() if running is None else 0.98 * running + 0.02 * loss.item()
        if step % 200 == 0:
            net.eval()
            with torch.no_grad():
                g = torch.Generator().manual_seed(1)
                check = np.mean([loss_of(held, 32, np.random.default_rng(k), g).item() for k in range(4)])
            net.train()
            print(f"step {step}, {time.time() - started:.0f} s, loss {running:.4f}, held out {check:.4f}", flush=True)
        step += 1
    torch.save({"model": net.state_dict(), "steps": step}, a.output)
    # What Eq. 8 asks of it: does the difference of the two answers lead a wrongly lit insertion towards the right one?
    net.eval()
    rng, g = np.random.default_rng(7), torch.Generator().manual_seed(7)
    own, pictures = held
    with torch.no_grad():
        for strength in (0.1, 0.3, 0.6):
            cosines, better = [], []
            for k in range(len(own)):
                q = pictures[k].float() / 127.5 - 1
                n = len(q)
                mask, normal = own[k, :1].float() / 255, (own[k, 1:].float() - 128) / 127
                condition = torch.cat([q[:, :3], mask.expand(n, -1, -1, -1), (normal * (mask > 0)).expand(n, -1, -1, -1)], 1)
                t = torch.full((n,), int(strength * m.TIMESTEPS) - 1)
                noisy = noised(q[:, 6:9], t, bar, torch.randn(n, 3, m.SIZE, m.SIZE, generator=g))
                time_ = t.float() / m.TIMESTEPS
                way = net(noisy, time_, condition, torch.ones(n, 1)) - net(noisy, time_, condition, torch.zeros(n, 1))
                truth = q[:, 3:6] - q[:, 6:9]
                cosines += torch.nn.functional.cosine_similarity(way.flatten(1), truth.flatten(1)).tolist()
            print(f"strength {strength}: cosine of the way and the truth {np.mean(cosines):.3f}, positive in {np.mean(np.array(cosines) > 0):.2f}")


if __name__ == "__main__":
    main()
