"""Threads that read ahead and write behind, in order; they do not know what."""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from threading import Event, Lock
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from ..errors import SettingError

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

T = TypeVar("T")


#: More than any machine has use for: each takes memory, and a slip of the finger asks for millions.
MOST_THREADS = 1024


def thread_count(threads: int | None) -> int:
    """How many threads a run takes: as asked, up to `MOST_THREADS`, or one for each core."""
    if threads is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else os.cpu_count() or 1
        )
    return min(check_threads(threads), MOST_THREADS)


def check_threads(threads: int) -> int:
    """The number of threads as it is; `SettingError` below 1."""
    if threads < 1:
        raise SettingError(f"threads {threads} is below 1")
    return threads


def reads_ahead(threads: int) -> int:
    """How many reads can be in memory before they are taken: all threads stay busy."""
    return 2 * threads if threads > 1 else 1


def writes_behind(threads: int) -> int:
    """How many writes can be in memory before they are done."""
    return 2 if threads > 1 else 1


def _pool_of(threads: int) -> ThreadPoolExecutor:
    from concurrent.futures import ThreadPoolExecutor  # which a composite of arrays does not need

    return ThreadPoolExecutor(threads, "hpcomp")


def _unchanged(stored: Any) -> Any:
    return stored


class ThreadPipeline(Generic[T]):
    """`threads` threads that read, composite and write; with one, all is done in the caller's."""

    def __init__(self, threads: int) -> None:
        self.threads = threads
        #: Of all threads together, by what they did.
        self.seconds = {"reading": 0.0, "compositing": 0.0, "writing": 0.0}
        self._pool = _pool_of(threads) if threads > 1 else None
        self._writes: deque[Future[None]] = deque()
        self._last_write: Event | None = None
        self._write_failed = False
        self._given_up = Event()
        self._lock = Lock()

    def __enter__(self) -> ThreadPipeline[T]:
        return self

    def __exit__(self, failure: object, *where: object) -> None:
        if failure is not None:
            self._given_up.set()
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def go_on(self) -> None:
        """Ends work that nobody waits for any more; long work is to call it now and then."""
        if self._given_up.is_set():
            from concurrent.futures import CancelledError

            raise CancelledError

    def read_ahead(
        self,
        reads: Iterable[tuple[int, Callable[[], Any]]],
        then: Callable[[Any], T] = _unchanged,
    ) -> Iterator[T]:
        """What `then` makes of the results of `(source, read)`, in their order, some read ahead.

        Reads of one source run one after another in their order: codecs are not shared. `then`
        runs in the same threads, side by side with other reads. The first error is that of the
        first read.
        """
        waiting: deque[Future[T]] = deque()
        # Not the future itself, which would keep every source's last strip in memory.
        last_read: dict[int, Event] = {}
        for source, read in reads:
            if self._pool is None:
                yield self._read(None, read, then, Event())
                continue
            done = Event()
            waiting.append(self._pool.submit(self._read, last_read.get(source), read, then, done))
            last_read[source] = done
            if len(waiting) > reads_ahead(self.threads):
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()

    def composite(self, work: Callable[[], None]) -> None:
        """Does `work` in one of the threads, and waits for it."""
        if self._pool is None:
            self._composite(work)
        else:
            self._pool.submit(self._composite, work).result()

    def write_behind(self, prepare: Callable[[], Any], write: Callable[[Any], None]) -> None:
        """Writes what `prepare` gives, after the write before it; raises an earlier one's error."""
        previous, done = self._last_write, Event()
        self._last_write = done
        if self._pool is None:
            self._write(previous, prepare, write, done)
            return
        while len(self._writes) >= writes_behind(self.threads):
            self._writes.popleft().result()
        self._writes.append(self._pool.submit(self._write, previous, prepare, write, done))

    def flush(self) -> None:
        """Waits for all writes; an error of theirs is raised here."""
        while self._writes:
            self._writes.popleft().result()

    # A task waits only for one that was queued, and so begun, before it: none waits for ever.

    def _read(
        self,
        previous: Event | None,
        read: Callable[[], Any],
        then: Callable[[Any], T],
        done: Event,
    ) -> T:
        try:
            if previous is not None:
                previous.wait()
            with self._timed("reading"):
                stored = read()
        finally:
            done.set()
        return then(stored)

    def _composite(self, work: Callable[[], None]) -> None:
        with self._timed("compositing"):
            work()

    def _write(
        self,
        previous: Event | None,
        prepare: Callable[[], Any],
        write: Callable[[Any], None],
        done: Event,
    ) -> None:
        try:
            with self._timed("writing"):
                prepared = prepare()
            if previous is not None:
                previous.wait()
            if not self._write_failed:  # a codec whose write failed may wait for ever in the next
                with self._timed("writing"):
                    write(prepared)
        except BaseException:
            self._write_failed = True
            raise
        finally:
            done.set()

    @contextlib.contextmanager
    def _timed(self, what: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        with self._lock:
            self.seconds[what] += time.perf_counter() - begin
