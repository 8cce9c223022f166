"""The whole way of personalise.py with a tiny model of random weights that is built as Stable Diffusion is.

    python test_personalise.py                                                    # checks
    python test_personalise.py ../../crates/comgs-insert/tests/fixtures/personalised   # and keeps the bundle, for tests/lds.rs
"""

import copy
import json
import os
import sys
import tempfile

import numpy as np
import onnxruntime
import torch
from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel
from PIL import Image
from transformers import CLIPTextConfig, CLIPTextModel

import latent_bundle
import lora
import personalise as p

SIDE, TOKENS, TEXT = 32, 20, 16


def tiny(seed=3):
    torch.manual_seed(seed)
    unet = UNet2DConditionModel(
        sample_size=SIDE // 4, in_channels=4, out_channels=4, layers_per_block=1, block_out_channels=(8, 16),
        cross_attention_dim=TEXT, attention_head_dim=4, norm_num_groups=4, use_linear_projection=True,
        down_block_types=("CrossAttnDownBlock2D", "DownBlock2D"), up_block_types=("UpBlock2D", "CrossAttnUpBlock2D"),
    )
    vae = AutoencoderKL(
        block_out_channels=(4, 8, 8), down_block_types=["DownEncoderBlock2D"] * 3, up_block_types=["UpDecoderBlock2D"] * 3,
        latent_channels=4, norm_num_groups=4, layers_per_block=1,
    )
    config = CLIPTextConfig(vocab_size=64, hidden_size=TEXT, intermediate_size=24, num_hidden_layers=2, num_attention_heads=2,
                            max_position_embeddings=TOKENS, bos_token_id=0, eos_token_id=1, pad_token_id=1)
    text = CLIPTextModel(config).eval()

    def embed(prompts):
        # Words by the sum of their letters; 0 begins, 1 ends and fills.
        words = [[2 + sum(map(ord, w)) % 62 for w in prompt.split()][: TOKENS - 2] for prompt in prompts]
        ids = [[0, *w] + [1] * (TOKENS - 1 - len(w)) for w in words]
        with torch.no_grad():
            return text(torch.tensor(ids)).last_hidden_state

    scheduler = DDIMScheduler(num_train_timesteps=1000, beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear",
                              prediction_type="epsilon", clip_sample=False, set_alpha_to_one=False, steps_offset=1)
    return p.Model(unet, vae, embed, scheduler, SIDE)


def fixed_loss(model, photo, prompt):
    """Mean loss over the same crops, steps and noise."""
    rng, g = np.random.default_rng(11), torch.Generator().manual_seed(11)
    torch.manual_seed(11)
    z = model.latents(torch.stack([p.crop(photo, SIDE, rng) for _ in range(64)]))
    t, noise = torch.randint(0, 1000, (64,), generator=g), torch.randn(z.shape, generator=g)
    with torch.no_grad():
        return p.loss_of(model, z, model.embed([prompt]).expand(64, -1, -1), t, noise).item()


def close(ours, truth, what, bound=1e-5):
    ours, truth = np.asarray(ours), np.asarray(truth)
    worst = np.abs(ours - truth).max() / np.abs(truth).max()
    print(f"{what}: {worst:.1e} of the largest entry")
    assert worst < bound, what


def check_graphs(folder, base, merged, vae, told):
    """The exported graphs against torch; returns what torch says."""
    run = lambda name, **inputs: onnxruntime.InferenceSession(os.path.join(folder, name + ".onnx")).run(
        None, {k: v.numpy() for k, v in inputs.items()})[0]
    g = torch.Generator().manual_seed(5)
    latent = (1, 4, SIDE // 4, SIDE // 4)
    z, time, picture = torch.randn(latent, generator=g), torch.tensor([250.0]), torch.rand(1, 3, SIDE, SIDE, generator=g) * 2 - 1
    grad = torch.randn(latent, generator=g)
    out = {"sample": z, "time": time, "picture": picture, "grad_latent": grad}
    with torch.no_grad():
        out["base"], out["personalised"] = (m(z, time, told).sample for m in (base, merged))
    close(run("base", sample=z, time=time, told=told), out["base"], "base network")
    close(run("personalised", sample=z, time=time, told=told), out["personalised"], "personalised network")
    assert (out["base"] - out["personalised"]).abs().max() > 1e-3 * out["base"].abs().max(), "they are the same"
    x = picture.clone().requires_grad_(True)
    out["latent"] = latent_bundle.Encoder(vae)(x)
    out["grad_picture"] = torch.autograd.grad(out["latent"], x, grad)[0]
    close(run("encoder", picture=picture), out["latent"].detach(), "encoder")
    close(run("encoder_vjp", picture=picture, grad_latent=grad), out["grad_picture"], "its vector-Jacobian product")
    return out


def main(folder):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:48, 0:64]
    pixels = np.stack([120 + 80 * np.sin(x / 6), 90 + y, 60 + 2 * x], -1) + rng.normal(0, 6, (48, 64, 3))
    photo = Image.fromarray(pixels.clip(0, 255).astype(np.uint8))
    model, concept = tiny(), "car"
    base = copy.deepcopy(model.unet)
    with tempfile.TemporaryDirectory() as work:
        arguments = (model, os.path.join(work, "class"), concept, 6, 3, 2.0, 0)
        images = p.class_images(*arguments)
        written = {n: os.path.getmtime(os.path.join(work, "class", n)) for n in os.listdir(os.path.join(work, "class"))}
        assert torch.equal(images, p.class_images(*arguments)) and len(written) == 6
        assert all(os.path.getmtime(os.path.join(work, "class", n)) == t for n, t in written.items()), "made again"
    prompts = p.prompts_of(concept, p.OUTDOOR, rng)
    assert len(set(prompts)) == p.OUTDOOR and all(t.startswith("a photo of a car, ") for t in prompts)

    before = fixed_loss(model, photo, p.SCENE)
    p.personalise(model, photo, concept, images, 300, rate=5e-3)
    after = fixed_loss(model, photo, p.SCENE)
    print(f"loss of the scene {before:.4f} -> {after:.4f}")
    assert after < 0.97 * before
    size = sum(w.numel() for w in lora.weights(model.unet).values())
    everything = sum(w.numel() for w in base.parameters())
    print(f"{size} of {everything} parameters were trained")

    z, t, told = torch.randn(2, 4, SIDE // 4, SIDE // 4), torch.tensor([40, 700]), model.embed([p.SCENE, "a car"])
    with torch.no_grad():
        applied = model.unet(z, t, told).sample
        merged = lora.merge(copy.deepcopy(model.unet))
        close(merged(z, t, told).sample, applied, "merged against applied")
    for name, weight in base.named_parameters():
        if name.endswith(tuple(f"{target}.weight" for target in lora.TARGETS)):
            continue
        assert torch.equal(weight, merged.get_parameter(name)), f"{name} was trained"

    with tempfile.TemporaryDirectory() as work:
        half = copy.deepcopy((base, merged, model.vae))
        prompts = {"empty": ("", model.embed([""])), "prompt": ("x", model.embed(["x"]))}
        latent_bundle.SMALL = 64
        latent_bundle.write(work, "half", *half, model.scheduler.config, prompts, SIDE, "none", half=True)
        print("in half precision:")
        check_graphs(work, *half, prompts["prompt"][1])
        small = sum(os.path.getsize(os.path.join(work, f)) for f in ("base.onnx", "personalised.onnx"))
    with tempfile.TemporaryDirectory() as work:
        out = folder or work
        p.export(out, model, base, concept, "random weights, for tests", more=["a photo of a red car"])
        full = sum(os.path.getsize(os.path.join(out, f)) for f in ("base.onnx", "personalised.onnx"))
        print(f"networks: {full} bytes, {small} in half precision")
        assert small < full
        told = model.embed([p.BOTH.format(concept=concept)])
        truth = check_graphs(out, base, model.unet, model.vae, told)
        if folder:
            flat = {k: [round(float(v), 7) for v in t.detach().flatten()] for k, t in truth.items()}
            with open(os.path.join(out, "expected.json"), "w") as f:
                json.dump(flat, f)
                f.write("\n")
    print("all is well")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
