"""PNG files, written: filters, one deflate stream of segments, colour chunks. Encodes no colours.

W3C, Portable Network Graphics (PNG) Specification, third edition; RFC 1950 and 1951.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

import numpy as np

from ..color.primaries import REC709, Primaries
from ..color.samples import Samples
from ..records import record
from ..system.sourcedate import source_date
from . import iccprofile
from .deflate import (
    LAST_BLOCK,
    adler32,
    crc32,
    deflated,
    deflated_fast,
    deflated_segment,
    joined_adler32,
)
from .header import PictureHeader
from .packing import Bytes, png_filtered
from .pngheader import CICP_PRIMARIES, CICP_SRGB, SIGNATURE
from .segments import SegmentWriter

_ROWS = 64
#: Below this a segment costs compression: short windows and a flush.
_SEGMENT_BYTES = 1 << 18

#: Colour type RGB with alpha.
_RGBA = 6
_LARGEST_NUMBER = 2**31 - 1


#: How filtered rows become bytes. `small`: the smaller of zlib's best levels.
COMPRESSIONS: dict[str, Callable[[Bytes], bytes]] = {
    "fast": deflated_fast,
    "small": lambda filtered: min((deflated_segment(filtered, n) for n in (8, 9)), key=len),
    **{str(level): partial(deflated_segment, level=level) for level in range(10)},
}


@record
class Segment:
    """Rows as they stand in the file: deflated, with the checksum and size of what was deflated."""

    deflated: bytes
    adler: int
    size: int


def segment_bytes(row_bytes: int) -> int:
    """The size of a segment of rows that long."""
    return _ROWS * row_bytes * -(-_SEGMENT_BYTES // (_ROWS * row_bytes))


class PngWriter(SegmentWriter[Segment]):
    """Writes one RGBA picture, rows top to bottom, whose codes have the curve of sRGB.

    `depth`: 8 or 16 bits. `compression`: one of `COMPRESSIONS`. `label` names the file in errors.
    """

    def __init__(
        self,
        path: str,
        header: PictureHeader,
        depth: int,
        compression: str,
        label: str,
    ) -> None:
        width, height = header.data_window.width, header.data_window.height
        row_bytes = width * 4 * depth // 8
        super().__init__(path, label, height, segment_bytes(row_bytes) // row_bytes)
        self._pixel_bytes = 4 * depth // 8
        self._deflated = COMPRESSIONS[compression]
        self._adler = 1
        self._put_bytes(SIGNATURE)
        self._put(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, _RGBA, 0, 0, 0))
        self._put_color(header.primaries)
        self._put_density(header)
        self._put_date()
        self._put(b"IDAT", b"\x78\x01")

    def _put_color(self, primaries: Primaries) -> None:
        """The curve of sRGB and these primaries, in each way that there is, the precise ones first.

        Most readers know no cICP, and some no ICC profile.
        """
        if primaries == REC709:
            self._put(b"sRGB", b"\0")
        else:
            self._put(b"cICP", bytes([CICP_PRIMARIES[primaries], CICP_SRGB, 0, 1]))
            name = f"{primaries.name}, sRGB curve"
            profile = deflated(iccprofile.profile(name, primaries))
            self._put(b"iCCP", name.encode("latin-1") + b"\0\0" + profile)
        self._put(b"gAMA", struct.pack(">I", 45455))
        red, green, blue, white = np.rint(primaries.xy * 100000).astype(int).tolist()
        self._put(b"cHRM", struct.pack(">8I", *white, *red, *green, *blue))

    def _put_density(self, header: PictureHeader) -> None:
        """pHYs, where there is anything to say that its numbers can hold."""
        if header.pixels_per_metre is not None:
            densities, unit = header.pixels_per_metre, 1
        elif header.pixel_aspect != 1:
            # Pixels a unit, of no unit: their ratio is the shape of a pixel.
            densities, unit = (10000.0, 10000.0 * header.pixel_aspect), 0
        else:
            return
        if all(0.5 < density < _LARGEST_NUMBER for density in densities):
            self._put(b"pHYs", struct.pack(">IIB", *map(round, densities), unit))

    def _put_date(self) -> None:
        """tIME, where the environment has a date."""
        date = source_date()
        if date is not None:
            self._put(b"tIME", struct.pack(">H5B", *date.timetuple()[:6]))

    def _complete(self) -> None:
        self._put(b"IDAT", LAST_BLOCK + struct.pack(">I", self._adler))
        self._put(b"IEND", b"")

    def _segment(self, rows: Samples) -> Segment:
        if rows.dtype == np.uint16:
            rows = rows.astype(">u2")
        stored = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
        filtered = png_filtered(stored, self._pixel_bytes)
        return Segment(self._deflated(filtered), adler32(filtered), filtered.size)

    def _append(self, segment: Segment) -> None:
        self._adler = joined_adler32(self._adler, segment.adler, segment.size)
        self._put(b"IDAT", segment.deflated)

    def _put(self, kind: bytes, data: bytes) -> None:
        checksum = crc32(data, crc32(kind))
        self._put_bytes(struct.pack(">I", len(data)) + kind)
        self._put_bytes(data)
        self._put_bytes(struct.pack(">I", checksum))
