"""The reference engine: the paper in numpy, for reading and checking; runs without a compiler.

Works in blocks of pixels, so that temporaries stay in cache. Planes first: Y (n), p (2, n), α (n).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import bytes_to_keep
from ..blending.orders import ORDERS
from ..blending.rules import Chroma, Reduction, StackRules
from ..blending.terms import (
    Term,
    background_term,
    color_of,
    layer_term,
    sum_of,
    sum_of_many,
    term_of,
    weighted,
)
from ..color.primaries import REC709, Primaries
from ..color.quantization import Losses
from ..color.samples import Samples, Strip, cropped, encode, linear_rgba, spread

if TYPE_CHECKING:  # only reports need them
    from ..measures.histogram import HueHistogram
    from ..measures.labels import Provenance
    from ..measures.summary import StackSummary, StripToMeasure

Array = NDArray[np.floating[Any]]
Counts = NDArray[np.int64]
Float64 = NDArray[np.float64]

#: Pixels that are composited at a time, so that a few planes of them stay in the L2 cache.
BLOCK_PIXELS = 16_384


class ReferenceEngine:
    """The contract's `Engine` in numpy; float64 goes through in float64."""

    name = "reference"
    decodes_in_numpy = True
    pairs_at_once = 1 << 17

    def start(
        self,
        rules: StackRules,
        width: int,
        height: int,
        dtype: Any = np.float32,
        origin: tuple[int, int] = (0, 0),
        phases: NDArray[np.float32] | None = None,
    ) -> _Accumulator:
        """An empty accumulator for a strip of that size, of the kind that the rules need."""
        return _ACCUMULATORS[rules.reduction](rules, width, height, dtype, origin, phases)

    def bytes_to_reduce(self, rules: StackRules, layers: int) -> int:
        """What adding all terms of one pixel at once takes; those of a block take no more."""
        if rules.reduction is not Reduction.ALL_LAYERS or rules.order is not ORDERS["simultaneous"]:
            return 0
        return bytes_to_keep(layers)

    def keep_runs(
        self, rules: StackRules, counts: Counts, p: Float64, strengths: Float64 | None
    ) -> Float64:
        """What is kept of each of runs of chroma vectors, added at once: p (2, n), m (n) → (n)."""
        kept = np.ones(p.shape[1])
        ends = np.cumsum(counts)
        for begin, end in zip(ends - counts, ends, strict=True):
            if begin < end:
                m = None if strengths is None else strengths[begin:end, None]
                terms = Chroma(p[:, begin:end].T[..., None], m)
                kept[begin:end] = rules.keep_of_many(terms)[:, 0]
        return kept

    def bytes_to_keep(self, terms: int) -> int:
        """Memory that `keep_runs` takes beside p for a run of so many."""
        return bytes_to_keep(terms)

    def measures(self, rules: StackRules) -> bool:
        """It measures in every space."""
        return True

    def hues(self, strip: Strip, like: HueHistogram) -> HueHistogram | None:
        """It has no loops of its own."""
        return None

    def summary(self, strip: StripToMeasure) -> tuple[StackSummary, Provenance | None]:
        """The summary of a strip, and its provenance planes (height, width) where wanted."""
        from ..measures.summary import summary_of

        layers = []
        for layer in strip.strips:
            inside = cropped(layer, strip.width, strip.height)
            rgba, _ = linear_rgba(inside)
            placed = spread(rgba, inside.left, inside.top, strip.width, strip.height)
            layers.append(placed.reshape(strip.height, strip.width, 4))
        summary, provenance = summary_of(
            strip.rules, strip.settings, layers, strip.bins, strip.origin, strip.squares
        )
        return summary, provenance if strip.with_provenance else None


ENGINE = ReferenceEngine()


class _Accumulator(ABC):
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite."""

    def __init__(
        self,
        rules: StackRules,
        width: int,
        height: int,
        dtype: Any,
        origin: tuple[int, int],
        phases: NDArray[np.float32] | None,
    ) -> None:
        self.rules, self.width, self.height = rules, width, height
        self._origin, self._phases = origin, phases
        self.nonfinite = [0] * len(rules.operators)
        self._begin(width * height, dtype)

    def add(self, numbers: Sequence[int], strips: Sequence[Strip]) -> None:
        """Layers by number; `nonfinite` counts their pixels with NaN or Inf."""
        for number, strip in zip(numbers, strips, strict=True):
            everywhere = number in self.rules.needed_everywhere
            inside = cropped(strip, self.width, self.height)
            if not inside.samples.size and not everywhere:
                continue
            rgba, self.nonfinite[number] = linear_rgba(inside)
            pixels = _Pixels.of(inside, self.width)
            if everywhere:
                rgba = spread(rgba, inside.left, inside.top, self.width, self.height)
                pixels = _Pixels(0)
            with np.errstate(all="ignore"):  # NaN and Inf may have been let through
                self.take(number, rgba.reshape(-1, 4), pixels)

    def result(self, kind: str, losses: Losses, gamut: Primaries = REC709) -> Samples:
        """The composite (height, width, 4) as samples of a kind of `OUTPUT_TYPES`, or float64.

        Codes are of that gamut, floats in the working primaries.
        """
        with np.errstate(all="ignore"):
            rgba = self.composite().reshape(self.height, self.width, 4)
            return encode(rgba, kind, losses, self.rules.primaries, gamut, self.rules.space.name)

    def result_and_summary(
        self, kind: str, losses: Losses, gamut: Primaries, strip: StripToMeasure
    ) -> tuple[Samples, StackSummary, Provenance | None]:
        """The samples of the accumulated strip, and its summary."""
        return self.result(kind, losses, gamut), *ENGINE.summary(strip)

    def term(self, number: int, rgba: Array) -> tuple[Term, Array]:
        """As `terms.layer_term`, of layer `number`."""
        return layer_term(self.rules, self.rules.opacities[number], rgba)

    def phases(self, block: slice) -> Array:
        """Those of the weave in pixels of the strip."""
        if self._phases is not None:
            return self._phases[block]
        x, y = self._origin
        row, column = np.divmod(np.arange(block.start, block.stop), self.width)
        return self.rules.weave.phases(column + x, row + y)

    def _no_light(self, n_pixels: int, dtype: Any) -> Term:
        """Planes of the colour of no layer at all."""
        return term_of(self.rules, np.zeros((3, n_pixels), dtype), 0.0)

    @abstractmethod
    def _begin(self, n_pixels: int, dtype: Any) -> None: ...

    @abstractmethod
    def take(self, number: int, rgba: Array, pixels: _Pixels) -> None:
        """Layer `number` in some pixels: (n, 4), linear, premultiplied, alpha in [0, 1].

        Elsewhere it changes nothing.
        """

    @abstractmethod
    def composite(self) -> Array:
        """The composite: (n_pixels, 4), linear, premultiplied."""


class BottomUp(_Accumulator):
    """Folds layers from the bottom: c ← F_A c_i ⊕ F_B c, the operators taken literally."""

    def _begin(self, n_pixels: int, dtype: Any) -> None:
        self.below, self.alpha = self._no_light(n_pixels, dtype), np.zeros(n_pixels, dtype)

    def take(self, number: int, rgba: Array, pixels: _Pixels) -> None:
        operator = self.rules.operators[number]
        for block in _blocks(len(rgba)):
            here = pixels.part(block)
            term, alpha = self.term(number, rgba[block])
            if operator is not None:
                alpha_below = self.alpha[here]
                f_a, f_b = operator.factors(alpha, alpha_below)
                both = term.weighted(f_a), self.below.part(here).weighted(f_b)
                term = sum_of(self.rules, *operator.front_first(*both))  # Eq. 2 with ⊕
                alpha = operator.alpha(alpha, alpha_below)
            self.below.put(here, term)
            self.alpha[here] = alpha

    def composite(self) -> Array:
        return _result(self.rules, self.below, self.alpha)


class FrontToBack(_Accumulator):
    """Folds layers from the top, all `over`: beside them only the transmittance is kept."""

    def _begin(self, n_pixels: int, dtype: Any) -> None:
        self.above, self.alpha = self._no_light(n_pixels, dtype), np.zeros(n_pixels, dtype)
        self.transmittance = np.ones(n_pixels, dtype)

    def take(self, number: int, rgba: Array, pixels: _Pixels) -> None:
        for block in _blocks(len(rgba)):
            here = pixels.part(block)
            term, alpha = self.term(number, rgba[block])
            weight = self.transmittance[here]
            both = sum_of(self.rules, self.above.part(here), term.weighted(weight))
            self.above.put(here, both)
            self.alpha[here] += weight * alpha
            self.transmittance[here] *= 1 - alpha

    def composite(self) -> Array:
        return _result(self.rules, self.above, np.minimum(self.alpha, 1))


class AllLayers(_Accumulator):
    """Keeps every layer until all have come, then reduces the weighted terms in any order."""

    def _begin(self, n_pixels: int, dtype: Any) -> None:
        self.n_pixels = n_pixels
        self.layers: dict[int, tuple[Array, _Pixels]] = {}

    def take(self, number: int, rgba: Array, pixels: _Pixels) -> None:
        self.layers[number] = rgba, pixels

    def composite(self) -> Array:
        bottom, _ = self.layers[0]
        rgba = np.empty((self.n_pixels, 4), bottom.dtype)
        for block in _blocks(self.n_pixels):
            rgba[block] = self._reduced(block)
        return rgba

    def _reduced(self, block: slice) -> Array:
        """The composite of a block, of the layers that have pixels there."""
        layers = {}
        for number, (rgba, pixels) in self.layers.items():
            where, turns = pixels.within(block, len(rgba))
            if turns.start < turns.stop:
                layers[number] = _spread_over(block, rgba[turns], where)
        rules = self.rules.of_layers(list(layers))
        stack = weighted(rules, list(layers.values()))
        terms: list[Term | None] = [None] * len(self.rules.operators)
        for number, term in zip(layers, stack.terms, strict=True):
            terms[number] = term
        phase = None
        if rules.blending.depends_on_place:
            phase = self.phases(block)
            if rules.background is not None:
                terms.append(background_term(rules, stack.alpha))
        reduced = self.rules.adding_order.reduce(
            terms,
            lambda a, b: b if a is None else a if b is None else sum_of(rules, a, b),
            lambda terms: sum_of_many(rules, [t for t in terms if t is not None], phase),
        )
        return _result(rules, reduced, stack.alpha)


@dataclass(frozen=True)
class _Pixels:
    """Which pixels of a strip, counted by rows: those from `first` on, or those of `index`.

    `index` rises.
    """

    first: int
    index: NDArray[np.intp] | None = None

    @classmethod
    def of(cls, inside: Strip, width: int) -> _Pixels:
        """Those of a layer that lies inside of a strip of that width."""
        rows, columns = inside.samples.shape[:2]
        first = inside.top * width + inside.left
        if columns == width:
            return cls(first)
        row, column = np.arange(rows)[:, None], np.arange(columns)
        return cls(first, (first + row * width + column).reshape(-1))

    def part(self, block: slice) -> slice | NDArray[np.intp]:
        """Some of them, by their turn, as an index into planes of the strip."""
        if self.index is not None:
            return self.index[block]
        return slice(self.first + block.start, self.first + block.stop)

    def within(self, block: slice, count: int) -> tuple[slice | NDArray[np.intp], slice]:
        """Where in a block of the strip those of `count` are that lie there, and their turns."""
        if self.index is not None:
            begin, end = np.searchsorted(self.index, (block.start, block.stop)).tolist()
            return self.index[begin:end] - block.start, slice(begin, end)
        begin = max(block.start - self.first, 0)
        end = min(block.stop - self.first, count)
        return slice(self.first + begin - block.start, self.first + end - block.start), slice(
            begin, end
        )


def _spread_over(block: slice, rgba: Array, where: slice | NDArray[np.intp]) -> Array:
    """(n, 4): pixels at their place in a block, transparent elsewhere."""
    n = block.stop - block.start
    if len(rgba) == n:
        return rgba
    whole = np.zeros((n, 4), rgba.dtype)
    whole[where] = rgba
    return whole


def _blocks(n_pixels: int) -> Iterator[slice]:
    for begin in range(0, n_pixels, BLOCK_PIXELS):
        yield slice(begin, min(begin + BLOCK_PIXELS, n_pixels))


def _result(rules: StackRules, stack: Term, alpha: Array) -> Array:
    """The reduced stack over its background and exposed, as RGBA (n, 4).

    What adds all at once holds its background already.
    """
    space = rules.blending_space
    rgba = np.empty((len(alpha), 4), alpha.dtype)
    for block in _blocks(len(alpha)):
        term, a_block = stack.part(block), alpha[block]
        if rules.background is not None:
            if not rules.blending.depends_on_place:
                term = sum_of(rules, term, background_term(rules, a_block))
            a_block = np.ones_like(a_block)
        rgb = color_of(space, term)
        if rules.exposure:
            rgb = rgb * 2.0**rules.exposure
        rgba[block, :3] = rgb.T
        rgba[block, 3] = a_block
    return rgba


_ACCUMULATORS: dict[Reduction, type[_Accumulator]] = {
    Reduction.BOTTOM_UP: BottomUp,
    Reduction.FRONT_TO_BACK: FrontToBack,
    Reduction.ALL_LAYERS: AllLayers,
}
