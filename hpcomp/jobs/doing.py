"""One job, in a process of its own: what such a process does, and how it is told.

Jobs come and what became of them goes as lines of JSON through pipes, until there are no more. A
process whose pipe is closed in the midst of a job, as when whoever gave it was killed, tidies up
and ends.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import sys
import threading
import time
import warnings
from types import FrameType
from typing import Any, BinaryIO

from ..engine import choice as engine
from ..errors import (
    ExitCode,
    HpcompError,
    HpcompWarning,
    MismatchError,
    SettingError,
    one_line,
)
from ..pipeline.stack import stack
from ..system import outputs
from .maker import difference, maker
from .schema import Job, jobs_of
from .state import Entry, current, entry_of, signature


def do_job(task: dict[str, Any]) -> dict[str, Any]:
    """Does one job; what became of it.

    `task`: `job` as a document; `granted`, options of `stack` that hold unless the job has its own;
    `entry`, what is known of an earlier run if the job may be up to date; `remembered`, whether
    what is made is to be known to later ones; `maker`, that of the batch; `elsewhere`, whether this
    may be another machine, whose maker has to be the same.
    """
    begin = time.perf_counter()
    _forget_peak()
    result: dict[str, Any] = {"status": "made", "error": None, "exit_code": int(ExitCode.DONE)}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", HpcompWarning)
        try:
            if task["elsewhere"] and (unlike := difference(maker(), task["maker"])):
                raise MismatchError(f"{unlike}, whose bytes may differ: install the same on both")
            (job,) = jobs_of([task["job"]])
            entry = current(task["entry"], job, task["maker"])
            if entry is not None:
                result["status"] = "current"
            else:
                entry = _made(job, task)
            result["entry"] = entry
        except HpcompError as error:
            result |= failure(str(error), error.exit_code)
        except Exception as error:
            result |= failure(f"bug: {type(error).__name__}: {error}", ExitCode.BUG)
    return {
        **result,
        "seconds": round(time.perf_counter() - begin, 6),
        "peak_memory": _peak(),
        "warnings": [one_line(str(w.message)) for w in caught],
    }


def failure(message: str, code: ExitCode) -> dict[str, Any]:
    """What became of a job that failed."""
    return {"status": "failed", "error": one_line(message), "exit_code": int(code)}


def _made(job: Job, task: dict[str, Any]) -> Entry | None:
    """Makes the stack; what is to be known of it afterwards, if that is remembered."""
    remembered = task["remembered"]
    inputs = {path: signature(path) for path in job.inputs} if remembered else {}
    stack(job.layers, job.output, **{**task["granted"], **job.options})
    return entry_of(job, task["maker"], inputs) if remembered else None


def _forget_peak() -> None:
    """Makes the peak of memory that of now, where Linux lets us."""
    try:
        with open("/proc/self/clear_refs", "w") as file:
            file.write("5")
    except OSError:
        pass  # it is that of all jobs so far


def _peak() -> int:
    """The most memory of this process, in bytes."""
    try:
        with open("/proc/self/status") as file:
            for line in file:
                if line.startswith("VmHWM:"):
                    return int(line.split()[1]) << 10
    except OSError:
        pass
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak << 10


# --- the process ----------------------------------------------------------------------------------


def _end(signal_number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second one must not stop the tidying up
    raise SystemExit(int(ExitCode.TERMINATED))


def _receive(tasks: BinaryIO, waiting: queue.Queue[bytes | None], busy: threading.Event) -> None:
    for line in tasks:
        busy.set()
        waiting.put(line)
    waiting.put(None)
    if busy.is_set():
        os.kill(os.getpid(), signal.SIGTERM)


def main(temporary_prefix: str, patience_s: float | None) -> None:
    """Does the jobs that come through stdin, until it ends, or none has come for so long."""
    outputs.temporary_prefix = temporary_prefix
    signal.signal(signal.SIGTERM, _end)
    tasks, results = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # What libraries print is for nobody, and must not get between the results.
    silence = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(silence, descriptor)
    waiting: queue.Queue[bytes | None] = queue.Queue()
    busy = threading.Event()
    threading.Thread(target=_receive, args=(tasks, waiting, busy), daemon=True).start()
    with warnings.catch_warnings(action="ignore"), contextlib.suppress(SettingError):
        # That the kernel is missing was said by the batch, once for all its processes.
        engine.active()
    try:
        while (line := waiting.get(timeout=patience_s)) is not None:
            result = json.dumps(do_job(json.loads(line))).encode()
            busy.clear()
            results.write(result + b"\n")
            results.flush()
    except (BrokenPipeError, queue.Empty):
        pass  # nobody asks any more
    except SystemExit as end:
        os._exit(int(str(end.code)))
    os._exit(int(ExitCode.DONE))
