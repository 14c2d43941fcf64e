"""`hpcomp explain`: how one pixel of a stack comes about, as text or JSON."""

from __future__ import annotations

import json
from typing import Any

import click

from .options import LayerCommand, format_option, message_options
from .printing import print_data
from .signals import load
from .stackoptions import NEAR_A_LAYER, other_options, stack_options
from .words import Layer

#: The options of a stack that change what is said, and what that may take.
EXPLAINED = (
    *("op", "preset", "blending", "order", "space", "strength", "primaries"),
    *("hue_tolerance", "gray_bias", "weave", "weave_size"),
    *("foreign_tolerance", "achromatic", "exposure", "region", "canvas", "overscan", "background"),
    *("nonfinite", "strict", "threads", "max_memory", "max_pixels"),
)
HELP = {
    **NEAR_A_LAYER,
    "region": "The part of the canvas that is made: the pixel lies in it.",
}

SHORT_HELP = "Say step by step how one pixel of a stack comes about."


@click.command("explain", cls=LayerCommand, short_help=SHORT_HELP)
@click.argument("layers", metavar="LAYER...", nargs=-1, required=True, type=Layer())
@click.option(
    "--at",
    required=True,
    metavar="X,Y",
    help="The pixel, in coordinates of the canvas; 0,0 is its top left corner, unless the files "
    "say otherwise.",
)
@stack_options(*EXPLAINED, help=HELP)
@other_options(*EXPLAINED)
@format_option
@message_options
def command(layers: tuple[str, ...], at: str, format: str, **options: Any) -> None:
    """Say step by step how one pixel of a stack comes about.

    Layers and options are those of `hpcomp stack`, and the result is what it would write. For each
    layer, explain prints the stored sample, its linear colour, its weight after opacity and
    operators, its hue and its chroma. Then it prints which colours met in the blend order, how far
    apart their hues are, and which one dominated. At the end stand the result, the traditional
    result, and what became of the labels.

    With another --strength than chroma, the strength of each colour stands beside its chroma, and
    the stronger one dominates. With --blending woven, explain prints the colours by hue, each with
    its share of the strength, and which of them the pattern shows in this pixel.

    Chroma is |p|, the distance from the grey axis. Grey is the share of chroma that is cancelled.
    Margin is how far the layer whose hue survived was ahead of the strongest layer of another hue.

    The other options of stack are accepted too, but for -o and --format. They change nothing here.

    \b
      hpcomp explain base.png 'roads.png::opacity=0.6' --at 30,20
      hpcomp explain base.png 'roads.png::opacity=0.6' 'mask.png::tint=#377eb8' --at 30,20
      hpcomp explain base.png 'roads.png::opacity=0.6' --at 30,20 --order top-down --format json
    """
    analysis, report = load("hpcomp.analysis.explain"), load("hpcomp.report.explanation")
    pixel = analysis.explain(layers, at, **options)
    if format == "json":
        print_data(json.dumps(report.as_data(pixel), indent=2))
    else:
        print_data(report.as_text(pixel))
