"""The pictures of a page, made strip by strip: those that are compared, and whose hue is where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..blending.rules import StackRules
from ..color.quantization import Losses
from ..color.samples import NOTHING, Strip
from ..engine import choice as engine
from ..geometry import Window
from ..measures.labels import RESULTS
from ..measures.squares import Squares, areas_of, means
from .stackreport import Preview, preview_scale

#: The blendings of which a page always shows a picture.
COMPARED = ("traditional", "hue-preserving", "woven")

#: What a square takes for each layer and result: its sums in the engine, here, and as a strip.
_SQUARE_BYTES = 32 + 32 + 16
#: What a pixel of each whole picture takes: sums, means and codes.
_PICTURE_BYTES = 32 + 16 + 4

Codes = NDArray[np.uint8]


def compared(rules: StackRules) -> tuple[str, ...]:
    """The blendings that a page compares, in the order to be shown."""
    return tuple(dict.fromkeys((*COMPARED, rules.blending.name)))


class SmallPictures:
    """What becomes the preview of a stack: `Squares` of strips come in, from the top.

    A picture that is measured is the mean of each square of the large one. Another is blended from
    the layers, which are made small first: the pattern of a woven one would not be seen otherwise.
    """

    def __init__(self, rules: StackRules, window: Window, canvas: Window) -> None:
        self._rules, self._window = rules, window
        self._scale = scale = preview_scale(window.width, window.height)
        self._origin = (window.x - canvas.x) // scale, (window.y - canvas.y) // scale
        self._areas = areas_of(scale, window.width, window.height)
        self._layer = np.zeros(self._areas.shape, np.uint32)
        self._measured = measured = _measured(rules)
        self._sums = {name: np.zeros((*self._areas.shape, 4), np.int64) for name in measured}
        self._blended = {
            name: np.zeros((*self._areas.shape, 4), np.uint8)
            for name in compared(rules)
            if name not in measured
        }
        # Of the lowest squares, which are not whole yet.
        self._begun: dict[int, NDArray[np.int64]] = {}

    @staticmethod
    def memory(rules: StackRules, layers_met: int, window: Window) -> tuple[int, int]:
        """Bytes for each pixel of a strip that so many layers meet in, and for the whole."""
        scale = preview_scale(window.width, window.height)
        across, down = -(-window.width // scale), -(-window.height // scale)
        row = (layers_met + len(RESULTS)) * _SQUARE_BYTES
        fixed = across * (down * len(compared(rules)) * _PICTURE_BYTES + 2 * row)
        return -(-row // scale**2), fixed

    def squares(self, rows: Window) -> Squares:
        """Those of a strip, to be added to."""
        return Squares(self._scale, self._row(rows) % self._scale, rows.width, rows.height)

    def add(self, rows: Window, squares: Squares, layer: NDArray[np.uint32]) -> None:
        """Takes the next strip; `layer` (height, width): whose hue survived, as in `Provenance`."""
        begin = self._row(rows)
        first = begin // self._scale
        inside = slice(first, first + squares.shape[0])
        for name, sums in self._sums.items():
            sums[inside] += squares.sums[self._measured[name]]
        at_top = -begin % self._scale
        ours = layer[at_top :: self._scale, :: self._scale]
        above = first + (at_top > 0)
        self._layer[above : above + len(ours)] = ours
        self._blend(first, squares, ends=begin + rows.height == self._window.height)

    def _blend(self, first: int, squares: Squares, ends: bool) -> None:
        """Blends the rows of squares that are whole now, and keeps the last one where it is not."""
        sums = {number: of for number, of in squares.sums.items() if isinstance(number, int)}
        for number, row in self._begun.items():
            sums.setdefault(number, np.zeros(squares.shape, np.int64))[0] += row
        last = (squares.top + squares.height) % self._scale != 0 and not ends
        whole = squares.shape[0] - last
        self._begun = {number: of[-1].copy() for number, of in sums.items()} if last else {}
        if not whole:
            return
        inside = slice(first, first + whole)
        strips = [NOTHING] * len(self._rules.operators)
        for number, of in sums.items():
            strips[number] = Strip(means(of[:whole], self._areas[inside]))
        # The sums are of layers at their opacities.
        rules = replace(self._rules, opacities=(1.0,) * len(strips))
        origin = self._origin[0], self._origin[1] + first
        for name, picture in self._blended.items():
            picture[inside] = _composited(
                rules.blended(name), strips, picture[inside].shape, origin
            )

    def result(self) -> Preview:
        """The preview, once all strips have come."""
        shown = self._blended | {name: self._shown(sums) for name, sums in self._sums.items()}
        pictures = {name: shown[name] for name in compared(self._rules)}
        own = self._rules.blending.name
        return Preview(pictures, own, self._layer, self._scale, tuple(self._blended))

    def _shown(self, sums: NDArray[np.int64]) -> Codes:
        """A measured picture as it is shown: exposed, in code values."""
        alone = replace(self._rules.of_layers((0,)), background=None, opacities=(1.0,))
        colors = Strip(means(sums, self._areas))
        return _composited(alone.blended("traditional"), [colors], sums.shape, (0, 0))

    def _row(self, rows: Window) -> int:
        return rows.y - self._window.y


def _measured(rules: StackRules) -> dict[str, str]:
    """The pictures that are measured, and which of `labels.RESULTS` each is."""
    if rules.blending.depends_on_place:
        return {"traditional": "traditional", "hue-preserving": "hue_preserving"}
    return {"traditional": "traditional", rules.blending.name: "result"}


def _composited(
    rules: StackRules, strips: Sequence[Strip], shape: tuple[int, ...], origin: tuple[int, int]
) -> Codes:
    """Straight sRGB with alpha, (height, width, 4)."""
    height, width = shape[:2]
    accumulator = engine.start(rules, width, height, origin=origin)
    accumulator.add(rules.arrival, [strips[number] for number in rules.arrival])
    codes: Codes = accumulator.result("uint8", Losses())
    return codes
