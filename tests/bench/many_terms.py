"""How long the order `simultaneous` takes for a pixel of so many terms, beside `balanced`; prints µs.

    python tests/bench/many_terms.py [TERMS...]

Hues: of four labels, anywhere, and within a band of 11°, in which every term meets every other.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from hpcomp.blending.rules import StackRules
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import Strip
from hpcomp.kernel import fused as kernel
from hpcomp.options import stack_rules

TERMS = (16, 32, 33, 64, 128, 512, 2048, 5000)
RUNS = 5
LABELS = np.array([[1, 0, 0], [0, 0.2, 1], [1, 0.8, 0], [0, 0.7, 0.2]])
BAND = np.array([[1, 0.1, 0], [1, 0.3, 0]])

Random = np.random.Generator
HUES: dict[str, Callable[[Random, int, int], np.ndarray]] = {
    "labels": lambda rng, n, pixels: LABELS[rng.integers(0, 4, (n, pixels))],
    "anywhere": lambda rng, n, pixels: rng.random((n, pixels, 3)),
    "a band": lambda rng, n, pixels: rng.dirichlet((1, 1), (n, pixels)) @ BAND,
}


def layers(kind: str, n: int, pixels: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    colors = HUES[kind](rng, n, pixels) * rng.random((n, pixels, 1))
    alpha = rng.random((n, pixels, 1)) * 0.1
    return np.concatenate([colors * alpha, alpha], axis=-1)[:, None].astype(np.float32)


def seconds(rules: StackRules, stack: np.ndarray) -> float:
    accumulator = kernel.ENGINE.start(rules, stack.shape[2], 1)
    strips = [Strip(layer) for layer in stack]
    begin = time.perf_counter()
    accumulator.add(rules.arrival, [strips[number] for number in rules.arrival])
    accumulator.result("float", Losses())
    return time.perf_counter() - begin


def main() -> None:
    print(f"{'hues':10}{'terms':>6}{'simultaneous':>14}{'balanced':>10}")
    for kind in HUES:
        for n in map(int, sys.argv[1:] or TERMS):
            pixels = 512 if n < 200 else 16 if n < 1000 else 1
            stack = layers(kind, n, pixels)
            rules = [stack_rules(n, op="plus", order=o) for o in ("simultaneous", "balanced")]
            runs = 1 if kind == "a band" and n > 1000 else RUNS
            times = [[seconds(row, stack) for row in rules] for _ in range(runs)]
            median = [
                statistics.median(column) / pixels * 1e6 for column in zip(*times, strict=True)
            ]
            print(f"{kind:10}{n:6}{median[0]:14.1f}{median[1]:10.1f}")


if __name__ == "__main__":
    main()
