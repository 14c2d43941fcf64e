"""Deflate and its checksums, by the libraries that measured fastest. Their only importer.

`isal` inflates, and deflates where speed goes before size; `zlib-ng` deflates at zlib's levels.
Both release the GIL. RFC 1950 and 1951.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import partial

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


def deflated_segment(data: Bytes, level: int, strategy: int = zlib_ng.Z_DEFAULT_STRATEGY) -> bytes:
    """A part of a raw deflate stream that depends on no other part, at a level of zlib's."""
    stream = zlib_ng.compressobj(level, zlib_ng.DEFLATED, -zlib.MAX_WBITS, 9, strategy)
    return bytes(stream.compress(data)) + bytes(stream.flush(zlib_ng.Z_FULL_FLUSH))


def _segment_by_isal(data: Bytes) -> bytes:
    stream = isal_zlib.compressobj(1, isal_zlib.DEFLATED, -zlib.MAX_WBITS)
    return bytes(stream.compress(data)) + bytes(stream.flush(isal_zlib.Z_FULL_FLUSH))


#: The ways of `deflated_fast`, the fastest first: isal is no larger than the others where hardly
#: anything can be packed, runs alone where pictures are smooth or noisy, zlib's level 3 elsewhere.
_FAST: tuple[Callable[[Bytes], bytes], ...] = (
    _segment_by_isal,
    partial(deflated_segment, level=1, strategy=zlib_ng.Z_RLE),
    partial(deflated_segment, level=3),
)
#: What a faster way may cost over the smallest one.
_ALLOWED = 1.02
#: So many pieces of the data are tried first, of so many bytes.
_PIECES, _PIECE_BYTES = 4, 1 << 12


def deflated_fast(data: NDArray[np.uint8]) -> bytes:
    """The same, small and fast: in the way that does best on a sample, pieces from all over."""
    plain = data.reshape(-1)
    begins = range(0, plain.size, max(_PIECE_BYTES, -(-plain.size // _PIECES)))
    sample = np.concatenate([plain[begin : begin + _PIECE_BYTES] for begin in begins])
    sizes = [len(way(sample)) for way in _FAST]
    enough = _ALLOWED * min(sizes)
    return next(way for way, size in zip(_FAST, sizes, strict=True) if size <= enough)(data)


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
