"""What a report of a stack is made from: its measures and hue histograms. No text, no pictures.

Found in numpy here, of pixels that are decoded and placed; which engine finds them of strips is
`engine`'s matter. Parts of a picture add up to the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.samples import Strip
from ..geometry import Window
from .defaults import DEFAULT_BINS
from .histogram import HueHistogram, hue_histogram
from .labels import (
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
) -> tuple[StackSummary, Provenance]:
    """The summary of some rows of a picture, and their provenance; arguments as `measures_of`."""
    measures, provenance = measures_of(rules, settings, layers, origin)
    total = StackSummary.none(rules, settings, bins)
    for place, block in blocks_of(layers, origin):
        with np.errstate(all="ignore"):  # NaN and Inf are counted, not judged
            total += _histograms(rules, settings, block, bins, place)
    return replace(total, measures=measures), provenance


@dataclass(frozen=True)
class StripToMeasure:
    """All layers of a strip, bottom first, and what is to be found of them.

    `width`, `height`: of the strip, in pixels. `with_provenance`: whether that is wanted.
    `origin`: x and y of its first pixel, counted from the canvas' corner.
    """

    rules: StackRules
    settings: MeasureSettings
    bins: int
    strips: Sequence[Strip]
    width: int
    height: int
    with_provenance: bool = False
    origin: tuple[int, int] = (0, 0)


def _histograms(
    rules: StackRules,
    settings: MeasureSettings,
    layers: Sequence[Array],
    bins: int,
    place: Window,
) -> StackSummary:
    def counted(rgba: Any) -> HueHistogram:
        return hue_histogram(rgba, bins=bins, space=rules.space, achromatic=settings.achromatic)

    pixels = contributors(rules, layers, place)
    opacities = np.array(rules.opacities, np.float32)
    alpha = pixels.alpha[pixels.known]
    ways = [pixels.reduced(rules), pixels.plain(rules)]
    if (unwoven := unwoven_of(rules)) is not None:
        ways.append(pixels.reduced(unwoven))
    results = []
    for p in ways:
        # What cannot be measured is still a pixel of the picture.
        rgba = np.full((len(pixels.known), 4), np.nan, np.float32)
        rgb = rules.space.inverse(summed(pixels.luminance), p)
        rgba[pixels.known] = np.concatenate([rgb, alpha[None]]).T
        results.append(counted(rgba))
    return StackSummary(
        StackMeasures.none(rules, settings),
        tuple(counted(rgba * opacity) for rgba, opacity in zip(layers, opacities, strict=True)),
        *results,
    )
