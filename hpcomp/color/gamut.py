"""Back into gamut: results of ⊕ in a space whose maps are not linear, and colours for a file.

With lo = Σ w_i·min(0, min c_i) and hi = Σ w_i·max(α_i, max c_i) of the terms w_i c_i, every channel
of Σ w_i c_i is within [lo, hi]. Once, after the reduction, p of a colour beyond them is scaled by
the largest t ≤ 1 that puts the colour into that range: its luminance and its hue stay. In a linear
space ⊕ stays inside. `into_gamut` takes the same way into [0, 1], for straight colours that a file
cannot hold.

In RGB that way is a line, or in Oklab and CIELAB a curve. Some curves leave the range shortly
before their end and come back, to pure blue in Oklab and to yellows in CIELAB: no way keeps such
hues, leaves colours inside as they are, and is continuous too. So p is scaled into a range that is
wider by the space's `gamut_slack`, and a line in RGB goes the rest, which turns hues by up to
`Space.gamut_turn`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import spaces
from .spaces import Space

Array = NDArray[np.floating[Any]]
Float64 = NDArray[np.float64]

#: How often the interval that holds t is halved, and then cut by a secant.
HALVINGS, SECANTS = 10, 3

#: How far a colour of (Y, p) may be from the plain sum that it is, in its largest channel, or p in
#: luminances. Of float32; either is enough.
SAME_COLOR, SAME_P = 4e-6, 1.2e-6


def bounds_of(
    space: Space, rgb: Array, alpha: Array | float = 0.0, bounded: bool | None = None
) -> Array:
    """(2, …): lo and hi of one term, for rgb (3, …) and α (…); (0, …) where nothing is bounded.

    Weights scale them, and they add, as the luminance does. Where α is not known it is 0.
    `bounded`: that is so in spaces that are not linear, if nothing is said.
    """
    if not (not space.linear if bounded is None else bounded):
        return np.empty((0, *rgb.shape[1:]), rgb.dtype)
    bounds = np.empty((2, *rgb.shape[1:]), rgb.dtype)
    np.minimum(rgb.min(axis=0), 0, out=bounds[0])
    np.fmax(rgb.max(axis=0), alpha, out=bounds[1])  # an alpha that is NaN bounds nothing
    return bounds


def colors_within(space: Space, luminance: Array, p: Array, plain: Array, bounds: Array) -> Array:
    """rgb (3, n) of Y (n) and p (2, n), within `bounds` (2, n), or (0, n) where there are none.

    `plain` (3, n): the colour itself in a linear space. Else + of the colours that went in: it is
    the colour where it has that p, and where p is not finite, and then its zeros are exact.
    """
    if space.linear:
        if len(bounds):
            plain = plain.copy()
            _bring_within(space, plain, luminance, p, bounds)
        return plain
    rgb = space.inverse(luminance, p)
    rounding = np.finfo(p.dtype).eps / np.finfo(np.float32).eps
    size = np.abs(plain).max(axis=0)
    blended = np.abs(rgb - plain).max(axis=0) > SAME_COLOR * rounding * size
    apart = np.abs(space.forward(plain)[1] - p).max(axis=0)
    blended &= apart > SAME_P * rounding * (np.abs(luminance) + np.abs(p).max(axis=0))
    _bring_within(space, rgb, luminance, p, bounds)
    return np.where(blended, rgb, plain)


def into_gamut(straight: Float64, codes_space: Space | None = None) -> Float64:
    """(n, 3), linear, straight → the same luminance and hue with every channel in [0, 1].

    `codes_space`: that of the hue, for the primaries of the colours; the paper's for Rec. 709 by
    default. Its p is scaled by the largest factor that fits. Luminance above 1 gives white, below 0
    black.
    """
    codes_space = codes_space or spaces.space(spaces.DEFAULT_SPACE)
    rgb = straight.T.copy()
    w_red, w_green, w_blue = codes_space.rgb_to_xyz[1]
    luminance = w_red * rgb[0] + w_green * rgb[1] + w_blue * rgb[2]
    luminance = np.clip(np.where(np.isnan(luminance), 1, luminance), 0, 1)
    infinite = ~np.isfinite(rgb).all(axis=0)
    rgb[:, infinite] = luminance[infinite]
    p = codes_space.forward(rgb)[1]
    bounds = np.stack([np.zeros_like(luminance), np.ones_like(luminance)])
    _bring_within(codes_space, rgb, luminance, p, bounds)
    return rgb.T


def _bring_within(space: Space, rgb: Array, luminance: Array, p: Array, bounds: Array) -> None:
    """Brings rgb (3, n) of Y (n) and p (2, n) within `bounds` (2, n)."""
    if not space.straight:
        _scale_p(space, rgb, luminance, p, bounds)
    lo, hi = bounds
    # Rounding may have taken a luminance itself beyond them.
    above, below = np.maximum(hi - luminance, 0), np.maximum(luminance - lo, 0)
    most, least = rgb.max(axis=0) - luminance, luminance - rgb.min(axis=0)
    t = np.ones_like(luminance)
    np.divide(above, most, out=t, where=most > above)
    np.minimum(t, np.divide(below, least, out=np.ones_like(t), where=least > below), out=t)
    moved = t < 1
    if moved.any():
        inside = luminance[moved] + t[moved] * (rgb[:, moved] - luminance[moved])
        rgb[:, moved] = inside
    np.clip(rgb, lo, hi, out=rgb)  # rounding
    rgb += 0  # no -0


def _scale_p(space: Space, rgb: Array, luminance: Array, p: Array, bounds: Array) -> None:
    """Scales p of those of the colours that are beyond `bounds` and the space's slack."""
    slack_lo, slack_hi = space.gamut_slack
    lo, hi = bounds[0] - slack_lo * luminance, bounds[1] + slack_hi * luminance
    outside = (luminance > 0) & ((rgb.max(axis=0) > hi) | (rgb.min(axis=0) < lo))
    if not outside.any():
        return
    lo, hi, luminance, p = lo[outside], hi[outside], luminance[outside], p[:, outside]

    def excess(t: Array) -> Array:
        """How far the colour of t·p is outside; below 0 inside."""
        colors = space.inverse(luminance, t * p)
        return np.maximum(colors.max(axis=0) - hi, lo - colors.min(axis=0))

    near, far = np.zeros_like(luminance), np.ones_like(luminance)
    excess_near, excess_far = excess(near), excess(far)
    for turn in range(HALVINGS + SECANTS):
        across = excess_far - excess_near
        share = np.full_like(luminance, 0.5)
        if turn >= HALVINGS:
            np.divide(-excess_near, across, out=share, where=across > 0)
        t = near + (far - near) * share
        of_t = excess(t)
        inside = of_t <= 0
        near, far = np.where(inside, t, near), np.where(inside, far, t)
        excess_near = np.where(inside, of_t, excess_near)
        excess_far = np.where(inside, excess_far, of_t)
    rgb[:, outside] = space.inverse(luminance, t * p)
