"""How OpenImageIO opens files and says what went wrong."""

from __future__ import annotations

from typing import Any

import OpenImageIO as oiio

from .. import exrheader
from ..errors import InputError

# Errors that nobody fetched would otherwise be printed on stdout when the process ends.
oiio.attribute("oiio:print_uncaught_errors", 0)


def error_text(source: Any) -> str:
    """The first line of OpenImageIO's error, which may quote bytes of a damaged file."""
    try:
        lines = source.geterror().strip().splitlines()
    except UnicodeDecodeError:
        lines = []
    return str(lines[0]) if lines else "the file is damaged"


def open_input(path: str, label: str) -> Any:
    config = oiio.ImageSpec()
    # Without this OpenImageIO premultiplies PNG in encoded 8-bit values.
    config.attribute("oiio:UnassociatedAlpha", 1)
    reader = oiio.ImageInput.open(path, config)
    if reader is None:
        reason = error_text(oiio)
        raise InputError(f"{label}: cannot be read: {exrheader.explain(path) or reason}")
    # Headers with an attribute that cannot be parsed open all the same, and leave an error behind.
    error_text(reader)
    return reader
