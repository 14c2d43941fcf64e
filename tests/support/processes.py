"""Runs of the command that are watched from outside: the memory they take, how a signal ends them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from command import PATIENCE_S, Desk, command

MIB = 1024.0

#: Peaks of the same run differ by this much, with where the allocator happens to put things.
NOISE_M = 1.5

# Its own peak counts, not that of the tests: only a small process may start it.
MEASURE = (
    "import os, sys\n"
    "child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)\n"
    "_, status, usage = os.wait4(child, 0)\n"
    "print(usage.ru_maxrss, os.waitstatus_to_exitcode(status))"
)


def peak(*arguments: object, env: Mapping[str, str] | None = None) -> tuple[float, int, str]:
    """(peak resident MiB, exit code, stderr) of a run."""
    done = subprocess.run(
        command(*arguments, through=[sys.executable, "-ISc", MEASURE]),
        capture_output=True, text=True, timeout=PATIENCE_S, env={**os.environ, **(env or {})},
    )  # fmt: skip
    *_, last = done.stdout.splitlines()
    most, code = last.split()
    return int(most) / MIB, int(code), done.stderr


# What runs tests in the background may ignore SIGINT, which children then inherit.
INTERRUPTIBLE = [
    sys.executable,
    "-ISc",
    "import os, signal, sys\n"
    "signal.signal(signal.SIGINT, signal.SIG_DFL)\n"
    "os.execv(sys.argv[1], sys.argv[1:])",
]


@contextlib.contextmanager
def running(desk: Desk, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """A run that has begun; it does not outlive the block."""
    process = subprocess.Popen(
        command(*arguments, through=INTERRUPTIBLE),
        cwd=desk.folder,
        env={**os.environ, **desk.env},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def temporary_of(
    process: subprocess.Popen[bytes], folder: Path, known: set[Path], at_least: int = 0
) -> Path:
    """Waits until a new file stands in the folder and has grown to `at_least` bytes; its path."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        assert process.poll() is None, process.stderr.read()
        for path in set(folder.iterdir()) - known:
            if path.stat().st_size >= at_least:
                return path
        time.sleep(0.005)
    raise AssertionError("the run has not begun to write")


SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143}


def assert_ended(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """It ends by this signal, soon, with a line at most."""
    stdout, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == SIGNALS[number], stderr
    assert stdout == b""
    # An empty line keeps the message off the ^C of a terminal.
    lines = [line for line in stderr.decode().splitlines() if line]
    assert len(lines) <= 1
    assert all(line.startswith("hpcomp: ") for line in lines)
    assert "bug" not in stderr.decode()
