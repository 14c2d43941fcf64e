"""Hue histograms as inline SVG for a page: bars that stretch with it, letters that do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..color.hueaxis import HueAxis
from ..measures.histogram import PEAK_RADIUS_DEG, HueHistogram, Peak
from .huetext import concentration_sentence, pixels_sentence
from .look import (
    SCALES,
    WEIGHT_TITLES,
    Entry,
    Look,
    axis_start,
    common_axis,
    hue_colors,
    percent,
    srgb_hex,
    ticks,
)
from .markup import Node, digits, h


@dataclass(frozen=True)
class Size:
    """Pixels of a chart: of its plot, and of the letters below it; `full`: whether names are there
    beside degrees, and sentences on its numbers."""

    plot: int
    below: int
    full: bool


LARGE, SMALL = Size(150, 36, True), Size(80, 20, False)

#: Pixels: the strip of hues below a plot, the gap between them, and what is above.
_STRIP, _GAP, _ABOVE = 10, 3, 8
#: The height of a line of letters, which labels of shares are apart at least.
_LINE = 20

#: Heights inside the plot count to so many, widths are degrees.
_UNITS = 100
#: Stops of the gradient of hues: every so many degrees.
_STOP_DEG = 5

_GRADIENT = "hue-colors"


class Charts:
    """Charts of the histograms of a page, all on one scale."""

    def __init__(self, entries: Sequence[Entry], look: Look) -> None:
        self.axis: HueAxis = common_axis(entries)
        self.look = look
        self.bins = entries[0][1].bins
        self.start = axis_start(self.axis)
        self.scale = SCALES[look.scale]
        shares = [histogram.shares(look.weight) for _, histogram in entries]
        self.top = max(float(share.max()) for share in shares) * 1.04 or 1.0

    @property
    def caption(self) -> str:
        """What the bars are, in words."""
        return (
            f"{self.axis.title}; share of the {WEIGHT_TITLES[self.look.weight]}, "
            f"{360 / self.bins:.3g}° to a bar, on a {self.scale.title}."
        )

    def colors(self) -> Node:
        """What the charts refer to, once a page: the colours under their axes."""
        degrees = np.arange(0, 360 + _STOP_DEG, _STOP_DEG) + self.start
        stops = [
            h.stop(offset=digits(k / (len(degrees) - 1)), stop_color=color)
            for k, color in enumerate(hue_colors(self.axis, degrees))
        ]
        gradient = h.Element("linearGradient")(id=_GRADIENT)[stops]
        return h.svg(class_="defs", width=0, height=0, aria_hidden="true")[gradient]

    def figure(self, label: Node, histogram: HueHistogram, size: Size) -> Node:
        """A histogram under its heading, with its counts and peaks."""
        heading = h.figcaption[h.h3[label], h.p(class_="readout", aria_live="polite")]
        counts = h.p(class_="note")[f"{pixels_sentence(histogram)}."]
        if not histogram.chromatic:
            return h.figure(class_="chart")[heading, counts]
        return h.figure(class_="chart")[
            heading,
            counts if size.full else "",
            self._plot(histogram, size),
            peak_list(histogram),
            h.p(class_="note")[f"{concentration_sentence(histogram)}."] if size.full else "",
        ]

    def _plot(self, histogram: HueHistogram, size: Size) -> Node:
        height = size.plot
        rows = [
            (_ABOVE + height - height * float(self.scale.heights(share, self.top)), share)
            for share in ticks(self.top, self.scale, _LINE / height)
        ]
        whole = _ABOVE + height + _GAP + _STRIP + size.below
        shares = h.svg(class_="shares", height=whole, aria_hidden="true")[
            (h.text(x="100%", y=digits(y))[f"{100 * share:g}%"] for y, share in rows)
        ]
        lines = h.fragment[
            (
                h.line(x1=0, x2="100%", y1=digits(y), y2=digits(y), class_="rule")
                for y, _ in rows[1:]
            )
        ]
        bars = h.svg(
            class_="field",
            viewBox=f"{digits(self.start)} 0 360 {_UNITS}",
            preserveAspectRatio="none",
            y=_ABOVE,
            width="100%",
            height=height,
        )[
            h.path(d=self._outline(histogram), class_="bars"),
            h.path(d="", class_="cursor"),
            (self._hit(peak) for peak in histogram.peaks),
        ]
        base = _ABOVE + height + _GAP
        plot = h.svg(
            class_="plot",
            height=whole,
            role="img",
            aria_label=summary(histogram),
            data_shares=self._data(histogram),
            data_bins=self.bins,
            data_start=digits(self.start),
        )[
            lines,
            bars,
            h.rect(y=base, width="100%", height=_STRIP, fill=f"url(#{_GRADIENT})"),
            self._landmarks(base + _STRIP, size.full),
        ]
        return h.div(class_="plotted")[shares, plot]

    def _outline(self, histogram: HueHistogram) -> str:
        """The bars as one path; neighbours are drawn in one go. The axis' ends cut a bar in two."""
        width = 360 / self.bins
        first = int(np.floor(self.start / width))
        heights = self.scale.heights(histogram.shares(self.look.weight), self.top) * _UNITS
        steps, open_ = [], False
        for index in range(first, first + self.bins + 2):
            height = float(heights[index % self.bins])
            if height > 0:
                # What is there is seen, however little it is.
                level = digits(_UNITS - max(height, 0.6))
                if not open_:
                    steps.append(f"M{_fine((index - 0.5) * width)} {_UNITS}")
                steps.append(f"V{level}h{_fine(width)}")
            elif open_:
                steps.append(f"V{_UNITS}z")
            open_ = height > 0
        return "".join(steps) + (f"V{_UNITS}z" if open_ else "")

    def _hit(self, peak: Peak) -> Node:
        reach = max(PEAK_RADIUS_DEG, 180 / self.bins)
        left = (peak.hue - self.start) % 360 + self.start - reach
        title = h.title[peak_text(peak)]
        return h.rect(class_="hit", x=_fine(left), width=_fine(2 * reach), height=_UNITS)[title]

    def _landmarks(self, y: float, names: bool) -> Node:
        texts = []
        for name, hue in self.axis.landmarks().items():
            place = f"{digits(((hue - self.start) % 360) / 3.6)}%"
            texts.append(h.text(x=place, y=digits(y + 15))[f"{hue:.0f}°"])
            if names:
                texts.append(h.text(x=place, y=digits(y + 29))[name])
        return h.g(class_="landmarks", aria_hidden="true")[texts]

    def _data(self, histogram: HueHistogram) -> str:
        """Number and share, in percent, of each bin with a pixel: what the page's script reads."""
        shares = histogram.shares(self.look.weight)
        return ",".join(
            f"{index}:{100 * float(shares[index]):.3g}" for index in np.flatnonzero(histogram.count)
        )


def _fine(value: float) -> str:
    """A number of degrees: of a tenth to a bin, hundredths would show."""
    return f"{value:.4f}".rstrip("0").rstrip(".")


def peak_text(peak: Peak) -> str:
    """A peak in words."""
    return (
        f"{peak.hue:.1f}°: {percent(peak.share)} of the pixels with a hue, "
        f"{percent(peak.chroma_share)} of their chroma"
    )


def summary(histogram: HueHistogram) -> str:
    """What a chart shows, for those who do not see it."""
    if not histogram.peaks:
        return "Hue histogram: no hue stands out."
    peaks = "; ".join(f"{peak.hue:.0f}° {percent(peak.share)}" for peak in histogram.peaks)
    return f"Hue histogram. Peaks, with their shares of the pixels with a hue: {peaks}."


def swatch(color: str) -> Node:
    """A patch of a colour, #rrggbb."""
    return h.svg(class_="swatch", width=12, height=12, aria_hidden="true")[
        h.rect(width=12, height=12, fill=color)
    ]


def peak_list(histogram: HueHistogram) -> Node:
    """The peaks with their colours, hues and shares."""
    if not histogram.peaks:
        return h.p(class_="note")["no hue stands out"]
    rows = [
        h.li(title=peak_text(peak))[
            swatch(srgb_hex(peak.rgb)), f" {peak.hue:.1f}° ", h.b[percent(peak.share)]
        ]
        for peak in histogram.peaks
    ]
    return h.ul(class_="peaks")[rows]
