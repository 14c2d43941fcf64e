"""Measures `hpcomp batch` beside as many single runs, and what a second core is worth to it.

    python batches.py [--runs N] [--pictures DIRECTORY]

What is compared takes turns, and the medians of the ratios count. No time is asserted: figures are
for people to read.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import signal
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bench import HPCOMP, ROOT, Task, Work, drawn, oiiotool

SMALL = Work("png512", 3, 512, 512, "png", ())
LARGE = Work("png4k", 4, 3840, 2160, "png", ())
TINY = Work("png64", 3, 64, 64, "png", ())
#: Jobs of each size.
MANY, FEW, THOUSANDS = 200, 8, 2000
#: At how many moments a batch is interrupted.
INTERRUPTIONS = 10


def put_jobs(path: str, layers: Sequence[str], count: int) -> None:
    """Jobs that write beside their file; no two have the same picture."""
    folder = os.path.dirname(path)
    jobs = [
        {
            "layers": [*layers[:-1], f"{layers[-1]}::opacity={1 - n / (2 * count)}"],
            "output": f"{folder}/out{n}.png",
        }
        for n in range(count)
    ]
    Path(path).write_text(json.dumps(jobs))


def seconds(commands: Sequence[Sequence[str]]) -> float:
    """How long commands take one after another."""
    begin = time.perf_counter()
    for command in commands:
        subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - begin


def compared(runs: int, ways: dict[str, Callable[[], float]]) -> dict[str, list[float]]:
    """The times of each way, which take turns."""
    taken: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(runs):
        for way, run in ways.items():
            taken[way].append(run())
    for way, times in taken.items():
        print(f"  {way:36}{statistics.median(times):9.3f} s")
    return taken


def show(figure: str, over: Sequence[float], under: Sequence[float], limit: str) -> None:
    ratio = statistics.median(a / b for a, b in zip(over, under, strict=True))
    print(f"  {figure:52}{ratio:9.3f}   {limit}")


def many_small(runs: int, pictures: Path) -> None:
    layers = drawn(SMALL, pictures)[: SMALL.layers]
    with tempfile.TemporaryDirectory() as folder:
        jobs = f"{folder}/jobs.json"
        put_jobs(jobs, layers, MANY)
        tasks = [Task(layers, f"{folder}/out{n}.png", "", 2) for n in range(MANY)]
        alone = [[HPCOMP, "stack", *layers, "-o", task.output] for task in tasks]
        peers = [oiiotool(task) for task in tasks]
        print(f"\n{MANY} stacks of {SMALL.title()}, load {os.getloadavg()[0]:.1f}", flush=True)
        taken = compared(
            runs,
            {
                "batch": lambda: seconds([[HPCOMP, "batch", jobs, "-q"]]),
                f"{MANY} hpcomp stack": lambda: seconds(alone),
                f"{MANY} oiiotool": lambda: seconds(peers),
            },
        )
    batch, ours, theirs = taken.values()
    show("batch / processes of hpcomp stack", batch, ours, "at most 0.10")
    show("batch / oiiotool", batch, theirs, "at most 0.5")


def on_dask(runs: int, pictures: Path) -> None:
    """The rate of a cluster on this machine, beside that of as many processes."""
    if importlib.util.find_spec("distributed") is None:
        print("\nDask: skipped, distributed is not installed")
        return
    layers = drawn(TINY, pictures)[: TINY.layers]
    with tempfile.TemporaryDirectory() as folder:
        jobs = f"{folder}/jobs.json"
        put_jobs(jobs, layers, THOUSANDS)
        command = [HPCOMP, "batch", jobs, "-q"]
        print(f"\n{THOUSANDS} stacks of {TINY.title()}, load {os.getloadavg()[0]:.1f}", flush=True)
        processes, cluster = compared(
            runs,
            {
                "-j 2": lambda: seconds([[*command, "-j", "2"]]),
                "--dask local:2": lambda: seconds([[*command, "--dask", "local:2"]]),
            },
        ).values()
    show("rate on Dask / rate at -j 2", processes, cluster, "at least 0.6")


def two_cores(runs: int, pictures: Path) -> None:
    layers = drawn(LARGE, pictures)
    with tempfile.TemporaryDirectory() as folder:
        jobs = f"{folder}/jobs.json"
        put_jobs(jobs, layers, FEW)
        command = [HPCOMP, "batch", jobs, "-q", "-j"]
        print(f"\n{FEW} stacks of {LARGE.title()}, load {os.getloadavg()[0]:.1f}", flush=True)
        one, two = compared(
            runs, {f"-j {n}": lambda n=n: seconds([[*command, str(n)]]) for n in (1, 2)}
        ).values()
    show("rate at -j 2 / rate at -j 1", one, two, "at least 1.7")


def interrupted(pictures: Path) -> None:
    layers = drawn(LARGE, pictures)
    with tempfile.TemporaryDirectory() as folder:
        jobs = f"{folder}/jobs.json"
        put_jobs(jobs, layers, FEW)
        times = []
        for moment in range(INTERRUPTIONS):
            process = subprocess.Popen([HPCOMP, "batch", jobs, "-q"], stderr=subprocess.DEVNULL)
            time.sleep(0.3 + 0.1 * moment)
            begin = time.perf_counter()
            process.send_signal(signal.SIGINT)
            process.wait()
            times.append(time.perf_counter() - begin)
            left = [name for name in os.listdir(folder) if name.startswith(".hpcomp.")]
            assert not left, left
    print(f"\nCtrl-C at {INTERRUPTIONS} moments of the same batch")
    print(f"  {'the slowest end, s':52}{max(times):9.3f}   at most 1")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--pictures", type=Path, default=ROOT / "build/bench")
    options = parser.parse_args()
    many_small(options.runs, options.pictures)
    on_dask(options.runs, options.pictures)
    two_cores(options.runs, options.pictures)
    interrupted(options.pictures)


if __name__ == "__main__":
    main()
