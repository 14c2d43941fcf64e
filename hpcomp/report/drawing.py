"""What all figures to publish share, and the only importer of matplotlib: a sheet, and its bytes.

The same sheet gives the same bytes: fonts are those that come with matplotlib, nobody's
matplotlibrc is read, and neither the clock nor a version is written.
"""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Callable
from email.utils import format_datetime
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OutputError
from ..system.sourcedate import source_date

# What it has to say of its caches is not for those who ask for a figure.
logging.getLogger("matplotlib").setLevel(logging.CRITICAL)

try:
    import matplotlib
    from matplotlib.collections import PolyCollection as PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties
    from matplotlib.patches import Circle as Circle
    from matplotlib.patches import Rectangle
    from matplotlib.text import Text
except ImportError as missing:
    raise OutputError(
        f"a figure needs matplotlib, which cannot be imported ({missing}): "
        "pip install 'hpcomp[plot]'"
    ) from None

PNG_DPI = 200

INK, PALE = "#222222", "#d0d0d0"
#: Sizes of letters, in points.
TITLE, TEXT, SMALL, SMALLEST = 9.0, 7.0, 6.5, 5.0

#: What is left of a text that has no room.
_FEWEST_LETTERS = 4

_RC: dict[str, Any] = {
    "svg.hashsalt": "hpcomp",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
    "path.simplify": False,
    "axes.linewidth": 0.6,
    "axes.unicode_minus": True,
    "text.usetex": False,
}


def _metadata(format: str) -> dict[str, Any]:
    """What a figure says of itself: no version, and the date of the environment alone."""
    date = source_date()
    written = None if date is None else format_datetime(date, usegmt=True)
    rows: dict[str, dict[str, Any]] = {
        "svg": {"Date": None if date is None else [date], "Creator": "hpcomp"},
        "png": {"Software": None, **({"Creation Time": written} if written else {})},
        "pdf": {"CreationDate": date, "Creator": "hpcomp", "Producer": None},
    }
    return rows[format]


def saved(draw: Callable[[], Sheet], format: str) -> bytes:
    """The file of the sheet that `draw` makes: svg, png or pdf."""
    stream = io.BytesIO()
    # SVG names its parts after numbers as numpy prints them, which other libraries change.
    plain = np.printoptions(legacy=False)
    with plain, matplotlib.rc_context(), warnings.catch_warnings():
        # File names may have letters that the font does not have: they become boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_RC)
        figure = draw().figure
        figure.savefig(stream, format=format, dpi=PNG_DPI, metadata=_metadata(format))
    return stream.getvalue()


class Sheet:
    """A white figure of `width` × `height` inches; places on it are inches from the bottom left."""

    width: float
    height: float
    figure: Figure

    def __init__(self) -> None:
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self.font = FontProperties(fname=fonts / "DejaVuSans.ttf")
        self.bold = FontProperties(fname=fonts / "DejaVuSans-Bold.ttf")

    def _open(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self.figure = Figure(figsize=(width, height), facecolor="white")

    def _axes(self, left: float, bottom: float, width: float, height: float, **how: Any) -> Any:
        place = (left / self.width, bottom / self.height, width / self.width, height / self.height)
        return self.figure.add_axes(place, **how)

    def _text(self, x: float, y: float, text: str, **how: Any) -> Text:
        how.setdefault("fontproperties", self.font)
        size = how.pop("size", TEXT)
        made = self.figure.text(
            x / self.width, y / self.height, text, color=INK, parse_math=False, **how
        )
        made.set_fontsize(size)
        return made

    def _width_of(self, text: Text) -> float:
        return float(text.get_window_extent().width / self.figure.dpi)

    def _shorten(self, text: Text, room: float) -> None:
        """Takes letters from the middle until it fits."""
        whole = text.get_text()
        if self._width_of(text) <= room:
            return

        def keep(letters: int) -> bool:
            text.set_text(whole[: -(-letters // 2)] + "…" + whole[len(whole) - letters // 2 :])
            return self._width_of(text) <= room

        least, too_many = min(_FEWEST_LETTERS, len(whole)), len(whole)
        while too_many - least > 1:
            middle = (least + too_many) // 2
            least, too_many = (middle, too_many) if keep(middle) else (least, middle)
        keep(least)

    def _swatch(self, x: float, y: float, size: float, color: str) -> None:
        """A square of that colour."""
        self.figure.add_artist(
            Rectangle(
                (x / self.width, y / self.height),
                size / self.width,
                size / self.height,
                facecolor=color,
                edgecolor=INK,
                linewidth=0.3,
                transform=self.figure.transFigure,
            )
        )

    def _style_ticks(self, axes: Any) -> None:
        axes.tick_params(length=2.2, width=0.6, pad=1.5, color=INK)
        for label in (*axes.get_xticklabels(), *axes.get_yticklabels()):
            label.set_fontproperties(self.font)
            label.set_fontsize(SMALL)
            label.set_color(INK)
