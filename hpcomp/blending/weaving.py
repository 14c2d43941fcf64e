"""Woven blending: each pixel has the hue of one of its terms, and a pattern decides whose.

Each hue appears as often as its share of the strength; so from afar a woven picture is the ordinary
blend, and from near every label is pure. Here are the patterns on the canvas, and what is kept of
the terms of a pixel. Bringing colours into gamut is `color.gamut`'s matter.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color.planes import cross_and_dot, ratio
from ..errors import SettingError, unknown_name
from ..geometry import Window
from ..records import record
from .addition import ROUNDING_ANGLE, chroma, competing

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.integer[Any]]
Float64 = NDArray[np.float64]

DEFAULT_WEAVE_SIZE = 8
#: The least and the largest size of a pattern, in pixels.
WEAVE_SIZES = 2, 1024

#: By what share of a step neighbouring stripes are shifted: the golden section, so that no share
#: falls between the steps of all of them.
STRIPE_SHIFT = 0.618034
#: A permutation of its cells' numbers, made by `tests/support/bluenoise.py`.
TILE_PATH = os.path.join(os.path.dirname(__file__), "bluenoise.npy")

#: The largest phase below 1 that is a float32.
LARGEST_PHASE = 1 - 2.0**-24


@cache
def noise_tile() -> NDArray[np.uint16]:
    """The blue-noise tile, (side, side): each number from 0 to side² − 1 once."""
    tile: NDArray[np.uint16] = np.load(TILE_PATH)
    return tile


def _stripes(x: Ints, y: Ints, size: int) -> Float64:
    """Diagonal stripes of `size` steps, each stripe shifted within a step."""
    stripe, step = np.divmod(x + y, size)
    shift = STRIPE_SHIFT * stripe + 0.5
    return np.asarray((step + (shift - np.floor(shift))) / size)


def _noise(x: Ints, y: Ints, size: int) -> Float64:
    """Cells of `size` pixels, each with a threshold of the tile."""
    tile = noise_tile()
    side = len(tile)
    return np.asarray((tile[y // size % side, x // size % side] + 0.5) / tile.size)


@record
class Pattern:
    """One row of the table: a phase in [0, 1) for each pixel, from x, y and a size."""

    name: str
    phase: Callable[[Ints, Ints, int], Float64]


PATTERNS: dict[str, Pattern] = {
    row.name: row for row in (Pattern("stripes", _stripes), Pattern("noise", _noise))
}


def check_weave_size(size: int) -> int:
    """The size; `SettingError` for what is not a whole number within `WEAVE_SIZES`."""
    least, largest = WEAVE_SIZES
    try:
        whole = operator.index(size)
    except TypeError:
        whole = least - 1
    if not least <= whole <= largest:
        raise SettingError(f"weave size {size} is not a whole number from {least} to {largest}")
    return whole


@record
class Weave:
    """A pattern of one size, in pixels."""

    pattern: Pattern
    size: int

    @staticmethod
    def of(name: str, size: int) -> Weave:
        """Errors: `SettingError` for a name and for a size."""
        if name not in PATTERNS:
            raise unknown_name("weave", name, PATTERNS)
        return Weave(PATTERNS[name], check_weave_size(size))

    def __str__(self) -> str:
        return f"{self.pattern.name} of {self.size} pixels"

    def phases(self, x: Ints, y: Ints) -> NDArray[np.float32]:
        """u (…) in [0, 1) of pixels, counted from the corner of the canvas."""
        return np.minimum(self.pattern.phase(x, y, self.size), LARGEST_PHASE).astype(np.float32)

    def phases_in(self, window: Window) -> NDArray[np.float32]:
        """Those of the pixels of a window, row by row."""
        row, column = np.divmod(np.arange(window.pixels), window.width)
        return self.phases(column + window.x, row + window.y)


@record
class Threads:
    """Which of many terms gives the hue at which phase.

    `m` (n, …): strengths, 0 of what is no thread. `order` (n, …): the terms' numbers, sorted by
    hue, equal ones by number; `reached` (n, …): their strengths in that order, added up.
    """

    m: Array
    order: Ints
    reached: Array

    @staticmethod
    def of(p: Array, strengths: Array | None) -> Threads:
        """p (n, 2, …), m (n, …), None where that is |p|."""
        m = np.where(chroma(p.swapaxes(0, 1)) > 0, competing(p, strengths), 0)
        order = np.argsort(np.arctan2(p[:, 1] + 0, p[:, 0]), axis=0, kind="stable")  # no -0
        return Threads(m, order, np.cumsum(np.take_along_axis(m, order, axis=0), axis=0))

    @property
    def whole(self) -> Array:
        """M (…), the strength of all."""
        return np.asarray(self.reached[-1])

    @property
    def shares(self) -> Array:
        """(n, …) in [0, 1]: of how many phases each term is the thread."""
        return ratio(self.m, self.whole)

    def at(self, phase: Array) -> Ints:
        """The number (…) of the term that is the thread there."""
        passed = self.reached > phase.astype(self.m.dtype) * self.whole
        passed[-1] = True
        first = passed.argmax(axis=0)[None]
        return np.asarray(np.take_along_axis(self.order, first, axis=0)[0])

    def middles(self) -> Array:
        """(n, …): a phase at which each term is the thread, of those that are one."""
        in_order = np.take_along_axis(self.m, self.order, axis=0)
        middles = np.empty_like(self.m)
        middle = ratio(self.reached - in_order / 2, self.whole)
        np.put_along_axis(middles, self.order, middle, axis=0)
        return middles


def keep_thread(
    p: Array,
    hue_tolerance: float,
    gray_bias: float,
    strengths: Array | None,
    phase: Array | None,
) -> Array:
    """What is kept of each of many chroma vectors where one of them gives the hue: (n, …) ≥ 0.

    p (n, 2, …), phases u (…) in [0, 1). Terms are sorted by hue, equal ones by number, and the
    first counts with which the sum of strengths is above u times that of all. It stands for the
    strength of all, which takes more of it than there is: factors go beyond 1. Hues that rounding
    alone tells apart are one. Where there is no other hue all is kept. Tolerance and bias have no
    part in it.
    """
    assert phase is not None
    size = chroma(p.swapaxes(0, 1))
    threads = Threads.of(p, strengths)
    m, whole = threads.m, threads.whole
    thread = threads.at(phase)[None]
    p_thread = np.take_along_axis(p, thread[:, None], axis=0)[0]
    own = one_hue(p_thread, p.swapaxes(0, 1)) & (size > 0)
    amount = np.where(own, size, 0).sum(axis=0) * ratio(whole, np.where(own, m, 0).sum(axis=0))
    kept = np.zeros_like(m)
    factor = ratio(amount, chroma(p_thread))
    np.put_along_axis(kept, thread, factor[None], axis=0)
    alone = (own | (size == 0)).all(axis=0) | ~np.isfinite(whole) | (whole == 0)
    return np.where(alone, 1, kept)


def one_hue(p1: Array, p2: Array) -> NDArray[np.bool_]:
    """Whether two hues are one but for rounding: p (2, …)."""
    cross, dot = cross_and_dot(p1[:, None], p2)
    return (dot > 0) & (cross <= ROUNDING_ANGLE * dot)
