"""Pictures for a page: PNG files written into the page itself. Makes no picture."""

from __future__ import annotations

import os
import tempfile
from base64 import b64encode

import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError, why
from ..geometry import Window
from ..imagefile.header import PictureHeader
from ..imagefile.writing import OutputForm, open_writer

#: Pixels of a screen that a picture may fill. A small one grows up to them: by whole numbers where
#: that doubles it at least, its pixels then kept square.
_WIDEST, _HIGHEST = 1100, 720
_LARGEST_ZOOM = 16

Pixels = NDArray[np.uint8]


def data_uri(pixels: Pixels) -> str:
    """A picture (h, w, 4), straight sRGB with alpha, as the address of a PNG that it contains."""
    return "data:image/png;base64," + b64encode(png_bytes(pixels)).decode()


def png_bytes(pixels: Pixels) -> bytes:
    """A picture (h, w, 4) as a PNG file. Errors: `OutputError` where none can be written."""
    height, width = pixels.shape[:2]
    window = Window(0, 0, width, height)
    try:
        descriptor, path = tempfile.mkstemp(prefix="hpcomp.")
        os.close(descriptor)
    except OSError as reason:
        raise OutputError(f"pictures of the report cannot be written: {why(reason)}") from None
    try:
        form = OutputForm.checked("png", compression="fast")
        writer = open_writer(path, form, PictureHeader(window, window), "a picture of the report")
        try:
            writer.write(writer.prepare(0, pixels))
            writer.finish()
        except BaseException:
            writer.abandon()
            raise
        with open(path, "rb") as file:
            return file.read()
    finally:
        os.unlink(path)


def shown_size(width: int, height: int) -> tuple[int, int, bool]:
    """Width and height on a wide screen, and whether pixels are to stay square there."""
    zoom = min(_WIDEST / width, _HIGHEST / height, _LARGEST_ZOOM)
    square = zoom >= 2
    if square:
        zoom = int(zoom)
    return max(1, round(zoom * width)), max(1, round(zoom * height)), square


def mask(where: NDArray[np.bool_], color: str) -> Pixels:
    """(h, w, 4): the colour #rrggbb where it is true, else nothing."""
    pixels = np.zeros((*where.shape, 4), np.uint8)
    pixels[where] = (*bytes.fromhex(color[1:]), 255)
    return pixels
