"""How OpenImageIO opens files and says what went wrong."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import OpenImageIO as oiio

from .. import exrheader
from ..errors import InputError

# Errors that nobody fetched would otherwise be printed on stdout when the process ends.
oiio.attribute("oiio:print_uncaught_errors", 0)


@contextlib.contextmanager
def codec_threads(reading: int, writing: int) -> Iterator[None]:
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
