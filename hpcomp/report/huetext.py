"""Hue histograms as bar charts of characters, in colour on a terminal. Prints nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..color.hueaxis import HueAxis
from ..errors import printable
from ..measures.histogram import PEAK_RADIUS_DEG, Floats, HueHistogram
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

#: Lines of a chart above its axis.
HEIGHT = 8
#: Columns to the left of a chart: its shares, and its axis.
MARGIN = 7
#: Fewer columns than these hold no chart, and more make it no clearer.
NARROWEST, WIDEST = 24, 186

_EIGHTHS = " ▁▂▃▄▅▆▇█"
#: What stands for characters that an encoding does not have.
_ASCII = str.maketrans(
    {
        **dict(zip("▁▂▃▄▅▆▇█│┤└─┴▀■", "___==###||+-+##", strict=True)),
        **{"°": "deg", "→": "->", "…": "..."},
    }
)


def as_text(entries: Sequence[Entry], look: Look) -> bytes:
    """Charts of all entries on one scale, each with its counts and peaks."""
    axis = common_axis(entries)
    chart = _Chart(axis, entries, look)
    blocks = ["\n".join(_lines(label, histogram, chart, look)) for label, histogram in entries]
    if any(histogram.chromatic for _, histogram in entries):
        blocks.append(chart.caption)
    return encoded("\n\n".join(blocks) + "\n", look)


def encoded(text: str, look: Look) -> bytes:
    """Text in the encoding of the look, with plain letters where that has no others."""
    try:
        return text.encode(look.encoding)
    except UnicodeEncodeError:
        return text.translate(_ASCII).encode(look.encoding, "backslashreplace")


def _lines(label: str, histogram: HueHistogram, chart: _Chart, look: Look) -> list[str]:
    lines = [printable(label), f"  {pixels_sentence(histogram)}"]
    if not histogram.chromatic:
        return lines
    lines += chart.lines(histogram)
    for peak in histogram.peaks:
        color = srgb_hex(peak.rgb)
        lines.append(
            f"  {colored('■', color, look)} {peak.hue:5.1f}°  {percent(peak.share):>6} of pixels, "
            f"{percent(peak.chroma_share):>6} of chroma, {color}"
        )
    return [*lines, f"  {concentration_sentence(histogram)}"]


def pixels_sentence(histogram: HueHistogram) -> str:
    """How many pixels there are, and what shares of them have a hue or none."""
    total = max(1, histogram.pixels)
    shares = [
        f"{percent(histogram.chromatic / total)} with a hue",
        f"{percent(histogram.grey / total)} grey",
        f"{percent(histogram.transparent / total)} transparent",
    ]
    if histogram.nonfinite:
        shares.append(f"{percent(histogram.nonfinite / total)} NaN or infinite")
    unit = "pixel" if histogram.pixels == 1 else "pixels"
    return f"{histogram.pixels:,} {unit}: {', '.join(shares)}"


def concentration_sentence(histogram: HueHistogram) -> str:
    """What the concentration of a histogram is, in words."""
    concentration = histogram.concentration
    near = (
        f"{percent(concentration.share)} of pixels within {PEAK_RADIUS_DEG:g}° of the peaks"
        if histogram.peaks
        else "no hue stands out"
    )
    return (
        f"{near}; {histogram.occupied} of {histogram.bins} bins; "
        f"entropy {concentration.entropy:.2f} of {np.log2(histogram.bins):.2f} bits"
    )


class _Chart:
    """Bars over a straight hue axis, the same for all histograms of a report."""

    def __init__(self, axis: HueAxis, entries: Sequence[Entry], look: Look) -> None:
        self.look, self.axis = look, axis
        bins = entries[0][1].bins
        room = max(NARROWEST, min(look.columns, WIDEST) - MARGIN - 1)
        #: Bins to a column, or columns to a bin.
        self.group = -(-bins // room)
        self.repeat = max(1, room // bins)
        # Columns are centred on hues, as bins are.
        self.first = round(axis_start(axis) * bins / 360) - (self.group - 1) // 2
        self.hues = (self.first + np.arange(bins)) * (360 / bins)
        self.colors = hue_colors(axis, self._columns(self.hues, mean=True))
        self.scale = SCALES[look.scale]
        self.top = max(float(self._shares(histogram).max()) for _, histogram in entries) or 1.0

    @property
    def caption(self) -> str:
        """What its bars are, in words."""
        width = self.group * 360 / len(self.hues)
        return (
            f"Bars: share of the {WEIGHT_TITLES[self.look.weight]}, {width:.3g}° to a bar, on a "
            f"{self.scale.title}."
        )

    def _shares(self, histogram: HueHistogram) -> Floats:
        return self._columns(np.roll(histogram.shares(self.look.weight), -self.first), mean=False)

    def _columns(self, values: Floats, mean: bool) -> Floats:
        """(bins,) → (columns,): groups of bins summed or averaged, or bins repeated."""
        begins = np.arange(0, len(values), self.group)
        sums = np.add.reduceat(values, begins)
        if mean:
            sums = sums / np.diff([*begins, len(values)])
        return np.repeat(sums, self.repeat)

    def _column(self, hue: float) -> int:
        """The column of a hue, the middle one of several."""
        bins = len(self.hues)
        number = (round(hue * bins / 360) - self.first) % bins
        return number // self.group * self.repeat + self.repeat // 2

    def lines(self, histogram: HueHistogram) -> list[str]:
        shares = self._shares(histogram)
        heights = self.scale.heights(shares, self.top) * HEIGHT
        # What is there is seen, however little it is.
        eighths = np.where(shares > 0, np.maximum(np.rint(heights * 8), 1), 0).astype(int)
        labels = self._labels()
        lines = []
        for row in reversed(range(HEIGHT)):
            cells = [_EIGHTHS[min(max(eighth - 8 * row, 0), 8)] for eighth in eighths.tolist()]
            side = f"{labels[row]:>{MARGIN - 1}}┤" if row in labels else " " * (MARGIN - 1) + "│"
            lines.append((side + self._painted(cells)).rstrip())
        return [*lines, *self._axis_lines(len(shares))]

    def _labels(self) -> dict[int, str]:
        """What stands beside the lines of a chart: the share at which a bar fills the line."""
        labels: dict[int, str] = {}
        for share in ticks(self.top, self.scale, apart=2 / HEIGHT)[1:]:
            row = round(float(self.scale.heights(share, self.top)) * HEIGHT) - 1
            labels.setdefault(max(0, row), f"{100 * share:g}%")
        return labels

    def _axis_lines(self, columns: int) -> list[str]:
        places = {self._column(hue): (name, hue) for name, hue in self.axis.landmarks().items()}
        strip = ["▀" if self.look.color else "┴" if k in places else "─" for k in range(columns)]
        side = " " * (MARGIN - 1)
        lines = [side + "└" + self._painted(strip)]
        for texts in (
            {place: f"{hue:.0f}°" for place, (_, hue) in places.items()},
            {place: name for place, (name, _) in places.items()},
        ):
            line = [" "] * (columns + 1)
            end = 0
            for place, text in sorted(texts.items()):
                begin = min(max(place - len(text) // 2, 0), columns + 1 - len(text))
                if begin >= end:
                    line[begin : begin + len(text)] = text
                    end = begin + len(text) + 1
            lines.append((side + " " + "".join(line)).rstrip())
        return lines

    def _painted(self, cells: list[str]) -> str:
        """The cells of a line, each in the colour of its hue."""
        if not self.look.color:
            return "".join(cells)
        painted, last = [], ""
        for cell, color in zip(cells, self.colors, strict=True):
            if cell != " " and color != last:
                painted.append(_escape(color))
                last = color
            painted.append(cell)
        return "".join(painted).rstrip() + (PLAIN if last else "")


#: Ends a colour on a terminal.
PLAIN = "\x1b[0m"


def _escape(color: str) -> str:
    red, green, blue = bytes.fromhex(color[1:])
    return f"\x1b[38;2;{red};{green};{blue}m"


def colored(text: str, color: str, look: Look) -> str:
    """Text in the colour #rrggbb, where the look has colours."""
    return f"{_escape(color)}{text}{PLAIN}" if look.color else text
