"""Layers and the options of a stack, for every command that takes one.

Beside `options`, which all commands import: here are tables of the mathematics.
"""

from __future__ import annotations

from collections.abc import Callable

import click

from ..blending.addition import BLENDINGS, DEFAULT_HUE_TOLERANCE
from ..blending.orders import ORDERS
from ..blending.porter_duff import OPERATOR_NAMES
from ..color.encoding import BOTTOM, WORKING_PRIMARIES
from ..color.spaces import SPACES
from .options import F

#: What decides how layers become pixels: each option by the name of its parameter.
STACK_OPTIONS: dict[str, Callable[[F], F]] = {
    "op": click.option(
        "--op",
        type=click.Choice(OPERATOR_NAMES),
        default="over",
        show_default=True,
        metavar="OPERATOR",
        help="Operator of the layers that name none.",
    ),
    "blending": click.option(
        "--blending",
        type=click.Choice(list(BLENDINGS)),
        default="hue-preserving",
        show_default=True,
        help="How colours are added: the stronger one keeps its hue, hues mix as usual, or the one "
        "in front keeps its hue.",
    ),
    "order": click.option(
        "--order",
        default="bottom-up",
        show_default=True,
        metavar="ORDER",
        help=f"In which order the layers' colours are added: {', '.join(ORDERS)}, "
        "or a permutation such as 2,0,1.",
    ),
    "space": click.option(
        "--space",
        type=click.Choice(list(SPACES)),
        default="linear-rgb",
        show_default=True,
        help="Blending space.",
    ),
    "primaries": click.option(
        "--primaries",
        type=click.Choice([*WORKING_PRIMARIES, BOTTOM]),
        default="rec709",
        show_default=True,
        help="Blend in these primaries, to which files in others are converted; bottom: in those "
        "of the bottom layer. They decide luminance and hue, and an EXR is written in them.",
    ),
    "hue_tolerance": click.option(
        "--hue-tolerance",
        type=float,
        default=DEFAULT_HUE_TOLERANCE,
        show_default=True,
        metavar="DEGREES",
        help="Hues closer than this, 0 to 90, are equal; 0 is the paper's operator.",
    ),
    "gray_bias": click.option(
        "--gray-bias",
        type=float,
        default=0.0,
        show_default=True,
        metavar="0…1",
        help="How much less different hues cancel each other to grey; 0 is the paper's operator.",
    ),
    "exposure": click.option(
        "--exposure",
        type=float,
        default=0.0,
        show_default=True,
        metavar="STOPS",
        help="Brighten or darken the result.",
    ),
    "canvas": click.option(
        "--canvas",
        default="bottom",
        show_default=True,
        metavar="CANVAS",
        help="bottom (the bottom layer's display window), union, intersection, or WxH+X+Y.",
    ),
    "overscan": click.option(
        "--overscan", is_flag=True, help="EXR: keep pixels beyond the canvas."
    ),
    "background": click.option(
        "--background", metavar="COLOR", help="Put a CSS hex colour under the result."
    ),
    "nonfinite": click.option(
        "--nonfinite",
        type=click.Choice(["error", "zero", "keep"]),
        default="error",
        show_default=True,
        help="NaN and Inf in a layer: error (refuse it), zero (the pixel becomes transparent), "
        "keep.",
    ),
    "strict": click.option("--strict", is_flag=True, help="Treat warnings as errors."),
}


def stack_options(*names: str) -> Callable[[F], F]:
    """The options of those names, in that order in the help."""

    def decorate(function: F) -> F:
        for name in reversed(names):
            function = STACK_OPTIONS[name](function)
        return function

    return decorate
