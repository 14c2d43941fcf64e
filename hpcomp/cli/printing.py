"""What a command prints on stdout, which carries data only."""

from __future__ import annotations

import sys

from ..system.outputs import writing
from ..system.streams import stdout_bytes


def print_data(text: str) -> None:
    """Prints on stdout; `OutputError` where it takes none."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print_bytes(f"{text}\n".encode(encoding, "backslashreplace"))


def print_bytes(data: bytes) -> None:
    """Prints data as they are; `OutputError` where stdout takes none."""
    with writing("stdout"), stdout_bytes() as stdout:
        stdout.write(data)
