"""Measures hpcomp beside other compositors and the codecs alone; prints tables and writes JSON.

    python bench.py [--only WORK]... [--runs N] [--threads N] [--json PATH] [--pictures DIRECTORY]

Every run is a process of its own. The tools of a work take turns, so that a disturbance meets all
of them, and the medians count. No time is asserted: figures are for people to read.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import sysconfig
import tempfile
import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

#: From nothing to a composited strip of arrays.
FIRST_STRIP = (
    "import numpy, hpcomp\nhpcomp.composite([numpy.full((64, 512, 4), 0.5, numpy.float32)] * 2)"
)
HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
PYTHON = sys.executable
LIBRARIES = Path(sysconfig.get_path("platlib"))
HPCOMP = str(Path(sysconfig.get_path("scripts")) / "hpcomp")
CODEC_FLOOR = str(HERE / "codec_floor.py")
HUES = "hue-preserving"
#: Files that a work draws; those with more layers use them again.
FILES = 4

# This file imports neither numpy nor images: the peak memory of a child counts from its parent's.


@dataclass(frozen=True)
class Work:
    """Layers of one size and format, and what composites them."""

    name: str
    layers: int
    width: int
    height: int
    format: str
    tools: tuple[str, ...]
    heavy: bool = False  # a few runs are enough

    def title(self) -> str:
        return f"{self.name}: {self.layers} {self.format.upper()} of {self.width}x{self.height}"


OURS, PEERS = ("hpcomp", "traditional", "top-down"), ("oiiotool", "magick", "vips")
ALL, GROWTH = ("hpcomp", "traditional", "floor", *PEERS), ("hpcomp", "floor")
WORKS = [
    Work("exr4k", 4, 3840, 2160, "exr", (*ALL, "page")),
    Work("png4k", 4, 3840, 2160, "png", ALL),
    Work("png1k", 3, 1024, 576, "png", ALL),
    Work("exr4k-16", 16, 3840, 2160, "exr", GROWTH),
    Work("exr4k-64", 64, 3840, 2160, "exr", GROWTH, heavy=True),
    Work("exr8k-64", 64, 7680, 4320, "exr", ("hpcomp", "top-down", "floor"), heavy=True),
]


@dataclass(frozen=True)
class Task:
    """One call of a tool: layers bottom first, the file to write, and what it may use."""

    layers: list[str]
    output: str
    raw: str
    threads: int


@dataclass(frozen=True)
class Usage:
    """What a process took: seconds, and bytes of its largest process."""

    wall: float
    cpu: float
    peak: int


# --- tools ----------------------------------------------------------------------------------------


def hpcomp(*options: str) -> Callable[[Task], list[str]]:
    return lambda task: [
        HPCOMP, "stack", *task.layers, "-o", task.output, "--threads", str(task.threads), *options
    ]  # fmt: skip


def oiiotool(task: Task) -> list[str]:
    """The program itself, not the script of the wheel that starts it."""
    program = LIBRARIES / "OpenImageIO" / "bin" / "oiiotool"
    bottom, *above = task.layers
    steps = [word for layer in above for word in (layer, "--swap", "--over")]
    form = ["-d", "half", "--compression", "zip"] if task.output.endswith(".exr") else []
    return [str(program), "--threads", str(task.threads), bottom, *steps, *form, "-o", task.output]


def magick(task: Task) -> list[str] | str:
    program = shutil.which("magick") or shutil.which("convert")
    if program is None:
        return "ImageMagick is not installed"
    form = ["-compress", "Zip"] if task.output.endswith(".exr") else []
    return [program, "-limit", "thread", str(task.threads), *task.layers, "-background", "none",
            "-flatten", *form, task.output]  # fmt: skip


def vips(task: Task) -> list[str] | str:
    program = shutil.which("vips")
    if program is None:
        return "libvips is not installed"
    if task.output.endswith(".exr"):
        return "libvips does not write EXR"
    over = " ".join(["2"] * (len(task.layers) - 1))
    return [program, "composite", " ".join(task.layers), task.output, over,
            f"--vips-concurrency={task.threads}"]  # fmt: skip


def codec_floor(task: Task) -> list[str]:
    return [PYTHON, CODEC_FLOOR, "run", str(task.threads), task.raw, task.output, *task.layers]


#: The command of each tool for a task, or why there is none.
COMMANDS: dict[str, Callable[[Task], list[str] | str]] = {
    "hpcomp": hpcomp(),
    "traditional": hpcomp("--blending", "traditional"),
    "top-down": hpcomp("--order", "top-down"),
    "page": lambda task: [*hpcomp()(task), "--report", f"{task.output}.html"],
    "floor": codec_floor,
    "oiiotool": oiiotool,
    "magick": magick,
    "vips": vips,
}
#: The rows of the tables; the codecs alone are timed by the codec floor itself.
TITLES = {
    "hpcomp": "hpcomp, hue-preserving",
    "traditional": "hpcomp, traditional",
    "top-down": "hpcomp, top-down",
    "page": "hpcomp, with a report page",
    "floor": "codec floor",
    "codecs": "codec floor, start-up apart",
    "oiiotool": "oiiotool",
    "magick": "ImageMagick",
    "vips": "libvips, encoded light",
}


# --- measuring ------------------------------------------------------------------------------------


def measured(command: list[str]) -> tuple[Usage, bytes]:
    """Runs a command to its end: what it took and what it printed; exits where it fails."""
    with tempfile.TemporaryFile() as printed, tempfile.TemporaryFile() as messages:
        begin = time.perf_counter()
        process = subprocess.Popen(command, stdout=printed, stderr=messages)
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0)
        messages.seek(0)
        if process.returncode:
            sys.exit(f"{' '.join(command)} failed: {messages.read().decode()}")
        unit = 1 if sys.platform == "darwin" else 1024
        usage = Usage(wall, used.ru_utime + used.ru_stime, used.ru_maxrss * unit)
        return usage, printed.read()


def median(runs: Sequence[Usage]) -> Usage:
    return Usage(*map(statistics.median, zip(*map(astuple, runs), strict=True)))


def drawn(work: Work, pictures: Path) -> list[str]:
    """The layer files, bottom first, drawn if they are not there."""
    drawing = HERE / "drawing.py"
    folder = pictures / f"{zlib.crc32(drawing.read_bytes()):08x}"
    files = [folder / f"{work.width}x{work.height}-{n}.{work.format}" for n in range(FILES)]
    if not all(file.exists() for file in files):
        print(f"drawing {FILES} {work.format} of {work.width}x{work.height}", file=sys.stderr)
        folder.mkdir(parents=True, exist_ok=True)
        size = [str(work.width), str(work.height)]
        subprocess.run([PYTHON, drawing, *size, *files], check=True)
    return [str(files[n % FILES]) for n in range(work.layers)]


def run_work(
    work: Work, runs: int, threads: int, pictures: Path
) -> tuple[dict[str, Usage], dict[str, int]]:
    """The medians of each tool that there is, and the bytes of its file.

    Of the codec floor also the median without its start-up.
    """
    layers = drawn(work, pictures)
    load = os.getloadavg()[0]
    print(f"\n{work.title()}, {threads} threads, {runs} runs, load {load:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        raw = f"{folder}/result.npy"
        tasks = {
            tool: Task(layers, f"{folder}/{tool}.{work.format}", raw, threads)
            for tool in work.tools
        }
        commands = {tool: COMMANDS[tool](task) for tool, task in tasks.items()}
        for tool, command in commands.items():
            if isinstance(command, str):
                print(f"  {TITLES[tool]}: skipped, {command}")
        ready = {tool: c for tool, c in commands.items() if not isinstance(c, str)}
        measured(ready["hpcomp"])  # the codec floor encodes what it makes
        measured([PYTHON, CODEC_FLOOR, "samples", tasks["hpcomp"].output, raw])
        taken: dict[str, list[Usage]] = defaultdict(list)
        for _ in range(runs):
            for tool, command in ready.items():
                usage, printed = measured(command)
                taken[tool].append(usage)
                if tool == "floor":
                    taken["codecs"].append(replace(usage, wall=float(printed)))
        found = {tool: median(usages) for tool, usages in taken.items()}
        sizes = {tool: os.path.getsize(tasks[tool].output) for tool in ready}
        print_work(found, sizes)
    return found, sizes


def print_work(found: Mapping[str, Usage], sizes: Mapping[str, int]) -> None:
    print(f"  {'':28}{'wall s':>9}{'CPU s':>9}{'peak MB':>9}{'x floor':>9}{'file MB':>9}")
    for tool, used in found.items():
        print(
            f"  {TITLES[tool]:28}{used.wall:9.3f}{used.cpu:9.3f}{used.peak / 1e6:9.0f}"
            f"{used.wall / found['floor'].wall:9.2f}"
            + (f"{sizes[tool] / 1e6:9.2f}" if tool in sizes else "")
        )


def run_kernel(runs: int, threads: int) -> list[dict[str, Any]]:
    """What `kernel_alone.py` prints; empty where the kernel was not built."""
    if not list((LIBRARIES / "hpcomp" / "kernel").glob("_kernel.*")):
        print("\nkernel: skipped, it was not built")
        return []
    command = [PYTHON, str(HERE / "kernel_alone.py"), str(threads), str(runs)]
    cases: list[dict[str, Any]] = json.loads(measured(command)[1])
    print(f"\nkernel: float layers of 3840x2160 in memory, {runs} runs; ns per pixel and blend")
    row = "  {layers:<8}{blending:16}{order:14}{level:10}{threads:<9}{space:12}{strength:10}"
    print(row.format(**{name: name for name in cases[0]}) + f"{'wall':>7}{'CPU':>7}")
    for case in cases:
        print(row.format(**case) + f"{case['wall']:7.2f}{case['cpu']:7.2f}")
    return cases


def run_starts(runs: int, pictures: Path) -> dict[str, Usage]:
    """The medians of runs that are over soon, beside the least that there is of their kind."""
    layers = drawn(Work("png512", 2, 512, 512, "png", ()), pictures)
    with tempfile.TemporaryDirectory() as folder:
        stack = [HPCOMP, "stack", *layers, "-o", f"{folder}/out.png"]
        commands = {
            "python": [PYTHON, "-c", "pass"],
            "help": [HPCOMP, "--help"],
            "numpy": [PYTHON, "-c", "import numpy"],
            "first strip": [PYTHON, "-c", FIRST_STRIP],
            "stack": stack,
            "acescg": [*stack, "--primaries", "acescg"],
        }
        taken: dict[str, list[Usage]] = defaultdict(list)
        for _ in range(4 * runs):
            for name, command in commands.items():
                taken[name].append(measured(command)[0])
    found = {name: median(usages) for name, usages in taken.items()}
    print(f"\nstart: 2 PNG of 512x512 and less, {4 * runs} runs, load {os.getloadavg()[0]:.1f}")
    for name, used in found.items():
        print(f"  {name:28}{used.wall:9.3f}{used.cpu:9.3f}{used.peak / 1e6:9.0f}")
    return found


# --- figures --------------------------------------------------------------------------------------


class Results:
    """What was measured; a `KeyError` for what was not."""

    def __init__(self) -> None:
        self.works: dict[str, dict[str, Usage]] = {}
        self.kernel: list[dict[str, Any]] = []
        self.sizes: dict[str, dict[str, int]] = {}
        self.starts: dict[str, Usage] = {}

    def wall(self, work: str, over: str) -> float:
        """The time of hpcomp, hue-preserving, over that of another tool."""
        return self.works[work]["hpcomp"].wall / self.works[work][over].wall

    def size(self, work: str, over: str) -> float:
        """The bytes of the file of hpcomp over those of another tool's."""
        return self.sizes[work]["hpcomp"] / self.sizes[work][over]

    def page(self, work: str) -> float:
        return self.works[work]["page"].wall / self.works[work]["hpcomp"].wall

    def later(self, start: str, than: str) -> float:
        """The milliseconds that one start takes more than another."""
        return (self.starts[start].wall - self.starts[than].wall) * 1e3

    def peak(self, *works: str) -> float:
        """The most megabytes that hpcomp took in any of these works."""
        measured = [self.works[work] for work in works]
        return max(tools[tool].peak for tools in measured for tool in OURS if tool in tools) / 1e6

    def growth(self) -> float:
        return self.works["exr4k-64"]["hpcomp"].wall / self.works["exr4k"]["hpcomp"].wall

    def nanoseconds(
        self, layers: int, order: str, space: str = "linear-rgb", **other: str
    ) -> float:
        """Of the kernel at its best: the fastest level, all threads; hue-preserving, by chroma."""
        own = {"layers": layers, "blending": HUES, "order": order, "space": space}
        wanted = {**own, "strength": "chroma", **other}
        found = [case["wall"] for case in self.kernel if wanted.items() <= case.items()]
        if not found:
            raise KeyError("kernel")
        return found[-1]

    def in_linear_rgb(self, space: str) -> float:
        return self.nanoseconds(4, "bottom-up", space) / self.nanoseconds(4, "bottom-up")

    def of_strength(self, order: str, space: str) -> float:
        by_coverage = self.nanoseconds(4, order, space, strength="coverage")
        return by_coverage / self.nanoseconds(4, order, space)

    def woven(self, strength: str) -> float:
        woven = self.nanoseconds(8, "bottom-up", blending="woven", strength=strength)
        return woven / self.nanoseconds(8, "simultaneous")

    def to_json(self) -> dict[str, Any]:
        works = {w: {t: asdict(u) for t, u in tools.items()} for w, tools in self.works.items()}
        return {
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "works": works,
            "kernel": self.kernel,
            "sizes": self.sizes,
            "starts": {name: asdict(usage) for name, usage in self.starts.items()},
            "figures": [
                {"figure": name, "value": value, "at_most": limit}
                for name, limit, value in self.figures()
            ],
        }

    def figures(self) -> Iterator[tuple[str, float, float | None]]:
        for name, limit, value in FIGURES:
            try:
                yield name, limit, value(self)
            except KeyError:
                yield name, limit, None


FIGURES: list[tuple[str, float, Callable[[Results], float]]] = [
    ("4 EXR of 4K: time / codec floor", 1.10, lambda r: r.wall("exr4k", "codecs")),
    ("4 EXR of 4K: time / oiiotool", 0.45, lambda r: r.wall("exr4k", "oiiotool")),
    ("4 EXR of 4K: with a report page / without", 1.3, lambda r: r.page("exr4k")),
    ("4 PNG of 4K: time / oiiotool", 0.16, lambda r: r.wall("png4k", "oiiotool")),
    ("4 PNG of 4K: time / libvips", 0.6, lambda r: r.wall("png4k", "vips")),
    ("4 PNG of 4K: size of the file / oiiotool", 1, lambda r: r.size("png4k", "oiiotool")),
    ("3 PNG of 1024x576: time / oiiotool", 0.5, lambda r: r.wall("png1k", "oiiotool")),
    ("3 PNG of 1024x576: time / libvips", 2.2, lambda r: r.wall("png1k", "vips")),
    ("kernel, 4 layers: ns per pixel and blend", 2, lambda r: r.nanoseconds(4, "bottom-up")),
    ("hpcomp --help: ms more than python", 35, lambda r: r.later("help", "python")),
    ("to the first strip: ms more than numpy", 60, lambda r: r.later("first strip", "numpy")),
    ("--primaries acescg: ms more than without", 20, lambda r: r.later("acescg", "stack")),
    ("4 layers of 4K: peak MB", 200, lambda r: r.peak("exr4k", "png4k")),
    ("64 EXR of 8K, fold orders: peak MB", 350, lambda r: r.peak("exr8k-64")),
    ("64 layers: time / 4 layers", 17, Results.growth),
    (
        "kernel, 8 layers: simultaneous / bottom-up",
        3,
        lambda r: r.nanoseconds(8, "simultaneous") / r.nanoseconds(8, "bottom-up"),
    ),
    *(
        (
            f"kernel, 4 layers: {space} / linear-rgb",
            3,
            partial(Results.in_linear_rgb, space=space),
        )
        for space in ("oklab", "cielab")
    ),
    *(
        (
            f"kernel, {space}, {order}: coverage / chroma",
            1.25,
            partial(Results.of_strength, order=order, space=space),
        )
        for space in ("linear-rgb", "oklab")
        for order in ("bottom-up", "simultaneous")
    ),
    *(
        (
            f"kernel, 8 layers: woven by {strength} / simultaneous",
            1.5,
            partial(Results.woven, strength=strength),
        )
        for strength in ("chroma", "coverage")
    ),
]


def print_figures(results: Results) -> None:
    print(f"\n{'figure':56}{'measured':>10}{'at most':>10}  reached")
    for name, limit, value in results.figures():
        if value is None:
            print(f"{name:56}{'-':>10}{limit:10.4g}  not measured")
        else:
            print(f"{name:56}{value:10.3g}{limit:10.4g}  {'yes' if value <= limit else 'no'}")


def main() -> None:
    names = [*(work.name for work in WORKS), "kernel", "start"]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", action="append", choices=names, help="this work, of: %(choices)s")
    parser.add_argument("--runs", type=int, default=5, help="runs of each tool, heavy works fewer")
    parser.add_argument("--threads", type=int, default=cores)
    parser.add_argument("--json", type=Path, default=ROOT / "build/bench.json")
    parser.add_argument("--pictures", type=Path, default=ROOT / "build/bench")
    options = parser.parse_args()
    wanted = options.only or names
    results = Results()
    for work in WORKS:
        if work.name in wanted:
            runs = -(-options.runs // 5) if work.heavy else options.runs
            measured_work = run_work(work, runs, options.threads, options.pictures)
            results.works[work.name], results.sizes[work.name] = measured_work
    if "kernel" in wanted:
        results.kernel = run_kernel(options.runs, options.threads)
    if "start" in wanted:
        results.starts = run_starts(options.runs, options.pictures)
    print_figures(results)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(results.to_json(), indent=1) + "\n")


if __name__ == "__main__":
    main()
