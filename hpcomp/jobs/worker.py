"""What a Dask worker does for a batch: jobs, one after another, in processes that it keeps.

It makes no stack itself. As on the machine of the batch, each job is done in a process, and so it
has its own working directory, warnings, peak of memory and end.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from ..errors import ExitCode, why
from .doing import failure
from .processes import JobProcess, Result, Task, stop

#: How long a process waits for another job, should the batch have been killed.
IDLE_S = 30
#: So long a task begins jobs: the others go back, and a batch that was killed is soon at rest.
BEGINNING_S = 2.0


class _Kept:
    """The processes that this worker keeps for a batch."""

    def __init__(self) -> None:
        self.held = False
        self._ended = False
        self._all: list[JobProcess] = []
        self._idle: list[JobProcess] = []
        self._lock = threading.Lock()

    def result(self, task: Task, start: Callable[[], JobProcess]) -> Result:
        """What has become of a job when its process is done with it, or has died.

        A result says whether its process was `killed`. Errors: `OSError` where none can be started.
        """
        while True:
            with self._lock:
                idle = self._idle.pop() if self._idle else None
            process = idle or self._started(start)
            process.give(task)
            try:
                while (result := process.result()) is None:
                    pass
            except EOFError:
                with self._lock:
                    self._all.remove(process)
                result = process.death(())
                if idle is not None and process.process.returncode == ExitCode.DONE:
                    continue  # it had waited too long
                return {**result, "killed": process.process.returncode < 0}
            with self._lock:
                self._idle.append(process)
            return result

    def _started(self, start: Callable[[], JobProcess]) -> JobProcess:
        process = start()
        with self._lock:
            self._all.append(process)
            if self._ended:  # meanwhile
                process.process.kill()
        return process

    def is_alive(self) -> bool:
        with self._lock:
            return any(each.process.poll() is None for each in self._all)

    def end(self) -> None:
        """Ends all processes, whatever they do."""
        with self._lock:
            self.held = self._ended = True
            processes, idle = list(self._all), self._idle
        stop(processes)
        for process in idle:  # a busy one is reaped by the thread that waits for it
            process.reap()


#: By the batch that they are for.
_kept: dict[str, _Kept] = {}
_lock = threading.Lock()


def _kept_for(prefix: str) -> _Kept:
    with _lock:
        if prefix not in _kept:
            # A batch that was killed has not said that it ends.
            for other in [name for name, kept in _kept.items() if not kept.is_alive()]:
                del _kept[other]
        return _kept.setdefault(prefix, _Kept())


def do_there(
    tasks: Sequence[Task], prefix: str, folder: str, environment: Mapping[str, str]
) -> list[Result]:
    """Does jobs one after another; what became of those that it came to, the first ones.

    `prefix`: of the temporary files of the batch; `folder`: its working directory.
    """
    kept = _kept_for(prefix)
    start = partial(JobProcess, prefix, folder, environment, patience_s=IDLE_S)
    end = time.monotonic() + BEGINNING_S
    results: list[Result] = []
    for task in tasks:
        if kept.held or (results and time.monotonic() > end):
            break
        try:
            results.append(kept.result(task, start))
        except OSError as reason:
            results.append(failure(_no_process(folder, reason), ExitCode.INPUT))
    return results


def _no_process(folder: str, reason: OSError) -> str:
    if os.path.isdir(folder):
        return f"the worker cannot start a process: {why(reason)}"
    return f"the worker has no directory {folder}: jobs need the same files on all machines"


def hold_there(prefix: str) -> None:
    """Lets this worker begin no more jobs of a batch."""
    _kept_for(prefix).held = True


def end_there(prefix: str) -> None:
    """Ends what this worker has of a batch."""
    with _lock:
        kept = _kept.pop(prefix, None)
    if kept is not None:
        kept.end()
