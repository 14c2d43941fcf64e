"""How far a batch is, on stderr: a bar where that is a terminal, else a line for each job."""

from __future__ import annotations

import contextlib
import os
import sys
import time

from ..errors import one_line
from .messages import say

#: Between two drawings of the bar: no oftener than an eye can follow.
_REDRAW_S = 0.1
_BAR_COLUMNS = 30
#: Where a terminal does not say how wide it is.
_COLUMNS = 80


class Progress:
    """Counts jobs as they end, once `begin` has said how many there are."""

    def __init__(self, quiet: bool) -> None:
        self.total, self.quiet = 0, quiet
        self.ended = self.failed = 0
        self._bar = not quiet and sys.stderr is not None and sys.stderr.isatty()
        self._begin = time.monotonic()
        self._drawn = 0.0

    def begin(self, total: int) -> None:
        """So many jobs there are, and time counts from now."""
        self.total, self._begin = total, time.monotonic()

    def count(self, worked: bool, failed: bool, text: str) -> None:
        """One more has ended; `text` is its line where there is no bar."""
        self.ended += 1
        self.failed += failed
        if self._bar:
            self.draw()
        elif worked and not failed and not self.quiet:
            say(f"hpcomp: {self.ended}/{self.total} {text}")

    def message(self, text: str) -> None:
        """A line of its own, above the bar."""
        self.clear()
        say(text)

    def draw(self) -> None:
        """Draws the bar, unless that was just done."""
        now = time.monotonic()
        if self._bar and now - self._drawn >= _REDRAW_S:
            self._drawn = now
            self._write("\r\x1b[K" + self._line(now - self._begin))

    def clear(self) -> None:
        """Takes the bar away, for what comes next."""
        if self._bar and self._drawn:
            self._drawn = 0.0
            self._write("\r\x1b[K")

    def _line(self, elapsed: float) -> str:
        filled = _BAR_COLUMNS * self.ended // max(1, self.total)
        words = [f"[{'#' * filled}{'-' * (_BAR_COLUMNS - filled)}] {self.ended}/{self.total}"]
        if self.ended:
            rate = self.ended / max(elapsed, 1e-6)
            left = round((self.total - self.ended) / rate)
            words += [f"{rate:.3g}/s", f"{left // 60}:{left % 60:02} left"]
        if self.failed:
            words.append(f"{self.failed} failed")
        return one_line(" ".join(words))[: self._columns() - 1]

    def _columns(self) -> int:
        """Of the terminal that stderr is; stdout may be another one, or none."""
        try:
            return os.get_terminal_size(sys.stderr.fileno()).columns or _COLUMNS
        except (OSError, ValueError):
            return _COLUMNS

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(text)
            sys.stderr.flush()
