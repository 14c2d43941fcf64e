"""Ramps of hues that cross the hue of another layer: ⊕ makes vivid rings of them, grey beside.

Within the hue tolerance two colours add up, beyond twice the tolerance they cancel. Between flat
labels that is a choice; where hues change step by step, as in photographs and colormaps, it is an
edge that no layer has. Only the two strongest contributors of a pixel are looked at. No files here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from ..blending.blendings import BLENDINGS
from ..blending.rules import StackRules
from ..color.planes import cross_and_dot, length
from ..color.spaces import Space
from .labels import Contributors, share

#: How far two hues are apart, in tolerances, at the end of each zone: in the first they add up, in
#: the next two, the shoulder, they do so in part, and in the last they cancel.
_ZONES = (1.0, 1.5, 2.0)

#: Of a larger tolerance, in degrees, the shoulder is too wide to be seen as an edge.
LARGEST_TOLERANCE = 10.0
#: The share of the |p| of a pure colour that both have to have: cancelling less is not seen, and
#: rounding to 8 bits turns the hue of less by more than the tolerance.
LEAST_CHROMA = 0.02

#: A ramp is in all three zones, each with this share of the pixels in them. Flat labels are in one,
#: and what rounding moves into the next are the tails.
LEAST_OF_ZONES = 0.1
#: Each zone also has this part of what it has of a ramp through all hues at a steady pace, and so
#: many pixels: where flat labels end, smooth edges have all hues between two labels, in few pixels.
LEAST_OF_ALL_HUES, FEWEST_PIXELS = 0.4, 16

#: Pixels in which two contributors are the strongest: how many for (lower, upper, zone).
Meetings = Counter[tuple[int, int, int]]


@dataclass(frozen=True)
class Ramp:
    """Two contributors, by number, the lower one first, of which one has a ramp across the other.

    `pixels`: in which they meet as the strongest two. `vivid`: those of them within the tolerance.
    """

    lower: int
    upper: int
    pixels: int
    vivid: int

    @property
    def vivid_share(self) -> float:
        """The share of these pixels in which the two add up."""
        return share(self.vivid, self.pixels)


def meetings(terms: Contributors, rules: StackRules) -> Meetings:
    """How far apart the hues of the two strongest contributors are, pixel by pixel, counted.

    Nothing is counted where the rules make no edge: by another blending than ⊕, at a tolerance of 0
    and beyond `LARGEST_TOLERANCE`.
    """
    found = Meetings()
    by_hue = rules.blending is BLENDINGS["hue-preserving"]
    if not (by_hue and 0 < rules.hue_tolerance <= LARGEST_TOLERANCE and len(terms.size) > 1):
        return found
    least = LEAST_CHROMA * _pure_chroma(rules.space)
    met = np.flatnonzero(np.count_nonzero(terms.size > least, axis=0) > 1)
    size, pixels = terms.size[:, met], np.arange(len(met))
    first = size.argmax(axis=0)
    size[first, pixels] = 0
    second = size.argmax(axis=0)
    cross, dot = cross_and_dot(terms.p[first, :, met].T, terms.p[second, :, met].T)
    apart = np.degrees(np.arctan2(cross, dot)) / rules.hue_tolerance
    shape = len(terms.size), len(terms.size), len(_ZONES) + 1
    kinds = np.ravel_multi_index(
        (np.minimum(first, second), np.maximum(first, second), np.searchsorted(_ZONES, apart)),
        shape,
    )
    counts = np.bincount(kinds)
    for kind in np.flatnonzero(counts):
        lower, upper, zone = map(int, np.unravel_index(kind, shape))
        found[lower, upper, zone] = int(counts[kind])
    return found


@lru_cache
def _pure_chroma(space: Space) -> float:
    """The mean |p| of the six pure colours, whose scale is each space's own."""
    colors = [rgb for rgb in product((0.0, 1.0), repeat=3) if len(set(rgb)) > 1]
    return float(length(space.forward(np.array(colors).T)[1]).mean())


def ramps(counted: Meetings, hue_tolerance: float) -> Iterator[Ramp]:
    """The pairs of which one has a ramp of hues that crosses the other's, the lowest first.

    `hue_tolerance`: in degrees, that of the `counted` meetings.
    """
    steady = 2 * hue_tolerance * (_ZONES[-1] - _ZONES[-2]) / 360
    for lower, upper in sorted({(lower, upper) for lower, upper, _ in counted}):
        *zones, beyond = (counted[lower, upper, zone] for zone in range(len(_ZONES) + 1))
        near = sum(zones)
        pixels = near + beyond
        least = max(LEAST_OF_ZONES * near, LEAST_OF_ALL_HUES * steady * pixels, FEWEST_PIXELS)
        if min(zones) >= least:
            yield Ramp(lower, upper, pixels, zones[0])
