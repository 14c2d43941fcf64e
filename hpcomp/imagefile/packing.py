"""Samples to the bytes that codecs deflate, and back, by the kernel's loops.

Where the kernel was not built, numpy packs, to the same bytes, and OpenImageIO reads.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..color.samples import Samples

try:
    from ..kernel._kernel import packing as _loops
except ImportError:
    _loops = None  # type: ignore[assignment]

Bytes = NDArray[np.uint8]

#: Whether files can be unpacked here; both formats' loops are for the byte order of most machines.
UNPACKS = _loops is not None and sys.byteorder == "little"

_NONE, _SUB, _UP, _AVERAGE, _PAETH = range(5)
#: EXR's differences of bytes are stored with this added.
_EXR_BIAS = 128


def exr_unpacked(
    block: bytes,
    packed: bool,
    row_bytes: int,
    channel_bytes: Sequence[int],
    first_row: int,
    out: Samples,
) -> None:
    """Rows of a block of an EXR, from `first_row` on, as interleaved samples in `out`.

    `block`: whole rows of `row_bytes`, planes of the file's channels in each; `packed` as ZIP has
    them, else plain. `channel_bytes`: where in a row each channel of `out` begins; multiples of 2.
    `out`: (rows, width, channels) float16 or float32. Only where `UNPACKS`.
    """
    data = np.frombuffer(block, np.uint8)
    _loops.exr_unpack(
        block=data,
        packed=packed,
        row_units=row_bytes // 2,
        channels=[begin // 2 for begin in channel_bytes],
        first_row=first_row,
        out=out,
    )


def exr_plain(samples: Samples) -> bytes:
    """Samples (rows, width, channels) as rows of planes, as EXR stores them uncompressed.

    The last channel comes first: names are sorted, and RGBA stands as A, B, G, R.
    """
    planes = np.moveaxis(samples[..., ::-1], 2, 1)
    return planes.astype(planes.dtype.newbyteorder("<")).tobytes()


def exr_packed(samples: Samples) -> Bytes:
    """The same as what EXR's ZIP deflates: differences of the bytes of planes."""
    if UNPACKS:
        packed = np.empty(samples.nbytes, np.uint8)
        _loops.exr_pack(samples=np.ascontiguousarray(samples), out=packed)
        return packed
    plain = np.frombuffer(exr_plain(samples), np.uint8)
    split = np.concatenate([plain[::2], plain[1::2]])
    packed = split.copy()
    packed[1:] -= split[:-1]
    packed[1:] += _EXR_BIAS
    return packed


def png_unfiltered(filtered: Bytes, pixel_bytes: int, above: Bytes, out: Bytes) -> None:
    """Rows of a PNG (rows, bytes) from filtered ones (rows, 1 + bytes), each behind its filter.

    `above`: the row before the first, zeros for none. Errors: `ValueError` for an unknown filter.
    Only where `UNPACKS`.
    """
    _loops.png_unfilter(filtered=filtered, pixel_bytes=pixel_bytes, above=above, out=out)


def png_filtered(rows: Bytes, pixel_bytes: int) -> Bytes:
    """Rows (rows, bytes) as differences to what a filter makes of their neighbours.

    Of the five filters, for each row the one whose differences have the least sum, of equal ones
    the first; nothing is above the first row. Returns (rows, 1 + bytes), the filter's number first.
    """
    if _loops is None:
        return _png_filtered_by_numpy(rows, pixel_bytes)
    filtered = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    _loops.png_filter(rows=np.ascontiguousarray(rows), pixel_bytes=pixel_bytes, out=filtered)
    return filtered


def _png_filtered_by_numpy(rows: Bytes, pixel_bytes: int) -> Bytes:
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
        sums = {kind: _size_of(differences) for kind, differences in candidates.items()}
        kind = min(sums, key=sums.__getitem__)
        best[number, 0], best[number, 1:] = kind, candidates[kind]
    return best


def _paeth(left: Bytes, above: Bytes, corner: Bytes) -> Bytes:
    """PNG specification, 9.4: of three neighbours the nearest to left + above − corner."""
    a, b, c = (v.astype(np.int16) for v in (left, above, corner))
    to_a, to_b, to_c = np.abs(b - c), np.abs(a - c), np.abs(a + b - 2 * c)
    return np.where((to_a <= to_b) & (to_a <= to_c), left, np.where(to_b <= to_c, above, corner))


def _size_of(differences: Bytes) -> int:
    """The sum of their sizes as signed bytes."""
    return int(np.minimum(differences, -differences).sum(dtype=np.int64))
