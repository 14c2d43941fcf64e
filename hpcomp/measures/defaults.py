"""What measures count where nothing else is asked. Light, as every command shows it in its help."""

from __future__ import annotations

#: Bins of a histogram: one for each degree.
DEFAULT_BINS = 360

#: The saturation below which a colour counts as grey.
DEFAULT_ACHROMATIC = 0.02
