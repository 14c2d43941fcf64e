"""EXR files made for the tests, what they mean in float64, and ways to damage them; no hpcomp."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

Box = tuple[int, int, int, int]  # x, y, width, height
Planes = Mapping[str, np.ndarray]

COMPRESSIONS = {
    "none": OpenEXR.NO_COMPRESSION,
    "rle": OpenEXR.RLE_COMPRESSION,
    "zips": OpenEXR.ZIPS_COMPRESSION,
    "zip": OpenEXR.ZIP_COMPRESSION,
    "piz": OpenEXR.PIZ_COMPRESSION,
    "pxr24": OpenEXR.PXR24_COMPRESSION,
    "b44": OpenEXR.B44_COMPRESSION,
    "b44a": OpenEXR.B44A_COMPRESSION,
    "dwaa": OpenEXR.DWAA_COMPRESSION,
    "dwab": OpenEXR.DWAB_COMPRESSION,
    "htj2k256": OpenEXR.HTJ2K256_COMPRESSION,
    "htj2k32": OpenEXR.HTJ2K32_COMPRESSION,
    "lj2k": OpenEXR.LJ2K_COMPRESSION,
    "zstd": OpenEXR.ZSTD_COMPRESSION,
}
LOSSY = {"b44", "b44a", "dwaa", "dwab"}
LINE_ORDERS = {"increasing": OpenEXR.INCREASING_Y, "decreasing": OpenEXR.DECREASING_Y}

# xy of red, green, blue, white: ITU-R BT.709 and BT.2020, SMPTE EG 432-1 and
# ST 2065-1, Academy S-2014-004.
PRIMARIES = {
    "rec709": (0.640, 0.330, 0.300, 0.600, 0.150, 0.060, 0.3127, 0.3290),
    "rec2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "p3d65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "ap1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
}


# ---- pixels ---------------------------------------------------------------------------------


def planes(names: str | Sequence[str], width: int, height: int, dtype: Any = np.float16, seed=0):
    """Random values in [0, 1) for each channel; for uint channels whole numbers below 100."""
    rng = np.random.default_rng([seed, width, height])
    out = {}
    for name in names:
        values = rng.random((height, width))
        out[name] = (values * (100 if np.issubdtype(dtype, np.unsignedinteger) else 1)).astype(
            dtype
        )
    return out


def rgba(width: int = 23, height: int = 19, dtype: Any = np.float16, seed: int = 0):
    """Premultiplied RGBA planes; among them HDR, glow (alpha 0 with colour), negative colour."""
    out = planes("RGBA", width, height, dtype, seed)
    for name in "RGB":
        out[name] = (out[name] * out["A"]).astype(dtype)
    out["A"][0, :3] = 0, 0, 1
    out["R"][0, :3] = 0, 0.25, 17
    out["G"][0, :3] = 0, 0.5, -0.125
    out["B"][0, :3] = 0, 1, 0
    return out


def coarse(names: str = "RGBA", width: int = 20, height: int = 40, dtype: Any = np.float16, seed=0):
    """Values of few steps, which deflate well: a chunk that does not shrink has no checksum."""
    return {
        name: (np.floor(plane.astype(float) * 9) / 8).astype(dtype)
        for name, plane in planes(names, width, height, np.float32, seed).items()
    }


def layer(channels: Planes, names: Sequence[str | None] = tuple("RGBA")) -> np.ndarray:
    """(h, w, 4) float64 that these channels mean: no alpha is opaque, alpha is held to [0, 1]."""
    height, width = next(iter(channels.values())).shape
    out = np.zeros((height, width, 4))
    for i, name in enumerate(names):
        out[..., i] = 1.0 if name is None else channels[name].astype(float)
    out[..., 3] = np.clip(out[..., 3], 0.0, 1.0)
    return out


# ---- files by the OpenEXR module ------------------------------------------------------------


def header(
    channels: Planes,
    *,
    origin: tuple[int, int] = (0, 0),
    display: Box | None = None,
    compression: str = "zip",
    tile: tuple[int, int] | None = None,
    line_order: str = "increasing",
    pixel_aspect: float = 1.0,
    deep: bool = False,
    **attributes: Any,
) -> dict[str, Any]:
    """A header for `OpenEXR.Part`; `origin` is the data window's, whose size the planes have."""
    height, width = next(iter(channels.values())).shape
    x, y = origin
    dx, dy, display_width, display_height = display or (x, y, width, height)
    out: dict[str, Any] = {
        "compression": COMPRESSIONS[compression],
        "type": OpenEXR.scanlineimage,
        "lineOrder": LINE_ORDERS[line_order],
        "dataWindow": ((x, y), (x + width - 1, y + height - 1)),
        "displayWindow": ((dx, dy), (dx + display_width - 1, dy + display_height - 1)),
        "pixelAspectRatio": pixel_aspect,
        **attributes,
    }
    if tile:
        description = OpenEXR.TileDescription()
        description.xSize, description.ySize = tile
        out.update(type=OpenEXR.tiledimage, tiles=description)
    if deep:
        out["type"] = OpenEXR.deepscanline
    return out


def write(path: Path, channels: Planes, **options: Any) -> Path:
    """One part with these planes."""
    # The module turns the arrays of a dict that it is given into its own objects: pass copies.
    OpenEXR.File(header(channels, **options), dict(channels)).write(str(path))
    return path


def write_parts(path: Path, parts: Sequence[tuple[str, Planes, Mapping[str, Any]]]) -> Path:
    """A multi-part file of (name, planes, options)."""
    made = [
        OpenEXR.Part(header(channels, **options), dict(channels), name)
        for name, channels, options in parts
    ]
    OpenEXR.File(made).write(str(path))
    return path


def write_deep(path: Path, width: int = 5, height: int = 4) -> Path:
    """A deep scanline file with 0 to 2 samples a pixel."""
    channels = {}
    for name in "RGBAZ":
        samples = np.empty((height, width), object)
        for y, x in np.ndindex(height, width):
            samples[y, x] = np.full((x + y) % 3, 0.5, np.float32)
        channels[name] = samples
    return write(path, channels, compression="zips", deep=True)


def read_back(path: Path, part: int = 0) -> dict[str, np.ndarray]:
    """The planes as the OpenEXR module decodes them."""
    channels = OpenEXR.File(str(path), separate_channels=True).channels(part)
    return {name: np.array(channel.pixels) for name, channel in channels.items()}


# ---- files byte by byte: what the module cannot write ---------------------------------------

_PIXEL_TYPES = {"uint32": (0, "<u4"), "float16": (1, "<f2"), "float32": (2, "<f4")}


def _attribute(name: str, kind: str, data: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(data)) + data


def _box(box: Box) -> bytes:
    x, y, width, height = box
    return struct.pack("<4i", x, y, x + width - 1, y + height - 1)


def _zip(data: bytes) -> bytes:
    """OpenEXR's ZIP: the even bytes, then the odd ones, as differences + 128, then deflate."""
    raw = np.frombuffer(data, "u1")
    halves = np.concatenate([raw[0::2], raw[1::2]]).astype(int)
    halves[1:] = (halves[1:] - halves[:-1] + 128) % 256
    packed = zlib.compress(halves.astype("u1").tobytes(), 6)
    # A chunk that does not shrink is stored as it is, and told by its size.
    return packed if len(packed) < len(data) else data


def raw_bytes(
    channels: Planes,
    size: tuple[int, int],
    *,
    sampling: Mapping[str, tuple[int, int]] | None = None,
    origin: tuple[int, int] = (0, 0),
    compression: str = "none",
    tile: tuple[int, int] | None = None,
    levels: str = "one",
    level_value: float = 99.0,
) -> bytes:
    """A single-part file of (width, height) `size`, uncompressed or ZIP.

    A subsampled channel has a smaller plane and its steps in `sampling`. `levels` is one, mip or
    rip (with `tile`): every pixel of the smaller levels is `level_value`, so that a reader that
    takes the wrong level is found out.
    """
    width, height = size
    names = sorted(channels)
    steps = {name: (sampling or {}).get(name, (1, 1)) for name in names}
    kinds = {name: _PIXEL_TYPES[channels[name].dtype.name] for name in names}
    channel_list = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", kinds[name][0], 0, *steps[name])
        for name in names
    )
    attributes = [
        _attribute("channels", "chlist", channel_list + b"\0"),
        _attribute("compression", "compression", bytes([{"none": 0, "zip": 3}[compression]])),
        _attribute("dataWindow", "box2i", _box((*origin, width, height))),
        _attribute("displayWindow", "box2i", _box((*origin, width, height))),
        _attribute("lineOrder", "lineOrder", b"\0"),
        _attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        _attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        _attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    if tile:
        mode = {"one": 0, "mip": 1, "rip": 2}[levels]
        attributes.append(_attribute("tiles", "tiledesc", struct.pack("<IIB", *tile, mode)))
    pack = _zip if compression == "zip" else bytes
    chunks = []
    if tile:
        for lx, ly, level in _levels(channels, levels, level_value):
            level_height, level_width = level[names[0]].shape
            for y in range(0, level_height, tile[1]):
                for x in range(0, level_width, tile[0]):
                    data = pack(
                        b"".join(
                            level[name][row, x : x + tile[0]].astype(kinds[name][1]).tobytes()
                            for row in range(y, min(y + tile[1], level_height))
                            for name in names
                        )
                    )
                    place = (x // tile[0], y // tile[1], lx, ly, len(data))
                    chunks.append(struct.pack("<5i", *place) + data)
    else:
        rows = 16 if compression == "zip" else 1
        for y in range(0, height, rows):
            data = pack(
                b"".join(
                    channels[name][row // steps[name][1]].astype(kinds[name][1]).tobytes()
                    for row in range(y, min(y + rows, height))
                    for name in names
                    if (origin[1] + row) % steps[name][1] == 0
                )
            )
            chunks.append(struct.pack("<ii", origin[1] + y, len(data)) + data)
    start = b"\x76\x2f\x31\x01" + struct.pack("<I", 2 | (0x200 if tile else 0))
    start += b"".join(attributes) + b"\0"
    offset = len(start) + 8 * len(chunks)
    table = []
    for one in chunks:
        table.append(offset)
        offset += len(one)
    return start + struct.pack(f"<{len(table)}Q", *table) + b"".join(chunks)


def _levels(channels: Planes, levels: str, value: float):
    """(level x, level y, planes) in file order; sizes are rounded down."""
    height, width = next(iter(channels.values())).shape
    yield 0, 0, channels
    if levels == "one":
        return
    count_x, count_y = width.bit_length(), height.bit_length()
    if levels == "mip":
        pairs = [(i, i) for i in range(1, max(count_x, count_y))]
    else:
        pairs = [(x, y) for y in range(count_y) for x in range(count_x) if x or y]
    for x, y in pairs:
        shape = max(1, height >> y), max(1, width >> x)
        yield x, y, {name: np.full(shape, value, p.dtype) for name, p in channels.items()}


# ---- damage ---------------------------------------------------------------------------------


def regions(data: bytes) -> dict[str, list[tuple[int, int]]]:
    """Byte ranges of a single-part, scanline or tiled file: header, table, heads, pixels."""
    (flags,) = struct.unpack("<I", data[4:8])
    i = 8
    while data[i]:
        kind = data.index(0, data.index(0, i) + 1)
        (size,) = struct.unpack("<I", data[kind + 1 : kind + 5])
        i = kind + 5 + size
    table = i + 1
    (first,) = struct.unpack("<Q", data[table : table + 8])
    count = (first - table) // 8
    head = 20 if flags & 0x200 else 8
    offsets = sorted(struct.unpack(f"<{count}Q", data[table:first]))
    ends = [*offsets[1:], len(data)]
    return {
        "header": [(0, table)],
        "table": [(table, first)],
        "heads": [(offset, offset + head) for offset in offsets],
        "pixels": [(offset + head, end) for offset, end in zip(offsets, ends, strict=True)],
    }
