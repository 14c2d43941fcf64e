"""The fused engine: every pixel from stored samples to stored samples in one pass, in C++.

Says in numbers what the rules and the decodings say in tables; the loops are in `block.cpp`, and
what they are given is checked in `module.cpp`. Fails to import where it was not built.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..blending.addition import ROUNDING_ANGLE
from ..blending.orders import ORDERS
from ..blending.porter_duff import Factor
from ..blending.rules import Reduction, StackRules
from ..color.gamut import bounds_of
from ..color.primaries import REC709, Primaries, conversion, to_xyz
from ..color.quantization import Losses
from ..color.samples import OUTPUT_TYPES, PLAIN, Decoding, Samples, Strip, cropped, linear_rgba
from ..color.spaces import Coefficients, HslCoefficients, PlaneCoefficients
from ..color.transfer import SRGB, decode_table
from ..color.uniformspaces import CielabCoefficients, OklabCoefficients, Pairs
from ..errors import unknown_name
from . import _kernel  # type: ignore[attr-defined]

NAME = "kernel"
#: Whether strips are widened to float RGBA on the way.
DECODES_IN_NUMPY = False
#: Where its `findings` are, with all that they import.
MEASURING = "hpcomp.kernel.measuring"
#: Pairs of terms of the order `simultaneous` that take it a small part of a second.
PAIRS_AT_ONCE = 1 << 24

#: Chooses an instruction set by name; the tests compare them.
LEVEL_VARIABLE = "HPCOMP_KERNEL_LEVEL"

#: The blendings in the order of their numbers in `block.h`.
_BLENDINGS = ("hue-preserving", "traditional", "foremost")

#: The numbers of the reductions in `block.h`.
_BOTTOM_UP, _FRONT_TO_BACK, _PERMUTATION, _BALANCED, _SIMULTANEOUS = range(5)


def levels() -> list[str]:
    """The instruction sets that were built and that this processor runs, the fastest last."""
    return list(_kernel.levels())


def start(rules: StackRules, width: int, height: int, dtype: Any = np.float32) -> Accumulator:
    """An empty accumulator for a strip of that size."""
    return Accumulator(rules, width, height)


def bytes_to_reduce(rules: StackRules, layers: int) -> int:
    """Memory that a strip of so many layers takes beside its samples, whatever its size."""
    if rules.reduction is not Reduction.ALL_LAYERS:
        return 0
    return int(_kernel.scratch_bytes(_order_of(rules), layers))


class Accumulator:
    """Takes the layers of one strip in `rules.arrival` order, and gives their composite."""

    def __init__(self, rules: StackRules, width: int, height: int) -> None:
        self.rules, self.shape = rules, (height, width, 4)
        self.nonfinite = [0] * len(rules.operators)
        self._decoded: set[int] = set()  # layers whose broken pixels were counted by numpy
        self._strip = _kernel.Accumulator(rules_of(rules), width, height, chosen_level())

    def add(self, numbers: Sequence[int], strips: Sequence[Strip]) -> None:
        """Layers by number; `nonfinite` counts their pixels with NaN or Inf."""
        layers = []
        for number, strip in zip(numbers, strips, strict=True):
            layer, broken = layer_of(self.rules, number, strip, self.shape[1], self.shape[0])
            layers.append(layer)
            if broken is not None:
                self.nonfinite[number] = broken
                self._decoded.add(number)
        self._count(numbers, self._strip.add(list(numbers), layers))

    def _count(self, numbers: Iterable[int], counts: Sequence[int]) -> None:
        for number, count in zip(numbers, counts, strict=False):
            if number not in self._decoded:
                self.nonfinite[number] += count

    def result(
        self, kind: str, losses: Losses, gamut: Primaries = REC709, measures: Any = None
    ) -> Samples:
        """The composite (height, width, 4), as samples of that kind; codes are of that gamut.

        `measures`: a `_kernel.Measures` to add to; all layers have been added at once.
        """
        out = np.empty(self.shape, OUTPUT_TYPES[kind])
        codes = _codes(out.dtype, self.rules.primaries, gamut)
        counts, nonfinite = self._strip.result(out, *codes, measures)
        losses.out_of_gamut += counts[0]
        losses.light_without_alpha += counts[1]
        losses.not_a_number += counts[2]
        losses.beyond_half += counts[3]
        self._count(self.rules.arrival, nonfinite)
        return out


def chosen_level() -> str:
    """The instruction set that the environment names, empty for the fastest."""
    level = os.environ.get(LEVEL_VARIABLE, "")
    if level not in ("", *levels()):
        raise unknown_name(f"instruction set in {LEVEL_VARIABLE}", level, levels())
    return level


def layer_of(
    rules: StackRules, number: int, strip: Strip, width: int, height: int
) -> tuple[Any, int | None]:
    """A layer for the loops, and how many pixels are broken where numpy had to decode it."""
    broken = None
    if not strip.decoding.is_plain(strip.samples):
        strip = cropped(strip, width, height)
        rgba, broken = linear_rgba(strip)
        strip = Strip(rgba, PLAIN, strip.left, strip.top)
    samples, decoding = strip.samples, strip.decoding
    operator = rules.operators[number]
    factors = (Factor.ONE, Factor.ZERO)
    if operator is not None:
        factors = (operator.factor_a, operator.factor_b)
    layer = _kernel.layer(
        samples,
        _table(samples, decoding),
        decoding.alpha_mode == "straight",
        _matrix(decoding.encoding.primaries, decoding.working),
        strip.left,
        strip.top,
        rules.opacities[number],
        *map(int, factors),
        operator is not None and operator.behind,
        decoding.zero_nonfinite,
    )
    return layer, broken


@lru_cache(maxsize=8)
def rules_of(rules: StackRules) -> Any:
    """The rules in numbers, for the loops."""
    n, space = len(rules.operators), rules.blending_space
    sequence = rules.order.sequence
    if rules.order is ORDERS["top-down"]:
        sequence = tuple(reversed(range(n)))
    background, background_bounds = None, [0.0, 0.0]
    if rules.background is not None:
        color = np.array(rules.background, np.float32)[:, None]
        luminance, p = space.forward(color)
        background = [float(luminance[0]), float(p[0, 0]), float(p[1, 0])]
        if not space.linear:
            background_bounds = [float(value) for value in bounds_of(space, color, 1.0)[:, 0]]
    weights, to_p, from_p, maps, numbers = _maps(space.coefficients)
    return _kernel.rules(
        _BLENDINGS.index(rules.blending.name),
        math.radians(rules.hue_tolerance),
        ROUNDING_ANGLE,
        rules.gray_bias,
        _order_of(rules),
        list(sequence),
        n,
        background,
        2.0**rules.exposure,
        list(weights),
        _flat(to_p),
        _flat(from_p),
        maps,
        numbers,
        background_bounds,
    )


def _order_of(rules: StackRules) -> int:
    match rules.reduction:
        case Reduction.BOTTOM_UP:
            return _BOTTOM_UP
        case Reduction.FRONT_TO_BACK:
            return _FRONT_TO_BACK
    if rules.order is ORDERS["balanced"]:
        return _BALANCED
    if rules.order is ORDERS["simultaneous"]:
        return _SIMULTANEOUS
    return _PERMUTATION


def _flat(*pairs: Pairs) -> list[float]:
    return [value for rows in pairs for row in rows for value in row]


def _maps(found: Coefficients) -> tuple[tuple[float, float], Pairs, Pairs, int, list[float]]:
    """The maps of a space: weights, to and from p, and by the number of `Maps` the rest."""
    none = ((0.0, 0.0),) * 3
    match found:
        case PlaneCoefficients():
            return found.weights, found.to_p, found.from_p, 0, []
        case HslCoefficients(plane):
            return plane.weights, plane.to_p, plane.from_p, 1, []
        case OklabCoefficients():
            numbers = _flat(found.to_lms, found.to_lab, found.to_roots, found.from_lms)
            return found.weights, none[:2], none, 2, [*numbers, 1 / found.largest]
        case CielabCoefficients():
            numbers = _flat(found.to_xz, found.from_xz)
            return found.weights, none[:2], none, 3, [*numbers, 1 / found.largest]


def _table(samples: Samples, decoding: Decoding) -> NDArray[np.float32] | None:
    if samples.dtype not in (np.uint8, np.uint16):
        return None  # the door refuses what is neither codes nor floats
    return decode_table(decoding.encoding.transfer, int(np.iinfo(samples.dtype).max))


@cache
def _matrix(source: Primaries, target: Primaries) -> list[float] | None:
    matrix = conversion(source, target)
    return None if matrix is None else [float(value) for value in matrix.ravel()]


#: Buckets an octave of linear light: so many that hardly one holds two thresholds.
_BUCKET_BITS = {8: 7, 16: 12}


@cache
def _codes(
    dtype: np.dtype[Any], working: Primaries = REC709, gamut: Primaries = REC709
) -> tuple[Any, ...]:
    """How linear light becomes code values: thresholds, the first code of each bucket, limits, the
    way from the working primaries to those of the codes, and the luminance weights of these.

    A code begins half a step below its value. Buckets are runs of float32 numbers, found by
    shifting their bits; from the first code of its bucket a value climbs to its own.
    """
    if dtype.kind != "u":
        return None, None, 1, [0.0, 0.0, 0.0, 0.0], None, [0.0, 0.0, 0.0]
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
    first_code = np.searchsorted(thresholds, begins, side="right").astype(np.uint16)
    half_code = 0.5 / largest
    lowest, darkest, highest = SRGB.decode(np.array([-half_code, half_code, 1 + half_code]))
    limits = [float(lowest), float(darkest), float(highest), smallest]
    return thresholds, first_code, bits, limits, _matrix(working, gamut), list(to_xyz(gamut)[1])
