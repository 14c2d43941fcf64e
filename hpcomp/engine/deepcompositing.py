"""Deep samples to flat pixels by the active engine: ⊕ of what `deepsamples` sorts. No files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..blending import deepsamples
from ..blending.blendings import BLENDINGS
from ..blending.deepsamples import DeepSamples, Floats, Ints
from ..blending.orders import ORDERS
from ..blending.porter_duff import operator
from ..blending.rules import Reduction, StackRules
from ..blending.terms import color_of, layer_term, sums_of_runs
from ..color.primaries import REC709, Primaries
from ..color.quantization import Losses
from ..color.samples import OUTPUT_TYPES, Samples, Strip
from ..geometry import Window
from ..records import record
from . import choice as engine

#: Samples in one place up to which pixels with as many are stacks, side by side. More are added run
#: by run, which takes longer for few and no memory but for the samples of a run.
MOST_SIDE_BY_SIDE = 32
#: Memory that a sample of such a run takes beside what adding them all takes: as a piece of a split
#: sample, and as a term.
RUN_SAMPLE_BYTES = 320

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
    window: Window | None = None,
) -> Samples:
    """The pixels (pixels, 4) as samples of that kind; codes are of that gamut.

    `rules`: of a stack of any height. In a pixel the farthest sample is the bottom. `go_on` is
    called now and then, and may raise. `window`: where the pixels are, row by row, from the corner
    of the canvas on; one row of it if None.
    """
    form = _Form(kind, losses, gamut)
    with np.errstate(all="ignore"):  # NaN and Inf may have been let through
        if rules.blending.depends_on_place:
            # What is merged has one hue, which would be woven once more: all samples are terms.
            phases = rules.weave.phases_in(window or Window(0, 0, len(samples.counts), 1))
            seen = deepsamples.seen(samples)
            return _composited(*seen, rules, "plus", form, go_on, phases)
        merge = partial(_merged_colors, _coincident_rules(rules), go_on)
        visible = deepsamples.visible(*deepsamples.tidied(samples, merge))
    return _composited(*visible, rules, "over", form, go_on)


def bytes_to_reduce(rules: StackRules, samples: int, has_volumes: bool) -> int:
    """Memory that a pixel of so many samples takes beside these, at most."""
    if rules.blending.depends_on_place:
        return max(_bytes_to_stack(rules, "plus", samples), samples * RUN_SAMPLE_BYTES)
    pieces = 2 * samples if has_volumes else samples
    of_stack = _bytes_to_stack(rules, "over", pieces)
    at_one_place = min(samples, MOST_SIDE_BY_SIDE)
    of_place = _bytes_to_stack(_coincident_rules(rules), "plus", at_one_place)
    of_run = 0
    if samples > MOST_SIDE_BY_SIDE:
        of_run = samples * RUN_SAMPLE_BYTES + engine.active().bytes_to_keep(samples)
    return max(of_stack, of_place, of_run)


def _bytes_to_stack(rules: StackRules, op: str, samples: int) -> int:
    """Memory that the stack of a pixel of so many samples takes beside these."""
    layers = int(deepsamples.stack_heights(np.array([samples]))[0])
    of_height = _of_height(rules, op, layers)
    reducing = engine.active().bytes_to_reduce(of_height, layers)
    return reducing + _layers_at_once(of_height, layers) * LAYER_BYTES


@record
class _Form:
    """What samples are made, as an accumulator's `result` takes it."""

    kind: str
    losses: Losses
    gamut: Primaries


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
        form = _Form("float", Losses(), rules.primaries)
        return _composited(counts, rgba, rules, "plus", form, go_on)

    long = counts > MOST_SIDE_BY_SIDE
    if not long.any():
        return add(counts, rgba)
    of_long = np.repeat(long, counts)
    made = np.empty((len(counts), 4), np.float32)
    made[~long] = add(counts[~long], rgba[~of_long])
    made[long] = _added_run_by_run(rules, go_on, counts[long], rgba[of_long])
    return made


def _added_run_by_run(
    rules: StackRules, go_on: Callable[[], None], counts: Ints, rgba: Floats
) -> Floats:
    """Each run as one sample (runs, 4), however long."""
    by, space = engine.active(), rules.blending_space
    made = np.empty((len(counts), 4), np.float32)
    pairs = np.cumsum(counts.astype(np.int64) ** 2)
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        go_on()
        most = (pairs[begin - 1] if begin else 0) + by.pairs_at_once
        end = max(begin + 1, int(np.searchsorted(pairs, most, side="right")))
        of_runs = slice(ends[begin] - counts[begin], ends[end - 1])
        terms, alpha = layer_term(rules, 1.0, rgba[of_runs].astype(float))
        strengths = None if terms.strength is None else terms.strength.astype(float)
        lengths = counts[begin:end].astype(np.int64)
        kept = by.keep_runs(rules, lengths, terms.p.astype(float), strengths)
        first = ends[begin:end] - counts[begin:end] - of_runs.start
        runs = sums_of_runs(terms, kept, first, space)
        made[begin:end, :3] = color_of(space, runs).T
        made[begin:end, 3] = np.minimum(np.add.reduceat(alpha, first), 1)
        begin = end
    return made


def _composited(
    counts: Ints,
    rgba: Floats,
    rules: StackRules,
    op: str,
    form: _Form,
    go_on: Callable[[], None],
    phases: NDArray[np.float32] | None = None,
) -> Samples:
    """The samples of each pixel, front first, as a stack with that operator: (pixels, 4).

    `phases` (pixels): of the weave, where there is one.
    """
    made: Samples = np.empty((len(counts), 4), OUTPUT_TYPES[form.kind])
    for pixels, stack in deepsamples.layers(counts, rgba):
        height = len(stack)
        of_height = _of_height(rules, op, height)
        arrival, layers_at_once = list(of_height.arrival), _layers_at_once(of_height, height)
        pixels_at_once = len(pixels)
        if of_height.order is ORDERS["simultaneous"]:  # which takes the square of the height
            pixels_at_once = max(1, engine.active().pairs_at_once // height**2)
        for first in range(0, len(pixels), pixels_at_once):
            go_on()
            part = slice(first, first + pixels_at_once)
            of_part = None if phases is None else phases[pixels[part]]
            accumulator = engine.start(of_height, len(pixels[part]), 1, phases=of_part)
            for begin in range(0, height, layers_at_once):
                numbers = arrival[begin : begin + layers_at_once]
                accumulator.add(numbers, [Strip(stack[number, part][None]) for number in numbers])
            made[pixels[part]] = accumulator.result(form.kind, form.losses, form.gamut)[0]
    return made


def _of_height(rules: StackRules, op: str, height: int) -> StackRules:
    """The rules of a stack of so many samples."""
    operators = (None, *[operator(op)] * (height - 1))
    return replace(rules, operators=operators, opacities=(1.0,) * height)


def _layers_at_once(rules: StackRules, layers: int) -> int:
    """How many of them an accumulator takes at a time."""
    return layers if rules.reduction is Reduction.ALL_LAYERS else min(layers, FOLDED_AT_ONCE)
