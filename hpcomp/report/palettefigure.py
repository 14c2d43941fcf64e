"""A palette as a figure to publish, SVG, PNG or PDF: its pairs over opacity, and all its mixtures.

The parts are the paper's Figures 4 and 6. The same palette gives the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..analysis.palette import Floats, Label, Pair, Palette, Profile, patch
from ..color.gamut import into_gamut
from ..color.transfer import encode_srgb
from ..errors import SettingError, printable
from .drawing import INK, PNG_DPI, SMALL, TITLE, Circle, PolyCollection, Sheet, saved
from .look import hue_colors, srgb_hex
from .palettedata import ALL, hex_colors, rules_data, rules_sentence, shown
from .paletteformats import PaletteLook

#: Of more labels than these, lines between each two would hide the disc.
_MOST_WITH_LINES = 4
#: More labels than these crowd a disc, and more pairs a page.
MOST_LABELS, MOST_PAIRS = 12, 28

# Inches.
_WIDTH, _MARGIN = 7.0, 0.15
_LABEL_WIDTH, _LABEL_HEIGHT, _SWATCH = 1.67, 0.34, 0.22
_NAMES, _ARROW, _GAP = 1.55, 0.24, 0.2
_HEADING = 0.3
_BAR, _STRIP, _BETWEEN, _ROW = 0.17, 0.05, 0.02, 0.345
_AXIS = 0.42
_DISC = (_WIDTH - 2 * _MARGIN - _GAP) / 2
_DISC_HEIGHT = 0.8 * _DISC
_CAPTION_LINE, _FOOT = 0.13, 0.1

#: The radius of a disc: a little more than the strongest label's chroma.
_MARGIN_OF_DISC = 1.08
#: Where the ring of hues lies and how far its axes reach, in radii.
_RING_INSIDE, _RING_OUTSIDE, _REACH = 1.03, 1.11, 1.6
_TAG = 1.15
#: Names around a disc are this many degrees apart at least, seen from its middle.
_TAGS_APART = 11.0
_RING_CELLS = 240
#: Pixels from the middle of a disc to its edge, and of what one mixture covers.
_RADIUS_PX, _DOT_PX = 240, 5
#: What is within a disc and no mixture.
_INSIDE = (0.78, 0.78, 0.78)

#: The code of what a hue strip shows where there is none.
_NO_HUE = 0x80


def as_svg(palette: Palette, look: PaletteLook) -> bytes:
    """The figure as SVG, its letters as outlines."""
    return _figure(palette, look, "svg")


def as_png(palette: Palette, look: PaletteLook) -> bytes:
    """The figure as PNG."""
    return _figure(palette, look, "png")


def as_pdf(palette: Palette, look: PaletteLook) -> bytes:
    """The figure as PDF of one page, its font embedded."""
    return _figure(palette, look, "pdf")


def _figure(palette: Palette, look: PaletteLook, format: str) -> bytes:
    if len(palette.labels) > MOST_LABELS:
        raise SettingError(
            f"a figure shows {MOST_LABELS} labels at most, not {len(palette.labels)}: make several"
        )
    return saved(lambda: _Sheet(palette, look), format)


class _Sheet(Sheet):
    """Labels at the top; below them a row for each pair; below these the discs."""

    def __init__(self, palette: Palette, look: PaletteLook) -> None:
        super().__init__()
        self.palette = palette
        pairs = palette.distinct if look.figure in ("all", "profiles") else ()
        self.left_out = max(0, len(pairs) - MOST_PAIRS)
        pairs = pairs[:MOST_PAIRS]
        discs = look.figure in ("all", "discs")
        self.columns = int((_WIDTH - 2 * _MARGIN) / _LABEL_WIDTH)
        label_rows = -(-len(palette.labels) // self.columns)
        caption = self._caption(bool(pairs), discs)
        heights = [
            0.1 + label_rows * _LABEL_HEIGHT,
            _HEADING + len(pairs) * _ROW + _AXIS if pairs else 0.0,
            _HEADING + _DISC_HEIGHT if discs else 0.0,
            _FOOT + len(caption) * _CAPTION_LINE,
        ]
        self._open(_WIDTH, sum(heights))
        top = self.height - 0.1
        self._labels(top)
        top = self.height - heights[0]
        if pairs:
            self._profiles(pairs, top)
        top -= heights[1]
        if discs:
            self._discs(top)
        for number, line in enumerate(reversed(caption)):
            self._text(_MARGIN, _FOOT + number * _CAPTION_LINE, line, size=SMALL)

    def _caption(self, profiles: bool, discs: bool) -> list[str]:
        rules = rules_data(self.palette)
        rules.pop("blending")
        given = rules_sentence(rules)
        lines = []
        woven = self.palette.stack.blending.depends_on_place
        if profiles:
            lines.append(
                "Blends of two labels, below each its hue alone (grey: none); a triangle is where "
                "least chroma is left."
            )
        if profiles and woven:
            lines.append(
                f"Woven blends show the pattern, {PNG_DPI} of its pixels to an inch; both threads "
                "count for the least chroma."
            )
        if self.left_out:
            lines.append(f"{self.left_out} pairs that keep more are left out.")
        if discs:
            lines.append(
                f"Discs: every mixture{', woven every thread of each,' if woven else ''} on "
                f"{srgb_hex(self.palette.settings.background)}, the brightest of each place; "
                f"angle is hue, radius is chroma, |p| = {self._radius:.2g} at the edge."
            )
        return [*lines, f"{given[0].upper()}{given[1:]}."]

    # --- labels ---

    def _labels(self, top: float) -> None:
        for number, label in enumerate(self.palette.labels):
            row, column = divmod(number, self.columns)
            x, y = _MARGIN + column * _LABEL_WIDTH, top - (row + 1) * _LABEL_HEIGHT + 0.06
            self._swatch(x, y, _SWATCH, self._hex(label))
            room = _LABEL_WIDTH - _SWATCH - 0.12
            name = self._text(
                x + _SWATCH + 0.06, y + 0.125, printable(label.name), fontproperties=self.bold
            )
            self._shorten(name, room)
            hue = "no hue" if label.hue is None else f"{label.hue:.0f}°"
            own = "" if label.name == srgb_hex(label.rgb) else f"{srgb_hex(label.rgb)}, "
            self._text(x + _SWATCH + 0.06, y + 0.01, f"{own}{hue}, |p| {label.chroma:.2f}")

    def _hex(self, label: Label) -> str:
        return hex_colors(self.palette, [label.rgb])[0]

    # --- profiles ---

    def _profiles(self, pairs: Sequence[Pair], top: float) -> None:
        width = (_WIDTH - 2 * _MARGIN - _NAMES - _GAP) / 2
        lefts = [_MARGIN + _NAMES, _MARGIN + _NAMES + width + _GAP]
        for left, name in zip(lefts, ("traditional", self.palette.blending), strict=True):
            self._text(left, top - _HEADING + 0.1, name, fontproperties=self.bold, size=TITLE)
        for number, pair in enumerate(pairs):
            bottom = top - _HEADING - number * _ROW - _BAR
            self._names(pair, bottom)
            for left, profile in zip(lefts, (pair.traditional, pair.result), strict=True):
                self._bar(profile, left, bottom, width)
        last = top - _HEADING - (len(pairs) - 1) * _ROW - _BAR - _STRIP - _BETWEEN
        for left in lefts:
            self._opacity_axis(left, last, width)

    def _names(self, pair: Pair, bottom: float) -> None:
        """Who is behind and who in front, and how far their hues are apart."""
        y = bottom + 0.04
        apart = "" if pair.angle is None else f"{pair.angle:.0f}°"
        end = self._text(_MARGIN + _NAMES - 0.1, y, apart, horizontalalignment="right")
        room = _NAMES - 0.1 - self._width_of(end) - 0.06 - _ARROW
        back, front = (
            self._text(_MARGIN, y, printable(self.palette.labels[number].name))
            for number in (pair.back, pair.front)
        )
        # Half of it for each, and what the other does not need.
        self._shorten(back, max(room / 2, room - self._width_of(front)))
        width = self._width_of(back)
        self._shorten(front, room - width)
        middle = _MARGIN + width + _ARROW / 2
        self._text(middle, y, "→", horizontalalignment="center")
        front.set_x((middle + _ARROW / 2) / self.width)

    def _bar(self, profile: Profile, left: float, bottom: float, width: float) -> None:
        """A blend, below it its hue alone, and a triangle where least of its chroma is left."""
        stack = self.palette.stack
        pixels = len(profile.rgb), 1
        if profile.threads:  # a pixel of the pattern is one of the figure
            pixels = round(width * PNG_DPI), round(_BAR * PNG_DPI)
        rgb, seen = patch(profile, stack.weave, *pixels)
        known = ~np.isnan(seen)
        hues = np.full((*seen.shape, 3), _NO_HUE, np.uint8)
        hues[known] = _straight_codes(stack.space.hue_axis.color(seen[known]).T)
        lowest = bottom - _STRIP - _BETWEEN
        axes = self._axes(left, lowest, width, _BAR + _STRIP + _BETWEEN)
        for codes, low, high in (
            (self._codes(rgb), bottom - lowest, bottom - lowest + _BAR),
            (hues[: round(_STRIP * PNG_DPI)], 0, _STRIP),
        ):
            axes.imshow(codes, aspect="auto", interpolation="none", extent=(0, 1, low, high))
        axes.set_xlim(0, 1)
        axes.set_ylim(0, _BAR + _STRIP + _BETWEEN)
        axes.set_axis_off()
        if profile.least_at is not None and profile.left is not None and profile.left < ALL:
            x, y = left + profile.least_at * width, lowest - 0.005
            corners = np.array([(x, y), (x - 0.028, y - 0.045), (x + 0.028, y - 0.045)])
            self.figure.add_artist(
                PolyCollection(
                    [corners / (self.width, self.height)],
                    facecolor=INK,
                    transform=self.figure.transFigure,
                )
            )

    def _opacity_axis(self, left: float, bottom: float, width: float) -> None:
        axes = self._axes(left, bottom - 0.06, width, 0.001)
        axes.set_xlim(0, 1)
        places = [0, 0.25, 0.5, 0.75, 1]
        axes.set_xticks(places, [f"{place:g}" for place in places])
        axes.set_yticks([])
        for side in ("left", "right", "top"):
            axes.spines[side].set_visible(False)
        self._style_ticks(axes)
        self._text(
            left + width / 2, bottom - 0.31, "opacity of the second label over the first",
            size=SMALL, horizontalalignment="center",
        )  # fmt: skip

    def _codes(self, rgb: Floats) -> NDArray[np.uint8]:
        return _straight_codes(shown(self.palette, rgb))

    # --- discs ---

    def _discs(self, top: float) -> None:
        radius = self._radius
        ways = ("traditional", self.palette.blending)
        for number, name in enumerate(ways):
            left = _MARGIN + number * (_DISC + _GAP)
            self._text(
                left + _DISC / 2, top - _HEADING + 0.1, name,
                fontproperties=self.bold, size=TITLE, horizontalalignment="center",
            )  # fmt: skip
            axes = self._axes(left, top - _HEADING - _DISC_HEIGHT, _DISC, _DISC_HEIGHT)
            high = _REACH * _DISC_HEIGHT / _DISC
            axes.set_axis_off()
            image = axes.imshow(
                self._mixture_codes(name, radius),
                extent=(-1, 1, -1, 1),
                interpolation="antialiased",
                zorder=0,
            )
            image.set_clip_path(Circle((0, 0), 1, transform=axes.transData))
            axes.set_xlim(-_REACH, _REACH)
            axes.set_ylim(-high, high)
            self._ring(axes)
            if number == 0 and len(self.palette.labels) <= _MOST_WITH_LINES:
                self._lines(axes, radius)
            self._marks(axes, radius)

    @property
    def _radius(self) -> float:
        """The |p| at the edge of a disc."""
        return _MARGIN_OF_DISC * max(*(label.chroma for label in self._marked), 1e-6)

    @property
    def _marked(self) -> list[Label]:
        """What stands on a disc: the labels, and the background where it has a hue."""
        background = self.palette.background
        return [*self.palette.labels, *([] if background.hue is None else [background])]

    def _mixture_codes(self, blending: str, radius: float) -> NDArray[np.uint8]:
        """(h, w, 3): at each p the colour of the brightest mixture, grey where there is none."""
        side = 2 * _RADIUS_PX + 1
        brightest: Floats = np.full((side, side), -np.inf)
        colors: Floats = np.zeros((side, side, 3))
        for p, rgb in self.palette.mixtures(blending):
            luminance, _ = self.palette.stack.space.forward(rgb)
            column = np.rint((p[0] / radius + 1) * _RADIUS_PX).astype(np.intp)
            row = np.rint((1 - p[1] / radius) * _RADIUS_PX).astype(np.intp)
            inside = (column >= 0) & (column < side) & (row >= 0) & (row < side)
            # The brightest is written last.
            order = np.flatnonzero(inside)[np.argsort(luminance[inside], kind="stable")]
            place = row[order] * side + column[order]
            last = len(place) - 1 - np.unique(place[::-1], return_index=True)[1]
            chosen = order[last]
            better = luminance[chosen] > brightest[row[chosen], column[chosen]]
            chosen = chosen[better]
            brightest[row[chosen], column[chosen]] = luminance[chosen]
            colors[row[chosen], column[chosen]] = rgb[:, chosen].T
        brightest, colors = _widened(brightest, colors, _DOT_PX)
        codes = self._codes(colors)
        codes[np.isneginf(brightest)] = np.rint(np.array(_INSIDE) * 255)
        return codes

    def _ring(self, axes: Any) -> None:
        """All hues around, each at the angle that its p has."""
        turn = np.linspace(0, 2 * math.pi, _RING_CELLS, endpoint=False)
        step = 2 * math.pi / _RING_CELLS
        space = self.palette.stack.space
        middle = turn + step / 2
        p = 0.02 * np.stack([np.cos(middle), np.sin(middle)])
        hues = space.hue_axis.degrees(space.inverse(np.ones(_RING_CELLS), p))
        corners = []
        for begin in turn:
            # Each reaches below the next, and no seam shows between them.
            angles = np.array([begin, begin + step, begin + 1.5 * step])
            points = np.stack([np.cos(angles), np.sin(angles)], axis=1)
            corners.append(np.concatenate([_RING_INSIDE * points, _RING_OUTSIDE * points[::-1]]))
        axes.add_collection(
            PolyCollection(corners, facecolors=hue_colors(space.hue_axis, hues), linewidth=0)
        )

    def _lines(self, axes: Any, radius: float) -> None:
        """The way of each opaque pair from one label to the other, the paper's Figure 2."""
        space = self.palette.stack.space
        for pair in self.palette.soonest:
            p = space.forward(pair.traditional.rgb.T)[1] / radius
            axes.plot(p[0], p[1], color=INK, linewidth=0.6, linestyle=(0, (3, 2)), zorder=3)

    def _marks(self, axes: Any, radius: float) -> None:
        """A circle in its colour where each label is, and its name outside the ring."""
        space = self.palette.stack.space
        colors = np.array([label.rgb for label in self._marked])
        places = space.forward(colors.T)[1].T / radius
        for label, (x, y) in zip(self._marked, places, strict=True):
            shape = "s" if label is self.palette.background else "o"
            axes.plot(
                [x], [y], marker=shape, markersize=6.5, markerfacecolor=self._hex(label),
                markeredgecolor="white", markeredgewidth=1.0, zorder=4,
            )  # fmt: skip
            axes.plot(
                [x], [y], marker=shape, markersize=7.4, markerfacecolor="none",
                markeredgecolor=INK, markeredgewidth=0.5, zorder=5,
            )  # fmt: skip
        with_hue = [n for n, label in enumerate(self._marked) if label.hue is not None]
        angles = np.degrees(np.arctan2(places[with_hue, 1], places[with_hue, 0])) % 360
        for number, angle in zip(with_hue, _apart(angles, _TAGS_APART), strict=True):
            x, y = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            side = "left" if x > 0.3 else "right" if x < -0.3 else "center"
            text = axes.text(
                _TAG * x, _TAG * y, printable(self._marked[number].name),
                horizontalalignment=side, color=INK, parse_math=False,
                verticalalignment="center" if side != "center" else "bottom" if y > 0 else "top",
            )  # fmt: skip
            text.set_fontproperties(self.font)
            text.set_fontsize(SMALL)
            self._shorten(text, self._room(x, side))

    def _room(self, x: float, side: str) -> float:
        """Inches that a name beside a disc has."""
        inch = _DISC / (2 * _REACH)
        return max((_REACH + 0.02 - _TAG * abs(x)) * inch, 0.3) if side != "center" else 0.9


def _straight_codes(rgb: Floats) -> NDArray[np.uint8]:
    """Linear colours (…, 3) as 8-bit sRGB, what lies outside paler."""
    flat = np.array(rgb, np.float64).reshape(-1, 3)
    outside = ((flat < 0) | (flat > 1)).any(axis=1)
    flat[outside] = into_gamut(flat[outside])
    codes = np.rint(encode_srgb(flat.clip(0, 1)) * 255).astype(np.uint8)
    return codes.reshape(rgb.shape)


def _widened(brightness: Floats, colors: Floats, by: int) -> tuple[Floats, Floats]:
    """Every pixel as a round dot of that radius, the brighter over the darker."""
    best = brightness.copy()
    whence = np.arange(brightness.size).reshape(brightness.shape)
    sources = whence.copy()
    for dy in range(-by, by + 1):
        for dx in range(-by, by + 1):
            if 0 < dx * dx + dy * dy <= by * by:
                moved = np.roll(brightness, (dy, dx), (0, 1))
                better = np.flatnonzero(moved > best)
                best.flat[better] = moved.flat[better]
                sources.flat[better] = np.roll(whence, (dy, dx), (0, 1)).flat[better]
    return best, colors.reshape(-1, 3)[sources]


def _apart(angles: Floats, least: float) -> Floats:
    """Angles in degrees moved as little as need be to be that far from each other."""
    n = len(angles)
    if n < 2:
        return angles
    order = np.argsort(angles, kind="stable")
    spread = angles[order].astype(np.float64)
    for _ in range(60):
        gaps = np.diff(spread, append=spread[0] + 360)
        push = np.maximum(least - gaps, 0) / 2
        if push.max() < 0.01:
            break
        spread = spread - push + np.roll(push, 1)
    moved = np.empty_like(spread)
    moved[order] = spread
    return moved
