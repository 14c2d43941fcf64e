"""`hpcomp hues`: measures images, and prints or writes one report of them all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from ..errors import HpcompError, InputError, MismatchError
from ..layers.layerspec import LayerSpec
from ..measures.defaults import DEFAULT_ACHROMATIC, DEFAULT_BINS, FEWEST_BINS, MOST_BINS
from ..measures.histogram import WEIGHTS
from ..report.hueformats import REPORT_FORMATS, report_format
from ..report.look import AXES, SCALES, Entry, Look
from ..system.outputs import write_bytes
from ..system.streams import STDOUT
from . import terminal
from .messages import say
from .options import LayerCommand, message_options
from .printing import print_bytes
from .reportoptions import WRITING, opened_report, report_options
from .signals import load
from .stackoptions import make_options, stack_options
from .words import Choice, Layer

_FORMATS = "\n".join(f"  {row.name:<6} {row.title}" for row in REPORT_FORMATS.values())

HUES_HELP = f"""Count the hues of images: how much of each, and which stand out.

IMAGE is a PNG or EXR file in the LAYER syntax of stack, with the keys alpha, colorspace, tint,
part, layer and name; `-` reads stdin. The hue is that of HSL, taken of the linear colour: 0 is
red, 120 green, 240 blue. With --space oklab or cielab it is the angle in that space. Grey and
transparent pixels are counted apart. Bins are centred on multiples of their width.

A peak is a bin with more pixels than any other bin within 2°, together with those bins. It is
listed if it holds 1% of the pixels with a hue, and if its bin has three times what is usual on
either side, up to 6° away. So a smear has no peak. The report also says which share of the pixels
is within 2° of the peaks, how many bins have a pixel, and the entropy of the histogram, which is 0
bits for a single hue.

Images that cannot be measured are named on stderr. A report on stdout has the other images. A file
is only written if it has all images. Figures need matplotlib, which the extra `plot` brings. The
formats:

\b
{_FORMATS}

\b
  hpcomp hues map.png
  hpcomp hues map.png plain.png -o hues.svg
  hpcomp hues 'render.exr::layer=diffuse' --format json > hues.json
"""


@click.command("hues", cls=LayerCommand, help=HUES_HELP, short_help=HUES_HELP.partition("\n")[0])
@click.argument(
    "images", metavar="IMAGE...", nargs=-1, required=True, type=Layer("op", "opacity", "at")
)
@report_options(REPORT_FORMATS)
@click.option(
    "--bins",
    type=int,
    default=DEFAULT_BINS,
    show_default=True,
    metavar="N",
    help=f"Bins of the circle, {FEWEST_BINS} to {MOST_BINS}.",
)
@stack_options("space", help={"space": "Blending space whose hue and chroma are measured."})
@click.option(
    "--achromatic",
    type=float,
    default=DEFAULT_ACHROMATIC,
    show_default=True,
    metavar="SATURATION",
    help="Pixels less saturated than this, 0 to 1, are grey.",
)
@click.option(
    "--weight",
    type=Choice(WEIGHTS, "weight"),
    default=WEIGHTS[0],
    show_default=True,
    help="What the bars of text and figures are shares of: pixels, their chroma or their alpha.",
)
@click.option(
    "--scale",
    type=Choice(SCALES, "scale"),
    default=Look.scale,
    show_default=True,
    help="Scale of the bars of text and figures.",
)
@click.option(
    "--axes",
    type=Choice(AXES, "axes"),
    default=Look.axes,
    show_default=True,
    help="Axes of a figure: straight, round, or both.",
)
@stack_options("clobber")
@stack_options(
    "nonfinite",
    help={
        "nonfinite": "NaN and Inf in an image: error (refuse it), zero (the pixel becomes "
        "transparent), keep (it is counted as such)."
    },
)
@stack_options("strict", "threads", "max_memory", "max_pixels")
@make_options
@message_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    images: tuple[str, ...],
    output: str | None,
    format: str | None,
    weight: str,
    scale: str,
    axes: str,
    **settings: Any,
) -> None:
    target = STDOUT if output is None else output
    chosen = report_format(target, format)
    terminal.check_shows(chosen, output)
    look = Look(weight=weight, scale=scale, axes=axes)
    if target == STDOUT:
        look = terminal.look(look)
    render = chosen.load()
    specs = load("hpcomp.analysis.hues").images_to_measure(images, target)
    writing = {name: settings.pop(name) for name in WRITING}
    # First of all, so that nothing is measured for a report that cannot be written.
    with opened_report(target, [spec.path for spec in specs], **writing) as place:
        entries, failures = _measured(specs, settings)
        if target == STDOUT and entries:
            print_bytes(render(entries, look))
        for failure in failures:
            say(f"hpcomp: error: {failure}")
        if failures:
            ctx.exit(int(failures[0].exit_code))
        if target != STDOUT:
            write_bytes(place, render(entries, look), target)


def _measured(
    specs: Sequence[LayerSpec], settings: dict[str, Any]
) -> tuple[list[Entry], list[HpcompError]]:
    """The histograms of the images that can be measured, and what is wrong with the others."""
    measuring = load("hpcomp.analysis.hues")
    entries: list[Entry] = []
    failures: list[HpcompError] = []
    for spec in specs:
        try:
            entries.append((measuring.image_label(spec), measuring.read_hues(spec, **settings)))
        except (InputError, MismatchError) as failure:
            failures.append(failure)
    return entries, failures
