"""What tests of batches share: jobs and their layers, and what is seen of a run from outside."""

from __future__ import annotations

import contextlib
import json
import os
import time
from pathlib import Path

import numpy as np
from command import PATIENCE_S


def noise(seed, size=(40, 56)):
    """A premultiplied layer of random pixels."""
    rng = np.random.default_rng(seed)
    alpha = rng.random((*size, 1), np.float32)
    return np.concatenate([alpha * rng.random((*size, 3), np.float32), alpha], axis=-1)


def jobs(count, **more):
    """Jobs of three layers; no two give the same picture. {} in an option is their number."""
    return [
        {"layers": ["l0.png", f"l1.png::opacity={1 / (number + 1)}", "l2.png"],
         "output": f"out{number}.png",
         **{key: value.format(number) if isinstance(value, str) else value
            for key, value in more.items()}}
        for number in range(count)
    ]  # fmt: skip


def put_jobs(desk, tables, name="jobs.json"):
    desk.put(name, json.dumps({"version": 1, "jobs": tables}).encode())


def outputs(desk):
    """All outputs of a desk by name."""
    return {path.name: path.read_bytes() for path in desk.folder.glob("out*")}


def records(desk, name="log"):
    return [json.loads(line) for line in (desk / name).read_text().splitlines()]


def temporaries(desk):
    """What a run has not finished yet, or left behind."""
    return [name for name in os.listdir(desk.folder) if name.startswith(".hpcomp.")]


def is_making(desk):
    """Whether a process of a batch is writing an output: their temporary files have long names."""
    return any(name.count(".") == 5 for name in temporaries(desk))


def processes_of(pid):
    """The processes that a process has started, by whichever of its threads."""
    found = []
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += [int(n) for n in (task / "children").read_text().split()]
    return sorted(found)


def is_over(pid):
    """Whether a process has ended with all its threads: its files are closed and its locks gone.

    Its command line is empty before that, when its first thread ends. Nobody may have waited for it.
    """
    try:
        threads = os.listdir(f"/proc/{pid}/task")
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return threads == [str(pid)] and state in "ZX"


def until(condition):
    """Waits for it."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)
