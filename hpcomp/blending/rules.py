"""The rules of a stack, and how it is reduced.

A stack is a reduction with ⊕ of the terms `w_i c_i`: the operators turn alphas into weights, the
blend order reduces the terms. No pixels here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..color import spaces
from ..color.primaries import Primaries, converted, to_xyz, working_primaries
from ..errors import MismatchError, SettingError
from ..records import record
from . import addition, blendings, orders, porter_duff
from . import strength as strengths
from .blendings import BLENDINGS, Blending
from .strength import Strength
from .weaving import Weave

Array = NDArray[np.floating[Any]]

#: More than there are between the faintest and the brightest float.
MAX_STOPS = 100


class Reduction(Enum):
    """How an engine reduces a stack: a fold holds one accumulator, else it holds every layer."""

    BOTTOM_UP = "bottom-up"
    FRONT_TO_BACK = "front-to-back"
    ALL_LAYERS = "all-layers"


class Chroma(NamedTuple):
    """The chroma of a term: p (2, …), and its strength m (…), None where that is |p|."""

    p: Array
    strength: Array | None = None


@record
class StackRules:
    """Everything that decides how the pixels of a stack become one: no pixels, no files.

    `operators[i]` puts layer i on those below it (None for layer 0); `opacities` are in [0, 1];
    `background` is straight linear RGB; `exposure` is in stops. `space` is that of reports;
    `primaries` are those of all RGB. `weave`: the pattern of woven blending.
    """

    operators: tuple[porter_duff.Operator | None, ...]
    opacities: tuple[float, ...]
    blending: Blending
    order: orders.Order
    space: spaces.Space
    hue_tolerance: float
    gray_bias: float
    background: tuple[float, ...] | None
    exposure: float
    primaries: Primaries
    strength: Strength
    weave: Weave

    def in_primaries(self, primaries: Primaries) -> StackRules:
        """The same rules in other primaries; `MismatchError` where blue, say, has no luminance."""
        if primaries == self.primaries:
            return self
        rgb_to_xyz = to_xyz(primaries)
        if min(rgb_to_xyz[1]) <= 0:
            raise MismatchError(
                f"the primaries {primaries.name} have one whose luminance is not above 0, which no "
                "blending space can do with: name others with --primaries, such as acescg"
            )
        background = self.background
        if background is not None:
            color = converted(np.array(background), self.primaries, primaries)
            background = tuple(color.tolist())
        space = spaces.space(self.space.name, rgb_to_xyz)
        return replace(self, primaries=primaries, space=space, background=background)

    def keep(self, front: Chroma, behind: Chroma) -> addition.Pair:
        """What the blending keeps of two; only `foremost` asks who is in front."""
        assert self.blending.keep is not None
        strengths = None
        if front.strength is not None and behind.strength is not None:
            strengths = front.strength, behind.strength
        return self.blending.keep(front.p, behind.p, self.hue_tolerance, self.gray_bias, strengths)

    def keep_of_many(self, terms: Chroma, phase: Array | None = None) -> Array:
        """What the blending keeps of each of p (n, 2, …), added at once.

        `phase` (…): that of the weave, where the blending depends on it.
        """
        return self.blending.keep_of_many(
            terms.p, self.hue_tolerance, self.gray_bias, terms.strength, phase
        )

    def add(self, front: Chroma, behind: Chroma) -> Chroma:
        """⊕ of two, or what else the blending is."""
        return sum_of_chromas((front, behind), self.keep(front, behind))

    def add_all(self, terms: Sequence[Chroma], phase: Array | None = None) -> Chroma:
        """All of them at once."""
        return sum_of_chromas(terms, tuple(self.keep_of_many(stacked(terms), phase)))

    @cached_property
    def needed_everywhere(self) -> frozenset[int]:
        """The numbers of the layers that do something where they have no pixels.

        That is the bottom, on which all others come, and those that erase what lies outside.
        """
        return frozenset(
            number
            for number, row in enumerate(self.operators)
            if row is None or not row.keeps_outside
        )

    def of_layers(self, numbers: Sequence[int]) -> StackRules:
        """The same rules for some of the layers, the bottom first; their order is that of all."""
        if len(numbers) == len(self.operators):
            return self
        return replace(
            self,
            operators=tuple(self.operators[number] for number in numbers),
            opacities=tuple(self.opacities[number] for number in numbers),
        )

    def __hash__(self) -> int:
        # Of little: those of thousands of layers are asked for again and again.
        return hash((len(self.operators), self.blending.name, self.order.name, self.space.name))

    @property
    def front_to_back(self) -> tuple[int, ...]:
        """The layers' numbers from front to back, as their operators put them there."""
        stacked: tuple[int, ...] = ()
        for number, row in enumerate(self.operators):
            here = (number,)
            front, behind = (here, stacked) if row is None else row.front_first(here, stacked)
            stacked = front + behind
        return stacked

    @property
    def adding_order(self) -> orders.Order:
        """The order in which terms, bottom first, are added: the stack's, where it matters."""
        if self.blending.depends_on_depth:
            return orders.order(self.front_to_back, len(self.operators))
        return orders.ORDERS["simultaneous"] if self.blending.depends_on_place else self.order

    @property
    def blending_space(self) -> spaces.Space:
        """The space in which p adds: + gives one picture in all, which only linear maps give."""
        plain = self.blending is BLENDINGS["traditional"]
        if not plain or self.space.linear:
            return self.space
        return spaces.space("linear-rgb", self.space.rgb_to_xyz)

    def blended(self, name: str) -> StackRules:
        """The same rules with another blending, by its name."""
        return replace(self, blending=BLENDINGS[name])

    @property
    def bounded(self) -> bool:
        """Whether results are brought back into gamut: not where they cannot leave it."""
        return self.blending.depends_on_place or not self.blending_space.linear

    @property
    def reduction(self) -> Reduction:
        """The leanest way to reduce this stack while its layers arrive."""
        if self.blending.depends_on_place:
            return Reduction.ALL_LAYERS
        one_way = len(self.operators) == 1 or not self.blending.depends_on_order
        if one_way or self.order is orders.ORDERS["bottom-up"]:
            return Reduction.BOTTOM_UP
        only_over = all(row is None or row.name == "over" for row in self.operators)
        if self.order is orders.ORDERS["top-down"] and only_over:
            return Reduction.FRONT_TO_BACK
        return Reduction.ALL_LAYERS

    @property
    def arrival(self) -> Sequence[int]:
        """The layers' numbers in the order in which an engine takes them."""
        numbers = range(len(self.operators))
        return numbers[::-1] if self.reduction is Reduction.FRONT_TO_BACK else numbers


def stacked(terms: Sequence[Chroma]) -> Chroma:
    """Terms as planes: p (n, 2, …), m (n, …)."""
    strengths = [term.strength for term in terms if term.strength is not None]
    return Chroma(np.stack([term.p for term in terms]), np.stack(strengths) if strengths else None)


def sum_of_chromas(terms: Sequence[Chroma], kept: Sequence[Array | float]) -> Chroma:
    """The sum of those of which factors (…) are kept; what has no hue left has no strength."""
    p = addition.added([term.p for term in terms], kept)
    strengths = [term.strength for term in terms if term.strength is not None]
    if not strengths:
        return Chroma(p)
    return Chroma(p, np.where((p != 0).any(axis=0), addition.added(strengths, kept), 0))


def check_exposure(stops: float) -> float:
    """The exposure as a float; `SettingError` beyond `MAX_STOPS`."""
    if not abs(stops) <= MAX_STOPS:
        raise SettingError(f"exposure {stops:g} is outside -{MAX_STOPS} to {MAX_STOPS} stops")
    return float(stops)


def checked_rules(
    ops: Sequence[str | None],
    opacities: Sequence[float],
    *,
    blending: str,
    order: str | Sequence[int],
    space: str,
    hue_tolerance: float,
    gray_bias: float,
    background: Sequence[float] | None,
    exposure: float,
    primaries: str,
    strength: str,
    weave: str,
    weave_size: int,
) -> StackRules:
    """The rules of a stack of layers with these operators, None first, and opacities.

    Names are looked up, and what is about single layers is checked; `options` checks the rest.
    """
    if None in ops[1:]:
        raise SettingError(f"layer {ops.index(None, 1)} has no operator: name one such as 'over'")
    if ops[0] is not None:
        raise SettingError(
            f"layer 0 is the bottom, with nothing below it for '{ops[0]}' to act on: "
            "leave its operator out"
        )
    for number, value in enumerate(opacities):
        if not 0 <= value <= 1:
            raise SettingError(f"layer {number}: opacity {value:g} is outside 0 to 1")
    working = working_primaries(primaries)
    return StackRules(
        operators=tuple(None if name is None else porter_duff.operator(name) for name in ops),
        opacities=tuple(float(value) for value in opacities),
        blending=blendings.blending(blending),
        order=orders.order(order, len(ops)),
        space=spaces.space(space, to_xyz(working)),
        hue_tolerance=hue_tolerance,
        gray_bias=gray_bias,
        background=None if background is None else tuple(float(v) for v in background),
        exposure=exposure,
        primaries=working,
        strength=strengths.strength(strength),
        weave=Weave.of(weave, weave_size),
    )
