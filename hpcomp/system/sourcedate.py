"""The only date that is ever written: the one that the environment asks for, never the clock's.

https://reproducible-builds.org/specs/source-date-epoch/
"""

from __future__ import annotations

import os
import re
from datetime import UTC, datetime

from ..errors import SettingError

VARIABLE = "SOURCE_DATE_EPOCH"

#: How EXR writes a date, after Exif.
EXR_DATE = "%Y:%m:%d %H:%M:%S"


def source_date() -> datetime | None:
    """The date of SOURCE_DATE_EPOCH, seconds since 1970 in UTC; None where it is not set.

    Errors: `SettingError` for what is no such number.
    """
    text = os.environ.get(VARIABLE)
    if not text:
        return None
    try:
        if not re.fullmatch(r"\d+", text, re.ASCII):
            raise ValueError
        return datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError):
        raise SettingError(
            f"{VARIABLE} is '{text}': it takes a number of seconds since 1970, or unset it"
        ) from None
