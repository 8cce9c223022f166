"""Two tiny bundles of the full shape of Stable Diffusion, random weights, and what `diffusers` makes of them: a test's judge.

    python tiny_latent.py ../../crates/comgs-panorama/tests/data/latent

`prompt` is laid out as in the ComGS paper (appendix D): noise, masked latent, normals and mask; text conditioned with
classifier-free guidance; v-prediction; exposures by interpolated prompts. `networks` is laid out as the variant that its authors
released: noise 4, normal 3, mask 1 (1 = known), masked latent 4; one network and one T2I adapter for each exposure.

The export functions are the ones to use for real weights: load a UNet, an autoencoder and, where there are any, adapters with
`diffusers`, and call `write_bundle` with them.
"""

import json
import os
import sys
import warnings

import numpy as np
import torch
from diffusers import AutoencoderKL, DDIMScheduler, T2IAdapter, UNet2DConditionModel
from safetensors.numpy import save_file
from torch import nn

from export import blake3

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from latent import plain  # noqa: E402

WIDTH, HEIGHT, FACTOR, SCALING = 128, 64, 8, 0.18215
TOKENS, TEXT = 5, 12
STEPS = 4
SCHEDULE = dict(num_train_timesteps=1000, beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear",
                prediction_type="v_prediction", timestep_spacing="trailing", rescale_betas_zero_snr=True)


class Encoder(nn.Module):
    def __init__(self, vae):
        super().__init__()
        self.vae = vae

    def forward(self, picture):
        return self.vae.encode(picture).latent_dist.mean


class Decoder(nn.Module):
    def __init__(self, vae):
        super().__init__()
        self.vae = vae

    def forward(self, latent):
        return self.vae.decode(latent).sample


class WithText(nn.Module):
    def __init__(self, unet):
        super().__init__()
        self.unet = unet

    def forward(self, sample, time, text):
        return self.unet(sample, time, text).sample


class WithAdapter(nn.Module):
    """A network whose prompt is fixed, and its adapter at full size, as one graph."""

    def __init__(self, unet, adapter, text):
        super().__init__()
        self.unet, self.adapter = unet, adapter
        self.register_buffer("text", text)

    def forward(self, sample, time, image):
        features = self.adapter(image)
        return self.unet(sample, time, self.text, down_intrablock_additional_residuals=list(features)).sample


def export(module, path, inputs, outputs):
    """Writes a graph; returns its entry of the manifest. `inputs` and `outputs`: role -> example."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(module, tuple(inputs.values()), path, opset_version=17, dynamo=False, do_constant_folding=True,
                          input_names=list(inputs), output_names=list(outputs))
    ports = lambda values: {k: {"name": k, "shape": list(v.shape)} for k, v in values.items()}
    return {"file": os.path.basename(path), "blake3": blake3(path), "inputs": ports(inputs), "outputs": ports(outputs)}


def write_bundle(folder, name, vae, denoisers, space, embeddings, licence="random weights, for tests"):
    """`denoisers`: role -> module; their inputs follow from `space` (docs/formats.md)."""
    os.makedirs(folder, exist_ok=True)
    h, w = HEIGHT // FACTOR, WIDTH // FACTOR
    channels = {"sample": 4, "masked_latent": 4, "normal_latent": 4, "mask": 1, "normal": 3}
    picture, latent = torch.zeros(1, 3, HEIGHT, WIDTH), torch.zeros(1, 4, h, w)
    for module in [vae, *denoisers.values()]:
        plain(module)
    graphs = {
        "encoder": export(Encoder(vae), f"{folder}/encoder.onnx", {"picture": picture}, {"latent": latent}),
        "decoder": export(Decoder(vae), f"{folder}/decoder.onnx", {"latent": latent}, {"picture": picture}),
    }
    inputs = {"sample": torch.zeros(1, sum(channels[c] for c in space["condition"]), h, w), "time": torch.zeros(1)}
    if embeddings:
        inputs["text"] = torch.zeros(1, TOKENS, TEXT)
        save_file(embeddings, f"{folder}/prompts.safetensors")
        space["prompts"] = {"file": "prompts.safetensors", "blake3": blake3(f"{folder}/prompts.safetensors"),
                            "unconditional": "none"}
    if space.get("image"):
        full = {"picture": 3, "mask": 1, "normal": 3}
        inputs["image"] = torch.zeros(1, sum(full[c] for c in space["image"]), HEIGHT, WIDTH)
    for role, module in denoisers.items():
        graphs[role] = export(module, f"{folder}/{role}.onnx", inputs, {"prediction": latent})
    manifest = {
        "format": "comgs-model", "version": 1, "name": name, "about": "Written by scripts/panorama/tiny_latent.py.",
        "licence": licence, "resolution": [WIDTH, HEIGHT],
        "space": {"kind": "latent", "channels": 4, "factor": FACTOR, "scaling": SCALING, "unknown": 0.0,
                  "tone": {"kind": "srgb"}, "white": {"quantile": 0.9, "value": 0.8}, **space},
        "schedule": {"timesteps": 1000, "betas": {"kind": "scaled_linear", "start": 0.00085, "end": 0.012},
                     "prediction": "v", "spacing": "trailing", "zero_terminal_snr": True, "final_alpha_one": True},
        "solver": "ddim", "steps": STEPS, "graphs": graphs,
    }
    with open(f"{folder}/model.json", "w") as f:
        json.dump(manifest, f, indent=1)
        f.write("\n")


def tiny_unet(seed):
    torch.manual_seed(seed)
    unet = UNet2DConditionModel(
        sample_size=(HEIGHT // FACTOR, WIDTH // FACTOR), in_channels=12, out_channels=4, layers_per_block=1,
        block_out_channels=(8, 8, 12, 12), cross_attention_dim=TEXT, attention_head_dim=4, norm_num_groups=4,
        down_block_types=("CrossAttnDownBlock2D",) * 3 + ("DownBlock2D",),
        up_block_types=("UpBlock2D",) + ("CrossAttnUpBlock2D",) * 3,
    ).eval()
    return unet


def tiny_vae(seed):
    torch.manual_seed(seed)
    vae = AutoencoderKL(block_out_channels=(4, 4, 8, 8), down_block_types=("DownEncoderBlock2D",) * 4,
                        up_block_types=("UpDecoderBlock2D",) * 4, norm_num_groups=4, latent_channels=4).eval()
    return vae


@torch.no_grad()
def walk(predict, noise):
    scheduler = DDIMScheduler(**SCHEDULE, clip_sample=False, set_alpha_to_one=True)
    scheduler.set_timesteps(STEPS)
    x = noise
    for t in scheduler.timesteps:
        x = scheduler.step(predict(x, t.float()[None]), t, x).prev_sample
    return x


@torch.no_grad()
def main():
    """What is expected comes from `diffusers` with its own attention and its own scheduler."""
    out = sys.argv[1]
    rng = np.random.default_rng(7)
    h, w = HEIGHT // FACTOR, WIDTH // FACTOR
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    known = (y > 24) & ~((x > 90) & (y < 50))
    picture = np.stack([np.sin(0.1 * x + c) * np.cos(0.07 * y * (c + 1)) for c in range(3)]).astype(np.float32) * known
    normal = np.stack([np.cos(0.05 * x), np.sin(0.05 * x), 0 * x]).astype(np.float32) * known
    noise = rng.standard_normal((4, h, w)).astype(np.float32)
    as_torch = lambda v: torch.from_numpy(np.ascontiguousarray(v))[None].float()
    vae = tiny_vae(1)
    masked = vae.encode(as_torch(picture)).latent_dist.mean * SCALING
    mask = as_torch(known[None])
    small_mask = mask[:, :, ::FACTOR, ::FACTOR]
    small_normal = torch.nn.functional.avg_pool2d(as_torch(normal), FACTOR)
    expected = {"noise": noise, "picture": picture, "normal": normal, "known": known.astype(np.float32),
                "encoded": masked[0].numpy()}

    unet = tiny_unet(2)
    embeddings = {k: rng.standard_normal((1, TOKENS, TEXT)).astype(np.float32) for k in ("bright", "dark", "none")}
    scale, ev_min = 2.5, -5.0
    for k, ev in enumerate((0.0, -2.5, -5.0)):
        text = torch.from_numpy(embeddings["bright"] + ev / ev_min * (embeddings["dark"] - embeddings["bright"]))
        free = torch.from_numpy(embeddings["none"])

        def predict(x, t):
            sample = torch.cat([x, masked, small_normal, 1 - small_mask], 1)
            a, b = unet(sample, t, text).sample, unet(sample, t, free).sample
            return b + scale * (a - b)

        expected[f"prompt_{k}"] = walk(predict, as_torch(noise))[0].numpy()
    decoded = vae.decode(torch.from_numpy(expected["prompt_0"])[None] / SCALING).sample
    expected["prompt_picture"] = decoded[0].numpy()
    # After the judge has run: writing changes how attention is computed.
    write_bundle(f"{out}/prompt", "tiny, as the paper", vae, {"denoiser": WithText(unet)},
                 {"condition": ["sample", "masked_latent", "normal", "mask"], "mask": "to_paint",
                  "guidance_scale": scale, "exposures": {"ev": [0.0, -2.5, -5.0], "by": {
                      "kind": "prompt", "ev_min": ev_min, "bright": "bright", "dark": "dark"}}}, embeddings)

    text = torch.from_numpy(embeddings["bright"])
    modules = {}
    for k in range(2):
        unet = tiny_unet(3 + k)
        torch.manual_seed(10 + k)
        adapter = T2IAdapter(in_channels=7, channels=[8, 8, 12, 12], num_res_blocks=1, downscale_factor=FACTOR,
                             adapter_type="full_adapter").eval()
        module = WithAdapter(unet, adapter, text).eval()
        modules[f"denoiser_{k}"] = module
        image = torch.cat([as_torch(picture), mask, as_torch(normal)], 1)
        sample = lambda x: torch.cat([x, small_normal, small_mask, masked], 1)
        expected[f"networks_{k}"] = walk(lambda x, t: module(sample(x), t, image), as_torch(noise))[0].numpy()
    write_bundle(f"{out}/networks", "tiny, as released", vae, modules,
                 {"condition": ["sample", "normal", "mask", "masked_latent"], "image": ["picture", "mask", "normal"],
                  "mask": "known", "exposures": {"ev": [0.0, -5.0], "by": {"kind": "network"}}}, None)
    save_file({k: np.ascontiguousarray(v) for k, v in expected.items()}, f"{out}/expected.safetensors")
    for name, value in expected.items():
        print(name, value.shape, float(np.abs(value).max()))


if __name__ == "__main__":
    main()
