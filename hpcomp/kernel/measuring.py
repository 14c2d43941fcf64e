"""What the fused engine finds of a strip: the sums of `measure.h` as findings and provenance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..compositing import StackRules
from ..findings import StackFindings
from ..histogram import HueHistogram
from ..measures import (
    Angle,
    ContributorMeasures,
    MeasureSettings,
    Provenance,
    ResultMeasures,
    StackMeasures,
)
from ..samples import Strip
from . import _kernel, chosen_level, layer_of, rules_of  # type: ignore[attr-defined]

#: The columns of the sums in `measure.h`.
_RESULT_SUMS, _CONTRIBUTOR_SUMS, _HUE_COLUMNS = 7, 4, 8
#: As blended, traditional, and what is to be added to both.
_RESULTS = 3


def findings(
    rules: StackRules,
    settings: MeasureSettings,
    bins: int,
    strips: Sequence[Strip],
    width: int,
    height: int,
    with_provenance: bool = False,
) -> tuple[StackFindings, Provenance | None]:
    """The findings of a strip, all its layers bottom first; provenance planes (height, width)."""
    n = len(strips)
    results = np.zeros((_RESULTS, _RESULT_SUMS + _CONTRIBUTOR_SUMS * (n + 1)), np.int64)
    hues = np.zeros((n + _RESULTS, bins, _HUE_COLUMNS), np.int64)
    others = np.zeros((n + _RESULTS, 3), np.int64)
    provenance = Provenance.none((height, width)) if with_provenance else None
    tolerance = Angle.of(settings.foreign_tolerance)
    unmeasured, order_sensitive = _kernel.measure(
        rules_of(rules),
        [settings.half_step, settings.achromatic, float(tolerance.sine), float(tolerance.cosine)],
        rules.blending.depends_on_order,
        [layer_of(rules, k, strip, width, height)[0] for k, strip in enumerate(strips)],
        width,
        height,
        results,
        hues,
        others,
        *((None,) * 3 if provenance is None else vars(provenance).values()),
        chosen_level(),
    )
    for sums in (results, hues[n:], others[n:]):
        sums[:-1] += sums[-1]
    histograms = [
        _histogram(rules, settings, rows, rest.tolist())
        for rows, rest in zip(hues[:-1], others[:-1], strict=True)
    ]
    result, traditional = (_result_measures(sums, n) for sums in results[:-1].tolist())
    measures = StackMeasures(
        settings,
        result,
        traditional,
        pixels=width * height,
        unmeasured=unmeasured,
        order_sensitive=order_sensitive,
    )
    return StackFindings(measures, tuple(histograms[:n]), *histograms[n:]), provenance


def _histogram(
    rules: StackRules, settings: MeasureSettings, rows: NDArray[np.int64], others: list[int]
) -> HueHistogram:
    count, chroma, alpha = (rows[:, column].copy() for column in range(3))
    return HueHistogram(
        rules.space.name, settings.achromatic, count, chroma, alpha, rows[:, 3:6].copy(), *others
    )


def _result_measures(sums: list[int], layers: int) -> ResultMeasures:
    chromatic, chroma, foreign, foreign_chroma, *light = sums[:_RESULT_SUMS]
    rows = [
        ContributorMeasures(*sums[begin : begin + _CONTRIBUTOR_SUMS])
        for begin in range(_RESULT_SUMS, len(sums), _CONTRIBUTOR_SUMS)
    ]
    red, green, blue = light
    return ResultMeasures(
        tuple(rows[:layers]),
        rows[layers],
        chromatic,
        chroma,
        foreign,
        foreign_chroma,
        (red, green, blue),
    )
