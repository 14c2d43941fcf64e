"""`hpcomp palette`: what labels blend to, as text, data or a figure, with what may be wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from ..analysis.palette import (
    DEFAULT_CLOSE_HUES,
    DEFAULT_GREY_OPACITY,
    DEFAULT_LEAST_DIFFERENCE,
    DEFAULT_OPACITY,
)
from ..errors import ExitCode, SettingError
from ..measures.defaults import DEFAULT_ACHROMATIC
from ..options import ARRAY_RULES
from ..report.paletteformats import FIGURES, PALETTE_FORMATS, PaletteLook, load, palette_format
from ..system.outputs import write_bytes
from ..system.streams import STDOUT
from . import signals, terminal
from .messages import say
from .options import F, LayerCommand, OptionOfOlderName, message_options
from .printing import print_bytes
from .reportoptions import WRITING, opened_report, report_options
from .stackoptions import make_options, stack_options
from .words import Choice, Layer, Text, color_names

#: The rules of how two colours are added: labels are sRGB, and lie on a background of their own.
_RULES = [name for name in ARRAY_RULES if name not in ("background", "exposure", "primaries")]

_FORMATS = "\n".join(f"  {row.name:<6} {row.title}" for row in PALETTE_FORMATS.values())

PALETTE_HELP = f"""Say what the colours of labels blend to, and what may go wrong.

COLOR is a CSS colour such as orange or #e41a1c, or NAME=COLOR, 2 to 24 of them. Quote a #: in a
shell an unquoted # begins a comment. The # can be left out. --from takes labels from layer files.

palette puts every label over every other one at opacities from 0 to 1, in traditional blending and
with ⊕, or as --blending says. For each pair it prints the angle between the hues, the share of the
opacities at which the blend has a foreign hue, which is neither label's, the opacity at which the
blend has least chroma, and how much chroma is left there. The pair that goes grey at the least
opacity comes first.

A woven blend is no one colour. For each pair palette prints the colour of each label's thread and
its share of the pixels, with the front label half opaque; the figure shows the pattern itself.
Foreign hues, least chroma and labels on the background are measured of the threads.

The figure has a bar for each pair, with its hue alone below it, as in the paper's Figure 4. Its
discs show, as in Figure 6, all that any stack of the labels can give at any opacities: angle is
hue, radius is chroma. Figures need matplotlib, which the extra `plot` brings. The formats:

\b
{_FORMATS}

Each finding says what may go wrong, what was measured and what the limit is:

\b
  no-hue      the label is grey: only its luminance sets it apart
  close-hues  two hues are hard to tell apart once pale, or even count as equal
  vanishes    the label can hardly be seen on the background
  hue-lost    on the background the label does not keep its hue
  goes-grey   a little of one label turns the other one grey

Findings change the exit code only with --strict.

\b
  hpcomp palette '#e41a1c' '#377eb8' '#ffdd00'
  hpcomp palette fault=#e41a1c streams=#377eb8 band=#ffdd00 -o palette.svg
  hpcomp palette --from roads.png --from rivers.exr --background '#202020' --strict
"""


def _limit(*names: str, default: float, metavar: str, help: str) -> Callable[[F], F]:
    """An option that says how something is judged."""
    return click.option(
        *names,
        cls=OptionOfOlderName,
        type=float,
        default=default,
        show_default=True,
        metavar=metavar,
        help=help,
    )


@click.command(
    "palette", cls=LayerCommand, help=PALETTE_HELP, short_help=PALETTE_HELP.partition("\n")[0]
)
@click.argument("colors", metavar="[COLOR...]", nargs=-1, type=Text(color_names))
@click.option(
    "--from",
    "layers",
    multiple=True,
    metavar="LAYER",
    type=Layer("op", "opacity", "at"),
    help="Take labels from this file, in the LAYER syntax: one for each peak of its hues, in the "
    "mean colour of the peak. May be repeated.",
)
@report_options(PALETTE_FORMATS)
@click.option(
    "--figure",
    type=Choice(FIGURES, "figure"),
    default=PaletteLook.figure,
    show_default=True,
    help="Parts of a figure: all, or the bars or the discs alone.",
)
@stack_options(*_RULES)
@click.option(
    "--background",
    type=Text(color_names),
    default="#ffffff",
    show_default=True,
    metavar="COLOR",
    help="What labels are seen on.",
)
@_limit(
    "--opacity",
    default=DEFAULT_OPACITY,
    metavar="ALPHA",
    help="How opaque a label is on the background, 0 to 1.",
)
@_limit(
    "--least-difference",
    default=DEFAULT_LEAST_DIFFERENCE,
    metavar="DISTANCE",
    help="A label vanishes if it differs less than this from the background: a distance in Oklab, "
    "where black to white is 1 and 0.02 is just noticeable side by side.",
)
@_limit(
    "--close-hues",
    default=DEFAULT_CLOSE_HUES,
    metavar="DEGREES",
    help="Hues are close if their p vectors are less than this apart, 0 to 180.",
)
@_limit(
    "--gray-opacity",
    "--grey-opacity",
    "gray_opacity",
    default=DEFAULT_GREY_OPACITY,
    metavar="ALPHA",
    help="A pair goes grey too soon if the front label does it at less opacity than this, 0 to 1.",
)
@_limit(
    "--achromatic",
    default=DEFAULT_ACHROMATIC,
    metavar="SATURATION",
    help="Colours of less saturation, 0 to 1, have no hue.",
)
@stack_options("max_pixels", "clobber")
@click.option(
    "--strict",
    is_flag=True,
    help="End with exit code 6 if there is a finding; treat warnings as errors.",
)
@make_options
@message_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    colors: tuple[str, ...],
    layers: tuple[str, ...],
    output: str | None,
    format: str | None,
    figure: str,
    **options: Any,
) -> None:
    if len(colors) < 2 and not layers:
        raise SettingError(
            f"{'one colour' if colors else 'no colours'}: give two or more, and quote '#…', since "
            "in a shell an unquoted # begins a comment; e41a1c without # works as well"
        )
    palettes, data = (
        signals.load("hpcomp.analysis.palette"),
        signals.load("hpcomp.report.palettedata"),
    )
    target = STDOUT if output is None else output
    chosen = palette_format(target, format)
    terminal.check_shows(chosen, output)
    look = PaletteLook(figure=figure)
    if target == STDOUT:
        look = terminal.look(look)
    render = load(chosen)
    specs = signals.load("hpcomp.analysis.hues").images_to_measure(layers, target)
    writing = {name: options.pop(name) for name in WRITING}
    with opened_report(target, [spec.path for spec in specs], **writing) as place:
        blended = palettes.palette(colors, layers=layers, **options)
        content = render(blended, look)
        if target == STDOUT:
            print_bytes(content)
        else:
            write_bytes(place, content, target)
    if options["strict"] and blended.findings:
        for finding in blended.findings:
            say(f"hpcomp: palette: {finding.kind}: {data.sentence(blended, finding)}")
        ctx.exit(int(ExitCode.CHECK))
