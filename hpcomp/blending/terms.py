"""The terms of a stack, what the operators' weights leave of each layer, and how two of them add.

The colour of any stack is a reduction of the terms `w_i c_i`, and the weights depend on alphas
alone. Planes first: Y (n), p (2, n), rgb (3, n), α (n).

⊕ keeps factors a and b in [0, 1] of two p, and all of Y; so c₁ ⊕ c₂ = a·c₁ + b·c₂ plus a grey of
(1 − a)·Y₁ + (1 − b)·Y₂ [R1]. Where the maps of a space are linear a term carries this colour, and
its zeros, its sign and a colour that is alone are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color.gamut import bounds_of, colors_within
from ..color.spaces import Space
from .addition import added
from .rules import StackRules

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Term:
    """A weighted colour, or a sum of such: `luminance` Y (n), `p` (2, n) and `rgb` (3, n).

    In a space whose maps are not linear rgb is the plain sum of the colours that went in, which is
    the colour where ⊕ did nothing else. `bounds`: as in `gamut`.
    """

    luminance: Array
    p: Array
    rgb: Array
    bounds: Array

    def weighted(self, weight: Array | float) -> Term:
        """All of it times a weight (n)."""
        return Term(
            weight * self.luminance, weight * self.p, weight * self.rgb, weight * self.bounds
        )


@dataclass(frozen=True)
class Terms:
    """The terms of a stack, bottom first: `weights` w (n, pixels), Y scaled by w, p scaled by w.

    `luminance`: (n, pixels). `p`: (n, 2, pixels). `rgb`: (n, 3, pixels). `bounds`: the sum of
    theirs, as in `gamut`. `alpha`: (pixels), of the whole stack.
    """

    weights: Array
    luminance: Array
    p: Array
    rgb: Array
    bounds: Array
    alpha: Array


def term_of(space: Space, rgb: Array, alpha: Array | float) -> Term:
    """A colour (3, n), linear and premultiplied, as a term."""
    luminance, p = space.forward(rgb)
    return Term(luminance, p, rgb, bounds_of(space, rgb, alpha))


def layer_term(space: Space, opacity: float, rgba: Array) -> tuple[Term, Array]:
    """A layer at its opacity as a term, and its α; rgba (n, 4) → planes of n."""
    planes = np.ascontiguousarray(rgba.T)
    if opacity != 1:
        planes = planes * opacity
    return term_of(space, planes[:3], planes[3]), planes[3]


def sum_of(rules: StackRules, front: Term, behind: Term) -> Term:
    """⊕ of two terms, or what else the blending is; only `foremost` asks who is in front."""
    return sum_of_terms((front, behind), rules.keep(front.p, behind.p), rules.blending_space)


def sum_of_many(rules: StackRules, terms: Sequence[Term]) -> Term:
    """⊕ of many terms at once."""
    kept = rules.keep_of_many(np.stack([term.p for term in terms]))
    return sum_of_terms(terms, tuple(kept), rules.blending_space)


def sum_of_terms(terms: Sequence[Term], kept: Sequence[Array], space: Space) -> Term:
    """The sum of terms of whose p factors in [0, 1], each (n), are kept."""
    luminance, bounds = terms[0].luminance, terms[0].bounds
    for term in terms[1:]:
        luminance = luminance + term.luminance  # [R1]
        bounds = bounds + term.bounds
    p = added([term.p for term in terms], kept)
    if not space.linear:
        return Term(luminance, p, added([term.rgb for term in terms], [1.0] * len(terms)), bounds)
    # What is not kept becomes grey. None of it is below 0 where no luminance is.
    grey = np.zeros_like(luminance)
    for term, factor in zip(terms, kept, strict=True):
        grey += np.where(factor == 1, 0, term.luminance - factor * term.luminance)
    return Term(luminance, p, added([term.rgb for term in terms], kept) + grey, bounds)


def sums_of_runs(term: Term, kept: Array, first: NDArray[np.intp], space: Space) -> Term:
    """The sums of runs of terms, which lie one after the other in `term` and begin at `first`.

    `kept`: the factor in [0, 1] of each p.
    """

    def total(planes: Array) -> Array:
        return np.add.reduceat(planes, first, axis=-1) if planes.size else planes[..., first]

    luminance, bounds, p = total(term.luminance), total(term.bounds), total(kept * term.p)
    if not space.linear:
        return Term(luminance, p, total(term.rgb), bounds)
    grey = total(np.where(kept == 1, 0, term.luminance - kept * term.luminance))
    return Term(luminance, p, total(kept * term.rgb) + grey, bounds)


def color_of(space: Space, term: Term) -> Array:
    """The colour (3, n) of a sum of terms, in gamut."""
    return colors_within(space, term.luminance, term.p, term.rgb, term.bounds)


def weighted(rules: StackRules, space: Space, layers: Sequence[Array]) -> Terms:
    """The terms of `layers`, each (pixels, 4), linear, premultiplied, alpha in [0, 1]."""
    unweighted = [
        layer_term(space, opacity, rgba)
        for opacity, rgba in zip(rules.opacities, layers, strict=True)
    ]
    alpha = unweighted[0][1]
    factors: list[tuple[Any, Any]] = [(1.0, 0.0)]
    for operator, (_, alpha_layer) in zip(rules.operators[1:], unweighted[1:], strict=True):
        assert operator is not None
        factors.append(operator.factors(alpha_layer, alpha))
        alpha = operator.alpha(alpha_layer, alpha)
    # w_i = F_A,i · Π F_B of the layers above: gathered from the top.
    above: Any = np.ones_like(alpha)
    weights = np.empty((len(unweighted), len(alpha)), alpha.dtype)
    luminance = np.empty_like(weights)
    p = np.empty((len(unweighted), 2, len(alpha)), alpha.dtype)
    rgb = np.empty((len(unweighted), 3, len(alpha)), alpha.dtype)
    total = np.zeros_like(unweighted[0][0].bounds)
    for number in reversed(range(len(unweighted))):
        f_a, f_b = factors[number]
        weights[number] = f_a * above
        above = f_b * above
        term = unweighted[number][0].weighted(weights[number])
        luminance[number], p[number], rgb[number] = term.luminance, term.p, term.rgb
        total += term.bounds
    return Terms(weights, luminance, p, rgb, total, alpha)
