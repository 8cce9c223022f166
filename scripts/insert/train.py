"""Trains the small guidance network on insertions under right and wrong light (guidance_data)."""

import argparse
import copy
import glob
import json
import os
import time

import numpy as np
import torch
import torch.nn.functional as F

import model as m


def linear_from_srgb(v):
    return torch.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def coded(v):
    """sRGB in [-1, 1] of linear values, as the models are given them."""
    v = v.clamp(0, 1)
    return 2 * torch.where(v <= 0.0031308, 12.92 * v, 1.055 * v.clamp(min=1e-6) ** (1 / 2.4) - 0.055) - 1


class Places:
    """Pictures of places: linear values, so that lights can be added and pixels averaged."""

    def __init__(self, names):
        s = m.DATA_SIZE
        curve = linear_from_srgb(torch.arange(256) / 255.0).half()
        self.own, self.pictures = [], []
        for name in names:
            planes = torch.from_numpy(np.fromfile(name, np.uint8).reshape(-1, s, s))
            mask, normal, albedo = planes[:1] / 255.0, (planes[1:4].float() - 128) / 127, curve[planes[4:7].int()]
            self.own.append(torch.cat([mask, normal * (mask > 0), albedo.float()]).half())
            self.pictures.append(curve[planes[7:].int()].reshape(-1, 9, s, s))
        self.own, self.pictures = torch.stack(self.own), torch.stack(self.pictures)

    def __len__(self):
        return len(self.own)

    def whole(self, place, light):
        """Condition, right and wrong insertion of the whole pictures, at the network's size."""
        return shown(self.own[place].float(), self.pictures[place, light].float(), lambda v: F.avg_pool2d(v, 2))

    def varied(self, n, rng):
        """The same of random places, lights added, coloured, mirrored and cut."""
        pick = lambda most: torch.from_numpy(rng.integers(0, most, n))
        place, lights = pick(len(self.own)), self.pictures.shape[1]
        own, p = self.own[place].float(), self.pictures[place, pick(lights)].float()
        # Light adds up, and photo and insertion with it.
        share = torch.from_numpy((rng.random((n, 1, 1, 1)) < 0.4) * rng.uniform(0, 0.5, (n, 1, 1, 1))).float()
        p = (1 - share) * p + share * self.pictures[place, pick(lights)].float()
        gain = torch.from_numpy(np.exp(rng.normal(0, 0.15, (n, 1, 3, 1, 1)))).float()
        p = (p.reshape(n, 3, 3, *p.shape[2:]) * gain).clamp(max=1)
        order = torch.from_numpy(rng.permutation(3))
        p, own = p[:, :, order].flatten(1, 2), torch.cat([own[:, :4], own[:, 4:][:, order]], 1)
        if rng.random() < 0.5:
            p, own = p.flip(-1), own.flip(-1)
            # World y points to the camera's left.
            own = own * torch.tensor([1, 1, -1, 1, 1, 1, 1])[:, None, None]
        side = int(rng.integers(m.DATA_SIZE // 2, m.DATA_SIZE + 1))
        x, y = rng.integers(0, m.DATA_SIZE - side + 1, 2)
        cut = lambda v: F.interpolate(v[..., y : y + side, x : x + side], (m.SIZE, m.SIZE), mode="bilinear", antialias=True)
        return shown(own, p, cut)


def shown(own, pictures, reduce):
    own, p = reduce(own), coded(reduce(pictures))
    mask, normal, albedo = own[:, :1], own[:, 1:4], coded(own[:, 4:])
    return torch.cat([p[:, :3], mask, normal, albedo], 1), p[:, 3:6], p[:, 6:9]


def noised(x, t, bar, noise):
    a = bar[t][:, None, None, None]
    return a.sqrt() * x + (1 - a).sqrt() * noise


def loss_of(net, examples, bar, rng, noise):
    """Squared error, because the score is that of a mean. With the flag the right insertion is asked for, whatever the noisy
    one shows; if only right ones were shown, they would be copied, and nothing learnt of the photo."""
    condition, right, wrong = examples
    n = len(right)
    pick = lambda p: torch.from_numpy(rng.random((n, 1, 1, 1)) < p)
    x = torch.where(pick(0.5), right, wrong)
    flag = pick(0.6)
    target = torch.where(flag, right, x)
    t = torch.from_numpy(rng.integers(0, int(m.STRONGEST * m.TIMESTEPS), n))
    out = net(noised(x, t, bar, noise), t.float() / m.TIMESTEPS, condition, flag.float()[:, :, 0, 0])
    # The object is what light shows itself on; elsewhere there is a shadow at most.
    return ((0.5 + 4 * condition[:, 3:4]) * (out - target) ** 2).mean()


def cosines(net, held, bar, strength):
    """What Eq. 8 asks: does the difference of the two answers lead a wrongly lit insertion towards the right one?"""
    g, out = torch.Generator().manual_seed(7), []
    with torch.no_grad():
        for place in range(len(held)):
            lights = torch.arange(held.pictures.shape[1])
            condition, right, wrong = held.whole(torch.full_like(lights, place), lights)
            n = len(right)
            t = torch.full((n,), int(strength * m.TIMESTEPS) - 1)
            noisy = noised(wrong, t, bar, torch.randn(wrong.shape, generator=g))
            answer = lambda flag: net(noisy, t.float() / m.TIMESTEPS, condition, torch.full((n, 1), flag))
            way = answer(1.0) - answer(0.0)
            out += F.cosine_similarity(way.flatten(1), (right - wrong).flatten(1)).tolist()
    return np.array(out)


def main():
    p = argparse.ArgumentParser()
    p.add_argument("data", nargs="+", help="folders of guidance_data; the last places of each are held out")
    p.add_argument("-o", "--output", required=True)
    p.add_argument("--minutes", type=float, default=40)
    p.add_argument("--batch", type=int, default=32)
    p.add_argument("--rate", type=float, default=1.5e-3)
    p.add_argument("--threads", type=int, default=1)
    p.add_argument("--held-out", type=int, default=24, help="places of each folder that training does not see")
    p.add_argument("--log", help="where to write progress, a JSON object a line")
    p.add_argument("--seed", type=int, default=0)
    a = p.parse_args()
    torch.set_num_threads(a.threads)
    torch.manual_seed(a.seed)
    rng = np.random.default_rng(a.seed)
    names = [sorted(glob.glob(os.path.join(folder, "*.bin"))) for folder in a.data]
    train = Places([n for folder in names for n in folder[: -a.held_out]])
    held = [Places(folder[-a.held_out :]) for folder in names]
    net, bar = m.Guide(), m.alphas_bar()
    # A mean over the last steps is what is kept.
    kept, log = copy.deepcopy(net), open(a.log, "w") if a.log else None

    def say(**values):
        line = json.dumps(values)
        print(line, flush=True)
        if log:
            log.write(line + "\n")
            log.flush()

    say(parameters=sum(w.numel() for w in net.parameters()), places=len(train), held_out=[len(h) for h in held])
    optimiser = torch.optim.AdamW(net.parameters(), a.rate, weight_decay=1e-3)
    started, step, running, looked = time.time(), 0, None, 0.0
    while (gone := (time.time() - started) / 60 / a.minutes) < 1:
        for g in optimiser.param_groups:
            g["lr"] = a.rate * min(1, step / 200) * (0.02 + 0.98 * 0.5 * (1 + np.cos(np.pi * gone)))
        loss = loss_of(net, train.varied(a.batch, rng), bar, rng, torch.randn(a.batch, 3, m.SIZE, m.SIZE))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        with torch.no_grad():
            for old, new in zip(kept.parameters(), net.parameters()):
                old.lerp_(new, max(0.002, 1 / (step + 1)))
        running = loss.item() if running is None else 0.99 * running + 0.01 * loss.item()
        step += 1
        if gone >= looked:
            looked += 0.1
            scores = [[round(float(cosines(kept, h, bar, s).mean()), 3) for s in (0.1, 0.3, 0.6)] for h in held]
            say(step=step, seconds=round(time.time() - started), loss=round(running, 5), cosines=scores)
            torch.save({"model": kept.state_dict(), "steps": step}, a.output)
    torch.save({"model": kept.state_dict(), "steps": step}, a.output)
    for folder, places in zip(a.data, held):
        for strength in (0.1, 0.3, 0.6):
            c = cosines(kept, places, bar, strength)
            say(folder=os.path.basename(os.path.normpath(folder)), strength=strength, cosine=round(float(c.mean()), 3),
                positive=round(float((c > 0).mean()), 3))


if __name__ == "__main__":
    main()
