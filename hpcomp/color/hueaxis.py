"""Hue as one number on a circle: what histograms bin and pictures show. Knows no pixels, no bins.

An axis is for display and bins alone. What counts as an equal hue is decided by the angle between
p vectors, in `addition`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..records import record

Array = NDArray[np.floating[Any]]

#: Degrees in the unit that an axis counts in, a sextant: from one primary to the next secondary.
SEXTANT_DEG = 60.0

#: The colours that name places on an axis: corners of the RGB cube, linear.
NAMED_COLORS: dict[str, tuple[float, float, float]] = {
    "red": (1, 0, 0),
    "yellow": (1, 1, 0),
    "green": (0, 1, 0),
    "cyan": (0, 1, 1),
    "blue": (0, 0, 1),
    "magenta": (1, 0, 1),
}


@record
class HueAxis:
    """A hue angle, as two maps between colours and numbers.

    `title` says on plots what the number is. `sextants`: rgb (3, …), linear, none of them grey →
    (…) in units of 60°, on any turn of the circle. `color`: degrees (…) → rgb (3, …), linear, in
    [0, 1], the most saturated colour of that hue.
    """

    title: str
    sextants: Callable[[Array], Array]
    color: Callable[[Array], Array]

    def degrees(self, rgb: Array) -> Array:
        """The hue of rgb (3, …), linear and not grey: (…), in [0, 360)."""
        hue = np.mod(self.sextants(rgb) * SEXTANT_DEG, 360.0)
        return np.where(hue == 360, 0, hue)  # what a hair below zero is rounded to

    def landmarks(self) -> dict[str, float]:
        """Where the named colours stand, in degrees."""
        return {
            name: float(self.degrees(np.array(rgb, np.float64)))
            for name, rgb in NAMED_COLORS.items()
        }


def _hexagon_sextants(rgb: Array) -> Array:
    # The operations and their order are part of the contract: the kernel has the same ones.
    red, green, blue = rgb
    largest = np.maximum(np.maximum(red, green), blue)
    chroma = largest - np.minimum(np.minimum(red, green), blue)
    in_red, in_green = largest == red, largest == green
    step = np.where(in_red, green - blue, np.where(in_green, blue - red, red - green))
    start = np.where(in_red, 0, np.where(in_green, 2, 4)).astype(rgb.dtype)
    return start + step / chroma


def _hexagon_color(degrees: Array) -> Array:
    sextants = np.mod(np.asarray(degrees, np.float64) / SEXTANT_DEG, 6)
    return np.stack(
        [
            np.clip(np.abs(sextants - 3) - 1, 0, 1),
            np.clip(2 - np.abs(sextants - 2), 0, 1),
            np.clip(2 - np.abs(sextants - 4), 0, 1),
        ]
    )


#: The hue of HSL and HSV, taken of the linear colour: one number for every half-plane that the grey
#: axis bounds. Smith: Color Gamut Transform Pairs, SIGGRAPH 1978.
HEXAGON = HueAxis("HSL hue of the linear colour", _hexagon_sextants, _hexagon_color)


#: Steps of a way around the circle of the most saturated colours, and halvings of one of them.
_AROUND, _HALVINGS = 720, 40


def angle_axis(title: str, p_of: Callable[[Array], Array]) -> HueAxis:
    """The axis of the angle of p, `p_of` rgb (3, …) being (2, …)."""

    def sextants(rgb: Array) -> Array:
        p = p_of(rgb)
        return np.arctan2(p[1], p[0]) * p.dtype.type(3 / np.pi)

    @cache
    def turn() -> tuple[Array, Array]:
        # The most saturated colours are those of the hexagon, in the same sequence. Where the angle
        # turns back for a moment, as that of Oklab does before blue, the way ahead is taken.
        around = np.linspace(0, 360, _AROUND + 1)
        angles = np.degrees(np.unwrap(np.arctan2(*p_of(_hexagon_color(around))[::-1])))
        return around, np.maximum.accumulate(angles)

    def color(degrees: Array) -> Array:
        around, angles = turn()
        wanted = angles[0] + np.mod(np.asarray(degrees, np.float64) - angles[0], 360.0)
        step = np.clip(np.searchsorted(angles, wanted, side="right"), 1, _AROUND)
        below, above = around[step - 1], around[step]
        for _ in range(_HALVINGS):
            middle = (below + above) / 2
            angle = np.degrees(np.arctan2(*p_of(_hexagon_color(middle))[::-1]))
            before = np.mod(angle - wanted + 180, 360) < 180
            below, above = np.where(before, middle, below), np.where(before, above, middle)
        return _hexagon_color((below + above) / 2)

    return HueAxis(title, sextants, color)
