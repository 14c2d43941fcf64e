"""How far a batch is, on stderr: a bar where a terminal can show one, else a line for each job."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import Any

from .messages import say

#: Columns of a terminal that does not say how many it has.
_ANY_WIDTH = 79
#: The bar shrinks to fit, then what stands last is cut.
_FORMAT = "[{bar}] {n_fmt}/{total_fmt}{postfix} {rate_noinv_fmt} {remaining} left"


class Progress:
    """Counts jobs as they end, once `begin` has said how many there are."""

    def __init__(self, quiet: bool) -> None:
        self.total, self.quiet = 0, quiet
        self.ended = self.failed = 0
        self._bar: Any = None

    def begin(self, total: int) -> None:
        """So many jobs there are, and time counts from now."""
        self.total = total
        if not self.quiet and _shows_bar():
            self._bar = _bar(total)

    def count(self, worked: bool, failed: bool, text: str) -> None:
        """One more has ended; `text` is its line where there is no bar."""
        self.ended += 1
        self.failed += failed
        if self._bar is not None:
            if failed:
                self._bar.set_postfix_str(f"{self.failed} failed", refresh=False)
            self._bar.update()
        elif worked and not failed and not self.quiet:
            say(f"hpcomp: {self.ended}/{self.total} {text}")

    def message(self, text: str) -> None:
        """A line of its own, above the bar."""
        if self._bar is not None:
            self._bar.clear()
        say(text)

    def draw(self) -> None:
        """Draws the bar, unless that was just done."""
        if self._bar is not None:
            self._bar.update(0)

    def clear(self) -> None:
        """Takes the bar away, for what comes next."""
        if self._bar is not None:
            self._bar.close()


def _shows_bar() -> bool:
    """Whether stderr is a terminal that can go back to the begin of a line."""
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def _width() -> dict[str, Any]:
    """For tqdm: that of the terminal whenever it is drawn, or one that fits any which tells none.

    A terminal without a width is one of a program, such as a recorder; tqdm would draw nothing.
    """
    with contextlib.suppress(OSError, ValueError):
        if os.get_terminal_size(sys.stderr.fileno()).columns:
            return {"dynamic_ncols": True}
    return {"ncols": _ANY_WIDTH}


def _bar(total: int) -> Any:
    import threading

    from tqdm import tqdm

    # One process draws, from one thread: without these tqdm makes a semaphore and a thread.
    tqdm.set_lock(threading.RLock())
    tqdm.monitor_interval = 0
    return tqdm(
        total=total,
        file=sys.stderr,
        leave=False,
        unit="",
        ascii="-#",
        bar_format=_FORMAT,
        **_width(),
        miniters=0,  # time goes on while no job ends
        smoothing=0,  # the mean rate: tqdm's moving one counts from the last drawing
    )
