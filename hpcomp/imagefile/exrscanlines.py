"""Plain EXR files, read and written without a library: one part of scanlines, ZIP, ZIPS or none.

That is what most tools write, and where most of a stack's time goes. `layout_of` says which files
are of this kind; all others are OpenImageIO's. OpenEXR: Technical Introduction, File Layout.
"""

from __future__ import annotations

import os
import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np

from ..color.encodings import interop_id
from ..color.primaries import Primaries
from ..color.samples import Samples
from ..errors import InputError
from ..geometry import Window
from ..records import record
from ..system.sourcedate import EXR_DATE, source_date
from .deflate import InflateError, deflated, inflated
from .header import PictureHeader
from .packing import UNPACKS, exr_packed, exr_plain, exr_unpacked
from .rawfile import RawFile
from .segments import SegmentWriter

MAGIC = b"v/1\x01"
VERSION = 2
#: Where the first header begins.
HEADER_AT = 8
#: The only flag beside the version that a plain file may have: names of up to 255 characters.
LONG_NAMES = 0x400
#: The flag of a file of several parts.
MULTIPART = 0x1000
#: No header of a plain file is longer.
_HEADER_BYTES = 1 << 16
#: The attributes that every header must have, and their types.
_ATTRIBUTES = {
    b"channels": b"chlist",
    b"compression": b"compression",
    b"dataWindow": b"box2i",
    b"displayWindow": b"box2i",
    b"lineOrder": b"lineOrder",
    b"pixelAspectRatio": b"float",
    b"screenWindowCenter": b"v2f",
    b"screenWindowWidth": b"float",
}
#: What stands before the data of a block: its first row, and their size.
_BLOCK_HEAD_BYTES = 8

#: Of those compressions that are read here: their number in the header, and rows of a block.
COMPRESSIONS = {"none": (0, 1), "zips": (2, 1), "zip": (3, 16)}
#: Numbers of the sample types, and their bytes.
TYPES = {"uint": (0, 4), "half": (1, 2), "float": (2, 4)}
#: Those that can be read here.
_DTYPES: dict[str, type[np.floating[Any]]] = {"half": np.float16, "float": np.float32}


@record
class ExrLayout:
    """Where the samples of a plain EXR lie.

    `channels`: of each by name its type, and where its plane begins in a row, in bytes.
    `offsets`: of each block, from the top, where it begins in the file.
    """

    channels: dict[str, tuple[str, int]]
    row_bytes: int
    block_rows: int
    deflated: bool
    window: Window
    offsets: Sequence[int]

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


def _parsed(file: BinaryIO) -> ExrLayout:
    """The layout; `ValueError`, or what a damaged header leads to, for any other file."""
    head = file.read(_HEADER_BYTES)
    magic, version = struct.unpack_from("<4sI", head)
    types, values, end = attributes(head, HEADER_AT)
    if (
        magic != MAGIC
        or version & ~LONG_NAMES != VERSION
        or not _ATTRIBUTES.items() <= types.items()
    ):
        raise ValueError("not one part of rows")
    window = window_of(values[b"dataWindow"])
    if window.width < 1 or window.height < 1:
        raise ValueError("no pixels")
    (compression,) = values[b"compression"]
    block_rows = dict(COMPRESSIONS.values())[compression]
    channels, row_bytes = planes_of(values[b"channels"], window.width)
    return ExrLayout(
        channels,
        row_bytes,
        block_rows,
        compression != COMPRESSIONS["none"][0],
        window,
        _offsets(file, end, -(-window.height // block_rows)),
    )


def attributes(head: bytes, at: int) -> tuple[dict[bytes, bytes], dict[bytes, bytes], int]:
    """The types and values of the attributes of a header at `at`, by name, and where it ends."""
    types: dict[bytes, bytes] = {}
    values: dict[bytes, bytes] = {}
    while head[at]:
        name_end = head.index(0, at)
        type_end = head.index(0, name_end + 1)
        (size,) = struct.unpack_from("<I", head, type_end + 1)
        name, begin = head[at:name_end], type_end + 5
        if name in types:
            raise ValueError("an attribute that is there twice")
        types[name], values[name] = head[name_end + 1 : type_end], head[begin : begin + size]
        at = begin + size
    return types, values, at + 1


def headers_of(head: bytes) -> tuple[list[dict[bytes, bytes]], int, bool]:
    """The attributes of every part of an EXR that begins like this, and where its tables begin.

    The last says whether it is a file of several parts, which may be one. Errors: `ValueError`, and
    what a damaged header leads to.
    """
    magic, version = struct.unpack_from("<4sI", head)
    if magic != MAGIC:
        raise ValueError("no EXR")
    several = bool(version & MULTIPART)
    headers: list[dict[bytes, bytes]] = []
    at = HEADER_AT
    while not headers or (several and head[at]):
        _, values, at = attributes(head, at)
        headers.append(values)
    return headers, at + several, several  # an empty header is behind the last of several


def window_of(box: bytes) -> Window:
    """A window from a box2i."""
    left, top, right, bottom = struct.unpack("<4i", box)
    return Window(left, top, right - left + 1, bottom - top + 1)


def channels_of(channels: bytes) -> Iterator[tuple[bytes, int, tuple[int, int]]]:
    """Name, number of the type, and sampling across and down, of the channels of a header."""
    at = 0
    while channels[at]:
        end = channels.index(0, at)
        number, _, x_sampling, y_sampling = struct.unpack_from("<iIii", channels, end + 1)
        yield channels[at:end], number, (x_sampling, y_sampling)
        at = end + 17


def _offsets(file: BinaryIO, at: int, blocks: int) -> Sequence[int]:
    """The table of so many blocks; `ValueError` where it cannot be right.

    That of an interrupted writer has zeros; OpenEXR finds the blocks all the same.
    """
    file_bytes, end = os.fstat(file.fileno()).st_size, at + 8 * blocks
    if end > file_bytes:
        raise ValueError("a file that is too short")
    file.seek(at)
    offsets = array("Q", file.read(8 * blocks))
    if min(offsets) < end or max(offsets) > file_bytes - _BLOCK_HEAD_BYTES:
        raise ValueError("blocks outside the file")
    return offsets


def planes_of(channels: bytes, width: int) -> tuple[dict[str, tuple[str, int]], int]:
    """The planes of a row by channel, and its bytes.

    `ValueError` where channels are subsampled, or not sorted: OpenEXR sorts them, and their planes.
    """
    types = {number: (name, size) for name, (number, size) in TYPES.items()}
    planes: dict[str, tuple[str, int]] = {}
    row_bytes, last = 0, b""
    for name, number, sampling in channels_of(channels):
        if sampling != (1, 1) or name <= last:
            raise ValueError("not planes of whole rows, sorted by name")
        kind, size = types[number]
        planes[name.decode()] = kind, row_bytes
        row_bytes += size * width
        last = name
    return planes, row_bytes


class ExrScanlines:
    """Channels of one type of a plain EXR, read by rows in any order; see `source.Source`."""

    by_openimageio = False

    def __init__(self, file: RawFile, layout: ExrLayout, names: Sequence[str], label: str) -> None:
        self._file, self._layout, self._label = file, layout, label
        self._planes = [layout.channels[name][1] for name in names]
        self._dtype = _DTYPES[layout.channels[names[0]][0]]
        block = layout.block_rows * layout.row_bytes
        # Deflated, inflated, and what the kernel needs to undo the packing.
        self.bytes_to_decode = 4 * block if layout.deflated else block
        self.bytes_held = 8 * len(layout.offsets) + 1024
        self.bytes_per_row = layout.window.width * len(names) * np.dtype(self._dtype).itemsize

    def close(self) -> None:
        self._file.close()

    def read(self, begin: int, end: int) -> Samples:
        """Rows `begin` to `end` in the file's coordinates. Errors: `InputError`."""
        layout = self._layout
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
        offset = self._layout.offsets[number]
        found_row, stored = struct.unpack("<iI", self._file.bytes_at(offset, _BLOCK_HEAD_BYTES))
        if found_row != row or stored > size:
            raise self._damage(row, "their block is not where it should be")
        data = self._file.bytes_at(offset + _BLOCK_HEAD_BYTES, stored)
        if stored == size:
            return data, False  # stored as it is, where deflating gains nothing
        if not self._layout.deflated:
            raise self._damage(row, "their block is too short")
        try:
            return inflated(data, size), True
        except InflateError:
            raise self._damage(row, "their deflated data are damaged") from None

    def _damage(self, row: int, what: str) -> InputError:
        last = min(row + self._layout.block_rows, self._layout.window.bottom) - 1
        return InputError(f"{self._label}: cannot be read, rows {row} to {last}: {what}")


@record
class ExrForm:
    """What an EXR holds, linear RGBA in one depth or data planes, how packed, and its header.

    `planes`: name and type of the channels that are no colour, sorted by name; all types of as many
    bytes as `depth`. Samples have them in the opposite order.
    """

    depth: str
    compression: str
    header: PictureHeader
    planes: tuple[tuple[str, str], ...] = ()


class ExrScanlineWriter(SegmentWriter[bytes]):
    """Writes one plain EXR; see `writing.ImageWriter`."""

    def __init__(self, path: str, form: ExrForm, label: str) -> None:
        number, block_rows = COMPRESSIONS[form.compression]
        window = form.header.data_window
        super().__init__(path, label, window.height, block_rows)
        self._deflates = form.compression != "none"
        self._next_row = window.y
        header = MAGIC + struct.pack("<I", VERSION) + _header(form, number)
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
        self._position += _BLOCK_HEAD_BYTES + len(segment)

    def _complete(self) -> None:
        try:
            self._file.seek(self._table_at)
        except OSError as reason:
            raise self._error(reason) from None
        self._put_bytes(struct.pack(f"<{len(self._offsets)}Q", *self._offsets))


def _color_attributes(primaries: Primaries) -> list[tuple[bytes, bytes, bytes]]:
    chromaticities = struct.pack("<8f", *primaries.xy.ravel())
    attributes = [(b"chromaticities", b"chromaticities", chromaticities)]
    name = interop_id(primaries)
    if name is not None:
        attributes.append((b"colorInteropID", b"string", name.encode()))
    return attributes


def _header(form: ExrForm, compression: int) -> bytes:
    """The attributes that the format asks for, and those that say what the colours mean."""
    picture = form.header
    channels = b"".join(
        name.encode() + b"\0" + struct.pack("<iIii", TYPES[kind][0], 0, 1, 1)
        for name, kind in form.planes or [(name, form.depth) for name in "ABGR"]
    )
    attributes = [
        (b"channels", b"chlist", channels + b"\0"),
        *([] if form.planes else _color_attributes(picture.primaries)),
        (b"compression", b"compression", bytes([compression])),
        (b"dataWindow", b"box2i", _box(picture.data_window)),
        (b"displayWindow", b"box2i", _box(picture.display_window)),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", picture.pixel_aspect)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]
    if picture.pixels_per_inch is not None:
        attributes.append((b"xDensity", b"float", struct.pack("<f", picture.pixels_per_inch)))
    date = source_date()
    if date is not None:
        attributes.append((b"capDate", b"string", date.strftime(EXR_DATE).encode()))
        attributes.append((b"utcOffset", b"float", struct.pack("<f", 0)))
    return (
        b"".join(
            name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value
            for name, kind, value in attributes
        )
        + b"\0"
    )


def _box(window: Window) -> bytes:
    return struct.pack("<4i", window.x, window.y, window.right - 1, window.bottom - 1)
