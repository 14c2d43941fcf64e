"""Where rounding decides what comes out: the oracle is asked again with its layers moved by roundings."""

from __future__ import annotations

import random

import numpy as np
import oracle

#: Units of the two precisions.
ROUNDINGS = {np.float64: 1e-15, np.float32: 6e-8}
#: A result that moves by more than this share of its tolerance is no longer compared.
SHARE = 1 / 8
TRIES = 4


def is_steady(result_of, layers, dtype, allowed):
    """Whether roundings in each component of the layers move the result by a share of `allowed`.

    `result_of`: the components of the result, of layers. Strength has such places: where what is left
    of strengths that cancel each other meets a term that has none, or where 1 − α is nothing but for
    a rounding.
    """
    rounding, generator = ROUNDINGS[dtype], random.Random(1)
    expected = result_of(layers)
    for _ in range(TRIES):
        moved = [
            tuple(component * (1 + rounding * generator.choice((-1, 1))) for component in layer)
            for layer in layers
        ]
        change = max(abs(a - b) for a, b in zip(result_of(moved), expected, strict=True))
        if change > SHARE * allowed:
            return False
    return True


def has_luminance(layers):
    """Whether Y of no layer is what is left of channels that cancel each other.

    In Oklab and CIELAB |p| is bounded by Y: whether such a colour is alone, and comes out as it went in,
    would be decided by the rounding of Y.
    """
    return all(
        abs(oracle.luminance(c)) >= 0.1 * oracle.luminance(tuple(map(abs, c[:3]))) for c in layers
    )
