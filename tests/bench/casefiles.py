"""What the cases of same_bytes.py are, and the PNG and EXR files that they start from; no hpcomp."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Rng = np.random.Generator
Planes = Mapping[str, np.ndarray]

COMPRESSIONS = {
    "none": OpenEXR.NO_COMPRESSION,
    "rle": OpenEXR.RLE_COMPRESSION,
    "zips": OpenEXR.ZIPS_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "pxr24": OpenEXR.PXR24_COMPRESSION,
    "b44": OpenEXR.B44_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
}
#: xy of red, green, blue and white: ITU-R BT.2020, SMPTE EG 432-1, Academy S-2014-004.
PRIMARIES = {
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "display-p3": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "acescg": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
}
#: Linear hues that pictures of labels are made of: two of them count as equal, two are opposite.
LABELS = np.array(
    [(0.8, 0.05, 0.05), (0.78, 0.05, 0.06), (0.05, 0.1, 0.8), (0.9, 0.6, 0.02), (0.1, 0.8, 0.75)]
)


@dataclass(frozen=True)
class Case:
    """A script of a POSIX shell, run in a folder of its own in which `put_inputs` has put files."""

    group: str
    number: int
    script: str
    put_inputs: Callable[[Path], None]

    @property
    def name(self) -> str:
        return f"{self.group}/{self.number:03}"


def straight(rng: Rng, width: int, height: int) -> np.ndarray:
    """(height, width, 4) in [0, 1], not premultiplied: noise, or patches of labels."""
    if rng.random() < 0.3:
        return rng.random((height, width, 4))
    cell = int(rng.integers(1, 12))
    rows, columns = np.arange(height) // cell, np.arange(width) // cell
    which = rng.integers(0, len(LABELS), (rows[-1] + 1, columns[-1] + 1))[np.ix_(rows, columns)]
    alpha = rng.choice([0, 0.25, 0.5, 1, rng.random()], which.shape)[..., None]
    shade = rng.choice([1, rng.uniform(0.3, 1)]) + np.linspace(-0.2, 0, width)[:, None]
    return np.concatenate([LABELS[which] * shade, alpha], axis=2)


#: The color types of PNG, and the channels of `straight` that each has.
PNG_KINDS = {"grey": (0, [0]), "rgb": (2, [0, 1, 2]), "grey-alpha": (4, [0, 3]), "rgba": (6, [0, 1, 2, 3])}  # fmt: skip
PNG_LIGHT = {
    "nothing": b"",
    "srgb": struct.pack(">I4sB", 1, b"sRGB", 0),
    "gamma": struct.pack(">I4sI", 4, b"gAMA", 100000),
    "p3": struct.pack(">I4s4B", 4, b"cICP", 12, 13, 0, 1),
}


def write_png(
    path: Path, pixels: np.ndarray, kind: str = "rgba", bits: int = 8, light: str = "nothing"
) -> None:
    """A PNG of some channels of `straight`, with a chunk that says what its light is."""
    color_type, channels = PNG_KINDS[kind]
    codes = np.round(pixels[..., channels] * (2**bits - 1)).astype(f">u{bits // 8}")
    height, width = codes.shape[:2]
    rows = np.frombuffer(codes.tobytes(), "u1").reshape(height, -1)
    filtered = np.concatenate([np.zeros((height, 1), "u1"), rows], axis=1)
    header = struct.pack(">IIBBBBB", width, height, bits, color_type, 0, 0, 0)
    chunks = [struct.pack(">I4s", 13, b"IHDR") + header, PNG_LIGHT[light]]
    data = zlib.compress(filtered.tobytes())
    chunks += [struct.pack(">I4s", len(data), b"IDAT") + data, struct.pack(">I4s", 0, b"IEND")]
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(c + struct.pack(">I", zlib.crc32(c[4:])) for c in chunks if c)
    )


def planes(pixels: np.ndarray, prefix: str = "", dtype: Any = np.float16) -> dict[str, np.ndarray]:
    """Premultiplied channels of `straight`, as EXR has them."""
    colors = {c: pixels[..., i] * pixels[..., 3] for i, c in enumerate("RGB")}
    return {prefix + c: p.astype(dtype) for c, p in {**colors, "A": pixels[..., 3]}.items()}


def exr_part(
    channels: Planes,
    name: str = "",
    *,
    origin: tuple[int, int] = (0, 0),
    display: tuple[int, int, int, int] | None = None,
    compression: str = "zip",
    tile: int = 0,
    deep: bool = False,
    **attributes: Any,
) -> Any:
    """A part for `write_exr`; `origin` is its data window's, `display` is x, y, width, height."""
    height, width = next(iter(channels.values())).shape
    (x, y), (dx, dy, across, down) = origin, display or (*origin, width, height)
    header = {
        "compression": COMPRESSIONS[compression],
        "type": OpenEXR.deepscanline if deep else OpenEXR.scanlineimage,
        "dataWindow": ((x, y), (x + width - 1, y + height - 1)),
        "displayWindow": ((dx, dy), (dx + across - 1, dy + down - 1)),
        **attributes,
    }
    if tile:
        description = OpenEXR.TileDescription()
        description.xSize = description.ySize = tile
        header |= {"type": OpenEXR.tiledimage, "tiles": description}
    return OpenEXR.Part(header, dict(channels), name)


def write_exr(path: Path, *parts: Any) -> None:
    OpenEXR.File(list(parts)).write(str(path))


def deep_planes(rng: Rng, width: int, height: int, most: int, volumes: bool) -> Planes:
    """Up to `most` samples a pixel at a few depths, so that some are at one place or overlap."""
    names = ("R", "G", "B", "A", "Z", *(["ZBack"] if volumes else []))
    out = {name: np.empty((height, width), object) for name in names}
    for at in np.ndindex(height, width):
        count = int(rng.integers(0, most + 1))
        alpha = rng.choice([0.25, 0.5, 1, rng.random()], count)
        color = LABELS[rng.integers(0, len(LABELS), count)] * alpha[:, None]
        front = rng.integers(1, 6, count)
        values = [*color.T, alpha, front, front + rng.integers(0, 4, count)]
        for name, samples in zip(names, values, strict=False):
            out[name][at] = samples.astype(np.float32)
    return out
