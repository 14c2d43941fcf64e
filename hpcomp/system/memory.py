"""Amounts of memory, and numbers of pixels, as people write them. Measures none."""

from __future__ import annotations

import re

from ..errors import SettingError

#: How many pixels a picture may claim where nobody says otherwise: whatever a file of a few
#: megabytes says of itself, no run is to be busy with it for long.
MAX_PIXELS = "2G"

_AMOUNT = re.compile(r"(\d{1,99}(?:\.\d{1,99})?)\s*([KMGT]?)", re.IGNORECASE | re.ASCII)
_BYTES = re.compile(r"(?:i?B)?", re.IGNORECASE)


def parse_bytes(text: str | int) -> int:
    """A number of bytes from `64M`, `1.5G` or a plain number; powers of 1024."""
    number = _parsed(text, 1024, _BYTES)
    if number is None:
        raise SettingError(f"'{text}' is not an amount of memory: write 512M or 2G")
    return number


def parse_pixels(text: str | int) -> int:
    """A number of pixels from `500M`, `1.5G` or a plain number; powers of 1000."""
    number = _parsed(text, 1000)
    if number is None:
        raise SettingError(f"'{text}' is not a number of pixels: write 500M or 4G")
    return number


def _parsed(text: str | int, step: int, unit: re.Pattern[str] = re.compile("")) -> int | None:
    """The number, whose letter counts powers of `step`, before a unit; None for another text."""
    match = _AMOUNT.match(str(text))
    if match is None or not unit.fullmatch(str(text), match.end()):
        return None
    number, letter = match.groups()
    return int(float(number) * step ** " KMGT".index(letter.upper() or " "))
