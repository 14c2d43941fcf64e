"""What earlier runs have made and from what: so that a job which is up to date is not done again.

A file is known by the SHA-256 of its content, which is not looked at again as long as its size,
times and inode are the same, and old enough to be trusted.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import stat
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import IO, Any

from ..errors import OutputError, SettingError
from ..system.outputs import remove_leftovers, writing
from ..system.sourcedate import VARIABLE as SOURCE_DATE
from .maker import Maker
from .schema import Job

#: A file that was changed so shortly before it was looked at may change again within the same tick
#: of its clock.
RACY_NS = 2 * 10**9
#: Options that have no part in what is written.
_WITHOUT_EFFECT = ("threads", "max_memory", "max_pixels", "clobber", "write_if_changed")

#: What is known of a file: `stat`, when that was looked at, and the SHA-256 of its content.
Signature = dict[str, Any]
#: What is known of a job that was done: its key, and the signatures of its inputs and outputs.
Entry = dict[str, Any]


# --- one job --------------------------------------------------------------------------------------


def job_key(job: Job, maker: Maker) -> str:
    """A name of all that decides what the job writes, but for the content of its files."""
    document = {k: v for k, v in job.document().items() if k not in _WITHOUT_EFFECT}
    date = os.environ.get(SOURCE_DATE)
    written = json.dumps([document, maker, date], sort_keys=True)
    return hashlib.sha256(written.encode()).hexdigest()


def _stat(path: str) -> list[int] | None:
    """What tells that a file is another or was changed; None for what is no plain file."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    if not stat.S_ISREG(status.st_mode):
        return None
    return [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]


#: The contents of files by path and stat: layers that many jobs share are read once.
_known: dict[tuple[str, tuple[int, ...]], str] = {}


def _sha256(path: str, stat_of_it: Sequence[int]) -> str | None:
    key = (path, tuple(stat_of_it))
    if key not in _known:
        digest = _digest(path)
        if digest is None or _is_racy({"stat": stat_of_it, "at": time.time_ns()}):
            return digest
        _known[key] = digest
    return _known[key]


def _digest(path: str) -> str | None:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _is_racy(signature: Signature) -> bool:
    _, modified, changed, _ = signature["stat"]
    return max(modified, changed) > signature["at"] - RACY_NS


def signature(path: str) -> Signature:
    """What a file is now; of an input before it is read: should it change later, it differs."""
    now: Signature = {"stat": _stat(path), "at": time.time_ns()}
    if now["stat"]:
        now["sha256"] = _sha256(path, now["stat"])
    return now


def _still(path: str, before: Signature) -> Signature | None:
    """The signature of a file that is as it was, None of any other."""
    now = _stat(path)
    if now is None or not before.get("stat"):
        return None
    if now == before["stat"] and not _is_racy(before):
        return before
    after = signature(path)
    return after if after.get("sha256") == before.get("sha256") is not None else None


def entry_of(job: Job, maker: Maker, inputs: Mapping[str, Signature]) -> Entry:
    """What is to be known of a job that was just done, from what `inputs` were before."""
    outputs = {path: signature(path) for path in job.outputs}
    return {"key": job_key(job, maker), "inputs": dict(inputs), "outputs": outputs}


def current(entry: Entry | None, job: Job, maker: Maker) -> Entry | None:
    """What is known now of a job whose outputs stand there, made from the same; None of another."""
    if entry is None or entry.get("key") != job_key(job, maker):
        return None
    known: Entry = {"key": entry["key"]}
    try:
        for kind, paths in (("outputs", job.outputs), ("inputs", job.inputs)):
            if set(entry[kind]) != set(paths):
                return None
            known[kind] = {}
            for path in dict.fromkeys(paths):
                still = _still(path, entry[kind][path])
                if still is None:
                    return None
                known[kind][path] = still
    except (AttributeError, KeyError, TypeError, ValueError):  # a line of another making
        return None
    return known


# --- all jobs -------------------------------------------------------------------------------------


#: How the name of a state file ends that has none given.
ENDING = ".hpcomp-state"


def state_beside(jobs: str | os.PathLike[str], needed: bool) -> str | None:
    """Where the state of a job file is kept; None where it cannot be and is not needed.

    Errors: `SettingError` where it is needed and the jobs come through a pipe.
    """
    folder, name = os.path.split(os.fspath(jobs))
    if os.path.exists(jobs) and not os.path.isfile(jobs):
        if needed:
            raise SettingError(f"{os.fspath(jobs)} is no file to keep a state beside: name --state")
        return None
    if not needed and not os.access(folder or ".", os.W_OK):
        return None
    return os.path.join(folder, f".{name}{ENDING}")


class State:
    """The entries of a state file: JSON Lines, of which a line is added for each job that is done.

    SIGKILL at any moment leaves a file that can be read: it is replaced as a whole when a run
    begins, and a line that is cut short is left out. `resume` carries on the run before; without
    it a new one begins. `prefix`: of the temporary files of this run. The file is locked as long as
    a run lasts; one that is not locked is of a run that is over, and what that left is removed.
    Errors: `OutputError`, also where another run has it; `SettingError` for a file of another kind.
    """

    def __init__(self, path: str, jobs: Iterable[Job], resume: bool, prefix: str) -> None:
        self.path = path
        self._entries: dict[str, Entry] = {}
        self._head: dict[str, Any] = {"run": 0, "prefix": ""}
        with contextlib.ExitStack() as opened:
            if os.path.exists(path):
                with writing(path, "read"):
                    before = opened.enter_context(open(path, "rb"))
                locked = self._lock(before)
                self._read(before)
                if locked and self._head["prefix"]:
                    targets = [output for job in jobs for output in job.outputs]
                    remove_leftovers(targets, self._head["prefix"])
            self._head = {"version": 1, "run": self._head["run"] + (not resume), "prefix": prefix}
            # Of one name, so that what a run leaves that is killed here the next one takes.
            new = f"{path}.new"
            with writing(path):
                self._file = open(new, "ab", buffering=0)  # noqa: SIM115
                self._lock(self._file)
                self._file.truncate(0)
                for line in (self._head, *self._entries.values()):
                    self._file.write(f"{json.dumps(line)}\n".encode())
                os.replace(new, path)

    def _lock(self, file: IO[bytes]) -> bool:
        """Whether it is ours alone now; not where the file system knows no locks."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                f"{self.path} is in use: wait for the batch that is running, or name another "
                "file with --state"
            ) from None
        except OSError:
            return False
        return True

    def _read(self, file: IO[bytes]) -> None:
        """Takes in the head and the entries that can be read."""
        lines = list(file)
        for line in lines:
            try:
                entry = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if not isinstance(entry, dict):
                continue
            if isinstance(entry.get("output"), str) and "key" in entry:
                self._entries[entry["output"]] = entry
            elif isinstance(entry.get("run"), int) and isinstance(entry.get("prefix"), str):
                self._head = entry
        if lines and not (self._entries or self._head["run"] or self.path.endswith(ENDING)):
            raise SettingError(
                f"{self.path} is no state of a batch: name another file with --state"
            )

    def entry(self, job: Job, of_this_run: bool) -> Entry | None:
        """What is known of a job; `of_this_run`: only if this run, or what it resumes, did it."""
        entry = self._entries.get(job.output)
        return None if entry and of_this_run and entry.get("run") != self._head["run"] else entry

    def add(self, job: Job, entry: Entry) -> None:
        """Remembers a job that was done."""
        # As it was given: in a folder that is moved or copied, what was made is still current.
        line = {**entry, "output": job.output, "run": self._head["run"]}
        with writing(self.path):
            self._file.write(f"{json.dumps(line)}\n".encode())

    def close(self) -> None:
        """Closes the file; what was added is in it already."""
        self._file.close()
