"""Deep samples to flat pixels by the active engine: ⊕ of what `deepsamples` sorts. No files."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from . import deepsamples, engine
from .addition import BLENDINGS
from .compositing import StackRules
from .deepsamples import DeepSamples, Floats, Ints
from .encoding import REC709, Losses, Primaries
from .orders import ORDERS
from .porter_duff import operator
from .samples import OUTPUT_TYPES, Samples, Strip


def flat(
    samples: DeepSamples, rules: StackRules, kind: str, losses: Losses, gamut: Primaries = REC709
) -> Samples:
    """The pixels (pixels, 4) as samples of that kind; codes are of that gamut.

    `rules`: of a stack of any height. In a pixel the farthest sample is the bottom.
    """
    merge = partial(_merged_colors, _coincident_rules(rules))
    with np.errstate(all="ignore"):  # NaN and Inf may have been let through
        counts, rgba = deepsamples.visible(*deepsamples.tidied(samples, merge))
    return _composited(counts, rgba, rules, "over", kind, losses, gamut)


def _coincident_rules(rules: StackRules) -> StackRules:
    """How samples at one place add: all at once, as none is in front.

    `foremost` has nothing to choose by, and takes the strongest.
    """
    blending = rules.blending
    if blending.depends_on_depth:
        blending = BLENDINGS["hue-preserving"]
    return replace(
        rules, blending=blending, order=ORDERS["simultaneous"], background=None, exposure=0.0
    )


def _merged_colors(rules: StackRules, counts: Ints, rgba: Floats) -> Floats:
    return _composited(counts, rgba, rules, "plus", "float", Losses(), rules.primaries)


def _composited(
    counts: Ints,
    rgba: Floats,
    rules: StackRules,
    op: str,
    kind: str,
    losses: Losses,
    gamut: Primaries,
) -> Samples:
    """The samples of each pixel, front first, as a stack with that operator: (pixels, 4)."""
    made: Samples = np.empty((len(counts), 4), OUTPUT_TYPES[kind])
    for pixels, stack in deepsamples.layers(counts, rgba):
        height = len(stack)
        of_height = replace(
            rules,
            operators=(None, *[operator(op)] * (height - 1)),
            opacities=(1.0,) * height,
        )
        accumulator = engine.start(of_height, len(pixels), 1)
        numbers = list(of_height.arrival)
        accumulator.add(numbers, [Strip(stack[number][None]) for number in numbers])
        made[pixels] = accumulator.result(kind, losses, gamut)[0]
    return made
