"""Mergeable hue histograms: how many pixels have which hue, and what stands out. No files, no text.

Sums are kept as whole numbers, so that a histogram of parts that are added in any order is the
histogram of the whole, to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..color import spaces
from ..color.hueaxis import HueAxis
from ..color.planes import is_saturated, length, spread_and_size
from ..errors import MismatchError, SettingError, unknown_name
from .defaults import DEFAULT_ACHROMATIC, DEFAULT_BINS, check_bins

Counts = NDArray[np.int64]
Floats = NDArray[np.floating[Any]]

#: What sums count in, and each pixel's value is rounded to: a float's own step below 1, and a
#: twentieth of the light between the two darkest codes of 16 bits.
SUM_UNIT = 2.0**-24
#: What a pixel adds to a sum at most, so that no picture of less than 2**27 pixels overflows one.
LARGEST_ADDEND = 4096.0
#: Pixels at a time: so many of the largest addends are summed exactly in a double.
BLOCK_PIXELS = 1 << 16

#: Bins this near to a peak, in degrees of the axis, are part of it.
PEAK_RADIUS_DEG = 2.0
#: Peaks with less of the chromatic pixels than this are not listed.
SMALLEST_PEAK = 0.01
#: The bin of a peak has so many times the pixels that are usual beside it, or it is a ripple of a
#: smear. Beside it is what is not its own, up to so many times its radius, and three bins at least.
PEAK_CONTRAST, BESIDE, FEWEST_BESIDE = 3, 3, 3

#: What the share of a hue can be a share of: pixels, their |p|, their alpha.
WEIGHTS = ("count", "chroma", "alpha")


@dataclass(frozen=True)
class Peak:
    """A hue that stands out: one that is more frequent than all others within 2° of it.

    `hue`: degrees, of the mean colour. `count`: pixels. `share`, `chroma_share`: of all chromatic
    pixels, and of their chroma. `rgb`: the mean colour, linear and straight.
    """

    hue: float
    count: int
    share: float
    chroma_share: float
    rgb: tuple[float, float, float]


@dataclass(frozen=True)
class Concentration:
    """How little a histogram is smeared.

    `share`, `chroma_share`: of the chromatic pixels, and of their chroma, what lies within 2° of
    the peaks. `entropy`: of the counts, in bits; `relative_entropy`: as a share of the most that so
    many bins can have, 0 for one hue and 1 for all hues alike.
    """

    share: float
    chroma_share: float
    entropy: float
    relative_entropy: float


@dataclass(frozen=True, eq=False)
class HueHistogram:
    """Pixels by hue: counts, and sums in units of `SUM_UNIT`; `a + b` and `sum` merge them.

    Bins are centred on multiples of their width, 360°/bins, on the hue axis of `space`.
    `count` (bins,): pixels; `chroma` (bins,): their |p|; `alpha` (bins,): their alpha in [0, 1];
    `rgb` (bins, 3): their linear, premultiplied colour; all int64.
    `grey`: pixels of no hue, whose saturation is 0 or below `achromatic`; `transparent`: without
    alpha and light; `nonfinite`: with NaN or Inf. Each pixel is counted once.
    Errors of merging: `MismatchError` where bins, space or achromatic differ.
    """

    space: str
    achromatic: float
    count: Counts
    chroma: Counts
    alpha: Counts
    rgb: Counts
    grey: int = 0
    transparent: int = 0
    nonfinite: int = 0

    @staticmethod
    def empty(
        bins: int = DEFAULT_BINS,
        space: str = spaces.DEFAULT_SPACE,
        achromatic: float = DEFAULT_ACHROMATIC,
    ) -> HueHistogram:
        """The histogram of no pixels. Errors: `SettingError`."""
        name = spaces.space(space).name
        check_bins(bins)
        if not 0 <= achromatic <= 1:
            raise SettingError(f"achromatic {achromatic:g} is outside 0 to 1")
        none = np.zeros(bins, np.int64)
        return HueHistogram(
            name, float(achromatic), none, none, none, np.zeros((bins, 3), np.int64)
        )

    def __add__(self, other: object) -> HueHistogram:
        if not isinstance(other, HueHistogram):
            return NotImplemented
        for what in ("bins", "space", "achromatic"):
            mine, theirs = getattr(self, what), getattr(other, what)
            if mine != theirs:
                raise MismatchError(
                    f"histograms of {what} {mine} and {theirs} cannot be added: "
                    f"make both with the same {what}"
                )
        return HueHistogram(
            self.space,
            self.achromatic,
            *(getattr(self, name) + getattr(other, name) for name in _TALLIES),
        )

    def __radd__(self, other: object) -> HueHistogram:
        # `sum` starts with 0.
        return self if other == 0 else NotImplemented

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HueHistogram) and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
        )

    @property
    def axis(self) -> HueAxis:
        """What the hues are measured on."""
        return spaces.space(self.space).hue_axis

    @property
    def bins(self) -> int:
        return len(self.count)

    @property
    def hues(self) -> Floats:
        """(bins,): the centres of the bins in degrees, from 0."""
        return np.arange(self.bins) * (360 / self.bins)

    @property
    def chromatic(self) -> int:
        """Pixels with a hue."""
        return int(self.count.sum())

    @property
    def pixels(self) -> int:
        """All pixels."""
        return self.chromatic + self.grey + self.transparent + self.nonfinite

    @property
    def occupied(self) -> int:
        """Bins with a pixel."""
        return int(np.count_nonzero(self.count))

    @property
    def chroma_sums(self) -> Floats:
        """(bins,): sums of |p|, linear."""
        return self.chroma * SUM_UNIT

    @property
    def alpha_sums(self) -> Floats:
        """(bins,): sums of alpha."""
        return self.alpha * SUM_UNIT

    @property
    def rgb_sums(self) -> Floats:
        """(bins, 3): sums of linear, premultiplied colour."""
        return self.rgb * SUM_UNIT

    @property
    def mean_rgb(self) -> Floats:
        """(bins, 3): mean colours, linear and straight; of light without alpha, the mean light.

        Zero where a bin is empty.
        """
        weight = np.where(self.alpha > 0, self.alpha, self.count / SUM_UNIT)[:, None]
        return np.divide(self.rgb, weight, out=np.zeros((self.bins, 3)), where=weight > 0)

    def shares(self, weight: str = "count") -> Floats:
        """(bins,): shares of the chromatic pixels, or of their chroma or alpha; zeros of nothing.

        `weight`: one of `WEIGHTS`. Errors: `SettingError`.
        """
        if weight not in WEIGHTS:
            raise unknown_name("weight", weight, WEIGHTS)
        sums: Counts = getattr(self, weight)
        return sums / max(1, int(sums.sum()))

    @cached_property
    def peaks(self) -> tuple[Peak, ...]:
        """The hues that stand out, the most frequent first; equally frequent ones by hue.

        A peak is at a bin with more pixels than any other within 2°, and claims those bins, or its
        own where bins are wider, but for what a higher peak has claimed. It is listed if it claims
        1% of the chromatic pixels, and if its bin has three times as many as is usual, the median,
        on either side up to 6° away, where no higher peak has claimed them.
        """
        peaks = [self._peak(center, claim) for center, claim in self._claims]
        return tuple(sorted(peaks, key=lambda peak: (-peak.count, peak.hue)))

    @cached_property
    def concentration(self) -> Concentration:
        """How much of the picture is near its peaks, and how evenly its hues are spread."""
        claimed = [index for _, claim in self._claims for index in claim]
        shares = [share for share in self.shares().tolist() if share]
        entropy = math.fsum(-share * math.log2(share) for share in shares)
        return Concentration(
            share=_share(self.count, claimed),
            chroma_share=_share(self.chroma, claimed),
            entropy=entropy,
            relative_entropy=entropy / math.log2(self.bins),
        )

    @cached_property
    def _claims(self) -> list[tuple[int, list[int]]]:
        """The listed peaks: the bin of each, and the bins that it claims."""
        from statistics import median  # random and decimal, which no stack needs, come with it

        radius = self._peak_radius
        beside = range(radius + 1, max(BESIDE * radius, radius + FEWEST_BESIDE) + 1)
        count = self.count.tolist()
        total = sum(count)
        free = [True] * self.bins
        claims = []
        for center in sorted(range(self.bins), key=lambda index: (-count[index], index)):
            near = [(center + offset) % self.bins for offset in range(-radius, radius + 1)]
            if not count[center] or not free[center]:
                continue
            if any(count[index] > count[center] for index in near):
                continue
            usual = max(
                median([count[i] for i in places if free[i]] or [0])
                for side in (-1, 1)
                for places in [[(center + side * offset) % self.bins for offset in beside]]
            )
            claim = [index for index in near if free[index]]
            size = sum(count[index] for index in claim)
            if size >= SMALLEST_PEAK * total and count[center] >= PEAK_CONTRAST * usual:
                claims.append((center, claim))
                for index in claim:
                    free[index] = False
        return claims

    @property
    def _peak_radius(self) -> int:
        """How many bins to either side of its own a peak claims."""
        return int(PEAK_RADIUS_DEG * self.bins / 360)

    def _peak(self, center: int, claim: list[int]) -> Peak:
        rgb, alpha = self.rgb[claim].sum(axis=0), int(self.alpha[claim].sum())
        count = int(self.count[claim].sum())
        red, green, blue = (float(v) / (alpha or count / SUM_UNIT) for v in rgb)
        return Peak(
            hue=self._hue_of(rgb.astype(np.float64), float(self.hues[center])),
            count=count,
            share=_share(self.count, claim),
            chroma_share=_share(self.chroma, claim),
            rgb=(red, green, blue),
        )

    def _hue_of(self, rgb: Floats, center: float) -> float:
        """The hue of a peak's colours in sum; its centre where they are too dark to tell."""
        if rgb.max() > rgb.min():
            hue = float(self.axis.degrees(rgb))
            away = abs((hue - center + 180) % 360 - 180)
            if away <= (self._peak_radius + 0.5) * 360 / self.bins:
                return hue
        return center


def _share(sums: Counts, of: list[int]) -> float:
    return int(sums[of].sum()) / max(1, int(sums.sum()))


_TALLIES = ("count", "chroma", "alpha", "rgb", "grey", "transparent", "nonfinite")


def hue_histogram(
    pixels: ArrayLike,
    *,
    bins: int = DEFAULT_BINS,
    space: str | spaces.Space = spaces.DEFAULT_SPACE,
    achromatic: float = DEFAULT_ACHROMATIC,
) -> HueHistogram:
    """Counts pixels by hue.

    `pixels`: (…, 4), linear Rec. 709 or of the primaries of a `Space`, premultiplied; measured in
    float32. Light without alpha counts as any other; alpha outside [0, 1] as the nearer end.
    `bins`: 6 to 3600, centred on multiples of their width in degrees. `space`: a `Space`, or a name
    of `SPACES`, whose hue axis and |p| are used. `achromatic`: pixels are grey whose saturation,
    difference over size of the largest component, is below it; in [0, 1].
    Returns: a `HueHistogram`; those of parts add up to that of the whole.
    Errors: `SettingError`, `MismatchError` for another shape.
    """
    measured = spaces.space(space) if isinstance(space, str) else space
    total = HueHistogram.empty(bins, measured.name, achromatic)
    rgba = np.asarray(pixels)
    if rgba.ndim < 1 or rgba.shape[-1] != 4 or rgba.dtype.kind not in "fiub":
        raise MismatchError(
            f"pixels have shape {rgba.shape} and type {rgba.dtype}: numbers (…, 4) are needed"
        )
    flat = rgba.reshape(-1, 4)
    for begin in range(0, len(flat), BLOCK_PIXELS):
        with np.errstate(over="ignore", invalid="ignore"):
            planes = np.ascontiguousarray(flat[begin : begin + BLOCK_PIXELS].T, np.float32)
            total += _of_block(planes, measured, total)
    return total


def _of_block(planes: NDArray[np.float32], space: spaces.Space, like: HueHistogram) -> HueHistogram:
    """The histogram of up to `BLOCK_PIXELS` pixels, planes (4, n), measured in that space.

    Every step is in float32 and in the order written here: the kernel has the same ones, and the
    same bits.
    """
    rgb, alpha = planes[:3], np.clip(planes[3], 0, 1)
    spread, size = spread_and_size(rgb)
    # Components too far apart for a float have no hue that it could hold.
    finite = np.isfinite(planes).all(axis=0) & np.isfinite(spread)
    transparent = finite & (alpha == 0) & (size == 0)
    chosen = np.flatnonzero(finite & (spread > 0) & is_saturated(spread, size, like.achromatic))
    _, p = space.forward(rgb[:, chosen])
    if not space.linear:
        # A colour without luminance has no hue where it is taken at Y = 1.
        with_hue = p.any(axis=0)
        chosen, p = chosen[with_hue], p[:, with_hue]
    rgb, alpha = rgb[:, chosen], alpha[chosen]

    # Centred bins: half a bin is added before rounding down.
    place = space.hue_axis.sextants(rgb) * np.float32(like.bins / 6)
    index = np.floor(place + np.float32(0.5)).astype(np.intp) % like.bins
    chroma = length(p)

    def summed(values: NDArray[np.float32]) -> Counts:
        units = np.rint(_within_addends(values) * np.float32(1 / SUM_UNIT))
        return np.bincount(index, units, like.bins).astype(np.int64)

    n_finite = int(np.count_nonzero(finite))
    n_transparent = int(np.count_nonzero(transparent))
    return HueHistogram(
        like.space,
        like.achromatic,
        count=np.bincount(index, minlength=like.bins).astype(np.int64),
        chroma=summed(chroma),
        alpha=summed(alpha),
        rgb=np.stack([summed(plane) for plane in rgb], axis=1),
        grey=n_finite - len(chosen) - n_transparent,
        transparent=n_transparent,
        nonfinite=finite.size - n_finite,
    )


def _within_addends(values: NDArray[np.float32]) -> NDArray[Any]:
    """At most `LARGEST_ADDEND` to either side; a |p| that overflowed is as large as any."""
    limit = np.float32(LARGEST_ADDEND)
    return np.fmax(np.fmin(values, limit), -limit)
