"""How different two colours look: in Oklab, and as a contrast of luminance. Knows no labels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .primaries import REC709_TO_XYZ
from .uniformspaces import ROOTS_TO_LAB, XYZ_TO_LMS

Floats = NDArray[np.floating[Any]]

#: Linear Rec. 709 to cone responses, and their cube roots to (L, a, b).
_TO_CONES = np.array(XYZ_TO_LMS) @ np.array(REC709_TO_XYZ)
_TO_LAB = np.array(ROOTS_TO_LAB)

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
