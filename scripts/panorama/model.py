"""The completer's network: from a partial panorama to the whole, 64 x 128, on the sphere.

Names and numbers that Rust must know as well (encodings, channel order, schedule) are written into model.json by export.py
from the constants here.
"""

import math
import os
import sys
from functools import partial

import torch
import torch.nn.functional as F
from torch import nn

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
import network  # noqa: E402
from network import angles, squared_cosine  # noqa: E402

HEIGHT, WIDTH = 64, 128
#: Radiance is divided by the level of what was seen, so that its geometric mean becomes this.
MIDDLE = 0.25
#: The log encoding reaches 1 here.
BRIGHTEST = 65536.0
#: Offset and scale of the two encodings: the network sees (code - offset) / scale.
REINHARD = (0.30, 0.25)
LOG = (0.06, 0.10)
#: Fusion of the encodings: Reinhard's below the first, the log one above the second.
FUSE = (8.0, 16.0)
#: Reinhard codes are cut here before they are inverted.
LARGEST_REINHARD = 0.95
#: Training steps of the noise schedule.
TIMESTEPS = 1000

#: Channels of the condition, in order.
CONDITION = ["reinhard"] * 3 + ["log"] * 3 + ["known", "clipped"] + ["normal"] * 3 + ["direction"] * 3


def encode(x, dual=True):
    """Radiance over its level, (N, 3, H, W) -> two codes, (N, 6, H, W), each with a mean near 0 and a spread near 1."""
    x = x.clamp(min=0)
    reinhard = (x / (1 + x) - REINHARD[0]) / REINHARD[1]
    log = (torch.log1p(x) / math.log1p(BRIGHTEST) - LOG[0]) / LOG[1]
    return torch.cat([reinhard if dual else log, log], 1)


def decode(code, dual=True):
    """Two codes -> radiance over its level: inverse Reinhard below 8, blended to 16, the log code above."""
    reinhard = (code[:, :3] * REINHARD[1] + REINHARD[0]).clamp(0, LARGEST_REINHARD)
    log = (code[:, 3:] * LOG[1] + LOG[0]).clamp(0, 1)
    low = reinhard / (1 - reinhard)
    high = torch.expm1(log * math.log1p(BRIGHTEST))
    if not dual:
        return high
    weight = ((high - FUSE[0]) / (FUSE[1] - FUSE[0])).clamp(0, 1)
    return low + weight * (high - low)


def alphas_bar():
    """Cumulative signal share of each step, with nothing left at the last."""
    return squared_cosine(TIMESTEPS, to_zero=True)


def pad(x):
    """One texel of what lies beyond each edge: around the azimuth, and over the poles to the other side."""
    half = x.shape[3] // 2
    top, bottom = x[:, :, :1], x[:, :, -1:]
    top = torch.cat([top[..., half:], top[..., :half]], 3)
    bottom = torch.cat([bottom[..., half:], bottom[..., :half]], 3)
    x = torch.cat([top, x, bottom], 2)
    return torch.cat([x[..., -1:], x, x[..., :1]], 3)


def pull_push(value, weight, levels=6):
    """Fills a map from coarser and coarser means of what is known (Gortler et al. 1996): the start from which the network
    predicts a change. `value` (N, C, H, W) counts where `weight` (N, 1, H, W) is 1."""
    pyramid = [(value * weight, weight)]
    for _ in range(levels):
        v, w = pyramid[-1]
        pyramid.append((F.avg_pool2d(v, 2), F.avg_pool2d(w, 2)))
    v, w = pyramid[-1]
    fill = v / w.clamp(min=1e-6)
    for v, w in reversed(pyramid[:-1]):
        fill = F.interpolate(fill, scale_factor=2.0, mode="nearest")
        # A tent over the blocks that nearest leaves.
        padded = pad(fill)
        fill = F.avg_pool2d(padded, 3, stride=1)
        trust = (w * 4).clamp(max=1)
        fill = trust * v / w.clamp(min=1e-6) + (1 - trust) * fill
    return fill


#: Convolutions and blocks on the sphere.
Conv, Block = partial(network.Conv, pad=pad), partial(network.Block, pad=pad)


class Completer(nn.Module):
    """x0 of the two codes from noisy codes, the time in [0, 1] and the condition (see CONDITION)."""

    def __init__(self, widths=(24, 48, 96, 128), context=96, dual=True):
        super().__init__()
        self.dual = dual
        a, b, c, d = widths
        inputs = 6 + len(CONDITION) + 6
        self.time = nn.Sequential(nn.Linear(8, context), nn.SiLU(), nn.Linear(context, context))
        self.stem = Conv(inputs, a, 2)
        self.down0 = Block(a, a, context)
        self.to1 = Conv(a, b, 2)
        self.down1 = nn.ModuleList([Block(b, b, context), Block(b, b, context)])
        self.to2 = Conv(b, c, 2)
        self.down2 = nn.ModuleList([Block(c, c, context), Block(c, c, context)])
        self.to3 = Conv(c, d, 2)
        self.summary = nn.Sequential(nn.Linear(d, context), nn.SiLU(), nn.Linear(context, context))
        self.middle = nn.ModuleList([Block(d, d, context), Block(d, d, context)])
        self.up2 = nn.ModuleList([Block(d + c, c, context), Block(c, c, context)])
        self.up1 = nn.ModuleList([Block(c + b, b, context), Block(b, b, context)])
        self.up0 = Block(b + a, a, context)
        # Four texels of six codes each: at the full size the last layers would be a quarter of all multiplications.
        self.last = Conv(a, 24, zero=True)

    def forward(self, noisy, time, condition):
        known = (condition[:, 6:7] + condition[:, 7:8]).clamp(max=1)
        log = (condition[:, 3:6] * LOG[1] + LOG[0]) * math.log1p(BRIGHTEST)
        base = torch.exp(pull_push(torch.log((torch.exp(log) - 1).clamp(min=0) + 0.01), known)) - 0.01
        base = encode(base, self.dual)
        x = torch.cat([noisy, condition, base], 1)
        context = self.time(angles(time))
        h0 = self.down0(self.stem(x), context)
        h1 = self.to1(h0)
        for block in self.down1:
            h1 = block(h1, context)
        h2 = self.to2(h1)
        for block in self.down2:
            h2 = block(h2, context)
        h = self.to3(h2)
        context = context + self.summary(h.mean((2, 3)))
        for block in self.middle:
            h = block(h, context)
        up = lambda v: F.interpolate(v, scale_factor=2.0, mode="nearest")
        h = torch.cat([up(h), h2], 1)
        for block in self.up2:
            h = block(h, context)
        h = torch.cat([up(h), h1], 1)
        for block in self.up1:
            h = block(h, context)
        h = self.up0(torch.cat([up(h), h0], 1), context)
        return base + F.pixel_shuffle(self.last(F.silu(h)), 2)
