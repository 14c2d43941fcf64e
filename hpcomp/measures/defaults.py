"""What measures count where nothing else is asked, and what may be asked.

Light, as every command shows it in its help.
"""

from __future__ import annotations

from ..errors import SettingError

#: Bins of a histogram: one for each degree.
DEFAULT_BINS = 360
#: One bin for a sextant at least; beyond a tenth of a degree, bins hold rounding.
FEWEST_BINS, MOST_BINS = 6, 3600

#: The saturation below which a colour counts as grey.
DEFAULT_ACHROMATIC = 0.02


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


def _within(what: str, value: float, most: float) -> float:
    if not 0 <= value <= most:
        raise SettingError(f"{what} {value:g} is outside 0 to {most}")
    return float(value)
