"""Image files that went wrong, each by its number and always the same: seeds, and ways to damage them.

A seed is a small sound file of some kind of PNG or EXR. Its mutant has some of its bytes, chunks,
attributes or lengths changed, most of them so that what checks a file first does not see it. No hpcomp.
"""

from __future__ import annotations

import itertools
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import deepfile
import exrfile
import numpy as np
import pngfile

Random = random.Random

#: Numbers at which something begins or ends, that a length or a size may lie to be.
TELLING = (0, 1, 2, 7, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)


class Mutant(NamedTuple):
    """`name` says what it was and what was done to it, `layer` as what it is given to the command."""

    name: str
    layer: str
    content: bytes

    @property
    def file(self) -> str:
        return self.layer.partition("::")[0]


# ---- seeds ----------------------------------------------------------------------------------


def seeds(folder: Path) -> dict[str, bytes]:
    """The sound files by name; some are written to `folder` on the way."""
    found = {f"{pngfile.name_of(png)}.png": png.encode() for png in _pngs()}
    for name, png in {
        "icc": pngfile.random_png(pngfile.RGBA, 8).with_chunks(
            head=[pngfile.iccp(pngfile.icc_profile("P3-like"))],
            tail=[pngfile.text("Title", "a picture"), (b"tIME", pngfile.time()[1])],
        ),
        "cicp": pngfile.random_png(pngfile.RGB, 16).with_chunks(
            head=[pngfile.cicp(12, 13), pngfile.phys(2835, 2835)],
            body=[(b"zTXt", b"Comment\0\0" + zlib.compress(b"words " * 30)), pngfile.bkgd(1, 2, 3)],
        ),
        "gamma": pngfile.random_png(pngfile.GREY, 8, interlaced=True).with_chunks(
            head=[pngfile.gama(45455), pngfile.chrm((0.3127, 0.329), (0.64, 0.33), (0.3, 0.6), (0.15, 0.06))],
            body=[(b"iTXt", b"Author\0\0\0en\0\0" + "wörter".encode())],
        ),
        "pieces": pngfile.Png(
            pngfile.random_png(pngfile.RGBA, 8).samples, pngfile.RGBA, 8, idat_size=60
        ).with_chunks(head=[pngfile.srgb()]),
    }.items():  # fmt: skip
        found[f"{name}.png"] = png.encode()
    folder.mkdir(parents=True, exist_ok=True)
    for name, write in _EXRS.items():
        found[f"{name}.exr"] = write(folder / f"{name}.exr").read_bytes()
    return found


def _pngs() -> list[pngfile.Png]:
    """Every colour type, its least and greatest depth; one in two is interlaced, or has tRNS."""
    made = []
    for colour, depths in pngfile.DEPTHS.items():
        for number, depth in enumerate((depths[0], depths[-1])):
            transparent = number == 0 and colour in (pngfile.GREY, pngfile.RGB, pngfile.PALETTE)
            made.append(
                pngfile.random_png(colour, depth, transparent=transparent, interlaced=number == 1)
            )
    return made


def _exr(**how: object) -> Callable[[Path], Path]:
    """A part of 23 × 19 pixels that deflate well: what does not shrink is stored as it is."""
    dtype = how.pop("dtype", np.float16)
    names = how.pop("names", "RGBA")
    return lambda path: exrfile.write(path, exrfile.coarse(names, 23, 19, dtype), **how)  # type: ignore[arg-type]


def _parts(path: Path) -> Path:
    tiled = {"tile": (8, 8), "compression": "zips"}
    return exrfile.write_parts(
        path,
        [
            ("fg", exrfile.coarse("RGBA", 11, 9), {"compression": "zip"}),
            ("bg", exrfile.coarse("RGB", 11, 9, np.float32), tiled),
        ],
    )


def _levels(path: Path) -> Path:
    content = exrfile.raw_bytes(
        exrfile.coarse("RGBA", 16, 12), (16, 12), compression="zip", tile=(8, 8), levels="mip"
    )
    path.write_bytes(content)
    return path


def _subsampled(path: Path) -> Path:
    planes = {
        "Y": exrfile.coarse("Y", 8, 8)["Y"],
        **{name: exrfile.coarse([name], 4, 4)[name] for name in ("RY", "BY")},
    }
    sampling = {"RY": (2, 2), "BY": (2, 2)}
    path.write_bytes(exrfile.raw_bytes(planes, (8, 8), sampling=sampling))
    return path


def _deep(*kinds: dict[str, object]) -> Callable[[Path], Path]:
    return lambda path: deepfile.write(
        path, *(deepfile.noise(9, 7, name=f"part{n}", **how) for n, how in enumerate(kinds))  # type: ignore[arg-type]
    )  # fmt: skip


_EXRS: dict[str, Callable[[Path], Path]] = {
    "zip": _exr(compression="zip"),
    "zips": _exr(compression="zips", dtype=np.float32, line_order="decreasing"),
    "none": _exr(compression="none", names="YA"),
    "rle": _exr(compression="rle", origin=(-5, 3), display=(0, 0, 30, 30)),
    "piz": _exr(compression="piz"),
    "pxr24": _exr(compression="pxr24", dtype=np.float32),
    "b44": _exr(compression="b44"),
    "dwaa": _exr(compression="dwaa"),
    "zstd": _exr(compression="zstd"),
    "tiles": _exr(compression="zip", tile=(8, 8)),
    "levels": _levels,
    "subsampled": _subsampled,
    "layers": _exr(compression="zip", names=["fg.R", "fg.G", "fg.B", "fg.A", "Z"]),
    "parts": _parts,
    "deep": _deep({}),
    "deep-rle": _deep({"compression": "rle", "tidy": False}),
    "deep-tiles": _deep({"tile": (4, 4), "volumes": False}),
    "deep-parts": _deep({"compression": "none"}, {"tile": (4, 4), "color": np.float16}),
}


# ---- bytes of any file ----------------------------------------------------------------------


def _place(data: bytes, rng: Random) -> int:
    """Anywhere, or in the first part, where most is decided."""
    return rng.randrange(len(data) if rng.random() < 0.5 else min(len(data), 400))


def flip_bits(data: bytes, rng: Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        out[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(out)


def set_bytes(data: bytes, rng: Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 4))):
        out[_place(data, rng)] = rng.choice((0, 1, 127, 128, 254, 255, rng.randrange(256)))
    return bytes(out)


def set_number(data: bytes, rng: Random) -> bytes:
    """Four bytes as a number that lies, of either byte order."""
    at = max(0, min(_place(data, rng), len(data) - 4))
    return data[:at] + struct.pack(rng.choice(("<I", ">I")), rng.choice(TELLING)) + data[at + 4 :]


def cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.choice((0, 1, 4, 8, *(rng.randrange(len(data)) for _ in range(12))))]


def take_out(data: bytes, rng: Random) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + rng.choice((1, 2, 4, 8, 100)) :]


def put_in(data: bytes, rng: Random) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.randbytes(rng.choice((1, 2, 4, 8, 100))) + data[at:]


def repeat(data: bytes, rng: Random) -> bytes:
    at, size = _place(data, rng), rng.choice((1, 8, 40, 400))
    return data[: at + size] + data[at:]


def exchange(data: bytes, rng: Random) -> bytes:
    size = rng.choice((1, 4, 16, 60))
    a, b = sorted((_place(data, rng), _place(data, rng)))
    if b - a < size:
        return data[:a] + data[b:]
    return data[:a] + data[b : b + size] + data[a + size : b] + data[a : a + size] + data[b + size :]


ANY = (flip_bits, set_bytes, set_number, cut, take_out, put_in, repeat, exchange)


# ---- chunks of a PNG, whose checksums are right -----------------------------------------------


def shuffle_chunks(data: bytes, rng: Random) -> bytes:
    chunks = pngfile.split(data)
    middle = chunks[1:-1] if rng.random() < 0.7 else chunks
    rng.shuffle(middle)
    return pngfile.join(middle if len(middle) == len(chunks) else [chunks[0], *middle, chunks[-1]])


def drop_chunk(data: bytes, rng: Random) -> bytes:
    chunks = pngfile.split(data)
    del chunks[rng.randrange(len(chunks))]
    return pngfile.join(chunks)


def repeat_chunk(data: bytes, rng: Random) -> bytes:
    chunks = pngfile.split(data)
    chunks.insert(rng.randrange(1, len(chunks) + 1), rng.choice(chunks))
    return pngfile.join(chunks)


def change_chunk(data: bytes, rng: Random) -> bytes:
    """The data of one chunk, as of any file."""
    chunks = pngfile.split(data)
    number = rng.choice([n for n, (_, body) in enumerate(chunks) if body])
    kind, body = chunks[number]
    chunks[number] = (kind, rng.choice(ANY)(body, rng))
    return pngfile.join(chunks)


def rename_chunk(data: bytes, rng: Random) -> bytes:
    chunks = pngfile.split(data)
    number = rng.randrange(len(chunks))
    kinds = [kind for kind, _ in chunks]
    more = (b"acTL", b"fcTL", b"fdAT", b"eXIf", b"cLLI", b"mDCV", b"sBIT", b"hIST", b"ABCD", b"\0\n\x1b[")
    chunks[number] = (rng.choice([*kinds, *more]), chunks[number][1])
    return pngfile.join(chunks)


def lie_of_length(data: bytes, rng: Random) -> bytes:
    """The length that a chunk says it has."""
    _, at, _ = rng.choice(pngfile.chunk_spans(data))
    (length,) = struct.unpack(">I", data[at : at + 4])
    told = rng.choice((*TELLING, length + 1, max(0, length - 1), length + 12))
    return data[:at] + struct.pack(">I", told) + data[at + 4 :]


def break_checksum(data: bytes, rng: Random) -> bytes:
    _, _, end = rng.choice(pngfile.chunk_spans(data))
    return pngfile.flip_bit(data, end - 1 - rng.randrange(4), rng.randrange(8))


def change_picture_header(data: bytes, rng: Random) -> bytes:
    """Width, height, depth, colour type, compression, filter or interlacing."""
    chunks = pngfile.split(data)
    fields = list(struct.unpack(">IIBBBBB", chunks[0][1]))
    number = rng.randrange(7)
    near = (fields[number] + 1, max(0, fields[number] - 1))
    fields[number] = rng.choice((*near, *TELLING)) if number < 2 else rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
    chunks[0] = (b"IHDR", struct.pack(">IIBBBBB", *fields))
    return pngfile.join(chunks)


def change_raster(data: bytes, rng: Random) -> bytes:
    """The filtered rows, deflated again: too short, too long, other filters."""
    chunks = pngfile.split(data)
    raster = zlib.decompress(b"".join(body for kind, body in chunks if kind == b"IDAT"))
    packed = zlib.compress(rng.choice(ANY)(raster, rng), rng.choice((0, 1, 9)))
    if rng.random() < 0.3:
        packed = rng.choice(ANY)(packed, rng)
    first = [kind for kind, _ in chunks].index(b"IDAT")
    rest = [(kind, body) for kind, body in chunks if kind != b"IDAT"]
    return pngfile.join([*rest[:first], (b"IDAT", packed), *rest[first:]])


def change_deflated_chunk(data: bytes, rng: Random) -> bytes:
    """What an iCCP or zTXt chunk holds, deflated again; a header's damage where there is none."""
    chunks = pngfile.split(data)
    packed = [n for n, (kind, _) in enumerate(chunks) if kind in (b"iCCP", b"zTXt")]
    if not packed:
        return change_picture_header(data, rng)
    kind, body = chunks[packed[0]]
    name, _, deflated = body.partition(b"\0")
    inside = rng.choice(ANY)(zlib.decompress(deflated[1:]), rng)
    chunks[packed[0]] = (kind, name + b"\0\0" + zlib.compress(inside))
    return pngfile.join(chunks)


OF_PNG = (
    shuffle_chunks, drop_chunk, repeat_chunk, change_chunk, rename_chunk, lie_of_length,
    break_checksum, change_picture_header, change_raster, change_deflated_chunk,
)  # fmt: skip


# ---- headers and chunks of an EXR -------------------------------------------------------------


class Exr(NamedTuple):
    """A file taken apart: attributes (name, kind, data) by header, and chunks as its table has them."""

    magic: bytes
    headers: list[list[tuple[bytes, bytes, bytes]]]
    chunks: list[bytes]

    @property
    def several(self) -> bool:
        return bool(struct.unpack("<I", self.magic[4:])[0] & 0x1000)

    @staticmethod
    def of(data: bytes) -> Exr:
        several = bool(struct.unpack("<I", data[4:8])[0] & 0x1000)
        headers, at = [], 8
        while data[at]:
            attributes = []
            while data[at]:
                kind = data.index(0, at) + 1
                size = data.index(0, kind) + 1
                (length,) = struct.unpack("<I", data[size : size + 4])
                begin = size + 4
                attributes.append((data[at : kind - 1], data[kind : size - 1], data[begin : begin + length]))
                at = begin + length
            headers.append(attributes)
            at += 1
            if not several:
                break
        table = at + several
        offsets: list[int] = []
        while not offsets or table < min(offsets):  # where the first chunk begins
            offsets += struct.unpack("<Q", data[table : table + 8])
            table += 8
        ends = dict(itertools.pairwise(sorted([*offsets, len(data)])))
        return Exr(
            data[:8],
            headers,
            [data[begin : ends[begin]] for begin in offsets],
        )

    def joined(self, offsets: Callable[[list[int]], list[int]] = list) -> bytes:
        """The file again; `offsets` may change those of the chunks that its table tells."""
        head = self.magic
        for attributes in self.headers:
            for name, kind, body in attributes:
                head += name + b"\0" + kind + b"\0" + struct.pack("<I", len(body)) + body
            head += b"\0"
        head += b"\0" * self.several
        at, told = len(head) + 8 * len(self.chunks), []
        for chunk in self.chunks:
            told.append(at)
            at += len(chunk)
        told = [value % 2**64 for value in offsets(told)]
        return head + struct.pack(f"<{len(told)}Q", *told) + b"".join(self.chunks)


def shuffle_chunks_of_exr(data: bytes, rng: Random) -> bytes:
    """One in two has a table that knows of it, and means the same."""
    exr = Exr.of(data)
    order = list(range(len(exr.chunks)))
    rng.shuffle(order)
    shuffled = exr._replace(chunks=[exr.chunks[number] for number in order])
    if rng.random() < 0.5:
        return shuffled.joined()
    return shuffled.joined(lambda told: [told[order.index(number)] for number in range(len(order))])


def shuffle_parts(data: bytes, rng: Random) -> bytes:
    """The headers, or the attributes of one."""
    exr = Exr.of(data)
    rng.shuffle(exr.headers if len(exr.headers) > 1 and rng.random() < 0.5 else rng.choice(exr.headers))
    return exr.joined()


def change_chunk_of_exr(data: bytes, rng: Random) -> bytes:
    exr = Exr.of(data)
    number = rng.randrange(len(exr.chunks))
    exr.chunks[number] = rng.choice(ANY)(exr.chunks[number], rng)
    return exr.joined()


def change_head_of_chunk(data: bytes, rng: Random) -> bytes:
    """The first numbers of a chunk: its part, its place, its sizes."""
    exr = Exr.of(data)
    number = rng.randrange(len(exr.chunks))
    chunk, at = exr.chunks[number], 4 * rng.randrange(7)
    told = rng.choice((*TELLING, rng.randrange(64)))
    exr.chunks[number] = chunk[:at] + struct.pack("<I", told) + chunk[at + 4 :]
    return exr.joined()


def drop_or_repeat_chunk_of_exr(data: bytes, rng: Random) -> bytes:
    exr = Exr.of(data)
    number = rng.randrange(len(exr.chunks))
    exr.chunks[number : number + 1] = [exr.chunks[number]] * rng.choice((0, 2))
    return exr.joined()


def lie_of_offsets(data: bytes, rng: Random) -> bytes:
    def lie(offsets: list[int]) -> list[int]:
        if rng.random() < 0.3:
            rng.shuffle(offsets)
        number = rng.randrange(len(offsets))
        near = [offsets[number] + by for by in (-1, 1, 8)]
        offsets[number] = rng.choice((*near, *TELLING, 2**63, 2**64 - 8, len(data) - 1, rng.choice(offsets)))
        return offsets

    return Exr.of(data).joined(lie)


def change_attribute(data: bytes, rng: Random) -> bytes:
    """What one holds; a window, a list of channels or a size more often than what only says something."""
    exr = Exr.of(data)
    attributes = rng.choice(exr.headers)
    telling = (b"dataWindow", b"displayWindow", b"channels", b"tiles", b"compression", b"chunkCount", b"type")
    wanted = [n for n, (name, _, body) in enumerate(attributes) if name in telling and body]
    number = rng.choice(wanted) if rng.random() < 0.7 else rng.randrange(len(attributes))
    name, kind, body = attributes[number]
    if len(body) >= 4 and rng.random() < 0.6:
        at = 4 * rng.randrange(len(body) // 4)
        told = rng.choice((*TELLING, rng.randrange(40)))
        body = body[:at] + struct.pack("<I", told) + body[at + 4 :]
    elif body:
        body = rng.choice(ANY)(body, rng)
    attributes[number] = (name, kind, body)
    return exr.joined()


def drop_or_repeat_attribute(data: bytes, rng: Random) -> bytes:
    exr = Exr.of(data)
    attributes = rng.choice(exr.headers)
    number = rng.randrange(len(attributes))
    attributes[number : number + 1] = [attributes[number]] * rng.choice((0, 2))
    return exr.joined()


def change_version(data: bytes, rng: Random) -> bytes:
    """The flags that say what kind of file it is."""
    (version,) = struct.unpack("<I", data[4:8])
    version ^= rng.choice((0x200, 0x400, 0x800, 0x1000, 0x1800, 0x2000, 1, 3))
    return data[:4] + struct.pack("<I", version) + data[8:]


OF_EXR = (
    shuffle_chunks_of_exr, shuffle_parts, change_chunk_of_exr, change_chunk_of_exr,
    change_head_of_chunk, change_head_of_chunk, drop_or_repeat_chunk_of_exr, lie_of_offsets,
    change_attribute, change_attribute, change_attribute, drop_or_repeat_attribute, change_version,
)  # fmt: skip


def mutant(sound: dict[str, bytes], number: int) -> Mutant:
    """The mutant of that number, of one of these seeds after the other."""
    rng = Random(f"mutant {number}")
    names = sorted(sound)
    name = names[number % len(names)]
    suffix = name[-4:]
    of_kind, share = (OF_PNG, 0.2) if suffix == ".png" else (OF_EXR, 0.35)
    part = rng.choice(("::part=0", "::part=1", "")) if "parts" in name else ""
    while True:
        way = rng.choice(ANY if rng.random() < share else of_kind)
        content = way(sound[name], rng)
        if content != sound[name]:
            return Mutant(f"{number}: {name}{part}, {way.__name__}", f"m{suffix}{part}", content)
