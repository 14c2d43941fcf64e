"""Back into gamut: what ⊕ takes beyond it in a space whose maps are not linear.

With lo = Σ w_i·min(0, min c_i) and hi = Σ w_i·max(α_i, max c_i) of the terms w_i c_i, every channel
of Σ w_i c_i is within [lo, hi]. Once, after the reduction, a colour beyond them goes straight in
linear RGB towards the grey of its luminance, no farther than into that range. Not along p: that is
a curve there, which may leave the range and come back, so that colours that hardly differ would end
far apart. What this turns the hue by is the space's `gamut_turn`. In a linear space ⊕ stays inside.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .spaces import Space

Array = NDArray[np.floating[Any]]


def bounds_of(space: Space, rgb: Array, alpha: Array | float = 0.0) -> Array:
    """(2, …): lo and hi of one term, for rgb (3, …) and α (…); (0, …) in a linear space.

    Weights scale them, and they add, as the luminance does. Where α is not known it is 0.
    """
    if space.linear:
        return np.empty((0, *rgb.shape[1:]), rgb.dtype)
    found = np.empty((2, *rgb.shape[1:]), rgb.dtype)
    np.minimum(rgb.min(axis=0), 0, out=found[0])
    np.maximum(rgb.max(axis=0), alpha, out=found[1])
    return found


def colors_within(space: Space, luminance: Array, p: Array, bounds: Array) -> Array:
    """rgb (3, n) of Y (n) and p (2, n), within `bounds` (2, n)."""
    rgb = space.inverse(luminance, p)
    if space.linear:
        return rgb
    lo, hi = bounds
    # Rounding may have taken a luminance itself beyond them.
    above, below = np.maximum(hi - luminance, 0), np.maximum(luminance - lo, 0)
    most, least = rgb.max(axis=0) - luminance, luminance - rgb.min(axis=0)
    t = np.ones_like(luminance)
    np.divide(above, most, out=t, where=most > above)
    np.minimum(t, np.divide(below, least, out=np.ones_like(t), where=least > below), out=t)
    moved = t < 1
    if moved.any():
        rgb[:, moved] = luminance[moved] + t[moved] * (rgb[:, moved] - luminance[moved])
    return rgb
