"""Many stacks: which job runs when and in which process, and what became of each."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any

from .budget import DEFAULT_MAX_MEMORY, parse_bytes
from .errors import ExitCode, InputError, OutputError, SettingError, why
from .jobfile import Job, jobs_of, read_jobs
from .jobstate import State, state_beside
from .outputfile import STDOUT, remove_leftovers, stdout_bytes
from .workers import thread_count

log = logging.getLogger("hpcomp")

#: What a job should at least be granted of the memory, before fewer run at a time.
MEMORY_OF_A_JOB = 128 << 20
#: How long processes have to tidy up after themselves before they are killed.
PATIENCE_S = 0.6
#: How often whoever waits is told so.
TICK_S = 0.1

#: From the worst failure to the least: the exit code of a batch is that of the worst.
SEVERITY = (
    ExitCode.BUG,
    ExitCode.OUTPUT,
    ExitCode.INPUT,
    ExitCode.MISMATCH,
    ExitCode.USAGE,
    ExitCode.DONE,
)


@dataclass(frozen=True)
class JobRecord:
    """What became of one job, as a line of the log says it.

    `job`: counted from 1. `status`: `made`, `current` (it was up to date), `skipped` (its output
    stood there), `failed`, or `not run` (after a failure). `seconds`, and `peak_memory` in bytes,
    of the process that did it. `error` and `exit_code` of a failure, None and 0 else.
    """

    job: int
    status: str
    inputs: Sequence[str]
    outputs: Sequence[str]
    seconds: float = 0.0
    peak_memory: int = 0
    warnings: Sequence[str] = ()
    error: str | None = None
    exit_code: int = int(ExitCode.DONE)


@dataclass(frozen=True)
class BatchResult:
    """What became of all jobs: a record of each, in the order of the jobs."""

    records: Sequence[JobRecord]
    seconds: float

    @property
    def counts(self) -> Mapping[str, int]:
        """How many jobs have which status."""
        return Counter(record.status for record in self.records)

    @property
    def exit_code(self) -> ExitCode:
        """0 if nothing failed, else the code of the worst failure: the first in `SEVERITY`."""
        codes = {ExitCode(record.exit_code) for record in self.records}
        return next((code for code in SEVERITY if code in codes), ExitCode.DONE)


def batch(
    jobs: str | os.PathLike[str] | Sequence[Mapping[str, Any] | Job],
    *,
    format: str | None = None,
    workers: int | None = None,
    threads: int | None = None,
    max_memory: str | int = DEFAULT_MAX_MEMORY,
    fail_fast: bool = False,
    skip_existing: bool = False,
    update: bool = False,
    resume: bool = False,
    state: str | os.PathLike[str] | None = None,
    log_to: str | os.PathLike[str] | None = None,
    command: str = "",
    on_record: Callable[[JobRecord, Job], None] | None = None,
    on_wait: Callable[[], None] | None = None,
) -> BatchResult:
    """Makes many stacks, several at a time, each as `stack` would.

    `jobs`: a job file, of the `format` that its ending says if None, or tables such as
    `{"layers": [LAYER, …], "output": PATH}` with options of `stack`. A job whose layer is another's
    output waits for it. `workers`: processes at a time, one for each core if None, but so that each
    has 128M of `max_memory`; `threads` and `max_memory` are for all of them together, and a job's
    own go first.
    A failure does not stop the others; with `fail_fast` no more are begun. `skip_existing`: jobs
    whose outputs all exist are left out. `update`: jobs whose inputs (by content), options and
    outputs are as they were are left out. `resume`: those that an interrupted run has done are left
    out. Both need `state`, a file that remembers what was done; of a job file it is a hidden one
    beside it if None. `log_to`: a path to which a line of JSON is written for each job, `-` for
    stdout. `command` is what reports say made them. `on_record` is told of each job that ends,
    `on_wait` is called several times a second.
    Returns: what became of each job. Nothing but complete files appear.
    Errors: of a job they are in its record; `SettingError` and `InputError` for the jobs as such,
    `OutputError` for state and log.
    """
    if isinstance(jobs, (str, os.PathLike)):
        todo = read_jobs(jobs, format=format)
        if state is None and os.fspath(jobs) != "-":
            state = state_beside(jobs, needed=update or resume)
    else:
        todo = jobs_of(jobs)
    if (update or resume) and state is None:
        raise SettingError(
            f"{'update' if update else 'resume'} needs to know what was done: name a file for it "
            "with --state"
        )
    begin = time.perf_counter()
    share = _Share.of(len(todo), workers, threads, parse_bytes(max_memory))
    with contextlib.ExitStack() as opened:
        remembered = None
        if state is not None:
            remembered = State(os.fspath(state), todo, resume)
            opened.callback(remembered.close)
        lines = None
        if log_to is not None:
            lines = _Log(os.fspath(log_to), append=resume)
            opened.callback(lines.close)
        run = _Run(todo, remembered, share, fail_fast, skip_existing, update, resume, command)

        def ended(record: JobRecord) -> None:
            if lines is not None:
                lines.add(record)
            if on_record is not None:
                on_record(record, todo[record.job - 1])

        records = run.all(ended, on_wait or (lambda: None))
    return BatchResult(records, time.perf_counter() - begin)


class _Log:
    """A line of JSON for each record, at `path` or on stdout."""

    def __init__(self, path: str, append: bool) -> None:
        self.path = path
        with self._checked():
            mode = "ab" if append else "wb"
            self._file = stdout_bytes() if path == STDOUT else open(path, mode)  # noqa: SIM115

    def add(self, record: JobRecord) -> None:
        with self._checked():
            self._file.write(f"{json.dumps(asdict(record))}\n".encode())
            self._file.flush()

    def close(self) -> None:
        with self._checked():
            self._file.close()

    @contextlib.contextmanager
    def _checked(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as reason:
            raise OutputError(f"{self.path}: the log cannot be written: {why(reason)}") from None


@dataclass(frozen=True)
class _Share:
    """How many processes there are, and what each may take."""

    workers: int
    granted: Mapping[str, Any]

    @staticmethod
    def of(jobs: int, workers: int | None, threads: int | None, max_memory: int) -> _Share:
        if workers is not None and workers < 1:
            raise SettingError(f"jobs at a time {workers} is below 1")
        in_all = thread_count(threads)
        if workers is None:
            workers = max(1, min(in_all, max_memory // MEMORY_OF_A_JOB))
        workers = min(workers, jobs) or 1
        return _Share(
            workers,
            {"threads": max(1, in_all // workers), "max_memory": max_memory // workers},
        )


# --- processes ------------------------------------------------------------------------------------


class _Worker:
    """A process that does one job after another."""

    def __init__(self) -> None:
        self.prefix = f"hpcomp.{os.urandom(6).hex()}."
        self.number: int | None = None
        paths = [os.path.abspath(path) for path in sys.path]
        code = (
            f"import sys; sys.path[:] = {paths!r}; "
            f"from hpcomp.jobworker import main; main({self.prefix!r})"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
            # Not in the terminal's group: Ctrl-C goes to the batch alone, which sees to the rest.
            process_group=0,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self._tasks, self.results = self.process.stdin, self.process.stdout
        self._received = b""

    def give(self, number: int, task: Mapping[str, Any]) -> None:
        self.number = number
        with contextlib.suppress(BrokenPipeError):  # it has died: seen when its result is awaited
            self._tasks.write(json.dumps(task).encode() + b"\n")
            self._tasks.flush()

    def result(self) -> dict[str, Any] | None:
        """What has become of its job, None if it is not all here yet. Errors: EOFError."""
        received = os.read(self.results.fileno(), 1 << 20)
        if not received:
            raise EOFError
        self._received += received
        if not self._received.endswith(b"\n"):
            return None
        line, self._received, self.number = self._received, b"", None
        found: dict[str, Any] = json.loads(line)
        return found

    def how_it_died(self) -> str:
        code = self.bury()
        if code >= 0:
            return f"the process that made it ended with exit code {code}"
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            hint = ": is there too little memory?" if -code == signal.SIGKILL else ""
            return f"the process that made it was ended by {name}{hint}"
        return f"the process that made it was ended by signal {-code}"

    def dismiss(self) -> None:
        """Lets it end by itself."""
        with contextlib.suppress(BrokenPipeError):
            self._tasks.close()

    def bury(self) -> int:
        """Waits for its end, which has to be near; how it ended."""
        self.dismiss()
        self.results.close()
        return self.process.wait()


def _stop(workers: Sequence[_Worker], jobs: Sequence[Job]) -> None:
    """Ends all processes now, and sees to it that they leave nothing."""
    for worker in workers:
        worker.process.terminate()
    deadline = time.monotonic() + PATIENCE_S
    for worker in workers:
        try:
            worker.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            worker.process.kill()
        worker.bury()
        if worker.number is not None:
            remove_leftovers(jobs[worker.number].outputs, worker.prefix)


# --- the run --------------------------------------------------------------------------------------


class _Run:
    """One run of a batch: what is ready, what is being done, and what became of the rest."""

    def __init__(
        self,
        jobs: Sequence[Job],
        state: State | None,
        share: _Share,
        fail_fast: bool,
        skip_existing: bool,
        update: bool,
        resume: bool,
        command: str,
    ) -> None:
        self.jobs, self.state, self.share, self.command = jobs, state, share, command
        self.fail_fast, self.skip_existing = fail_fast, skip_existing
        self.update, self.resume = update, resume
        self.records: dict[int, JobRecord] = {}
        self.makers = _makers(jobs)
        self.order = _order(jobs, self.makers)

    def all(self, ended: Callable[[JobRecord], None], wait: Callable[[], None]) -> list[JobRecord]:
        """Does all jobs; the record of each in their order."""
        workers: list[_Worker] = []
        ready: deque[int] = deque()
        stopped = False
        with selectors.DefaultSelector() as selector:

            def done(record: JobRecord) -> None:
                nonlocal stopped
                self.records[record.job - 1] = record
                stopped = stopped or (self.fail_fast and record.status == "failed")
                ended(record)
                self.order.done(record.job - 1)

            def begin() -> None:
                idle = [worker for worker in workers if worker.number is None]
                while not stopped:
                    ready.extend(self.order.get_ready())
                    if not ready or not (idle or len(workers) < self.share.workers):
                        return
                    number = ready.popleft()
                    record = self._without_running(number)
                    if record is not None:
                        done(record)
                        continue
                    if not idle:
                        workers.append(_Worker())
                        idle.append(workers[-1])
                        selector.register(workers[-1].results, selectors.EVENT_READ, workers[-1])
                        if self.state is not None:
                            self.state.add_process(workers[-1].process.pid, workers[-1].prefix)
                    idle.pop().give(number, self._task(number))

            try:
                begin()
                while any(worker.number is not None for worker in workers):
                    for key, _ in selector.select(TICK_S):
                        worker = key.data
                        number = worker.number
                        try:
                            result = worker.result()
                        except EOFError:
                            selector.unregister(worker.results)
                            workers.remove(worker)
                            result = {"status": "failed", "error": worker.how_it_died(),
                                      "exit_code": int(ExitCode.BUG)}  # fmt: skip
                            if number is None:
                                continue
                            remove_leftovers(self.jobs[number].outputs, worker.prefix)
                        if result is not None:
                            done(self._record(number, result))
                    begin()
                    wait()
                for worker in workers:
                    worker.dismiss()
                for number in range(len(self.jobs)):
                    if number not in self.records:
                        record = self._plain(number, "not run")
                        self.records[number] = record
                        ended(record)
            except BaseException:
                _stop(workers, self.jobs)
                raise
            for worker in workers:
                worker.bury()
        return [self.records[number] for number in range(len(self.jobs))]

    def _task(self, number: int) -> dict[str, Any]:
        entry = None
        if self.state is not None and (self.update or self.resume):
            entry = self.state.entry(self.jobs[number], of_this_run=not self.update)
        granted = {**self.share.granted, "command": self.command}
        return {
            "job": self.jobs[number].document(),
            "granted": granted,
            "entry": entry,
            "by_content": self.update,
        }

    def _plain(self, number: int, status: str, **more: Any) -> JobRecord:
        job = self.jobs[number]
        return JobRecord(number + 1, status, job.inputs, job.outputs, **more)

    def _without_running(self, number: int) -> JobRecord | None:
        """The record of a job that need not or cannot be run."""
        job = self.jobs[number]
        if self.skip_existing and all(map(os.path.lexists, job.outputs)):
            return self._plain(number, "skipped")
        for path in job.inputs:
            maker = self.makers.get(os.path.realpath(path))
            if maker not in (None, number) and self.records[maker].exit_code:
                error = f"{path} is made by job {maker + 1}, which failed"
                return self._plain(
                    number, "failed", error=error, exit_code=int(InputError.exit_code)
                )
        return None

    def _record(self, number: int, result: dict[str, Any]) -> JobRecord:
        entry = result.pop("entry", None)
        if self.state is not None and entry is not None:
            self.state.add(self.jobs[number], entry)
        log.info("%s: %s, %s", self.jobs[number].where, self.jobs[number].output, result["status"])
        return self._plain(number, **result)


def _makers(jobs: Sequence[Job]) -> dict[str, int]:
    """Which job writes which file. Errors: `SettingError` where two write the same."""
    makers: dict[str, int] = {}
    for number, job in enumerate(jobs):
        for output in job.outputs:
            place = os.path.realpath(output)
            other = makers.setdefault(place, number)
            if other != number:
                raise SettingError(f"{job.where} and {jobs[other].where} both write {output}")
    return makers


def _order(jobs: Sequence[Job], makers: Mapping[str, int]) -> TopologicalSorter[int]:
    """The jobs, each after those that write its layers. Errors: `SettingError` for a circle."""
    order: TopologicalSorter[int] = TopologicalSorter()
    for number, job in enumerate(jobs):
        needed = {makers.get(os.path.realpath(path)) for path in job.inputs} - {None, number}
        order.add(number, *(maker for maker in needed if maker is not None))
    try:
        order.prepare()
    except CycleError as circle:
        names = ", ".join(jobs[number].where for number in dict.fromkeys(circle.args[1]))
        raise SettingError(f"{names} wait for each other's outputs") from None
    return order
