"""Many stacks: which job is begun when, and what became of each."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any, BinaryIO

from ..errors import ExitCode, InputError, SettingError
from ..options import OutputOptions, ResourceOptions
from ..system.depfile import Depfile
from ..system.memory import parse_bytes, parse_pixels
from ..system.outputs import check_places, remove_abandoned, writing
from ..system.streams import STDIN, STDOUT, stdout_bytes
from .jobfile import read_jobs
from .maker import maker
from .processes import Crew, Processes, Result
from .schema import Job, jobs_of
from .state import State, state_beside

log = logging.getLogger("hpcomp")

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


@dataclass(frozen=True, slots=True)  # there may be 100,000
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
    max_memory: str | int = ResourceOptions.max_memory,
    max_pixels: str | int = ResourceOptions.max_pixels,
    fail_fast: bool = False,
    skip_existing: bool = False,
    update: bool = False,
    resume: bool = False,
    write_if_changed: bool = OutputOptions.write_if_changed,
    state: str | os.PathLike[str] | None = None,
    log_to: str | os.PathLike[str] | None = None,
    depfile: str | os.PathLike[str] | None = None,
    depfile_target: str | Sequence[str] = (),
    dask: str | None = None,
    command: str = "",
    on_begin: Callable[[Sequence[Job]], None] | None = None,
    on_record: Callable[[JobRecord, Job], None] | None = None,
    on_wait: Callable[[], None] | None = None,
) -> BatchResult:
    """Makes many stacks, several at a time, each as `stack` would.

    `jobs`: a job file, of the `format` that its ending says if None, or tables such as
    `{"layers": [LAYER, …], "output": PATH}` with options of `stack`. A job whose layer is another's
    output waits for it.
    `workers`: jobs at a time, each on a core of its own; one for each core if None, but so that
    each has 128M of `max_memory`. `threads`, as many as cores are used if None, and `max_memory`
    are for all of them together. `max_pixels` and `write_if_changed`: as in `stack`. What a job
    says of these itself goes first.
    A failure does not stop the others; with `fail_fast` no more are begun. `skip_existing`: jobs
    whose outputs all exist are left out. `update`: jobs whose inputs (by content), options and
    outputs are as they were are left out. `resume`: those that an interrupted run has done are left
    out. Both need `state`, a file that remembers what was done; of a job file it is a hidden one
    beside it if None. `log_to`: a path to which a line of JSON is written for each job, `-` for
    stdout. `depfile`: a path for a rule of make that says what was read, the job file included;
    `depfile_target`: of what, the pictures if empty.
    `dask`: the address of a Dask scheduler, or its scheduler file, whose workers do the jobs, on
    the same paths; `local:4` starts one with four. `workers` is then how many jobs run at a time,
    `threads` (1 if None) and `max_memory` are of each job, and a job whose worker dies or whose
    process is killed is begun again.
    `command` is what reports say made them. `on_begin` is told of the jobs, `on_record` of each
    that ends, `on_wait` is called several times a second.
    Returns: what became of each job. Nothing but complete files appear.
    Errors: of a job they are in its record; `SettingError` and `InputError` for the jobs as such
    and for a cluster that does not answer, `OutputError` for state, log and depfile.
    """
    job_file = None
    if isinstance(jobs, (str, os.PathLike)):
        todo = read_jobs(jobs, format=format)
        job_file = os.fspath(jobs)
        if job_file == STDIN:
            job_file = None
        elif state is None:
            state = state_beside(job_file, needed=update or resume)
    else:
        todo = jobs_of(jobs)
    if (update or resume) and state is None:
        raise SettingError(
            f"{'update' if update else 'resume'} needs to know what was done: name a file for it "
            "with --state"
        )
    deps = Depfile.asked(depfile, depfile_target, [job.output for job in todo])
    memory = parse_bytes(max_memory)
    parse_pixels(max_pixels)
    begin = time.perf_counter()
    makers = _makers(todo)
    needs = _needs(todo, makers)
    order = _order(todo, needs)
    _check_own_files(
        [os.fspath(p) for p in (job_file, log_to, state, depfile) if p is not None], todo
    )
    if on_begin is not None:
        on_begin(todo)
    prefix = f"hpcomp.{os.urandom(6).hex()}."
    with contextlib.ExitStack() as opened:
        remembered = None
        if state is not None:
            remembered = State(os.fspath(state), todo, resume, prefix)
            opened.callback(remembered.close)
        remove_abandoned(output for job in todo for output in job.outputs)
        lines = None
        if log_to is not None:
            lines = _Log(os.fspath(log_to), append=resume)
            opened.callback(lines.close)
        if deps is not None:
            _write_depfile(deps, todo, needs, job_file)
        crew: Crew
        if dask is None:
            crew = Processes.sharing(len(todo), workers, threads, memory, prefix)
        else:
            from .cluster import Cluster

            crew = Cluster.at(dask, workers, threads, memory, prefix)
        run = _Run(
            todo,
            needs,
            order,
            crew,
            remembered,
            granted={
                **crew.granted,
                "command": command,
                "max_pixels": max_pixels,
                **({"write_if_changed": True} if write_if_changed else {}),
            },
            fail_fast=fail_fast,
            skip_existing=skip_existing,
            update=update,
            resume=resume,
        )

        def ended(record: JobRecord) -> None:
            if lines is not None:
                lines.add(record)
            if on_record is not None:
                on_record(record, todo[record.job - 1])

        records = run.all(ended, on_wait or (lambda: None))
    return BatchResult(records, time.perf_counter() - begin)


def _write_depfile(
    asked: Depfile,
    jobs: Sequence[Job],
    needs: Sequence[Mapping[str, int]],
    job_file: str | None,
) -> None:
    """Says what all jobs together read, but for what they make themselves."""
    read = [
        path
        for job, by in zip(jobs, needs, strict=True)
        for path in job.inputs
        if path not in by and path not in job.outputs
    ]
    with asked.written(read if job_file is None else [job_file, *read]):
        pass


class _Log:
    """A line of JSON for each record, at `path` or on stdout; `append` keeps what stands there."""

    def __init__(self, path: str, append: bool) -> None:
        self.path = path
        with writing(path):
            if path == STDOUT:
                self._file = stdout_bytes()
            else:
                self._file = open(path, "ab+" if append else "wb")  # noqa: SIM115
                if append and self._file.tell() and not _ends_a_line(self._file):
                    self._file.write(b"\n")  # a run that was killed may have been writing

    def add(self, record: JobRecord) -> None:
        with writing(self.path):
            self._file.write(f"{json.dumps(asdict(record))}\n".encode())
            self._file.flush()

    def close(self) -> None:
        with writing(self.path):
            self._file.close()


def _ends_a_line(file: BinaryIO) -> bool:
    file.seek(-1, os.SEEK_END)
    return file.read(1) == b"\n"


# --- the run --------------------------------------------------------------------------------------


class _Run:
    """One run of a batch: what is ready, what is being done, and what became of the rest."""

    def __init__(
        self,
        jobs: Sequence[Job],
        needs: Sequence[Mapping[str, int]],
        order: TopologicalSorter[int],
        crew: Crew,
        state: State | None,
        *,
        granted: Mapping[str, Any],
        fail_fast: bool,
        skip_existing: bool,
        update: bool,
        resume: bool,
    ) -> None:
        self.jobs, self.needs, self.order = jobs, needs, order
        self.crew, self.state, self.granted = crew, state, granted
        self.fail_fast, self.skip_existing = fail_fast, skip_existing
        self.update, self.resume = update, resume
        self.maker = maker()
        self.records: dict[int, JobRecord] = {}
        self.ready: deque[int] = deque()
        self.stopped = False

    def all(self, ended: Callable[[JobRecord], None], wait: Callable[[], None]) -> list[JobRecord]:
        """Does all jobs; the record of each in their order."""
        try:
            self._begin(ended)
            while self.crew.is_busy():
                for number, result in self.crew.ended(TICK_S):
                    if result is None:
                        self.ready.appendleft(number)
                    else:
                        self._done(self._record(number, result), ended)
                self._begin(ended)
                wait()
            for number in range(len(self.jobs)):
                if number not in self.records:
                    self._done(self._plain(number, "not run"), ended)
        except BaseException:
            self.crew.stop()
            raise
        self.crew.close()
        return [self.records[number] for number in range(len(self.jobs))]

    def _begin(self, ended: Callable[[JobRecord], None]) -> None:
        """Begins as many jobs as there is room for; those that need nothing done are done."""
        while not self.stopped:
            self.ready.extend(self.order.get_ready())
            if not self.ready or not self.crew.has_room(len(self.ready)):
                return
            number = self.ready.popleft()
            record = self._without_running(number)
            if record is None:
                self.crew.give(number, self._task(number), self.jobs[number].outputs)
            else:
                self._done(record, ended)

    def _done(self, record: JobRecord, ended: Callable[[JobRecord], None]) -> None:
        number = record.job - 1
        self.records[number] = record
        if self.fail_fast and record.status == "failed" and not self.stopped:
            self.stopped = True
            self.crew.hold()
        ended(record)
        if record.status != "not run":
            self.order.done(number)

    def _task(self, number: int) -> dict[str, Any]:
        entry = None
        if self.state is not None and (self.update or self.resume):
            entry = self.state.entry(self.jobs[number], of_this_run=not self.update)
        return {
            "job": self.jobs[number].document(),
            "granted": self.granted,
            "entry": entry,
            "remembered": self.state is not None,
            "maker": self.maker,
            "elsewhere": self.crew.elsewhere,
        }

    def _plain(self, number: int, status: str, **more: Any) -> JobRecord:
        job = self.jobs[number]
        return JobRecord(number + 1, status, job.inputs, job.outputs, **more)

    def _without_running(self, number: int) -> JobRecord | None:
        """The record of a job that need not or cannot be run."""
        job = self.jobs[number]
        if self.skip_existing and all(map(os.path.exists, job.outputs)):
            return self._plain(number, "skipped")
        for path, other in self.needs[number].items():
            if self.records[other].exit_code:
                error = f"{path} is made by job {other + 1}, which failed"
                return self._plain(
                    number, "failed", error=error, exit_code=int(InputError.exit_code)
                )
        return None

    def _record(self, number: int, result: Result) -> JobRecord:
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


def _needs(jobs: Sequence[Job], makers: Mapping[str, int]) -> list[dict[str, int]]:
    """Of each job the layers that others write, and which job does."""
    needs = []
    for number, job in enumerate(jobs):
        by = {path: makers.get(os.path.realpath(path), number) for path in job.inputs}
        needs.append({path: maker for path, maker in by.items() if maker != number})
    return needs


def _order(jobs: Sequence[Job], needs: Sequence[Mapping[str, int]]) -> TopologicalSorter[int]:
    """The jobs, each after those that write its layers. Errors: `SettingError` for a circle."""
    order: TopologicalSorter[int] = TopologicalSorter(
        {number: by.values() for number, by in enumerate(needs)}
    )
    try:
        order.prepare()
    except CycleError as circle:
        names = ", ".join(jobs[number].where for number in dict.fromkeys(circle.args[1]))
        raise SettingError(f"{names} wait for each other's outputs") from None
    return order


def _check_own_files(own: Sequence[str], jobs: Sequence[Job]) -> None:
    """Refuses a job file, log, state or depfile that is another of them, or of a job.

    Errors: `SettingError`.
    """
    files = [path for path in own if path != STDOUT]
    check_places([*files, *(output for job in jobs for output in job.outputs)])
    places = {os.path.realpath(path): path for path in files}
    for job in jobs:
        for path in job.inputs:
            if own_file := places.get(os.path.realpath(path)):
                raise SettingError(f"{own_file} is read by {job.where}: name another file")
