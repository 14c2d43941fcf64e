"""What the fused engine finds of a strip: the sums of `measure.h` as findings and provenance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..compositing import StackRules
from ..encoding import Losses, Primaries
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
from ..samples import Samples, Strip
from . import Accumulator, _kernel, chosen_level, layer_of, rules_of  # type: ignore[attr-defined]

#: The columns of the sums in `measure.h`.
_RESULT_SUMS, _CONTRIBUTOR_SUMS, _HUE_COLUMNS = 7, 4, 8
#: As blended, traditional, and what is to be added to both.
_RESULTS = 3


class _StripSums:
    """What the loops add to, of one strip of `layers` layers, and the findings that it makes."""

    def __init__(
        self,
        rules: StackRules,
        settings: MeasureSettings,
        bins: int,
        layers: int,
        width: int,
        height: int,
        with_provenance: bool,
    ) -> None:
        self._rules, self._settings, self._n, self._pixels = rules, settings, layers, width * height
        self._results = np.zeros(
            (_RESULTS, _RESULT_SUMS + _CONTRIBUTOR_SUMS * (layers + 1)), np.int64
        )
        self._hues = np.zeros((layers + _RESULTS, bins, _HUE_COLUMNS), np.int64)
        self._others = np.zeros((layers + _RESULTS, 3), np.int64)
        self._provenance = Provenance.none((height, width)) if with_provenance else None
        tolerance = Angle.of(settings.foreign_tolerance)
        sine, cosine = float(tolerance.sine), float(tolerance.cosine)
        self.measures = _kernel.measures(
            [settings.half_step, settings.achromatic, sine, cosine],
            rules.blending.depends_on_order,
            layers,
            width,
            height,
            self._results,
            self._hues,
            self._others,
            *((None,) * 3 if self._provenance is None else vars(self._provenance).values()),
        )

    def findings(self) -> tuple[StackFindings, Provenance | None]:
        """To be asked for once."""
        n = self._n
        for sums in (self._results, self._hues[n:], self._others[n:]):
            sums[:-1] += sums[-1]
        histograms = [
            _histogram(self._rules, self._settings, rows, rest.tolist())
            for rows, rest in zip(self._hues[:-1], self._others[:-1], strict=True)
        ]
        result, traditional = (_result_measures(sums, n) for sums in self._results[:-1].tolist())
        measures = StackMeasures(
            self._settings,
            result,
            traditional,
            pixels=self._pixels,
            unmeasured=self.measures.unmeasured,
            order_sensitive=self.measures.order_sensitive,
        )
        found = StackFindings(measures, tuple(histograms[:n]), *histograms[n:])
        return found, self._provenance


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
    sums = _StripSums(rules, settings, bins, len(strips), width, height, with_provenance)
    layers = [layer_of(rules, k, strip, width, height)[0] for k, strip in enumerate(strips)]
    _kernel.measure(rules_of(rules), layers, sums.measures, chosen_level())
    return sums.findings()


def result_and_findings(
    accumulator: Accumulator,
    kind: str,
    losses: Losses,
    gamut: Primaries,
    rules: StackRules,
    settings: MeasureSettings,
    bins: int,
    strips: Sequence[Strip],
    width: int,
    height: int,
    with_provenance: bool = False,
) -> tuple[Samples, StackFindings, Provenance | None]:
    """The strip's samples and its findings, from one pass; its layers have been added at once."""
    sums = _StripSums(rules, settings, bins, len(strips), width, height, with_provenance)
    samples = accumulator.result(kind, losses, gamut, sums.measures)
    return samples, *sums.findings()


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
