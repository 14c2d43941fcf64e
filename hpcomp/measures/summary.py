"""What a report of a stack is made from: its measures and hue histograms. No text, no pictures.

Found in numpy here, of pixels that are decoded and placed; which engine finds them of strips is
`engine`'s matter. Parts of a picture add up to the whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.samples import Strip
from ..geometry import Window
from .defaults import DEFAULT_BINS
from .histogram import HueHistogram, hue_histogram
from .labels import (
    RESULTS,
    MeasureSettings,
    Provenance,
    StackMeasures,
    Sums,
    blocks_of,
    contributors,
    measures_of,
    results_of,
    summed,
    unwoven_of,
)
from .squares import Picture, Squares

Array = NDArray[np.float32]


@dataclass(frozen=True)
class StackSummary(Sums):
    """The measures and histograms of a stack or of a part of it; `a + b` is that of both.

    `layers`: the histogram of each layer, bottom first, at its opacity and as far as it lies on the
    canvas. `result` and `traditional`: of the stack as it is blended and by plain +, over the
    background and before the exposure; `hue_preserving`: by ⊕, where the stack is woven.
    """

    measures: StackMeasures
    layers: tuple[HueHistogram, ...]
    result: HueHistogram
    traditional: HueHistogram
    hue_preserving: HueHistogram | None = None

    @property
    def results(self) -> dict[str, HueHistogram]:
        """What there is of `RESULTS`, in their order."""
        return results_of(self)

    @staticmethod
    def none(rules: StackRules, settings: MeasureSettings, bins: int) -> StackSummary:
        """The summary of no pixel, to add others to."""
        empty = HueHistogram.empty(bins, rules.space.name, settings.achromatic)
        unwoven = None if unwoven_of(rules) is None else empty
        of_layers = (empty,) * len(rules.operators)
        return StackSummary(StackMeasures.none(rules, settings), of_layers, empty, empty, unwoven)


def summary_of(
    rules: StackRules,
    settings: MeasureSettings,
    layers: Sequence[Array],
    bins: int = DEFAULT_BINS,
    origin: tuple[int, int] = (0, 0),
    squares: Squares | None = None,
) -> tuple[StackSummary, Provenance]:
    """The summary of some rows of a picture, and their provenance; arguments as `measures_of`.

    `squares`: what all layers and results are added to.
    """
    measures, provenance = measures_of(rules, settings, layers, origin)
    total = StackSummary.none(rules, settings, bins)
    for place, block in blocks_of(layers, origin):
        inside = place.moved(-origin[0], -origin[1])
        counted: dict[Picture, HueHistogram] = {}
        with np.errstate(all="ignore"):  # NaN and Inf are counted, not judged
            for picture, rgba in _pictures(rules, block, place):
                counted[picture] = hue_histogram(
                    rgba, bins=bins, space=rules.space, achromatic=settings.achromatic
                )
                if squares is not None:
                    squares.add(picture, rgba.reshape(place.height, place.width, 4), inside)
        total += StackSummary(
            StackMeasures.none(rules, settings),
            tuple(counted[number] for number in range(len(layers))),
            **{name: counted[name] for name in RESULTS if name in counted},
        )
    return replace(total, measures=measures), provenance


@dataclass(frozen=True)
class StripToMeasure:
    """All layers of a strip, bottom first, and what is to be found of them.

    `width`, `height`: of the strip, in pixels. `with_provenance`: whether that is wanted.
    `origin`: x and y of its first pixel, counted from the canvas' corner. `squares`: of this strip,
    what its layers and results are added to; None where no small pictures are wanted.
    """

    rules: StackRules
    settings: MeasureSettings
    bins: int
    strips: Sequence[Strip]
    width: int
    height: int
    with_provenance: bool = False
    origin: tuple[int, int] = (0, 0)
    squares: Squares | None = None


def _pictures(
    rules: StackRules, layers: Sequence[Array], place: Window
) -> Iterator[tuple[Picture, Array]]:
    """The layers at their opacities, by number, and the results by name: (pixels, 4) each."""
    pixels = contributors(rules, layers, place)
    alpha = pixels.alpha[pixels.known]
    ways = [pixels.reduced(rules), pixels.plain(rules)]
    if (unwoven := unwoven_of(rules)) is not None:
        ways.append(pixels.reduced(unwoven))
    for number, (rgba, opacity) in enumerate(zip(layers, rules.opacities, strict=True)):
        yield number, rgba * np.float32(opacity)
    for name, p in zip(RESULTS, ways, strict=False):
        # What cannot be measured is still a pixel of the picture.
        colors = np.full((len(pixels.known), 4), np.nan, np.float32)
        rgb = rules.space.inverse(summed(pixels.luminance), p)
        colors[pixels.known] = np.concatenate([rgb, alpha[None]]).T
        yield name, colors
