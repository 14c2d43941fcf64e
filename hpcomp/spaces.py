"""Blending spaces: linear RGB to (Y, p) and back. What ⊕ does with p lives in `addition`.

`Y` is the linear luminance and `p` the two chroma coordinates of a colour: its difference vector to
the grey axis at the same luminance. The angle of p is the hue, its length the chroma.
Arrays are planes first: `rgb` is (3, …), `p` is (2, …), so that each component is contiguous.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import unknown_name
from .hueaxis import HEXAGON, HueAxis

Array = NDArray[np.floating[Any]]

#: Luminance of the linear Rec. 709 primaries: the Y row of RGB→XYZ for the chromaticities of
#: ITU-R BT.709 with D65 at (0.3127, 0.3290), here to 16 digits.
REC709_WEIGHTS: tuple[float, float, float] = (
    0.21263900587151036,
    0.7151686787677559,
    0.07219231536073371,
)

#: Rec. ITU-R BT.709-6, item 1.3: (x, y) of the primaries red, green and blue, and of white, D65.
REC709_CHROMATICITIES: tuple[tuple[float, float], ...] = ((0.64, 0.33), (0.3, 0.6), (0.15, 0.06))
D65: tuple[float, float] = (0.3127, 0.3290)


@dataclass(frozen=True)
class PlaneCoefficients:
    """A space whose maps are linear, as numbers: what the fused engine needs of it.

    `weights`: of red and blue in the luminance. `to_p` (2, 2): p from red − green and blue − green.
    `from_p` (3, 2): what p adds to each channel.
    """

    weights: tuple[float, float]
    to_p: tuple[tuple[float, float], ...]
    from_p: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Space:
    """A blending space: two maps between linear premultiplied RGB and (Y, p), of degree 1.

    `forward`: rgb (3, …), linear, unbounded → Y (…), p (2, …).
    `inverse`: Y (…), p (2, …) → rgb (3, …).
    `hue_axis`: the number that reports give to a hue.
    Greys have p = 0 exactly, and p = 0 gives a grey exactly.
    """

    name: str
    forward: Callable[[Array], tuple[Array, Array]]
    inverse: Callable[[Array, Array], Array]
    coefficients: PlaneCoefficients
    hue_axis: HueAxis = HEXAGON


def _plane_basis(weights: tuple[float, float, float]) -> NDArray[np.float64]:
    """(2, 3): an orthonormal basis of the plane w·d = 0, its first axis towards red."""
    w = np.array(weights)
    to_red = np.array([1.0, 0.0, 0.0]) - w[0]
    first = to_red / np.linalg.norm(to_red)
    second = np.cross(w / np.linalg.norm(w), first)
    return np.stack([first, second])


def linear_rgb(weights: tuple[float, float, float] = REC709_WEIGHTS) -> Space:
    """The paper's space: difference vectors to the grey axis in linear RGB.

    `weights`: luminance of the three primaries, summing to 1. Chuang et al. 2009, §4.
    """
    basis = _plane_basis(weights)
    # The columns of basis · (I − 1 wᵀ) sum to zero, as do those of d: two differences to green
    # carry all of p, and a grey gives exactly zero whatever its rounding.
    columns = basis - basis.sum(axis=1, keepdims=True) * np.array(weights)
    found = PlaneCoefficients(
        weights=(float(weights[0]), float(weights[2])),
        to_p=tuple((float(row[0]), float(row[2])) for row in columns),
        from_p=tuple((float(column[0]), float(column[1])) for column in basis.T),
    )

    return _linear("linear-rgb", found)


def xyz(
    weights: tuple[float, float, float] = REC709_WEIGHTS,
    chromaticities: tuple[tuple[float, float], ...] = REC709_CHROMATICITIES,
    white: tuple[float, float] = D65,
) -> Space:
    """CIE XYZ: p is what X and Z differ by from the grey of the same luminance.

    `weights`: luminance of the primaries. `chromaticities`, `white`: their (x, y). The hues lie in
    the same half-planes as in `linear_rgb`, the angles between them and |p| differ. CIE 15:2018.
    """

    def of_luminance(xy: tuple[float, float]) -> NDArray[np.float64]:
        x, y = xy
        return np.array([x / y, (1 - x - y) / y])  # X and Z of the chromaticity at Y = 1

    to_p = [
        [weights[i] * float(of_luminance(chromaticities[i])[row] - of_luminance(white)[row])
         for i in (0, 2)]
        for row in (0, 1)
    ]  # fmt: skip
    (red_x, blue_x), (red_z, blue_z) = to_p
    determinant = red_x * blue_z - blue_x * red_z
    # What p is in differences to green, and these in channels at Y = 0.
    red_green = np.array([blue_z, -blue_x]) / determinant
    blue_green = np.array([-red_z, red_x]) / determinant
    green = -(weights[0] * red_green + weights[2] * blue_green)
    columns = (green + red_green, green, green + blue_green)
    found = PlaneCoefficients(
        weights=(weights[0], weights[2]),
        to_p=tuple((red, blue) for red, blue in to_p),
        from_p=tuple((float(column[0]), float(column[1])) for column in columns),
    )
    return _linear("xyz", found)


def _linear(name: str, found: PlaneCoefficients) -> Space:
    """The space of these coefficients."""

    def forward(rgb: Array) -> tuple[Array, Array]:
        red, green, blue = rgb
        red_green, blue_green = red - green, blue - green
        w_red, w_blue = found.weights
        luminance = green + w_red * red_green + w_blue * blue_green
        p = np.empty((2, *rgb.shape[1:]), rgb.dtype)
        for axis, (of_red, of_blue) in enumerate(found.to_p):
            np.multiply(red_green, of_red, out=p[axis])
            p[axis] += blue_green * of_blue
        return luminance, p

    def inverse(luminance: Array, p: Array) -> Array:
        rgb = np.empty((3, *p.shape[1:]), p.dtype)
        for channel, (of_p0, of_p1) in enumerate(found.from_p):
            np.multiply(p[0], of_p0, out=rgb[channel])
            rgb[channel] += p[1] * of_p1
            rgb[channel] += luminance
        return rgb

    return Space(name, forward, inverse, found)


SPACES: dict[str, Space] = {row.name: row for row in (linear_rgb(), xyz())}


def space(name: str) -> Space:
    """The blending space of that name; `SettingError` lists the valid ones."""
    try:
        return SPACES[name]
    except KeyError:
        raise unknown_name("blending space", name, SPACES) from None
