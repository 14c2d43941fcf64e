"""What people read: one line at a time on stderr, which carries nothing that a library prints."""

from __future__ import annotations

import contextlib
import os
import sys

from ..errors import one_line


def say(text: str) -> None:
    """Prints one line on stderr; nowhere if that is closed."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):
            print(one_line(text), file=sys.stderr, flush=True)


def open_standard_streams() -> None:
    """Gives closed standard streams a place, so that no picture gets their file descriptor."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def keep_libraries_off_stderr() -> None:
    """Moves stderr to a descriptor of its own: what codecs print to file descriptor 2 is lost."""
    if sys.stderr is None:
        return
    ours = os.dup(2)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 2)
    os.close(silence)
    sys.stderr = open(ours, "w", encoding="utf-8", errors="backslashreplace", buffering=1)  # noqa: SIM115
