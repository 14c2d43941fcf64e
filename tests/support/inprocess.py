"""The `hpcomp` command run in this process: what a shell gives it is real, what it changes is undone.

Its standard streams are pipes on file descriptors 0, 1 and 2: pictures are written to the descriptor
of stdout, and what codecs print to that of stderr must not be seen. What a process has and a test
does not, such as an end by a signal, is not here: see `command.hpcomp`.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from click.testing import CliRunner

from hpcomp.cli import run
from hpcomp.system import signals

#: Far longer than the end of a stream takes to arrive.
PATIENCE_S = 120


def invoke(
    arguments: Sequence[str],
    stdin: bytes = b"",
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    umask: int = -1,
) -> tuple[int, bytes, bytes]:
    """(exit code, what stdout and stderr were sent) of the command."""
    with _undone(), _piped(stdin) as sent:
        os.chdir(cwd or ".")
        if umask >= 0:
            os.umask(umask)
        sys.argv = ["hpcomp", *arguments]
        result = _OnPipes().invoke(_Entry("hpcomp"), arguments, env=env, catch_exceptions=False)
    return result.exit_code, bytes(sent[1]), bytes(sent[2])


class _Entry(click.Command):
    """The console script, which turns errors into exit codes, where the runner calls a command."""

    def main(self, args: Sequence[str], **how: Any) -> None:
        run(list(args))


class _OnPipes(CliRunner):
    """Click's runner, whose streams in memory have no file descriptors, on ours that have."""

    @contextlib.contextmanager
    def isolation(self, *streams: Any, **how: Any) -> Iterator[Any]:
        with super().isolation(*streams, **how) as unused, contextlib.ExitStack() as opened:
            tempfile.tempdir = None  # asks the environment again
            theirs = sys.stdin, sys.stdout, sys.stderr  # click 8.3 and older has no other reference
            names = ("stdin", "r", "strict"), ("stdout", "w", "strict"), ("stderr", "w", "backslashreplace")
            for descriptor, (name, mode, errors) in enumerate(names):
                stream = open(descriptor, mode, encoding="utf-8", errors=errors, closefd=False)  # noqa: SIM115
                setattr(sys, name, opened.enter_context(stream))
            try:
                yield unused
            finally:
                del theirs
                if sys.stderr is not stream:  # one of its own, which codecs do not write to
                    sys.stderr.close()


@contextlib.contextmanager
def _piped(stdin: bytes) -> Iterator[dict[int, bytearray]]:
    """Pipes as descriptors 0, 1 and 2; gives what was sent to the last two, whole at the end."""
    sent = {1: bytearray(), 2: bytearray()}
    saved = [os.dup(descriptor) for descriptor in range(3)]
    threads = []

    def feed(end: int) -> None:
        # Outside: what a run does not read may be noticed where the pipe is closed.
        with contextlib.suppress(BrokenPipeError), open(end, "wb") as pipe:
            pipe.write(stdin)

    def collect(end: int, into: bytearray) -> None:
        with open(end, "rb", buffering=0) as pipe:
            while data := pipe.read(1 << 16):
                into += data

    try:
        for descriptor in range(3):
            read, write = os.pipe()
            theirs = write if descriptor else read
            os.dup2(theirs, descriptor)
            os.close(theirs)
            whose = (collect, (read, sent[descriptor])) if descriptor else (feed, (write,))
            threads.append(threading.Thread(target=whose[0], args=whose[1]))
            threads[-1].start()
        yield sent
    finally:
        for descriptor, before in enumerate(saved):
            os.dup2(before, descriptor)
            os.close(before)
        for thread in threads:
            thread.join(PATIENCE_S)
            assert not thread.is_alive(), "a process that the run began holds one of its streams"


@contextlib.contextmanager
def _undone() -> Iterator[None]:
    """What belongs to the process is afterwards as it was."""
    streams, argv, folder = (sys.stdin, sys.stdout, sys.stderr), sys.argv, os.getcwd()
    temporary, umask = tempfile.tempdir, os.umask(0)
    os.umask(umask)
    handlers = {number: signal.getsignal(number) for number in signals.ENDING}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    log = logging.getLogger("hpcomp")
    told, level = list(log.handlers), log.level
    try:
        with warnings.catch_warnings(), np.errstate():
            yield
    finally:
        log.handlers[:] = told
        log.setLevel(level)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.umask(umask)
        os.chdir(folder)
        sys.argv, tempfile.tempdir = argv, temporary
        sys.stdin, sys.stdout, sys.stderr = streams
