"""Signals that end a run, and how they wait for what must not be interrupted. Ends nothing."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

#: Comes by itself where one of these was lost.
REMINDER = signal.SIGALRM

#: All that a run waits with, and lets through.
HELD = (*ENDING, REMINDER)


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Signals wait until the end of the block: an extension interrupted in its start may abort."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, HELD)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
