"""`hpcomp flatten`: parses, calls `pipeline.flatten.flatten`, prints nothing of its own."""

from __future__ import annotations

from typing import Any

import click

from ..blending.orders import ORDERS
from .options import LayerCommand, message_options
from .signals import load
from .stackoptions import output_option, stack_options
from .words import Layer

FLATTEN_HELP = """Composite the samples of deep EXR files into one flat picture.

A deep EXR has many samples along each viewing ray. hpcomp sorts them by depth, and splits them
where they overlap, as OpenEXR's document on deep pixels says. The samples of a pixel are then a
stack with `over`, with the farthest at the bottom. The samples of several files become one stack:
their depths say which is in front. Samples in one place are added first, all at once, so the order
of files and samples has no effect. With `--blending woven` nothing is merged: each sample has its
part in the pattern, as far as it is seen.

IMAGE is a deep EXR file, with scanlines or tiles, in the LAYER syntax of stack; `-` reads stdin. It
has the channels Z and A, and ZBack if it has volumes; samples without a colour are black. Keys:

\b
  part=NAME        a part of a multi-part EXR, by name or index
  layer=NAME       channels NAME.R, NAME.G, NAME.B; without a NAME.A, with the A around it
  at=PLACE         +X+Y, or a gravity: center, north-west, south+0-10 …
  alpha=MODE       straight, premultiplied, premultiplied-encoded, luminance
  colorspace=NAME  overrides what the file says: linear, acescg …
  name=TEXT        what messages call the file

\b
  hpcomp flatten smoke.exr -o smoke.png
  hpcomp flatten smoke.exr bones.exr --order top-down -o both.exr
  hpcomp flatten 'shot.exr::layer=glow' --background '#000000' -o glow.png
  cat smoke.exr | hpcomp flatten - -o - --format png > smoke.png
"""


@click.command(
    "flatten", cls=LayerCommand, help=FLATTEN_HELP, short_help=FLATTEN_HELP.partition("\n")[0]
)
@click.argument(
    "images", metavar="IMAGE...", nargs=-1, required=True, type=Layer("op", "opacity", "tint")
)
@output_option
@stack_options(
    *("format", "preset", "blending", "order", "space", "strength", "primaries"),
    *("hue_tolerance", "gray_bias", "weave", "weave_size"),
    *("depth", "compression", "out_primaries", "exposure", "region", "clobber", "canvas"),
    *("overscan", "background", "nonfinite", "strict", "threads", "max_memory", "max_pixels"),
    *("depfile", "depfile_target", "write_if_changed"),
    help={
        "order": f"In which order the samples' colours are added: {', '.join(ORDERS)}. The bottom "
        "is the farthest.",
        "nonfinite": "NaN, and infinite colours or alphas: error (refuse them), zero (such a "
        "sample is left out), keep (one whose depth is NaN is behind all others).",
    },
)
@message_options
def command(images: tuple[str, ...], output: str, **options: Any) -> None:
    load("hpcomp.pipeline.flatten").flatten(images, output, **options)
