"""The chunks of a PNG file: checksums, and what they say of colour and pixel shape. No pixels.

Image libraries ignore damage outside the pixels and disagree about colour chunks; here every
checksum is verified and each chunk is taken for what the PNG specification (third edition) says.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import BinaryIO

import numpy as np

from ..color.encodings import SRGB_ENCODING, ColorEncoding
from ..color.primaries import PRIMARIES, Primaries, primaries_from_xy
from ..color.transfer import (
    HDR_TRANSFERS,
    LINEAR,
    REC709_CAMERA,
    SRGB,
    Transfer,
    gamma,
    narrow_range,
)
from ..errors import InputError
from ..records import record
from . import iccprofile
from .filecolor import DEFAULT, FileColor

SIGNATURE = b"\x89PNG\r\n\x1a\n"

#: Where the data of the first chunk begin, behind its size and kind.
_FIRST_DATA = len(SIGNATURE) + 8
#: Chunks whose content is kept; the others are only verified.
_KEPT = {b"IHDR", b"PLTE", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"cICP", b"pHYs"}
_KEPT |= {b"acTL", b"eXIf", b"oFFs"}
#: Those that must be understood.
_CRITICAL = {b"IHDR", b"PLTE", b"IDAT", b"IEND"}
#: Those that decide colour, and that the image data follow: without one the picture is another.
_DECIDES_COLOR = {b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"cICP"}
_LARGEST = 2**31 - 1
#: Of the pieces of image data so many are kept at most: 512 MiB, as libpng cuts them.
MOST_PIECES = 1 << 16
#: The depths of each colour type: grey, RGB, palette, grey and alpha, RGBA; and its channels.
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
#: How many bytes deflate makes of one at most.
_MOST_OF_A_BYTE = 1032
_PIECE_BYTES = 1 << 20
#: No display profile is larger; a hostile one is not unpacked beyond it, and no chunk is kept.
_PROFILE_BYTES = 1 << 24

#: The power that stands for sRGB in a gAMA chunk alone: 45455, or what is rounded in another way.
_GAMMA_OF_SRGB = 2.2

#: ITU-T H.273 code points: colour primaries, transfer curves.
_CICP_PRIMARIES: dict[int, Primaries] = {
    1: PRIMARIES["rec709"],
    9: PRIMARIES["rec2020"],
    12: PRIMARIES["display-p3"],
}
#: The same the other way, for those who write.
CICP_PRIMARIES = {primaries: code for code, primaries in _CICP_PRIMARIES.items()}
CICP_SRGB = 13
_CICP_TRANSFER: dict[int, Transfer] = {
    1: REC709_CAMERA,
    6: REC709_CAMERA,
    8: LINEAR,
    CICP_SRGB: SRGB,
    14: REC709_CAMERA,
    15: REC709_CAMERA,
    **HDR_TRANSFERS,
}
#: Colour types without colour: grey, and grey with alpha.
_GREY_TYPES = (0, 4)
_PALETTE = 3


@record
class PngHeader:
    """What the chunks around the pixels say.

    `image_data`: offset and size of each IDAT that is not empty; of `MOST_PIECES` + 1 at most.
    `dropped`: of each chunk that is left out, what is wrong with it.
    """

    width: int
    height: int
    depth: int
    color_type: int
    interlaced: bool
    image_data: tuple[tuple[int, int], ...] = field(repr=False)
    chunks: dict[bytes, bytes] = field(repr=False)
    dropped: tuple[str, ...] = ()

    @property
    def pixels_per_metre(self) -> tuple[int, int] | None:
        """pHYs where it has a unit."""
        density = self.chunks.get(b"pHYs", b"")
        if len(density) != 9 or density[8] != 1:
            return None
        x, y = struct.unpack(">II", density[:8])
        return (x, y) if x and y else None

    @property
    def pixel_aspect(self) -> float:
        """Width of a pixel over its height."""
        density = self.chunks.get(b"pHYs", b"")
        x, y = struct.unpack(">II", density[:8]) if len(density) == 9 else (1, 1)
        return y / x if x and y else 1.0

    @property
    def icc_profile(self) -> str:
        """What the ICC profile calls itself, or the file the profile; empty where there is none."""
        name = self.chunks.get(b"iCCP", b"").partition(b"\0")[0].decode("latin-1")
        try:
            return iccprofile.description(_profile(self)) or name
        except ValueError:
            return name

    def color(self) -> FileColor:
        """What the chunks say of its colours.

        Precedence: cICP, iCCP, sRGB, gAMA and cHRM, else sRGB. What is not honoured falls through
        to the next. PNG specification, third edition, 4.3.
        """
        problems: list[str] = []
        for chunk, reader, source in _COLOR_CHUNKS:
            if chunk in self.chunks:
                try:
                    return FileColor(reader(self), source, source, tuple(problems))
                except ValueError as reason:
                    problems.append(str(reason))
        transfer, primaries = SRGB, SRGB_ENCODING.primaries
        transfer_from = primaries_from = DEFAULT
        if b"cHRM" in self.chunks:
            try:
                primaries, primaries_from = _primaries_of(self.chunks[b"cHRM"]), "cHRM"
            except ValueError as reason:
                problems.append(str(reason))
        if b"gAMA" in self.chunks:
            try:
                of_srgb = primaries_from == DEFAULT
                transfer, transfer_from = _transfer_of(self.chunks[b"gAMA"], of_srgb), "gAMA"
            except ValueError as reason:
                problems.append(str(reason))
        encoding = ColorEncoding(transfer, primaries)
        return FileColor(encoding, transfer_from, primaries_from, tuple(problems))


def _from_cicp(header: PngHeader) -> ColorEncoding:
    data = header.chunks[b"cICP"]
    if len(data) != 4:
        raise ValueError("a cICP chunk that is not 4 bytes long")
    primaries, transfer, matrix, full_range = data
    if matrix or primaries not in _CICP_PRIMARIES or transfer not in _CICP_TRANSFER:
        raise ValueError(f"cICP {primaries}/{transfer}/{matrix}/{full_range}")
    curve = _CICP_TRANSFER[transfer]
    if not full_range and curve not in HDR_TRANSFERS.values():
        # The entries of a palette have 8 bits, however many its indices have.
        curve = narrow_range(curve, 8 if header.color_type == _PALETTE else header.depth)
    return ColorEncoding(curve, _CICP_PRIMARIES[primaries])


def _profile(header: PngHeader) -> bytes:
    """The ICC profile, unpacked; `ValueError` where that fails."""
    _, _, rest = header.chunks.get(b"iCCP", b"").partition(b"\0")
    try:
        return zlib.decompressobj().decompress(rest[1:], _PROFILE_BYTES)
    except zlib.error:
        raise ValueError("an ICC profile that does not decompress") from None


def _from_iccp(header: PngHeader) -> ColorEncoding:
    profile = _profile(header)
    try:
        return iccprofile.encoding(profile, header.color_type in _GREY_TYPES)
    except ValueError as reason:
        raise ValueError(f"the ICC profile '{header.icc_profile}' ({reason})") from None


def _from_srgb(header: PngHeader) -> ColorEncoding:
    return SRGB_ENCODING


def _transfer_of(gama: bytes, alone: bool) -> Transfer:
    """The curve that gAMA names; `ValueError` where it names none.

    It is a pure power, but where it is `alone`, without cHRM, 2.2 is how sRGB was written before
    there was an sRGB chunk: libpng and browsers leave such samples as they are.
    """
    exponent = struct.unpack(">I", gama)[0] if len(gama) == 4 else 0
    if not exponent:
        raise ValueError("a gAMA chunk that is zero or not 4 bytes long")
    power = 100000 / exponent
    return SRGB if alone and round(power, 2) == _GAMMA_OF_SRGB else gamma(power)


def _primaries_of(chrm: bytes) -> Primaries:
    """The primaries that cHRM names; `ValueError` where it names none."""
    if len(chrm) != 32:
        raise ValueError("a cHRM chunk that is not 32 bytes long")
    white, *rgb = np.array(struct.unpack(">8i", chrm)).reshape(4, 2) / 100000
    return primaries_from_xy([*rgb, white])


#: The chunks that say curve and primaries at once, the first that is honoured first: what reads
#: them, and what they are called.
_COLOR_CHUNKS = (
    (b"cICP", _from_cicp, "cICP"),
    (b"iCCP", _from_iccp, "iCCP"),
    (b"sRGB", _from_srgb, "sRGB chunk"),
)


def read_header(path: str) -> PngHeader:
    """Walks a PNG from its signature to IEND, checking every chunk's CRC.

    A damaged chunk is left out where nothing of the picture depends on it, as libpng does. Errors:
    `InputError` (without the file's name) that says which chunk is damaged or missing.
    """
    kept: dict[bytes, bytes] = {}
    image_data: list[tuple[int, int]] = []
    dropped: list[str] = []
    image_bytes, begun, last = 0, False, b""
    with open(path, "rb") as file:
        if file.read(8) != SIGNATURE:
            raise InputError("not a PNG file: its signature is damaged")
        for chunk in _chunks(file):
            kind, before, last = chunk.kind, last, chunk.kind
            if kind[:1].isupper() and kind not in _CRITICAL:
                raise InputError(f"{_shown(kind)} must be understood and is not")
            if not chunk.sound:
                if not _can_be_dropped(kind):
                    raise InputError(f"damaged PNG: the checksum of {_shown(kind)} is wrong")
                dropped.append(f"the checksum of {_shown(kind)} is wrong, and it is left out")
                continue
            if (kind == b"IHDR") != (chunk.offset == _FIRST_DATA):
                raise InputError(f"damaged PNG: {_shown(kind)} is out of place")
            if kind == b"IDAT":
                if begun and before != b"IDAT":
                    raise InputError(
                        f"damaged PNG: its IDAT chunks are not consecutive, {_shown(before)} is "
                        "between them"
                    )
                begun = True
                image_bytes += chunk.size
                if chunk.size and len(image_data) <= MOST_PIECES:
                    image_data.append((chunk.offset, chunk.size))
            elif kind in _DECIDES_COLOR and begun:
                dropped.append(f"{_shown(kind)} is behind the image data, and it is left out")
            elif kind == b"tRNS" and not _fits(chunk.data, kept):
                dropped.append("its tRNS chunk does not fit it, and it is left out")
            elif kind in _KEPT and kind not in kept:
                kept[kind] = chunk.data
        if file.read(8) == SIGNATURE:
            dropped.append("another PNG is behind its end, and it is left out")
    return _header_of(kept, image_data, image_bytes, dropped)


def _header_of(
    kept: dict[bytes, bytes],
    image_data: Sequence[tuple[int, int]],
    image_bytes: int,
    dropped: Sequence[str],
) -> PngHeader:
    """What the chunks of a whole file say. Errors: `InputError` where they make no picture."""
    if len(kept.get(b"IHDR", b"")) != 13 or not image_data:
        raise InputError("damaged PNG: it has no image data")
    width, height, depth, color_type, deflate, filters, interlace = struct.unpack(
        ">IIBBBBB", kept[b"IHDR"]
    )
    if not (1 <= width <= _LARGEST and 1 <= height <= _LARGEST):
        raise InputError(f"damaged PNG: it has {width}x{height} pixels")
    if depth not in _DEPTHS.get(color_type, ()) or (deflate, filters) != (0, 0) or interlace > 1:
        raise InputError("damaged PNG: its header describes no kind of PNG that there is")
    row_bits = width * depth * _CHANNELS[color_type]
    # A filter is before each row; what that takes in the passes of an interlaced one is not needed.
    least = height * (1 + -(-row_bits // 8)) if not interlace else height * row_bits // 8
    if least > _MOST_OF_A_BYTE * image_bytes:
        raise InputError(f"damaged PNG: its image data are too few for {width}x{height} pixels")
    return PngHeader(
        width,
        height,
        depth,
        color_type,
        interlace == 1,
        tuple(image_data),
        kept,
        tuple(dict.fromkeys(dropped)),
    )


@record
class _Chunk:
    """A chunk: its data where they are kept, their place in the file, whether its CRC is right."""

    kind: bytes
    data: bytes
    offset: int
    size: int
    sound: bool


def _chunks(file: BinaryIO) -> Iterator[_Chunk]:
    """The chunks from the first to IEND. Errors: `InputError` where the file ends before."""
    kind, at = b"", len(SIGNATURE)
    while kind != b"IEND":
        head = file.read(8)
        if len(head) < 8:
            raise InputError("truncated PNG: it ends before its IEND chunk")
        size, kind = struct.unpack(">I4s", head)
        left = size
        checksum = zlib.crc32(kind)
        data = b""
        while left:
            piece = file.read(min(left, _PIECE_BYTES))
            if not piece:
                raise InputError(f"truncated PNG: it ends inside {_shown(kind)}")
            checksum = zlib.crc32(piece, checksum)
            left -= len(piece)
            if kind in _KEPT and size <= _PROFILE_BYTES:
                data += piece
        sound = file.read(4) == struct.pack(">I", checksum)
        yield _Chunk(kind, data, at + 8, size, sound)
        at += 12 + size


def _can_be_dropped(kind: bytes) -> bool:
    """Whether a damaged chunk of that name is one that nothing of the picture depends on.

    Its name may be what is damaged: one bit more must not make it another.
    """
    number = int.from_bytes(kind)
    bits = [(number ^ int.from_bytes(other)).bit_count() for other in _CRITICAL | _DECIDES_COLOR]
    return kind.isalpha() and kind.isascii() and kind[:1].islower() and min(bits) > 1


def _fits(transparency: bytes, kept: Mapping[bytes, bytes]) -> bool:
    """Whether a tRNS chunk is one of such a picture, at this place: libpng leaves others out."""
    color_type = kept.get(b"IHDR", bytes(10))[9]
    if color_type == _PALETTE:
        return 1 <= len(transparency) <= len(kept.get(b"PLTE", b"")) // 3
    return len(transparency) == {0: 2, 2: 6}.get(color_type)


def _shown(kind: bytes) -> str:
    return f"its {kind.decode()} chunk" if kind.isalpha() and kind.isascii() else "a chunk"
