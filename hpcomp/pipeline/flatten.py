"""Deep images, from files to one flat file: what is asked, what will be done, doing it.

What samples a pixel has is `deepsamples`' matter, how their colours are added the engine's.
"""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Unpack

import numpy as np
from numpy.typing import NDArray

from ..blending import deepsamples
from ..blending.deepsamples import DeepSamples
from ..blending.orders import ORDERS
from ..blending.rules import StackRules
from ..color.primaries import BOTTOM
from ..color.quantization import Losses
from ..color.samples import Samples
from ..engine import choice as engine
from ..engine.deepcompositing import bytes_to_reduce, flat
from ..errors import InputError, SettingError
from ..geometry import Window
from ..imagefile.deepreading import DeepReader
from ..imagefile.source import codec_threads
from ..imagefile.writing import OutputForm
from ..layers.canvas import LayerWindows, lay_out, output_window
from ..layers.layerspec import LayerSpec, check_stdin
from ..layers.notices import Notices, warn_of_losses, warn_of_outside, warn_of_problems
from ..layers.opening import opened_deep_layer
from ..layers.placing import Layer, layer_specs
from ..options import OPTIONS, ResourceOptions, StackOptions, takes_options
from ..records import record
from ..system.memory import parse_bytes, parse_pixels
from ..system.threads import ThreadPipeline, thread_count
from .deepbudget import Need
from .picture import PicturePlan, PictureRequest, StackResult

if TYPE_CHECKING:
    from ..keywords import FlattenKeywords

log = logging.getLogger("hpcomp")

#: Settings of a LAYER that deep samples have no use for, and why.
USELESS_SETTINGS = {
    "op": "samples lie one over the other, as their depths say",
    "opacity": "what it does would depend on how a volume was cut into samples",
    "tint": "samples have colours of their own",
}


@record
class PlacedImage:
    """An open deep image and how far its file's coordinates move to the canvas."""

    reader: DeepReader
    dx: int
    dy: int

    @property
    def window(self) -> Window:
        """Its pixels, in canvas coordinates."""
        return self.reader.window.moved(self.dx, self.dy)

    def add_rows(
        self, row_samples: NDArray[np.int64], window: Window, total: NDArray[np.int64]
    ) -> None:
        """Adds what its rows have of samples, from its top, to that of the rows of `window`."""
        common = self.window.intersection(window)
        if common is not None:
            here, there = common.y - self.window.y, common.y - window.y
            total[there : there + common.height] += row_samples[here : here + common.height]

    def read(self, rows: Window) -> tuple[DeepSamples, int]:
        """The samples of the pixels of `rows` of the canvas, and how many were left out."""
        counts = np.zeros((rows.height, rows.width), np.int64)
        common = self.window.intersection(rows)
        if common is None:
            return _no_samples(counts), 0
        begin = common.y - self.dy
        samples, left_out = self.reader.read(begin, begin + common.height)
        there = samples.counts.reshape(common.height, self.window.width)
        columns = slice(common.x - self.window.x, common.right - self.window.x)
        if common.width < self.window.width:
            inside = np.zeros(there.shape, bool)
            inside[:, columns] = True
            kept = np.repeat(inside.ravel(), samples.counts)
            samples = DeepSamples(
                samples.counts, samples.front[kept], samples.back[kept], samples.rgba[kept]
            )
        at = common.moved(-rows.x, -rows.y)
        counts[at.y : at.bottom, at.x : at.right] = there[:, columns]
        return DeepSamples(counts.ravel(), samples.front, samples.back, samples.rgba), left_out


def _no_samples(counts: NDArray[np.int64]) -> DeepSamples:
    none = np.empty(0, np.float32)
    return DeepSamples(counts.ravel(), none, none, np.empty((0, 4), np.float32))


#: The options of a picture that say nothing of samples: these have no operators and no numbers.
_OF_STACKS = ("op", *(name for name, row in OPTIONS.items() if row.group == "reports"))
#: Those that `flatten` takes.
FLATTEN_OPTIONS = tuple(name for name in OPTIONS if name not in _OF_STACKS)


@takes_options(*FLATTEN_OPTIONS)
def flatten(
    images: Layer | Sequence[Layer],
    output: str | os.PathLike[str],
    asked: StackOptions | None = None,
    **options: Unpack[FlattenKeywords],
) -> StackResult:
    """Composites the samples of deep EXR files along each viewing ray into one flat file.

    `images`: one or several LAYER strings, paths or `LayerSpec`, in any order: samples of all files
    lie where their depths say. `output` and the options are those of `stack` and mean the same,
    the farthest sample being the bottom; `order` is no permutation; `canvas` "bottom" and
    `primaries` "bottom" are those of the first file.
    Volumes are split where samples begin or end inside them. What coincides is added first, all at
    once as with `order` "simultaneous"; then the samples of a pixel are a stack with "over".
    `nonfinite`: "zero" leaves samples with NaN or Inf out.
    Returns: what was written. Nothing but complete files appear.
    Errors: `SettingError`, `InputError`, `MismatchError`, `OutputError`.
    Warnings: `HpcompWarning`; errors with `strict`.
    Source: Chuang et al. 2009; OpenEXR: Interpreting Deep Pixels.
    """
    checked = StackOptions.of(options, base=asked, names=FLATTEN_OPTIONS)
    request = _requested(images, os.fspath(output), checked)
    request.check_places()
    with contextlib.ExitStack() as opened:
        return _made(_planned(request, opened))


def _requested(
    images: Layer | Sequence[Layer], output: str, options: StackOptions
) -> PictureRequest:
    several = [images] if isinstance(images, (str, os.PathLike, LayerSpec)) else list(images)
    specs = deep_specs(several)
    order = options.rules.order
    if order not in ORDERS:
        raise SettingError(
            f"order '{order}' is not one for samples, which have no numbers: choose one of "
            + ", ".join(ORDERS)
        )
    # Of a stack of one layer: how many there are differs from pixel to pixel.
    rules = options.rules.of_layers([None], [1.0])
    return PictureRequest.checked(specs, output, options, rules)


@record
class FlatteningPlan(PicturePlan):
    """The plan of flattening: the images where they lie, and the strips that memory allows."""

    images: Sequence[PlacedImage]
    strips: Sequence[Window]


def _planned(request: PictureRequest, opened: contextlib.ExitStack) -> FlatteningPlan:
    """Opens and places all files, until `opened` closes, and shares out threads and memory."""
    target = request.placed(opened)
    request.place_depfile(opened)
    options, rules = request.options, request.rules
    notices = Notices(options.rules.strict)
    nonfinite, max_pixels = options.rules.nonfinite, options.resources.max_pixels
    readers = [
        opened.enter_context(opened_deep_layer(spec, spec.title, nonfinite, max_pixels))
        for spec in request.specs
    ]
    if options.rules.primaries == BOTTOM:
        rules = rules.in_primaries(readers[0].decoding.encoding.primaries)
    _prepare(readers, rules, notices)
    images, canvas = _placed(request.specs, readers, options.canvas.canvas)
    window = output_window(canvas, [image.window for image in images], options.canvas, max_pixels)
    places = [spec.placement for spec in request.specs]
    warn_of_outside(places, images, canvas, window, notices)
    threads, strips = _strips(images, window, rules, request.form, options.resources)
    opened.enter_context(codec_threads([request.form], reading=1, writing=threads))
    return FlatteningPlan(
        request,
        target,
        rules,
        canvas,
        window,
        threads,
        readers[0].part,
        notices,
        images=images,
        strips=strips,
    )


def _made(plan: FlatteningPlan) -> StackResult:
    """Makes the picture."""
    request, rules, window = plan.request, plan.rules, plan.window
    log.info("%s", plan.in_words)
    log.info(
        "writing %s in %d strips, %d threads, engine %s",
        window,
        len(plan.strips),
        plan.threads,
        engine.active().name,
    )
    work = _Work(plan.images, rules, request.form, plan.canvas)
    with plan.writer() as writer, ThreadPipeline[Samples](plan.threads) as pipeline:
        # Each strip is a source of its own: they are read and flattened side by side.
        made = pipeline.read_ahead(
            (number, partial(work.strip, rows, pipeline.go_on))
            for number, rows in enumerate(plan.strips)
        )
        for rows, samples in zip(plan.strips, made, strict=True):
            prepare = partial(writer.prepare, rows.y - window.y, samples)
            pipeline.write_behind(prepare, writer.write)
            del samples, prepare
        pipeline.flush()
    for what, seconds in {**work.seconds, "writing": pipeline.seconds["writing"]}.items():
        log.info("%s: %.3f s of all threads together", what, seconds)
    for image, left_out in zip(plan.images, work.left_out, strict=True):
        held = image.reader.alphas.in_words("sample")
        if held:
            plan.notices.warn(f"{image.reader.label}: {held}")
        if left_out:
            samples_are = "1 sample is" if left_out == 1 else f"{left_out} samples are"
            plan.notices.warn(f"{image.reader.label}: {samples_are} NaN or infinite, and left out")
    warn_of_losses(request.shown, work.losses, plan.notices)
    return StackResult(request.output, plan.canvas, window, work.losses)


def deep_specs(images: Sequence[Layer]) -> list[LayerSpec]:
    """The settings of every image; `SettingError` for those that samples have no use for."""
    if not images:
        raise SettingError("there is nothing to flatten: name a deep EXR")
    specs = layer_specs(images)
    for spec in specs:
        for setting, why in USELESS_SETTINGS.items():
            if getattr(spec, setting) != getattr(LayerSpec, setting):
                raise SettingError(f"{spec.title}: {why}, so '{setting}' is to be left out")
    check_stdin(specs, "images")
    return specs


def _prepare(readers: Sequence[DeepReader], rules: StackRules, notices: Notices) -> None:
    """Has them decode into the working primaries, and warns of what is odd about them."""
    aspect = readers[0].part.pixel_aspect
    for reader in readers:
        reader.work_in(rules.primaries)
        warn_of_problems(reader, notices)
        if reader.part.pixel_aspect != aspect:
            notices.warn(
                f"{reader.label} has pixels of aspect {reader.part.pixel_aspect:g}, "
                f"{readers[0].label} of {aspect:g}: resample it first"
            )


def _placed(
    specs: Sequence[LayerSpec], readers: Sequence[DeepReader], canvas: str | Window
) -> tuple[list[PlacedImage], Window]:
    """The images where they lie, and the canvas."""
    laid_out = lay_out(
        [
            LayerWindows(r.label, r.part.display_window, r.window, spec.placement)
            for spec, r in zip(specs, readers, strict=True)
        ],
        canvas,
    )
    placed = [
        PlacedImage(reader, *by) for reader, by in zip(readers, laid_out.offsets, strict=True)
    ]
    return placed, laid_out.window


def _strips(
    images: Sequence[PlacedImage],
    window: Window,
    rules: StackRules,
    form: OutputForm,
    granted: ResourceOptions,
) -> tuple[int, list[Window]]:
    """How many threads memory allows, and the strips in which it allows the window to be made."""
    readers = [image.reader for image in images]
    need = Need.of(
        readers,
        [image.window for image in images],
        window,
        form,
        parse_bytes(granted.max_memory),
    )
    row_samples = np.zeros(window.height, np.int64)
    largest_chunk = deepest = 0
    for image in images:
        counts = image.reader.count()
        _check_samples(image.reader, int(counts.rows.sum()), parse_pixels(granted.max_pixels))
        image.add_rows(counts.rows, window, row_samples)
        largest_chunk = max(largest_chunk, counts.largest_chunk)
        deepest += counts.deepest  # no pixel has more
    log.info("%d samples, up to %d in a pixel", row_samples.sum(), deepest)
    has_volumes = any(reader.has_volumes for reader in readers)
    reducing = bytes_to_reduce(rules, deepest, has_volumes)
    need = replace(need, chunk=largest_chunk, reducing=reducing, deepest=deepest)
    return need.strips(row_samples, thread_count(granted.threads))


def _check_samples(reader: DeepReader, samples: int, most: int) -> None:
    if samples > most:
        raise InputError(
            f"{reader.label}: it claims {samples:,} samples, which is more than {most:,}: raise "
            "--max-pixels if that is right"
        )


class _Work:
    """Makes the strips, in any thread; counts what was lost on the way."""

    def __init__(
        self,
        images: Sequence[PlacedImage],
        rules: StackRules,
        form: OutputForm,
        canvas: Window,
    ) -> None:
        self._images, self._rules, self._form, self._canvas = images, rules, form, canvas
        self._lock = Lock()
        self.losses = Losses()
        self.left_out = [0] * len(images)
        self.seconds = {"reading": 0.0, "compositing": 0.0}

    def strip(self, rows: Window, go_on: Callable[[], None]) -> Samples:
        """The flat picture (height, width, 4) of `rows` of the canvas; `go_on` as in `flat`."""
        begin = time.perf_counter()
        read = [image.read(rows) for image in self._images]
        has_read = time.perf_counter()
        samples = deepsamples.merged([of_image for of_image, _ in read])
        lost = Losses()
        window = rows.moved(-self._canvas.x, -self._canvas.y)
        made = flat(samples, self._rules, self._form.kind, lost, self._form.gamut, go_on, window)
        done = time.perf_counter()
        with self._lock:
            self.losses.add(lost)
            for number, (_, left_out) in enumerate(read):
                self.left_out[number] += left_out
            self.seconds["reading"] += has_read - begin
            self.seconds["compositing"] += done - has_read
        return made.reshape(rows.height, rows.width, 4)
