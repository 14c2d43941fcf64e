"""Measures pictures in files, strip by strip: their hue histograms. Writes and draws nothing."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Sequence
from functools import partial

from ..color.samples import Strip, linear_rgba, part_of
from ..engine import choice as engine
from ..engine.contract import Engine
from ..errors import SettingError
from ..geometry import Window
from ..imagefile.interpretation import check_nonfinite
from ..imagefile.source import codec_threads
from ..layers.budget import DECODING_BYTES, RGBA_BYTES, Budget, share_out
from ..layers.layerspec import LayerSpec, check_stdin, layer_spec
from ..layers.notices import Notices, warn_of_problems, warn_of_samples
from ..layers.opening import opened_layer
from ..layers.placing import Layer, PlacedLayer
from ..measures.defaults import DEFAULT_ACHROMATIC, DEFAULT_BINS
from ..measures.histogram import HueHistogram, hue_histogram
from ..options import ResourceOptions, RuleOptions
from ..system.streams import STDIN, STDOUT
from ..system.threads import ThreadPipeline

log = logging.getLogger("hpcomp")

#: Pixels that are decoded and counted at a time, and the memory that this takes.
BLOCK_PIXELS = 1 << 14
MEASURING_BYTES = BLOCK_PIXELS * (RGBA_BYTES + DECODING_BYTES + 100)

#: Settings of a layer that say what a stack does with it, and nothing of what it looks like.
STACK_SETTINGS = ("op", "opacity", "at")


def measured_image(image: Layer) -> LayerSpec:
    """A picture to be measured: a LAYER without settings that only a stack gives a meaning.

    Errors: `SettingError`.
    """
    spec = layer_spec(image)
    for setting in STACK_SETTINGS:
        if getattr(spec, setting) != getattr(LayerSpec, setting):
            raise SettingError(
                f"{image}: '{setting}' says nothing of a single picture: leave it out"
            )
    return spec


def images_to_measure(images: Sequence[Layer], output: str) -> list[LayerSpec]:
    """The pictures for a report at `output`, checked as far as names go. Errors: `SettingError`."""
    specs = [measured_image(image) for image in images]
    check_stdin(specs, "images")
    for spec in specs:
        if _same_file(spec.path, output):
            raise SettingError(
                f"{output} is also an image to be measured, which the report would replace: "
                "name another file with -o"
            )
    return specs


def _same_file(path: str, output: str) -> bool:
    if path == STDIN or output == STDOUT:
        return False
    try:
        return os.path.isfile(path) and os.path.samefile(path, output)
    except (OSError, ValueError):
        return False


def image_label(spec: LayerSpec) -> str:
    """What reports and errors call a picture."""
    return spec.title


def read_hues(
    path: Layer,
    *,
    bins: int = DEFAULT_BINS,
    space: str = RuleOptions.space,
    achromatic: float = DEFAULT_ACHROMATIC,
    nonfinite: str = RuleOptions.nonfinite,
    strict: bool = RuleOptions.strict,
    threads: int | None = None,
    max_memory: str | int = ResourceOptions.max_memory,
    max_pixels: str | int = ResourceOptions.max_pixels,
) -> HueHistogram:
    """Counts the pixels of a file by hue, as `hpcomp hues` does; memory does not follow its height.

    `path`: a file, a LAYER string or a `LayerSpec`; all pixels of its data window count.
    `bins`, `space`, `achromatic`: as in `hue_histogram`. `nonfinite`: `error`, `zero` or `keep`,
    for NaN and Inf. `strict`: warnings become errors. `threads`: all cores if None.
    `max_memory`: for pixels and codecs, in bytes or as `512M`; where it is short, there are fewer
    threads, and fewer rows at a time. `max_pixels`: a file that claims more is refused.
    Returns: a `HueHistogram`, the same for any number of threads and any memory.
    Errors: `SettingError`, `InputError`, `MismatchError`. Warnings: `HpcompWarning`.
    """
    spec = measured_image(path)
    check_nonfinite(nonfinite)
    granted = ResourceOptions(threads, max_memory, max_pixels)
    none = total = HueHistogram.empty(bins, space, achromatic)
    notices = Notices(strict)
    begun = time.perf_counter()
    with (
        opened_layer(spec, image_label(spec), nonfinite, max_pixels, placed=False) as reader,
        codec_threads([reader], reading=1, writing=1),
    ):
        warn_of_problems(reader, notices)
        n_threads, rows = share_out(
            [reader],
            reader.window.height,
            granted,
            lambda threads: Budget.of_measuring([reader], threads, MEASURING_BYTES),
            reader.label,
        )
        picture = PlacedLayer(reader, 0, 0)
        reads = ((0, partial(picture.read_checked, strip)) for strip in picture.window.strips(rows))
        # Closed before the reader is: no thread reads on behind a failure.
        with ThreadPipeline[HueHistogram](n_threads) as pipeline:
            for part in pipeline.read_ahead(
                reads,
                partial(_measured, total=none, counting=engine.active(), go_on=pipeline.go_on),
            ):
                total += part
        warn_of_samples([reader], notices)
        log.info(
            "%s: %s, %s, alpha %s: %.3f s, %d threads",
            reader.label,
            reader.window,
            reader.decoding.encoding,
            reader.decoding.alpha_mode if reader.has_alpha else "none",
            time.perf_counter() - begun,
            n_threads,
        )
    return total


def _measured(
    strip: Strip, total: HueHistogram, counting: Engine, go_on: Callable[[], None]
) -> HueHistogram:
    """The histogram of a strip, like the empty `total`, by the engine or by numpy.

    What numpy counts is decoded in blocks, which stay in cache.
    """
    go_on()
    counted = counting.hues(strip, total)
    if counted is not None:
        return counted
    height, width = strip.samples.shape[:2]
    for block in Window(0, 0, width, height).blocks(BLOCK_PIXELS):
        go_on()
        rgba, _ = linear_rgba(part_of(strip, block))
        total += hue_histogram(
            rgba, bins=total.bins, space=total.space, achromatic=total.achromatic
        )
    return total
