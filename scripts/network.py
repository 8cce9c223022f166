"""What the small networks of `panorama` and `insert` are made of."""

import math

import torch
import torch.nn.functional as F
from torch import nn


def squared_cosine(steps, to_zero=False):
    """Signal share of each step: squared cosine (Nichol & Dhariwal 2021); `to_zero` leaves nothing at the last."""
    t = torch.arange(1, steps + 1, dtype=torch.float64) / steps
    bar = torch.cos(0.5 * math.pi * (t + 0.008) / 1.008) ** 2 / math.cos(0.5 * math.pi * 0.008 / 1.008) ** 2
    if to_zero:
        bar = (bar - bar[-1]) / (bar[0] - bar[-1]) * bar[0]
    return bar.float()


def angles(time):
    """Sines and cosines of a time in [0, 1], (N,) -> (N, 8)."""
    angle = time[:, None] * torch.tensor([0.5, 1.0, 2.0, 4.0], dtype=time.dtype) * math.pi
    return torch.cat([torch.sin(angle), torch.cos(angle)], 1)


class Conv(nn.Module):
    """Convolution of 3 x 3 whose edges are filled by `pad`: one texel of what lies beyond each."""

    def __init__(self, inputs, outputs, stride=1, zero=False, pad=None):
        super().__init__()
        self.pad = pad or (lambda x: F.pad(x, (1, 1, 1, 1)))
        self.conv = nn.Conv2d(inputs, outputs, 3, stride)
        if zero:
            nn.init.zeros_(self.conv.weight)
            nn.init.zeros_(self.conv.bias)

    def forward(self, x):
        return self.conv(self.pad(x))


class Block(nn.Module):
    """Pre-activated residual block; what is known of the whole picture scales and shifts its features."""

    def __init__(self, inputs, outputs, context, pad=None):
        super().__init__()
        self.norm1, self.conv1 = nn.GroupNorm(8, inputs), Conv(inputs, outputs, pad=pad)
        self.norm2, self.conv2 = nn.GroupNorm(8, outputs), Conv(outputs, outputs, zero=True, pad=pad)
        self.film = nn.Linear(context, 2 * outputs)
        self.skip = nn.Conv2d(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x, context):
        h = self.conv1(F.silu(self.norm1(x)))
        scale, shift = self.film(context)[:, :, None, None].chunk(2, 1)
        h = self.norm2(h) * (1 + scale) + shift
        return self.skip(x) + self.conv2(F.silu(h))
