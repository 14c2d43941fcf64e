"""Colours as CSS writes them, in linear light. Knows no pixels and no labels."""

from __future__ import annotations

import numpy as np

from ..errors import SettingError
from .transfer import SRGB


def parse_hex_color(text: str) -> tuple[float, float, float]:
    """Straight linear RGB in [0, 1] of a CSS hex colour: `#rgb` or `#rrggbb`, in sRGB."""
    digits = text.removeprefix("#")
    if len(digits) == 3:
        digits = "".join(2 * digit for digit in digits)
    try:
        codes = bytes.fromhex(digits) if digits.isalnum() else b""
    except ValueError:
        codes = b""
    if len(codes) != 3:
        raise SettingError(f"'{text}' is not a colour: write a CSS hex colour such as #ff8800")
    red, green, blue = (float(v) for v in SRGB.decode(np.frombuffer(codes, np.uint8) / 255))
    return red, green, blue
