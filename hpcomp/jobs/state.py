"""What earlier runs have made and from what: so that a job which is up to date is not done again.

A file is known by its size, times and inode; where these differ, or are too young to be trusted, by
the SHA-256 of its content.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from .. import __version__, engine
from ..errors import OutputError, why
from ..outputfile import remove_leftovers, whole_output
from ..sourcedate import VARIABLE as SOURCE_DATE
from .schema import Job

#: A file that was changed so shortly before it was looked at may change again within the same tick
#: of its clock.
RACY_NS = 2 * 10**9
#: Options that have no part in what is written.
_WITHOUT_EFFECT = ("threads", "max_memory", "clobber", "write_if_changed")

#: What is known of a job that was done: its key, its inputs and its outputs.
Entry = dict[str, Any]


# --- one job --------------------------------------------------------------------------------------


def job_key(job: Job) -> str:
    """A name of all that decides what the job writes, but for the content of its files."""
    document = {k: v for k, v in job.document().items() if k not in _WITHOUT_EFFECT}
    date = os.environ.get(SOURCE_DATE)
    written = json.dumps([document, __version__, engine.active().NAME, date], sort_keys=True)
    return hashlib.sha256(written.encode()).hexdigest()


def _stat(path: str) -> list[int] | None:
    """What tells that a file is another or was changed; None for what is no plain file."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]


def _sha256(path: str) -> str | None:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _is_racy(signature: Mapping[str, Any]) -> bool:
    _, modified, changed, _ = signature["stat"]
    return max(modified, changed) > signature["at"] - RACY_NS


def input_signature(path: str, by_content: bool) -> dict[str, Any]:
    """What a file is, before it is read: should it change later, it differs from this."""
    signature: dict[str, Any] = {"stat": _stat(path), "at": time.time_ns()}
    if signature["stat"] and (by_content or _is_racy(signature)):
        signature["sha256"] = _sha256(path)
    return signature


def output_signature(path: str) -> list[int] | None:
    """What an output is: its size and time of change, which copies with their times keep."""
    found = _stat(path)
    return found and found[:2]


def _same_input(path: str, before: Mapping[str, Any]) -> bool:
    now = _stat(path)
    if now is None or not before.get("stat"):
        return False
    if now == before["stat"] and not _is_racy(before):
        return True
    return (
        now[0] == before["stat"][0]
        and before.get("sha256") is not None
        and _sha256(path) == before["sha256"]
    )


def is_current(entry: Entry | None, job: Job) -> bool:
    """Whether what the job would write stands there already, made from the same."""
    return (
        entry is not None
        and entry.get("key") == job_key(job)
        and set(entry.get("inputs", ())) == set(job.inputs)
        and all(
            path in entry["outputs"]
            and entry["outputs"][path] is not None
            and output_signature(path) == entry["outputs"][path]
            for path in job.outputs
        )
        and all(_same_input(path, before) for path, before in entry["inputs"].items())
    )


# --- all jobs -------------------------------------------------------------------------------------


def state_beside(jobs: str | os.PathLike[str], needed: bool) -> str | None:
    """Where the state of a job file is kept; None where it cannot be and is not needed."""
    folder, name = os.path.split(os.fspath(jobs))
    if not needed and not os.access(folder or ".", os.W_OK):
        return None
    return os.path.join(folder, f".{name}.hpcomp-state")


class State:
    """The entries of a state file: JSON Lines, of which a line is added for each job that is done.

    SIGKILL at any moment leaves a file that can be read: it is replaced as a whole when a run
    begins, and a line that is cut short is left out. `resume` carries on the run before; without
    it a new one begins. `prefix`: of the temporary files of this run, which the next one removes
    should this one be killed before it can.
    """

    def __init__(self, path: str, jobs: Iterable[Job], resume: bool, prefix: str) -> None:
        self.path = path
        self._entries: dict[str, Entry] = {}
        self._head: dict[str, Any] = {"run": 0}
        self._read()
        if _is_over(self._head):
            targets = [output for job in jobs for output in job.outputs]
            remove_leftovers(targets, self._head["prefix"])
        self._head = {
            "version": 1,
            "run": self._head["run"] + (not resume),
            "prefix": prefix,
            "host": socket.gethostname(),
            "pid": os.getpid(),
        }
        with self._checked("written"):
            with whole_output(path) as target, open(target, "w") as file:
                lines = [self._head, *self._entries.values()]
                file.writelines(f"{json.dumps(line)}\n" for line in lines)
            self._file = open(path, "ab", buffering=0)  # noqa: SIM115

    def _read(self) -> None:
        """Takes in the head and the entries that can be read."""
        if not os.path.exists(self.path):
            return
        with self._checked("read"), open(self.path, "rb") as file:
            for line in file:
                try:
                    found = json.loads(line)
                except ValueError:
                    continue
                if isinstance(found, dict) and "output" in found:
                    self._entries[found["output"]] = found
                elif isinstance(found, dict) and found.get("version") == 1:
                    self._head = found

    def entry(self, job: Job, of_this_run: bool) -> Entry | None:
        """What is known of a job; `of_this_run`: only if this run, or what it resumes, did it."""
        entry = self._entries.get(os.path.abspath(job.output))
        return None if entry and of_this_run and entry.get("run") != self._head["run"] else entry

    def add(self, job: Job, entry: Entry) -> None:
        """Remembers a job that was done."""
        line = {**entry, "output": os.path.abspath(job.output), "run": self._head["run"]}
        with self._checked("written"):
            self._file.write(f"{json.dumps(line)}\n".encode())

    @contextlib.contextmanager
    def _checked(self, done: str) -> Iterator[None]:
        try:
            yield
        except OSError as reason:
            raise OutputError(f"{self.path}: cannot be {done}: {why(reason)}") from None

    def close(self) -> None:
        """Closes the file; what was added is in it already."""
        self._file.close()


def _is_over(head: Mapping[str, Any]) -> bool:
    """Whether a run was of this machine and is no more."""
    if head.get("host") != socket.gethostname():
        return False
    try:
        os.kill(head["pid"], 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False
