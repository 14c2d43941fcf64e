"""How the chroma of colours is added: the hue-preserving ⊕, and what it is compared with.

Luminances always add [R1]; here are only the chroma vectors `p` (2, …), planes first, in any
blending space. Every angle is between p vectors. The first of two vectors is that of the colour in
front, which only `foremost` asks. What competes are strengths m (…): |p| where none are given.
Chuang, Weiskopf, Möller: Hue-Preserving Color Blending, 2009; R1–R3 are its requirements.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..color.planes import ratio
from ..errors import SettingError

Array = NDArray[np.floating[Any]]
#: Two factors.
Pair = tuple[Array, Array]

#: Two shadings of one pale label, stored in 8 bits, differ by up to this many degrees.
DEFAULT_HUE_TOLERANCE = 2.0

#: The hues that count as equal at tolerance 0, in radians: what float rounding turns a vector by.
ROUNDING_ANGLE = 1e-4

#: Above what float32 rounding changes in the cosine of two unit vectors.
COSINE_ROUNDING = 1e-5

#: Terms of a pixel up to which all pairs of them are tabled, for several pixels side by side.
MOST_TABLED = 64
#: Shoulders that are tabled at a time, of some terms and all others, where a pixel has more terms;
#: and how many arrays of that size, of doubles, there are meanwhile.
SHOULDERS_AT_ONCE = 1 << 20
SHOULDER_ARRAYS = 12

#: The largest tolerance, in degrees: at 90 the shoulder reaches the opposite hue.
MAX_HUE_TOLERANCE = 90.0


def check_hue_tolerance(degrees: float) -> float:
    """The tolerance as a float; `SettingError` outside [0, 90] degrees."""
    if not 0 <= degrees <= MAX_HUE_TOLERANCE:
        raise SettingError(
            f"hue tolerance {degrees:g} is outside 0 to {MAX_HUE_TOLERANCE:g} degrees"
        )
    return float(degrees)


def check_gray_bias(bias: float) -> float:
    """The bias as a float; `SettingError` outside [0, 1]."""
    if not 0 <= bias <= 1:
        raise SettingError(f"gray bias {bias:g} is outside 0 to 1")
    return float(bias)


def chroma(p: Array) -> Array:
    """|p| (…) of p (2, …), however long: nothing overflows on the way."""
    return np.hypot(p[0], p[1])


def shoulder(p1: Array, p2: Array, hue_tolerance: float) -> Array:
    """How far two hues count as equal: e (…) in [0, 1], for p (2, …).

    1 up to `hue_tolerance` degrees, or what rounding turns a vector by, 0 from twice that on, a
    smoothstep between. At tolerance 0 a hard switch at `ROUNDING_ANGLE`. A vector without hue
    (p = 0) is equal to any.
    """
    m1, m2 = chroma(p1), chroma(p2)
    # Unit vectors, so that neither tiny nor huge colours leave the range of the type.
    x1, y1 = ratio(p1, m1)
    x2, y2 = ratio(p2, m2)
    cosine = x1 * x2 + y1 * y2
    e = ((m1 == 0) | (m2 == 0)).astype(cosine.dtype)
    # Few pixels lie near the switch: only they need the angle itself.
    switch_end = max(math.radians(2 * hue_tolerance), 2 * ROUNDING_ANGLE)
    near = (cosine >= math.cos(switch_end) - COSINE_ROUNDING) & (e == 0)
    angle = np.arctan2(np.abs(x1[near] * y2[near] - y1[near] * x2[near]), cosine[near])
    e[near] = _shoulder_of(angle, hue_tolerance)
    return e


def _shoulder_of(angle: Array, hue_tolerance: float) -> Array:
    """e (…) of hues at an angle in [0, π]; no tolerance but 0 is below that of rounding."""
    if hue_tolerance == 0:
        return (angle <= ROUNDING_ANGLE).astype(angle.dtype)
    t = np.clip(angle / max(math.radians(hue_tolerance), ROUNDING_ANGLE) - 1, 0, 1)
    return 1 - t * t * (3 - 2 * t)


def _biased(share: Array, gray_bias: float) -> Array:
    """What a bias b against grey makes of the share (…), in [0, 1], that a rival cancels."""
    return share ** (1 + 3 * gray_bias) if gray_bias else share


def competing(p: Array, strengths: Array | None) -> Array:
    """What competes: m (n, …) of p (n, 2, …), or |p| where there are no strengths, or all are 0."""
    lengths = chroma(p.swapaxes(0, 1))
    if strengths is None:
        return lengths
    return np.where((strengths == 0).all(axis=0), lengths, strengths)


def keep_hue(
    p1: Array,
    p2: Array,
    hue_tolerance: float,
    gray_bias: float = 0.0,
    strengths: Pair | None = None,
) -> Pair:
    """⊕ of two chroma vectors (2, …): the hue of the stronger one survives.

    The weaker one cancels its own strength of it, or less with a bias against grey in [0, 1].
    Chuang et al. 2009, Algorithm 1 in closed form; opposite colours are never formed, so nothing
    leaves the gamut on the way.
    """
    m1, m2 = chroma(p1), chroma(p2)
    unknown = ~(np.isfinite(m1) & np.isfinite(m2))
    if strengths is not None:
        m1, m2 = competing(np.stack([p1, p2]), np.stack(strengths))
        unknown |= ~(np.isfinite(m1) & np.isfinite(m2))
    m_big, m_small = np.maximum(m1, m2), np.minimum(m1, m2)
    kept = ratio(m_big - m_small, m_big)
    if gray_bias:
        kept = 1 - _biased(ratio(m_small, m_big), gray_bias)
    e = shoulder(p1, p2, hue_tolerance)
    kept = np.minimum(kept + e * (1 - kept), 1)  # [R3][D3]
    first = m1 >= m2
    a, b = np.where(first, kept, e), np.where(first, e, kept)  # [R2]
    return np.where(unknown, 1, a), np.where(unknown, 1, b)


def keep_all(
    p1: Array,
    p2: Array,
    hue_tolerance: float,
    gray_bias: float = 0.0,
    strengths: Pair | None = None,
) -> Pair:
    """Plain + of two chroma vectors (2, …); nothing else has a part in it."""
    ones = np.ones(p1.shape[1:], p1.dtype)
    return ones, ones


def keep_foremost(
    front: Array,
    behind: Array,
    hue_tolerance: float,
    gray_bias: float = 0.0,
    strengths: Pair | None = None,
) -> Pair:
    """The chroma (2, …) in front, or what is behind where there is none in front.

    A baseline: what Chuang et al. 2009, section 7, say of Wang et al. 2008. Not continuous: the
    least chroma in front decides. Tolerance, bias and strengths have no part in it.
    """
    a = (front != 0).any(axis=0)
    unknown = ~(np.isfinite(front) & np.isfinite(behind)).all(axis=0)
    return (a | unknown).astype(front.dtype), (~a | unknown).astype(front.dtype)


def keep_hues(
    p: Array,
    hue_tolerance: float,
    gray_bias: float = 0.0,
    strengths: Array | None = None,
    phase: Array | None = None,
) -> Array:
    """⊕ of many chroma vectors at once, p (n, 2, …), whatever their order.

    Each term is scaled down by its strongest rival of another hue. Terms without chroma are kept
    as they are, and the cost follows the number of the others, pixel by pixel.
    """
    n, _, *shape = p.shape
    flat = p.reshape(n, 2, -1)
    m = competing(flat, None if strengths is None else strengths.reshape(n, -1))
    size = m if strengths is None else chroma(flat.swapaxes(0, 1))
    has_hue = (size > 0) & (np.isfinite(size) & np.isfinite(m)).all(axis=0)
    counts = has_hue.sum(axis=0)
    first = np.argsort(~has_hue, axis=0, kind="stable")
    kept = np.ones((n, flat.shape[2]), p.dtype)
    for count in np.unique(counts[counts > 1]):
        pixels = np.flatnonzero(counts == count)
        if count > MOST_TABLED:
            for pixel in pixels:
                numbers = first[:count, pixel]
                share, _ = strongest_rivals(
                    flat[numbers, :, pixel].T, hue_tolerance, gray_bias, m[numbers, pixel]
                )
                kept[numbers, pixel] = 1 - share
            continue
        # The pair tables hold count² values a pixel: short runs keep them in cache.
        for run in np.array_split(pixels, max(1, len(pixels) * count**2 >> 18)):
            numbers = first[:count, run]
            terms = flat[numbers[:, None], np.arange(2)[None, :, None], run]
            cancelled = rivalry(terms, hue_tolerance, gray_bias, m[numbers, run])
            kept[numbers, run] = 1 - cancelled.max(axis=1)
    return kept.reshape(n, *shape)


def rivalry(
    p: Array, hue_tolerance: float, gray_bias: float = 0.0, strengths: Array | None = None
) -> Array:
    """(n, n, pixels): what share of term i its rival j would cancel; p (n, 2, pixels), |p| > 0."""
    n = len(p)
    m = competing(p, strengths)
    e = np.ones((n, n, p.shape[2]), p.dtype)
    for i in range(n):
        for j in range(i):
            e[i, j] = e[j, i] = shoulder(p[i], p[j], hue_tolerance)
    # support[i, j]: what backs i's hue and not j's. near[j]: the most that j's own hue can hold; it
    # vanishes with m_j and does not count terms, so that a vanishing term changes nothing.
    support = np.zeros_like(e)
    near = np.zeros_like(m)
    for k in range(n):
        support += (e[:, k] * m[k])[:, None] * (1 - e[:, k])[None, :]
        near += np.minimum(m, m[k])
    rival = np.minimum(support.swapaxes(0, 1), near[None, :])
    return (1 - e) * _biased(_cancelled(rival, support), gray_bias)


def _cancelled(rival: Array, support: Array) -> Array:
    """q (…) in [0, 1]: what a rival cancels of what has this support, all of what has none."""
    q = ratio(np.minimum(rival, support), support)
    q[(support == 0) & (rival > 0)] = 1
    return q


def bytes_to_keep(terms: int) -> int:
    """Memory that `keep_hues` takes beside p for a pixel of so many terms, at most."""
    return max(terms, min(terms**2, SHOULDERS_AT_ONCE)) * SHOULDER_ARRAYS * 8


def strongest_rivals(
    p: Array, hue_tolerance: float, gray_bias: float = 0.0, strengths: Array | None = None
) -> tuple[Array, NDArray[np.intp]]:
    """(n) each: what share of each term its strongest rival cancels, and which one that is.

    The first of several that are as strong, and any where the share is 0.
    p (2, n), every |p| > 0. As `rivalry` has it, of some terms at a time: neighbours in hue, which
    few others back. Supports are products of matrices of shoulders.
    """
    n = p.shape[1]
    hue = np.arctan2(*p[::-1].astype(float))
    m = competing(p.T.astype(float), None if strengths is None else strengths.astype(float))
    by_hue = np.argsort(hue, kind="stable")
    hue, m = hue[by_hue], m[by_hue]
    some = max(1, SHOULDERS_AT_ONCE // n)
    blocks = [slice(begin, min(begin + some, n)) for begin in range(0, n, some)]
    near = np.concatenate([np.minimum(m[block, None], m).sum(axis=1) for block in blocks])
    share, rival = np.zeros_like(m), np.full(n, n)

    def shoulders(block: slice) -> Array:
        angle = np.abs(hue[block, None] - hue)
        return _shoulder_of(np.minimum(angle, 2 * math.pi - angle), hue_tolerance)

    def support(own: Array, other: Array) -> Array:
        """[i, j]: what backs i's hue and not j's."""
        backs = own.any(axis=0)
        return (own[:, backs] * m[backs]) @ (1 - other[:, backs]).T

    def oppose(block: slice, others: slice, e: Array, backing: Array, opposed: Array) -> None:
        strength = np.minimum(opposed, near[others])
        cancelled = (1 - e) * _biased(_cancelled(strength, backing), gray_bias)
        most = cancelled.max(axis=1)
        first = np.where(cancelled == most[:, None], by_hue[others], n).min(axis=1)
        stronger = (most > share[block]) | ((most == share[block]) & (first < rival[block]))
        share[block][stronger], rival[block][stronger] = most[stronger], first[stronger]

    for number, block in enumerate(blocks):
        own = shoulders(block)
        for others in blocks[number:]:
            other = own if others is block else shoulders(others)
            supported, opposed = support(own, other), support(other, own)
            oppose(block, others, own[:, others], supported, opposed.T)
            if others is not block:
                oppose(others, block, other[:, block], opposed, supported.T)
    given = np.argsort(by_hue)
    return share[given], rival[given]


def keep_all_of_many(
    p: Array,
    hue_tolerance: float,
    gray_bias: float = 0.0,
    strengths: Array | None = None,
    phase: Array | None = None,
) -> Array:
    """Plain sum of many chroma vectors, p (n, 2, …)."""
    return np.ones((len(p), *p.shape[2:]), p.dtype)


def keep_foremost_of_many(
    p: Array,
    hue_tolerance: float,
    gray_bias: float = 0.0,
    strengths: Array | None = None,
    phase: Array | None = None,
) -> Array:
    """The first of many chroma vectors that is not 0, from the front, p (n, 2, …)."""
    has_hue = (p != 0).any(axis=1)
    before = np.cumsum(has_hue, axis=0) - has_hue
    unknown = ~np.isfinite(p).all(axis=(0, 1))
    return (before == 0) | unknown


def added(p: Sequence[Array], kept: Sequence[Array | float]) -> Array:
    """The sum (2, …) of chroma vectors, each (2, …), of which factors (…) are kept."""
    return sum((factor * of for factor, of in zip(kept, p, strict=True)), np.zeros_like(p[0]))
