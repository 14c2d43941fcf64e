"""`hpcomp check`: measures a picture against its layers or hues, and ends with a verdict."""

from __future__ import annotations

import contextlib
import json
from typing import Any

import click

from ..errors import ExitCode, SettingError
from ..system.depfile import Depfile
from ..system.streams import STDOUT
from .messages import say
from .options import LayerCommand, OptionOfOlderName, format_option, message_options
from .printing import print_data
from .signals import load
from .stackoptions import NEAR_A_LAYER, depfile_options, other_options, stack_options
from .words import Layer

#: The options of a stack that change what is measured, and what that may take.
CHECKED = (
    *("foreign_tolerance", "achromatic"),
    *("op", "preset", "space", "primaries", "hue_tolerance", "exposure"),
    *("region", "canvas", "background"),
    *("nonfinite", "strict", "threads", "max_memory", "max_pixels"),
)

HELP = {
    **NEAR_A_LAYER,
    "preset": "A set of choices of stack, of which the space and the hue tolerance count here.",
}

SHORT_HELP = "Fail if a picture has lost the hues of its layers."


@click.command("check", cls=LayerCommand, short_help=SHORT_HELP)
@click.argument("image", metavar="IMAGE", type=Layer("op", "opacity"))
@click.argument("layers", metavar="[LAYER...]", nargs=-1, type=Layer())
@click.option(
    "--hues",
    metavar="HUE,HUE...",
    help="Check against these hues instead of layers: degrees, 0 red, 60 yellow, 120 green, "
    "240 blue, of the linear colour; with --space oklab or cielab those of that space.",
)
@click.option(
    "--max-foreign",
    metavar="SHARE",
    help="Fail if more of the chromatic pixels have a hue that no layer gave them: 0.01 or 1%.",
)
@click.option(
    "--max-gray",
    "--max-grey",
    "max_gray",
    cls=OptionOfOlderName,
    metavar="SHARE",
    help="Fail if more of the layers' chroma was cancelled; against hues, if more of the visible "
    "pixels are grey.",
)
@click.option(
    "--require-hue",
    multiple=True,
    metavar="LABEL",
    help="Fail if this label is not visible: degrees such as 120, layer:1, or layer:NAME. May be "
    "repeated.",
)
@click.option(
    "--visible",
    default="0.1%",
    show_default=True,
    metavar="SHARE",
    help="For --require-hue a label is visible if this much of where it could be has its hue: of "
    "the pixels to which its layer contributes, or of all chromatic pixels.",
)
@click.option(
    "--min-visible",
    multiple=True,
    metavar="[LAYER=]SHARE",
    help="Fail if a layer is visible in less of its pixels: 95% for every layer that contributes "
    "anywhere, layer:1=90% or layer:NAME=90% for one. May be repeated.",
)
@stack_options(*CHECKED, help=HELP)
@other_options(*CHECKED, "depfile", "depfile_target")
@format_option
@depfile_options
@message_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    image: str,
    layers: tuple[str, ...],
    format: str,
    depfile: str | None,
    depfile_target: tuple[str, ...],
    **options: Any,
) -> None:
    """Fail if a picture has lost the hues of its layers.

    IMAGE is the picture. Layers and options are those that `hpcomp stack` made it with. Instead of
    layers, --hues lists the hues that are allowed. At least one of --max-foreign, --max-gray,
    --require-hue and --min-visible is needed. If a rule does not hold, the exit code is 6, and
    stderr has a line for each such rule. A depfile names the --depfile-target, such as a stamp, as
    what is made.
    The other options of stack are accepted too, but for -o and --format. They change nothing here.
    A list of options that stack and check share leaves out --depfile, as each writes its own.

    A hue is foreign if it is farther than the tolerance from the hue of every layer that
    contributes to that pixel. The rounding of the file is allowed for: half a code value of each
    channel, or half a unit in the last place of a half-float. Lossy compression is not.

    For --min-visible the canvas is cut into cells of 16 by 16 pixels from its corner. A pixel to
    which a layer contributes counts as visible if one of that layer's pixels in its cell has the
    layer's hue: a reader finds the label there.

    Layers whose hues run across a hue of another layer, as those of photographs do, are warned of:
    hue-preserving blending makes vivid rings of them, with grey beside.

    \b
      hpcomp check map.png base.png 'roads.png::opacity=0.6' rivers.exr --max-foreign 0.1%
      hpcomp check map.png base.png 'roads.png::opacity=0.6' rivers.exr --require-hue layer:roads
      hpcomp check map.png base.png 'roads.png::opacity=0.6' --min-visible 95%
      hpcomp check map.png --hues 0,120,231 --max-foreign 1% --format json
    """
    analysis, report = load("hpcomp.analysis.check"), load("hpcomp.report.check")
    deps = Depfile.asked(depfile, depfile_target, [STDOUT])
    read = [spec.path for spec in load("hpcomp.layers.placing").layer_specs([image, *layers])]
    if deps is not None and (own := set(deps.targets) & set(read)):
        raise SettingError(
            f"{min(own)} is read by the check, and cannot be what it makes: give --depfile-target "
            "the name of a stamp"
        )
    with contextlib.nullcontext() if deps is None else deps.written(read):
        result = analysis.check(image, layers, **options)
    if format == "json":
        print_data(json.dumps(report.as_data(result), indent=2))
    else:
        print_data(report.as_text(result))
    for line in report.failures(result):
        say(f"hpcomp: {line}")
    if not result.passed:
        ctx.exit(int(ExitCode.CHECK))
