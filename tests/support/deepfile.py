"""Deep EXR files made for the tests, byte by byte, and what OpenImageIO makes of them; no hpcomp."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio

COMPRESSIONS = {"none": 0, "rle": 1, "zips": 2, "zip": 3, "zstd": 13}
_TYPES = {"uint32": (0, "<u4"), "float16": (1, "<f2"), "float32": (2, "<f4")}
NAMES = ("A", "B", "G", "R", "Z", "ZBack")


@dataclass(frozen=True)
class Deep:
    """One deep part.

    `counts`: (height, width). `planes`: by channel the samples of all pixels, one after the other.
    `display`: x, y, width, height; the data window where None.
    """

    counts: np.ndarray
    planes: Mapping[str, np.ndarray]
    compression: str = "zips"
    tile: tuple[int, int] | None = None
    origin: tuple[int, int] = (0, 0)
    display: tuple[int, int, int, int] | None = None
    name: str = ""
    levels: int = 0
    attributes: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)

    def chunks(self) -> list[tuple[int, int, int, int]]:
        """(across, down, left, top) of each, in the order of the offset table."""
        height, width = self.counts.shape
        across, down = self.tile or (width, 1)
        return [
            (x // across, y // down, x, y)
            for y in range(0, height, down)
            for x in range(0, width, across)
        ]

    def header(self, several: bool) -> bytes:
        height, width = self.counts.shape
        x, y = self.origin
        box = struct.pack("<4i", x, y, x + width - 1, y + height - 1)
        shown = box
        if self.display is not None:
            dx, dy, dw, dh = self.display
            shown = struct.pack("<4i", dx, dy, dx + dw - 1, dy + dh - 1)
        channels = b"".join(
            name.encode() + b"\0" + struct.pack("<iIii", _TYPES[plane.dtype.name][0], 0, 1, 1)
            for name, plane in sorted(self.planes.items())
        )
        kind = b"deeptile" if self.tile else b"deepscanline"
        found = {
            "channels": ("chlist", channels + b"\0"),
            "chunkCount": ("int", struct.pack("<i", len(self.chunks()))),
            "compression": ("compression", bytes([COMPRESSIONS[self.compression]])),
            "dataWindow": ("box2i", box),
            "displayWindow": ("box2i", shown),
            "lineOrder": ("lineOrder", b"\0"),
            "maxSamplesPerPixel": ("int", struct.pack("<i", int(self.counts.max(initial=0)))),
            "name": ("string", (self.name or "deep").encode()),
            "pixelAspectRatio": ("float", struct.pack("<f", 1)),
            "screenWindowCenter": ("v2f", struct.pack("<2f", 0, 0)),
            "screenWindowWidth": ("float", struct.pack("<f", 1)),
            "type": ("string", kind),
            "version": ("int", struct.pack("<i", 1)),
            **self.attributes,
        }
        if self.tile:
            found["tiles"] = ("tiledesc", struct.pack("<2IB", *self.tile, 0))
        return (
            b"".join(
                key.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(data)) + data
                for key, (kind, data) in found.items()
            )
            + b"\0"
        )

    def chunk(self, number: int, part: int | None) -> bytes:
        across, down, left, top = self.chunks()[number]
        height, width = self.counts.shape
        columns, rows = self.tile or (width, 1)
        right, bottom = min(left + columns, width), min(top + rows, height)
        counts = self.counts[top:bottom, left:right]
        table = np.cumsum(counts, axis=1).astype("<i4").tobytes()
        starts = np.cumsum(self.counts.ravel()) - self.counts.ravel()
        data = []
        for y in range(top, bottom):
            begin = starts[y * width + left]
            end = begin + self.counts[y, left:right].sum()
            for _, plane in sorted(self.planes.items()):
                data.append(plane[begin:end].astype(_TYPES[plane.dtype.name][1]).tobytes())
        plain = b"".join(data)
        packed_table, packed = self._packed(table), self._packed(plain)
        where = struct.pack("<4i", across, down, 0, 0) if self.tile else b""
        where = where or struct.pack("<i", self.origin[1] + top)
        if part is not None:
            where = struct.pack("<i", part) + where
        sizes = struct.pack("<3Q", len(packed_table), len(packed), len(plain))
        return where + sizes + packed_table + packed

    def _packed(self, data: bytes) -> bytes:
        if self.compression == "none" or not data:
            return data
        raw = np.frombuffer(data, "u1")
        halves = np.concatenate([raw[0::2], raw[1::2]]).astype(int)
        halves[1:] = (halves[1:] - halves[:-1] + 128) % 256
        halves = halves.astype("u1").tobytes()
        packed = _runs(halves) if self.compression == "rle" else zlib.compress(halves, 4)
        return packed if len(packed) < len(data) else data


def _runs(data: bytes) -> bytes:
    """OpenEXR's RLE: n and a byte for n + 1 of them, or -n and n bytes as they are."""
    out, at = bytearray(), 0
    while at < len(data):
        end = at + 1
        while end < len(data) and data[end] == data[at] and end - at < 128:
            end += 1
        if end - at >= 3:
            out += bytes([end - at - 1, data[at]])
        else:
            end = at + 1
            while end < len(data) and end - at < 127 and len(set(data[end : end + 3])) > 1:
                end += 1
            out += bytes([256 - (end - at)]) + data[at:end]
        at = end
    return bytes(out)


def content(*parts: Deep) -> bytes:
    """A file of these parts."""
    several = len(parts) > 1
    version = 2 | 0x800 | (0x1000 if several else 0)
    head = b"v/1\x01" + struct.pack("<I", version)
    head += b"".join(part.header(several) for part in parts) + (b"\0" if several else b"")
    at = len(head) + 8 * sum(len(part.chunks()) for part in parts)
    offsets, chunks = [], []
    for number, part in enumerate(parts):
        for chunk in range(len(part.chunks())):
            found = part.chunk(chunk, number if several else None)
            offsets.append(at)
            chunks.append(found)
            at += len(found)
    return head + struct.pack(f"<{len(offsets)}Q", *offsets) + b"".join(chunks)


def write(path: Path, *parts: Deep) -> Path:
    path.write_bytes(content(*parts))
    return path


def repacked(path: Path, to: Path, compression: Any) -> Path:
    """The first part in one of OpenEXR's compressions, by OpenEXR itself."""
    file = OpenEXR.File(str(path), separate_channels=True)
    OpenEXR.File({**file.header(), "compression": compression}, file.channels()).write(str(to))
    return to


def of_pixels(
    pixels: Sequence[Sequence[Sequence[Sequence[float]]]],
    names: Sequence[str] = ("R", "G", "B", "A", "Z", "ZBack"),
    dtype: Any = np.float32,
    **options: Any,
) -> Deep:
    """A part of rows of pixels of samples, each with the values of the channels `names`."""
    counts = np.array([[len(pixel) for pixel in row] for row in pixels])
    values = np.array([s for row in pixels for pixel in row for s in pixel], float)
    values = values.reshape(-1, len(names))
    return Deep(counts, {n: values[:, i].astype(dtype) for i, n in enumerate(names)}, **options)


def noise(
    width: int = 11,
    height: int = 7,
    most: int = 5,
    *,
    seed: int = 0,
    tidy: bool = True,
    color: Any = np.float32,
    depth: Any = np.float32,
    volumes: bool = True,
    **options: Any,
) -> Deep:
    """Samples of valid premultiplied colours; tidy: sorted and apart, else of few depths."""
    rng = np.random.default_rng([seed, width, height])
    counts = rng.integers(0, most + 1, (height, width))
    total = int(counts.sum())
    alpha = np.round(rng.random(total), 2)
    alpha[rng.random(total) < 0.1] = 1
    planes = {name: (rng.random(total) * alpha).astype(color) for name in "RGB"}
    planes["A"] = alpha.astype(color)
    if tidy:
        starts = np.cumsum(counts) - counts.ravel()
        within = np.arange(total) - np.repeat(starts, counts.ravel())
        front = 1 + 2 * within + rng.integers(0, 2, total) / 2
        back = front + rng.integers(0, 3, total) / 2
    else:
        front = rng.integers(1, 6, total).astype(float)
        back = front + rng.integers(0, 4, total)
    planes["Z"] = front.astype(depth)
    if volumes:
        planes["ZBack"] = back.astype(depth)
    return Deep(counts, planes, **options)


# ---- what OpenImageIO makes of them ---------------------------------------------------------


def read_back(path: Path, part: int = 0) -> list[list[list[dict[str, float]]]]:
    """rows of pixels of samples by channel, as OpenImageIO decodes them."""
    reader = oiio.ImageInput.open(str(path))
    assert reader.seek_subimage(part, 0)
    spec = reader.spec()
    data = reader.read_native_deep_image(part, 0)
    assert data is not None, reader.geterror()
    found = [
        [
            {name: _value(data, pixel, c, s) for c, name in enumerate(spec.channelnames)}
            for s in range(data.samples(pixel))
        ]
        for pixel in range(data.pixels)
    ]
    return [found[y * spec.width : (y + 1) * spec.width] for y in range(spec.height)]


def _value(data: Any, pixel: int, channel: int, sample: int) -> float:
    """As it is stored: OpenImageIO divides whole numbers by the largest."""
    if str(data.channeltype(channel)) == "uint":
        return float(data.deep_value_uint(pixel, channel, sample))
    return data.deep_value(pixel, channel, sample)


def flattened_by_oiio(path: Path, part: int = 0, *, tidy: bool = False) -> np.ndarray:
    """(height, width, 4) float32 RGBA as `oiiotool --flatten` has it.

    `tidy`: sorted, split and merged by OpenImageIO before, which --flatten does not do by itself.
    """
    image = oiio.ImageBuf(str(path), part, 0)
    if tidy:
        image = merged_by_oiio([image])
    flat = oiio.ImageBufAlgo.flatten(image)
    assert not flat.has_error, flat.geterror()
    names = list(flat.spec().channelnames)
    pixels = flat.get_pixels(oiio.FLOAT)
    return pixels[..., [names.index(name) for name in "RGBA"]]


def merged_by_oiio(images: Sequence[oiio.ImageBuf]) -> oiio.ImageBuf:
    """All samples of these images in one, tidy.

    Pixel by pixel: sorted, split at every depth, sorted, merged; until nothing changes.
    """
    first = images[0]
    first.read(first.subimage, 0, True)
    data = first.deepdata()
    back = data.Zback_channel
    back = data.Z_channel if back < 0 else back
    for image in images[1:]:
        image.read(image.subimage, 0, True)
    for pixel in range(data.pixels):
        for image in images[1:]:
            at = data.samples(pixel)
            other = image.deepdata()
            data.set_samples(pixel, at + other.samples(pixel))
            for s in range(other.samples(pixel)):
                for c in range(data.channels):
                    data.set_deep_value(pixel, c, at + s, other.deep_value(pixel, c, s))
        depths = {
            data.deep_value(pixel, channel, s)
            for s in range(data.samples(pixel))
            for channel in (data.Z_channel, back)
        }
        data.sort(pixel)
        for depth in sorted(depths):
            data.split(pixel, depth)
        _sort(data, pixel, back)
        data.merge_overlaps(pixel)
    return _image(first.spec(), data)


def _image(spec: Any, data: Any) -> oiio.ImageBuf:
    """An image of these samples: what an image gives of its own is a copy."""
    image = oiio.ImageBuf(spec)
    for pixel in range(data.pixels):
        x, y = spec.x + pixel % spec.width, spec.y + pixel // spec.width
        image.set_deep_samples(x, y, 0, data.samples(pixel))
        for s in range(data.samples(pixel)):
            for c in range(data.channels):
                image.set_deep_value(x, y, 0, c, s, data.deep_value(pixel, c, s))
    return image


def _sort(data: Any, pixel: int, back: int) -> None:
    """By front and back; `DeepData.sort` looks at the front alone."""
    samples = [
        [data.deep_value(pixel, c, s) for c in range(data.channels)]
        for s in range(data.samples(pixel))
    ]
    samples.sort(key=lambda sample: (sample[data.Z_channel], sample[back]))
    for s, sample in enumerate(samples):
        for c, value in enumerate(sample):
            data.set_deep_value(pixel, c, s, value)
