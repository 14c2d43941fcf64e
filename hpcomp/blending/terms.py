"""The terms of a stack, what the operators' weights leave of each layer, and how two of them add.

The colour of any stack is a reduction of the terms `w_i c_i`, and the weights depend on alphas
alone. Planes first: Y (n), p (2, n), rgb (3, n), α (n).

⊕ keeps factors a and b in [0, 1] of two p, and all of Y; so c₁ ⊕ c₂ = a·c₁ + b·c₂ plus a grey of
(1 − a)·Y₁ + (1 − b)·Y₂ [R1]. Where the maps of a space are linear a term carries this colour, and
its zeros, its sign and a colour that is alone are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color.gamut import bounds_of, colors_within
from ..color.spaces import Space
from ..records import record
from .addition import added
from .rules import Chroma, StackRules, stacked, sum_of_chromas

Array = NDArray[np.floating[Any]]


@record
class Term:
    """A weighted colour, or a sum of such: `luminance` Y (n), `p` (2, n) and `rgb` (3, n).

    In a space whose maps are not linear rgb is the plain sum of the colours that went in, which is
    the colour where ⊕ did nothing else. `bounds`: as in `gamut`. `strength` m (n): None where it is
    |p|.
    """

    luminance: Array
    p: Array
    rgb: Array
    bounds: Array
    strength: Array | None = None

    @property
    def chroma(self) -> Chroma:
        """What competes."""
        return Chroma(self.p, self.strength)

    def planes(self) -> dict[str, Array]:
        """Its arrays (…, n) by name."""
        return {name: array for name, array in vars(self).items() if array is not None}

    def weighted(self, weight: Array | float) -> Term:
        """All of it times a weight (n)."""
        return Term(**{name: weight * array for name, array in self.planes().items()})

    def part(self, pixels: slice | NDArray[np.intp]) -> Term:
        """Some pixels of it; those of a slice are views."""
        return Term(**{name: array[..., pixels] for name, array in self.planes().items()})

    def put(self, pixels: slice | NDArray[np.intp], part: Term) -> None:
        """Replaces some pixels of it."""
        for name, array in part.planes().items():
            getattr(self, name)[..., pixels] = array


@record
class Terms:
    """The terms of a stack, bottom first, their weights w (n, pixels), and α (pixels) of it all."""

    terms: list[Term]
    weights: Array
    alpha: Array


def term_of(
    rules: StackRules, rgb: Array, alpha: Array | float, space: Space | None = None
) -> Term:
    """A colour (3, n), linear and premultiplied, as a term, in that space or the rules' own."""
    space = space or rules.blending_space
    luminance, p = space.forward(rgb)
    strength = rules.strength.of(space.rgb_to_xyz, rgb, alpha)
    if strength is not None:
        strength = np.where((p != 0).any(axis=0), strength, 0)
    bounds = bounds_of(space, rgb, alpha, rules.bounded)
    return Term(luminance, p, rgb, bounds, strength)


def layer_term(
    rules: StackRules, opacity: float, rgba: Array, space: Space | None = None
) -> tuple[Term, Array]:
    """A layer at its opacity as a term, and its α; rgba (n, 4) → planes of n."""
    planes = np.ascontiguousarray(rgba.T)
    if opacity != 1:
        planes = planes * opacity
    return term_of(rules, planes[:3], planes[3], space), planes[3]


def background_term(rules: StackRules, alpha: Array, space: Space | None = None) -> Term:
    """The background as far as it shows through a stack of α (n)."""
    color = np.array(rules.background, alpha.dtype)[:, None]
    return term_of(rules, color, 1.0, space).weighted(1 - alpha)


def sum_of(rules: StackRules, front: Term, behind: Term) -> Term:
    """⊕ of two terms, or what else the blending is; only `foremost` asks who is in front."""
    kept = rules.keep(front.chroma, behind.chroma)
    return sum_of_terms((front, behind), kept, rules.blending_space)


def sum_of_many(rules: StackRules, terms: Sequence[Term], phase: Array | None = None) -> Term:
    """⊕ of many terms at once; `phase` (n) of the weave, where the blending depends on it."""
    kept = rules.keep_of_many(stacked([term.chroma for term in terms]), phase)
    return sum_of_terms(terms, tuple(kept), rules.blending_space)


def sum_of_terms(terms: Sequence[Term], kept: Sequence[Array], space: Space) -> Term:
    """The sum of terms of whose p factors, each (n), are kept."""
    luminance, bounds = terms[0].luminance, terms[0].bounds
    for term in terms[1:]:
        luminance = luminance + term.luminance  # [R1]
        bounds = bounds + term.bounds
    p, strength = sum_of_chromas([term.chroma for term in terms], kept)
    if not space.linear:
        plain = added([term.rgb for term in terms], [1.0] * len(terms))
        return Term(luminance, p, plain, bounds, strength)
    # What is not kept becomes grey. None of it is below 0 where no luminance is.
    grey = np.zeros_like(luminance)
    for term, factor in zip(terms, kept, strict=True):
        grey += np.where(factor == 1, 0, term.luminance - factor * term.luminance)
    rgb = added([term.rgb for term in terms], kept) + grey
    return Term(luminance, p, rgb, bounds, strength)


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


def weighted(rules: StackRules, layers: Sequence[Array], space: Space | None = None) -> Terms:
    """The terms of `layers`, each (pixels, 4), linear, premultiplied, alpha in [0, 1]."""
    unweighted = [
        layer_term(rules, opacity, rgba, space)
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
    for number in reversed(range(len(unweighted))):
        f_a, f_b = factors[number]
        weights[number] = f_a * above
        above = f_b * above
    terms = [term.weighted(w) for (term, _), w in zip(unweighted, weights, strict=True)]
    return Terms(terms, weights, alpha)
