"""What the fused engine finds of a strip: the sums of `measure.h` as a summary and provenance."""

from __future__ import annotations

from dataclasses import replace

from ..color.samples import NOTHING
from ..measures.histogram import HueHistogram
from ..measures.labels import (
    Angle,
    ContributorMeasures,
    Provenance,
    ResultMeasures,
    StackMeasures,
)
from ..measures.squares import Squares
from ..measures.summary import StackSummary, StripToMeasure
from . import _kernel

#: Of a layer that is not there.
_NOTHING_FOUND = ContributorMeasures(pixels=0, survived=0, visible=0, chroma=0, kept=0)


class StripMeasures:
    """What the loops add to, `sums`, of one strip, and the summary that it makes."""

    def __init__(self, strip: StripToMeasure) -> None:
        self._strip = strip
        self._there = [
            number
            for number, layer in enumerate(strip.strips)
            if layer is not NOTHING or number in strip.rules.needed_everywhere
        ]
        self._provenance, planes = None, None
        if strip.with_provenance:
            self._provenance = made = Provenance.none((strip.height, strip.width))
            planes = _kernel.provenance(layer=made.layer, grey=made.grey, margin=made.margin)
        settings, squares = strip.settings, strip.squares
        tolerance = Angle.of(settings.foreign_tolerance)
        self.sums = _kernel.measures(
            layers=len(self._there),
            width=strip.width,
            height=strip.height,
            left=strip.origin[0],
            top=strip.origin[1],
            bins=strip.bins,
            half_step=settings.half_step,
            achromatic=settings.achromatic,
            foreign_sine=float(tolerance.sine),
            foreign_cosine=float(tolerance.cosine),
            depends_on_order=strip.rules.blending.depends_on_order,
            provenance=planes,
            square_scale=0 if squares is None else squares.scale,
            square_top=0 if squares is None else squares.top,
        )

    def summary(self) -> tuple[StackSummary, Provenance | None]:
        """The summary so far, and the provenance planes (height, width) where they are wanted."""
        strip, sums = self._strip, self.sums
        if strip.squares is not None:
            self._add_squares(strip.squares)
        measures = StackMeasures(
            strip.settings,
            result=self._result_measures(sums.result),
            traditional=self._result_measures(sums.traditional),
            pixels=strip.width * strip.height,
            unmeasured=sums.unmeasured,
            order_sensitive=sums.order_sensitive,
        )
        space, achromatic = strip.rules.space.name, strip.settings.achromatic
        empty = HueHistogram.empty(strip.bins, space, achromatic)
        histograms = [replace(empty, transparent=strip.width * strip.height)] * len(strip.strips)
        for place, number in enumerate(self._there):
            histograms[number] = self._histogram(sums.layer_hues(number=place))
        summary = StackSummary(
            measures,
            layers=tuple(histograms),
            result=self._histogram(sums.result_hues),
            traditional=self._histogram(sums.traditional_hues),
        )
        return summary, self._provenance

    def _add_squares(self, squares: Squares) -> None:
        for place, number in enumerate(self._there):
            squares.sums[number] = self.sums.layer_squares(number=place)
        squares.sums["result"] = self.sums.result_squares()
        squares.sums["traditional"] = self.sums.traditional_squares()

    def _result_measures(self, sums: _kernel.ResultSums) -> ResultMeasures:
        layers = [_NOTHING_FOUND] * len(self._strip.strips)
        for number, found in zip(self._there, sums.layers, strict=True):
            layers[number] = _contributor(found)
        return ResultMeasures(
            layers=tuple(layers),
            background=_contributor(sums.background),
            chromatic=sums.chromatic,
            chroma=sums.chroma,
            foreign=sums.foreign,
            foreign_chroma=sums.foreign_chroma,
            light=sums.light,
        )

    def _histogram(self, hues: _kernel.HueSums) -> HueHistogram:
        return HueHistogram(
            space=self._strip.rules.space.name,
            achromatic=self._strip.settings.achromatic,
            count=hues.count,
            chroma=hues.chroma,
            alpha=hues.alpha,
            rgb=hues.rgb,
            grey=hues.grey,
            transparent=hues.transparent,
            nonfinite=hues.nonfinite,
        )


def _contributor(sums: _kernel.ContributorSums) -> ContributorMeasures:
    return ContributorMeasures(
        pixels=sums.pixels,
        survived=sums.survived,
        visible=sums.visible,
        chroma=sums.chroma,
        kept=sums.kept,
    )
