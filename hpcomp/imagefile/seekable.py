"""Files that can be read more than once: stdin and pipes are copied first. Parses nothing."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import sys
from collections.abc import Iterator
from typing import IO

from ..errors import InputError, why
from ..system.streams import STDIN


@contextlib.contextmanager
def seekable(path: str, label: str) -> Iterator[str]:
    """A path that can be read more than once: stdin and pipes are copied to a temporary file."""
    try:
        special = path == STDIN or not _is_plain(path)
    except OSError as reason:
        raise InputError(f"{label}: cannot be read: {why(reason)}") from None
    if not special:
        yield path
        return
    if path == STDIN and sys.stdin is None:
        raise InputError(f"{label}: stdin is closed")
    with temporary(label) as (copy, copy_path):
        try:
            if path == STDIN:
                _copy_pipe(sys.stdin.fileno(), copy)
            else:
                with open(path, "rb", buffering=0) as pipe:
                    _copy_pipe(pipe.fileno(), copy)
            copy.flush()
        except OSError as reason:
            raise InputError(f"{label}: cannot be read: {why(reason)}") from None
        yield copy_path


@contextlib.contextmanager
def temporary(label: str) -> Iterator[tuple[IO[bytes], str]]:
    """A temporary file and its path; it goes with the process, however that ends, where it can.

    `label`: of what is to be copied there, for the `InputError` where no file can be made.
    """
    import tempfile  # with all that it imports, which plain files have no use for

    unnamed = sys.platform == "linux"
    make = tempfile.TemporaryFile if unnamed else tempfile.NamedTemporaryFile
    try:
        file = make(prefix="hpcomp.")
    except OSError as reason:
        raise InputError(
            f"{label}: cannot be read, as no temporary file can be made: {why(reason)}"
        ) from None
    with file:
        yield file, f"/dev/fd/{file.fileno()}" if unnamed else str(file.name)


#: Seconds after which a signal is noticed that arrived just before a read began to wait.
_PATIENCE = 0.2


def _copy_pipe(source: int, copy: IO[bytes]) -> None:
    while True:
        while not select.select([source], [], [], _PATIENCE)[0]:
            pass
        data = os.read(source, 1 << 20)
        if not data:
            return
        copy.write(data)


def _is_plain(path: str) -> bool:
    """Whether libraries can open it again and again: no pipe, and a name that is UTF-8."""
    mode = os.stat(path).st_mode
    utf8 = path.isascii() or not any("\udc80" <= character <= "\udcff" for character in path)
    return stat.S_ISDIR(mode) or (stat.S_ISREG(mode) and utf8)
