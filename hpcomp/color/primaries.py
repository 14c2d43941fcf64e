"""Which light red, green and blue stand for: chromaticities, and matrices between primaries.

The only importer of colour-science, for what `matrices` does not have. Knows no transfer curves, no
pixels, no files.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import unknown_name
from ..records import record
from .matrices import D65_TO_D50, RGB_TO_XYZ, Matrix, inverted, product

Array = NDArray[np.floating[Any]]
Float64 = NDArray[np.float64]
Chromaticity = tuple[float, float]
XYZ = tuple[float, float, float]

#: CIE 1931 xy of the white points. ITU-R BT.709-6; SMPTE ST 2065-1 for the ACES white.
D65: Chromaticity = (0.3127, 0.3290)
ACES_WHITE: Chromaticity = (0.32168, 0.33767)
#: XYZ of the white of ICC's connection space; ICC.1:2022, 7.2.16.
D50_XYZ: XYZ = (0.9642, 1.0, 0.8249)

#: Files store chromaticities in 5 digits, and D65 in several roundings of its own: closer than this
#: changes no colour by half an 8-bit step.
SAME_CHROMATICITY = 2e-4


@record
class Primaries:
    """The CIE 1931 xy chromaticities of red, green, blue and white."""

    name: str
    red: Chromaticity
    green: Chromaticity
    blue: Chromaticity
    white: Chromaticity

    @property
    def rgb(self) -> tuple[Chromaticity, Chromaticity, Chromaticity]:
        """The chromaticities of red, green and blue, without the white."""
        return self.red, self.green, self.blue

    @property
    def xy(self) -> Float64:
        """(4, 2): red, green, blue, white."""
        return np.array([self.red, self.green, self.blue, self.white])


PRIMARIES: dict[str, Primaries] = {
    row.name: row
    for row in (
        # ITU-R BT.709-6; SMPTE EG 432-1 with D65; ITU-R BT.2020-2; AMPAS S-2014-004;
        # SMPTE ST 2065-1; Adobe RGB (1998), 2005-05.
        Primaries("rec709", (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D65),
        Primaries("display-p3", (0.680, 0.320), (0.265, 0.690), (0.150, 0.060), D65),
        Primaries("rec2020", (0.708, 0.292), (0.170, 0.797), (0.131, 0.046), D65),
        Primaries("acescg", (0.713, 0.293), (0.165, 0.830), (0.128, 0.044), ACES_WHITE),
        Primaries("aces2065-1", (0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), ACES_WHITE),
        Primaries("adobe-rgb", (0.64, 0.33), (0.21, 0.71), (0.15, 0.06), D65),
    )
}
REC709 = PRIMARIES["rec709"]
#: Those that a stack may be asked to be composited in; a file may have others.
WORKING_PRIMARIES = ("rec709", "display-p3", "rec2020", "acescg")
#: Those that a PNG can be written in.
OUT_PRIMARIES = ("rec709", "display-p3", "rec2020")
#: Asks for those of the bottom layer.
BOTTOM = "bottom"

#: Luminance of the linear Rec. 709 primaries: the Y row of RGB→XYZ for the chromaticities of
#: ITU-R BT.709 with D65 at (0.3127, 0.3290), here to 16 digits.
REC709_WEIGHTS: tuple[float, float, float] = (
    0.21263900587151036,
    0.7151686787677559,
    0.07219231536073371,
)
#: XYZ of each primary by columns, white being D65 at Y = 1: RGB→XYZ of Rec. 709.
REC709_TO_XYZ: Matrix = (
    tuple(w * (x / y) for w, (x, y) in zip(REC709_WEIGHTS, REC709.rgb, strict=True)),
    REC709_WEIGHTS,
    tuple(w * ((1 - x - y) / y) for w, (x, y) in zip(REC709_WEIGHTS, REC709.rgb, strict=True)),
)


_KNOWN_TO_XYZ: dict[Primaries, Matrix] = {
    REC709: REC709_TO_XYZ,
    **{PRIMARIES[name]: matrix for name, matrix in RGB_TO_XYZ.items()},
}


def working_primaries(name: str) -> Primaries:
    """The working primaries of that name; `SettingError` lists the valid ones."""
    if name not in WORKING_PRIMARIES:
        raise unknown_name("primaries", name, WORKING_PRIMARIES)
    return PRIMARIES[name]


def primaries_from_xy(xy: Any) -> Primaries:
    """The primaries with these 8 chromaticities: the known ones by name, others as `custom`.

    `xy`: red, green, blue, white, x before y. Errors: `ValueError` where they span no gamut.
    """
    chromaticities = np.asarray(xy, float).reshape(4, 2)
    for known in PRIMARIES.values():
        if np.abs(chromaticities - known.xy).max() <= SAME_CHROMATICITY:
            return known
    corners = np.concatenate([chromaticities[:3], np.ones((3, 1))], axis=1)
    if (
        not np.isfinite(chromaticities).all()
        or abs(np.linalg.det(corners)) < 1e-6
        or chromaticities[3, 1] <= 0
    ):
        raise ValueError("chromaticities that span no gamut")
    red, green, blue, white = ((float(x), float(y)) for x, y in chromaticities)
    return Primaries("custom", red, green, blue, white)


@contextlib.contextmanager
def _colour() -> Iterator[Any]:
    """The library, imported when it is needed."""
    # It warns of optional packages that nothing here needs, and changes how numpy prints.
    with warnings.catch_warnings(), np.printoptions():
        warnings.simplefilter("ignore")
        import colour

        yield colour


def white_xyz(xy: Chromaticity) -> XYZ:
    """XYZ of a chromaticity at Y = 1."""
    x, y = xy
    return x / y, 1.0, (1 - x - y) / y


@cache
def conversion(source: Primaries, target: Primaries) -> Float64 | None:
    """(3, 3): linear RGB of some primaries to others, Bradford-adapted; None if they are the same.

    White becomes white, and grey grey, whatever the white points.
    """
    if source == target:
        return None
    # Both by way of D65: what Bradford does on the way to a white it undoes on the way back.
    return np.array(product(inverted(to_xyz(target)), to_xyz(source)))


@cache
def to_xyz(primaries: Primaries) -> Matrix:
    """Linear RGB to CIE XYZ by rows, adapted to D65 by Bradford: white is D65 at Y = 1.

    The second row has the luminance weights.
    """
    if primaries in _KNOWN_TO_XYZ:
        return _KNOWN_TO_XYZ[primaries]
    with _colour() as colour:
        space = colour.RGB_Colourspace(primaries.name, primaries.xy[:3], primaries.xy[3])
        matrix = np.asarray(space.matrix_RGB_to_XYZ, float)
    if primaries.white != D65:
        matrix = adaptation(white_xyz(primaries.white), white_xyz(D65)) @ matrix
    return tuple(tuple(map(float, row)) for row in matrix)


def converted(rgb: Array, source: Primaries, target: Primaries) -> Array:
    """Linear RGB (…, 3) of some primaries in others, in its own precision; greys stay exactly."""
    pairs = conversion_pairs(source, target)
    if pairs is None:
        return rgb
    # The operations and their order are part of the contract: the kernel has the same ones.
    red, green, blue = np.moveaxis(rgb, -1, 0)
    red_green, blue_green = red - green, blue - green
    return np.stack([green + r * red_green + b * blue_green for r, b in pairs], axis=-1)


@cache
def conversion_pairs(
    source: Primaries, target: Primaries
) -> tuple[tuple[float, float], ...] | None:
    """`conversion` by rows, of red and blue less green, beside green; None where it is None.

    Each row sums to 1, as white becomes white: so equal channels stay equal.
    """
    matrix = conversion(source, target)
    if matrix is None:
        return None
    return tuple((float(row[0] / row.sum()), float(row[2] / row.sum())) for row in matrix)


def adaptation(white: XYZ, to_white: XYZ) -> Float64:
    """(3, 3): XYZ under one white to XYZ under another, by Bradford; the whites as XYZ."""
    if white == to_white:
        return np.eye(3)
    if (white, to_white) in _KNOWN_ADAPTATIONS:
        return np.array(_KNOWN_ADAPTATIONS[white, to_white])
    with _colour() as colour:
        matrix = colour.adaptation.matrix_chromatic_adaptation_VonKries(
            white, to_white, transform="Bradford"
        )
    return np.asarray(matrix, float)


_KNOWN_ADAPTATIONS: dict[tuple[XYZ, XYZ], Matrix] = {
    (white_xyz(D65), D50_XYZ): D65_TO_D50,
    (D50_XYZ, white_xyz(D65)): inverted(D65_TO_D50),
}
