"""The standard streams, by the name that stands for them where a path is asked for. No files."""

from __future__ import annotations

import sys
from typing import BinaryIO

from ..errors import OutputError

#: Of an input and of an output: one name for two things, so each is compared with its own.
STDIN = "-"
STDOUT = "-"


def stdout_bytes() -> BinaryIO:
    """Stdout as a stream that writes all that it is given.

    Python's own does not where PYTHONUNBUFFERED is set: what a pipe does not take at once is lost.
    Errors: `OutputError` where it is closed.
    """
    if sys.stdout is None:
        raise OutputError("stdout is closed: give it a reader")
    sys.stdout.flush()
    return open(sys.stdout.fileno(), "wb", closefd=False)
