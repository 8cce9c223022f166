"""Writes the trained guidance network as a bundle for `comgs insert --guidance lds`: guide.onnx (its weights in half
precision, computed with in single) and model.json."""

import argparse
import json
import os
import warnings

import onnx
import torch
from blake3 import blake3

import model as m
from latent_bundle import halved, rounded


def main():
    p = argparse.ArgumentParser()
    p.add_argument("checkpoint")
    p.add_argument("-o", "--output", required=True, help="folder of the bundle")
    a = p.parse_args()
    net = m.Guide()
    net.load_state_dict(torch.load(a.checkpoint, weights_only=True)["model"])
    rounded(net.eval())
    os.makedirs(a.output, exist_ok=True)
    path = os.path.join(a.output, "guide.onnx")
    s, c = m.SIZE, m.CONDITION
    example = (torch.zeros(1, 3, s, s), torch.ones(1), torch.zeros(1, c, s, s), torch.ones(1, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            net, example, path, opset_version=17, dynamo=False, do_constant_folding=True,
            input_names=["noisy", "time", "condition", "flag"], output_names=["clean"],
        )
    graph = halved(onnx.load(path))
    onnx.checker.check_model(graph)
    onnx.save(graph, path)
    port = lambda name, *shape: {"name": name, "shape": list(shape)}
    term = lambda context: {
        "graph": "guide", "context": context, "sample": port("noisy", 1, 3, s, s), "time": port("time", 1),
        "condition": port("condition", 1, c, s, s), "told": port("flag", 1, 1), "prediction": port("clean", 1, 3, s, s),
    }
    manifest = {
        "format": "comgs-guidance",
        "version": 1,
        "name": "comgs-guide",
        "about": "Answers a noisy insertion with it, or with how it would be lit as its photo is; trained by scripts/insert.",
        "licence": "MIT OR Apache-2.0",
        "resolution": [s, s],
        "condition": list(m.PLANES),
        "schedule": {
            "timesteps": m.TIMESTEPS, "betas": {"kind": "squared_cosine"}, "prediction": "x0", "spacing": "leading",
        },
        "time_scale": 1 / m.TIMESTEPS,
        "base": term("as it is"),
        "personalised": term("right"),
        "contexts": {
            "right": {"prompt": "lit as the photo is", "shape": [1, 1], "values": [1.0]},
            "as it is": {"prompt": "", "shape": [1, 1], "values": [0.0]},
        },
        "graphs": {"guide": {"file": "guide.onnx", "blake3": blake3(open(path, "rb").read()).hexdigest()}},
    }
    with open(os.path.join(a.output, "model.json"), "w") as f:
        json.dump(manifest, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
