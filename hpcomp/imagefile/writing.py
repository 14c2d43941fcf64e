"""One picture written strip by strip, in the form that its format allows. Encodes no colours."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, Protocol

from ..color.primaries import OUT_PRIMARIES, PRIMARIES, REC709, Primaries
from ..color.samples import Samples
from ..errors import SettingError, unknown_name
from ..records import record
from ..system.streams import STDOUT
from . import exrscanlines, pngwriter
from .exrscanlines import ExrForm
from .forms import COMPRESSIONS, DEPTHS, EXR_COMPRESSIONS, FORMATS
from .header import PictureHeader

#: The state and buffers of a codec.
_CODEC_BYTES = 1 << 17
#: The tables of one of OpenEXR's compressors: of DWA, and of any other.
_COMPRESSOR_BYTES = {"dwaa": 13 << 20, "dwab": 13 << 20}
_OTHER_COMPRESSOR_BYTES = 1 << 20


def format_of_output(path: str, format: str | None = None) -> str:
    """`png` or `exr`, from the ending of the path or as named; `SettingError` otherwise."""
    if format is not None and format not in FORMATS:
        raise unknown_name("format", format, FORMATS)
    ending = os.path.splitext(path)[1].lower().removeprefix(".")
    if path != STDOUT and ending in FORMATS:
        if format not in (None, ending):
            raise SettingError(f"output {path} ends in .{ending} but the format is {format}")
        return ending
    if format is None:
        if path == STDOUT:
            raise SettingError("stdout does not say its format: give --format png or --format exr")
        raise SettingError(
            f"output {path} does not say its format: end it in .png or .exr, or give --format"
        )
    return format


@record
class OutputForm:
    """The form of an output file, checked: `format` and what that format allows.

    `gamut`: the primaries of a PNG; an EXR has those of its colours.
    """

    format: str
    depth: str
    compression: str
    gamut: Primaries = REC709

    @property
    def kind(self) -> str:
        """The type of its samples, one of `samples.OUTPUT_TYPES`."""
        return {"8": "uint8", "16": "uint16"}.get(self.depth, self.depth)

    @property
    def by_openimageio(self) -> bool:
        """Whether OpenImageIO writes it."""
        return self.format == "exr" and self.compression not in exrscanlines.COMPRESSIONS

    @property
    def _stored_bytes(self) -> int:
        """The samples of a pixel."""
        return 4 * {"8": 1, "16": 2, "half": 2, "float": 4}[self.depth]

    @property
    def bytes_per_pixel(self) -> int:
        """Memory of a pixel of a strip on its way to the file: its samples, filtered and packed."""
        if self.by_openimageio:
            return self._stored_bytes
        return self._stored_bytes * (3 if self.format == "png" else 2)

    def bytes_to_encode(self, width: int, threads: int) -> int:
        """Memory of the codec while it encodes rows of that width in so many threads."""
        if self.format == "png":
            # Segments gathered, filtered and deflated, one in each of two threads.
            return _CODEC_BYTES + 8 * pngwriter.segment_bytes(width * self._stored_bytes)
        rows = EXR_COMPRESSIONS[self.compression]
        block = rows * width * self._stored_bytes
        if self.by_openimageio:
            # OpenEXR keeps two line buffers a thread, each with a compressor of its own.
            tables = _COMPRESSOR_BYTES.get(self.compression, _OTHER_COMPRESSOR_BYTES)
            return _CODEC_BYTES + 2 * threads * (tables + 4 * block)
        return _CODEC_BYTES + 6 * block

    @staticmethod
    def checked(
        format: str,
        depth: str | int | None = None,
        compression: str | int | None = None,
        out_primaries: str | None = None,
    ) -> OutputForm:
        """With the format's own defaults; `SettingError` lists what the format allows."""
        depth = None if depth is None else str(depth)
        compression = None if compression is None else str(compression)
        for what, value, valid in (
            ("depth", depth, DEPTHS),
            ("compression", compression, COMPRESSIONS),
        ):
            if value is not None and value not in valid[format]:
                others = [other.upper() for other in FORMATS if value in valid[other]]
                raise unknown_name(
                    f"{format.upper()} {what}",
                    value,
                    valid[format],
                    otherwise="".join(f"; {value} is for {other}" for other in others),
                )
        if out_primaries is not None and out_primaries not in OUT_PRIMARIES:
            raise unknown_name("out primaries", out_primaries, OUT_PRIMARIES)
        if out_primaries is not None and format == "exr":
            raise SettingError(
                "an EXR is written in the primaries that colours are blended in: "
                "--out-primaries is for PNG, give --primaries instead"
            )
        return OutputForm(
            format,
            depth or DEPTHS[format][0],
            compression or COMPRESSIONS[format][0],
            PRIMARIES[out_primaries or REC709.name],
        )


class ImageWriter(Protocol):
    """Writes one picture in strips of rows; `finish` closes it, `abandon` after a failure."""

    def prepare(self, begin: int, samples: Samples) -> Any:
        """Does for rows from `begin` on, counted from 0, what any thread may do in any order."""

    def write(self, prepared: Any) -> None:
        """Writes what `prepare` gave, in the order of the rows. Errors: `OutputError`."""

    def finish(self) -> None:
        """Completes the file; `OutputError` where it cannot be."""

    def abandon(self) -> None:
        """Closes the file, whatever state it is in."""


def open_writer(path: str, form: OutputForm, header: PictureHeader, label: str) -> ImageWriter:
    """A writer of samples of `form.kind` (rows, width, 4) to `path`; `label` names it in errors.

    The primaries of the header are those of an EXR; a PNG has those of its form.
    """
    if form.format == "png":
        in_gamut = replace(header, primaries=form.gamut)
        return pngwriter.PngWriter(path, in_gamut, int(form.depth), form.compression, label)
    exr = ExrForm(form.depth, form.compression, header)
    if form.by_openimageio:
        from .openimageio import OpenImageIOExrWriter

        return OpenImageIOExrWriter(path, exr, label)
    return exrscanlines.ExrScanlineWriter(path, exr, label)
