"""PNG files made byte by byte, what they mean in float64, and ways to damage them; no hpcomp."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GREY, RGB, PALETTE, GREY_ALPHA, RGBA = 0, 2, 3, 4, 6
CHANNELS = {GREY: 1, RGB: 3, PALETTE: 1, GREY_ALPHA: 2, RGBA: 4}
DEPTHS = {
    GREY: (1, 2, 4, 8, 16),
    RGB: (8, 16),
    PALETTE: (1, 2, 4, 8),
    GREY_ALPHA: (8, 16),
    RGBA: (8, 16),
}
# PNG third edition, 8.2: first column, first row, column step, row step of each Adam7 pass.
ADAM7 = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)

Chunk = tuple[bytes, bytes]
Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Png:
    """One PNG picture as its stored samples, (h, w, channels) integers, and the chunks around them.

    `transparency` is tRNS as numbers: one alpha per palette entry, or the one grey or RGB sample
    that is transparent. `head` comes before PLTE, `body` between it and IDAT, `tail` after IDAT.
    """

    samples: np.ndarray
    colour: int
    depth: int
    palette: tuple[tuple[int, int, int], ...] | None = None
    transparency: tuple[int, ...] | None = None
    interlaced: bool = False
    head: tuple[Chunk, ...] = ()
    body: tuple[Chunk, ...] = ()
    tail: tuple[Chunk, ...] = ()
    idat_size: int | None = None

    @property
    def has_alpha(self) -> bool:
        return self.colour in (GREY_ALPHA, RGBA) or self.transparency is not None

    @property
    def size(self) -> tuple[int, int]:
        return self.samples.shape[1], self.samples.shape[0]

    def with_chunks(
        self, *, head: Sequence[Chunk] = (), body: Sequence[Chunk] = (), tail: Sequence[Chunk] = ()
    ) -> Png:
        return replace(
            self,
            head=self.head + tuple(head),
            body=self.body + tuple(body),
            tail=self.tail + tuple(tail),
        )

    def chunks(self) -> list[Chunk]:
        """Every chunk from IHDR to IEND in file order, without lengths and CRCs."""
        width, height = self.size
        header = struct.pack(
            ">IIBBBBB", width, height, self.depth, self.colour, 0, 0, int(self.interlaced)
        )
        out = [(b"IHDR", header), *self.head]
        if self.palette is not None:
            out.append((b"PLTE", bytes(value for entry in self.palette for value in entry)))
        if self.transparency is not None:
            layout = "B" if self.colour == PALETTE else "H"
            out.append(
                (b"tRNS", struct.pack(f">{len(self.transparency)}{layout}", *self.transparency))
            )
        out += self.body
        data = zlib.compress(self.raster(), 9)
        size = self.idat_size or len(data)
        out += [(b"IDAT", data[i : i + size]) for i in range(0, len(data), size)]
        return [*out, *self.tail, (b"IEND", b"")]

    def encode(self) -> bytes:
        return join(self.chunks())

    def raster(self) -> bytes:
        """The bytes that are compressed: every pass, every row with its filter number in front."""
        if not self.interlaced:
            return self._filtered(self.samples)
        return b"".join(self._filtered(self.samples[y0::dy, x0::dx]) for x0, y0, dx, dy in ADAM7)

    def _filtered(self, samples: np.ndarray) -> bytes:
        height, width = samples.shape[:2]
        if not height or not width:
            return b""
        step = max(1, CHANNELS[self.colour] * self.depth // 8)
        rows, above = [], bytes(len(self._packed(samples[0])))
        for y in range(height):
            row = self._packed(samples[y])
            # All five filters take turns, so that a reader which does not undo one is found out.
            rows.append(bytes([y % 5]) + _filter(y % 5, row, above, step))
            above = row
        return b"".join(rows)

    def _packed(self, row: np.ndarray) -> bytes:
        values = row.reshape(-1)
        if self.depth == 16:
            return values.astype(">u2").tobytes()
        if self.depth == 8:
            return values.astype("u1").tobytes()
        bits = (values[:, None] >> np.arange(self.depth - 1, -1, -1)) & 1
        return np.packbits(bits.astype("u1").reshape(-1)).tobytes()

    def straight(self) -> np.ndarray:
        """(h, w, 4) float64 encoded straight RGBA in [0, 1], from the samples alone."""
        height, width = self.samples.shape[:2]
        top = float(2**self.depth - 1)
        out = np.ones((height, width, 4))
        if self.colour == PALETTE:
            assert self.palette is not None
            index = self.samples[..., 0]
            out[..., :3] = np.array(self.palette)[index] / 255.0
            if self.transparency is not None:
                alphas = np.full(len(self.palette), 255)
                alphas[: len(self.transparency)] = self.transparency
                out[..., 3] = alphas[index] / 255.0
            return out
        colours = 1 if self.colour in (GREY, GREY_ALPHA) else 3
        out[..., :3] = self.samples[..., :colours] / top
        if self.colour in (GREY_ALPHA, RGBA):
            out[..., 3] = self.samples[..., -1] / top
        elif self.transparency is not None:
            key = np.array(self.transparency)
            out[..., 3] = np.where(np.all(self.samples == key, axis=-1), 0.0, 1.0)
        return out

    def linear(self, curve: Curve | None = None) -> np.ndarray:
        """(h, w, 4) float64 linear premultiplied RGBA that the file means, its alpha straight."""
        out = self.straight()
        out[..., :3] = (curve or srgb_to_linear)(out[..., :3]) * out[..., 3:]
        return out


def _filter(kind: int, row: bytes, above: bytes, step: int) -> bytes:
    """One row filtered as PNG third edition, 9.2, defines it; `step` is bytes a pixel."""
    x = np.frombuffer(row, "u1").astype(int)
    b = np.frombuffer(above, "u1").astype(int)
    a = np.concatenate([np.zeros(step, int), x])[: len(x)]
    c = np.concatenate([np.zeros(step, int), b])[: len(x)]
    if kind == 0:
        predicted = np.zeros_like(x)
    elif kind == 1:
        predicted = a
    elif kind == 2:
        predicted = b
    elif kind == 3:
        predicted = (a + b) // 2
    else:
        p = a + b - c
        pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
        predicted = np.where((pa <= pb) & (pa <= pc), a, np.where(pb <= pc, b, c))
    return ((x - predicted) % 256).astype("u1").tobytes()


def srgb_to_linear(v: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding in float64."""
    v = np.asarray(v, float)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(v: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 encoding in float64, for values in [0, 1]."""
    v = np.asarray(v, float)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0) ** (1 / 2.4) - 0.055)


def power(exponent: float) -> Curve:
    return lambda v: np.asarray(v, float) ** exponent


# ---- pictures -------------------------------------------------------------------------------


def random_png(
    colour: int,
    depth: int,
    *,
    transparent: bool = False,
    interlaced: bool = False,
    width: int = 13,
    height: int = 11,
    seed: int = 0,
) -> Png:
    """A picture of random samples; 13×11 leaves every Adam7 pass and every bit packing ragged."""
    rng = np.random.default_rng([seed, colour, depth])
    palette = None
    transparency: tuple[int, ...] | None = None
    top = 2**depth
    if colour == PALETTE:
        # Five fewer entries than the depth has room for, where that leaves any: legal and usual.
        entries = max(2, top - 5)
        palette = tuple(tuple(int(v) for v in rng.integers(0, 256, 3)) for _ in range(entries))
        samples = rng.integers(0, entries, (height, width, 1))
        if transparent:
            # Shorter than the palette: the rest of the entries are opaque.
            transparency = tuple(int(v) for v in rng.integers(0, 256, max(1, entries // 2)))
    else:
        samples = rng.integers(0, top, (height, width, CHANNELS[colour]))
        if colour in (GREY_ALPHA, RGBA):
            samples[0, : min(2, width), -1] = (0, top - 1)[:width]
        if transparent:
            transparency = tuple(int(v) for v in samples[1, 1])
            samples[-1, -1] = samples[1, 1]
            if depth == 16:
                # Same high byte as the key: transparent only to a reader that cut 16 bits to 8.
                samples[2, 2] = samples[1, 1] ^ 1
    return Png(samples, colour, depth, palette, transparency, interlaced)


def every_kind() -> list[Png]:
    """Every colour type, depth, tRNS or not, interlaced or not, that PNG has."""
    out = []
    for colour, depths in DEPTHS.items():
        for depth in depths:
            for transparent in (False, True) if colour in (GREY, RGB, PALETTE) else (False,):
                for interlaced in (False, True):
                    out.append(
                        random_png(colour, depth, transparent=transparent, interlaced=interlaced)
                    )
    return out


def name_of(png: Png) -> str:
    kind = {GREY: "grey", RGB: "rgb", PALETTE: "palette", GREY_ALPHA: "greyalpha", RGBA: "rgba"}
    return (
        f"{kind[png.colour]}{png.depth}"
        + ("-trns" if png.transparency is not None else "")
        + ("-adam7" if png.interlaced else "")
    )


def rgba_png(rgba: np.ndarray, depth: int = 8) -> Png:
    """An RGBA picture from (h, w, 4) stored integers."""
    return Png(np.asarray(rgba), RGBA, depth)


def bands(*colors, alpha=255, size=(12, 8)):
    """An 8-bit PNG, upright bands of these colours."""
    rgba = np.zeros((size[1], size[0], 4), np.uint8)
    for color, band in zip(colors, np.array_split(rgba, len(colors), axis=1), strict=True):
        band[:] = (*color, alpha)
    return rgba_png(rgba).encode()


# ---- chunks ---------------------------------------------------------------------------------


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def join(chunks: Sequence[Chunk]) -> bytes:
    return SIGNATURE + b"".join(chunk(kind, data) for kind, data in chunks)


def split(data: bytes) -> list[Chunk]:
    """The chunks of a sound PNG file; asserts every CRC."""
    assert data[:8] == SIGNATURE
    out, i = [], 8
    while i < len(data):
        (length,) = struct.unpack(">I", data[i : i + 4])
        kind, body = data[i + 4 : i + 8], data[i + 8 : i + 8 + length]
        (crc,) = struct.unpack(">I", data[i + 8 + length : i + 12 + length])
        assert crc == zlib.crc32(kind + body), kind
        out.append((kind, body))
        i += 12 + length
    return out


def size_of(data: bytes) -> tuple[int, int]:
    """Width and height of a PNG, as its header says."""
    return struct.unpack(">II", split(data)[0][1][:8])


def decode(data: bytes) -> np.ndarray:
    """(h, w, channels) stored integers of a sound PNG, 8 or 16 bits and not interlaced.

    Reads no more than the specification and RFC 1950 ask for, and asserts all that they do: every
    CRC, one zlib stream with a right header and Adler-32 and nothing behind it, known filters.
    """
    chunks = split(data)
    assert [kind for kind, _ in (chunks[0], chunks[-1])] == [b"IHDR", b"IEND"]
    width, height, depth, colour, *methods = struct.unpack(">IIBBBBB", chunks[0][1])
    assert depth in (8, 16)
    assert methods == [0, 0, 0]
    stream = b"".join(body for kind, body in chunks if kind == b"IDAT")
    method, flags = stream[:2]
    assert method & 15 == 8
    assert method >> 4 <= 7
    assert (256 * method + flags) % 31 == 0
    assert not flags & 32
    inflate = zlib.decompressobj(-(8 + (method >> 4)))
    raw = inflate.decompress(stream[2:]) + inflate.flush()
    assert inflate.eof
    assert inflate.unused_data == struct.pack(">I", zlib.adler32(raw))
    step = CHANNELS[colour] * depth // 8
    assert len(raw) == height * (1 + width * step)
    rows = np.frombuffer(raw, np.uint8).reshape(height, 1 + width * step)
    above, out = np.zeros(width * step, np.uint8), []
    for row in rows:
        above = _unfiltered(int(row[0]), row[1:], above, step)
        out.append(above)
    stored = np.stack(out).view(np.uint8 if depth == 8 else ">u2")
    return stored.reshape(height, width, CHANNELS[colour]).astype(f"u{depth // 8}")


def _unfiltered(kind: int, row: np.ndarray, above: np.ndarray, step: int) -> np.ndarray:
    """PNG third edition, 9.2: a row from its filtered bytes and the row above it."""
    if kind == 0:
        return row
    if kind == 1:
        return np.cumsum(row.reshape(-1, step), axis=0, dtype=np.uint8).reshape(-1)
    if kind == 2:
        return row + above
    assert kind in (3, 4)
    predicted = _mean if kind == 3 else _paeth
    out = np.empty_like(row)
    for i in range(step):
        out[i::step] = predicted(row[i::step].tobytes(), above[i::step].tobytes())
    return out


def _mean(row: bytes, above: bytes) -> list[int]:
    """Every `step`-th byte of a row."""
    left, out = 0, []
    for byte, up in zip(row, above, strict=True):
        left = (byte + (left + up) // 2) % 256
        out.append(left)
    return out


def _paeth(row: bytes, above: bytes) -> list[int]:
    """The same. Written out, as whole pictures go through it: `min` with a key takes three times as long."""
    left, corner, out = 0, 0, []
    for byte, up in zip(row, above, strict=True):
        away_left, away_up = abs(up - corner), abs(left - corner)
        away_corner = abs(left + up - 2 * corner)
        if away_left <= away_up and away_left <= away_corner:
            nearest = left
        else:
            nearest = up if away_up <= away_corner else corner
        left, corner = (byte + nearest) % 256, up
        out.append(left)
    return out


def gama(value: int) -> Chunk:
    """`value` is the encoding exponent × 100000, as stored: 45455 is the usual 1/2.2."""
    return b"gAMA", struct.pack(">I", value)


def chrm(white: Sequence[float], *primaries: Sequence[float]) -> Chunk:
    return b"cHRM", struct.pack(">8I", *(round(v * 1e5) for xy in (white, *primaries) for v in xy))


def srgb(intent: int = 0) -> Chunk:
    return b"sRGB", bytes([intent])


def cicp(primaries: int, transfer: int, matrix: int = 0, full_range: int = 1) -> Chunk:
    return b"cICP", bytes([primaries, transfer, matrix, full_range])


def iccp(profile: bytes, name: str = "profile") -> Chunk:
    return b"iCCP", name.encode("latin-1") + b"\0\0" + zlib.compress(profile, 9)


def phys(x: int, y: int, unit: int = 1) -> Chunk:
    return b"pHYs", struct.pack(">IIB", x, y, unit)


def text(key: str, value: str) -> Chunk:
    return b"tEXt", key.encode("latin-1") + b"\0" + value.encode("latin-1")


def bkgd(*values: int) -> Chunk:
    return b"bKGD", struct.pack(f">{len(values)}H", *values)


def time(year: int = 1999) -> Chunk:
    return b"tIME", struct.pack(">HBBBBB", year, 12, 31, 23, 59, 58)


# ---- damage ---------------------------------------------------------------------------------


def flip_bit(data: bytes, place: int, bit: int = 0) -> bytes:
    out = bytearray(data)
    out[place] ^= 1 << bit
    return bytes(out)


def chunk_spans(data: bytes) -> list[tuple[bytes, int, int]]:
    """(kind, first byte, one past the last byte) of every chunk, its length and CRC included."""
    out, i = [], 8
    for kind, body in split(data):
        out.append((kind, i, i + 12 + len(body)))
        i += 12 + len(body)
    return out


def replace_chunk(data: bytes, kind: bytes, body: bytes | None) -> bytes:
    """The same file with another body in every chunk of this kind, or without them (None)."""
    return join(
        [
            (k, b if k != kind or body is None else body)
            for k, b in split(data)
            if k != kind or body is not None
        ]
    )


def break_crc(data: bytes, kind: bytes) -> bytes:
    """The same file with a wrong CRC in the first chunk of this kind."""
    last = next(end for k, _, end in chunk_spans(data) if k == kind)
    return flip_bit(data, last - 1, 3)


# ---- ICC profiles ---------------------------------------------------------------------------

D50 = (0.9642, 1.0, 0.8249)
# xy of the primaries: IEC 61966-2-1, Adobe RGB (1998) 4.3.1.1, SMPTE RP 431-2.
SRGB_XY = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
ADOBE_XY = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
P3_XY = ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060))
D65_XY = (0.3127, 0.3290)
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def xyz_of(xy: Sequence[float]) -> np.ndarray:
    return np.array([xy[0] / xy[1], 1.0, (1 - xy[0] - xy[1]) / xy[1]])


def rgb_to_xyz(primaries: Sequence[Sequence[float]], white: Sequence[float]) -> np.ndarray:
    """The 3×3 matrix of RGB with these xy to XYZ; RGB (1, 1, 1) is the white with Y = 1."""
    columns = np.stack([xyz_of(xy) for xy in primaries], axis=1)
    return columns * np.linalg.solve(columns, xyz_of(white))


def bradford(source_xyz: Sequence[float], target_xyz: Sequence[float]) -> np.ndarray:
    """XYZ under one white to XYZ under another, the linear Bradford transform of ICC.1 Annex E."""
    scale = (BRADFORD @ np.array(target_xyz)) / (BRADFORD @ np.array(source_xyz))
    return np.linalg.inv(BRADFORD) @ np.diag(scale) @ BRADFORD


def to_rec709(primaries: Sequence[Sequence[float]], white: Sequence[float]) -> np.ndarray:
    """Linear RGB with these xy to linear Rec. 709, the white adapted with Bradford."""
    adapt = bradford(xyz_of(white), xyz_of(D65_XY))
    return np.linalg.inv(rgb_to_xyz(SRGB_XY, D65_XY)) @ adapt @ rgb_to_xyz(primaries, white)


def _s15(*values: float) -> bytes:
    return struct.pack(f">{len(values)}i", *(round(v * 65536) for v in values))


def _curve_tag(curve: float | str, version: int) -> bytes:
    if curve != "srgb":
        assert isinstance(curve, float)
        return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(curve * 256))
    if version >= 4:
        return b"para\0\0\0\0\0\3\0\0" + _s15(2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    return table(srgb_to_linear(np.linspace(0, 1, 1024)))


def _text_tag(value: str, version: int) -> bytes:
    if version >= 4:
        data = value.encode("utf-16-be")
        return b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(data), 28) + data
    data = value.encode("ascii") + b"\0"
    return b"desc\0\0\0\0" + struct.pack(">I", len(data)) + data + bytes(4 + 4 + 2 + 1 + 67)


def parametric(function: int, *parameters: float) -> bytes:
    """A parametricCurveType. ICC.1:2022, 10.18."""
    return b"para\0\0\0\0" + struct.pack(">HH", function, 0) + _s15(*parameters)


def table(values: Sequence[float]) -> bytes:
    """A curveType with these values, 0 to 1. ICC.1:2022, 10.6."""
    stored = np.round(np.asarray(values) * 65535).astype(">u2")
    return b"curv\0\0\0\0" + struct.pack(">I", len(stored)) + stored.tobytes()


def icc_profile(
    name: str,
    primaries: Sequence[Sequence[float]] = SRGB_XY,
    curve: float | str | Sequence[bytes] = "srgb",
    *,
    white: Sequence[float] = D65_XY,
    version: int = 4,
    space: bytes = b"RGB ",
    device: bytes = b"mntr",
    more: Sequence[tuple[bytes, bytes]] = (),
    without: Sequence[bytes] = (),
) -> bytes:
    """A matrix/TRC profile, ICC v2 or v4; `curve` is "srgb", one exponent, or a tag a channel.

    With `space` = b"GRAY" it holds one curve, as a grey PNG must have it. Version 4 says in a chad
    tag how the colorants were adapted, version 2 in the white point. `more`: further tags, and
    `without`: tags that are left out.
    """
    adapted = bradford(xyz_of(white), D50)
    matrix = adapted @ rgb_to_xyz(primaries, white)
    curves = [_curve_tag(curve, version)] * 3 if isinstance(curve, (float, str)) else list(curve)
    tags = [
        (b"desc", _text_tag(name, version)),
        (b"cprt", _text_tag("none", 4) if version >= 4 else b"text\0\0\0\0none\0"),
        (b"wtpt", b"XYZ \0\0\0\0" + _s15(*(D50 if version >= 4 else xyz_of(white)))),
    ]
    if version >= 4:
        tags.append((b"chad", b"sf32\0\0\0\0" + _s15(*adapted.ravel())))
    if space == b"GRAY":
        tags.append((b"kTRC", curves[0]))
    else:
        tags += [
            (b"rgb"[i : i + 1] + b"XYZ", b"XYZ \0\0\0\0" + _s15(*matrix[:, i])) for i in range(3)
        ]
        tags += [(b"rgb"[i : i + 1] + b"TRC", curves[i]) for i in range(3)]
    tags = [*(tag for tag in tags if tag[0] not in without), *more]
    directory, body = struct.pack(">I", len(tags)), b""
    start = 128 + 4 + 12 * len(tags)
    seen: dict[bytes, int] = {}
    for signature, data in tags:
        if data not in seen:
            seen[data] = start + len(body)
            body += data + bytes(-len(data) % 4)
        directory += signature + struct.pack(">II", seen[data], len(data))
    size = start + len(body)
    header = struct.pack(
        ">I4sI4s4s4s12s4s4sI4s4s8sI12s4s",
        size,
        b"\0\0\0\0",
        0x04300000 if version >= 4 else 0x02100000,
        device,
        space,
        b"XYZ ",
        struct.pack(">6H", 2000, 1, 1, 0, 0, 0),
        b"acsp",
        b"\0\0\0\0",
        0,
        b"\0\0\0\0",
        b"\0\0\0\0",
        bytes(8),
        0,
        _s15(*D50),
        b"\0\0\0\0",
    )
    return (header + bytes(128 - len(header)) + directory + body)[:size]
