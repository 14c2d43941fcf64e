"""Hue histograms as a figure to publish: SVG, PNG, PDF. The same histograms, the same bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..color.hueaxis import HueAxis
from ..errors import SettingError, printable
from ..measures.histogram import HueHistogram
from .drawing import INK, PALE, SMALL, SMALLEST, TITLE, PolyCollection, Sheet, saved
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
from .stackreport import StackReport

#: Small multiples beyond these would be a wall, and a PNG of them too large.
MOST_IMAGES = 120

# Inches. A cell is one image: its title and two lines of text above, a straight axis, a round one.
_LINEAR_WIDTH, _POLAR_WIDTH, _PLOT_HEIGHT = 4.4, 1.75, 1.35
_SMALL_LINEAR_WIDTH = 3.0
_LEFT, _RIGHT, _GAP = 0.62, 0.12, 0.38
_ABOVE, _BELOW = 0.52, 0.42
_NOTE = 0.13
_FOOT = 0.26
_STRIP = 0.09
_POLAR_MARGIN = 0.22
#: A figure of round axes alone.
_BIG_POLAR, _POLAR_COLUMNS = 2.3, 4

#: The hole in a round histogram, as a share of its radius: single bins stay visible around it.
_HOLE = 0.32
_RING = 0.07

#: Cells of the colours of the hues, straight and round.
_STRIP_CELLS, _RING_CELLS = 360, 120


def as_svg(entries: Sequence[Entry], look: Look) -> bytes:
    """The figure as SVG, its letters as outlines."""
    return _saved(entries, look, "svg")


def as_png(entries: Sequence[Entry], look: Look) -> bytes:
    """The figure as PNG."""
    return _saved(entries, look, "png")


def as_pdf(entries: Sequence[Entry], look: Look) -> bytes:
    """The figure as PDF of one page, its font embedded."""
    return _saved(entries, look, "pdf")


def stack_as_svg(report: StackReport) -> bytes:
    """The figure of a stack as SVG."""
    return _stack_saved(report, "svg")


def stack_as_png(report: StackReport) -> bytes:
    """The figure of a stack as PNG."""
    return _stack_saved(report, "png")


def stack_as_pdf(report: StackReport) -> bytes:
    """The figure of a stack as PDF."""
    return _stack_saved(report, "pdf")


def _stack_saved(report: StackReport, format: str) -> bytes:
    """Its layers and results, each with what became of its hues.

    Of more layers than a figure has room for, it shows the lower ones and says so.
    """
    measures = report.summary.measures
    notes = [
        f"visible in {percent(layer.visible_share)} of {layer.pixels:,} px, "
        f"hue survived in {percent(layer.survived_share)}, "
        f"lost to grey: {percent(layer.lost)} of chroma"
        if layer.pixels
        else "contributes no hue"
        for layer in measures.result.layers
    ] + [
        f"foreign hue: {percent(result.foreign_share)} of pixels, "
        f"{percent(result.foreign_chroma_share)} of chroma; "
        f"lost to grey: {percent(result.lost)} of chroma; "
        f"visible: {percent(result.visible_share)}"
        for result in measures.results.values()
    ]
    entries = report.entries
    left_out = len(entries) - MOST_IMAGES
    remark = ""
    if left_out > 0:
        results = len(measures.results)
        kept = [*range(len(entries) - results - left_out), *range(-results, 0)]
        entries, notes = [entries[k] for k in kept], [notes[k] for k in kept]
        remark = f"; {left_out} upper layers are left out"
    return _saved(entries, Look(), format, notes, remark)


def _saved(
    entries: Sequence[Entry],
    look: Look,
    format: str,
    notes: Sequence[str] = (),
    remark: str = "",
) -> bytes:
    """The figure; `notes`: a line for each entry, or none at all; `remark`: ends its caption."""
    axis = common_axis(entries)
    if len(entries) > MOST_IMAGES:
        raise SettingError(
            f"a figure shows {MOST_IMAGES} images at most, not {len(entries)}: make several"
        )
    return saved(lambda: _Sheet(axis, entries, look, notes, remark), format)


class _Sheet(Sheet):
    """A figure with a cell for each image, in rows, all on one scale."""

    def __init__(
        self,
        axis: HueAxis,
        entries: Sequence[Entry],
        look: Look,
        notes: Sequence[str] = (),
        remark: str = "",
    ) -> None:
        super().__init__()
        self.axis, self.look, self.remark = axis, look, remark
        self.scale = SCALES[look.scale]
        self.bins = entries[0][1].bins
        shares = [histogram.shares(look.weight) for _, histogram in entries]
        self.top = max(float(share.max()) for share in shares) * 1.04 or 1.0
        self.start = axis_start(axis)

        n = len(entries)
        self.straight, self.round = look.axes != "polar", look.axes != "linear"
        below = _BELOW
        if self.straight:
            columns = 1 if n <= 3 else 2 if n <= 8 else 3
            self.linear_width = _LINEAR_WIDTH if columns == 1 else _SMALL_LINEAR_WIDTH
            self.polar_size, self.plot_height = _POLAR_WIDTH, _PLOT_HEIGHT
            polar_below = 0.22
        else:
            columns = min(n, _POLAR_COLUMNS)
            self.linear_width = 0.0
            self.polar_size = self.plot_height = _BIG_POLAR
            below = polar_below = 0.0
        rows = -(-n // columns)
        cell_width = self._polar_left + (self.polar_size if self.round else 0) + _RIGHT
        above = _ABOVE + (_NOTE if notes else 0)
        cell_height = above + self.plot_height + below
        self._open(columns * cell_width, rows * cell_height + _FOOT)
        for number, (label, histogram) in enumerate(entries):
            row, column = divmod(number, columns)
            left = column * cell_width
            bottom = self.height - row * cell_height - above - self.plot_height
            note = notes[number] if notes else ""
            self._heading(label, histogram, left, bottom + self.plot_height, cell_width, note)
            if self.straight:
                self._linear(histogram, left + _LEFT, bottom)
            if self.round:
                self._polar(histogram, left + self._polar_left, bottom - polar_below)
        self._text(self.width / 2, 0.1, self._caption(), size=SMALL, horizontalalignment="center")

    @property
    def _polar_left(self) -> float:
        """Where a cell's round axis begins."""
        return _LEFT + self.linear_width + _GAP if self.straight else _RIGHT

    def _caption(self) -> str:
        return (
            f"{self.axis.title}; share of the {WEIGHT_TITLES[self.look.weight]}, "
            f"{360 / self.bins:.3g}° to a bar, on a {self.scale.title}{self.remark}"
        )

    # --- parts; places are inches from the bottom left ---

    def _heading(
        self,
        label: str,
        histogram: HueHistogram,
        left: float,
        bottom: float,
        width: float,
        note: str,
    ) -> None:
        """Above a cell's plots: name, note, shares of pixels, peaks with their colours."""
        x = left + (_LEFT if self.straight else _RIGHT)
        room = left + width - x - _RIGHT
        top = bottom + 0.34
        if note:
            self._shorten(self._text(x, top, note), room)
            top += _NOTE
        title = self._text(x, top, printable(label), fontproperties=self.bold, size=TITLE)
        self._shorten(title, room)
        total = max(1, histogram.pixels)
        parts = [
            f"{histogram.pixels:,} px",
            f"{percent(histogram.chromatic / total)} with a hue",
            f"{percent(histogram.grey / total)} grey",
            f"{percent(histogram.transparent / total)} transparent",
        ]
        if histogram.nonfinite:
            parts.append(f"{percent(histogram.nonfinite / total)} NaN or Inf")
        shares = self._text(x, bottom + 0.215, ", ".join(parts))
        if self._width_of(shares) > room:
            shares.set_text(", ".join(parts[1:]))
            self._shorten(shares, room)
        self._peaks(histogram, x, bottom + 0.085, room)

    def _peaks(self, histogram: HueHistogram, x: float, y: float, room: float) -> None:
        if not histogram.peaks:
            words = "no hue stands out" if histogram.chromatic else "no pixel has a hue"
            self._text(x, y, words)
            return
        end = x + room
        for number, peak in enumerate(histogram.peaks):
            left = len(histogram.peaks) - number
            text = self._text(x + 0.12, y, f"{peak.hue:.1f}° {percent(peak.share)}")
            width = 0.12 + self._width_of(text) + 0.14
            # Room is kept for the words on those that are left out.
            if x + width > end - (0.5 if left > 1 else 0) + 0.14:
                text.remove()
                self._text(x, y, f"+{left} more")
                return
            self._swatch(x, y - 0.005, 0.085, srgb_hex(peak.rgb))
            x += width

    def _heights(self, histogram: HueHistogram) -> Any:
        return self.scale.heights(histogram.shares(self.look.weight), self.top)

    def _ticks(self, height: float) -> list[tuple[float, str]]:
        """Heights and shares to write there, no closer than the letters need."""
        apart = 0.19 / height
        return [
            (float(self.scale.heights(share, self.top)), f"{100 * share:g}%")
            for share in ticks(self.top, self.scale, apart)
        ]

    def _linear(self, histogram: HueHistogram, left: float, bottom: float) -> None:
        axes = self._axes(left, bottom, self.linear_width, self.plot_height)
        axes.set_xlim(self.start, self.start + 360)
        axes.set_ylim(0, 1)
        width = 360 / self.bins
        first = math.floor(self.start / width)
        # Bars that the axis' ends cut are drawn at both.
        numbers = np.arange(first, first + self.bins + 2)
        edges = (np.append(numbers, numbers[-1] + 1) - 0.5) * width
        heights = self._heights(histogram)[numbers % self.bins]
        rows = self._ticks(self.plot_height)
        for height, _ in rows[1:]:
            axes.axhline(height, color=PALE, linewidth=0.4, zorder=0)
        # The outline keeps a single bin visible, however narrow.
        axes.stairs(
            np.where(heights > 0, heights, np.nan),
            edges,
            fill=True,
            facecolor=INK,
            edgecolor=INK,
            linewidth=0.35,
        )
        axes.set_yticks([height for height, _ in rows], [text for _, text in rows])
        for spine in ("top", "right"):
            axes.spines[spine].set_visible(False)
        axes.set_xticks([])
        self._style_ticks(axes)

        strip = self._axes(left, bottom - _STRIP - 0.02, self.linear_width, _STRIP)
        strip.set_xlim(self.start, self.start + 360)
        strip.set_ylim(0, 1)
        self._hue_colors(strip, _STRIP_CELLS, 0, 1)
        strip.set_yticks([])
        places = self.axis.landmarks()
        turned = [(hue - self.start) % 360 + self.start for hue in places.values()]
        labels = [f"{hue:.0f}°\n{name}" for name, hue in places.items()]
        strip.set_xticks(turned, labels)
        self._style_ticks(strip)
        for spine in strip.spines.values():
            spine.set_visible(False)

    def _hue_colors(
        self, axes: Any, cells: int, lowest: float, highest: float, unit: float = 1
    ) -> None:
        """A band of all hues on `axes`, whose x is in degrees times `unit`."""
        width = 360 / cells
        begins = self.start + width * np.arange(cells)
        # Each reaches below the next, and no seam shows between them.
        ends = np.minimum(begins + 2 * width, self.start + 360)
        corners = [
            [(x * unit, y) for x, y in ((b, lowest), (e, lowest), (e, highest), (b, highest))]
            for b, e in zip(begins, ends, strict=True)
        ]
        colors = hue_colors(self.axis, begins + width / 2)
        axes.add_collection(PolyCollection(corners, facecolors=colors, linewidth=0))

    def _polar(self, histogram: HueHistogram, left: float, bottom: float) -> None:
        size = self.polar_size - 2 * _POLAR_MARGIN
        axes = self._axes(
            left + _POLAR_MARGIN, bottom + _POLAR_MARGIN, size, size, projection="polar"
        )
        axes.set_ylim(0, 1)
        circle = np.radians(np.arange(0, 362, 2))
        for height, share in self._ticks(size / 2 * (1 - _HOLE))[1:]:
            radius = _HOLE + height * (1 - _HOLE)
            axes.plot(circle, np.full(len(circle), radius), color=PALE, linewidth=0.4, zorder=0)
            label = axes.text(
                math.pi / 2, radius, share, color=INK, zorder=0.5, parse_math=False,
                horizontalalignment="center", verticalalignment="center",
                bbox={"facecolor": "white", "linewidth": 0, "pad": 0.4},
            )  # fmt: skip
            label.set_fontproperties(self.font)
            label.set_fontsize(SMALLEST)
        heights = self._heights(histogram) * (1 - _HOLE)
        axes.add_collection(
            PolyCollection(
                [self._wedge(k, heights[k]) for k in np.flatnonzero(heights).tolist()],
                facecolor=INK,
                edgecolor=INK,
                linewidth=0.35,
            )
        )
        self._hue_colors(axes, _RING_CELLS, _HOLE - _RING - 0.01, _HOLE - 0.01, math.radians(1))
        places = self.axis.landmarks()
        axes.set_xticks(
            [math.radians(hue) for hue in places.values()],
            [f"{hue:.0f}°" for hue in places.values()],
        )
        axes.set_yticks([])
        axes.grid(False)
        axes.set_ylim(0, 1)
        axes.spines["polar"].set_visible(False)
        self._style_ticks(axes)
        axes.tick_params(pad=0 if self.straight else 1.5, length=0)

    def _wedge(self, index: int, height: float) -> Any:
        """A bar of round axes as (angle, radius): its ends are arcs of short pieces."""
        width = 360 / self.bins
        angles = np.radians(np.linspace(-width / 2, width / 2, 1 + math.ceil(width)))
        angles += math.radians(index * width)
        inner = np.stack([angles, np.full(len(angles), _HOLE)], axis=1)
        outer = np.stack([angles, np.full(len(angles), _HOLE + height)], axis=1)
        return np.concatenate([inner, outer[::-1]])
