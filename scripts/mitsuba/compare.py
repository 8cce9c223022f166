#!/usr/bin/env python3
"""The same scene and light in comgs and in Mitsuba 3: object and shadow ratio, and time per sample.

    pip install mitsuba numpy
    cargo build --release
    python scripts/mitsuba/compare.py --comgs target/release/comgs --work out/mitsuba

Writes a torus (OBJ), an environment map with a sun and a grey photo, lets `comgs insert --guidance none` render them, and
renders the same with Mitsuba's path integrator. The object is a metal: its reflectance is Schlick's with GGX in both programs
(Mitsuba's `principled` at metallic 1; its masking is Smith's without height correlation, ours with, which differs by less than
half a percent at this roughness). Dielectrics are not compared, because Disney's diffuse term is not in our model.

The expected noise is measured: the difference of two Mitsuba pictures with other seeds.
"""

import argparse
import json
import math
import pathlib
import shutil
import subprocess
import time

import mitsuba as mi
import numpy as np

WIDTH, HEIGHT, FOV_DEG = 192, 128, 45.0
CAMERA_HEIGHT, AT, HORIZON_ROW = 1.5, (4.0, 0.0), 40.0
ALBEDO, ROUGHNESS = (0.9, 0.7, 0.4), 0.3
SUN, SUN_SIGMA, SUN_RADIANCE = (-0.5, 0.55, 0.67), 0.1, 40.0
DEPTH = 3  # interactions along a path, as comgs has by default


def torus(path, ring=0.38, tube=0.14, n=96, m=48):
    """An OBJ with y up, standing upright on y = 0 so that it shades itself."""
    lines, faces = [f"mtllib {path.stem}.mtl"], []
    for j in range(n):
        a = 2 * math.pi * j / n
        for i in range(m):
            b = 2 * math.pi * i / m
            normal = (math.cos(a) * math.cos(b), math.sin(a) * math.cos(b), math.sin(b))
            r = ring + tube * math.cos(b)
            p = (r * math.cos(a), r * math.sin(a) + ring + tube, tube * math.sin(b))
            lines.append("v %.7f %.7f %.7f" % p)
            lines.append("vn %.7f %.7f %.7f" % normal)
            k = lambda j, i: (j % n) * m + i % m + 1
            faces.append((k(j, i), k(j + 1, i), k(j + 1, i + 1)))
            faces.append((k(j, i), k(j + 1, i + 1), k(j, i + 1)))
    lines.append("usemtl metal")
    lines += ["f " + " ".join(f"{c}//{c}" for c in f) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text(
        "newmtl metal\nKd %g %g %g\nPr %g\nPm 1\n" % (*ALBEDO, ROUGHNESS)
    )


def environment(height=256):
    """Equirectangular radiance, z up: a sky that darkens downwards, and a sun."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    theta, phi = np.pi - 2 * np.pi * u, np.pi * v
    d = np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)], -1)
    sun = np.array(SUN) / np.linalg.norm(SUN)
    glow = SUN_RADIANCE * np.exp((d @ sun - 1) / SUN_SIGMA**2)
    sky = 0.35 + 0.25 * d[..., 2]
    return np.stack([sky * 0.8 + glow, sky * 0.95 + 0.95 * glow, sky * 1.2 + 0.8 * glow], -1).astype(np.float32)


def layer(bitmap, names):
    """Channels of a multilayer EXR as an array."""
    fields = {field.name: k for k, field in enumerate(bitmap.struct_())}
    data = np.array(bitmap, copy=False).astype(np.float32)
    return data[..., [fields[name] for name in names]]


def scene(mesh, sensor, env, plane, black):
    bsdf = (
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
        if black
        else {
            "type": "principled",
            "base_color": {"type": "rgb", "value": list(ALBEDO)},
            "roughness": ROUGHNESS,
            "metallic": 1.0,
        }
    )
    # z up, and the azimuth's origin where comgs has it: local (x, y, z) of the map is world (z, x, y).
    turn = mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float))
    out = {
        "type": "scene",
        "sensor": sensor,
        "light": {"type": "envmap", "bitmap": mi.Bitmap(env), "to_world": turn},
    }
    if mesh is not None:
        # y up to z up, then onto the ground.
        up = np.array([[1, 0, 0, AT[0]], [0, 0, -1, AT[1]], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
        out["object"] = {
            "type": "obj", "filename": str(mesh), "to_world": mi.ScalarTransform4f(up),
            "material": {"type": "twosided", "bsdf": bsdf},
        }
    if plane:
        out["ground"] = {
            "type": "rectangle", "to_world": mi.ScalarTransform4f().scale(60.0),
            "material": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
        }
    return mi.load_dict(out)


def render(what, depth, samples, seed):
    integrator = mi.load_dict({"type": "path", "max_depth": depth + 1, "hide_emitters": True, "rr_depth": 64})
    started = time.perf_counter()
    image = np.array(mi.render(what, integrator=integrator, spp=samples, seed=seed))
    return image, time.perf_counter() - started


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--comgs", required=True, type=pathlib.Path)
    parser.add_argument("--work", required=True, type=pathlib.Path)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--variant", default="scalar_rgb", help="scalar_rgb, or llvm_ad_rgb where LLVM is installed")
    arguments = parser.parse_args()
    mi.set_variant(arguments.variant)
    work, samples = arguments.work, arguments.samples
    work.mkdir(parents=True, exist_ok=True)
    mesh, env, photo, out = work / "torus.obj", work / "env.exr", work / "photo.png", work / "comgs"
    # An unchanged run is not run again, and would not be timed.
    shutil.rmtree(out, ignore_errors=True)
    torus(mesh)
    radiance = environment()
    mi.Bitmap(radiance).write(str(env))
    mi.Bitmap(np.full((HEIGHT, WIDTH, 3), 128, np.uint8)).write(str(photo))
    subprocess.run(
        [
            arguments.comgs, "-q", "insert", "--image", photo, "--object", mesh, "--guidance", "none", "--light", env,
            "--camera", f"fov={FOV_DEG}", "--plane", f"horizon={HORIZON_ROW},{CAMERA_HEIGHT}",
            "--at", f"{AT[0]},{AT[1]}", "--samples", str(samples), "--response", "clip", "-o", out,
        ],
        check=True, stdout=subprocess.DEVNULL,
    )
    ours = mi.Bitmap(str(out / "layers.exr"))
    timings = {t["stage"]: t["seconds"] for t in json.loads((out / "run.json").read_text())["timings"]}

    # The same pose: the optical axis dips so that the horizon lies on its row.
    focal = 0.5 * WIDTH / math.tan(math.radians(FOV_DEG) / 2)
    dip = math.atan((0.5 * HEIGHT - HORIZON_ROW) / focal)
    origin = [0.0, 0.0, CAMERA_HEIGHT]
    target = [math.cos(dip), 0.0, CAMERA_HEIGHT - math.sin(dip)]
    sensor = {
        "type": "perspective", "fov": FOV_DEG, "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 0, 1]),
        "film": {
            "type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "pixel_format": "rgba", "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent"},
    }
    lit = scene(mesh, sensor, radiance, False, False)
    first, seconds = render(lit, DEPTH, samples, 1)
    second, _ = render(lit, DEPTH, samples, 2)
    bare, _ = render(scene(None, sensor, radiance, True, True), 1, samples, 3)
    shaded, ground_seconds = render(scene(mesh, sensor, radiance, True, True), 1, samples, 4)
    again, _ = render(scene(mesh, sensor, radiance, True, True), 1, samples, 5)

    mask = layer(ours, ["mask.Y"])[..., 0]
    inside = (mask >= 1) & (first[..., 3] >= 0.999)
    object_ours = layer(ours, ["radiance.R", "radiance.G", "radiance.B"])[inside]
    object_one, object_two = first[inside][:, :3], second[inside][:, :3]
    print(f"coverage: mean {mask.mean():.5f} comgs, {first[..., 3].mean():.5f} Mitsuba")
    report("object", object_ours, object_one, object_two)
    on_ground = (mask == 0) & (bare[..., 3] >= 0.999) & (bare[..., :3].min(-1) > 0)
    # Without the object the ground has one radiance; its mean is free of the bias that dividing by noise would have.
    unshaded = bare[on_ground][:, :3].mean(0)
    ratio = lambda image: image[on_ground][:, :3] / unshaded
    report("shadow ratio", layer(ours, ["shadow.R", "shadow.G", "shadow.B"])[on_ground], ratio(shaded), ratio(again))
    pixels = WIDTH * HEIGHT
    print(
        f"seconds for {pixels} pixels at {samples} samples: comgs {timings['render']:.1f} for object and shadow, "
        f"Mitsuba ({arguments.variant}) {seconds:.1f} for the object, {ground_seconds:.1f} for the ground with it; per "
        f"pixel sample {1e9 * timings['render'] / pixels / samples:.0f} ns against "
        f"{1e9 * (seconds + ground_seconds) / pixels / samples:.0f} ns"
    )


def report(name, ours, one, two):
    rmse = lambda a, b: float(np.sqrt(np.mean((a - b) ** 2)))
    truth = 0.5 * (one + two)
    print(
        f"{name}: {len(ours)} pixels, mean {ours.mean():.5f} comgs, {truth.mean():.5f} Mitsuba "
        f"({100 * (ours.mean() / truth.mean() - 1):+.2f} %); RMSE {rmse(ours, one):.5f}, "
        f"between two Mitsuba pictures {rmse(one, two):.5f}"
    )


if __name__ == "__main__":
    main()
