"""Dependency files for make and ninja: which files were read to make which. Makes none of them."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from ..errors import SettingError
from .outputs import whole_output, write_bytes
from .streams import STDIN, STDOUT

#: What make takes for its own in a name, written so that make and ninja read the character alone.
_ESCAPES = {"$": "$$", "#": "\\#", ":": "\\:"}
_SPECIAL = re.compile(r"(\\*)([ \t])|([$#:])")
#: What ends a rule, however it is escaped.
_IMPOSSIBLE = re.compile(r"[\n\r;]")


@dataclass(frozen=True)
class Depfile:
    """A dependency file that is asked for: its path, and the targets that it is about."""

    path: str
    targets: tuple[str, ...]

    @staticmethod
    def asked(
        path: str | os.PathLike[str] | None, targets: str | Sequence[str], outputs: Sequence[str]
    ) -> Depfile | None:
        """None where no path is given. `targets`: the outputs if empty.

        Errors: `SettingError` for targets without a path, and for stdout without a target.
        """
        given = (targets,) if isinstance(targets, str) else tuple(targets)
        if path is None:
            if given:
                raise SettingError(
                    f"depfile target {given[0]} needs a depfile: name one with --depfile"
                )
            return None
        if not given and STDOUT in outputs:
            raise SettingError(
                "a depfile has to name what is made, and stdout is no file: give --depfile-target"
            )
        return Depfile(os.fspath(path), given or tuple(outputs))

    @contextlib.contextmanager
    def written(self, inputs: Iterable[str], if_changed: bool = False) -> Iterator[None]:
        """The file appears when the block ends without an error, before outputs opened earlier.

        `inputs`: what was read; streams are left out.
        Errors: `SettingError`, also where it would replace an input; `OutputError`.
        """
        read = [path for path in inputs if not _is_stream(path)]
        if self.path != STDOUT and os.path.realpath(self.path) in map(os.path.realpath, read):
            raise SettingError(f"the depfile {self.path} would replace what is read: rename it")
        text = rule(self.targets, read)
        with whole_output(self.path, if_changed=if_changed) as place:
            yield
            write_bytes(place, text.encode("utf-8", "surrogateescape"), self.path)


def rule(targets: Iterable[str], inputs: Iterable[str]) -> str:
    """A rule by which `targets` are made from `inputs`, and an empty one for each input.

    The empty ones let make go on where an input is no more: the target is made again. Names are
    escaped as both GNU make and ninja read them.
    Errors: `SettingError` for a name that no rule can hold.
    """
    read = [_escaped(path) for path in dict.fromkeys(inputs)]
    made = " ".join(map(_escaped_target, dict.fromkeys(targets)))
    first = " \\\n  ".join([f"{made}:", *read])
    # An input with = has none: make would take the line for an assignment.
    empty = [f"{_escaped_target(path)}:" for path in dict.fromkeys(inputs) if "=" not in path]
    return "\n\n".join([first, *empty]) + "\n"


def _escaped_target(path: str) -> str:
    """A target's % would make the rule one of patterns."""
    if "=" in path:
        raise SettingError(
            f"make takes a rule for {path} for an assignment, because of its =: "
            "name another target with --depfile-target"
        )
    return _escaped(path).replace("%", "\\%")


def _escaped(path: str) -> str:
    if _IMPOSSIBLE.search(path):
        raise SettingError(
            f"{path!r} has a line break or semicolon, which make cannot read in a depfile: "
            "rename it"
        )
    # At the start of a word make takes it for somebody's home.
    path = f"./{path}" if path.startswith("~") else path
    # Backslashes count only before a blank.
    return _SPECIAL.sub(lambda m: _ESCAPES[m[3]] if m[3] else f"{m[1] * 2}\\{m[2]}", path)


def _is_stream(path: str) -> bool:
    """Whether it is stdin, or a pipe or device, which make could not look at."""
    return path == STDIN or (os.path.exists(path) and not os.path.isfile(path))
