"""What the fused engine finds of a strip: the sums of `measure.h` as findings and provenance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.primaries import Primaries
from ..color.quantization import Losses
from ..color.samples import Samples
from ..measures.findings import MeasuredStrip, StackFindings
from ..measures.histogram import HueHistogram
from ..measures.labels import (
    Angle,
    ContributorMeasures,
    MeasureSettings,
    Provenance,
    ResultMeasures,
    StackMeasures,
)
from . import _kernel  # type: ignore[attr-defined]
from .fused import Accumulator, chosen_level, layer_of, rules_of

#: The columns of the sums in `measure.h`.
_RESULT_SUMS, _CONTRIBUTOR_SUMS, _HUE_COLUMNS = 7, 4, 8
#: As blended, traditional, and what is to be added to both.
_RESULTS = 3


class _StripSums:
    """What the loops add to, of one strip, and the findings that it makes."""

    def __init__(self, strip: MeasuredStrip) -> None:
        self._strip, n = strip, len(strip.strips)
        self._results = np.zeros((_RESULTS, _RESULT_SUMS + _CONTRIBUTOR_SUMS * (n + 1)), np.int64)
        self._hues = np.zeros((n + _RESULTS, strip.bins, _HUE_COLUMNS), np.int64)
        self._others = np.zeros((n + _RESULTS, 3), np.int64)
        self._provenance = None
        if strip.with_provenance:
            self._provenance = Provenance.none((strip.height, strip.width))
        settings = strip.settings
        tolerance = Angle.of(settings.foreign_tolerance)
        sine, cosine = float(tolerance.sine), float(tolerance.cosine)
        self.measures = _kernel.measures(
            [settings.half_step, settings.achromatic, sine, cosine],
            strip.rules.blending.depends_on_order,
            n,
            strip.width,
            strip.height,
            self._results,
            self._hues,
            self._others,
            *((None,) * 3 if self._provenance is None else vars(self._provenance).values()),
        )

    def findings(self) -> tuple[StackFindings, Provenance | None]:
        """To be asked for once."""
        strip, n = self._strip, len(self._strip.strips)
        for sums in (self._results, self._hues[n:], self._others[n:]):
            sums[:-1] += sums[-1]
        histograms = [
            _histogram(strip.rules, strip.settings, rows, rest.tolist())
            for rows, rest in zip(self._hues[:-1], self._others[:-1], strict=True)
        ]
        result, traditional = (_result_measures(sums, n) for sums in self._results[:-1].tolist())
        measures = StackMeasures(
            strip.settings,
            result,
            traditional,
            pixels=strip.width * strip.height,
            unmeasured=self.measures.unmeasured,
            order_sensitive=self.measures.order_sensitive,
        )
        found = StackFindings(measures, tuple(histograms[:n]), *histograms[n:])
        return found, self._provenance


def findings(strip: MeasuredStrip) -> tuple[StackFindings, Provenance | None]:
    """The findings of a strip, and its provenance planes (height, width) where they are wanted."""
    sums, rules = _StripSums(strip), strip.rules
    layers = [
        layer_of(rules, number, layer, strip.width, strip.height)[0]
        for number, layer in enumerate(strip.strips)
    ]
    _kernel.measure(rules_of(rules), layers, sums.measures, chosen_level())
    return sums.findings()


def result_and_findings(
    accumulator: Accumulator, kind: str, losses: Losses, gamut: Primaries, strip: MeasuredStrip
) -> tuple[Samples, StackFindings, Provenance | None]:
    """The samples of the accumulated strip and its findings, from one pass."""
    sums = _StripSums(strip)
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
