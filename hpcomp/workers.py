"""Threads that read ahead and write behind, in order; they do not know what."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event
from typing import Generic, TypeVar

T = TypeVar("T")


def strips_in_flight(threads: int) -> int:
    """How many strips can be in memory between being read and being taken."""
    return threads + 2 if threads > 1 else 1


class Workers(Generic[T]):
    """Threads for the reads and one for the writes; with one thread all is done in the caller's."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._readers = ThreadPoolExecutor(threads, "read") if threads > 1 else None
        self._writer = ThreadPoolExecutor(1, "write") if threads > 1 else None
        self._writing: Future[None] | None = None

    def __enter__(self) -> Workers[T]:
        return self

    def __exit__(self, *failure: object) -> None:
        for pool in (self._readers, self._writer):
            if pool is not None:
                pool.shutdown(cancel_futures=True)

    def read_ahead(self, reads: Iterable[tuple[int, Callable[[], T]]]) -> Iterator[T]:
        """The results of `(source, read)` in their order, some read ahead.

        Reads of one source run one after another in their order: codecs are not shared.
        """
        if self._readers is None:
            for _, read in reads:
                yield read()
            return
        waiting: deque[Future[T]] = deque()
        # Not the future itself, which would keep every source's last strip in memory.
        last_read: dict[int, Event] = {}
        for source, read in reads:
            done = Event()
            waiting.append(self._readers.submit(_after, last_read.get(source), read, done))
            last_read[source] = done
            if len(waiting) > self.threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    def write_behind(self, write: Callable[[], None]) -> None:
        """Runs `write` once the write before it is done, whose error is raised here."""
        self.flush()
        if self._writer is None:
            write()
        else:
            self._writing = self._writer.submit(write)

    def flush(self) -> None:
        """Waits for the last write; its error is raised here."""
        if self._writing is not None:
            writing, self._writing = self._writing, None
            writing.result()


def _after(previous: Event | None, read: Callable[[], T], done: Event) -> T:
    """Runs `read` after its source's previous one, which was queued, and so begun, before."""
    try:
        if previous is not None:
            previous.wait()
        return read()
    finally:
        done.set()
