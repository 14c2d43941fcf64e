"""Back into gamut: results of ⊕ in a space whose maps are not linear, and colours for a file.

With lo = Σ w_i·min(0, min c_i) and hi = Σ w_i·max(α_i, max c_i) of the terms w_i c_i, every channel
of Σ w_i c_i is within [lo, hi]. Once, after the reduction, a colour beyond them goes straight in
linear RGB towards the grey of its luminance, no farther than into that range. Not along p: that is
a curve there, which may leave the range and come back, so that colours that hardly differ would end
far apart. What this turns the hue by is the space's `gamut_turn`. In a linear space ⊕ stays inside.
`into_gamut` takes the same way into [0, 1], for straight colours that a file cannot hold.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .primaries import REC709, Primaries, to_xyz
from .spaces import Space

Array = NDArray[np.floating[Any]]
Float64 = NDArray[np.float64]


def bounds_of(space: Space, rgb: Array, alpha: Array | float = 0.0) -> Array:
    """(2, …): lo and hi of one term, for rgb (3, …) and α (…); (0, …) in a linear space.

    Weights scale them, and they add, as the luminance does. Where α is not known it is 0.
    """
    if space.linear:
        return np.empty((0, *rgb.shape[1:]), rgb.dtype)
    bounds = np.empty((2, *rgb.shape[1:]), rgb.dtype)
    np.minimum(rgb.min(axis=0), 0, out=bounds[0])
    np.maximum(rgb.max(axis=0), alpha, out=bounds[1])
    return bounds


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


def into_gamut(straight: Float64, primaries: Primaries = REC709) -> Float64:
    """(n, 3), linear, straight → the same luminance and hue with every channel in [0, 1].

    Chroma is scaled by the largest factor that fits; luminance above 1 gives white, below 0 black.
    """
    red, green, blue = straight.T
    w_red, w_green, w_blue = to_xyz(primaries)[1]
    luminance = np.clip(w_red * red + w_green * green + w_blue * blue, 0, 1)[:, None]
    infinite = ~np.isfinite(straight).all(axis=1, keepdims=True)
    luminance[np.isnan(luminance)] = 1
    difference = np.where(infinite, 0, straight - luminance)
    room = np.where(difference > 0, 1 - luminance, luminance)
    fits = np.ones_like(difference)
    np.divide(room, np.abs(difference), out=fits, where=np.abs(difference) > room)
    return luminance + fits.min(axis=1, keepdims=True) * difference
