"""Processes that do jobs: started, given one job after another, stopped; those of this machine."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from ..errors import ExitCode, SettingError
from ..system.outputs import remove_leftovers
from ..system.threads import thread_count
from .doing import failure

Task = Mapping[str, Any]
Result = dict[str, Any]

#: What a job should at least be granted of the memory, before fewer run at a time.
MEMORY_OF_A_JOB = 128 << 20
#: How long processes have to tidy up after themselves before they are killed.
PATIENCE_S = 0.6


class Crew(Protocol):
    """Whoever does the jobs of a batch: is given them by number, and tells what became of them.

    `granted`: options of `stack` for the jobs that have none of their own. `elsewhere`: whether
    jobs are done by installations that may not be this one.
    """

    granted: Mapping[str, Any]
    elsewhere: bool

    def has_room(self, ready: int) -> bool:
        """Whether one more job can be begun, of so many that are ready."""

    def give(self, number: int, task: Task, outputs: Sequence[str]) -> None:
        """Begins a job, which writes `outputs`."""

    def ended(self, wait_s: float) -> Iterator[tuple[int, Result | None]]:
        """The jobs that have ended, waiting so long at most; a batch asks until there are none.

        None instead of a result: the job is to be given again.
        """

    def is_busy(self) -> bool:
        """Whether a job that was begun has not ended."""

    def hold(self) -> None:
        """Begins no more of the jobs that it was given: they come to no end."""

    def close(self) -> None:
        """Lets everybody go, after the last job."""

    def stop(self) -> None:
        """Ends all jobs now, and sees to it that they leave nothing."""


class JobProcess:
    """A process that does one job after another; its temporary files begin with `prefix`.

    `folder`: its working directory, and `environment`: beside this process's, where not the same.
    `patience_s`: after so long without a job it ends, with exit code 0; None: never.
    Errors: `OSError` where there is no such folder.
    """

    def __init__(
        self,
        prefix: str,
        folder: str | None = None,
        environment: Mapping[str, str] | None = None,
        patience_s: float | None = None,
    ) -> None:
        self.prefix = f"{prefix}{os.urandom(4).hex()}."
        paths = [os.path.abspath(path) for path in sys.path]
        code = (
            f"import sys; sys.path[:] = {paths!r}; "
            f"from hpcomp.jobs.doing import main; main({self.prefix!r}, {patience_s!r})"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=folder,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ, **(environment or {})},
            # Not in the terminal's group: Ctrl-C goes to the batch alone, which sees to the rest.
            process_group=0,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self._tasks, self.results = self.process.stdin, self.process.stdout
        self._received = b""

    def give(self, task: Task) -> None:
        with contextlib.suppress(BrokenPipeError):  # it has died: seen when its result is awaited
            self._tasks.write(json.dumps(task).encode() + b"\n")
            self._tasks.flush()

    def result(self) -> Result | None:
        """What has become of its job, None if it is not all here yet. Errors: `EOFError`."""
        received = os.read(self.results.fileno(), 1 << 20)
        if not received:
            raise EOFError
        self._received += received
        if not self._received.endswith(b"\n"):
            return None
        line, self._received = self._received, b""
        result: Result = json.loads(line)
        return result

    def death(self, outputs: Sequence[str]) -> Result:
        """What became of the job of a process that died; what it left beside `outputs` goes."""
        code = self.reap()
        remove_leftovers(outputs, self.prefix)
        how = f"ended with exit code {code}" if code >= 0 else f"was ended by signal {-code}"
        with contextlib.suppress(ValueError):
            if code < 0:
                how = f"was ended by {signal.Signals(-code).name}"
        hint = ": is there too little memory?" if -code == signal.SIGKILL else ""
        return failure(f"the process that made it {how}{hint}", ExitCode.BUG)

    def dismiss(self) -> None:
        """Lets it end by itself."""
        with contextlib.suppress(BrokenPipeError):
            self._tasks.close()

    def reap(self) -> int:
        """Waits for its end, which has to be near; how it ended."""
        self.dismiss()
        self.results.close()
        return self.process.wait()


def stop(processes: Sequence[JobProcess]) -> None:
    """Ends all of them, with their jobs, and gives them time to tidy up."""
    for each in processes:
        each.process.terminate()
    deadline = time.monotonic() + PATIENCE_S
    for each in processes:
        try:
            each.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            each.process.kill()
            each.process.wait()


class Processes:
    """A crew on this machine: `count` processes at most, started when they are needed."""

    elsewhere = False

    def __init__(self, count: int, granted: Mapping[str, Any], prefix: str) -> None:
        self.count, self.granted, self._prefix = count, granted, prefix
        self._idle: list[JobProcess] = []
        self._busy: dict[JobProcess, tuple[int, Sequence[str]]] = {}
        self._selector = selectors.DefaultSelector()

    @staticmethod
    def sharing(
        jobs: int, at_a_time: int | None, threads: int | None, max_memory: int, prefix: str
    ) -> Processes:
        """As many as run at a time, each with its share of threads and memory.

        `at_a_time`: jobs, each of which has a core; all cores if None. Where there are fewer jobs,
        they share these cores. `threads`: of all together, if that is to be another number.
        """
        if at_a_time is not None and at_a_time < 1:
            raise SettingError(f"jobs at a time {at_a_time} is below 1")
        cores = thread_count(None)
        in_all = thread_count(min(at_a_time or cores, cores) if threads is None else threads)
        if at_a_time is None:
            at_a_time = max(1, min(in_all, max_memory // MEMORY_OF_A_JOB))
        count = min(at_a_time, jobs) or 1
        granted = {"threads": max(1, in_all // count), "max_memory": max_memory // count}
        return Processes(count, granted, prefix)

    def has_room(self, ready: int) -> bool:
        return bool(self._idle) or len(self._busy) < self.count

    def give(self, number: int, task: Task, outputs: Sequence[str]) -> None:
        if self._idle:
            process = self._idle.pop()
        else:
            process = JobProcess(self._prefix)
            self._selector.register(process.results, selectors.EVENT_READ, process)
        self._busy[process] = (number, outputs)
        process.give(task)

    def ended(self, wait_s: float) -> Iterator[tuple[int, Result]]:
        for key, _ in self._selector.select(wait_s):
            process: JobProcess = key.data
            number, outputs = self._busy.get(process, (None, ()))
            try:
                result = process.result()
            except EOFError:
                self._selector.unregister(process.results)
                result = process.death(outputs)
                if number is None:
                    self._idle.remove(process)
            else:
                if result is not None:
                    self._idle.append(process)
            if result is not None and number is not None:
                del self._busy[process]
                yield number, result

    def is_busy(self) -> bool:
        return bool(self._busy)

    def hold(self) -> None:
        pass  # each is begun when it is given

    def close(self) -> None:
        for process in self._idle:
            process.dismiss()
        for process in self._idle:
            process.reap()
        self._selector.close()

    def stop(self) -> None:
        stop([*self._idle, *self._busy])
        for process in self._idle:
            process.reap()
        for process, (_, outputs) in self._busy.items():
            process.death(outputs)
        self._selector.close()
