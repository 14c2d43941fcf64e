"""Files that are not read or written here, by OpenImageIO, of which this is the only importer.

Imported when a file asks for it, so that plain files do not wait for a large library.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..color.encodings import interop_id
from ..color.samples import Samples
from ..errors import InputError, OutputError
from ..system.signals import held
from ..system.sourcedate import EXR_DATE, source_date
from .exrscanlines import ExrForm
from .parts import Channel, Part

with held():
    import OpenImageIO as oiio

#: Of the sample types that files store.
_SAMPLE_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float": 4, "uint": 4}
#: Headers, offset tables and buffers of an open file.
_OPEN_FILE_BYTES = 1 << 17


# Errors that nobody fetched would otherwise be printed on stdout when the process ends.
oiio.attribute("oiio:print_uncaught_errors", 0)


@contextlib.contextmanager
def library_threads(reading: int, writing: int) -> Iterator[None]:
    """Bounds the threads that OpenImageIO and OpenEXR add to ours, and puts their settings back."""
    settings = {"threads": reading, "exr_threads": writing}
    before = {name: oiio.get_int_attribute(name) for name in settings}
    try:
        for name, value in settings.items():
            oiio.attribute(name, value)
        yield
    finally:
        for name, value in before.items():
            oiio.attribute(name, value)


def error_text(source: Any, otherwise: str = "the file is damaged") -> str:
    """The first line of OpenImageIO's error, which may quote a damaged file's bytes."""
    try:
        lines = source.geterror().strip().splitlines()
    except UnicodeDecodeError:
        lines = []
    return str(lines[0]) if lines else otherwise


def open_input(path: str, label: str) -> Any:
    """OpenImageIO's reader of the file; `InputError` where there is none."""
    config = oiio.ImageSpec()
    # Without this OpenImageIO premultiplies PNG in encoded 8-bit values.
    config.attribute("oiio:UnassociatedAlpha", 1)
    reader = oiio.ImageInput.open(path, config)
    if reader is None:
        raise InputError(f"{label}: cannot be read: {error_text(oiio)}")
    # Headers with an attribute that cannot be parsed open all the same, and leave an error behind.
    error_text(reader)
    return reader


class OpenImageIOSource:
    """Channels of any picture that OpenImageIO reads; see `source.Source`."""

    by_openimageio = True

    def __init__(self, path: str, part: Part, channels: Sequence[Channel], label: str) -> None:
        self._path, self._part, self._channels, self._label = path, part, channels, label
        # Colour and alpha that stand together in one type are read at once, halves as they are.
        types = {channel.type for channel in channels}
        first = channels[0].index
        self._together = (
            len(types) == 1
            and types != {"uint"}
            and [c.index for c in channels] == list(range(first, first + len(channels)))
        )
        self._reader: Any = None
        width, tiled = part.data_window.width, part.tile is not None
        sample = max(_SAMPLE_BYTES.get(kind, 4) for kind in types)
        copies = 1 if self._together and not tiled else 3
        self.bytes_per_row = width * len(channels) * sample * copies
        # One block of every channel, packed and unpacked; an interlaced PNG is held whole.
        block = (
            part.rows_per_block * width * sum(_SAMPLE_BYTES.get(c.type, 4) for c in part.channels)
        )
        self.bytes_to_decode = 0 if part.interlaced else (7 if tiled else 3) * block
        self.bytes_held = _OPEN_FILE_BYTES + block + block // 16

    def close(self) -> None:
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def read(self, begin: int, end: int) -> Samples:
        """See `source.Source`."""
        channels = self._channels
        if self._together:
            return self._read(channels[0], channels[-1].index + 1, begin, end)
        planes = [self._read(c, c.index + 1, begin, end) for c in channels]
        if len({plane.dtype for plane in planes}) > 1:
            planes = [plane.astype(np.float32) for plane in planes]
        return np.concatenate(planes, axis=2)

    def _read(self, first: Channel, stop: int, begin: int, end: int) -> Samples:
        if self._reader is None:
            self._reader = open_input(self._path, self._label)
        # A uint32 read as a float would be divided by the largest uint32.
        if self._part.tile is None:
            pixels = self._reader.read_scanlines(
                self._part.index, 0, begin, end, 0, first.index, stop, oiio.TypeDesc(first.type)
            )
        else:
            pixels = self._tile_rows(first.index, stop, begin, end, first.type)
        if pixels is None:
            raise _unreadable(self._label, begin, end, self._reader)
        pixels = pixels.reshape(end - begin, self._part.data_window.width, stop - first.index)
        return pixels.astype(np.float32) if first.type == "uint" else pixels

    def _tile_rows(self, first: int, stop: int, begin: int, end: int, wanted: str) -> Any:
        """Whole tiles around the rows, cut down to them; None where they do not decode."""
        assert self._part.tile is not None
        window, height = self._part.data_window, self._part.tile[1]
        top = window.y + (begin - window.y) // height * height
        bottom = min(window.bottom, window.y - (window.y - end) // height * height)
        tiles = self._reader.read_tiles(
            self._part.index, 0, window.x, window.right, top, bottom, 0, 1, first, stop,
            oiio.TypeDesc(wanted),
        )  # fmt: skip
        if tiles is None:
            return None
        tiles = tiles.reshape(bottom - top, window.width, stop - first)
        return np.ascontiguousarray(tiles[begin - top : end - top])


def repack_deep(path: str, part: Part, to: str, compression: str, label: str) -> None:
    """Writes the deep part, alone, into another EXR, a chunk at a time.

    Errors: `InputError`, also where there is no room for it.
    """
    source = open_input(path, label)
    with contextlib.closing(source):
        source.seek_subimage(part.index, 0)
        spec = oiio.ImageSpec(source.spec())
        spec.attribute("compression", compression)
        target = oiio.ImageOutput.create("openexr")
        assert target is not None  # the format is part of OpenImageIO itself
        window, done = part.data_window, target.open(to, spec)
        width, height = part.tile or (window.width, part.rows_per_block)
        for begin in range(window.y, window.bottom, height):
            end = min(begin + height, window.bottom)
            for left in range(window.x, window.right, width):
                where: tuple[int, ...] = begin, end, 0
                read: Any
                write: Any
                if part.tile is None:
                    read, write = source.read_native_deep_scanlines, target.write_deep_scanlines
                else:
                    where = left, min(left + width, window.right), begin, end, 0, 1
                    read, write = source.read_native_deep_tiles, target.write_deep_tiles
                samples = read(part.index, 0, *where, 0, spec.nchannels)
                if samples is None:
                    raise _unreadable(label, begin, end, source)
                done = done and write(*where, samples)
        if not (target.close() and done):
            raise InputError(
                f"{label}: cannot be unpacked into a temporary file, is the disk full? "
                + error_text(target, "it is incomplete").replace(to, "it")
            )


def _unreadable(label: str, begin: int, end: int, source: Any) -> InputError:
    rows = f"rows {begin} to {end - 1}" if end - begin > 1 else f"row {begin}"
    return InputError(f"{label}: cannot be read, {rows}: {error_text(source)}")


class OpenImageIOExrWriter:
    """Writes an EXR of any compression; see `writing.ImageWriter`."""

    def __init__(self, path: str, form: ExrForm, label: str) -> None:
        self._path, self._spec, self._label = path, _spec(form), label
        output = oiio.ImageOutput.create("openexr")
        assert output is not None  # the format is part of OpenImageIO itself
        self._output = output
        if not self._output.open(path, self._spec):
            raise self._error()

    def prepare(self, begin: int, samples: Samples) -> tuple[int, Samples]:
        return self._spec.y + begin, samples

    def write(self, prepared: tuple[int, Samples]) -> None:
        row, samples = prepared
        if not self._output.write_scanlines(row, row + len(samples), 0, samples):
            raise self._error()

    def finish(self) -> None:
        if not self._output.close() or not self._is_whole():
            raise self._error()

    def _is_whole(self) -> bool:
        """Whether the last rows are there: closing does not notice that a disk is full."""
        written = oiio.ImageInput.open(self._path)
        if written is None:
            return False
        last = self._spec.y + self._spec.height - 1
        return written.read_scanlines(0, 0, last, last + 1, 0, 0, 4, "half") is not None

    def abandon(self) -> None:
        with contextlib.suppress(Exception):
            self._output.close()

    def _error(self) -> OutputError:
        reason = error_text(self._output, "it is incomplete").replace(self._path, self._label)
        return OutputError(f"{self._label}: cannot be written, is the disk full? {reason}")


def _spec(form: ExrForm) -> oiio.ImageSpec:
    """What `exrscanlines` writes into a header, in OpenImageIO's words."""
    picture = form.header
    data, display = picture.data_window, picture.display_window
    spec = oiio.ImageSpec(data.width, data.height, 4, oiio.TypeDesc(form.depth))
    spec.x, spec.y = data.x, data.y
    spec.full_x, spec.full_y = display.x, display.y
    spec.full_width, spec.full_height = display.width, display.height
    spec.attribute("compression", form.compression)
    xy = picture.primaries.xy.ravel()
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), tuple(xy))
    name = interop_id(picture.primaries)
    if name is not None:
        spec.attribute("colorInteropID", name)
    spec.attribute("PixelAspectRatio", float(picture.pixel_aspect))
    if picture.pixels_per_inch is not None:
        spec.attribute("ResolutionUnit", "in")
        spec.attribute("XResolution", picture.pixels_per_inch)
        spec.attribute("YResolution", picture.pixels_per_inch * picture.pixel_aspect)
    date = source_date()
    # An empty date keeps the clock out of the file.
    spec.attribute("DateTime", "" if date is None else date.strftime(EXR_DATE))
    if date is not None:
        spec.attribute("utcOffset", 0.0)
    return spec
