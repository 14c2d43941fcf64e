"""Plain EXR files, read and written without a library: one part of scanlines, ZIP, ZIPS or none.

That is what most tools write, and where most of a stack's time goes. `layout_of` says which files
are of this kind; all others are OpenImageIO's. OpenEXR: Technical Introduction, File Layout.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from ..encoding import REC709
from ..errors import InputError
from ..geometry import Window
from ..samples import Samples
from .deflate import InflateError, deflated, inflated
from .packing import UNPACKS, exr_packed, exr_plain, exr_unpacked
from .rawfile import RawFile
from .segments import SegmentWriter

_MAGIC = b"v/1\x01"
_VERSION = 2
#: The only flag beside the version that a plain file may have: names of up to 255 characters.
_LONG_NAMES = 0x400
#: No header of a plain file is longer.
_HEADER_BYTES = 1 << 16

#: Of those compressions that are read here: their number in the header, and rows of a block.
COMPRESSIONS = {"none": (0, 1), "zips": (2, 1), "zip": (3, 16)}
#: Numbers of the sample types, and their bytes.
_TYPES = {"uint": (0, 4), "half": (1, 2), "float": (2, 4)}
#: Those that can be read here.
_DTYPES: dict[str, type[np.floating[Any]]] = {"half": np.float16, "float": np.float32}


@dataclass(frozen=True)
class ExrLayout:
    """Where the samples of a plain EXR lie.

    `channels`: of each by name its type, and where its plane begins in a row, in bytes.
    `table_at`: where the offsets of the blocks stand.
    """

    channels: dict[str, tuple[str, int]]
    row_bytes: int
    block_rows: int
    deflated: bool
    window: Window
    table_at: int

    @property
    def blocks(self) -> int:
        return -(-self.window.height // self.block_rows)

    def has(self, types: Mapping[str, str]) -> bool:
        """Whether these channels are there with these types: one type that can be read here."""
        there = {name: kind for name, (kind, _) in self.channels.items()}
        wanted = set(types.values())
        return len(wanted) == 1 and wanted <= _DTYPES.keys() and types.items() <= there.items()


def layout_of(path: str) -> ExrLayout | None:
    """The layout of a plain EXR that can be read here; None for any other file."""
    if not UNPACKS:
        return None
    try:
        with open(path, "rb") as file:
            return _parsed(file)
    except (OSError, ValueError, KeyError, IndexError, struct.error):
        return None  # whatever is wrong, OpenImageIO says it


def _parsed(file: BinaryIO) -> ExrLayout | None:
    head = file.read(_HEADER_BYTES)
    magic, version = struct.unpack_from("<4sI", head)
    if magic != _MAGIC or version & ~_LONG_NAMES != _VERSION:
        return None
    attributes: dict[bytes, bytes] = {}
    at = 8
    while head[at]:
        name_end = head.index(0, at)
        type_end = head.index(0, name_end + 1)
        (size,) = struct.unpack_from("<I", head, type_end + 1)
        begin = type_end + 5
        attributes[head[at:name_end]] = head[begin : begin + size]
        at = begin + size
    compression = attributes[b"compression"][0]
    found = [rows for number, rows in COMPRESSIONS.values() if number == compression]
    left, top, right, bottom = struct.unpack("<4i", attributes[b"dataWindow"])
    window = Window(left, top, right - left + 1, bottom - top + 1)
    planes = _planes(attributes[b"channels"], window.width)
    if not found or planes is None or window.width < 1 or window.height < 1:
        return None
    channels, row_bytes = planes
    return ExrLayout(
        channels,
        row_bytes,
        found[0],
        compression != COMPRESSIONS["none"][0],
        window,
        table_at=at + 1,
    )


def _planes(channels: bytes, width: int) -> tuple[dict[str, tuple[str, int]], int] | None:
    """The planes of a row by channel, and its bytes; None where channels are subsampled."""
    types = {number: (name, size) for name, (number, size) in _TYPES.items()}
    planes, row_bytes, at = {}, 0, 0
    while channels[at]:
        end = channels.index(0, at)
        number, _, x_sampling, y_sampling = struct.unpack_from("<iIii", channels, end + 1)
        if (x_sampling, y_sampling) != (1, 1):
            return None
        name, size = types[number]
        planes[channels[at:end].decode()] = name, row_bytes
        row_bytes += size * width
        at = end + 17
    return planes, row_bytes


class ExrScanlines:
    """Channels of one type of a plain EXR, read by rows in any order; see `source.Source`."""

    by_openimageio = False

    def __init__(self, file: RawFile, layout: ExrLayout, names: Sequence[str], label: str) -> None:
        self._file, self._layout, self._label = file, layout, label
        self._planes = [layout.channels[name][1] for name in names]
        self._dtype = _DTYPES[layout.channels[names[0]][0]]
        self._offsets: Sequence[int] = ()
        block = layout.block_rows * layout.row_bytes
        # Deflated, inflated, and what the kernel needs to undo the packing.
        self.bytes_to_decode = 4 * block if layout.deflated else block
        self.bytes_held = 16 * layout.blocks + 1024
        self.bytes_per_row = layout.window.width * len(names) * np.dtype(self._dtype).itemsize

    def close(self) -> None:
        self._file.close()

    def read(self, begin: int, end: int) -> Samples:
        """Rows `begin` to `end` in the file's coordinates. Errors: `InputError`."""
        layout = self._layout
        if not self._offsets:
            table = self._file.bytes_at(layout.table_at, 8 * layout.blocks)
            self._offsets = array("Q", table)
        out = np.empty((end - begin, layout.window.width, len(self._planes)), self._dtype)
        first, last = begin - layout.window.y, end - layout.window.y - 1
        for number in range(first // layout.block_rows, last // layout.block_rows + 1):
            top = number * layout.block_rows
            rows = min(layout.block_rows, layout.window.height - top)
            data, packed = self._block(number, layout.window.y + top, rows * layout.row_bytes)
            cut = max(first, top), min(last + 1, top + rows)
            exr_unpacked(
                data,
                packed,
                layout.row_bytes,
                self._planes,
                cut[0] - top,
                out[cut[0] - first : cut[1] - first],
            )
        return out

    def _block(self, number: int, row: int, size: int) -> tuple[bytes, bool]:
        """A block of `size` bytes that begins with `row`, and whether it is packed as for ZIP."""
        offset = self._offsets[number]
        found_row, stored = struct.unpack("<iI", self._file.bytes_at(offset, 8))
        if found_row != row or stored > size:
            raise self._damage(row, "their block is not where it should be")
        data = self._file.bytes_at(offset + 8, stored)
        if stored == size:
            return data, False  # stored as it is, where deflating gains nothing
        if not self._layout.deflated:
            raise self._damage(row, "their block is too short")
        try:
            return inflated(data, size), True
        except InflateError as reason:
            raise self._damage(row, str(reason)) from None

    def _damage(self, row: int, what: str) -> InputError:
        last = min(row + self._layout.block_rows, self._layout.window.bottom) - 1
        return InputError(f"{self._label}: cannot be read, rows {row} to {last}: {what}")


@dataclass(frozen=True)
class ExrForm:
    """What a header says beside the channels: half or float RGBA, Rec. 709."""

    depth: str
    compression: str
    data_window: Window
    display_window: Window
    pixel_aspect: float
    pixels_per_inch: float | None


class ExrScanlineWriter(SegmentWriter[bytes]):
    """Writes one plain EXR; see `writing.ImageWriter`."""

    def __init__(self, path: str, form: ExrForm, label: str) -> None:
        number, block_rows = COMPRESSIONS[form.compression]
        window = form.data_window
        super().__init__(path, label, window.height, block_rows)
        self._deflates = form.compression != "none"
        self._next_row = window.y
        header = _MAGIC + struct.pack("<I", _VERSION) + _header(form, number)
        self._table_at = len(header)
        self._offsets: list[int] = []
        blocks = -(-window.height // block_rows)
        self._put_bytes(header + bytes(8 * blocks))
        self._position = len(header) + 8 * blocks

    def _segment(self, rows: Samples) -> bytes:
        if self._deflates:
            data = deflated(exr_packed(rows))
            if len(data) < rows.nbytes:
                return data
        return exr_plain(rows)

    def _append(self, segment: bytes) -> None:
        self._offsets.append(self._position)
        self._put_bytes(struct.pack("<iI", self._next_row, len(segment)) + segment)
        self._next_row += self._segment_rows
        self._position += 8 + len(segment)

    def _complete(self) -> None:
        try:
            self._file.seek(self._table_at)
        except OSError as reason:
            raise self._error(reason) from None
        self._put_bytes(struct.pack(f"<{len(self._offsets)}Q", *self._offsets))


def _header(form: ExrForm, compression: int) -> bytes:
    """The attributes that the format asks for, and those that say what the colours mean."""
    kind = _TYPES[form.depth][0]
    channels = b"".join(
        name + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) for name in (b"A", b"B", b"G", b"R")
    )
    attributes = [
        (b"channels", b"chlist", channels + b"\0"),
        (b"chromaticities", b"chromaticities", struct.pack("<8f", *REC709.xy.ravel())),
        (b"colorInteropID", b"string", b"lin_rec709_scene"),
        (b"compression", b"compression", bytes([compression])),
        (b"dataWindow", b"box2i", _box(form.data_window)),
        (b"displayWindow", b"box2i", _box(form.display_window)),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", form.pixel_aspect)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]
    if form.pixels_per_inch is not None:
        attributes.append((b"xDensity", b"float", struct.pack("<f", form.pixels_per_inch)))
    return (
        b"".join(
            name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value
            for name, kind, value in attributes
        )
        + b"\0"
    )


def _box(window: Window) -> bytes:
    return struct.pack("<4i", window.x, window.y, window.right - 1, window.bottom - 1)
