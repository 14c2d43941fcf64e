"""How strong a term is where hues compete: what ⊕ compares. How terms add is in `addition`.

In the paper a colour is as strong as its chroma |p|, so that dark and blue labels lose to whatever
lies beside them. A strength m ≥ 0 separates the two: it is of degree 1 in the weight of a term, and
⊕ keeps the same share of it as of p.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color import spaces
from ..color.matrices import Matrix
from ..color.uniformspaces import OklabCoefficients, oklab_chroma
from ..errors import unknown_name
from ..records import record

Array = NDArray[np.floating[Any]]

#: The Oklab chroma at which a colour has half the strength of its coverage.
HALF_CHROMA = 0.04


@record
class Strength:
    """One row of the table: what a colour is as strong as.

    `of_chroma`: m (…) of α (…) and of Oklab's chroma of the premultiplied colour (…); None where m
    is |p|. Oklab is of degree 1/3, so a straight colour's chroma is α^(−1/3) of this.
    """

    name: str
    of_chroma: Callable[[Array, Array], Array] | None = None

    def of(self, rgb_to_xyz: Matrix, rgb: Array, alpha: Array | float) -> Array | None:
        """m (…) of a colour rgb (3, …), linear and premultiplied, of α in [0, 1]; or None.

        `rgb_to_xyz`: of its primaries.
        """
        if self.of_chroma is None:
            return None
        whole = np.broadcast_to(np.asarray(alpha, rgb.dtype), rgb.shape[1:])
        return self.of_chroma(whole, oklab_chroma(oklab_of(rgb_to_xyz), rgb))


def oklab_of(rgb_to_xyz: Matrix) -> OklabCoefficients:
    """Oklab for those primaries."""
    coefficients = spaces.space("oklab", rgb_to_xyz).coefficients
    assert isinstance(coefficients, OklabCoefficients)
    return coefficients


def _perceived(alpha: Array, chroma: Array) -> Array:
    """α·C, C being the chroma of the straight colour; 0 where α is."""
    root = np.cbrt(alpha)
    return root * root * chroma


def _coverage(alpha: Array, chroma: Array) -> Array:
    """α·C/(C + `HALF_CHROMA`): greys have no part in it, and all else is as strong as it covers."""
    whole = chroma + np.cbrt(alpha) * alpha.dtype.type(HALF_CHROMA)
    return alpha * np.divide(chroma, whole, out=np.zeros_like(chroma), where=whole != 0)


STRENGTHS: dict[str, Strength] = {
    row.name: row
    for row in (
        Strength("chroma"),
        Strength("perceived", _perceived),
        Strength("coverage", _coverage),
    )
}


def strength(name: str) -> Strength:
    """The strength of that name; `SettingError` lists the valid ones."""
    try:
        return STRENGTHS[name]
    except KeyError:
        raise unknown_name("strength", name, STRENGTHS) from None
