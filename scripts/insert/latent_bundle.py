"""Writes a latent guidance bundle (docs/formats.md, crates/comgs-insert/src/lds/manifest.rs): two denoisers, an encoder, its
vector-Jacobian product, and prompts as numbers."""

import json
import os
import sys
import tempfile
import warnings

import numpy as np
import onnx
import torch
from blake3 import blake3
from torch import nn

import vjp

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from latent import plain  # noqa: E402

PREDICTIONS = {"epsilon": "epsilon", "v_prediction": "v", "sample": "x0"}
#: A file of ONNX holds less than 2 GiB.
LARGEST = 2**31 - 2**16
#: Weights of fewer entries stay in single precision.
SMALL = 4096


class Denoiser(nn.Module):
    def __init__(self, unet):
        super().__init__()
        self.unet = unet

    def forward(self, sample, time, told):
        return self.unet(sample, time, told).sample


class Encoder(nn.Module):
    """The mean of the latent, scaled as the denoisers know it."""

    def __init__(self, vae):
        super().__init__()
        self.vae = vae

    def forward(self, picture):
        return self.vae.encode(picture).latent_dist.mean * self.vae.config.scaling_factor


def rounded(module):
    """Rounds large weights to half precision, as the files of `halved` hold them; they are computed with in single."""
    with torch.no_grad():
        for p in module.parameters():
            if p.numel() >= SMALL:
                p.copy_(p.half().float())
    return module


def halved(model):
    """Stores large weights in half precision, each with a cast behind it: half the file, the same numbers once rounded."""
    casts = []
    for weight in model.graph.initializer:
        values = onnx.numpy_helper.to_array(weight)
        if values.dtype == np.float32 and values.size >= SMALL:
            name = weight.name
            weight.CopyFrom(onnx.numpy_helper.from_array(values.astype(np.float16), name + "_half"))
            casts.append(onnx.helper.make_node("Cast", [name + "_half"], [name], to=onnx.TensorProto.FLOAT))
    nodes = list(model.graph.node)
    del model.graph.node[:]
    model.graph.node.extend(casts + nodes)
    return model


def write_graph(module, example, path, inputs, output, half):
    """Exports a module. Networks beyond 2 GiB go through a folder of external data and must be halved."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        raw = os.path.join(folder, "graph.onnx")
        program = torch.onnx.export(
            module, example, dynamo=True, opset_version=18, input_names=inputs, output_names=[output], verbose=False
        )
        program.save(raw, external_data=True)
        model = onnx.load(raw)
    if half:
        model = halved(model)
    # Where in the sources an operator came from is of no use to who runs it.
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    for value in [*model.graph.value_info, *model.graph.input, *model.graph.output]:
        del value.metadata_props[:]
    del model.graph.metadata_props[:]
    del model.metadata_props[:]
    size = model.ByteSize()
    if size > LARGEST:
        raise ValueError(f"{os.path.basename(path)} would take {size} bytes; an ONNX file holds {LARGEST}: export with --half")
    with open(path, "wb") as f:
        f.write(model.SerializeToString())


def write(folder, name, base, personalised, vae, schedule, prompts, resolution, licence, half=False):
    """Writes the bundle.

    base, personalised: UNets of `diffusers` (the second with its additions merged); vae: AutoencoderKL
    schedule: configuration of the scheduler that they were trained with
    prompts: context's name -> (prompt, embedding (1, tokens, size)); "empty" is the base's, "prompt" the personalised one's
    """
    os.makedirs(folder, exist_ok=True)
    if schedule["beta_schedule"] not in ("linear", "scaled_linear"):
        raise ValueError(f"a schedule of linear or scaled_linear betas is needed, this one has {schedule['beta_schedule']!r}")
    path = lambda file: os.path.join(folder, file)
    entry = lambda file: {"file": file, "blake3": blake3(open(path(file), "rb").read()).hexdigest()}
    modules = [m.float().cpu().eval().requires_grad_(False) for m in (base, personalised, vae)]
    for module in modules:
        plain(rounded(module) if half else module)
    base, personalised, vae = modules
    factor = 2 ** (len(vae.config.block_out_channels) - 1)
    side = resolution // factor
    latent, picture = torch.zeros(1, base.config.in_channels, side, side), torch.rand(1, 3, resolution, resolution) * 2 - 1
    told = prompts["prompt"][1].float()
    time = torch.tensor([250.0])
    for file, unet in (("base.onnx", base), ("personalised.onnx", personalised)):
        example = (torch.randn_like(latent), time, told)
        write_graph(Denoiser(unet), example, path(file), ["sample", "time", "told"], "noise", half)
    encoder = Encoder(vae)
    write_graph(encoder, (picture,), path("encoder.onnx"), ["picture"], "latent", half)
    gradient = torch.randn_like(latent)
    product = vjp.vjp_module(encoder, picture, gradient)
    write_graph(product, (picture, gradient), path("encoder_vjp.onnx"), ["picture", "grad_latent"], "grad_picture", half)
    contexts = {}
    for context, (text, numbers) in prompts.items():
        numbers.detach().float().numpy().astype("<f4").tofile(path(context + ".bin"))
        contexts[context] = {"prompt": text, "shape": list(numbers.shape), "file": entry(context + ".bin")}
    port = lambda name, shape: {"name": name, "shape": list(shape)}
    term = lambda graph, context: {
        "graph": graph, "context": context, "sample": port("sample", latent.shape), "time": port("time", [1]),
        "told": port("told", told.shape), "prediction": port("noise", latent.shape),
    }
    manifest = {
        "format": "comgs-guidance", "version": 1, "name": name, "about": "Written by scripts/insert/personalise.py.",
        "licence": licence, "resolution": [resolution, resolution], "latent": {"shape": list(latent.shape)},
        "schedule": {
            "timesteps": schedule["num_train_timesteps"],
            "betas": {"kind": schedule["beta_schedule"], "start": schedule["beta_start"], "end": schedule["beta_end"]},
            "prediction": PREDICTIONS[schedule["prediction_type"]], "spacing": "leading",
        },
        "time_scale": 1.0, "base": term("base", "empty"), "personalised": term("personalised", "prompt"),
        "contexts": contexts,
        "graphs": {role: entry(role + ".onnx") for role in ("base", "personalised", "encoder", "encoder_vjp")},
    }
    with open(path("model.json"), "w") as f:
        json.dump(manifest, f, indent=1)
        f.write("\n")
