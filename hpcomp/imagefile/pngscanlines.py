"""Plain PNG files, read without a library: 8 or 16 bits, no palette, not interlaced. No colours.

`layout_of` says which files are of this kind; all others are OpenImageIO's.
W3C, Portable Network Graphics (PNG) Specification, third edition.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..color.samples import Samples
from ..errors import InputError
from ..records import record
from .deflate import InflateError, InflateStream
from .packing import UNPACKS, png_unfiltered
from .pngheader import MOST_PIECES, PngHeader
from .rawfile import RawFile

#: Channels of the colour types that are read here: grey, RGB, grey and alpha, RGBA.
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
#: Of the deflated data that are read at a time.
_PIECE_BYTES = 1 << 16
#: Of filtered rows that are inflated at a time, so that they are unfiltered in cache.
_FILTERED_BYTES = 1 << 18
#: The state of an inflating stream and its window.
_INFLATE_BYTES = 1 << 17


@record
class PngLayout:
    """Where the rows of a plain PNG lie, and how. `pieces`: offset and size of its image data."""

    width: int
    height: int
    channels: int
    depth: int
    pieces: tuple[tuple[int, int], ...]

    @property
    def pixel_bytes(self) -> int:
        return self.channels * self.depth // 8


def layout_of(header: PngHeader) -> PngLayout | None:
    """The layout of a plain PNG that can be read here; None for any other."""
    plain = header.depth in (8, 16) and header.color_type in _CHANNELS and not header.interlaced
    too_many = len(header.image_data) > MOST_PIECES
    if not UNPACKS or not plain or too_many or b"tRNS" in header.chunks:
        return None
    return PngLayout(
        header.width,
        header.height,
        _CHANNELS[header.color_type],
        header.depth,
        header.image_data,
    )


class PngScanlines:
    """A plain PNG, read by rows from top to bottom; going back begins anew. See `source.Source`."""

    by_openimageio = False

    def __init__(self, file: RawFile, layout: PngLayout, label: str) -> None:
        self._file, self._layout, self._label = file, layout, label
        self.bytes_per_row = layout.width * layout.pixel_bytes * (1 if layout.depth == 8 else 2)
        self.bytes_to_decode = 3 * max(_FILTERED_BYTES, self.bytes_per_row) + 2 * _PIECE_BYTES
        self.bytes_held = _INFLATE_BYTES + self.bytes_per_row + 128 * len(layout.pieces)
        self._is_open = False

    def close(self) -> None:
        self._file.close()
        if self._is_open:
            del self._stream, self._pieces, self._above
            self._is_open = False

    def _begin(self) -> None:
        self._is_open = True
        self._row = 0
        self._stream = InflateStream()
        self._pieces = self._deflated_pieces()
        self._above = np.zeros(self._layout.width * self._layout.pixel_bytes, np.uint8)

    def read(self, begin: int, end: int) -> Samples:
        """Rows `begin` to `end`, uint8 or uint16. Errors: `InputError`."""
        layout = self._layout
        if not self._is_open or begin < self._row:
            self._begin()
        try:
            at_once = self._rows_at_once()
            for row in range(self._row, begin, at_once):
                self._next_rows(min(at_once, begin - row))
            rows = self._next_rows(end - begin)
            if end == layout.height:
                self._check_end()
        except InputError:
            self._begin()  # the stream may stand inside a row
            raise
        if layout.depth == 16:
            rows = rows.view(">u2").astype(np.uint16)
        return rows.reshape(end - begin, layout.width, layout.channels)

    def _rows_at_once(self) -> int:
        return max(1, _FILTERED_BYTES // (len(self._above) + 1))

    def _next_rows(self, count: int) -> Samples:
        """The bytes of the next rows (count, bytes of a row)."""
        rows = np.empty((count, len(self._above)), np.uint8)
        at_once = self._rows_at_once()
        for begin in range(0, count, at_once):
            part = rows[begin : begin + at_once]
            filtered = np.empty((len(part), part.shape[1] + 1), np.uint8)
            self._inflate(filtered.data.cast("B"))
            try:
                png_unfiltered(filtered, self._layout.pixel_bytes, self._above, part)
            except ValueError as reason:
                raise self._damage(str(reason)) from None
            self._above = part[-1].copy()
            self._row += len(part)
        return rows

    def _inflate(self, out: memoryview) -> None:
        """Fills `out` with the next bytes of the filtered rows."""
        filled = 0
        while filled < len(out):
            content = self._content(len(out) - filled)
            if not content:
                raise self._damage("its image data end too early")
            out[filled : filled + len(content)] = content
            filled += len(content)

    def _check_end(self) -> None:
        """Reads on to the checksum behind the last row; rows that are too many are let be."""
        if not self._content(1) and not self._stream.ended:
            raise self._damage("its image data end too early")

    def _content(self, size: int) -> bytes:
        """Up to `size` bytes of the inflated data; none where the stream or the file ends."""
        try:
            while not (content := self._stream.take(size)) and not self._stream.ended:
                piece = next(self._pieces, b"")
                if not piece:
                    break
                self._stream.feed(piece)
        except InflateError:
            raise self._damage("its deflated data are damaged") from None
        return content

    def _deflated_pieces(self) -> Iterator[bytes]:
        for offset, size in self._layout.pieces:
            for begin in range(0, size, _PIECE_BYTES):
                yield self._file.bytes_at(offset + begin, min(_PIECE_BYTES, size - begin))

    def _damage(self, what: str) -> InputError:
        return InputError(f"{self._label}: cannot be read, rows from {self._row} on: {what}")
