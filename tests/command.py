"""The installed `hpcomp` command in a subprocess, as a shell runs it, and folders to run it in."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMMAND = Path(sys.executable).with_name("hpcomp")

#: Far longer than any run takes, far shorter than a night.
PATIENCE_S = 120

#: What stands at an output before the run; no picture, so that nothing can mistake it for one.
OLD = b"what stood here"


@dataclass(frozen=True)
class Run:
    """How a run ended."""

    code: int
    stdout: bytes
    stderr: str

    @property
    def lines(self) -> list[str]:
        return self.stderr.splitlines()


def hpcomp(
    *arguments: object,
    stdin: bytes = b"",
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    through: Sequence[str | Path] = (),
    umask: int = -1,
) -> Run:
    """Runs the command and waits; `through` is a command that is to start it."""
    done = subprocess.run(
        command(*arguments, through=through),
        input=stdin,
        capture_output=True,
        cwd=cwd,
        env={**os.environ, **(env or {})},
        umask=umask,
        timeout=PATIENCE_S,
    )
    return Run(done.returncode, done.stdout, done.stderr.decode())


def command(*arguments: object, through: Sequence[str | Path] = ()) -> list[Any]:
    return [
        *through,
        COMMAND,
        *(a if isinstance(a, bytes) else os.fspath(a) if isinstance(a, Path) else str(a)
          for a in arguments),
    ]  # fmt: skip


def shell(script: str) -> list[str]:
    """For `through`: a POSIX shell in which "$@" is the command."""
    return ["sh", "-c", script, "sh"]


def snapshot(folder: Path) -> dict[str, Any]:
    """All that stands below a folder: kind and mode, and of plain files their time and bytes."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        state = path.lstat()
        plain = stat.S_ISREG(state.st_mode)
        link = os.readlink(path) if path.is_symlink() else None
        found[str(path.relative_to(folder))] = (
            state.st_mode,
            link,
            (state.st_mtime_ns, path.read_bytes()) if plain else None,
        )
    return found


@dataclass(frozen=True)
class Desk:
    """A folder to run the command in, and beside it one of its own for temporary files."""

    folder: Path
    temporary: Path

    @staticmethod
    def made(parent: Path) -> Desk:
        desk = Desk(parent / "desk", parent / "temporary")
        desk.folder.mkdir()
        desk.temporary.mkdir()
        return desk

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    @property
    def env(self) -> dict[str, str]:
        return {"TMPDIR": str(self.temporary)}

    def put(self, name: str, content: bytes) -> Path:
        path = self.folder / name
        path.write_bytes(content)
        return path

    def run(self, *arguments: object, **how: Any) -> Run:
        return hpcomp(*arguments, cwd=self.folder, env=self.env, **how)

    def makes(self, *arguments: object, **how: Any) -> Run:
        """A run that succeeds without a word and leaves no temporary file."""
        run = self.run(*arguments, **how)
        assert (run.code, run.stderr) == (0, "")
        assert os.listdir(self.temporary) == []
        assert [name for name in os.listdir(self.folder) if name.startswith(".")] == []
        return run

    def refuses(self, code: int, *arguments: object, says: Sequence[str], **how: Any) -> str:
        """A run that fails with one line that says these words and changes no file; the line."""
        before = snapshot(self.folder.parent)
        run = self.run(*arguments, **how)
        assert run.code == code, run
        lines = run.lines
        if code == 2:
            assert lines.pop(0).startswith("Usage: hpcomp"), run.stderr
        assert len(lines) == 1, run.stderr
        assert lines[0].startswith("hpcomp: error: "), run.stderr
        for word in says:
            assert word in lines[0], f"{word!r} is not in {lines[0]!r}"
        assert run.stdout == b""
        assert snapshot(self.folder.parent) == before
        return lines[0]
