"""One picture written strip by strip, in the form that its format allows."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from .. import pngheader
from ..encoding import REC709, Losses, to_half_range, to_straight_srgb
from ..errors import InputError, OutputError, SettingError, unknown_name
from ..geometry import Window
from .description import METRES_PER_INCH, STDIN
from .library import error_text
from .reading import Rgba

EXR_COMPRESSIONS = (
    "zip", "none", "rle", "zips", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab",
    "htj2k256", "htj2k32",
)  # fmt: skip
_ROWS_PER_BLOCK = {
    "zip": 16, "piz": 32, "pxr24": 16, "b44": 32, "b44a": 32, "dwaa": 32, "dwab": 256,
    "htj2k256": 256, "htj2k32": 32,
}  # fmt: skip
PNG_COMPRESSIONS = ("fast", "small", *"0123456789")
DEPTHS = {"png": ("8", "16"), "exr": ("half", "float")}
COMPRESSIONS = {"png": PNG_COMPRESSIONS, "exr": EXR_COMPRESSIONS}
FORMATS = tuple(DEPTHS)

#: The state and buffers of a codec.
_CODEC_BYTES = 1 << 17
_PNG_LEVELS = {"fast": 3, "small": 9}
_PNG_TYPES: dict[str, type[np.unsignedinteger[Any]]] = {"8": np.uint8, "16": np.uint16}


def format_of_output(path: str, format: str | None = None) -> str:
    """`png` or `exr`, from the ending of the path or as named; `SettingError` otherwise."""
    if format is not None and format not in FORMATS:
        raise unknown_name("format", format, FORMATS)
    ending = os.path.splitext(path)[1].lower().removeprefix(".")
    if path != STDIN and ending in FORMATS:
        if format not in (None, ending):
            raise SettingError(f"output {path} ends in .{ending} but the format is {format}")
        return ending
    if format is None:
        where = "stdout" if path == STDIN else f"output {path}"
        raise SettingError(
            f"{where} does not say its format: end it in .png or .exr, or give --format"
        )
    return format


@dataclass(frozen=True)
class OutputForm:
    """The form of an output file, checked: `format` and what that format allows."""

    format: str
    depth: str
    compression: str

    def bytes_to_encode(self, width: int) -> int:
        """Memory of the codec while it encodes rows of that width."""
        rows = _ROWS_PER_BLOCK.get(self.compression, 1)
        return _CODEC_BYTES + 6 * rows * width * 4 * (4 if self.depth == "float" else 2)

    @staticmethod
    def checked(
        format: str, depth: str | int | None = None, compression: str | int | None = None
    ) -> OutputForm:
        """With the format's own defaults; `SettingError` lists what the format allows."""
        depth = None if depth is None else str(depth)
        compression = None if compression is None else str(compression)
        for what, value, valid in (
            ("depth", depth, DEPTHS[format]),
            ("compression", compression, COMPRESSIONS[format]),
        ):
            if value is not None and value not in valid:
                raise unknown_name(f"{format.upper()} {what}", value, valid)
        return OutputForm(
            format, depth or DEPTHS[format][0], compression or COMPRESSIONS[format][0]
        )


class ImageWriter:
    """Writes one picture in strips of rows, top to bottom.

    `path` gets the file; `label` names it in errors. What the format cannot hold is counted in
    `losses`. Close it with `finish`, or `abandon` after a failure.
    """

    def __init__(
        self,
        path: str,
        form: OutputForm,
        data_window: Window,
        display_window: Window,
        *,
        pixel_aspect: float = 1.0,
        pixels_per_metre: tuple[float, float] | None = None,
        label: str | None = None,
    ) -> None:
        self.path, self.form, self.window, self.label = path, form, data_window, label or path
        self.losses = Losses()
        png = form.format == "png"
        kind = {"8": "uint8", "16": "uint16", "half": "half", "float": "float"}[form.depth]
        spec = oiio.ImageSpec(data_window.width, data_window.height, 4, oiio.TypeDesc(kind))
        if not png:
            spec.x, spec.y = data_window.x, data_window.y
            spec.full_x, spec.full_y = display_window.x, display_window.y
            spec.full_width, spec.full_height = display_window.width, display_window.height
        for name, value in self._attributes(png, pixel_aspect, pixels_per_metre).items():
            spec.attribute(name, *value) if isinstance(value, tuple) else spec.attribute(
                name, value
            )
        output = oiio.ImageOutput.create("png" if png else "openexr")
        assert output is not None  # both formats are part of OpenImageIO itself
        self._output = output
        if not self._output.open(path, spec):
            raise self._error()

    def _attributes(
        self, png: bool, pixel_aspect: float, density: tuple[float, float] | None
    ) -> dict[str, Any]:
        found: dict[str, Any] = {"PixelAspectRatio": float(pixel_aspect)}
        if density is not None:
            found["ResolutionUnit"] = "in"
            found["XResolution"] = density[0] * METRES_PER_INCH
            found["YResolution"] = density[1] * METRES_PER_INCH
        compression = self.form.compression
        if png:
            level = _PNG_LEVELS.get(compression)
            found["png:compressionLevel"] = int(compression) if level is None else level
            found["oiio:UnassociatedAlpha"] = 1
            found["oiio:ColorSpace"] = "sRGB"
        else:
            found["compression"] = compression
            found["chromaticities"] = (oiio.TypeDesc("float[8]"), tuple(REC709.xy.ravel()))
            found["colorInteropID"] = "lin_rec709_scene"
            # An empty date keeps the clock out of the file.
            found["DateTime"] = ""
        return found

    def write_rows(self, begin: int, rgba: Rgba) -> None:
        """Rows from `begin` on, in canvas coordinates: (rows, width, 4), linear, premultiplied."""
        pixels: NDArray[Any] = rgba
        if self.form.format == "png":
            pixels = to_straight_srgb(rgba, _PNG_TYPES[self.form.depth], self.losses)
            begin -= self.window.y
        elif self.form.depth == "half":
            pixels = to_half_range(rgba, self.losses)
        if not self._output.write_scanlines(begin, begin + len(rgba), 0, pixels):
            raise self._error()

    def finish(self) -> None:
        """Completes the file; `OutputError` where it cannot be."""
        if not self._output.close():
            raise self._error()
        if self.form.format == "png":
            # OpenImageIO's PNG writer does not notice a full disk.
            try:
                pngheader.read_header(self.path)
            except (InputError, OSError):
                raise self._error() from None

    def abandon(self) -> None:
        """Closes the file, whatever state it is in."""
        with contextlib.suppress(Exception):
            self._output.close()

    def _error(self) -> OutputError:
        reason = error_text(self._output, "it is incomplete").replace(self.path, self.label)
        return OutputError(f"{self.label}: cannot be written, is the disk full? {reason}")
