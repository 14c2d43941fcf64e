"""The table of blendings: what is kept of chroma vectors that add. How is in its own modules."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import unknown_name
from ..records import record
from . import addition, weaving

Array = NDArray[np.floating[Any]]


@record
class Blending:
    """One row of the table: what is kept of two chroma vectors that add, and of many at once.

    What is kept are factors: `keep` gives a and b (…) of p1, p2 (2, …), whose sum is a·p1 + b·p2,
    and `keep_of_many` one for each of p (n, 2, …). They are 1 where p vanishes, and where any is
    not finite. Both take a hue tolerance in degrees, a bias against grey, and strengths or None.
    `depends_on_order`: whether the blend order matters; `depends_on_depth`: whether it matters who
    is in front, who is given first; `depends_on_place`: whether the phase of the pattern matters,
    which `keep_of_many` takes last. Then all terms add at once, the background among them, and
    there is no `keep`. Its factors go beyond 1, all others are in [0, 1].
    """

    name: str
    keep: Callable[..., addition.Pair] | None
    keep_of_many: Callable[[Array, float, float, Array | None, Array | None], Array]
    depends_on_order: bool = False
    depends_on_depth: bool = False
    depends_on_place: bool = False


BLENDINGS: dict[str, Blending] = {
    row.name: row
    for row in (
        Blending("hue-preserving", addition.keep_hue, addition.keep_hues, depends_on_order=True),
        Blending("traditional", addition.keep_all, addition.keep_all_of_many),
        Blending(
            "foremost",
            addition.keep_foremost,
            addition.keep_foremost_of_many,
            depends_on_depth=True,
        ),
        Blending("woven", None, weaving.keep_thread, depends_on_place=True),
    )
}


def blending(name: str) -> Blending:
    """The blending of that name; `SettingError` lists the valid ones."""
    try:
        return BLENDINGS[name]
    except KeyError:
        raise unknown_name("blending", name, BLENDINGS) from None
