"""What measures count where nothing else is asked, and what may be asked.

Light, as every command shows it in its help.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

from ..errors import SettingError
from ..system.streams import STDOUT

#: Bins of a histogram: one for each degree.
DEFAULT_BINS = 360
#: One bin for a sextant at least; beyond a tenth of a degree, bins hold rounding.
FEWEST_BINS, MOST_BINS = 6, 3600

#: The saturation below which a colour counts as grey.
DEFAULT_ACHROMATIC = 0.02

#: Side of the cells, in pixels, in which a label is seen if one pixel shows its hue.
CELL = 16

#: How the files of reports end: of each of their formats.
REPORT_ENDINGS = (".txt", ".json", ".csv", ".svg", ".png", ".pdf", ".html")


def check_bins(bins: int) -> int:
    """The number of bins as it is; `SettingError` outside `FEWEST_BINS` to `MOST_BINS`."""
    if not FEWEST_BINS <= bins <= MOST_BINS:
        raise SettingError(f"bins {bins} is outside {FEWEST_BINS} to {MOST_BINS}")
    return bins


def check_achromatic(saturation: float) -> float:
    """The saturation as a float; `SettingError` outside [0, 1]."""
    return _within("achromatic saturation", saturation, 1)


def check_foreign_tolerance(degrees: float) -> float:
    """The tolerance as a float; `SettingError` outside [0, 180] degrees."""
    return _within("foreign tolerance", degrees, 180)


def check_energy_weights(weights: str | Sequence[float]) -> tuple[float, float, float]:
    """Weights of red, green and blue as floats, from `0.3,0.25,0.45` too.

    Errors: `SettingError` unless they are 3, finite and ≥ 0.
    """
    try:
        given = weights.split(",") if isinstance(weights, str) else weights
        checked = tuple(float(weight) for weight in given)
    except ValueError:
        checked = ()
    if len(checked) != 3 or not all(0 <= weight < math.inf for weight in checked):
        shown = weights if isinstance(weights, str) else ",".join(f"{w:g}" for w in checked)
        raise SettingError(
            f"energy weights {shown} are not three numbers of at least 0: write 0.3,0.25,0.45"
        )
    return checked


def check_report(path: str) -> str:
    """The path of a report as it is; `SettingError` where its ending names no format."""
    if path != STDOUT and os.path.splitext(path)[1].lower() not in REPORT_ENDINGS:
        raise SettingError(
            f"report {path}: its ending names no format: end it in {', '.join(REPORT_ENDINGS)}"
        )
    return path


def check_provenance(path: str) -> str:
    """The path of a provenance as it is; `SettingError` where that is not of an EXR."""
    if os.path.splitext(path)[1].lower() != ".exr":
        raise SettingError(f"provenance {path} is an EXR: end it in .exr")
    return path


def _within(what: str, value: float, most: float) -> float:
    if not 0 <= value <= most:
        raise SettingError(f"{what} {value:g} is outside 0 to {most}")
    return float(value)
