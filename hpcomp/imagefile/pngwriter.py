"""PNG files, written: row filters, one deflate stream made of segments, and colour chunks.

A segment is a fixed number of rows that is filtered and compressed by itself, so that segments can
be made side by side, and so that the bytes do not depend on how the rows arrive.
W3C, Portable Network Graphics (PNG) Specification, third edition; RFC 1950 and 1951.
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

from ..encoding import REC709
from ..errors import OutputError, why
from ..pngheader import SIGNATURE
from ..samples import Samples

Bytes2D = NDArray[np.uint8]

_ROWS = 64
#: Below this a segment costs compression: short windows and a flush.
_SEGMENT_BYTES = 1 << 18

_NONE, _SUB, _UP, _AVERAGE, _PAETH = range(5)
#: Colour type RGB with alpha.
_RGBA = 6
_ADLER_BASE = 65521
_LARGEST_NUMBER = 2**31 - 1
#: Deflate's end: a last block without content.
_LAST_BLOCK = b"\x03\x00"


@dataclass(frozen=True)
class Compression:
    """How rows become bytes: the filter of each row, and a deflate of one segment."""

    filtered: Callable[[Bytes2D, int], Bytes2D]
    deflate: Callable[[Bytes2D], bytes]


def _up(rows: Bytes2D, pixel_bytes: int) -> Bytes2D:
    """Differences to the row above; the first row's to the pixel on its left."""
    filtered = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    filtered[0] = _against_left(rows[:1], pixel_bytes)[0]
    filtered[1:, 0] = _UP
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    return filtered


def _against_left(rows: Bytes2D, pixel_bytes: int) -> Bytes2D:
    filtered = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = _SUB
    filtered[:, 1 : 1 + pixel_bytes] = rows[:, :pixel_bytes]
    np.subtract(rows[:, pixel_bytes:], rows[:, :-pixel_bytes], out=filtered[:, 1 + pixel_bytes :])
    return filtered


def _adaptive(rows: Bytes2D, pixel_bytes: int) -> Bytes2D:
    """Of the five filters, for each row the one with the least sum of absolute differences."""
    best = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    for number, row in enumerate(rows):
        left = np.zeros_like(row)
        left[pixel_bytes:] = row[:-pixel_bytes]
        candidates = {_NONE: row, _SUB: row - left}
        if number:
            above = rows[number - 1]
            corner = np.zeros_like(row)
            corner[pixel_bytes:] = above[:-pixel_bytes]
            candidates[_UP] = row - above
            mean = (left.astype(np.uint16) + above) >> 1
            candidates[_AVERAGE] = row - mean.astype(np.uint8)
            candidates[_PAETH] = row - _paeth(left, above, corner)
        sums = {
            kind: int(np.abs(c.view(np.int8).astype(np.int16)).sum())
            for kind, c in candidates.items()
        }
        kind = min(sums, key=sums.__getitem__)
        best[number, 0], best[number, 1:] = kind, candidates[kind]
    return best


def _paeth(left: Bytes2D, above: Bytes2D, corner: Bytes2D) -> Bytes2D:
    """PNG specification, 9.4: of three neighbours the nearest to left + above − corner."""
    a, b, c = (v.astype(np.int16) for v in (left, above, corner))
    to_a, to_b, to_c = np.abs(b - c), np.abs(a - c), np.abs(a + b - 2 * c)
    return np.where((to_a <= to_b) & (to_a <= to_c), left, np.where(to_b <= to_c, above, corner))


def _isal(level: int) -> Callable[[Bytes2D], bytes]:
    def deflate(filtered: Bytes2D) -> bytes:
        stream = isal_zlib.compressobj(level, isal_zlib.DEFLATED, -zlib.MAX_WBITS)
        return bytes(stream.compress(filtered.data)) + bytes(stream.flush(isal_zlib.Z_FULL_FLUSH))

    return deflate


def _zlib(level: int) -> Callable[[Bytes2D], bytes]:
    def deflate(filtered: Bytes2D) -> bytes:
        stream = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS, 9)
        return stream.compress(filtered.data) + stream.flush(zlib.Z_FULL_FLUSH)

    return deflate


#: `fast` is Intel's deflate of one filter; the numbers are zlib's levels, `small` its best.
COMPRESSIONS: dict[str, Compression] = {
    "fast": Compression(_up, _isal(1)),
    "small": Compression(_adaptive, _zlib(9)),
    **{str(level): Compression(_adaptive, _zlib(level)) for level in range(10)},
}


@dataclass(frozen=True)
class Segment:
    """Rows as they stand in the file: deflated, with the checksum and size of what was deflated."""

    deflated: bytes
    adler: int
    size: int
    rows: int


def segment_bytes(row_bytes: int) -> int:
    """The size of a segment of rows that long."""
    return _ROWS * row_bytes * -(-_SEGMENT_BYTES // (_ROWS * row_bytes))


class PngWriter:
    """Writes one RGBA picture, rows top to bottom. `label` names the file in errors."""

    def __init__(
        self,
        path: str,
        width: int,
        height: int,
        depth: int,
        compression: str,
        *,
        pixel_aspect: float,
        pixels_per_metre: tuple[float, float] | None,
        label: str,
    ) -> None:
        self.label = label
        self._width, self._height = width, height
        self._pixel_bytes = 4 * depth // 8
        self._compression = COMPRESSIONS[compression]
        row_bytes = width * self._pixel_bytes
        self._segment_rows = segment_bytes(row_bytes) // row_bytes
        self._waiting: list[Samples] = []
        self._rows = 0
        self._adler = 1
        try:
            self._file: BinaryIO = open(path, "wb")  # noqa: SIM115
        except OSError as reason:
            raise self._error(reason) from None
        self._put_bytes(SIGNATURE)
        self._put(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, _RGBA, 0, 0, 0))
        self._put(b"sRGB", b"\0")
        self._put(b"gAMA", struct.pack(">I", 45455))
        red, green, blue, white = np.rint(REC709.xy * 100000).astype(int).tolist()
        self._put(b"cHRM", struct.pack(">8I", *white, *red, *green, *blue))
        self._put_density(pixel_aspect, pixels_per_metre)
        self._put(b"IDAT", b"\x78\x01")

    def _put_density(
        self, pixel_aspect: float, pixels_per_metre: tuple[float, float] | None
    ) -> None:
        """pHYs, where there is anything to say that its numbers can hold."""
        if pixels_per_metre is not None:
            densities, unit = pixels_per_metre, 1
        elif pixel_aspect != 1:
            # Pixels a unit, of no unit: their ratio is the shape of a pixel.
            densities, unit = (10000.0, 10000.0 * pixel_aspect), 0
        else:
            return
        if all(0.5 < density < _LARGEST_NUMBER for density in densities):
            self._put(b"pHYs", struct.pack(">IIB", *map(round, densities), unit))

    def prepare(self, begin: int, rows: Samples) -> list[Segment] | Samples:
        """What of the work on rows from `begin` on needs no other rows: any thread may do it."""
        end = begin + len(rows)
        whole = self._segment_rows
        if begin % whole or (end % whole and end != self._height):
            return rows
        return [self._segment(rows[i : i + whole]) for i in range(0, len(rows), whole)]

    def write(self, prepared: list[Segment] | Samples) -> None:
        """Appends what `prepare` gave, in the order of the rows."""
        if isinstance(prepared, list):
            for segment in prepared:
                self._rows += segment.rows
                self._append(segment)
            return
        self._waiting.append(prepared)
        self._rows += len(prepared)
        rows = sum(map(len, self._waiting))
        if rows >= self._segment_rows or self._rows == self._height:
            gathered = np.concatenate(self._waiting)
            whole = rows if self._rows == self._height else rows - rows % self._segment_rows
            self._waiting = [gathered[whole:].copy()]
            for i in range(0, whole, self._segment_rows):
                self._append(self._segment(gathered[i : min(i + self._segment_rows, whole)]))

    def finish(self) -> None:
        """Completes the file; `OutputError` where it cannot be."""
        assert self._rows == self._height, "rows are missing"
        self._put(b"IDAT", _LAST_BLOCK + struct.pack(">I", self._adler))
        self._put(b"IEND", b"")
        try:
            self._file.close()
        except OSError as reason:
            raise self._error(reason) from None

    def abandon(self) -> None:
        """Closes the file, whatever state it is in."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _segment(self, rows: Samples) -> Segment:
        if rows.dtype == np.uint16:
            rows = rows.astype(">u2")
        stored = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
        filtered = self._compression.filtered(stored, self._pixel_bytes)
        deflated = self._compression.deflate(filtered)
        return Segment(deflated, zlib.adler32(filtered.data), filtered.size, len(rows))

    def _append(self, segment: Segment) -> None:
        self._adler = _adler32_joined(self._adler, segment.adler, segment.size)
        self._put(b"IDAT", segment.deflated)

    def _put(self, kind: bytes, data: bytes) -> None:
        checksum = zlib.crc32(data, zlib.crc32(kind))
        self._put_bytes(struct.pack(">I", len(data)) + kind)
        self._put_bytes(data)
        self._put_bytes(struct.pack(">I", checksum))

    def _put_bytes(self, data: bytes) -> None:
        try:
            self._file.write(data)
        except OSError as reason:
            raise self._error(reason) from None

    def _error(self, reason: OSError) -> OutputError:
        return OutputError(f"{self.label}: cannot be written: {why(reason)}")


def _adler32_joined(first: int, second: int, second_size: int) -> int:
    """The Adler-32 of two runs of bytes, one after the other, from theirs. RFC 1950, 9."""
    a1, b1, a2, b2 = first & 0xFFFF, first >> 16, second & 0xFFFF, second >> 16
    a = (a1 + a2 - 1) % _ADLER_BASE
    b = (b1 + b2 + second_size % _ADLER_BASE * (a1 - 1)) % _ADLER_BASE
    return b << 16 | a
