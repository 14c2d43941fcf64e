"""What all hue reports share in looks: choices, colours, the scale of shares. Draws nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..color.gamut import into_gamut
from ..color.hueaxis import HueAxis
from ..color.transfer import encode_srgb
from ..errors import MismatchError, unknown_name
from ..measures.histogram import WEIGHTS, Floats, HueHistogram

#: A picture in a report: what it is called, and its histogram.
Entry = tuple[str, HueHistogram]

#: Which axes a figure has.
AXES = ("both", "linear", "polar")


@dataclass(frozen=True)
class Scale:
    """How shares become heights: by a map that grows from 0 at 0. `title` says it in words."""

    name: str
    title: str
    forward: Callable[[Floats], Floats]

    def heights(self, shares: Floats | float, top: float) -> Floats:
        """Heights of shares (…), where that of `top` is 1; `top` is above 0."""
        return self.forward(np.asarray(shares, np.float64)) / self.forward(np.array(top))


#: Where the logarithmic scale bends to reach 0: shares below it are of a few stray pixels.
LOG_FLOOR = 1e-5
#: The power of ten below which no share is written beside an axis.
LOWEST_TICK = -7

#: The square root shows what is small beside what is large, and keeps 0 at 0.
SCALES: dict[str, Scale] = {
    row.name: row
    for row in (
        Scale("sqrt", "square-root scale", np.sqrt),
        Scale("linear", "linear scale", lambda share: share),
        Scale("log", "logarithmic scale", lambda share: np.log1p(share / LOG_FLOOR)),
    )
}

#: What the shares of a weight are shares of.
WEIGHT_TITLES = {
    "count": "pixels with a hue",
    "chroma": "chroma",
    "alpha": "alpha of the pixels with a hue",
}


@dataclass(frozen=True)
class Look:
    """How a report looks, where there is a choice; none of it changes the numbers.

    `weight`: what the shares are shares of, one of `histogram.WEIGHTS`. `scale`: a name of
    `SCALES`. `axes`: one of `AXES`, of figures. `columns`, `color`, `encoding`: of text, how wide
    it is, whether it is coloured for a terminal, and how it is encoded. Errors: `SettingError`.
    """

    weight: str = "count"
    scale: str = "sqrt"
    axes: str = "both"
    columns: int = 80
    color: bool = False
    encoding: str = "utf-8"

    def __post_init__(self) -> None:
        for kind, name, valid in (
            ("weight", self.weight, WEIGHTS),
            ("scale", self.scale, SCALES),
            ("axes", self.axes, AXES),
        ):
            if name not in valid:
                raise unknown_name(kind, name, valid)


def common_axis(entries: Sequence[Entry]) -> HueAxis:
    """The hue axis of all histograms of a report, which must have their bins in common.

    Errors: `MismatchError`.
    """
    first = entries[0][1]
    for label, histogram in entries:
        if (histogram.bins, histogram.space) != (first.bins, first.space):
            raise MismatchError(
                f"{label}: its histogram has {histogram.bins} bins of {histogram.space}, the first "
                f"one {first.bins} of {first.space}: make all with the same settings"
            )
    return first.axis


def axis_start(axis: HueAxis) -> float:
    """Where a straight axis begins, in degrees up to 0: far from every named colour."""
    places = sorted(axis.landmarks().values())
    return (places[-1] + places[0] - 360) / 2


def hue_colors(axis: HueAxis, degrees: Floats) -> list[str]:
    """The colour of each hue (n,), as #rrggbb."""
    return [srgb_hex(rgb) for rgb in axis.color(degrees).T]


def srgb_hex(rgb: Sequence[float] | Floats) -> str:
    """A linear colour as #rrggbb in sRGB; what it cannot show is made darker and paler."""
    straight = np.array([rgb], np.float64)
    straight /= max(1.0, float(straight.max()))
    codes = np.rint(encode_srgb(into_gamut(straight)[0]).clip(0, 1) * 255).astype(int)
    return "#" + "".join(f"{code:02x}" for code in codes)


def percent(share: float) -> str:
    """A share for people: three digits at most, and never 0% for what is there."""
    if 0 < share < 0.0005:
        return "<0.1%"
    if 0.9995 <= share < 1:
        return ">99.9%"
    return f"{share:.0%}" if share in (0, 1) else f"{share:.1%}"


def ticks(top: float, scale: Scale, apart: float) -> list[float]:
    """Round shares from 0 up to `top`; their heights are at least the share `apart` of it apart."""
    shares, last = [0.0], 1 + apart
    digits = [
        digit * 10.0**exponent
        for exponent in range(math.floor(math.log10(top)), LOWEST_TICK, -1)
        for digit in (5, 2, 1)
    ]
    for share in digits:
        height = float(scale.heights(share, top))
        if share <= top and apart <= height <= last - apart:
            shares.append(share)
            last = height
    return sorted(shares)
