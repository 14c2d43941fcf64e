"""Blending spaces: linear RGB to (Y, p) and back. What ⊕ does with p lives in `addition`.

`Y` is the linear luminance and `p` the two chroma coordinates of a colour: its difference vector to
the grey axis at the same luminance. The angle of p is the hue, its length the chroma.
Arrays are planes first: `rgb` is (3, …), `p` is (2, …), so that each component is contiguous.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import unknown_name
from ..records import record
from .hueaxis import HEXAGON, HueAxis, angle_axis
from .matrices import Matrix
from .planes import ratio, spread_and_size
from .primaries import D65, REC709_TO_XYZ
from .uniformspaces import (
    CielabCoefficients,
    OklabCoefficients,
    cielab_coefficients,
    cielab_forward,
    cielab_inverse,
    oklab_coefficients,
    oklab_forward,
    oklab_inverse,
)

Array = NDArray[np.floating[Any]]


@record
class PlaneCoefficients:
    """A space whose maps are linear, as numbers: what the fused engine needs of it.

    `weights`: of red and blue in the luminance. `to_p` (2, 2): p from red − green and blue − green.
    `from_p` (3, 2): what p adds to each channel.
    """

    weights: tuple[float, float]
    to_p: tuple[tuple[float, float], ...]
    from_p: tuple[tuple[float, float], ...]


@record
class HslCoefficients:
    """HSL as numbers: p has the direction that `plane` gives it, and another length."""

    plane: PlaneCoefficients


#: What the fused engine needs of a space: one type for each kind of maps.
Coefficients = PlaneCoefficients | HslCoefficients | OklabCoefficients | CielabCoefficients


@record
class Space:
    """A blending space: two maps between linear premultiplied RGB and (Y, p), of degree 1.

    `forward`: rgb (3, …), linear, unbounded → Y (…), p (2, …).
    `inverse`: Y (…), p (2, …) → rgb (3, …).
    `coefficients`: the same as numbers. `rgb_to_xyz`: of the primaries, white being D65.
    `hue_axis`: the number that reports give to a hue. `gamut_slack`: by how many luminances of a
    colour curves of one hue go below black and above white before they end inside. `gamut_turn`:
    the degrees between p vectors that the way back into gamut turns a hue by at most, on the way to
    a file of Rec. 709 too: tried from Rec. 709 to ACEScg, with colours that have no negative
    channel.
    Greys have p = 0 exactly, and p = 0 gives a grey exactly.
    """

    name: str
    rgb_to_xyz: Matrix = field(repr=False)
    forward: Callable[[Array], tuple[Array, Array]] = field(repr=False)
    inverse: Callable[[Array, Array], Array] = field(repr=False)
    coefficients: Coefficients = field(repr=False)
    hue_axis: HueAxis = field(default=HEXAGON, repr=False)
    gamut_slack: tuple[float, float] = (0.0, 0.0)
    gamut_turn: float = 0.0

    @property
    def linear(self) -> bool:
        """Whether the maps are: then + of p is + of colours, and ⊕ stays in gamut by itself."""
        return isinstance(self.coefficients, PlaneCoefficients)

    @property
    def straight(self) -> bool:
        """Whether colours of one hue and luminance lie on a line in RGB."""
        return isinstance(self.coefficients, PlaneCoefficients | HslCoefficients)


#: Gamut slacks, in luminances: of the curve to pure blue, and of those to yellows.
OKLAB_SLACK = (0.01, 0.0)
CIELAB_SLACK = (0.0, 0.035)


def _plane_basis(weights: tuple[float, float, float]) -> NDArray[np.float64]:
    """(2, 3): an orthonormal basis of the plane w·d = 0, its first axis towards red."""
    w = np.array(weights)
    to_red = np.array([1.0, 0.0, 0.0]) - w[0]
    first = to_red / np.linalg.norm(to_red)
    second = np.cross(w / np.linalg.norm(w), first)
    return np.stack([first, second])


def _plane(weights: tuple[float, float, float]) -> PlaneCoefficients:
    """Difference vectors to the grey axis in an orthonormal basis of their plane."""
    basis = _plane_basis(weights)
    # The columns of basis · (I − 1 wᵀ) sum to zero, as do those of d: two differences to green
    # carry all of p, and a grey gives exactly zero whatever its rounding.
    columns = basis - basis.sum(axis=1, keepdims=True) * np.array(weights)
    return PlaneCoefficients(
        weights=(float(weights[0]), float(weights[2])),
        to_p=tuple((float(row[0]), float(row[2])) for row in columns),
        from_p=tuple((float(column[0]), float(column[1])) for column in basis.T),
    )


def linear_rgb(rgb_to_xyz: Matrix = REC709_TO_XYZ) -> Space:
    """The paper's space: difference vectors to the grey axis in linear RGB. Chuang et al. 2009, §4.

    `rgb_to_xyz`: of the primaries, by rows, white being D65 at Y = 1; here as in the other spaces.
    """
    return _linear("linear-rgb", rgb_to_xyz, _plane(_weights(rgb_to_xyz)))


def xyz(rgb_to_xyz: Matrix = REC709_TO_XYZ) -> Space:
    """CIE XYZ: p is what X and Z differ by from the grey of the same luminance.

    The hues lie in the same half-planes as in `linear_rgb`, the angles between them and |p| differ.
    CIE 15:2018.
    """
    weights = _weights(rgb_to_xyz)
    x, y = D65
    white = x / y, (1 - x - y) / y

    def differences(row: Sequence[float], of_white: float) -> tuple[float, float]:
        red, blue = (
            weights[i] * (row[i] / weights[i] - of_white) if weights[i] else row[i] for i in (0, 2)
        )
        return red, blue

    red_x, blue_x = differences(rgb_to_xyz[0], white[0])
    red_z, blue_z = differences(rgb_to_xyz[2], white[1])
    determinant = red_x * blue_z - blue_x * red_z
    # What p is in differences to green, and these in channels at Y = 0.
    red_green = np.array([blue_z, -blue_x]) / determinant
    blue_green = np.array([-red_z, red_x]) / determinant
    green = -(weights[0] * red_green + weights[2] * blue_green)
    columns = (green + red_green, green, green + blue_green)
    coefficients = PlaneCoefficients(
        weights=(weights[0], weights[2]),
        to_p=((red_x, blue_x), (red_z, blue_z)),
        from_p=tuple((float(column[0]), float(column[1])) for column in columns),
    )
    return _linear("xyz", rgb_to_xyz, coefficients)


def hsl(rgb_to_xyz: Matrix = REC709_TO_XYZ) -> Space:
    """The hues of `linear_rgb`, with the chroma of HSL's double cone: |p| = max − min.

    Smith: Color Gamut Transform Pairs, SIGGRAPH 1978, taken of the linear colour.
    """
    plane = linear_rgb(rgb_to_xyz)
    coefficients = _plane(_weights(rgb_to_xyz))

    def forward(rgb: Array) -> tuple[Array, Array]:
        luminance, p = plane.forward(rgb)
        return luminance, p * ratio(spread_and_size(rgb)[0], np.hypot(p[0], p[1]))

    def inverse(luminance: Array, p: Array) -> Array:
        difference = plane.inverse(np.zeros_like(luminance), p)
        spread, _ = spread_and_size(difference)
        return luminance + difference * ratio(np.hypot(p[0], p[1]), spread)

    return Space("hsl", rgb_to_xyz, forward, inverse, HslCoefficients(coefficients))


def oklab(rgb_to_xyz: Matrix = REC709_TO_XYZ) -> Space:
    """Oklab: p = Y·(a, b)/L. Ottosson, A perceptual color space for image processing, 2020."""
    coefficients = oklab_coefficients(rgb_to_xyz)
    forward, inverse = partial(oklab_forward, coefficients), partial(oklab_inverse, coefficients)
    axis = angle_axis("Oklab hue", lambda rgb: forward(rgb)[1])
    return Space("oklab", rgb_to_xyz, forward, inverse, coefficients, axis, OKLAB_SLACK, 0.5)


def cielab(rgb_to_xyz: Matrix = REC709_TO_XYZ) -> Space:
    """CIELAB: p = Y·(a*, b*)/L* of the colour scaled to Y = 1. CIE 15:2018, 8.2.1."""
    coefficients = cielab_coefficients(rgb_to_xyz)
    forward, inverse = partial(cielab_forward, coefficients), partial(cielab_inverse, coefficients)
    axis = angle_axis("CIELAB hue", lambda rgb: forward(rgb)[1])
    return Space("cielab", rgb_to_xyz, forward, inverse, coefficients, axis, CIELAB_SLACK, 4.5)


def _weights(rgb_to_xyz: Matrix) -> tuple[float, float, float]:
    red, green, blue = rgb_to_xyz[1]
    return float(red), float(green), float(blue)


def _linear(name: str, rgb_to_xyz: Matrix, coefficients: PlaneCoefficients) -> Space:
    """The space of these coefficients."""

    def forward(rgb: Array) -> tuple[Array, Array]:
        red, green, blue = rgb
        red_green, blue_green = red - green, blue - green
        w_red, w_blue = coefficients.weights
        luminance = green + w_red * red_green + w_blue * blue_green
        p = np.empty((2, *rgb.shape[1:]), rgb.dtype)
        for axis, (of_red, of_blue) in enumerate(coefficients.to_p):
            np.multiply(red_green, of_red, out=p[axis])
            p[axis] += blue_green * of_blue
        return luminance, p

    def inverse(luminance: Array, p: Array) -> Array:
        rgb = np.empty((3, *p.shape[1:]), p.dtype)
        for channel, (of_p0, of_p1) in enumerate(coefficients.from_p):
            np.multiply(p[0], of_p0, out=rgb[channel])
            rgb[channel] += p[1] * of_p1
            rgb[channel] += luminance
        return rgb

    return Space(name, rgb_to_xyz, forward, inverse, coefficients)


#: The space of the paper.
DEFAULT_SPACE = "linear-rgb"

#: Each space by its name, as a function of the primaries' RGB→XYZ.
BUILDERS: dict[str, Callable[[Matrix], Space]] = {
    "linear-rgb": linear_rgb,
    "xyz": xyz,
    "hsl": hsl,
    "oklab": oklab,
    "cielab": cielab,
}


def space(name: str, rgb_to_xyz: Matrix = REC709_TO_XYZ) -> Space:
    """The blending space of that name, for Rec. 709 or the primaries whose RGB→XYZ is given.

    `rgb_to_xyz`: a tuple of three rows, white being D65 at Y = 1.
    Errors: `SettingError` that lists the valid names.
    """
    if name not in BUILDERS:
        raise unknown_name("blending space", name, BUILDERS)
    return _built(name, rgb_to_xyz)


@cache
def _built(name: str, rgb_to_xyz: Matrix) -> Space:
    return BUILDERS[name](rgb_to_xyz)


if TYPE_CHECKING:
    #: The blending spaces by name, for the primaries of Rec. 709.
    SPACES: dict[str, Space]


def __getattr__(name: str) -> Any:
    # `SPACES` is made when it is asked for: a stack needs one space, and each takes its time.
    if name != "SPACES":
        raise AttributeError(f"module {__name__} has no attribute {name}")
    globals()[name] = {name: space(name) for name in BUILDERS}
    return globals()[name]
