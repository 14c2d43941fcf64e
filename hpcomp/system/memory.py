"""Amounts of memory, as people write them. Measures none."""

from __future__ import annotations

import re

from ..errors import SettingError

_BYTES = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE | re.ASCII)


def parse_bytes(text: str | int) -> int:
    """A number of bytes from `64M`, `1.5G` or a plain number; powers of 1024."""
    match = _BYTES.fullmatch(str(text))
    if not match:
        raise SettingError(f"'{text}' is not an amount of memory: write 512M or 2G")
    number, unit = match.groups()
    return int(float(number) * 1024 ** " KMGT".index(unit.upper() or " "))
