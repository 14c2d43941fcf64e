"""What the header of a written picture says: windows, primaries, shape of pixels. No format."""

from __future__ import annotations

from ..color.primaries import REC709, Primaries
from ..geometry import Window
from ..records import record

METRES_PER_INCH = 0.0254


@record
class PictureHeader:
    """Of one picture, in either format.

    `data_window`: the pixels that are written; a PNG keeps no more of windows than its size.
    `primaries`: those of the samples. `pixel_aspect`: width over height of a pixel.
    `pixels_per_metre`: across and down, or None.
    """

    data_window: Window
    display_window: Window
    primaries: Primaries = REC709
    pixel_aspect: float = 1.0
    pixels_per_metre: tuple[float, float] | None = None

    @property
    def pixels_per_inch(self) -> float | None:
        """Across, as an EXR has it."""
        return self.pixels_per_metre and self.pixels_per_metre[0] * METRES_PER_INCH
