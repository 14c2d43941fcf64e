"""The options of commands that write one picture: where, in which form, and with how much of what.

Beside `options`, which all commands import: here are tables of what is written.
"""

from __future__ import annotations

from collections.abc import Callable

import click

from ..color.encoding import OUT_PRIMARIES
from .options import F

#: Each option by the name of its parameter.
PICTURE_OPTIONS: dict[str, Callable[[F], F]] = {
    "output": click.option(
        "-o",
        "--output",
        required=True,
        metavar="PATH",
        type=click.Path(readable=False),
        help="Write here: a path ending in .png or .exr, or - for stdout with --format.",
    ),
    "format": click.option(
        "--format",
        type=click.Choice(["png", "exr"]),
        help="Format of an output without an ending.",
    ),
    "depth": click.option(
        "--depth",
        type=click.Choice(["8", "16", "half", "float"]),
        help="PNG: 8 (default), 16. EXR: half (default), float.",
    ),
    "compression": click.option(
        "--compression",
        metavar="NAME",
        help="PNG: fast (default), small, 0…9. EXR: zip (default), none, rle, zips, piz, pxr24, "
        "b44, b44a, dwaa, dwab, htj2k256, htj2k32.",
    ),
    "out_primaries": click.option(
        "--out-primaries",
        type=click.Choice(OUT_PRIMARIES),
        help="PNG: write it in these primaries instead of rec709, on the curve of sRGB. An EXR is "
        "written in those of --primaries.",
    ),
    "region": click.option(
        "--region", metavar="WxH+X+Y", help="Make only this part of the canvas."
    ),
    "clobber": click.option(
        "--clobber/--no-clobber",
        default=True,
        show_default=True,
        help="Replace an existing output.",
    ),
    "threads": click.option(
        "--threads",
        type=click.IntRange(min=1),
        metavar="N",
        help="Threads to use: all cores if not given.",
    ),
    "max_memory": click.option(
        "--max-memory",
        default="1G",
        show_default=True,
        metavar="SIZE",
        help="Memory for pixels and codecs, such as 512M.",
    ),
}


def picture_options(*names: str) -> Callable[[F], F]:
    """The options of those names, in that order in the help."""

    def decorate(function: F) -> F:
        for name in reversed(names):
            function = PICTURE_OPTIONS[name](function)
        return function

    return decorate
