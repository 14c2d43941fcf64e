"""The weighted terms of a stack: what the operators' weights leave of each layer. No reduction.

The colour of any stack is a reduction of the terms `w_i c_i`, and the weights depend on alphas
alone. Planes first: Y (n), p (2, n), α (n).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color.gamut import bounds_of
from ..color.spaces import Space
from .rules import StackRules

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Terms:
    """The terms of a stack, bottom first: `weights` w (n, pixels), Y scaled by w, p scaled by w.

    `luminance`: (n, pixels). `p`: (n, 2, pixels). `bounds`: the sum of theirs, as in `gamut`.
    `alpha`: (pixels), of the whole stack.
    """

    weights: Array
    luminance: Array
    p: Array
    bounds: Array
    alpha: Array


def term(space: Space, opacity: float, rgba: Array) -> tuple[Array, Array, Array, Array]:
    """(Y, p, α) and `gamut.bounds_of` of a layer at its opacity; rgba (n, 4) → planes of n."""
    planes = np.ascontiguousarray(rgba.T)
    if opacity != 1:
        planes = planes * opacity
    luminance, p = space.forward(planes[:3])
    return luminance, p, planes[3], bounds_of(space, planes[:3], planes[3])


def weighted(rules: StackRules, space: Space, layers: Sequence[Array]) -> Terms:
    """The terms of `layers`, each (pixels, 4), linear, premultiplied, alpha in [0, 1]."""
    unweighted = [
        term(space, opacity, rgba) for opacity, rgba in zip(rules.opacities, layers, strict=True)
    ]
    alpha = unweighted[0][2]
    factors: list[tuple[Any, Any]] = [(1.0, 0.0)]
    for operator, (_, _, alpha_layer, _) in zip(rules.operators[1:], unweighted[1:], strict=True):
        assert operator is not None
        factors.append(operator.factors(alpha_layer, alpha))
        alpha = operator.alpha(alpha_layer, alpha)
    # w_i = F_A,i · Π F_B of the layers above: gathered from the top.
    above: Any = np.ones_like(alpha)
    weights = np.empty((len(unweighted), len(alpha)), alpha.dtype)
    luminance = np.empty_like(weights)
    p = np.empty((len(unweighted), 2, len(alpha)), alpha.dtype)
    total = np.zeros_like(unweighted[0][3])
    for number in reversed(range(len(unweighted))):
        f_a, f_b = factors[number]
        weights[number] = f_a * above
        above = f_b * above
        luminance[number] = weights[number] * unweighted[number][0]
        p[number] = weights[number] * unweighted[number][1]
        total += weights[number] * unweighted[number][3]
    return Terms(weights, luminance, p, total, alpha)
