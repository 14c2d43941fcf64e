"""Jobs on the machines of a Dask cluster; the only importer of distributed.

A Dask worker makes no stack itself. It keeps processes as this machine does for its own jobs, and
so a job has its own working directory, warnings, peak of memory and end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import queue
import threading
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..engine.choice import VARIABLE as ENGINE
from ..errors import ExitCode, HpcompWarning, InputError, OutputError, SettingError
from ..system.outputs import remove_leftovers
from ..system.sourcedate import VARIABLE as SOURCE_DATE
from .doing import failure
from .processes import PATIENCE_S, JobProcess, Result, Task, stop

#: How long a scheduler has to answer.
CONNECTION_S = 10
#: How long a process on a worker waits for another job, should the batch have been killed.
IDLE_S = 30
#: How long a cluster may be without workers before that is said.
WITHOUT_WORKERS_S = 5
#: Jobs that are given to each thread of the cluster, so that it never waits for the next one.
JOBS_OF_A_THREAD = 2
#: How often the cluster is asked how large it is.
COUNT_S = 1
#: What a job takes from the environment; all else is the worker's.
_ENVIRONMENT = (ENGINE, SOURCE_DATE)


# --- on a worker ----------------------------------------------------------------------------------

#: The processes of a Dask worker, by the batch that they are for: those that are idle, and all.
_idle: dict[str, list[JobProcess]] = {}
_all: dict[str, list[JobProcess]] = {}
_lock = threading.Lock()


def do_there(task: Task, prefix: str, folder: str, environment: Mapping[str, str]) -> Result:
    """What a thread of a Dask worker does: gives the job to a process, and waits for its end.

    `prefix`: of the temporary files of the batch; `folder`: its working directory.
    """
    while True:
        with _lock:
            waiting = _idle.setdefault(prefix, [])
            idle = waiting.pop() if waiting else None
        try:
            process = idle or JobProcess(prefix, folder, environment, patience_s=IDLE_S)
        except OSError:
            return failure(
                f"the worker has no directory {folder}: jobs need the same files on all machines",
                ExitCode.INPUT,
            )
        if idle is None:
            with _lock:
                _all.setdefault(prefix, []).append(process)
        process.give(task)
        try:
            while (result := process.result()) is None:
                pass
        except EOFError:
            with _lock, contextlib.suppress(KeyError, ValueError):  # as after `end_there`
                _all[prefix].remove(process)
            result = process.death(())
            if idle is not None and process.process.returncode == ExitCode.DONE:
                continue  # it had waited too long
            return result
        with _lock:
            _idle.setdefault(prefix, []).append(process)
        return result


def end_there(prefix: str) -> None:
    """Ends what a Dask worker has of a batch, whatever it does."""
    with _lock:
        processes, idle = _all.pop(prefix, []), _idle.pop(prefix, [])
    stop(processes)
    for process in idle:  # a busy one is reaped by the thread that waits for it
        process.reap()


# --- here -----------------------------------------------------------------------------------------


class Cluster:
    """A crew of Dask workers; their jobs' temporary files begin with `prefix`.

    `client`: of the scheduler. `started`: a cluster of our own, which ends with us.
    """

    def __init__(
        self,
        client: Any,
        started: Any,
        address: str,
        at_a_time: int | None,
        granted: Mapping[str, Any],
        prefix: str,
    ) -> None:
        self.granted = granted
        self._client, self._started, self._address = client, started, address
        self._at_a_time, self._prefix = at_a_time, prefix
        self._environment = {name: os.environ[name] for name in _ENVIRONMENT if name in os.environ}
        self._begun: dict[int, Any] = {}
        self._outputs: set[str] = set()
        self._ended: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self._threads, self._counted, self._seen = 0, 0.0, time.monotonic()

    @staticmethod
    def at(
        address: str, at_a_time: int | None, threads: int | None, max_memory: int, prefix: str
    ) -> Cluster:
        """The cluster of a scheduler, by address or scheduler file; `local:N` starts one here.

        Errors: `SettingError` for what is no address, `InputError` where nobody answers,
        `OutputError` where distributed is missing.
        """
        if at_a_time is not None and at_a_time < 1:
            raise SettingError(f"jobs at a time {at_a_time} is below 1")
        kind, _, number = address.partition(":")
        if kind == "local" and not (number.isascii() and number.isdigit() and int(number)):
            raise SettingError(f"'{address}' is no number of workers: write local:4")
        try:
            import distributed
        except ImportError:
            raise OutputError(
                "--dask needs distributed, which is not installed: pip install 'hpcomp[dask]'"
            ) from None
        # What goes on in a cluster is told here in our own lines.
        for name in ("distributed", *logging.root.manager.loggerDict):
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        started = None
        try:
            if kind == "local":
                started = distributed.LocalCluster(
                    n_workers=int(number),
                    threads_per_worker=1,
                    memory_limit=0,
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                )
            where = {"scheduler_file": address} if os.path.isfile(address) else {"address": address}
            client = distributed.Client(
                **({"address": started} if started else where),
                timeout=CONNECTION_S,
                set_as_default=False,
                name="hpcomp",
            )
        except Exception as reason:  # whatever distributed finds wrong with an address or a file
            if started is not None:
                started.close()
            raise InputError(
                f"{address}: no Dask scheduler answers there ({type(reason).__name__}): start one, "
                "or try local:2"
            ) from None
        granted = {"threads": threads or 1, "max_memory": max_memory}
        return Cluster(client, started, address, at_a_time, granted, prefix)

    def has_room(self) -> bool:
        if self._at_a_time is not None:
            return len(self._begun) < self._at_a_time
        self._count()
        return len(self._begun) < JOBS_OF_A_THREAD * max(1, self._threads)

    def _is_gone(self) -> bool:
        """Whether the client has given the scheduler up."""
        return self._client.status in ("closing", "closed")

    def _count(self) -> None:
        """Sees how many threads the cluster has now, and says so where it has none."""
        now = time.monotonic()
        if self._counted and now - self._counted < COUNT_S:
            return
        self._counted = now
        if self._is_gone():
            return
        with contextlib.suppress(OSError):  # jobs tell of a scheduler that does not answer
            self._threads = sum(self._client.nthreads().values())
        if self._threads:
            self._seen = now
        elif now - self._seen > WITHOUT_WORKERS_S:
            self._seen = float("inf")
            warnings.warn(
                f"{self._address} has no workers: the jobs wait for one",
                HpcompWarning,
                stacklevel=2,
            )

    def give(self, number: int, task: Task, outputs: Sequence[str]) -> None:
        self._outputs.update(map(os.path.abspath, outputs))
        if self._is_gone():
            self._begun[number] = None
            self._ended.put((number, None))
            return
        here = (self._prefix, os.getcwd(), self._environment)
        future = self._client.submit(
            do_there, task, *here, key=f"{self._prefix}{number}", pure=False
        )
        self._begun[number] = future
        future.add_done_callback(lambda done: self._ended.put((number, done)))

    def ended(self, wait_s: float) -> Iterator[tuple[int, Result]]:
        self._count()
        with contextlib.suppress(queue.Empty):
            number, future = self._ended.get(timeout=wait_s)
            while True:
                del self._begun[number]
                yield number, self._result(future)
                number, future = self._ended.get_nowait()

    def _result(self, future: Any) -> Result:
        """What became of a job, also where the cluster did not let it end."""
        if future is not None and future.status == "finished":
            result: Result = future.result()
            future.release()
            return result
        if future is None or future.status != "error":
            return failure(f"{self._address}: the scheduler is gone", ExitCode.OUTPUT)
        reason = future.exception()
        name = type(reason).__name__
        if name == "KilledWorker":
            return failure("every worker that was given it died", ExitCode.BUG)
        if isinstance(reason, ImportError):
            return failure(
                f"a worker cannot import hpcomp ({reason}): install the same version there",
                ExitCode.INPUT,
            )
        return failure(f"bug: {name}: {reason}", ExitCode.BUG)

    def is_busy(self) -> bool:
        return bool(self._begun)

    def close(self) -> None:
        self._end()

    def stop(self) -> None:
        with contextlib.suppress(Exception):
            self._client.cancel(list(self._begun.values()), asynchronous=False, force=True)
        self._end()

    def _end(self) -> None:
        """Leaves the cluster as it was found."""
        with contextlib.suppress(Exception):  # it may be gone
            self._client.run(end_there, self._prefix, on_error="ignore")
        with contextlib.suppress(Exception):
            self._client.close(timeout=PATIENCE_S)
        if self._started is not None:
            with contextlib.suppress(Exception):
                self._started.close(timeout=PATIENCE_S)
        remove_leftovers(self._outputs, self._prefix)
