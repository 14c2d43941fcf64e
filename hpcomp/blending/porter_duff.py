"""The Porter–Duff operators as a table of factors; what is done with the colours lives elsewhere.

A is the layer, B the stack below it. An operator is two factors: `c = F_A c_A ⊕ F_B c_B` and
`α = F_A α_A + F_B α_B`, on premultiplied colour. Porter and Duff 1984; names as in the W3C's
Compositing and Blending Level 1.
"""

from __future__ import annotations

from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import unknown_name
from ..records import record

Alpha = NDArray[np.floating[Any]]
T = TypeVar("T")


class Factor(Enum):
    """What a colour is multiplied by: a function of the other picture's alpha."""

    ZERO = "0"
    ONE = "1"
    ALPHA = "α"
    REST = "1 − α"

    def __call__(self, alpha: Alpha) -> Alpha | float:
        match self:
            case Factor.ZERO:
                return 0.0
            case Factor.ONE:
                return 1.0
            case Factor.ALPHA:
                return alpha
            case Factor.REST:
                return 1 - alpha


_ZERO, _ONE, _ALPHA, _REST = Factor.ZERO, Factor.ONE, Factor.ALPHA, Factor.REST
_BEHIND = True


@record
class Operator:
    """One row of the table: a name, its aliases, the two factors, and who is in front.

    `factor_a` is a function of the alpha below, `factor_b` of the layer's own alpha. `behind`: the
    layer is put behind all that is there, not in front of it.
    """

    name: str
    aliases: tuple[str, ...]
    factor_a: Factor
    factor_b: Factor
    behind: bool = False

    def factors(
        self, alpha_a: ArrayLike, alpha_b: ArrayLike
    ) -> tuple[Alpha | float, Alpha | float]:
        """`(F_A, F_B)` for the layer's alpha and the alpha below, both in [0, 1]."""
        return self.factor_a(np.asarray(alpha_b)), self.factor_b(np.asarray(alpha_a))

    def alpha(self, alpha_a: ArrayLike, alpha_b: ArrayLike) -> Alpha:
        """The alpha of the layer on the stack below, in [0, 1]."""
        alpha_a, alpha_b = np.asarray(alpha_a), np.asarray(alpha_b)
        f_a, f_b = self.factors(alpha_a, alpha_b)
        # Only `plus` can pass 1 by more than rounding: W3C Compositing clamps it there.
        return np.minimum(f_a * alpha_a + f_b * alpha_b, alpha_a.dtype.type(1))

    def front_first(self, layer: T, stack: T) -> tuple[T, T]:
        """Something of the layer and of the stack, that of the one in front first."""
        return (stack, layer) if self.behind else (layer, stack)

    @property
    def needs_alpha(self) -> bool:
        """Whether the operator does nothing useful with a layer that is opaque everywhere."""
        return self.name in ("in", "out", "dst-in", "dst-out")

    @property
    def keeps_outside(self) -> bool:
        """Whether all below stays as it is where the layer is transparent."""
        return self.factor_b in (Factor.ONE, Factor.REST)


OPERATORS: dict[str, Operator] = {
    row.name: row
    for row in (
        #        name        aliases            F_A     F_B     depth
        Operator("clear",    (),                _ZERO,  _ZERO),
        Operator("src",      ("copy",),         _ONE,   _ZERO),
        Operator("dst",      (),                _ZERO,  _ONE),
        Operator("over",     ("src-over",),     _ONE,   _REST),
        Operator("dst-over", ("under",),        _REST,  _ONE,   _BEHIND),
        Operator("in",       ("src-in",),       _ALPHA, _ZERO),
        Operator("dst-in",   ("mask",),         _ZERO,  _ALPHA),
        Operator("out",      ("src-out",),      _REST,  _ZERO),
        Operator("dst-out",  ("stencil",),      _ZERO,  _REST),
        Operator("atop",     ("src-atop",),     _ALPHA, _REST),
        Operator("dst-atop", (),                _REST,  _ALPHA, _BEHIND),
        Operator("xor",      (),                _REST,  _REST),
        Operator("plus",     ("add", "lighter"), _ONE,  _ONE),
    )
}  # fmt: skip

_BY_NAME = {name: row for row in OPERATORS.values() for name in (row.name, *row.aliases)}

#: Every name an operator answers to, aliases after their operator.
OPERATOR_NAMES: tuple[str, ...] = tuple(_BY_NAME)


def operator(name: str) -> Operator:
    """The operator of that name or alias.

    Errors: `SettingError` for an unknown name, listing the valid ones.
    """
    try:
        return _BY_NAME[name]
    except KeyError:
        raise unknown_name("operator", name, OPERATOR_NAMES) from None
