"""How different two colours look: in Oklab, and as a contrast of luminance. Knows no labels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.floating[Any]]

#: Linear Rec. 709 to cone responses, and their cube roots to (L, a, b).
#: Ottosson: A perceptual color space for image processing, 2020, in the digits of 2021-01-25.
_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)

#: What is added to both luminances of a contrast: the light that a screen reflects. WCAG 2.2.
FLARE = 0.05


def oklab(rgb: ArrayLike) -> Floats:
    """(L, a, b) of linear Rec. 709 colours: (…, 3) → (…, 3), L of white being 1."""
    return np.cbrt(np.asarray(rgb, np.float64) @ _TO_CONES.T) @ _TO_LAB.T


def difference(rgb1: ArrayLike, rgb2: ArrayLike) -> Floats:
    """The distance in Oklab of linear Rec. 709 colours (…, 3): black to white is 1.

    Side by side, 0.02 is just noticeable: CSS Color Module Level 4, on ΔEOK.
    """
    return np.linalg.norm(oklab(rgb1) - oklab(rgb2), axis=-1)


def contrast(luminance1: ArrayLike, luminance2: ArrayLike) -> Floats:
    """The contrast ratio of two linear luminances (…), white being 1: 1 to 21. WCAG 2.2."""
    one, other = np.asarray(luminance1, np.float64), np.asarray(luminance2, np.float64)
    return (np.maximum(one, other) + FLARE) / (np.minimum(one, other) + FLARE)
