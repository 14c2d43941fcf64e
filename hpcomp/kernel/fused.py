"""The fused engine: every pixel from stored samples to stored samples in one pass, in C++.

Says in numbers what the rules and the decodings say in tables; the loops are in `block.cpp`, and
what they are given, by keyword and as enums, is checked in `module.cpp`. Fails to import where it
was not built.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import ROUNDING_ANGLE
from ..blending.orders import ORDERS
from ..blending.porter_duff import Factor
from ..blending.rules import Reduction, StackRules, checked_rules
from ..blending.strength import HALF_CHROMA, STRENGTHS
from ..blending.terms import term_of
from ..blending.weaving import noise_tile
from ..color import spaces
from ..color.primaries import REC709, Primaries, conversion_pairs, to_xyz
from ..color.quantization import Losses
from ..color.samples import (
    NOTHING,
    OUTPUT_TYPES,
    PLAIN,
    Decoding,
    Samples,
    Strip,
    cropped,
    linear_rgba,
)
from ..color.spaces import HslCoefficients, PlaneCoefficients, Space
from ..color.transfer import SRGB, decode_table
from ..color.uniformspaces import CielabCoefficients, OklabCoefficients
from ..errors import unknown_name
from . import _kernel

if TYPE_CHECKING:  # only reports need them
    from ..measures.histogram import HueHistogram
    from ..measures.labels import Provenance
    from ..measures.summary import StackSummary, StripToMeasure

#: Chooses an instruction set by name; the tests compare them.
LEVEL_VARIABLE = "HPCOMP_KERNEL_LEVEL"

_BLENDINGS = {
    "hue-preserving": _kernel.Blending.HUE_PRESERVING,
    "traditional": _kernel.Blending.TRADITIONAL,
    "foremost": _kernel.Blending.FOREMOST,
    "woven": _kernel.Blending.WOVEN,
}

#: But for the chroma, which the loops have at hand.
_STRENGTHS = {
    "perceived": _kernel.Strength.PERCEIVED,
    "coverage": _kernel.Strength.COVERAGE,
}

_PATTERNS = {
    "stripes": _kernel.Pattern.STRIPES,
    "noise": _kernel.Pattern.NOISE,
}

_FOLDS = {
    Reduction.BOTTOM_UP: _kernel.Order.BOTTOM_UP,
    Reduction.FRONT_TO_BACK: _kernel.Order.FRONT_TO_BACK,
}
#: Of what reduces all layers at once; any other order is a permutation to the loops.
_ORDERS = {
    "balanced": _kernel.Order.BALANCED,
    "simultaneous": _kernel.Order.SIMULTANEOUS,
}

_FACTORS = {
    Factor.ZERO: _kernel.Factor.ZERO,
    Factor.ONE: _kernel.Factor.ONE,
    Factor.ALPHA: _kernel.Factor.ALPHA,
    Factor.REST: _kernel.Factor.REST,
}


def levels() -> list[str]:
    """The instruction sets that were built and that this processor runs, the fastest last."""
    return _kernel.levels()


class KernelEngine:
    """The contract's `Engine` in C++."""

    name = "kernel"
    decodes_in_numpy = False
    pairs_at_once = 1 << 24

    def start(
        self,
        rules: StackRules,
        width: int,
        height: int,
        dtype: Any = np.float32,
        origin: tuple[int, int] = (0, 0),
        phases: NDArray[np.float32] | None = None,
    ) -> Accumulator:
        """An empty accumulator for a strip of that size, whose planes are float32."""
        return Accumulator(rules, width, height, origin, phases)

    def bytes_to_reduce(self, rules: StackRules, layers: int) -> int:
        """Scratch for the terms of a block, and for what reduces them."""
        if rules.reduction is not Reduction.ALL_LAYERS:
            return 0
        return _kernel.scratch_bytes(order=_order_of(rules), layers=layers)

    def keep_runs(
        self,
        rules: StackRules,
        counts: NDArray[np.int64],
        p: NDArray[np.float64],
        strengths: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """What is kept of each of runs of chroma vectors, added at once: p (2, n), m (n) → (n)."""
        kept = np.empty(p.shape[1])
        _kernel.keep_runs(rules=rules_of(rules), counts=counts, p=p, strengths=strengths, kept=kept)
        return kept

    def bytes_to_keep(self, terms: int) -> int:
        """The terms themselves, and what sorting them by hue takes."""
        return _kernel.run_bytes(terms=terms)

    def measures(self, rules: StackRules) -> bool:
        """It measures in linear spaces alone, and what competes by its chroma in them."""
        by_chroma = rules.strength is STRENGTHS["chroma"] and not rules.blending.depends_on_place
        return rules.space.linear and by_chroma

    def hues(self, strip: Strip, like: HueHistogram) -> HueHistogram | None:
        """The histogram of one strip: the layer's, in the summary of a stack of that layer."""
        rules = _rules_of_one(like.space)
        if not self.measures(rules) or not strip.decoding.is_plain(strip.samples):
            return None
        from ..measures.labels import MeasureSettings
        from ..measures.summary import StripToMeasure

        height, width = strip.samples.shape[:2]
        settings = MeasureSettings(0.0, like.achromatic, 0.0)
        alone = StripToMeasure(rules, settings, like.bins, (strip,), width, height)
        return self.summary(alone)[0].layers[0]

    def summary(self, strip: StripToMeasure) -> tuple[StackSummary, Provenance | None]:
        """The summary of a strip, and its provenance planes (height, width) where wanted."""
        from .measuring import StripMeasures

        measures, rules = StripMeasures(strip), strip.rules
        layers = [
            layer_of(rules, number, layer, strip.width, strip.height)[0]
            if layer is not NOTHING or number in rules.needed_everywhere
            else None
            for number, layer in enumerate(strip.strips)
        ]
        _kernel.measure(
            rules=rules_of(rules), layers=layers, measures=measures.sums, level=chosen_level()
        )
        return measures.summary()


@cache
def _rules_of_one(space: str) -> StackRules:
    """The rules of a stack of one layer, in which nothing is blended."""
    return checked_rules(
        [None],
        [1.0],
        blending="traditional",
        order="bottom-up",
        space=space,
        hue_tolerance=0.0,
        gray_bias=0.0,
        background=None,
        exposure=0.0,
        primaries=REC709.name,
        strength="chroma",
        weave="stripes",
        weave_size=8,
    )


ENGINE = KernelEngine()


class Accumulator:
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite."""

    def __init__(
        self,
        rules: StackRules,
        width: int,
        height: int,
        origin: tuple[int, int],
        phases: NDArray[np.float32] | None,
    ) -> None:
        self.rules, self.shape = rules, (height, width, 4)
        self.nonfinite = [0] * len(rules.operators)
        self._decoded: set[int] = set()  # layers whose broken pixels were counted by numpy
        self._strip = _kernel.Accumulator(
            rules=rules_of(rules),
            width=width,
            height=height,
            left=origin[0],
            top=origin[1],
            phases=phases,
            level=chosen_level(),
        )

    def add(self, numbers: Sequence[int], strips: Sequence[Strip]) -> None:
        """Layers by number; `nonfinite` counts their pixels with NaN or Inf."""
        layers: list[_kernel.Layer | None] = []
        needed = self.rules.needed_everywhere
        for number, strip in zip(numbers, strips, strict=True):
            if strip is NOTHING and number not in needed:
                layers.append(None)
                continue
            layer, broken = layer_of(self.rules, number, strip, self.shape[1], self.shape[0])
            layers.append(layer)
            if broken is not None:
                self.nonfinite[number] = broken
                self._decoded.add(number)
        self._count(numbers, self._strip.add(numbers=list(numbers), layers=layers))

    def _count(self, numbers: Iterable[int], counts: Sequence[int]) -> None:
        for number, count in zip(numbers, counts, strict=False):
            if number not in self._decoded:
                self.nonfinite[number] += count

    def result(self, kind: str, losses: Losses, gamut: Primaries = REC709) -> Samples:
        """The composite (height, width, 4), as samples of that kind; codes are of that gamut."""
        return self._result(kind, losses, gamut)

    def result_and_summary(
        self, kind: str, losses: Losses, gamut: Primaries, strip: StripToMeasure
    ) -> tuple[Samples, StackSummary, Provenance | None]:
        """The samples of the accumulated strip and its summary, from one pass."""
        from .measuring import StripMeasures

        measures = StripMeasures(strip)
        samples = self._result(kind, losses, gamut, measures.sums)
        return samples, *measures.summary()

    def _result(
        self, kind: str, losses: Losses, gamut: Primaries, measures: _kernel.Measures | None = None
    ) -> Samples:
        """`measures`: a `_kernel.Measures` to add to; all layers have been added at once."""
        out = np.empty(self.shape, OUTPUT_TYPES[kind])
        codes = _codes(out.dtype, self.rules.primaries, gamut, self.rules.space.name)
        lost, nonfinite = self._strip.result(out=out, codes=codes, measures=measures)
        losses.add(
            Losses(
                out_of_gamut=lost.out_of_gamut,
                light_without_alpha=lost.light_without_alpha,
                not_a_number=lost.not_a_number,
                beyond_half=lost.beyond_half,
            )
        )
        self._count(range(len(nonfinite)), nonfinite)
        return out


def chosen_level() -> str:
    """The instruction set that the environment names, empty for the fastest."""
    level = os.environ.get(LEVEL_VARIABLE, "")
    if level not in ("", *levels()):
        raise unknown_name(f"instruction set in {LEVEL_VARIABLE}", level, levels())
    return level


def layer_of(
    rules: StackRules, number: int, strip: Strip, width: int, height: int
) -> tuple[_kernel.Layer, int | None]:
    """A layer for the loops, and how many pixels are broken where numpy had to decode it."""
    broken = None
    if not strip.decoding.is_plain(strip.samples):
        strip = cropped(strip, width, height)
        rgba, broken = linear_rgba(strip)
        strip = Strip(rgba, PLAIN, strip.left, strip.top)
    samples, decoding = strip.samples, strip.decoding
    operator = rules.operators[number]
    factor_a, factor_b = Factor.ONE, Factor.ZERO
    if operator is not None:
        factor_a, factor_b = operator.factor_a, operator.factor_b
    layer = _kernel.layer(
        samples=samples,
        decode=_table(samples, decoding),
        alpha_straight=decoding.alpha_mode == "straight",
        matrix=conversion_pairs(decoding.encoding.primaries, decoding.working),
        left=strip.left,
        top=strip.top,
        opacity=rules.opacities[number],
        factor_a=_FACTORS[factor_a],
        factor_b=_FACTORS[factor_b],
        behind=operator is not None and operator.behind,
        zero_nonfinite=decoding.zero_nonfinite,
    )
    return layer, broken


@lru_cache(maxsize=8)
def rules_of(rules: StackRules) -> _kernel.Rules:
    """The rules in numbers, for the loops."""
    n = len(rules.operators)
    sequence = rules.order.sequence
    if rules.order is ORDERS["top-down"]:
        sequence = tuple(reversed(range(n)))
    return _kernel.rules(
        blending=_BLENDINGS[rules.blending.name],
        hue_tolerance=math.radians(rules.hue_tolerance),
        rounding_angle=ROUNDING_ANGLE,
        gray_bias=rules.gray_bias,
        order=_order_of(rules),
        permutation=list(sequence),
        layers=n,
        background=_background(rules),
        gain=2.0**rules.exposure,
        space=_maps(rules.blending_space),
        competition=_competition(rules),
        weave=_weave(rules),
    )


def _competition(rules: StackRules) -> _kernel.Competition | None:
    """How strong colours are; None where that is their chroma."""
    strength = _STRENGTHS.get(rules.strength.name)
    if strength is None:
        return None
    oklab = _maps(spaces.space("oklab", rules.space.rgb_to_xyz))
    return _kernel.competition(strength=strength, oklab=oklab, half_chroma=HALF_CHROMA)


def _weave(rules: StackRules) -> _kernel.Weave | None:
    """The pattern, where there is one."""
    if not rules.blending.depends_on_place:
        return None
    pattern = _PATTERNS[rules.weave.pattern.name]
    tile = noise_tile() if pattern is _kernel.Pattern.NOISE else None
    return _kernel.weave(pattern=pattern, size=rules.weave.size, tile=tile)


def _order_of(rules: StackRules) -> _kernel.Order:
    if rules.blending.depends_on_place:
        return _kernel.Order.WOVEN
    fold = _FOLDS.get(rules.reduction)
    return _ORDERS.get(rules.order.name, _kernel.Order.PERMUTATION) if fold is None else fold


def _background(rules: StackRules) -> _kernel.Background | None:
    """The background as a term, and where results are bounded what bounds its channels."""
    if rules.background is None:
        return None
    color = np.array(rules.background, np.float32)[:, None]
    term = term_of(rules, color, 1.0)
    lo, hi = term.bounds[:, 0].tolist() if rules.bounded else (0.0, 0.0)
    return _kernel.background(
        luminance=float(term.luminance[0]),
        p=term.p[:, 0].tolist(),
        rgb=color[:, 0].tolist(),
        lo=lo,
        hi=hi,
        strength=0.0 if term.strength is None else float(term.strength[0]),
    )


def _maps(space: Space) -> _kernel.SpaceMaps:
    """The maps of a space."""
    coefficients = space.coefficients
    match coefficients:
        case PlaneCoefficients():
            return _kernel.linear_maps(**_plane(coefficients))
        case HslCoefficients(plane=plane):
            return _kernel.hsl_maps(**_plane(plane))
    weight_red, weight_blue = coefficients.weights
    slack_lo, slack_hi = space.gamut_slack
    match coefficients:
        case OklabCoefficients():
            return _kernel.oklab_maps(
                weight_red=weight_red,
                weight_blue=weight_blue,
                to_lms=coefficients.to_lms,
                to_lab=coefficients.to_lab,
                to_roots=coefficients.to_roots,
                from_lms=coefficients.from_lms,
                inverse_largest=1 / coefficients.largest,
                slack_lo=slack_lo,
                slack_hi=slack_hi,
            )
        case CielabCoefficients():
            return _kernel.cielab_maps(
                weight_red=weight_red,
                weight_blue=weight_blue,
                to_xz=coefficients.to_xz,
                from_xz=coefficients.from_xz,
                inverse_largest=1 / coefficients.largest,
                slack_lo=slack_lo,
                slack_hi=slack_hi,
            )


def _plane(coefficients: PlaneCoefficients) -> dict[str, Any]:
    weight_red, weight_blue = coefficients.weights
    return {
        "weight_red": weight_red,
        "weight_blue": weight_blue,
        "to_p": coefficients.to_p,
        "from_p": coefficients.from_p,
    }


def _table(samples: Samples, decoding: Decoding) -> NDArray[np.float32] | None:
    if samples.dtype not in (np.uint8, np.uint16):
        return None  # the binding refuses what is neither codes nor floats
    return decode_table(decoding.encoding.transfer, int(np.iinfo(samples.dtype).max))


#: Buckets an octave of linear light: so many that hardly one holds two thresholds.
_BUCKET_BITS = {8: 7, 16: 12}


@cache
def _codes(
    dtype: np.dtype[Any],
    working: Primaries = REC709,
    gamut: Primaries = REC709,
    space_name: str = spaces.DEFAULT_SPACE,
) -> _kernel.Codes | None:
    """How linear light of the working primaries becomes codes of that gamut; None for floats.

    `space_name`: of the space whose hues they keep.
    """
    if dtype.kind != "u":
        return None
    return _kernel.codes(
        **code_tables(dtype),
        matrix=conversion_pairs(working, gamut),
        luminance_weights=list(to_xyz(gamut)[1]),
        space=_maps(spaces.space(space_name, to_xyz(gamut))),
    )


def code_tables(dtype: np.dtype[Any]) -> dict[str, Any]:
    """What `_kernel.codes` needs to know of a depth, by keyword.

    A code begins half a step below its value, at its threshold. Buckets are runs of float32
    numbers, found by shifting their bits; from the first code of its bucket a value climbs to its
    own.
    """
    largest = int(np.iinfo(dtype).max)
    steps = (np.arange(largest) + 0.5) / largest
    thresholds = np.append(SRGB.decode(steps), np.inf).astype(np.float32)
    smallest = 2.0 ** math.floor(math.log2(float(thresholds[0])))
    bits = _BUCKET_BITS[dtype.itemsize * 8]
    octaves = -int(math.log2(smallest))
    start_bits = np.float32(smallest).view(np.uint32)
    begins = (start_bits + (np.arange((octaves << bits) + 1, dtype=np.uint32) << (23 - bits))).view(
        np.float32
    )
    half_code = 0.5 / largest
    lowest, darkest, highest = SRGB.decode(np.array([-half_code, half_code, 1 + half_code]))
    return {
        "thresholds": thresholds,
        "first_code": np.searchsorted(thresholds, begins, side="right").astype(np.uint16),
        "bucket_bits": bits,
        "smallest": smallest,
        "lowest": float(lowest),
        "darkest": float(darkest),
        "highest": float(highest),
    }
