"""Pictures many times smaller: the sums of squares of their pixels, in whole numbers.

So a small picture does not depend on the strips in which the large one came.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Window
from .histogram import LARGEST_ADDEND, SUM_UNIT

Sums = NDArray[np.int64]
Array = NDArray[np.float32]

#: What stands for a picture: the number of a layer, or a name of `labels.RESULTS`.
Picture = int | str


class Squares:
    """The squares of a strip: `sums[picture]` (rows, columns, 4), RGBA in `SUM_UNIT`.

    `scale`: pixels of a square's side. `top`: rows of the uppermost squares that lie above the
    strip. `width`, `height`: of the strip, in pixels; its first column begins squares. Layers are
    at their opacity and results over the background, all before the exposure. A pixel adds at most
    `LARGEST_ADDEND`, and nothing where it is no number. A layer that is nowhere in the strip has no
    sums.
    """

    def __init__(self, scale: int, top: int, width: int, height: int) -> None:
        self.scale, self.top, self.height = scale, top, height
        self.shape = -(-(top + height) // scale), -(-width // scale), 4
        self.sums: dict[Picture, Sums] = {}

    def add(self, picture: Picture, rgba: Array, place: Window) -> None:
        """Adds linear, premultiplied pixels (height, width, 4); `place`: in the strip."""
        clipped = np.clip(np.nan_to_num(rgba), -LARGEST_ADDEND, LARGEST_ADDEND)
        units = np.rint(clipped * np.float32(1 / SUM_UNIT)).astype(np.int64)
        rows, first_row = _begins(place.y + self.top, place.height, self.scale)
        columns, first_column = _begins(place.x, place.width, self.scale)
        sums = np.add.reduceat(np.add.reduceat(units, rows, axis=0), columns, axis=1)
        if picture not in self.sums:
            self.sums[picture] = np.zeros(self.shape, np.int64)
        across = slice(first_column, first_column + len(columns))
        self.sums[picture][first_row : first_row + len(rows), across] += sums


def _begins(at: int, length: int, scale: int) -> tuple[NDArray[np.intp], int]:
    """Where squares begin among so many pixels from coordinate `at` on, and which is the first."""
    first = at // scale
    begins = np.arange(first * scale, at + length, scale) - at
    begins[0] = 0
    return begins, first


def means(sums: Sums, areas: NDArray[np.int64]) -> Array:
    """The mean colours (rows, columns, 4) of squares of so many pixels, `areas` (rows, columns)."""
    factors = (SUM_UNIT / areas[..., None]).astype(np.float32)
    return np.multiply(sums, factors, dtype=np.float32, casting="unsafe")


def areas_of(scale: int, width: int, height: int) -> NDArray[np.int64]:
    """How many pixels of a picture each of its squares has, (rows, columns)."""
    down, across = (
        np.diff(np.append(np.arange(0, length, scale), length)) for length in (height, width)
    )
    return down[:, None] * across
