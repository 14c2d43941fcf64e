"""`hpcomp stack`: parses, calls `pipeline.stack.stack`, prints nothing of its own."""

from __future__ import annotations

import re
import shlex
import sys
from typing import Any

import click

from ..blending.porter_duff import OPERATORS
from ..layers.layerspec import LAYER_KEYS
from .options import LayerCommand, at_a_time, message_options
from .signals import load
from .stackoptions import output_option, stack_options
from .words import File, Layer

#: What may be a pattern of frames.
_PATTERN_SIGN = re.compile("%|##")

LAYER_HELP = f"""Composite layers, bottom first, into one picture.

LAYER is PATH[::key=value[,key=value]...]. PATH `-` reads stdin. The last `::` separates path and
keys, unless the whole argument is an existing file. A value cannot contain a comma. Keys:
{", ".join(LAYER_KEYS)}.

\b
  op=OPERATOR      {", ".join(OPERATORS)}
  opacity=0…1      scales the layer's colour and alpha
  at=PLACE         +X+Y, or a gravity: center, north-west, south+0-10 …
  alpha=MODE       straight, premultiplied, premultiplied-encoded, luminance
  colorspace=NAME  overrides what the file says: srgb, linear, acescg …
  tint=COLOR       colours a grey mask, whose stored values become the alpha
  part=NAME        a part of a multi-part EXR, by name or index
  layer=NAME       channels NAME.R, NAME.G, NAME.B, NAME.A of an EXR
  name=TEXT        what messages call the layer

\b
  hpcomp stack base.png 'roads.png::opacity=0.6' rivers.exr -o map.png
  hpcomp stack base.png 'roads.png::opacity=0.6' rivers.exr --preset labels -o even.png
  hpcomp stack base.png 'roads.png::opacity=0.6' rivers.exr --preset woven -o woven.png
  hpcomp stack base.png 'mask.png::op=dst-in,tint=white' -o cut.exr
  hpcomp stack base.png 'mask.png::tint=#377eb8,opacity=0.6' -o map.png
  hpcomp stack base.png roads.png -o map.png --report map.html --provenance origin.exr
  hpcomp stack base.png 'fg.####.exr::opacity=0.5' -o out.%04d.exr --frames 1-3
  cat a.png | hpcomp stack b.exr - -o - --format png > c.png
"""


@click.command("stack", cls=LayerCommand, help=LAYER_HELP, short_help=LAYER_HELP.partition("\n")[0])
@click.argument("layers", metavar="LAYER...", nargs=-1, required=True, type=Layer())
@output_option
@stack_options(
    *("format", "op", "preset", "blending", "order", "space", "strength", "primaries"),
    *("hue_tolerance", "gray_bias", "weave", "weave_size"),
    *("depth", "compression", "out_primaries", "exposure", "region", "clobber", "canvas"),
    *("overscan", "background", "nonfinite", "strict", "threads", "max_memory", "max_pixels"),
    *("report", "provenance", "foreign_tolerance", "achromatic", "bins", "energy_weights"),
    *("depfile", "depfile_target", "write_if_changed"),
)
@click.option(
    "--frames",
    metavar="RANGE",
    help="Make a sequence, each frame a file: 1-240, 1-240x2, or several between commas. The "
    "number stands where paths have %04d or ####; a layer without is the same in every frame. "
    "For more, such as --update or a log, add --save-job and run hpcomp batch.",
)
@at_a_time("Frames at a time: one for each core if not given.")
@click.option(
    "--save-job",
    metavar="PATH",
    type=File(".json", ".jsonl"),
    help="Make nothing, but write the stack as a job of hpcomp batch, or each frame as one: to a "
    "path ending in .json, or as more lines of a .jsonl.",
)
@message_options
@click.pass_context
def command(
    ctx: click.Context,
    /,
    layers: tuple[str, ...],
    output: str,
    frames: str | None,
    workers: int | None,
    save_job: str | None,
    **options: Any,
) -> None:
    if frames is None and workers is not None:
        raise click.UsageError("-j is for frames, which --frames names", ctx)
    if frames is not None:
        sequence = load("hpcomp.jobs.frames")
        # A depfile with a number is that of each frame, any other one that of all of them.
        shared = ["threads", "max_memory"]
        if not sequence.is_numbered(options["depfile"] or ""):
            shared += ["depfile", "depfile_target"]
        run = {name: options.pop(name) for name in shared}
        jobs = sequence.frame_jobs(layers, output, frames, **options)
        if save_job is None:
            load("hpcomp.cli.batch").run(ctx, jobs, workers=workers, **run)
            return
    if save_job is not None:
        if frames is None:
            jobs = [load("hpcomp.jobs.schema").job_of_stack(layers, output, options)]
        load("hpcomp.jobs.jobfile").save_jobs(jobs, save_job)
        return
    if any(_PATTERN_SIGN.search(path) for path in layers):
        load("hpcomp.jobs.frames").check_no_frames(layers)
    pipeline = load("hpcomp.pipeline.stack")
    if options["report"]:
        options["command"] = shlex.join(["hpcomp", *sys.argv[1:]])
    pipeline.stack(layers, output, **options)
