"""The installed `hpcomp` command, in this process or as a shell runs it, and folders to run it in."""

from __future__ import annotations

import ast
import fcntl
import os
import pty
import stat
import struct
import subprocess
import sys
import termios
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import inprocess

from hpcomp.engine import choice as engine
from hpcomp.system import sourcedate

COMMAND = Path(sys.executable).with_name("hpcomp")

#: Far longer than any run takes, far shorter than a night.
PATIENCE_S = 120

#: What stands at an output before the run; no picture, so that nothing can mistake it for one.
OLD = b"what stood here"


#: Variables that say what a terminal can show.
TERMINAL = {"NO_COLOR", "FORCE_COLOR", "CLICOLOR", "CLICOLOR_FORCE", "COLUMNS", "LINES", "TERM"}

#: Options of runs that leave threads and a process behind in the process that they are made in.
LEAVING = {"--dask"}

#: Variables with which a shell asks for words.
COMPLETING = {"_HPCOMP_COMPLETE", "COMP_LINE", "COMP_WORDBREAKS", "COMP_WORDS", "COMP_CWORD"}

#: Variables that are asked for during a run; others may be read when a process starts alone.
ASKED = {engine.VARIABLE, sourcedate.VARIABLE, "TMPDIR", *TERMINAL, *COMPLETING}


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
    process: bool = False,
) -> Run:
    """Runs the command, and waits where it has a process of its own.

    `process`: that is what the test is about. It has one as well where another command is to start
    it, `through`, where variables are set that a process may read when it starts, and for `LEAVING`.
    """
    if not (process or through or (env or {}).keys() - ASKED or LEAVING.intersection(arguments)):
        code, stdout, stderr = inprocess.invoke(
            [os.fsdecode(argument) for argument in command(*arguments)[1:]], stdin, cwd, env, umask
        )
        return Run(code, stdout, stderr.decode())
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

    def run(self, *arguments: object, env: Mapping[str, str] | None = None, **how: Any) -> Run:
        return hpcomp(*arguments, cwd=self.folder, env={**self.env, **(env or {})}, **how)

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


def on_terminal(
    desk: Desk, *arguments: object, width: int = 90, **env: str
) -> tuple[int, str, str]:
    """(exit code, what a terminal of that width is sent, stderr)."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, width, 0, 0))
    process = subprocess.Popen(
        command(*arguments),
        cwd=desk.folder,
        stdout=theirs,
        stderr=subprocess.PIPE,
        env={**os.environ, **desk.env, "TERM": "xterm", **env},
    )
    os.close(theirs)
    sent = sent_to(ours)
    error = process.communicate(timeout=PATIENCE_S)[1]
    return process.returncode, sent.decode().replace("\r\n", "\n"), error.decode()


def sent_to(terminal: int) -> bytes:
    """What a terminal was sent until all its writers closed it; closes it, too."""
    sent = b""
    try:
        while data := os.read(terminal, 1 << 16):
            sent += data
    except OSError:
        pass  # on Linux, the end
    os.close(terminal)
    return sent


def loaded(desk: Desk, *arguments: str) -> set[str]:
    """The modules that a run has imported when it ends."""
    code = (
        "import sys\nfrom hpcomp.cli import run\ntry:\n    run(sys.argv[1:])\n"
        "except SystemExit as end:\n    assert not end.code, end.code\n"
        "    print('loaded', sorted(sys.modules), file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-Wignore", "-c", code, *arguments],
        cwd=desk.folder, capture_output=True, check=True,
    )  # fmt: skip
    return set(ast.literal_eval(done.stderr.decode().partition("loaded ")[2]))


def hidden_matplotlib(desk: Desk) -> list[str]:
    """For `through`: an environment in which importing matplotlib fails as where there is none."""
    shadow = desk.temporary.parent / "shadow"
    shadow.mkdir()
    (shadow / "matplotlib.py").write_text(
        "raise ModuleNotFoundError(\"No module named 'matplotlib'\", name='matplotlib')"
    )
    return ["env", f"PYTHONPATH={shadow}"]


def made_elsewhere(code: str, argument: str, folder: Path) -> set[bytes]:
    """What `python -c code argument` prints in processes in other settings.

    In `folder` is the user's matplotlibrc, and neither hash seed nor locale is the same.
    """
    (folder / "matplotlibrc").write_text(
        "axes.facecolor: red\nimage.cmap: gray\nfont.size: 30\nsvg.fonttype: none\n"
    )
    made = set()
    for seed in ("1", "2"):
        env = {"PYTHONHASHSEED": seed, "MATPLOTLIBRC": str(folder), "MPLCONFIGDIR": str(folder)}
        if seed == "2":
            env |= {"TZ": "Asia/Tokyo", "LC_ALL": "C"}
        done = subprocess.run(
            [sys.executable, "-P", "-c", code, argument], capture_output=True, env=env, check=True
        )
        assert done.stderr == b""
        made.add(done.stdout)
    return made
