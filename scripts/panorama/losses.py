"""What the network is asked for: codes, and what spheres under the completed light look like."""

import math

import numpy as np
import torch
import torch.nn.functional as F

from data import directions, solid_angles
from model import HEIGHT, WIDTH, decode


def fibonacci(n):
    """n directions, evenly spread, (n, 3)."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    theta = np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(theta), r * np.sin(theta), z], -1)


def sphere_matrices(points=160, roughness=0.4):
    """Two (points, H/2 * W/2) matrices from a map of half the size to a diffuse sphere (cosine lobe) and a glossy one (GGX
    around the normal, seen from along it: the prefiltered map of Karis 2013), rows summing to 1."""
    h, w = HEIGHT // 2, WIDTH // 2
    d = directions(h, w).reshape(3, -1)
    solid = np.broadcast_to(solid_angles(h, w), (h, w)).reshape(-1)
    cos = fibonacci(points) @ d
    diffuse = np.maximum(cos, 0) * solid
    alpha = roughness**2
    half2 = (1 + cos) / 2
    lobe = alpha**2 / (half2 * (alpha**2 - 1) + 1) ** 2
    glossy = lobe * np.maximum(cos, 0) * solid
    return [torch.tensor(m / m.sum(1, keepdims=True), dtype=torch.float32) for m in (diffuse, glossy)]


class Losses:
    def __init__(self, dual=True):
        self.dual = dual
        self.matrices = sphere_matrices()
        solid = torch.tensor(np.broadcast_to(solid_angles(), (HEIGHT, WIDTH)).copy())
        self.solid = (solid / solid.mean())[None, None]
        coarse = F.avg_pool2d(self.solid, 2)
        self.coarse_solid = coarse

    def spheres(self, x):
        """(N, 3, H, W) -> two lists of (N, 3, points)."""
        small = F.avg_pool2d(x * self.solid, 2) / self.coarse_solid
        flat = small.flatten(2)
        return [flat @ m.T for m in self.matrices]

    def compose(self, x, batch):
        known, clipped = batch["known"], batch["clipped"]
        x = torch.where(clipped, torch.maximum(x, batch["partial"]), x)
        return torch.where(known, batch["truth"], x)

    def __call__(self, code, target, batch):
        """Per-sample parts of the loss, (N,) each."""
        unknown = (~batch["known"]).float() * self.solid
        error = F.smooth_l1_loss(code, target, beta=0.3, reduction="none")
        parts = {"code": (error * (unknown + 0.05)).mean((1, 2, 3)) * 2}
        full = self.compose(decode(code, self.dual), batch)
        for name, a, b in zip(("diffuse", "glossy"), self.spheres(full), self.spheres(batch["truth"])):
            a, b = a.flatten(1), b.flatten(1)
            aa, bb, ab = (a * a).sum(1), (b * b).sum(1), (a * b).sum(1)
            # si-RMSE over the truth's root mean square.
            parts[name] = torch.sqrt((1 - ab * ab / (aa * bb).clamp(min=1e-12)).clamp(min=0) + 1e-5)
            if name == "diffuse":
                ratio = torch.log(a.mean(1).clamp(min=1e-6) / b.mean(1).clamp(min=1e-6))
                parts["energy"] = F.smooth_l1_loss(ratio, torch.zeros_like(ratio), reduction="none", beta=0.2)
        return parts


WEIGHTS = {"code": 1.0, "diffuse": 1.5, "glossy": 1.0, "energy": 0.3}


def total(parts):
    return sum(WEIGHTS[k] * v for k, v in parts.items())


assert math.isclose(sum(fibonacci(64)[:, 2]), 0, abs_tol=1e-9)
