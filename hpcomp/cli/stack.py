"""`hpcomp stack`: parses, calls `pipeline.stack`, prints nothing of its own."""

from __future__ import annotations

from typing import Any

import click

from ..addition import BLENDINGS, DEFAULT_HUE_TOLERANCE
from ..orders import ORDERS
from ..porter_duff import OPERATOR_NAMES, OPERATORS
from ..spaces import SPACES
from ..stackfile import LAYER_KEYS
from .options import LayerCommand, message_options
from .signals import load

LAYER_HELP = f"""Composite layers, bottom first, into one picture.

LAYER is PATH[::key=value[,key=value]...]; `-` reads stdin. The last `::` splits, unless the whole
argument is an existing file; a value holds no comma. Keys: {", ".join(LAYER_KEYS)}.

\b
  op=OPERATOR      {", ".join(OPERATORS)}
  opacity=0…1      scales the layer's colour and alpha
  at=PLACE         +X+Y, or a gravity: center, north-west, south+0-10 …
  alpha=MODE       straight, premultiplied, premultiplied-encoded, luminance
  colorspace=NAME  overrides what the file says: srgb, linear, acescg …
  part=NAME        a part of a multi-part EXR, by name or index
  layer=NAME       channels NAME.R, NAME.G, NAME.B, NAME.A of an EXR
  name=TEXT        what messages call the layer

\b
  hpcomp stack base.png 'roads.png::opacity=0.6' rivers.exr -o map.png
  hpcomp stack base.png 'mask.png::op=dst-in,alpha=luminance' -o cut.exr
  cat a.png | hpcomp stack b.exr - -o - --format png > c.png
"""


@click.command("stack", cls=LayerCommand, help=LAYER_HELP, short_help=LAYER_HELP.partition("\n")[0])
@click.argument(
    "layers", metavar="LAYER...", nargs=-1, required=True, type=click.Path(readable=False)
)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="PATH",
    type=click.Path(readable=False),
    help="Write here: a path ending in .png or .exr, or - for stdout with --format.",
)
@click.option(
    "--format",
    type=click.Choice(["png", "exr"]),
    help="Format of an output without an ending.",
)
@click.option(
    "--op",
    type=click.Choice(OPERATOR_NAMES),
    default="over",
    show_default=True,
    metavar="OPERATOR",
    help="Operator of the layers that name none.",
)
@click.option(
    "--blending",
    type=click.Choice(list(BLENDINGS)),
    default="hue-preserving",
    show_default=True,
    help="How colours are added.",
)
@click.option(
    "--order",
    default="bottom-up",
    show_default=True,
    metavar="ORDER",
    help=f"In which order the layers' colours are added: {', '.join(ORDERS)}, "
    "or a permutation such as 2,0,1.",
)
@click.option(
    "--space",
    type=click.Choice(list(SPACES)),
    default="linear-rgb",
    show_default=True,
    help="Blending space.",
)
@click.option(
    "--hue-tolerance",
    type=float,
    default=DEFAULT_HUE_TOLERANCE,
    show_default=True,
    metavar="DEGREES",
    help="Hues closer than this, 0 to 90, are equal; 0 is the paper's operator.",
)
@click.option(
    "--depth",
    type=click.Choice(["8", "16", "half", "float"]),
    help="PNG: 8 (default), 16. EXR: half (default), float.",
)
@click.option(
    "--compression",
    metavar="NAME",
    help="PNG: fast (default), small, 0…9. EXR: zip (default), none, rle, zips, piz, pxr24, b44, "
    "b44a, dwaa, dwab, htj2k256, htj2k32.",
)
@click.option(
    "--exposure",
    type=float,
    default=0.0,
    show_default=True,
    metavar="STOPS",
    help="Brighten or darken the result.",
)
@click.option("--region", metavar="WxH+X+Y", help="Make only this part of the canvas.")
@click.option(
    "--clobber/--no-clobber",
    default=True,
    show_default=True,
    help="Replace an existing output.",
)
@click.option(
    "--canvas",
    default="bottom",
    show_default=True,
    metavar="CANVAS",
    help="bottom (the bottom layer's display window), union, intersection, or WxH+X+Y.",
)
@click.option("--overscan", is_flag=True, help="EXR: keep pixels beyond the canvas.")
@click.option("--background", metavar="COLOR", help="Put a CSS hex colour under the result.")
@click.option(
    "--nonfinite",
    type=click.Choice(["error", "zero", "keep"]),
    default="error",
    show_default=True,
    help="NaN and Inf in a layer: error (refuse it), zero (the pixel becomes transparent), keep.",
)
@click.option("--strict", is_flag=True, help="Treat warnings as errors.")
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    help="Threads to use: all cores if not given.",
)
@click.option(
    "--max-memory",
    default="1G",
    show_default=True,
    metavar="SIZE",
    help="Memory for pixels and codecs, such as 512M.",
)
@message_options
def command(layers: tuple[str, ...], output: str, **options: Any) -> None:
    pipeline = load("hpcomp.pipeline")
    pipeline.stack(layers, output, **options)
