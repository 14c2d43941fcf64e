"""Measures what a slice of a volume costs as their number grows: time and memory of `hpcomp stack`.

    python tests/bench/slices.py [SIZE]      (default: 512)

The slices are those of the tooth in samples/paper. Runs are interleaved and medians are shown.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

COMMAND = Path(sys.executable).with_name("hpcomp")
PAPER = Path(__file__).parents[2] / "samples" / "paper"
NUMBERS = (32, 64, 128, 256, 512)
RUNS = 5


def measured(arguments: list[str]) -> tuple[float, float]:
    """Seconds and peak MiB of a command that must succeed."""
    begin = time.perf_counter()
    child = os.posix_spawn(arguments[0], arguments, os.environ)
    _, status, usage = os.wait4(child, 0)
    if status:
        sys.exit(f"slices: {arguments[:2]} failed")
    return time.perf_counter() - begin, usage.ru_maxrss / 1024


def main(size: int) -> None:
    sys.path.insert(0, str(PAPER))
    from slices import write_slices

    with tempfile.TemporaryDirectory() as folder:
        write_slices("tooth", size, max(NUMBERS), Path(folder))
        back_first = sorted((str(p) for p in Path(folder).iterdir()), reverse=True)
        found: dict[int, list[tuple[float, float]]] = {number: [] for number in NUMBERS}
        for _ in range(RUNS):
            for number in NUMBERS:
                # Evenly spread, so that each number of them meets as much of the tooth.
                layers = back_first[:: max(NUMBERS) // number]
                words = ["stack", *layers, "--order", "top-down", "-o", f"{folder}/out.exr"]
                found[number].append(measured([str(COMMAND), *words]))
    least = statistics.median(seconds for seconds, _ in found[NUMBERS[0]])
    print("| slices | s | ms for each more | MiB |\n|---|---|---|---|")
    for number, runs in found.items():
        seconds, peak = (statistics.median(values) for values in zip(*runs, strict=True))
        more = number - NUMBERS[0]
        each = f"{1000 * (seconds - least) / more:.2f}" if more else ""
        print(f"| {number} | {seconds:.2f} | {each} | {peak:.0f} |")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 512)
