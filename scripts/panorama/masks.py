"""Picks the masks that completers are judged with: ten a group of coverage, from walks of cameras through places that are
not in the training set (seeds from 100000 on, see README.md)."""

import glob
import os
import sys

import numpy as np
from PIL import Image

from data import solid_angles

source, output = sys.argv[1:3]
os.makedirs(output, exist_ok=True)
groups = {"40": (0.42, 0.6), "60": (0.6, 0.8), "80": (0.8, 0.97)}
counts = dict.fromkeys(groups, 0)
solid = solid_angles()
for path in sorted(glob.glob(os.path.join(source, "*_seen.png"))):
    mask = np.asarray(Image.open(path).convert("L")) > 127
    coverage = (mask * solid).sum() / (4 * np.pi)
    for name, (low, high) in groups.items():
        if low <= coverage < high and counts[name] < 10:
            counts[name] += 1
            picture = Image.fromarray((mask * 255).astype(np.uint8)).convert("1")
            picture.save(os.path.join(output, f"{name}_{counts[name]:02}.png"), optimize=True)
print(counts)
