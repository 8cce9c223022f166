"""The small guidance network: what an insertion looked like before noise was added to it.

Pixel space, 64 x 64. It sees the noisy insertion, the photo without the object, the object's mask and normals, the noise's
level, and a flag: 1 for "lit as the photo is", 0 for "lit somehow". The two answers of one network are the two terms of
DiPIR's Eq. 8. What Rust must know (channels, schedule) is written into model.json by export.py from the constants here.
"""

import math

import torch
import torch.nn.functional as F
from torch import nn

SIZE = 64
#: Channels of the condition, in order; photo and noisy picture are sRGB codes in [-1, 1], the mask is in [0, 1].
CONDITION = ["photo"] * 3 + ["mask"] + ["normal"] * 3
TIMESTEPS = 1000
#: The strength that the optimisation starts with is 0.6; training goes a little beyond.
STRONGEST = 0.65


def alphas_bar():
    """Signal share of each step: squared cosine (Nichol & Dhariwal 2021), not rescaled."""
    t = torch.arange(1, TIMESTEPS + 1, dtype=torch.float64) / TIMESTEPS
    bar = torch.cos(0.5 * math.pi * (t + 0.008) / 1.008) ** 2 / math.cos(0.5 * math.pi * 0.008 / 1.008) ** 2
    return bar.float()


class Block(nn.Module):
    """Pre-activated residual block, scaled and shifted by time, flag and a summary of the picture."""

    def __init__(self, inputs, outputs, context):
        super().__init__()
        self.norm1, self.conv1 = nn.GroupNorm(8, inputs), nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm2, self.conv2 = nn.GroupNorm(8, outputs), nn.Conv2d(outputs, outputs, 3, padding=1)
        nn.init.zeros_(self.conv2.weight)
        self.film = nn.Linear(context, 2 * outputs)
        self.skip = nn.Conv2d(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x, context):
        h = self.conv1(F.silu(self.norm1(x)))
        scale, shift = self.film(context)[:, :, None, None].chunk(2, 1)
        h = self.norm2(h) * (1 + scale) + shift
        return self.skip(x) + self.conv2(F.silu(h))


class Guide(nn.Module):
    """x0 from a noisy insertion (N, 3, S, S), the step over TIMESTEPS (N,), the condition (N, 7, S, S) and the flag (N, 1)."""

    def __init__(self, widths=(32, 56, 80), context=80):
        super().__init__()
        b, c, d = widths
        self.time = nn.Sequential(nn.Linear(9, context), nn.SiLU(), nn.Linear(context, context))
        self.stem = nn.Conv2d(4 * (3 + len(CONDITION)), b, 3, padding=1)
        self.down0 = Block(b, b, context)
        self.to1 = nn.Conv2d(b, c, 3, 2, padding=1)
        self.down1 = Block(c, c, context)
        self.to2 = nn.Conv2d(c, d, 3, 2, padding=1)
        self.down2 = Block(d, d, context)
        self.to3 = nn.Conv2d(d, d, 3, 2, padding=1)
        # Where things stand matters for where the light comes from, so the summary is not a mean.
        self.summary = nn.Sequential(nn.Linear(d * 16, context), nn.SiLU(), nn.Linear(context, context))
        self.middle = Block(d, d, context)
        self.up2 = Block(2 * d, d, context)
        self.up1 = Block(d + c, c, context)
        self.up0 = Block(c + b, b, context)
        self.last = nn.Conv2d(b, 12, 3, padding=1)
        nn.init.zeros_(self.last.weight)

    def forward(self, noisy, time, condition, flag):
        x = F.pixel_unshuffle(torch.cat([noisy, condition], 1), 2)
        angle = time[:, None] * torch.tensor([0.5, 1.0, 2.0, 4.0], dtype=time.dtype) * math.pi
        context = self.time(torch.cat([torch.sin(angle), torch.cos(angle), flag], 1))
        h0 = self.down0(self.stem(x), context)
        h1 = self.down1(self.to1(h0), context)
        h2 = self.down2(self.to2(h1), context)
        h = self.to3(h2)
        context = context + self.summary(h.flatten(1))
        h = self.middle(h, context)
        up = lambda v: F.interpolate(v, scale_factor=2.0, mode="nearest")
        h = self.up2(torch.cat([up(h), h2], 1), context)
        h = self.up1(torch.cat([up(h), h1], 1), context)
        h = self.up0(torch.cat([up(h), h0], 1), context)
        return condition[:, :3] + F.pixel_shuffle(self.last(F.silu(h)), 2)
