"""Oklab and CIELAB as maps between linear RGB and (Y, p), for `spaces`. No other space, no pixels.

So p is of degree 1 in the colour, as weights need it, and its angle is the hue of that space.
A chromaticity is a vector q = p/Y. Planes first: rgb (3, …), p (2, …).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..records import record
from .hueaxis import HEXAGON
from .matrices import inverted, product
from .planes import length

Array = NDArray[np.floating[Any]]
#: Two coefficients of each of some sums: of the first and the last of three terms, less the middle.
Pairs = tuple[tuple[float, float], ...]
#: Three rows of three numbers.
Matrix = Sequence[Sequence[float]]

#: XYZ (D65) to cone responses, and their cube roots to L, a, b: Ottosson, A perceptual color space
#: for image processing, 2020, in the digits of the W3C's CSS Color Module Level 4, with which
#: D65 at (0.3127, 0.3290) is neutral.
XYZ_TO_LMS: Matrix = (
    (0.8190224379967030, 0.3619062600528904, -0.1288737815209879),
    (0.0329836539323885, 0.9292868615863434, 0.0361446663506424),
    (0.0481771893596242, 0.2642395317527308, 0.6335478284694309),
)
ROOTS_TO_LAB: Matrix = (
    (0.2104542683093140, 0.7936177747023054, -0.0040720430116193),
    (1.9779985324311684, -2.4285922420485799, 0.4505937096174110),
    (0.0259040424655478, 0.7827717124575296, -0.8086757549230774),
)

#: CIE 15:2018, 8.2.1: where the cube root of CIELAB becomes a line; its slope and its start.
LAB_ROOT = 6 / 29
LAB_SLOPE = 1 / (3 * LAB_ROOT**2)
LAB_START = 4 / 29

#: How far beyond the gamut a chromaticity may go, in lengths of the gamut's largest.
BEYOND_GAMUT = 2.0
#: The least luminance of (1, a/L, b/L), that of grey being 1: where it vanished, light of no
#: luminance would have a colour.
LEAST_LUMINANCE = 0.25
#: What X and Z at Y = 1 are held within, so that squares of their roots are floats.
FARTHEST_XZ = 1e15


@record
class OklabCoefficients:
    """Oklab for some primaries, in numbers.

    `weights`: of red and blue in the luminance. `to_lms`: cone responses from red and blue less
    green, beside green. `to_lab`: L, a and b from the roots l and s less m; L beside m.
    `to_roots`: l, m and s from a/L and b/L, beside 1. `from_lms`: the channels from l and s less m,
    beside m. `largest`: the bound of |p|/Y.
    """

    weights: tuple[float, float]
    to_lms: Pairs
    to_lab: Pairs
    to_roots: Pairs
    from_lms: Pairs
    largest: float = np.inf


@record
class CielabCoefficients:
    """CIELAB for some primaries, in numbers.

    `weights`: of red and blue in the luminance. `to_xz`: X and Z over those of white, from red and
    blue less green, beside green. `from_xz`: the channels at Y = 1 from X and Z over those of
    white, less 1, beside 1. `largest`: the bound of |p|/Y.
    """

    weights: tuple[float, float]
    to_xz: Pairs
    from_xz: Pairs
    largest: float = np.inf


def _of_white(m: Matrix) -> list[list[float]]:
    """Rows at the strength at which white, (1, 1, 1), gives 1."""
    return [[value / sum(row) for value in row] for row in m]


def _outer(m: Matrix) -> Pairs:
    """The first and the last of each row: the middle one follows from what the row sums to."""
    return tuple((float(row[0]), float(row[2])) for row in m)


def _sums(base: Any, first: Array, last: Array, pairs: Pairs) -> list[Array]:
    """base + a·first + b·last, for each pair (a, b)."""
    return [base + a * first + b * last for a, b in pairs]


def _luminance(rgb: Array, weights: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Y, red − green and blue − green of rgb (3, …)."""
    red, green, blue = rgb
    red_green, blue_green = red - green, blue - green
    w_red, w_blue = weights
    return green + w_red * red_green + w_blue * blue_green, red_green, blue_green


def _chromaticity(luminance: Array, p: Array, largest: float) -> Array:
    """q = p/Y, no longer than `largest`, and 0 where Y is not positive."""
    whole = np.maximum(luminance, np.hypot(p[0], p[1]) / largest)
    q = np.zeros_like(p)
    return np.divide(p, whole, out=q, where=luminance > 0)


#: Degrees of a whole turn.
_TURN = np.arange(0, 360, 0.5)


def _bound(gamut: tuple[Array, Array], least_luminance: Callable[[Array], float]) -> float:
    """The bound of |q|: beyond the gamut, and where no colour has too little luminance.

    `gamut`: Y and p of its most saturated colours. `least_luminance`: of chromaticities q (2, n).
    """
    luminance, p = gamut
    there = luminance > 0
    reach = BEYOND_GAMUT * float((length(p[:, there]) / luminance[there]).max())
    angles = np.radians(_TURN)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    if least_luminance(reach * circle) >= LEAST_LUMINANCE:
        return reach
    near, far = 0.0, reach
    for _ in range(40):
        middle = (near + far) / 2
        if least_luminance(middle * circle) >= LEAST_LUMINANCE:
            near = middle
        else:
            far = middle
    return near


# --- Oklab ----------------------------------------------------------------------------------------


def oklab_coefficients(rgb_to_xyz: Matrix) -> OklabCoefficients:
    """Those of the primaries whose RGB→XYZ this is, D65 being white."""
    lms = _of_white(product(XYZ_TO_LMS, rgb_to_xyz))
    (l_red, l_blue), *others = _outer(ROOTS_TO_LAB)
    # The digits of the last place, so that greys have no a and b.
    exact = [[l_red, 1 - l_red - l_blue, l_blue]]
    exact += [[first, -first - last, last] for first, last in others]
    unbounded = OklabCoefficients(
        weights=_outer(rgb_to_xyz)[1],
        to_lms=_outer(lms),
        to_lab=_outer(exact),
        to_roots=tuple((row[1], row[2]) for row in inverted(exact)),
        from_lms=_outer(inverted(lms)),
    )

    def least_luminance(q: Array) -> float:
        return float(_luminance(_oklab_direction(unbounded, q), unbounded.weights)[0].min())

    largest = _bound(oklab_forward(unbounded, HEXAGON.color(_TURN)), least_luminance)
    return replace(unbounded, largest=largest)


def _oklab(coefficients: OklabCoefficients, rgb: Array) -> tuple[Array, Array, Array]:
    """Y, L and (a, b) (2, …) of rgb (3, …)."""
    luminance, red_green, blue_green = _luminance(rgb, coefficients.weights)
    cones = _sums(rgb[1], red_green, blue_green, coefficients.to_lms)
    long, middle, short = (np.cbrt(cone) for cone in cones)
    long, short = long - middle, short - middle
    (lightness,) = _sums(middle, long, short, coefficients.to_lab[:1])
    return luminance, lightness, np.stack(_sums(0, long, short, coefficients.to_lab[1:]))


def oklab_chroma(coefficients: OklabCoefficients, rgb: Array) -> Array:
    """Oklab's chroma C (…) of rgb (3, …), linear: of degree 1/3 in the colour."""
    return length(_oklab(coefficients, rgb)[2])


def oklab_forward(coefficients: OklabCoefficients, rgb: Array) -> tuple[Array, Array]:
    """rgb (3, …) → Y (…), p (2, …)."""
    luminance, lightness, p = _oklab(coefficients, rgb)
    # As L vanishes, q grows to its bound and stays there: the direction is (a, b) throughout.
    whole = np.maximum(lightness, length(p) / coefficients.largest)
    there = (luminance > 0) & (whole > 0)
    p *= np.divide(luminance, whole, out=np.zeros_like(luminance), where=there)
    return luminance, p


def _oklab_direction(coefficients: OklabCoefficients, q: Array) -> Array:
    """A colour (3, …) of the chromaticity q (2, …): that of L = 1."""
    roots = _sums(1, q[0], q[1], coefficients.to_roots)
    long, middle, short = (root * root * root for root in roots)
    return np.stack(_sums(middle, long - middle, short - middle, coefficients.from_lms))


def oklab_inverse(coefficients: OklabCoefficients, luminance: Array, p: Array) -> Array:
    """Y (…), p (2, …) → rgb (3, …)."""
    rgb = _oklab_direction(coefficients, _chromaticity(luminance, p, coefficients.largest))
    rgb *= luminance / _luminance(rgb, coefficients.weights)[0]
    return rgb


# --- CIELAB ---------------------------------------------------------------------------------------


def cielab_coefficients(rgb_to_xyz: Matrix) -> CielabCoefficients:
    """Those of the primaries whose RGB→XYZ this is, D65 being white."""
    xyz = _of_white(rgb_to_xyz)
    xz = _outer(xyz)
    unbounded = CielabCoefficients(
        weights=_outer(rgb_to_xyz)[1],
        to_xz=(xz[0], xz[2]),
        from_xz=_outer(inverted(xyz)),
    )
    largest = _bound(cielab_forward(unbounded, HEXAGON.color(_TURN)), lambda q: 1.0)
    return replace(unbounded, largest=largest)


def cielab_forward(coefficients: CielabCoefficients, rgb: Array) -> tuple[Array, Array]:
    """rgb (3, …) → Y (…), p (2, …)."""
    luminance, red_green, blue_green = _luminance(rgb, coefficients.weights)
    there = luminance > 0

    def root(of_white: Array) -> Array:
        share = np.divide(of_white, luminance, out=np.ones_like(luminance), where=there)
        share = np.clip(share, -FARTHEST_XZ, FARTHEST_XZ)
        return np.where(share > LAB_ROOT**3, np.cbrt(share), LAB_SLOPE * share + LAB_START)

    x, z = (root(share) for share in _sums(rgb[1], red_green, blue_green, coefficients.to_xz))
    # a/L = 500 (f(X) − f(Y)) / 100 and b/L = 200 (f(Y) − f(Z)) / 100, and f(Y) is 1.
    p = np.stack([5 * (x - 1), 2 * (1 - z)])
    p *= np.where(there, luminance, 0) / np.maximum(1, length(p) / coefficients.largest)
    return luminance, p


def cielab_inverse(coefficients: CielabCoefficients, luminance: Array, p: Array) -> Array:
    """Y (…), p (2, …) → rgb (3, …)."""
    q = _chromaticity(luminance, p, coefficients.largest)

    def cubed(root: Array) -> Array:
        return np.where(root > LAB_ROOT, root * root * root, (root - LAB_START) / LAB_SLOPE)

    x, z = cubed(1 + q[0] / 5), cubed(1 - q[1] / 2)
    return np.stack(_sums(1, x - 1, z - 1, coefficients.from_xz)) * luminance
