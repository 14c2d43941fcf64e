"""Deep samples to flat pixels by the active engine: ⊕ of what `deepsamples` sorts. No files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ..blending import deepsamples
from ..blending.addition import BLENDINGS
from ..blending.deepsamples import DeepSamples, Floats, Ints
from ..blending.orders import ORDERS
from ..blending.porter_duff import operator
from ..blending.rules import Reduction, StackRules
from ..color.primaries import REC709, Primaries
from ..color.quantization import Losses
from ..color.samples import OUTPUT_TYPES, Samples, Strip
from . import choice as engine

#: Samples in one place that are added at once; what that takes grows faster than their number. More
#: are sorted by hue, and then every so many neighbours are one, which keeps groups of one hue
#: together and does not depend on the order of samples either.
MOST_AT_ONCE = 32

#: Layers of a stack that are there at a time, where they fold, and what one takes but for samples.
FOLDED_AT_ONCE = 256
LAYER_BYTES = 1200


def flat(
    samples: DeepSamples,
    rules: StackRules,
    kind: str,
    losses: Losses,
    gamut: Primaries = REC709,
    go_on: Callable[[], None] = lambda: None,
) -> Samples:
    """The pixels (pixels, 4) as samples of that kind; codes are of that gamut.

    `rules`: of a stack of any height. In a pixel the farthest sample is the bottom. `go_on` is
    called now and then, and may raise.
    """
    merge = partial(_merged_colors, _coincident_rules(rules), go_on)
    with np.errstate(all="ignore"):  # NaN and Inf may have been let through
        counts, rgba = deepsamples.visible(*deepsamples.tidied(samples, merge))
    return _composited(counts, rgba, rules, "over", kind, losses, gamut, go_on)


def bytes_to_reduce(rules: StackRules, samples: int, has_volumes: bool) -> int:
    """Memory that a pixel of so many samples takes beside these, at most."""
    pieces = 2 * samples if has_volumes else samples
    height = int(deepsamples.stack_heights(np.array([pieces]))[0])
    of_stack, of_place = (
        engine.active().bytes_to_reduce(of, layers) + _layers_at_once(of, layers) * LAYER_BYTES
        for of, layers in ((rules, height), (_coincident_rules(rules), min(samples, MOST_AT_ONCE)))
    )
    return max(of_stack, of_place)


def _coincident_rules(rules: StackRules) -> StackRules:
    """How samples at one place add: all at once, as none is in front.

    `foremost` has nothing to choose by, and adds as hue-preserving does.
    """
    blending = rules.blending
    if blending.depends_on_depth:
        blending = BLENDINGS["hue-preserving"]
    return replace(
        rules, blending=blending, order=ORDERS["simultaneous"], background=None, exposure=0.0
    )


def _merged_colors(
    rules: StackRules, go_on: Callable[[], None], counts: Ints, rgba: Floats
) -> Floats:
    """Each run as one sample (runs, 4)."""

    def add(counts: Ints, rgba: Floats) -> Floats:
        return _composited(counts, rgba, rules, "plus", "float", Losses(), rules.primaries, go_on)

    large = counts > MOST_AT_ONCE
    if not large.any():
        return add(counts, rgba)
    of_large = np.repeat(large, counts)
    made = np.empty((len(counts), 4), np.float32)
    made[~large] = add(counts[~large], rgba[~of_large])
    colors, lengths = rgba[of_large], counts[large]
    _, p = rules.blending_space.forward(colors[:, :3].T.astype(float))
    run = np.repeat(np.arange(len(lengths)), lengths)
    by_hue = np.lexsort((*colors.T, np.arctan2(p[1], p[0]), run))
    groups = -(-lengths // MOST_AT_ONCE)
    group = np.arange(groups.sum()) - np.repeat(np.cumsum(groups) - groups, groups)
    size, longer = np.repeat(lengths // groups, groups), np.repeat(lengths % groups, groups)
    added = add(size + (group < longer), colors[by_hue])
    made[large] = _merged_colors(rules, go_on, groups, added)
    return made


def _composited(
    counts: Ints,
    rgba: Floats,
    rules: StackRules,
    op: str,
    kind: str,
    losses: Losses,
    gamut: Primaries,
    go_on: Callable[[], None],
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
        arrival, layers_at_once = list(of_height.arrival), _layers_at_once(of_height, height)
        pixels_at_once = len(pixels)
        if of_height.order is ORDERS["simultaneous"]:  # which takes the square of the height
            pixels_at_once = max(1, engine.active().pairs_at_once // height**2)
        for first in range(0, len(pixels), pixels_at_once):
            go_on()
            part = slice(first, first + pixels_at_once)
            accumulator = engine.start(of_height, len(pixels[part]), 1)
            for begin in range(0, height, layers_at_once):
                numbers = arrival[begin : begin + layers_at_once]
                accumulator.add(numbers, [Strip(stack[number, part][None]) for number in numbers])
            made[pixels[part]] = accumulator.result(kind, losses, gamut)[0]
    return made


def _layers_at_once(rules: StackRules, layers: int) -> int:
    """How many of them an accumulator takes at a time."""
    return layers if rules.reduction is Reduction.ALL_LAYERS else min(layers, FOLDED_AT_ONCE)
