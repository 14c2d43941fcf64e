"""Ctrl-C, SIGTERM and SIGHUP: each unwinds the run once, so that temporary files are removed."""

from __future__ import annotations

import gc
import signal
import sys
from importlib import import_module
from types import FrameType, ModuleType
from typing import TYPE_CHECKING

from ..system.signals import ENDING as ENDING_SIGNALS
from ..system.signals import HELD, REMINDER, held

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

#: How soon a signal that was lost comes again.
_AGAIN_S = 0.01


class Terminated(BaseException):
    """SIGTERM or SIGHUP."""


#: The signals that end a run, each with what it raises.
ENDING: dict[int, type[BaseException]] = {
    number: KeyboardInterrupt if number == signal.SIGINT else Terminated
    for number in ENDING_SIGNALS
}


def install() -> None:
    """Makes the signals raise, and lets them through where they were held."""
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` and `&` want it
            signal.signal(number, _end)
    sys.unraisablehook = _on_unraisable
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HELD)


def _end(signal_number: int, frame: FrameType | None) -> None:
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)  # a second Ctrl-C must not stop the cleaning up
    raise ENDING[signal_number]


def _on_unraisable(lost: UnraisableHookArgs) -> None:
    """Raises once more, a little later, what a signal raised where Python cannot raise.

    Callbacks of weak references, which imports have, and finalizers end without a word to others.
    """
    ending = lost.exc_type
    if ending not in ENDING.values():
        sys.__unraisablehook__(lost)
        return

    def again(signal_number: int, frame: FrameType | None) -> None:
        raise ending  # `lost` is not kept: it holds what was being finalized

    signal.signal(REMINDER, again)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


def load(module: str) -> ModuleType:
    """Imports a module of hpcomp, which a signal does not interrupt."""
    if module in sys.modules:
        return sys.modules[module]
    with held():
        # What is imported stays: the collector need not go through it again and again as it grows.
        gc.disable()
        try:
            return import_module(module)
        finally:
            gc.enable()
