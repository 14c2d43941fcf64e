"""A file of segments, each a fixed number of rows that is packed by itself. Knows no format.

So segments can be packed side by side, and the bytes do not depend on how the rows arrive.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from typing import BinaryIO, Generic, TypeVar

import numpy as np

from ..color.samples import Samples
from ..errors import OutputError, why

S = TypeVar("S")


class SegmentWriter(ABC, Generic[S]):
    """Gathers rows, top to bottom, into segments `S` of one picture; `label` names it in errors."""

    def __init__(self, path: str, label: str, height: int, segment_rows: int) -> None:
        self.label = label
        self._height, self._segment_rows = height, segment_rows
        self._waiting: list[Samples] = []
        self._rows = 0
        try:
            self._file: BinaryIO = open(path, "wb")  # noqa: SIM115
        except OSError as reason:
            raise self._error(reason) from None

    @abstractmethod
    def _segment(self, rows: Samples) -> S:
        """Rows (at most so many as a segment has, width, 4), packed: any thread may do it."""

    @abstractmethod
    def _append(self, segment: S) -> None:
        """Writes the next segment."""

    @abstractmethod
    def _complete(self) -> None:
        """Writes what comes behind all segments."""

    def prepare(self, begin: int, rows: Samples) -> list[S] | Samples:
        """What of the work on rows from `begin` on needs no other rows: any thread may do it."""
        end = begin + len(rows)
        whole = self._segment_rows
        if begin % whole or (end % whole and end != self._height):
            return rows
        return self._segments(rows)

    def write(self, prepared: list[S] | Samples) -> None:
        """Appends what `prepare` gave, in the order of the rows."""
        if isinstance(prepared, list):
            self._rows = min(self._height, self._rows + len(prepared) * self._segment_rows)
        else:
            prepared = self._segments(self._gathered(prepared))
        for segment in prepared:
            self._append(segment)

    def finish(self) -> None:
        """Completes the file; `OutputError` where it cannot be."""
        assert self._rows == self._height, "rows are missing"
        self._complete()
        try:
            self._file.close()
        except OSError as reason:
            raise self._error(reason) from None

    def abandon(self) -> None:
        """Closes the file, whatever state it is in."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _segments(self, rows: Samples) -> list[S]:
        whole = self._segment_rows
        return [self._segment(rows[i : i + whole]) for i in range(0, len(rows), whole)]

    def _gathered(self, rows: Samples) -> Samples:
        """The rows that make whole segments with those that were waiting; the others wait."""
        self._waiting.append(rows)
        self._rows += len(rows)
        gathered = np.concatenate(self._waiting)
        whole = len(gathered)
        if self._rows < self._height:
            whole -= whole % self._segment_rows
        self._waiting = [gathered[whole:].copy()]
        return gathered[:whole]

    def _put_bytes(self, data: bytes) -> None:
        try:
            self._file.write(data)
        except OSError as reason:
            raise self._error(reason) from None

    def _error(self, reason: OSError) -> OutputError:
        return OutputError(f"{self.label}: cannot be written: {why(reason)}")
