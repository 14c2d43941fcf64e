"""The Porter–Duff operators as a table of factors; what is done with the colours lives elsewhere.

A is the layer, B the stack below it. An operator is two factors: `c = F_A c_A ⊕ F_B c_B` and
`α = F_A α_A + F_B α_B`, on premultiplied colour. Porter and Duff 1984; names as in the W3C's
Compositing and Blending Level 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import unknown_name

Alpha = NDArray[np.floating[Any]]
Factor = Callable[[Alpha], Alpha | float]


def _zero(alpha: Alpha) -> float:
    return 0.0


def _one(alpha: Alpha) -> float:
    return 1.0


def _alpha(alpha: Alpha) -> Alpha:
    return alpha


def _rest(alpha: Alpha) -> Alpha:
    return 1 - alpha


@dataclass(frozen=True)
class Operator:
    """One row of the table: a name, its aliases, and the two factors.

    `factor_a` is a function of the alpha below, `factor_b` of the layer's own alpha.
    """

    name: str
    aliases: tuple[str, ...]
    factor_a: Factor
    factor_b: Factor

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

    @property
    def needs_alpha(self) -> bool:
        """Whether the operator does nothing useful with a layer that is opaque everywhere."""
        return self.name in ("in", "out", "dst-in", "dst-out")


OPERATORS: dict[str, Operator] = {
    row.name: row
    for row in (
        #        name        aliases            F_A     F_B
        Operator("clear",    (),                _zero,  _zero),
        Operator("src",      ("copy",),         _one,   _zero),
        Operator("dst",      (),                _zero,  _one),
        Operator("over",     ("src-over",),     _one,   _rest),
        Operator("dst-over", ("under",),        _rest,  _one),
        Operator("in",       ("src-in",),       _alpha, _zero),
        Operator("dst-in",   ("mask",),         _zero,  _alpha),
        Operator("out",      ("src-out",),      _rest,  _zero),
        Operator("dst-out",  ("stencil",),      _zero,  _rest),
        Operator("atop",     ("src-atop",),     _alpha, _rest),
        Operator("dst-atop", (),                _rest,  _alpha),
        Operator("xor",      (),                _rest,  _rest),
        Operator("plus",     ("add", "lighter"), _one,  _one),
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
