"""Cells of a canvas, in which a reader finds a label: squares of pixels from its corner.

A label is seen in a cell where one pixel of that cell shows its hue. Parts of a picture that begin
at borders of cells add up to the whole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Window
from .defaults import CELL

Cells = NDArray[np.intp]
Mask = NDArray[np.bool_]


def cells_of(place: Window) -> Cells:
    """(pixels): which of the cells that it touches each pixel lies in, row by row.

    `place`: counted from the canvas' corner; negative coordinates lie in cells before it.
    """
    rows = np.arange(place.y, place.bottom) // CELL - place.y // CELL
    columns = np.arange(place.x, place.right) // CELL - place.x // CELL
    across = (place.right - 1) // CELL - place.x // CELL + 1
    return (rows[:, None] * across + columns).reshape(-1)


def pixels_seen(contributes: Mask, shows: Mask, cells: Cells) -> int:
    """How many pixels of a label lie in cells where it is seen.

    `contributes`, `shows` (pixels): where the label is, and where the picture has its hue there.
    `cells` (pixels): as of `cells_of`; a cell's pixels are all here.
    """
    seen = np.zeros(int(cells.max(initial=-1)) + 1, np.bool_)
    seen[cells[shows]] = True
    return int(np.count_nonzero(seen[cells[contributes]]))
