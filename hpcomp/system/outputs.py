"""Outputs that appear whole or not at all: written beside their place, then renamed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import sys
import zlib
from collections.abc import Iterable, Iterator
from typing import BinaryIO

from ..errors import OutputError, SettingError, why
from .streams import STDOUT, stdout_bytes

#: What the names of temporary files begin with, behind the dot of hidden ones. Behind it stand what
#: tells the output and the machine, and a random number: `.hpcomp.1c0ffee5.0123456789abcdef`.
_PREFIX = "hpcomp."
#: That of this process: one that another one tidies up after has a name of its own here.
temporary_prefix = _PREFIX


@contextlib.contextmanager
def whole_output(target: str, *, clobber: bool = True, if_changed: bool = False) -> Iterator[str]:
    """Gives a temporary path to write to, and puts what was written at `target` on success.

    `target`: a path; `-` for stdout; links are followed; devices and pipes are written through.
    `if_changed`: a file that has these bytes already is left as it is, with its time.
    On any exception the temporary file is removed and `target` stays as it was. What a run that was
    killed has left beside `target` is removed, too.
    Errors: `OutputError` where the directory is missing or not writable, where `target` is a
    directory, or where it exists and `clobber` is off.
    """
    stream = target == STDOUT
    label = "stdout" if stream else target
    if stream and sys.stdout is None:
        raise OutputError(f"{label} is closed: give it a reader, or name a file")
    special = stream or _is_special(target, clobber)
    place = target if special else os.path.realpath(target)
    # The name first and the file inside the `try`: wherever a signal strikes, the file is removed.
    directory = _temporary_directory() if special else os.path.dirname(place)
    hidden = "" if special else "."
    if not special and temporary_prefix == _PREFIX:
        remove_abandoned([place])
    begin = os.path.join(directory, f"{hidden}{temporary_prefix}{_tag(place)}.")
    temporary, held = "", -1
    try:
        while held < 0:
            temporary = f"{begin}{os.urandom(8).hex()}"
            try:
                held = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
            except OSError as reason:
                where = directory if special else os.path.dirname(target) or "."
                raise OutputError(
                    f"{label}: cannot write in the directory {where}: {why(reason)}"
                ) from None
            if not _is_ours(held):
                os.close(held)
                held = -1
        yield temporary
        try:
            if stream:
                with stdout_bytes() as pipe:
                    _copy(temporary, pipe)
            elif special:
                with open(target, "wb") as device:
                    _copy(temporary, device)
            else:
                if not clobber and os.path.lexists(place):
                    raise _exists(target)
                if if_changed and _same_bytes(temporary, place):
                    return
                os.chmod(temporary, _mode(place))
                os.replace(temporary, place)
        except BrokenPipeError:
            raise
        except OSError as reason:
            raise OutputError(f"{label}: cannot be written: {why(reason)}") from None
    finally:
        # Where there is none, a disk that is read-only says so instead.
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        if held >= 0:
            os.close(held)


def write_bytes(place: str, content: bytes, label: str) -> None:
    """Writes all of a file to the `place` that `whole_output` gave; `label` names it in errors.

    Errors: `OutputError`.
    """
    with writing(label), open(place, "wb") as file:
        file.write(content)


def check_places(paths: Iterable[str]) -> None:
    """Refuses outputs of which one would replace another. Errors: `SettingError`."""
    taken = set()
    for path in paths:
        place = path if path == STDOUT else os.path.realpath(path)
        if place in taken:
            shown = "stdout" if path == STDOUT else path
            raise SettingError(f"{shown} is named for two outputs: give each its own")
        taken.add(place)


@contextlib.contextmanager
def writing(label: str, done: str = "written") -> Iterator[None]:
    """What the system refuses in the block is an `OutputError` about `label`."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as reason:
        raise OutputError(f"{label}: cannot be {done}: {why(reason)}") from None


def remove_leftovers(targets: Iterable[str], prefix: str) -> None:
    """Removes the temporary files beside `targets` that a killed process of that prefix left."""
    for directory in {os.path.dirname(os.path.realpath(target)) for target in targets}:
        with contextlib.suppress(OSError):
            for name in os.listdir(directory):
                if name.startswith(f".{prefix}"):
                    with contextlib.suppress(FileNotFoundError):
                        os.unlink(os.path.join(directory, name))


def remove_abandoned(targets: Iterable[str]) -> None:
    """Removes the temporary files of `targets` that nobody writes any more.

    A process has a lock on what it writes, which ends with it, however it ends. Another machine may
    not see the lock: files of processes on this one alone are removed. Who has just made one and
    finds it locked or gone before he could lock it makes another.
    """
    tags: dict[str, set[str]] = {}
    for target in targets:
        place = os.path.realpath(target)
        tags.setdefault(os.path.dirname(place), set()).add(_tag(place))
    for directory, wanted in tags.items():
        with contextlib.suppress(OSError), os.scandir(directory) as entries:
            for entry in entries:
                if entry.name.startswith(f".{_PREFIX}") and entry.name.split(".")[-2] in wanted:
                    _remove_unlocked(entry.path)


def _tag(place: str) -> str:
    """What tells in the name of a temporary file which output it is of, and on which machine."""
    words = f"{os.uname().nodename}/{os.path.basename(place)}"
    return f"{zlib.crc32(os.fsencode(words)):08x}"


def _is_ours(made: int) -> bool:
    """Whether a file that was just made is locked now, or is on a file system without locks.

    Else somebody took it for one that was abandoned, and has removed it or is about to.
    """
    try:
        fcntl.flock(made, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return os.fstat(made).st_nlink > 0


def _remove_unlocked(path: str) -> None:
    """Removes a file unless a process has it locked, or the file system knows no locks."""
    with contextlib.suppress(OSError):
        file = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if stat.S_ISREG(os.fstat(file).st_mode):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(path)
        finally:
            os.close(file)


def _temporary_directory() -> str:
    import tempfile  # with all that it imports, which a plain output has no use for

    try:
        return tempfile.gettempdir()
    except OSError as reason:
        raise OutputError(f"stdout: no temporary file can be made: {why(reason)}") from None


def _copy(path: str, stream: BinaryIO) -> None:
    with open(path, "rb") as written:
        while data := written.read(1 << 20):
            stream.write(data)
    stream.flush()


def _same_bytes(written: str, place: str) -> bool:
    """Whether there is a file at `place` that holds what was written."""
    try:
        if os.path.getsize(place) != os.path.getsize(written):
            return False
        with open(written, "rb") as ours, open(place, "rb") as theirs:
            while (block := ours.read(1 << 20)) == theirs.read(1 << 20):
                if not block:
                    return True
    except OSError:
        pass  # it is replaced
    return False


def _is_special(target: str, clobber: bool) -> bool:
    """Whether `target` is a device or pipe, to be written through; refuses what cannot be."""
    try:
        # Before links are followed: those of /dev/stdout and /dev/fd lead to no path.
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        if not os.path.isdir(os.path.dirname(os.path.realpath(target))):
            shown = os.path.dirname(target) or "."
            raise OutputError(f"{target}: there is no directory {shown}: make it first") from None
        return False
    except OSError as reason:
        raise OutputError(f"{target}: cannot be written: {why(reason)}") from None
    if stat.S_ISDIR(mode):
        raise OutputError(f"{target} is a directory: name a file in it")
    if not stat.S_ISREG(mode):
        return True
    if not clobber:
        raise _exists(target)
    return False


def _exists(target: str) -> OutputError:
    return OutputError(f"{target} exists and --no-clobber keeps it: choose another output")


def _mode(place: str) -> int:
    """The permissions of what stands there, or those that the umask gives a new file."""
    try:
        return stat.S_IMODE(os.stat(place).st_mode)
    except FileNotFoundError:
        umask = os.umask(0)
        os.umask(umask)
        return 0o666 & ~umask
