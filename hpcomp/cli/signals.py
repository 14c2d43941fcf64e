"""Ctrl-C, SIGTERM and SIGHUP: each unwinds the run once, so that temporary files are removed."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from importlib import import_module
from types import FrameType, ModuleType


class Terminated(BaseException):
    """SIGTERM or SIGHUP."""


#: The signals that end a run, each with what it raises.
ENDING: dict[int, type[BaseException]] = {
    signal.SIGINT: KeyboardInterrupt,
    signal.SIGTERM: Terminated,
    signal.SIGHUP: Terminated,
}


def install() -> None:
    """Makes the signals raise, and lets them through where they were held."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` and `&` want it
            signal.signal(number, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)


def _end(signal_number: int, frame: FrameType | None) -> None:
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)  # a second Ctrl-C must not stop the cleaning up
    raise ENDING[signal_number]


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Signals wait until the end of the block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def load(module: str) -> ModuleType:
    """Imports a module of hpcomp: an extension that is interrupted while it starts may abort."""
    with held():
        return import_module(module)
