"""Arithmetic that several modules do on planes of pixels: of p vectors, and of linear colours.

What is the same everywhere stands here, down to the order of operations. No spaces, no files.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]


def ratio(numerator: Array, denominator: Array) -> Array:
    """numerator / denominator, and 0 where the denominator is 0; no denominator is below 0."""
    quotient = np.zeros(np.broadcast_shapes(numerator.shape, denominator.shape), denominator.dtype)
    return np.divide(numerator, denominator, out=quotient, where=denominator > 0)


def length(p: Array) -> Array:
    """|p| (…) of p (2, …), as the kernel takes it: the squares of p have to be floats."""
    return np.sqrt(p[0] * p[0] + p[1] * p[1])


def cross_and_dot(p1: Array, p2: Array) -> tuple[Array, Array]:
    """|p1 × p2| and p1 · p2 (…) of p (2, …): the sine and cosine of their angle, times lengths."""
    dot = p1[0] * p2[0] + p1[1] * p2[1]
    return np.abs(p1[0] * p2[1] - p1[1] * p2[0]), dot


def spread_and_size(rgb: Array) -> tuple[Array, Array]:
    """max − min and max(|max|, |min|) (…) of the channels of rgb (3, …), linear, unbounded."""
    largest = np.maximum(np.maximum(rgb[0], rgb[1]), rgb[2])
    smallest = np.minimum(np.minimum(rgb[0], rgb[1]), rgb[2])
    return largest - smallest, np.maximum(np.abs(largest), np.abs(smallest))


def saturation(rgb: Array) -> Array:
    """The saturation (…) of rgb (3, …): its spread over its size; 0 for black."""
    return ratio(*spread_and_size(rgb))


def is_saturated(spread: Array, size: Array, achromatic: float) -> Mask:
    """Whether the saturation is `achromatic`, in [0, 1], or more; compared without a division."""
    return spread >= spread.dtype.type(achromatic) * size
