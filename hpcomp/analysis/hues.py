"""Measures pictures in files, strip by strip: their hue histograms. Writes and draws nothing."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from ..color.samples import Strip, linear_rgba
from ..errors import SettingError
from ..imagefile.interpretation import check_nonfinite
from ..imagefile.reading import STRIP_ROWS, LayerReader
from ..imagefile.source import codec_threads
from ..layers.layerspec import LayerSpec, check_stdin, layer_spec
from ..layers.notices import Notices, warn_of_problems, warn_of_zeroed
from ..layers.opening import opened_layer
from ..measures.defaults import DEFAULT_ACHROMATIC, DEFAULT_BINS
from ..measures.histogram import HueHistogram, hue_histogram
from ..options import RuleOptions
from ..system.streams import STDIN, STDOUT
from ..system.threads import ThreadPipeline, thread_count

log = logging.getLogger("hpcomp")

Layer = LayerSpec | str | os.PathLike[str]

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
) -> HueHistogram:
    """Counts the pixels of a file by hue, as `hpcomp hues` does; memory does not follow its height.

    `path`: a file, a LAYER string or a `LayerSpec`; all pixels of its data window count.
    `bins`, `space`, `achromatic`: as in `hue_histogram`. `nonfinite`: `error`, `zero` or `keep`,
    for NaN and Inf. `strict`: warnings become errors. `threads`: all cores if None.
    Returns: a `HueHistogram`, the same for any number of threads.
    Errors: `SettingError`, `InputError`, `MismatchError`. Warnings: `HpcompWarning`.
    """
    spec = measured_image(path)
    check_nonfinite(nonfinite)
    n_threads = thread_count(threads)
    total = HueHistogram.empty(bins, space, achromatic)

    def measured(read: tuple[int, Strip]) -> _Measured:
        begin, strip = read
        rgba, broken = linear_rgba(strip)
        part = hue_histogram(rgba, bins=bins, space=space, achromatic=achromatic)
        return begin, part, broken

    notices = Notices(strict)
    begun = time.perf_counter()
    with (
        opened_layer(spec, image_label(spec), nonfinite) as reader,
        codec_threads([reader], reading=1, writing=1),
    ):
        warn_of_problems(reader, notices)
        # Closed before the reader is: no thread reads on behind a failure.
        with ThreadPipeline[_Measured](n_threads) as pipeline:
            for begin, part, broken in pipeline.read_ahead(_reads(reader), measured):
                reader.note_nonfinite(begin, broken)
                total += part
        warn_of_zeroed([reader], notices)
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


#: A strip's first row, its histogram, and how many of its pixels are stored with NaN or Inf.
_Measured = tuple[int, HueHistogram, int]


def _reads(reader: LayerReader) -> Iterator[tuple[int, Callable[[], tuple[int, Strip]]]]:
    """What reads each strip and tells its first row; all of one source."""

    def read(begin: int, end: int) -> tuple[int, Strip]:
        return begin, Strip(reader.read_samples(begin, end), reader.decoding)

    block, window = reader.rows_at_once, reader.window
    rows = -(-STRIP_ROWS // block) * block  # whole blocks: none is decoded twice
    for begin in range(window.y, window.bottom, rows):
        yield 0, partial(read, begin, min(begin + rows, window.bottom))
