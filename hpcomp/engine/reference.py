"""The reference engine: the paper in numpy, for reading and checking; runs without a compiler.

Works in blocks of pixels, so that temporaries stay in cache. Planes first: Y (n), p (2, n), α (n).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..blending.orders import ORDERS
from ..blending.rules import Reduction, StackRules
from ..blending.terms import term, weighted
from ..color.gamut import bounds_of, colors_within
from ..color.primaries import REC709, Primaries
from ..color.quantization import Losses
from ..color.samples import Samples, Strip, cropped, encode, linear_rgba, spread

if TYPE_CHECKING:  # only reports need them
    from ..measures.labels import Provenance
    from ..measures.summary import StackSummary, StripToMeasure

Array = NDArray[np.floating[Any]]

#: Pixels that are composited at a time, so that a few planes of them stay in the L2 cache.
BLOCK_PIXELS = 16_384

#: Of two terms that are added at once: their shoulder, support, rivalry, and what these take.
PAIR_BYTES = 36


class ReferenceEngine:
    """The contract's `Engine` in numpy; float64 goes through in float64."""

    name = "reference"
    decodes_in_numpy = True
    pairs_at_once = 1 << 17

    def start(
        self, rules: StackRules, width: int, height: int, dtype: Any = np.float32
    ) -> _Accumulator:
        """An empty accumulator for a strip of that size, of the kind that the rules need."""
        return _ACCUMULATORS[rules.reduction](rules, width, height, dtype)

    def bytes_to_reduce(self, rules: StackRules, layers: int) -> int:
        """The pairs of the terms of one pixel, where these are more than those of a block."""
        if rules.reduction is not Reduction.ALL_LAYERS or rules.order is not ORDERS["simultaneous"]:
            return 0
        return layers**2 * PAIR_BYTES

    def measures(self, rules: StackRules) -> bool:
        """It measures in every space."""
        return True

    def summary(self, strip: StripToMeasure) -> tuple[StackSummary, Provenance | None]:
        """The summary of a strip, and its provenance planes (height, width) where wanted."""
        from ..measures.summary import summary_of

        layers = []
        for layer in strip.strips:
            inside = cropped(layer, strip.width, strip.height)
            rgba, _ = linear_rgba(inside)
            layers.append(spread(rgba, inside.left, inside.top, strip.width, strip.height))
        summary, provenance = summary_of(strip.rules, strip.settings, layers, strip.bins)
        if not strip.with_provenance:
            return summary, None
        return summary, provenance.reshaped((strip.height, strip.width))


ENGINE = ReferenceEngine()


class _Accumulator(ABC):
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite."""

    def __init__(self, rules: StackRules, width: int, height: int, dtype: Any) -> None:
        self.rules, self.width, self.height = rules, width, height
        self.nonfinite = [0] * len(rules.operators)
        self._begin(width * height, dtype)

    def add(self, numbers: Sequence[int], strips: Sequence[Strip]) -> None:
        """Layers by number; `nonfinite` counts their pixels with NaN or Inf."""
        for number, strip in zip(numbers, strips, strict=True):
            inside = cropped(strip, self.width, self.height)
            rgba, self.nonfinite[number] = linear_rgba(inside)
            with np.errstate(all="ignore"):  # NaN and Inf may have been let through
                self.take(number, spread(rgba, inside.left, inside.top, self.width, self.height))

    def result(self, kind: str, losses: Losses, gamut: Primaries = REC709) -> Samples:
        """The composite (height, width, 4) as samples of a kind of `OUTPUT_TYPES`, or float64.

        Codes are of that gamut, floats in the working primaries.
        """
        with np.errstate(all="ignore"):
            rgba = self.composite().reshape(self.height, self.width, 4)
            return encode(rgba, kind, losses, self.rules.primaries, gamut)

    def result_and_summary(
        self, kind: str, losses: Losses, gamut: Primaries, strip: StripToMeasure
    ) -> tuple[Samples, StackSummary, Provenance | None]:
        """The samples of the accumulated strip, and its summary."""
        return self.result(kind, losses, gamut), *ENGINE.summary(strip)

    def term(self, number: int, rgba: Array) -> tuple[Array, Array, Array, Array]:
        """As `terms.term`, of layer `number`."""
        return term(self.rules.blending_space, self.rules.opacities[number], rgba)

    def _no_bounds(self, n_pixels: int, dtype: Any) -> Array:
        return bounds_of(self.rules.blending_space, np.zeros((3, n_pixels), dtype))

    @abstractmethod
    def _begin(self, n_pixels: int, dtype: Any) -> None: ...

    @abstractmethod
    def take(self, number: int, rgba: Array) -> None:
        """Layer `number`: (n_pixels, 4), linear, premultiplied, alpha in [0, 1]."""

    @abstractmethod
    def composite(self) -> Array:
        """The composite: (n_pixels, 4), linear, premultiplied."""


class BottomUp(_Accumulator):
    """Folds layers from the bottom: c ← F_A c_i ⊕ F_B c, the operators taken literally."""

    def _begin(self, n_pixels: int, dtype: Any) -> None:
        self.luminance, self.alpha = np.zeros((2, n_pixels), dtype)
        self.p, self.bounds = np.zeros((2, n_pixels), dtype), self._no_bounds(n_pixels, dtype)

    def take(self, number: int, rgba: Array) -> None:
        operator = self.rules.operators[number]
        for block in _blocks(len(rgba)):
            luminance, p, alpha, bounds = self.term(number, rgba[block])
            if operator is not None:
                alpha_below = self.alpha[block]
                f_a, f_b = operator.factors(alpha, alpha_below)
                luminance = f_a * luminance + f_b * self.luminance[block]  # [R1]
                front_first = operator.front_first(f_a * p, f_b * self.p[:, block])
                p = self.rules.add(*front_first)  # Eq. 2 with ⊕
                bounds = f_a * bounds + f_b * self.bounds[:, block]
                alpha = operator.alpha(alpha, alpha_below)
            self.luminance[block], self.p[:, block], self.alpha[block] = luminance, p, alpha
            self.bounds[:, block] = bounds

    def composite(self) -> Array:
        return _result(self.rules, self.luminance, self.p, self.bounds, self.alpha)


class FrontToBack(_Accumulator):
    """Folds layers from the top, all `over`: beside them only the transmittance is kept."""

    def _begin(self, n_pixels: int, dtype: Any) -> None:
        self.luminance, self.alpha = np.zeros((2, n_pixels), dtype)
        self.p, self.bounds = np.zeros((2, n_pixels), dtype), self._no_bounds(n_pixels, dtype)
        self.transmittance = np.ones(n_pixels, dtype)

    def take(self, number: int, rgba: Array) -> None:
        for block in _blocks(len(rgba)):
            luminance, p, alpha, bounds = self.term(number, rgba[block])
            weight = self.transmittance[block]
            self.luminance[block] += weight * luminance  # [R1]
            self.p[:, block] = self.rules.add(self.p[:, block], weight * p)
            self.bounds[:, block] += weight * bounds
            self.alpha[block] += weight * alpha
            self.transmittance[block] *= 1 - alpha

    def composite(self) -> Array:
        alpha = np.minimum(self.alpha, 1)
        return _result(self.rules, self.luminance, self.p, self.bounds, alpha)


class AllLayers(_Accumulator):
    """Keeps every layer until all have come, then reduces the weighted terms in any order."""

    def _begin(self, n_pixels: int, dtype: Any) -> None:
        self.layers: list[Array] = []

    def take(self, number: int, rgba: Array) -> None:
        self.layers.append(rgba)

    def composite(self) -> Array:
        rgba = np.empty_like(self.layers[0])
        for block in _blocks(len(rgba)):
            rgba[block] = self._reduced([layer[block] for layer in self.layers])
        return rgba

    def _reduced(self, layers: list[Array]) -> Array:
        rules = self.rules
        terms = weighted(rules, rules.blending_space, layers)
        luminance = np.zeros_like(terms.alpha)
        for luminance_layer in terms.luminance:
            luminance += luminance_layer  # [R1]
        p = rules.adding_order.reduce(terms.p, rules.add, rules.add_all)
        return _result(rules, luminance, p, terms.bounds, terms.alpha)


def _blocks(n_pixels: int) -> Iterator[slice]:
    for begin in range(0, n_pixels, BLOCK_PIXELS):
        yield slice(begin, min(begin + BLOCK_PIXELS, n_pixels))


def _result(
    rules: StackRules, luminance: Array, p: Array, bounds_of_all: Array, alpha: Array
) -> Array:
    """The reduced stack over its background and exposed, as RGBA (n, 4)."""
    space = rules.blending_space
    rgba = np.empty((len(alpha), 4), alpha.dtype)
    for block in _blocks(len(alpha)):
        y_block, p_block, a_block = luminance[block], p[:, block], alpha[block]
        b_block = bounds_of_all[:, block]
        if rules.background is not None:
            colour = np.array(rules.background, alpha.dtype)[:, None]
            y_below, p_below = space.forward(colour)
            uncovered = 1 - a_block
            y_block = y_block + uncovered * y_below
            p_block = rules.add(p_block, uncovered * p_below)
            b_block = b_block + uncovered * bounds_of(space, colour, 1.0)
            a_block = np.ones_like(a_block)
        rgb = colors_within(space, y_block, p_block, b_block)
        if rules.exposure:
            rgb *= 2.0**rules.exposure
        rgba[block, :3] = rgb.T
        rgba[block, 3] = a_block
    return rgba


_ACCUMULATORS: dict[Reduction, type[_Accumulator]] = {
    Reduction.BOTTOM_UP: BottomUp,
    Reduction.FRONT_TO_BACK: FrontToBack,
    Reduction.ALL_LAYERS: AllLayers,
}
