"""Measures what layers cost that are small: a mosaic of many, and many small ones on a large one.

    python tests/bench/placed.py [RUNS]      (default: 5)

Small layers of 32 × 32 lie side by side with `at=`, 256 to 10,000 of them; and a hundred of 64 × 64 lie
on one of 4K. Runs are interleaved and medians are shown.
"""

from __future__ import annotations

import random
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from slices import COMMAND, measured

TILE, NUMBERS, FIGURE_S = 32, (256, 1024, 2304, 10_000), {2304: 2.0}
SMALL, SMALL_LAYERS, FIGURE_RATIO = 64, 100, 1.15
WIDTH, HEIGHT = 3840, 2160


def draw(folder: Path) -> None:
    """Writes tiles, small layers and a large one: noisy, each of one hue and one alpha."""
    import numpy as np

    import hpcomp

    rng = np.random.default_rng(1)

    def write(name: str, width: int, height: int) -> None:
        pixels = np.empty((height, width, 4), np.float32)
        pixels[..., 3] = alpha = rng.uniform(0.2, 1)
        pixels[..., :3] = alpha * (0.9 * rng.random(3) + 0.1 * rng.random((height, width, 3)))
        hpcomp.write_image(folder / f"{name}.png", pixels)

    for number in range(max(NUMBERS)):
        write(f"tile{number}", TILE, TILE)
    for number in range(SMALL_LAYERS):
        write(f"small{number}", SMALL, SMALL)
    write("canvas", WIDTH, HEIGHT)


def mosaic(folder: Path, number: int) -> list[str]:
    """The words of `stack` for so many tiles, side by side in a square."""
    side = 1
    while side * side < number:
        side += 1
    places = [f"{k % side * TILE}+{k // side * TILE}" for k in range(number)]
    tiles = [f"{folder}/tile{k}.png::at=+{place}" for k, place in enumerate(places)]
    return [*tiles, "--canvas", f"{side * TILE}x{side * TILE}+0+0"]


def main(runs: int) -> None:
    rng = random.Random(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # In a process of its own: the peak of a child begins with that of its parent.
        subprocess.run([sys.executable, __file__, "draw", name], check=True)
        canvas = f"{folder}/canvas.png"
        small = [
            f"{folder}/small{k}.png::at=+{rng.randrange(WIDTH - SMALL)}+{rng.randrange(HEIGHT - SMALL)}"
            for k in range(SMALL_LAYERS)
        ]
        works = {f"{number} tiles": mosaic(folder, number) for number in NUMBERS}
        works |= {"4K": [canvas], f"4K and {SMALL_LAYERS} small": [canvas, *small]}
        found: dict[str, list[tuple[float, float]]] = {work: [] for work in works}
        for _ in range(runs):
            for work, words in works.items():
                output = str(folder / "out.png")
                found[work].append(measured([str(COMMAND), "stack", *words, "-o", output]))
    middle = {
        work: [statistics.median(values) for values in zip(*measurements, strict=True)]
        for work, measurements in found.items()
    }
    print("| layers | s | MiB | figure |\n|---|---|---|---|")
    for work, (seconds, peak) in middle.items():
        figure = ""
        for number, limit in FIGURE_S.items():
            if work == f"{number} tiles":
                figure = f"at most {limit:g} s" + ("" if seconds <= limit else ": falls short")
        print(f"| {work} | {seconds:.2f} | {peak:.0f} | {figure} |")
    ratio = middle[f"4K and {SMALL_LAYERS} small"][0] / middle["4K"][0]
    short = "" if ratio <= FIGURE_RATIO else ": falls short"
    print(f"\n{SMALL_LAYERS} small layers on one of 4K: {ratio:.2f} times its own time, "
          f"at most {FIGURE_RATIO:g}{short}")  # fmt: skip


if __name__ == "__main__":
    if sys.argv[1:2] == ["draw"]:
        draw(Path(sys.argv[2]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
