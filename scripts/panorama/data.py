"""Panoramas, masks, and what a completer is given of them. numpy only."""

import glob
import os

import numpy as np
import OpenEXR
from PIL import Image

from model import HEIGHT, MIDDLE, WIDTH


def read_exr(path):
    channels = OpenEXR.File(path).channels()
    if "RGB" in channels:
        return channels["RGB"].pixels.astype(np.float32)
    return np.stack([channels[k].pixels for k in "RGB"], -1).astype(np.float32)


def solid_angles(height=HEIGHT, width=WIDTH):
    """Steradians of the texels of each row, (H, 1)."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return ((edges[:-1] - edges[1:]) * 2 * np.pi / width)[:, None].astype(np.float32)


def directions(height=HEIGHT, width=WIDTH):
    """(3, H, W), z up, the image's centre along +x (docs/conventions.md)."""
    theta = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width
    phi = np.pi * (np.arange(height) + 0.5) / height
    sin = np.sin(phi)[:, None]
    return np.stack(
        [sin * np.cos(theta), sin * np.sin(theta), np.cos(phi)[:, None] * np.ones(width)]
    ).astype(np.float32)


def reduced(image):
    """Mean over blocks down to HEIGHT x WIDTH."""
    factor = image.shape[0] // HEIGHT
    shape = (HEIGHT, factor, WIDTH, factor, image.shape[2])
    return image.reshape(shape).astype(np.float64).mean((1, 3)).astype(np.float32)


#: Every third map by name is for the final judgement and never read here; three of the others validate.
def hdri_split(folder):
    names = sorted(glob.glob(os.path.join(folder, "*.exr")))
    test = names[1::3]
    rest = [n for n in names if n not in test]
    validation = rest[::8]
    return [n for n in rest if n not in validation], validation, test


class Library:
    def __init__(self, hdri_folder, synthetic_folder, limit=None, blended=0.0):
        self.blended = blended
        train, validation, _ = hdri_split(hdri_folder)
        self.maps = [reduced(read_exr(n)).transpose(2, 0, 1) for n in train]
        self.validation_maps = [reduced(read_exr(n)).transpose(2, 0, 1) for n in validation]
        self.folder, self.limit = synthetic_folder, limit
        self.names, self.synthetic, self.normals, self.masks = [], [], [], []
        self.direction = directions()
        self.solid = solid_angles()
        self.refresh()

    #: The first so many synthetic panoramas are for validation.
    HELD = 24

    def refresh(self):
        """Reads synthetic panoramas that were added since: rendering may go on beside training."""
        names = sorted(glob.glob(os.path.join(self.folder, "?????.exr")))[: self.limit]
        for name in names[len(self.names) :]:
            self.names.append(name)
            self.synthetic.append(read_exr(name).transpose(2, 0, 1))
            normal = read_exr(name.replace(".exr", "_normal.exr"))
            self.normals.append(normal.transpose(2, 0, 1).astype(np.float16))
            self.masks.append(np.asarray(Image.open(name.replace(".exr", "_seen.png")).convert("L")) > 127)

    def coverage(self, mask):
        return float((mask * self.solid).sum() / (4 * np.pi))

    def mask(self, rng, index=None):
        """A sweep's mask, with regions dropped as the ComGS paper does, of 15 to 98 % coverage."""
        for _ in range(20):
            mask = self.masks[rng.integers(self.HELD, len(self.masks)) if index is None else index].copy()
            if index is None:
                mask = np.roll(mask, rng.integers(WIDTH), 1)
                if rng.random() < 0.3:
                    other = self.masks[rng.integers(self.HELD, len(self.masks))]
                    mask |= np.roll(other, rng.integers(WIDTH), 1)
            for _ in range(rng.integers(0, 4)):
                h, w = rng.integers(4, 28), rng.integers(6, 48)
                y, x = rng.integers(HEIGHT), rng.integers(WIDTH)
                columns = np.arange(x, x + w) % WIDTH
                mask[y : y + h, columns] = rng.random() < 0.25
            if 0.15 < self.coverage(mask) < 0.98:
                return mask
        return mask

    def sample(self, rng, hdri_share=0.4, validate=False):
        """One example: (truth over level, condition, known mask, clip level map), canonical yaw."""
        if rng.random() < hdri_share:
            maps = self.validation_maps if validate else self.maps
            image = maps[rng.integers(len(maps))].copy()
            image = np.roll(image, rng.integers(WIDTH), 2)
            normal = np.zeros_like(image)
            mask = self.mask(rng)
            if not validate and rng.random() < self.blended:
                # The geometric mean with another map, turned and in its own scale: places that lie between two photographs.
                other = np.roll(maps[rng.integers(len(maps))], rng.integers(WIDTH), 2)
                share = rng.uniform(0.05, 0.4)
                level = lambda v: np.log(np.maximum(v, 1e-6))
                a, b = level(image), level(other)
                image = np.exp(a + share * (b - b.mean() - (a - a.mean()))).astype(np.float32)
            if not validate and rng.random() < 0.5:
                # Contrast, and a slow gain over the sphere: more rooms than there are maps.
                image = np.maximum(image, 0) ** rng.uniform(0.85, 1.15)
                tilt = np.tensordot(rng.normal(0, 0.3, 3), self.direction, 1)
                image = image * np.exp(tilt)
        else:
            count = len(self.synthetic)
            index = rng.integers(self.HELD) if validate else rng.integers(self.HELD, count)
            image = self.synthetic[index].copy()
            normal = self.normals[index].astype(np.float32)
            mask = self.mask(rng, index) if rng.random() < 0.7 else self.mask(rng)
            if rng.random() < 0.3:
                normal = np.zeros_like(normal)
        if rng.random() < 0.5:
            image, mask = image[..., ::-1], mask[..., ::-1]
            normal = normal[..., ::-1] * np.array([1, -1, 1], np.float32)[:, None, None]
        white = np.exp(rng.normal(0, 0.15, 3)).astype(np.float32)
        image = np.maximum(image * white[:, None, None], 0)
        clip = None
        if rng.random() < 0.5:
            values = image.max(0)[mask]
            clip = np.quantile(values, rng.uniform(0.8, 0.999)) if values.size else None
        return self.prepare(image.astype(np.float32), mask, normal, clip)

    def prepare(self, image, mask, normal, clip):
        """What a completer is given. `image` (3, H, W) linear, `mask` (H, W) bool, `clip` the level above which the photos
        say only "at least this"."""
        clipped = mask & (image.max(0) >= clip) if clip is not None else np.zeros_like(mask)
        partial = np.minimum(image, clip) if clip is not None else image
        partial = partial * mask
        weight = self.solid * mask
        luminance = partial.mean(0)
        total = max(weight.sum(), 1e-9)
        mean = (weight * luminance).sum() / total
        level = float(np.exp((weight * np.log(np.maximum(luminance, 1e-3 * mean + 1e-12))).sum() / total)) / MIDDLE
        known = mask & ~clipped
        # Canonical yaw: the brighter side of what was seen is in the middle, so that turning the input turns the output.
        soft = weight * (luminance / level) / (1 + luminance / level)
        theta = np.arctan2((soft * self.direction[1]).sum(), (soft * self.direction[0]).sum())
        shift = int(np.floor(theta / (2 * np.pi) * WIDTH + 0.5))
        roll = lambda v: np.roll(v, shift, -1)
        angle = shift * 2 * np.pi / WIDTH
        c, s = np.cos(angle), np.sin(angle)
        # Rolling right by `shift` texels turns directions by -angle about z.
        turned = np.stack([c * normal[0] + s * normal[1], -s * normal[0] + c * normal[1], normal[2]])
        truth = roll(image / level)
        return {
            "truth": np.ascontiguousarray(truth).astype(np.float32),
            "partial": np.ascontiguousarray(roll(partial / level)).astype(np.float32),
            "known": np.ascontiguousarray(roll(known)),
            "clipped": np.ascontiguousarray(roll(clipped)),
            "normal": np.ascontiguousarray(roll(turned * mask)).astype(np.float32),
            "shift": shift,
            "level": level,
        }
