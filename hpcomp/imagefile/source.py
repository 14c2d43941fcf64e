"""Where a layer's samples come from: a file read here, or OpenImageIO. Does not decode colours."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

from ..color.samples import Samples
from .exrscanlines import ExrLayout, ExrScanlines
from .parts import Channel, ImageFile, Part
from .pngscanlines import PngLayout, PngScanlines
from .rawfile import RawFile


class ByLibrary(Protocol):
    """What can say whether OpenImageIO reads or writes it."""

    @property
    def by_openimageio(self) -> bool: ...


@contextlib.contextmanager
def codec_threads(files: Iterable[ByLibrary], reading: int, writing: int) -> Iterator[None]:
    """Bounds the threads of the libraries that these files need; without any, does nothing."""
    if not any(file.by_openimageio for file in files):
        yield
        return
    from .openimageio import library_threads

    with library_threads(reading, writing):
        yield


class Source(Protocol):
    """Some channels of one picture, read by rows; opened when it is first read.

    Memory in bytes: of a row as it is read, of the codec while it decodes, and while it is open.
    """

    by_openimageio: bool
    bytes_per_row: int
    bytes_to_decode: int
    bytes_held: int

    def read(self, begin: int, end: int) -> Samples:
        """Rows `begin` to `end` in the file's coordinates: (rows, width, channels), as stored.

        uint8 and uint16 of PNG, float16 and float32 of EXR, its uint channels as floats of the same
        value. Errors: `InputError`.
        """

    def close(self) -> None:
        """Gives back what is open; it is opened again where it is read again."""


def source_of(file: ImageFile, part: Part, channels: Sequence[Channel], label: str) -> Source:
    """The source of those channels; `label` names it in errors."""
    raw = RawFile(file.path, file.identity, label)
    kinds = {channel.name: channel.type for channel in channels}
    if isinstance(part.layout, ExrLayout) and part.layout.has(kinds):
        return ExrScanlines(raw, part.layout, list(kinds), label)
    if isinstance(part.layout, PngLayout) and part.layout.channels == len(channels):
        return PngScanlines(raw, part.layout, label)
    from .openimageio import OpenImageIOSource

    return OpenImageIOSource(file.path, part, channels, label)
