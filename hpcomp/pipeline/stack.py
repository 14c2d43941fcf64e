"""One stack, from files to a file, in three steps: what is asked, what will be done, doing it."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Unpack

from ..engine import choice as engine
from ..imagefile.source import codec_threads
from ..layers.canvas import output_window
from ..layers.notices import Notices, warn_of_losses, warn_of_outside, warn_of_samples
from ..layers.placing import Layer, layer_specs, opened_stack, rules_of
from ..options import OPTIONS, StackOptions, takes_options
from .budget import share_out
from .observer import NobodyWatches, Observer
from .picture import PictureRequest, StackResult
from .strips import StackPlan, composite_strips

if TYPE_CHECKING:
    from ..keywords import StackKeywords

log = logging.getLogger("hpcomp")


@takes_options(*OPTIONS)
def stack(
    layers: Sequence[Layer],
    output: str | os.PathLike[str],
    asked: StackOptions | None = None,
    *,
    command: str = "",
    **options: Unpack[StackKeywords],
) -> StackResult:
    """Composites layer files, bottom first, into one file.

    `layers`: LAYER strings, paths or `LayerSpec`. `output`: a path ending in .png or .exr, or `-`
    for stdout with `format`. The options are those of `hpcomp stack` and mean the same; `asked` has
    them as a whole, and the keywords go first.
    `background`: a CSS colour, opaque, or straight linear RGB in the working primaries, in Rec. 709
    where these are `bottom`. `max_memory`: in bytes, or `512M`, `1G`.
    `report`: one path or several, whose endings name the formats. `foreign_tolerance` in degrees
    (twice `hue_tolerance` if None, more in oklab and cielab), `achromatic` in [0, 1],
    `energy_weights` of red, green and blue, and `bins` decide what reports count (0.02, an estimate
    and 360 if None). `command` is what they say made the picture. `provenance`: a path in .exr.
    SOURCE_DATE_EPOCH in the environment is the only date that is written.
    Returns: what was written, and the findings of a report. Nothing but complete files appear.
    Errors: `SettingError`, `InputError`, `MismatchError`, `OutputError`.
    Warnings: `HpcompWarning`; errors with `strict`.
    Source: Chuang et al. 2009; Porter and Duff 1984.
    """
    request = _requested(layers, os.fspath(output), StackOptions.of(options, base=asked))
    observer = _observer_of(request, command)
    request.check_places(observer.outputs)
    with contextlib.ExitStack() as opened:
        plan = _planned(request, observer, opened)
        return _made(plan, observer)


def _requested(layers: Sequence[Layer], output: str, options: StackOptions) -> PictureRequest:
    specs = layer_specs(layers)
    return PictureRequest.checked(specs, output, options, rules_of(specs, options.rules))


def _observer_of(request: PictureRequest, command: str) -> Observer:
    """Who writes the reports that are asked for. Errors: `SettingError`, `OutputError`."""
    asked = request.options.reports
    if not asked.is_asked:
        asked.check_unasked()
        return NobodyWatches()
    from ..report.recorder import Recorder  # with all that reports need

    return Recorder(
        request.options,
        request.rules,
        request.form,
        output=request.shown,
        labels=[spec.title for spec in request.specs],
        command=command,
    )


def _planned(
    request: PictureRequest, observer: Observer, opened: contextlib.ExitStack
) -> StackPlan:
    """Opens and places all files, until `opened` closes, and shares out threads and memory."""
    target = request.placed(opened)
    observer.place(opened)
    request.place_depfile(opened)
    notices = Notices(request.options.rules.strict)
    stacked = opened.enter_context(
        opened_stack(request.specs, request.rules, request.options, notices)
    )
    asked, windows = request.options, [layer.window for layer in stacked.layers]
    window = output_window(stacked.canvas, windows, asked.canvas, asked.resources.max_pixels)
    places = [spec.placement for spec in request.specs]
    warn_of_outside(places, stacked.layers, stacked.canvas, window, notices)
    readers = [layer.reader for layer in stacked.layers]
    readers[0].unseen.alone = len(readers) == 1 and stacked.rules.background is None
    threads, strip_rows = share_out(
        stacked.layers,
        window,
        stacked.rules,
        request.form,
        request.options.resources,
        observer,
    )
    opened.enter_context(codec_threads([*readers, request.form], reading=1, writing=threads))
    return StackPlan(
        request,
        target,
        stacked.rules,
        stacked.canvas,
        window,
        threads,
        readers[0].part,
        notices,
        layers=stacked.layers,
        strip_rows=strip_rows,
        missing_rows=(window.y - stacked.canvas.y) % observer.cell,
    )


def _made(plan: StackPlan, observer: Observer) -> StackResult:
    """Makes the picture, and what is written beside it."""
    request, rules = plan.request, plan.rules
    log.info("%d layers on %s", len(plan.layers), plan.in_words)
    log.info(
        "writing %s in strips of %d rows, %d threads, engine %s",
        plan.window,
        plan.strip_rows,
        plan.threads,
        engine.active().name,
    )
    with observer.watch(rules, plan.window, plan.canvas, plan.bottom.pixel_aspect):
        with plan.writer() as writer:
            losses = composite_strips(plan, writer, observer)
        observer.publish()
    warn_of_samples([layer.reader for layer in plan.layers], plan.notices)
    warn_of_losses(request.shown, losses, plan.notices)
    return StackResult(request.output, plan.canvas, plan.window, losses, observer.summary)
