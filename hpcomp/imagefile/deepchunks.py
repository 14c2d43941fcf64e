"""Deep parts of an EXR, read without a library: scanlines or tiles, ZIPS, RLE or none. No colours.

A chunk is a tile, or a row: how many samples each pixel has, then row by row a plane of them for
each channel. OpenEXR: File Layout, Deep Data.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry import FARTHEST, Window
from ..records import record
from .deflate import InflateError, inflated
from .exrscanlines import headers_of, planes_of, window_of
from .rawfile import RawFile

Counts = NDArray[np.int64]
Bytes = NDArray[np.uint8]

#: Headers are longer where they hold many attributes; they are read in growing pieces.
_HEADER_BYTES, _MOST_HEADER_BYTES = 1 << 16, 1 << 26
#: How deep data may be packed, by number: OpenEXR allows no other, but for zstd.
COMPRESSIONS = {0: "none", 1: "rle", 2: "zips"}
_OTHER_COMPRESSIONS = {3: "zip", 4: "piz", 13: "zstd"}
#: Stored types of samples.
_DTYPES = {"uint": "<u4", "half": "<f2", "float": "<f4"}
#: Packed counts, packed samples, samples: their bytes, behind where the chunk lies.
_SIZES = struct.Struct("<3Q")
#: What a packed byte can become at most: of deflate's shortest code, and of a run of RLE.
_MOST_UNPACKED = {"none": 1, "rle": 64, "zips": 1032}


@record
class DeepLayout:
    """Where the samples of a deep part lie.

    `channels`: of each by name its type, and where its bytes begin in those of one sample.
    `sample_bytes`: of all channels. `tile`: size, or None for rows. `offsets`: of each chunk, row
    by row of chunks. `part`: its number where the file has several, else None.
    """

    channels: dict[str, tuple[str, int]]
    sample_bytes: int
    compression: str
    window: Window
    tile: tuple[int, int] | None
    offsets: NDArray[np.uint64]
    part: int | None

    @property
    def chunk_rows(self) -> int:
        return 1 if self.tile is None else self.tile[1]

    @property
    def chunks_across(self) -> int:
        return 1 if self.tile is None else -(-self.window.width // self.tile[0])

    def chunk(self, number: int) -> Window:
        """The pixels of a chunk, in the file's coordinates."""
        window, down, across = self.window, *divmod(number, self.chunks_across)
        width = window.width if self.tile is None else self.tile[0]
        x, y = window.x + across * width, window.y + down * self.chunk_rows
        return Window(x, y, min(width, window.right - x), min(self.chunk_rows, window.bottom - y))


@record
class DeepChunk:
    """One chunk as it is stored: how many samples each of its pixels has, and where the rest is.

    `counts`: (rows, columns). `packed_at`, `packed_bytes`: of the samples in the file.
    """

    window: Window
    counts: Counts
    packed_at: int
    packed_bytes: int


@record
class DeepCounts:
    """How many samples an image has: each row (height), and the pixel with most of them.

    `largest_chunk`: the bytes of the largest chunk, unpacked.
    """

    rows: Counts
    deepest: int
    largest_chunk: int


def layout_of(file: RawFile, part: int, label: str) -> DeepLayout:
    """The layout of the deep part of that number. Errors: `InputError`."""
    size = _HEADER_BYTES
    while True:
        head = file.bytes_at(0, min(size, file.size))
        try:
            return _parsed(file, head, part, label)
        except (ValueError, KeyError, IndexError, struct.error):
            if size >= min(file.size, _MOST_HEADER_BYTES):
                raise InputError(
                    f"{label}: cannot be read: the header of its deep part is damaged"
                ) from None
        size *= 8


def _parsed(file: RawFile, head: bytes, part: int, label: str) -> DeepLayout:
    headers, at, several = headers_of(head)
    values = headers[part]
    for before in headers[:part]:
        at += 8 * struct.unpack("<i", before[b"chunkCount"])[0]
    window = window_of(values[b"dataWindow"])
    if not (0 < window.width <= FARTHEST and 0 < window.height <= FARTHEST):
        raise ValueError("no pixels")
    number = values[b"compression"][0]
    if number not in COMPRESSIONS:
        name = _OTHER_COMPRESSIONS.get(number, f"number {number}")
        raise InputError(
            f"{label}: deep data in the compression {name} cannot be read: store them as zips first"
        )
    tile = None
    if values[b"type"] == b"deeptile":
        width, height = struct.unpack_from("<2I", values[b"tiles"])
        if not (0 < width <= FARTHEST and 0 < height <= FARTHEST):
            raise ValueError("tiles of no size")
        # A tile may be larger than the picture, which gains nothing.
        tile = min(width, window.width), min(height, window.height)
    elif values[b"type"] != b"deepscanline":
        raise ValueError("not deep")
    channels, sample_bytes = planes_of(values[b"channels"], 1)
    width, height = (window.width, 1) if tile is None else tile
    chunks = -(-window.width // width) * -(-window.height // height)
    offsets = np.frombuffer(file.bytes_at(at, 8 * chunks), "<u8")
    if offsets.min() < at + 8 * chunks or offsets.max() >= file.size:
        raise InputError(
            f"{label}: cannot be read: it is not whole, parts of its table of rows are missing"
        )
    return DeepLayout(
        channels,
        sample_bytes,
        COMPRESSIONS[number],
        window,
        tile,
        offsets,
        part if several else None,
    )


class DeepChunks:
    """Channels of a deep part, read by rows in any order, by any number of threads at a time.

    `names`: the channels that are wanted. `label` names the file in errors.
    """

    def __init__(self, file: RawFile, layout: DeepLayout, names: Sequence[str], label: str) -> None:
        self._file, self.layout, self._names, self._label = file, layout, tuple(names), label

    def close(self) -> None:
        self._file.close()

    def count(self) -> DeepCounts:
        """How many samples there are, from the tables of counts alone.

        So damage in these is found before all else. Errors: `InputError`.
        """
        window = self.layout.window
        rows = np.zeros(window.height, np.int64)
        deepest = largest = 0
        for number in range(len(self.layout.offsets)):
            chunk = self._chunk(number)
            top = chunk.window.y - window.y
            rows[top : top + chunk.window.height] += chunk.counts.sum(axis=1)
            deepest = max(deepest, int(chunk.counts.max()))
            largest = max(largest, int(chunk.counts.sum()) * self.layout.sample_bytes)
        return DeepCounts(rows, deepest, largest)

    def read(self, begin: int, end: int) -> tuple[Counts, dict[str, NDArray[np.float32]]]:
        """Rows `begin` to `end` in the file's coordinates.

        Returns how many samples each pixel has, (rows, width), and by channel the samples of all
        pixels one after the other, float32. Errors: `InputError`.
        """
        layout = self.layout
        counts = np.zeros((end - begin, layout.window.width), np.int64)
        planes: list[list[list[Any]]] = [[[] for _ in self._names] for _ in range(end - begin)]
        first, last = ((y - layout.window.y) // layout.chunk_rows for y in (begin, end - 1))
        across = layout.chunks_across
        for number in range(first * across, (last + 1) * across):
            chunk = self._chunk(number)
            left = chunk.window.x - layout.window.x
            for row, pieces in self._rows(chunk, begin, end):
                counts[row - begin, left : left + chunk.window.width] = chunk.counts[
                    row - chunk.window.y
                ]
                for plane, piece in zip(planes[row - begin], pieces, strict=True):
                    plane.append(piece)
        return counts, {
            name: _joined([piece for row in planes for piece in row[number]])
            for number, name in enumerate(self._names)
        }

    def _rows(self, chunk: DeepChunk, begin: int, end: int) -> Iterator[tuple[int, list[Any]]]:
        """Of each row of the chunk from `begin` to `end` the wanted planes, as stored."""
        layout = self.layout
        totals = chunk.counts.sum(axis=1)
        size = int(totals.sum()) * layout.sample_bytes
        data = self._unpacked(chunk.packed_at, chunk.packed_bytes, size, chunk.window)
        ends = np.cumsum(totals)
        whole = begin <= chunk.window.y and chunk.window.bottom <= end
        for number, (total, stop) in enumerate(zip(totals.tolist(), ends.tolist(), strict=True)):
            row = chunk.window.y + number
            if not begin <= row < end:
                continue
            at = (stop - total) * layout.sample_bytes
            pieces = []
            for name in self._names:
                kind, offset = layout.channels[name]
                piece = np.frombuffer(data, _DTYPES[kind], total, at + total * offset)
                # A piece keeps its whole chunk in memory, of which it may be a small part.
                pieces.append(piece if whole else piece.copy())
            yield row, pieces

    def _chunk(self, number: int) -> DeepChunk:
        layout, at = self.layout, int(self.layout.offsets[number])
        window = layout.chunk(number)
        where = [window.y]
        if layout.tile is not None:
            down, across = divmod(number, layout.chunks_across)
            where = [across, down, 0, 0]
        if layout.part is not None:
            where.insert(0, layout.part)
        size = 4 * len(where)
        head = self._file.bytes_at(at, size + _SIZES.size)
        packed_counts, packed, unpacked = _SIZES.unpack_from(head, size)
        if struct.unpack_from(f"<{len(where)}i", head) != tuple(where):
            raise self._damage(window, "they are not where they should be")
        at += len(head)
        if max(packed_counts, packed) > self._file.size:
            raise self._damage(window, "they end behind the file")
        table = 4 * window.width * window.height
        counts = self._counts(at, packed_counts, table, window)
        if unpacked != int(counts.sum()) * layout.sample_bytes:
            raise self._damage(window, "their samples are not as many as counted")
        if unpacked > packed * _MOST_UNPACKED[layout.compression]:
            raise self._damage(window, "they hold fewer samples than counted")
        return DeepChunk(window, counts, at + packed_counts, packed)

    def _counts(self, at: int, packed: int, size: int, window: Window) -> Counts:
        if size > packed * _MOST_UNPACKED[self.layout.compression]:
            raise self._damage(window, "their table of counts is too short")
        if self.layout.compression == "none":
            packed = min(packed, size)  # OpenEXR fills those of cut tiles up to a whole tile's
        table = self._unpacked(at, packed, size, window)
        # Counted up along each row.
        sums = np.frombuffer(table, "<i4").reshape(window.height, window.width).astype(np.int64)
        counts = np.diff(sums, axis=1, prepend=0)
        if counts.min() < 0:
            raise self._damage(window, "their table of counts is damaged")
        return counts

    def _unpacked(self, at: int, packed: int, size: int, window: Window) -> bytes | Bytes:
        """`size` bytes from `packed` ones in the file, which are plain where they are as many."""
        if size == 0:
            return b""
        data = self._file.bytes_at(at, packed)
        if packed == size:
            return data
        compression = self.layout.compression
        try:
            if compression == "zips":
                return _unpredicted(np.frombuffer(inflated(data, size), np.uint8))
            if compression == "rle":
                return _unpredicted(_run_lengths_undone(np.frombuffer(data, np.uint8), size))
        except (InflateError, ValueError):
            raise self._damage(window, "their packed data are damaged") from None
        raise self._damage(window, "they are not as long as they say")

    def _damage(self, window: Window, what: str) -> InputError:
        rows = f"row {window.y}"
        if window.height > 1:
            rows = f"rows {window.y} to {window.bottom - 1}"
        return InputError(f"{self._label}: cannot be read, deep data of {rows}: {what}")


def _joined(pieces: Sequence[Any]) -> NDArray[np.float32]:
    if not pieces:
        return np.empty(0, np.float32)
    return np.concatenate(pieces, dtype=np.float32, casting="unsafe")


#: EXR's differences of bytes are stored with this added.
_BIAS = 128


def _unpredicted(packed: Bytes) -> Bytes:
    """What ZIPS and RLE pack: differences of bytes, the even ones before the odd ones, undone."""
    differences = packed - np.uint8(_BIAS)
    differences[:1] = packed[:1]
    split = np.cumsum(differences, dtype=np.uint8)
    plain = np.empty_like(split)
    half = (len(split) + 1) // 2
    plain[0::2], plain[1::2] = split[:half], split[half:]
    return plain


def _run_lengths_undone(packed: Bytes, size: int) -> Bytes:
    """`size` bytes from runs: n and a byte to repeat n + 1 times, or -n and n bytes as they are.

    `ValueError` where they make another size.
    """
    steps = np.where(packed < 128, 2, 257 - packed.astype(np.int64)).tolist()
    starts, at, end = [], 0, len(packed)
    while at < end:
        starts.append(at)
        at += steps[at]
    begin = np.array(starts, np.int64)
    head = packed[begin].astype(np.int64)
    repeated = head < 128
    lengths = np.where(repeated, head + 1, 256 - head)
    if at != end or lengths.sum() != size:
        raise ValueError("another size")
    source = np.repeat(begin + 1, lengths)
    within = np.arange(size) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    source += np.where(np.repeat(repeated, lengths), 0, within)
    return packed[source]
