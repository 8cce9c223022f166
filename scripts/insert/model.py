"""The small guidance network: what an insertion looked like before noise was added to it, or what it should look like.

Pixel space, 32 x 32. It sees the noisy insertion, the photo without the object, the object's mask, normals and base colour, the
noise's level, and a flag. With 0 it removes the noise. With 1 it answers with the insertion lit as the photo is, whatever light
the noisy one was made under. The two answers are the two terms of DiPIR's Eq. 8. What Rust must know (channels, schedule) is
written into model.json by export.py from the constants here.
"""

import os
import sys

import torch
import torch.nn.functional as F
from torch import nn

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from network import Block, Conv, angles, squared_cosine  # noqa: E402

SIZE = 32
#: Size of the pictures that guidance_data writes.
DATA_SIZE = 64
#: Planes of the condition, in order. Photo, base colour and noisy picture are sRGB codes in [-1, 1], the mask is in [0, 1].
PLANES = {"photo": 3, "mask": 1, "normal": 3, "albedo": 3}
CONDITION = sum(PLANES.values())
TIMESTEPS = 1000
#: The strength that the optimisation starts with is 0.6; training goes a little beyond.
STRONGEST = 0.65


def alphas_bar():
    return squared_cosine(TIMESTEPS)


class Attention(nn.Module):
    """Every place looks at every other: what lights the things of the photo lights the object."""

    def __init__(self, channels):
        super().__init__()
        self.norm = nn.GroupNorm(8, channels)
        self.qkv, self.out = nn.Conv2d(channels, 3 * channels, 1), nn.Conv2d(channels, channels, 1)
        nn.init.zeros_(self.out.weight)

    def forward(self, x):
        n, c, h, w = x.shape
        q, k, v = self.qkv(self.norm(x)).reshape(n, 3, c, h * w).unbind(1)
        weight = torch.softmax(q.transpose(1, 2) @ k / c**0.5, -1)
        return x + self.out((v @ weight.transpose(1, 2)).reshape(n, c, h, w))


class Guide(nn.Module):
    """An insertion (N, 3, S, S) from a noisy one, the step over TIMESTEPS (N,), the condition (N, 10, S, S), the flag (N, 1)."""

    def __init__(self, widths=(48, 80, 112), context=96):
        super().__init__()
        a, b, c = widths
        self.time = nn.Sequential(nn.Linear(9, context), nn.SiLU(), nn.Linear(context, context))
        self.stem = Conv(4 * (3 + CONDITION), a)
        self.down0 = Block(a, a, context)
        self.to1 = Conv(a, b, 2)
        self.down1, self.look1 = Block(b, b, context), Attention(b)
        self.to2 = Conv(b, c, 2)
        # Where things stand matters for where the light comes from, so the summary is not a mean.
        self.summary = nn.Sequential(nn.Linear(c * 16, context), nn.SiLU(), nn.Linear(context, context))
        self.middle = nn.ModuleList([Block(c, c, context), Block(c, c, context)])
        self.up1, self.look2 = Block(c + b, b, context), Attention(b)
        self.up0 = Block(b + a, a, context)
        self.last = Conv(a, 12, zero=True)

    def forward(self, noisy, time, condition, flag):
        x = F.pixel_unshuffle(torch.cat([noisy, condition], 1), 2)
        context = self.time(torch.cat([angles(time), flag], 1))
        h0 = self.down0(self.stem(x), context)
        h1 = self.look1(self.down1(self.to1(h0), context))
        h = self.to2(h1)
        context = context + self.summary(h.flatten(1))
        for block in self.middle:
            h = block(h, context)
        up = lambda v: F.interpolate(v, scale_factor=2.0, mode="nearest")
        h = self.look2(self.up1(torch.cat([up(h), h1], 1), context))
        h = self.up0(torch.cat([up(h), h0], 1), context)
        return condition[:, :3] + F.pixel_shuffle(self.last(F.silu(h)), 2)
