"""Deflate and its checksums, by the libraries that measured fastest. Their only importer.

`isal` inflates, and deflates where speed goes before size; `zlib-ng` deflates at zlib's levels.
Both release the GIL. RFC 1950 and 1951.
"""

from __future__ import annotations

import zlib

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray
from zlib_ng import zlib_ng

Bytes = bytes | NDArray[np.uint8]

#: What inflating damaged data raises.
InflateError: type[Exception] = isal_zlib.error  # type: ignore[assignment]

adler32 = isal_zlib.adler32
crc32 = isal_zlib.crc32

#: Deflate's end: a last block without content.
LAST_BLOCK = b"\x03\x00"

#: Of isal's levels 0 to 3 the one that packs half-float planes best for its time: 0.10 s for a
#: picture of 4K that zlib's level 4 takes 0.80 s for, 5% larger.
_EXR_LEVEL = 2
_ADLER_BASE = 65521


def inflated(data: bytes, size: int) -> bytes:
    """A whole zlib stream of `size` bytes, never more; `InflateError` where it is not that."""
    stream = isal_zlib.decompressobj(zlib.MAX_WBITS)
    content = bytes(stream.decompress(data, size))
    surplus = b"" if stream.eof else stream.decompress(stream.unconsumed_tail, 1)
    if len(content) < size or surplus or not stream.eof or stream.unused_data:
        raise InflateError("another size")
    return content


def deflated(data: Bytes) -> bytes:
    """A whole zlib stream, made fast."""
    return bytes(isal_zlib.compress(data, _EXR_LEVEL))


def deflated_segment(data: Bytes, level: int) -> bytes:
    """A part of a raw deflate stream that depends on no other part, at a level of zlib's."""
    stream = zlib_ng.compressobj(level, zlib_ng.DEFLATED, -zlib.MAX_WBITS, 9)
    return bytes(stream.compress(data)) + bytes(stream.flush(zlib_ng.Z_FULL_FLUSH))


class InflateStream:
    """A zlib stream that is inflated piece by piece, in bounded memory."""

    def __init__(self) -> None:
        self._stream = isal_zlib.decompressobj(zlib.MAX_WBITS)
        self._tail = b""

    @property
    def ended(self) -> bool:
        """Whether the stream is at its end."""
        return bool(self._stream.eof)

    def feed(self, data: bytes) -> None:
        """Takes more of the deflated data."""
        self._tail += data

    def take(self, size: int) -> bytes:
        """Up to `size` bytes of the content; none where it must be fed, or is at its end."""
        content = bytes(self._stream.decompress(self._tail, size))
        self._tail = self._stream.unconsumed_tail
        return content


def joined_adler32(first: int, second: int, second_size: int) -> int:
    """The Adler-32 of two runs of bytes, one after the other, from theirs. RFC 1950, 9."""
    a1, b1, a2, b2 = first & 0xFFFF, first >> 16, second & 0xFFFF, second >> 16
    a = (a1 + a2 - 1) % _ADLER_BASE
    b = (b1 + b2 + second_size % _ADLER_BASE * (a1 - 1)) % _ADLER_BASE
    return b << 16 | a
