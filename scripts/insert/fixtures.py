"""The fixture of crates/comgs-insert/tests/lds.rs: a latent model of random weights, its encoder's vector-Jacobian product, and
what torch says both are. Fails where the exported product is not autograd's to 1e-5."""

import json
import os
import sys

import numpy as np
import onnxruntime
import torch
from blake3 import blake3
from torch import nn

import vjp as v


class Encoder(nn.Module):
    """Strided convolutions, group norm, SiLU and attention: the operators of a latent diffusion model's encoder."""

    def __init__(self):
        super().__init__()
        self.first, self.norm, self.second = nn.Conv2d(3, 8, 3, padding=1), nn.GroupNorm(4, 8), nn.Conv2d(8, 8, 3, 2)
        self.norm2, self.last = nn.GroupNorm(4, 8), nn.Conv2d(8, 4, 3, 2, padding=1)
        self.q, self.k, self.v = nn.Linear(8, 8), nn.Linear(8, 8), nn.Linear(8, 8)

    def forward(self, x):
        h = nn.functional.silu(self.norm(self.first(x)))
        # As autoencoders of diffusers pad: below and to the right only.
        h = self.second(nn.functional.pad(h, (0, 1, 0, 1)))
        n, c, height, width = h.shape
        t = self.norm2(h).flatten(2).transpose(1, 2)
        weight = torch.softmax(self.q(t) @ self.k(t).transpose(1, 2) / c**0.5, -1)
        h = h + (weight @ self.v(t)).transpose(1, 2).reshape(n, c, height, width)
        return 0.18215 * self.last(nn.functional.silu(h))


class Denoiser(nn.Module):
    def __init__(self):
        super().__init__()
        self.a, self.b, self.told = nn.Conv2d(4, 8, 3, padding=1), nn.Conv2d(8, 4, 3, padding=1), nn.Linear(6, 8)

    def forward(self, z, time, told):
        h = self.a(z) + self.told(told).mean(1)[:, :, None, None] + time[:, None, None, None] / 1000
        return self.b(nn.functional.silu(h))


def main(out):
    os.makedirs(out, exist_ok=True)
    torch.manual_seed(5)
    encoder, denoisers = Encoder().eval(), [Denoiser().eval(), Denoiser().eval()]
    picture, grad = torch.rand(1, 3, 32, 32) * 2 - 1, torch.randn(1, 4, 8, 8)
    z, time, told = torch.randn(1, 4, 8, 8), torch.tensor([250.0]), torch.randn(1, 5, 6)
    path = lambda name: os.path.join(out, name)
    v.export(encoder, (picture,), path("encoder.onnx"), ["picture"], "latent")
    product = v.vjp_module(encoder, picture, grad)
    v.export(product, (picture, grad), path("encoder_vjp.onnx"), ["picture", "grad_latent"], "grad_picture")
    for name, net in zip(["base", "personalised"], denoisers):
        v.export(net, (z, time, told), path(name + ".onnx"), ["sample", "time", "told"], "noise")
    x = picture.clone().requires_grad_(True)
    latent = encoder(x)
    truth = torch.autograd.grad(latent, x, grad)[0]
    session = onnxruntime.InferenceSession(path("encoder_vjp.onnx"))
    ours = session.run(None, {"picture": picture.numpy(), "grad_latent": grad.numpy()})[0]
    error = np.abs(ours - truth.numpy()).max() / np.abs(truth.numpy()).max()
    print(f"encoder_vjp against autograd: {error:.1e} of the largest entry")
    assert error < 1e-5
    told.numpy().astype("<f4").tofile(path("prompt.bin"))
    entry = lambda name: {"file": name, "blake3": blake3(open(path(name), "rb").read()).hexdigest()}
    port = lambda name, *shape: {"name": name, "shape": list(shape)}
    term = lambda graph, context: {
        "graph": graph, "context": context, "sample": port("sample", 1, 4, 8, 8), "time": port("time", 1),
        "told": port("told", 1, 5, 6), "prediction": port("noise", 1, 4, 8, 8),
    }
    manifest = {
        "format": "comgs-guidance", "version": 1, "name": "fixture", "about": "Random weights (scripts/insert/fixtures.py).",
        "licence": "MIT OR Apache-2.0", "resolution": [32, 32], "latent": {"shape": [1, 4, 8, 8]},
        "schedule": {
            "timesteps": 1000, "betas": {"kind": "scaled_linear", "start": 0.00085, "end": 0.012},
            "prediction": "epsilon", "spacing": "leading",
        },
        "time_scale": 1.0, "base": term("base", "empty"), "personalised": term("personalised", "prompt"),
        "contexts": {
            "empty": {"prompt": "", "shape": [1, 5, 6], "values": [0.0] * 30},
            "prompt": {"prompt": "a photo of a car", "shape": [1, 5, 6], "file": entry("prompt.bin")},
        },
        "graphs": {name: entry(name + ".onnx") for name in ["encoder", "encoder_vjp", "base", "personalised"]},
    }
    json.dump(manifest, open(path("model.json"), "w"), indent=1)
    with torch.no_grad():
        noise = denoisers[1](z, time, told)
    flat = lambda t: [round(float(x), 7) for x in t.detach().flatten()]
    expected = {
        "picture": flat(picture), "grad_latent": flat(grad), "latent": flat(latent), "grad_picture": flat(truth),
        "sample": flat(z), "time": 250.0, "noise": flat(noise),
    }
    json.dump(expected, open(path("expected.json"), "w"))


if __name__ == "__main__":
    main(sys.argv[1])
