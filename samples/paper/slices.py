"""Looks at a phantom and writes what the viewing rays meet: RGBA slices, half-float EXR.

    python slices.py VOLUME SIZE SLICES DIRECTORY

writes SLICES files of SIZE x SIZE pixels, 000.exr in front. A 1D transfer function gives every
data value a colour, which is that of one label, and an opacity; the gradient shades it. Light only
scales a colour or adds white, so that a slice has no hues but those of the labels. Nothing is
composited here: hpcomp does that, from the back slice to the front one. Running twice gives the
same bytes, and slices that an earlier run wrote beyond the last one are removed.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import OpenEXR
from phantoms import PHANTOMS


@dataclass(frozen=True)
class Material:
    """A label: its sRGB colour, the data values that it stands for, its extinction per unit.

    The extinction rises from 0 at `low` and falls to 0 at `high`, each over RAMP.
    """

    name: str
    color: str
    low: float
    high: float
    extinction: float


@dataclass(frozen=True)
class Volume:
    """A phantom, its transfer function, and from where it is seen.

    `turn`, `nod`: degrees about the vertical and then about the horizontal axis. `depth`: the rays
    are sampled where |z| is less, z being 0 in the middle.
    """

    phantom: str
    materials: tuple[Material, ...]
    turn: float
    nod: float
    depth: float


# fmt: off
TOMATO = (
    Material("peel",    "#e60024", 0.10, 0.34, 64.0),
    Material("flesh",   "#ff9a00", 0.34, 0.70, 1.3),
    Material("seeds",   "#ffe600", 0.70, 1.00, 60.0),
)
TOOTH = (
    Material("enamel",  "#ffd800", -0.50, -0.15, 1.5),
    Material("dentine", "#f00028", 0.20, 0.65, 2.0),
    Material("pulp",    "#0038ff", 0.65, 1.00, 30.0),
)
FISH = (
    Material("flesh",   "#f01446", 0.10, 0.55, 3.6),
    Material("bones",   "#f08c00", 0.62, 1.00, 60.0),
)
PIGGY_BANK = (
    Material("pig",     "#be00dc", 0.10, 0.50, 4.9),
    Material("coins",   "#1446ff", -0.70, -0.25, 60.0),
)
CHEST = (
    Material("flesh",   "#0000ff", 0.15, 0.60, 2.3),
    Material("bones",   "#ffff00", 0.62, 1.00, 30.0),
)
FROG = (
    Material("flesh",   "#ff0000", 0.15, 0.60, 2.0),
    Material("brain",   "#00ff00", 0.62, 1.00, 20.0),
)
# fmt: on
# All three of one luminance; with them the tooth takes little more than half of the energy.
ENERGY = ("#3c6ec8", "#ad5560", "#517c00")

VOLUMES = {
    "tomato": Volume("tomato", TOMATO, turn=10, nod=28, depth=0.86),
    "tooth": Volume("tooth", TOOTH, turn=28, nod=8, depth=0.62),
    "fish": Volume("fish", FISH, turn=-24, nod=-8, depth=0.62),
    "piggy-bank": Volume("piggy-bank", PIGGY_BANK, turn=-28, nod=12, depth=0.80),
    "chest-opposite": Volume("chest", CHEST, turn=16, nod=4, depth=0.62),
    "chest-cyan": Volume(
        "chest", (replace(CHEST[0], color="#00c8ff"), CHEST[1]), turn=16, nod=4, depth=0.62
    ),
    "frog-flesh": Volume("frog", FROG[:1], turn=0, nod=12, depth=0.55),
    "frog-brain": Volume("frog", FROG[1:], turn=0, nod=12, depth=0.55),
    "tooth-energy": Volume(
        "tooth",
        tuple(replace(m, color=c) for m, c in zip(TOOTH, ENERGY, strict=True)),
        turn=28,
        nod=8,
        depth=0.62,
    ),
}

LIGHT = np.array([-0.45, -0.60, -0.66])  # from the upper left, in front
TO_VIEWER = np.array([0, 0, -1])
AMBIENT, DIFFUSE, SHINE, SHININESS = 0.35, 0.65, 0.30, 28
RAMP = 0.12  # data values over which a label fades in or out
SUBSAMPLES = 0.125, 0.375  # of the way from a sample to the one before it, and to the one after
FLAT = 3.0  # gradients below this, in data values per unit, do not say where a surface faces
TRANSPARENT = 1 / 2048  # opacities below this are left out: files stay small


def linear_rgb(color: str) -> np.ndarray:
    """A CSS colour, #rrggbb, as linear light 0-1 (3,). IEC 61966-2-1."""
    encoded = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def rotation(turn: float, nod: float) -> np.ndarray:
    """Object from view coordinates."""
    (st, ct), (sn, cn) = ((np.sin(a), np.cos(a)) for a in np.radians([turn, nod]))
    about_vertical = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    about_horizontal = np.array([[1, 0, 0], [0, cn, -sn], [0, sn, cn]])
    return about_vertical @ about_horizontal


def fields(volume: Volume, size: int, slices: int) -> Iterator[np.ndarray]:
    """Data values (size, size) float32, from in front of the first slice to behind the last."""
    turned = rotation(volume.turn, volume.nod).astype(np.float32)
    right = ((np.arange(size, dtype=np.float32) + 0.5) * 2 / size - 1)[None, :]
    down = right.T
    for k in range(-1, slices + 1):
        away = np.float32(((k + 0.5) * 2 / slices - 1) * volume.depth)
        x, y, z = (
            np.ascontiguousarray(np.broadcast_to(row[0] * right + row[1] * down + row[2] * away,
                                                 (size, size)))
            for row in turned
        )  # fmt: skip
        yield PHANTOMS[volume.phantom](x, y, z).astype(np.float32)


def shading(before: np.ndarray, here: np.ndarray, after: np.ndarray, steps: tuple[float, float]):
    """How bright a surface is, and how much of a white highlight lies on it, each 0-1."""
    pixel, between = steps
    before, here, after = np.abs(before), np.abs(here), np.abs(after)  # 0 is air
    down, right = np.gradient(here, pixel)
    gradient = np.stack([right, down, (after - before) / (2 * between)])
    size = np.sqrt((gradient**2).sum(axis=0))
    normal = -gradient / np.maximum(size, 1e-6)  # values rise inwards
    light = LIGHT / np.linalg.norm(LIGHT)
    halfway = light + TO_VIEWER
    halfway /= np.linalg.norm(halfway)
    surface = np.clip(size / FLAT, 0, 1)
    # Both sides of a wall are lit: what is inside is seen through it.
    lit = np.abs(np.tensordot(light, normal, 1))
    bright = AMBIENT + DIFFUSE * (surface * lit + (1 - surface) * 0.7)
    shine = SHINE * surface * np.clip(np.tensordot(halfway, normal, 1), 0, 1) ** SHININESS
    return bright, shine


def extinction(material: Material, values: list[np.ndarray]) -> np.ndarray:
    """The mean of its extinction per unit at these data values."""
    inside = sum(
        np.clip(np.minimum(v - material.low, material.high - v), 0, np.float32(RAMP))
        for v in values
    )
    return inside * np.float32(material.extinction / RAMP / len(values))


def box_of(seen: np.ndarray) -> tuple[slice, slice]:
    """The rows and the columns where it is true, and one more on each side."""
    found = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(max(i[0] - 1, 0), i[-1] + 2) if i.size else slice(0) for i in found)
    return rows, columns


def slices_of(volume: Volume, size: int, slices: int) -> Iterator[np.ndarray]:
    """Premultiplied linear RGBA (size, size, 4) float32, the front one first."""
    steps = 2 / size, 2 * volume.depth / slices
    colors = np.array([linear_rgb(m.color) for m in volume.materials], np.float32)
    before = here = None
    for after in fields(volume, size, slices):
        if before is not None:
            rgba = np.zeros((size, size, 4), np.float32)
            box = box_of((before != 0) | (here != 0) | (after != 0))
            if rgba[box].size:
                rgba[box] = one_slice(volume.materials, colors, before[box], here[box], after[box],
                                      steps)  # fmt: skip
            yield rgba
        before, here = here, after


def one_slice(
    materials: tuple[Material, ...],
    colors: np.ndarray,
    before: np.ndarray,
    here: np.ndarray,
    after: np.ndarray,
    steps: tuple[float, float],
) -> np.ndarray:
    """What `here` looks like; its opacity is the mean along the slice, or a thin layer between
    two samples would be missed and seen as contours."""
    values = [here + np.float32(part) * (there - here)
              for there in (before, after) for part in SUBSAMPLES]  # fmt: skip
    found = [extinction(material, values) for material in materials]
    label = np.argmax(found, axis=0)  # one label, or the slice would have mixed hues
    alpha = 1 - np.exp(-np.maximum.reduce(found) * np.float32(steps[1]))
    alpha[alpha < TRANSPARENT] = 0
    bright, shine = shading(before, here, after, steps)
    color = ((1 - shine) * bright)[..., None] * colors[label] + shine[..., None]
    return np.concatenate([color * alpha[..., None], alpha[..., None]], axis=-1)


def save_exr(path: Path, rgba: np.ndarray) -> None:
    """Half-float, linear, premultiplied; the data window holds only what is not transparent."""
    height, width = rgba.shape[:2]
    seen = rgba[..., 3] > 0
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    top, bottom = (rows[0], rows[-1]) if rows.size else (0, 0)
    left, right = (columns[0], columns[-1]) if columns.size else (0, 0)
    part = rgba[top : bottom + 1, left : right + 1]
    channels = {
        name: np.ascontiguousarray(part[..., i], dtype=np.float16) for i, name in enumerate("RGBA")
    }
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": (np.array([left, top], np.int32), np.array([right, bottom], np.int32)),
        "displayWindow": (np.zeros(2, np.int32), np.array([width - 1, height - 1], np.int32)),
    }
    # Under its name a file is whole, whenever this is interrupted.
    half_made = path.with_name(f".{path.name}")
    OpenEXR.File(header, channels).write(str(half_made))
    os.replace(half_made, path)


def write_slices(name: str, size: int, slices: int, directory: Path) -> None:
    directory.mkdir(parents=True, exist_ok=True)
    for number, rgba in enumerate(slices_of(VOLUMES[name], size, slices)):
        save_exr(directory / f"{number:03}.exr", rgba)
    # Those of an earlier run with more slices do not belong to this one.
    for path in directory.glob("*.exr"):
        if path.stem.isdecimal() and int(path.stem) >= slices:
            path.unlink()


if __name__ == "__main__":
    name, size, slices, directory = sys.argv[1:]
    write_slices(name, int(size), int(slices), Path(directory))
