"""Writes a trained completer as a bundle: completer.onnx and model.json."""

import argparse
import json
import os
import subprocess
import warnings

import onnx
import torch

import model as m


def blake3(path):
    """With the b3sum program if it is there, else the Python package."""
    try:
        return subprocess.run(["b3sum", "--no-names", path], capture_output=True, text=True, check=True).stdout.strip()
    except (FileNotFoundError, subprocess.CalledProcessError):
        from blake3 import blake3 as hash

        return hash(open(path, "rb").read()).hexdigest()


def main():
    p = argparse.ArgumentParser()
    p.add_argument("checkpoint", help="of train.py")
    p.add_argument("-o", "--output", required=True, help="folder of the bundle")
    p.add_argument("--name", default="comgs-small")
    p.add_argument("--steps", type=int, default=1)
    a = p.parse_args()
    os.makedirs(a.output, exist_ok=True)
    h, w, c = m.HEIGHT, m.WIDTH, len(m.CONDITION)
    checkpoint = torch.load(a.checkpoint, weights_only=True)
    net = m.Completer(dual=checkpoint["dual"])
    net.load_state_dict(checkpoint["model"])
    net.eval()
    path = os.path.join(a.output, "completer.onnx")
    example = (torch.zeros(1, 6, h, w), torch.ones(1), torch.zeros(1, c, h, w))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            net, example, path, opset_version=17, dynamo=False, do_constant_folding=True,
            input_names=["noisy", "time", "condition"], output_names=["clean"],
        )
    graph = onnx.load(path)
    onnx.checker.check_model(graph)
    print(sorted({n.op_type for n in graph.graph.node}), os.path.getsize(path), "bytes")
    port = lambda name, *shape: {"name": name, "shape": list(shape)}
    manifest = {
        "format": "comgs-model",
        "version": 1,
        "name": a.name,
        "about": "Completes a partial panorama to HDR light; trained by scripts/panorama (see its README).",
        "licence": "MIT OR Apache-2.0",
        "resolution": [w, h],
        "space": {
            "kind": "codes",
            "condition": ["reinhard", "log", "known", "clipped", "normal", "direction"],
            "codes": {
                "middle": m.MIDDLE, "brightest": m.BRIGHTEST, "reinhard": list(m.REINHARD), "log": list(m.LOG),
                "fuse": list(m.FUSE), "largest_reinhard": m.LARGEST_REINHARD,
            },
            "zeros_at_last_step": True,
        },
        "schedule": {
            "timesteps": m.TIMESTEPS, "betas": {"kind": "squared_cosine"}, "prediction": "x0", "spacing": "trailing",
            "zero_terminal_snr": True, "final_alpha_one": True,
        },
        "solver": "ddim",
        "steps": a.steps,
        "graphs": {
            "denoiser": {
                "file": os.path.basename(path),
                "blake3": blake3(path),
                "inputs": {
                    "sample": port("noisy", 1, 6, h, w),
                    "time": port("time", 1),
                    "condition": port("condition", 1, c, h, w),
                },
                "outputs": {"prediction": port("clean", 1, 6, h, w)},
            }
        },
    }
    with open(os.path.join(a.output, "model.json"), "w") as f:
        json.dump(manifest, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
