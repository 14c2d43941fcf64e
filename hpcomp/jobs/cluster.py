"""Jobs on the machines of a Dask cluster; the only importer of distributed.

Small jobs go together in tasks of about a second: a scheduler takes far longer over a task than a
worker over a small picture.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import re
import time
import warnings
from asyncio import CancelledError
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..engine.choice import VARIABLE as ENGINE
from ..errors import ExitCode, HpcompWarning, InputError, OutputError, SettingError, why
from ..system.outputs import remove_leftovers
from ..system.sourcedate import VARIABLE as SOURCE_DATE
from .doing import failure
from .processes import PATIENCE_S, Result, Task
from .worker import do_there, end_there, hold_there

#: How long a scheduler has to answer.
CONNECTION_S = 10
#: How long a cluster may be without workers before that is said.
WITHOUT_WORKERS_S = 5
#: How often the cluster is asked how large it is.
COUNT_S = 1
#: How often it is looked whether a task has ended.
LOOK_S = 0.01
#: How long a task should take, how long at least where few jobs are left, and its jobs at most.
TASK_S, SHORTEST_TASK_S, JOBS_OF_A_TASK = 1.0, 0.1, 500
#: Tasks that each thread of the cluster is given. It never waits for the next one; and Dask lets an
#: adaptive cluster grow until its tasks last 5 s (`distributed.adaptive.target-duration`): with
#: these it more than doubles, for as long as there are jobs.
TASKS_OF_A_THREAD = 12
#: A job whose process was killed is begun again as often as Dask does it where a worker was
#: (`distributed.scheduler.allowed-failures`).
RETRIES = 3
#: What the keys of all tasks begin with: in Dask's pages they are one group.
KEYS = "hpcomp-stack"
#: What a job takes from the environment; all else is the worker's.
_ENVIRONMENT = (ENGINE, SOURCE_DATE)

_ADDRESS = re.compile(r".+://.+|.+:\d+")


class Cluster:
    """A crew of Dask workers; their jobs' temporary files begin with `prefix`.

    `client`: of the scheduler. `started`: a cluster of our own, which ends with us.
    """

    elsewhere = True

    def __init__(
        self,
        client: Any,
        started: Any,
        address: str,
        at_a_time: int | None,
        granted: Mapping[str, Any],
        prefix: str,
    ) -> None:
        from distributed import as_completed

        self.granted = granted
        self._client, self._started, self._address = client, started, address
        self._at_a_time, self._prefix = at_a_time, prefix
        self._place = {
            "prefix": prefix,
            "folder": os.getcwd(),
            "environment": {n: os.environ[n] for n in _ENVIRONMENT if n in os.environ},
        }
        self._threads, self._counted, self._seen = 0, 0.0, time.monotonic()
        self._job_s: float | None = None
        #: The jobs of the task that is being put together, how many it will have, and whole ones.
        self._open: dict[int, Task] = {}
        self._size = 1
        self._unsent: list[dict[int, Task]] = []
        self._n_sent = 0
        #: The jobs of each task that was sent, and what tells of those that have ended.
        self._sent: dict[Any, list[int]] = {}
        self._completed = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        #: Jobs that are a task by themselves, and how often the process of a job was killed.
        self._alone: set[int] = set()
        self._killed: Counter[int] = Counter()
        #: An output in each directory that has one.
        self._outputs: dict[str, str] = {}

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
        is_local = kind == "local"
        if is_local and not (number.isascii() and number.isdigit() and int(number)):
            raise SettingError(f"'{address}' is no number of workers: write local:4")
        where = address if is_local else _scheduler_address(address)
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
            if is_local:
                # Within this process: workers have processes for their jobs, and need none besides.
                started = distributed.LocalCluster(
                    n_workers=int(number),
                    threads_per_worker=1,
                    processes=False,
                    protocol="inproc://",
                    memory_limit=0,
                    dashboard_address=None,
                    silence_logs=logging.CRITICAL,
                )
            client = distributed.Client(
                started or where, timeout=CONNECTION_S, set_as_default=False, name="hpcomp"
            )
        except Exception as reason:  # whatever distributed finds wrong with an address
            if started is not None:
                started.close()
            raise InputError(
                f"{address}: no Dask scheduler answers there ({_root(reason)}): start one, "
                "or try local:2"
            ) from None
        granted = {"threads": threads or 1, "max_memory": max_memory}
        return Cluster(client, started, address, at_a_time, granted, prefix)

    # --- giving -----------------------------------------------------------------------------------

    def has_room(self, ready: int) -> bool:
        self._count()
        if not self._open:
            self._size = self._wanted_size(ready)
        return len(self._sent) + len(self._unsent) < self._wanted_tasks()

    def _wanted_tasks(self) -> int:
        return self._at_a_time or TASKS_OF_A_THREAD * max(1, self._threads)

    def _wanted_size(self, ready: int) -> int:
        """How many of so many jobs the next task has.

        They shrink to the end, so that all threads are done at about the same time: but a task of
        next to nothing costs more than it saves.
        """
        if self._job_s is None:
            return 1
        fair = ready / (2 * min(max(1, self._threads), self._wanted_tasks()))
        job_s = max(self._job_s, TASK_S / JOBS_OF_A_TASK)
        shortest = math.ceil(SHORTEST_TASK_S / job_s)
        size = max(1, math.floor(min(max(fair, shortest), TASK_S / job_s)))
        return size if ready - size >= shortest else ready

    def give(self, number: int, task: Task, outputs: Sequence[str]) -> None:
        for output in outputs:
            self._outputs.setdefault(os.path.dirname(os.path.realpath(output)), output)
        alone = number in self._alone or not _is_repeatable(task, outputs)
        if alone:
            self._finish_task()
        self._open[number] = task
        if alone or len(self._open) >= self._size:
            self._finish_task()

    def _finish_task(self) -> None:
        if self._open:
            self._unsent.append(self._open)
            self._open = {}

    def _send(self) -> None:
        """Sends what was given, all tasks at once."""
        self._finish_task()
        if not self._unsent:
            return
        # The number before what is random: letters alone would be a part of the group's name.
        first, self._n_sent = self._n_sent, self._n_sent + len(self._unsent)
        keys = [f"{KEYS}-{number}-{self._prefix}" for number in range(first, self._n_sent)]
        tasks = [list(jobs.values()) for jobs in self._unsent]
        futures = self._client.map(do_there, tasks, key=keys, pure=False, **self._place)
        self._sent.update(zip(futures, map(list, self._unsent), strict=True))
        self._unsent.clear()
        self._completed.update(futures)

    # --- what becomes of it -----------------------------------------------------------------------

    def ended(self, wait_s: float) -> Iterator[tuple[int, Result | None]]:
        self._count()
        if self._is_gone():
            yield from self._lost()
            return
        self._send()
        end = time.monotonic() + wait_s
        while not self._completed.has_ready() and time.monotonic() < end:
            time.sleep(LOOK_S)
        for future, outcome in self._completed.next_batch(block=False):
            numbers = self._sent.pop(future)
            yield from self._results(numbers, future.status, outcome)

    def _results(
        self, numbers: Sequence[int], status: str, outcome: Any
    ) -> Iterator[tuple[int, Result | None]]:
        """What became of the jobs of a task, also where the cluster did not let it end."""
        if status == "finished":
            self._learn(outcome)
            for number, result in zip(numbers, outcome, strict=False):
                yield number, self._unless_killed(number, result)
            for number in reversed(numbers[len(outcome) :]):
                yield number, None
        elif self._may_be_innocent(numbers, status, outcome):
            self._alone.update(numbers)
            for number in reversed(numbers):
                yield number, None
        else:
            for number in numbers:
                yield number, self._failure(status, outcome)

    def _may_be_innocent(self, numbers: Sequence[int], status: str, outcome: Any) -> bool:
        """Whether a task is blamed for dead workers, and its jobs have not been tried alone.

        One of them may have killed those, or something else while the task was waiting there.
        """
        killed = status == "error" and type(outcome[1]).__name__ == "KilledWorker"
        return killed and not self._alone.issuperset(numbers)

    def _learn(self, results: Sequence[Result]) -> None:
        """Takes in how long jobs last now."""
        if results:
            lasted = sum(result.get("seconds", 0.0) for result in results) / len(results)
            self._job_s = lasted if self._job_s is None else (self._job_s + lasted) / 2

    def _unless_killed(self, number: int, result: Result) -> Result | None:
        """The result of a job, unless its process was killed and it is begun again."""
        if result.pop("killed", False) and self._killed[number] < RETRIES:
            self._killed[number] += 1
            self._alone.add(number)
            return None
        return result

    def _failure(self, status: str, outcome: Any) -> Result:
        if status != "error":
            if self._client.status != "running":
                return failure(f"{self._address}: the scheduler is gone", ExitCode.OUTPUT)
            return failure(f"{self._address}: the scheduler gave it up: {outcome}", ExitCode.OUTPUT)
        reason = outcome[1]
        name = type(reason).__name__
        if name == "KilledWorker":
            return failure("every worker that was given it died", ExitCode.BUG)
        if isinstance(reason, ImportError):
            return failure(
                f"a worker cannot import hpcomp ({reason}): install the same version there",
                ExitCode.INPUT,
            )
        return failure(f"bug: {name}: {reason}", ExitCode.BUG)

    def _lost(self) -> Iterator[tuple[int, Result]]:
        """All jobs that have not ended, of a scheduler that was given up."""
        lost = [*self._sent.values(), *map(list, self._unsent), list(self._open)]
        self._forget()
        for numbers in lost:
            for number in numbers:
                yield number, self._failure("lost", None)

    def _forget(self) -> None:
        self._sent.clear()
        self._unsent.clear()
        self._open.clear()

    def is_busy(self) -> bool:
        return bool(self._sent or self._unsent or self._open)

    # --- the cluster ------------------------------------------------------------------------------

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

    def _tell(self, function: Any) -> None:
        """Lets all workers do something about the batch; some, or all, may be gone."""
        with contextlib.suppress(Exception):
            self._client.run(function, self._prefix, on_error="ignore")

    def hold(self) -> None:
        self._unsent.clear()
        self._open.clear()
        self._tell(hold_there)

    def close(self) -> None:
        self._end()

    def stop(self) -> None:
        with contextlib.suppress(Exception):
            self._client.cancel(list(self._sent), asynchronous=False, force=True)
        self._end()

    def _end(self) -> None:
        """Leaves the cluster as it was found."""
        self._forget()
        self._tell(end_there)
        with contextlib.suppress(Exception):
            self._client.close(timeout=PATIENCE_S)
        if self._started is not None:
            with contextlib.suppress(Exception):
                self._started.close(timeout=PATIENCE_S)
        remove_leftovers(self._outputs.values(), self._prefix)


def _scheduler_address(address: str) -> str:
    """An address as it is, or the one in a scheduler file. Errors: `InputError`."""
    if not os.path.isfile(address) and _ADDRESS.fullmatch(address):
        return address
    try:
        with open(address, encoding="utf-8") as file:
            return str(json.load(file)["address"])
    except FileNotFoundError:
        raise InputError(
            f"no such file: {address}: name a scheduler file, an address such as tcp://host:8786, "
            "or local:2"
        ) from None
    except OSError as reason:
        raise InputError(f"{address}: cannot be read: {why(reason)}") from None
    except (ValueError, KeyError, TypeError):
        raise InputError(
            f"{address} is no scheduler file of Dask: it has no address; try local:2"
        ) from None


def _root(reason: BaseException) -> str:
    """What was wrong at first, in the words of the system or of Dask."""
    while reason.__cause__ is not None:
        reason = reason.__cause__
    if isinstance(reason, CancelledError | TimeoutError):  # Dask gave up in the middle of a try
        return f"no answer in {CONNECTION_S} s"
    return why(reason) if isinstance(reason, OSError) else str(reason) or type(reason).__name__


def _is_repeatable(task: Task, outputs: Sequence[str]) -> bool:
    """Whether a job can be done twice, as when a worker dies that had done it.

    Not one that keeps what is there, or reads what it replaces.
    """
    read = {layer["path"] for layer in task["job"]["layers"]}
    return task["job"].get("clobber", True) and read.isdisjoint(outputs)
