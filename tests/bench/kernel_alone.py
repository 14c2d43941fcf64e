"""Times the kernel on float layers in memory, without files; prints JSON.

python kernel_alone.py THREADS RUNS
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

from drawing import layer

from hpcomp.blending.rules import StackRules
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import Strip
from hpcomp.color.spaces import SPACES
from hpcomp.kernel import fused as kernel
from hpcomp.options import stack_rules

WIDTH, HEIGHT, STRIP_ROWS = 3840, 2160, 64


@dataclass(frozen=True)
class Case:
    """One way to composite the same layers."""

    layers: int
    blending: str
    order: str
    level: str
    threads: int
    space: str = "linear-rgb"
    strength: str = "chroma"


def cases(threads: int) -> list[Case]:
    levels = kernel.levels()
    fastest = levels[-1]
    bottom_up = [
        Case(4, blending, "bottom-up", level, n)
        for blending in ("hue-preserving", "traditional")
        for level in levels
        for n in sorted({1, threads})
    ]
    orders = ("bottom-up", "top-down", "balanced", "simultaneous")
    spaces = [
        Case(4, "hue-preserving", "bottom-up", fastest, threads, space)
        for space in SPACES
        if space != "linear-rgb"
    ]
    of_orders = [Case(8, "hue-preserving", order, fastest, threads) for order in orders]
    strengths = [
        Case(4, "hue-preserving", order, fastest, threads, space, "coverage")
        for space in ("linear-rgb", "oklab")
        for order in ("bottom-up", "simultaneous")
    ]
    woven = [
        Case(8, "woven", "bottom-up", fastest, threads, strength=name)
        for name in ("chroma", "coverage")
    ]
    oklab = Case(4, "hue-preserving", "simultaneous", fastest, threads, "oklab")
    return [*bottom_up, *spaces, *of_orders, *strengths, *woven, oklab]


def composite_strip(rules: StackRules, layers: list[Any], begin: int) -> None:
    strips = [Strip(pixels[begin : begin + STRIP_ROWS]) for pixels in layers]
    accumulator = kernel.ENGINE.start(rules, WIDTH, len(strips[0].samples))
    accumulator.add(rules.arrival, [strips[number] for number in rules.arrival])
    accumulator.result("float", Losses())


def seconds(case: Case, layers: list[Any]) -> tuple[float, float]:
    """Wall time, and CPU time of all threads."""
    os.environ[kernel.LEVEL_VARIABLE] = case.level
    rules = stack_rules(
        case.layers,
        blending=case.blending,
        order=case.order,
        space=case.space,
        strength=case.strength,
    )
    with ThreadPoolExecutor(case.threads) as pool:
        wall, cpu = time.perf_counter(), time.process_time()
        rows = range(0, HEIGHT, STRIP_ROWS)
        list(pool.map(lambda row: composite_strip(rules, layers[: case.layers], row), rows))
        return time.perf_counter() - wall, time.process_time() - cpu


def main() -> None:
    threads, runs = map(int, sys.argv[1:])
    layers = [layer(number, WIDTH, HEIGHT) for number in range(8)]
    todo = cases(threads)
    turns = [[seconds(case, layers) for case in todo] for _ in range(runs + 1)][1:]
    found = []
    for case, times in zip(todo, zip(*turns, strict=True), strict=True):
        nanosecond = WIDTH * HEIGHT * (case.layers - 1) / 1e9
        wall, cpu = (statistics.median(each) / nanosecond for each in zip(*times, strict=True))
        found.append({**asdict(case), "wall": wall, "cpu": cpu})
    print(json.dumps(found))


if __name__ == "__main__":
    main()
