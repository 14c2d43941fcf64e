"""What the fused engine finds of a strip: the sums of `measure.h` as a summary and provenance."""

from __future__ import annotations

from ..measures.histogram import HueHistogram
from ..measures.labels import (
    Angle,
    ContributorMeasures,
    Provenance,
    ResultMeasures,
    StackMeasures,
)
from ..measures.summary import StackSummary, StripToMeasure
from . import _kernel


class StripMeasures:
    """What the loops add to, `sums`, of one strip, and the summary that it makes."""

    def __init__(self, strip: StripToMeasure) -> None:
        self._strip = strip
        self._provenance, planes = None, None
        if strip.with_provenance:
            self._provenance = made = Provenance.none((strip.height, strip.width))
            planes = _kernel.provenance(layer=made.layer, grey=made.grey, margin=made.margin)
        settings = strip.settings
        tolerance = Angle.of(settings.foreign_tolerance)
        self.sums = _kernel.measures(
            layers=len(strip.strips),
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
        )

    def summary(self) -> tuple[StackSummary, Provenance | None]:
        """The summary so far, and the provenance planes (height, width) where they are wanted."""
        strip, sums = self._strip, self.sums
        measures = StackMeasures(
            strip.settings,
            result=_result_measures(sums.result),
            traditional=_result_measures(sums.traditional),
            pixels=strip.width * strip.height,
            unmeasured=sums.unmeasured,
            order_sensitive=sums.order_sensitive,
        )
        layers = range(len(strip.strips))
        summary = StackSummary(
            measures,
            layers=tuple(self._histogram(sums.layer_hues(number=number)) for number in layers),
            result=self._histogram(sums.result_hues),
            traditional=self._histogram(sums.traditional_hues),
        )
        return summary, self._provenance

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


def _result_measures(sums: _kernel.ResultSums) -> ResultMeasures:
    return ResultMeasures(
        layers=tuple(_contributor(layer) for layer in sums.layers),
        background=_contributor(sums.background),
        chromatic=sums.chromatic,
        chroma=sums.chroma,
        foreign=sums.foreign,
        foreign_chroma=sums.foreign_chroma,
        light=sums.light,
    )


def _contributor(sums: _kernel.ContributorSums) -> ContributorMeasures:
    return ContributorMeasures(
        pixels=sums.pixels,
        survived=sums.survived,
        visible=sums.visible,
        chroma=sums.chroma,
        kept=sums.kept,
    )
