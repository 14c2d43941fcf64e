"""What can go wrong, once for the whole package: the exceptions, their exit codes, the warnings."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum


class ExitCode(IntEnum):
    """The exit codes of the command: a stable interface for makefiles and scripts."""

    DONE = 0
    BUG = 1
    USAGE = 2
    INPUT = 3
    MISMATCH = 4
    OUTPUT = 5
    CHECK = 6
    INTERRUPTED = 130
    PIPE_CLOSED = 141
    TERMINATED = 143


#: What each exit code tells the caller; REFERENCE.md and the man pages print this table.
EXIT_CODE_MEANINGS: dict[ExitCode, str] = {
    ExitCode.DONE: "done",
    ExitCode.BUG: "a bug in hpcomp",
    ExitCode.USAGE: "usage: no command, or an unknown option, key or value",
    ExitCode.INPUT: "an input cannot be read",
    ExitCode.MISMATCH: "the layers do not fit together, or a policy on pixels refuses them",
    ExitCode.OUTPUT: "an output cannot be written",
    ExitCode.CHECK: "a check failed",
    ExitCode.INTERRUPTED: "interrupted (Ctrl-C)",
    ExitCode.PIPE_CLOSED: "the reader of the output closed the pipe",
    ExitCode.TERMINATED: "terminated (SIGTERM, SIGHUP)",
}


class HpcompError(Exception):
    """Any failure that hpcomp foresees; the message says what, where and what next."""

    exit_code = ExitCode.BUG


class SettingError(HpcompError, ValueError):
    """A setting has a value that does not exist or is out of range."""

    exit_code = ExitCode.USAGE


class InputError(HpcompError):
    """A file or stream cannot be read as what it is given as."""

    exit_code = ExitCode.INPUT


class MismatchError(HpcompError):
    """Layers do not fit together, or a policy on pixels refuses them."""

    exit_code = ExitCode.MISMATCH


class OutputError(HpcompError):
    """The result cannot be written."""

    exit_code = ExitCode.OUTPUT


class HpcompWarning(UserWarning):
    """The result is made, but something in it is not as the user may expect."""


class InputWarning(HpcompWarning):
    """A file carries something that cannot be honoured, such as a foreign ICC profile."""


def one_line(text: str) -> str:
    """A message as one printable line, whatever names from files it quotes."""
    return printable(" ".join(text.split()))


def printable(text: str) -> str:
    """`text` with what could control a terminal shown as escapes."""
    if text.isprintable():  # as nearly all is, pages with pictures in them too
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def why(reason: OSError) -> str:
    """What the system says of a failure, in the lower case of our lines."""
    return (reason.strerror or str(reason)).lower()


def unknown_name(
    kind: str, name: str, valid: Iterable[object], *, meant: str = "", otherwise: str = ""
) -> SettingError:
    """The error of every strict lookup: asks for the nearest of the valid names, lists them all.

    `meant`: the one that was meant, where it is not the nearest. `otherwise`: what else will do.
    """
    names = list(map(str, valid))
    meant = meant or nearest_name(name, names)
    hint = f"did you mean '{meant}'? Choose" if meant else "choose"
    return SettingError(f"unknown {kind} '{name}': {hint} one of {', '.join(names)}{otherwise}")


def nearest(name: str, valid: Iterable[str]) -> str:
    """The end of a message that asks for the nearest of the valid names; empty if none is near."""
    near = nearest_name(name, valid)
    return f": did you mean '{near}'?" if near else ""


def nearest_name(name: str, valid: Iterable[str]) -> str:
    """The one of the valid names that was probably meant; empty if none is near.

    It begins as the name does, as no other one, or has most letters in common, whatever their case.
    Of numbers none is near another.
    """
    import difflib  # where something went wrong

    if not any(map(str.isalpha, name)):
        return ""
    names = {valid_name.casefold(): valid_name for valid_name in valid}
    begin = [other for other in names if other.startswith(name.casefold())]
    near = begin if len(begin) == 1 else difflib.get_close_matches(name.casefold(), names, 1)
    return names[near[0]] if near else ""
