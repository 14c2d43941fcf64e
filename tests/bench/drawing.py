"""Draws the layers that the benchmarks composite: a textured ground, and overlays with soft edges.

python drawing.py WIDTH HEIGHT FILE...      one layer a file, bottom first
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]

#: Linear, straight RGB of the ground and of the overlays above it.
COLORS = (
    (0.42, 0.40, 0.36), (0.85, 0.10, 0.08), (0.08, 0.20, 0.85), (0.20, 0.75, 0.10),
    (0.80, 0.65, 0.05), (0.45, 0.10, 0.70), (0.05, 0.60, 0.60), (0.90, 0.35, 0.05),
)  # fmt: skip
OPACITY = 0.6
SPOTS = 3


def layer(number: int, width: int, height: int) -> NDArray[np.float32]:
    """Linear, premultiplied RGBA (height, width, 4); the same for the same arguments."""
    rng = np.random.default_rng(number)
    alpha = np.ones((height, width), np.float32)
    if number:
        alpha = OPACITY * _spots(rng, width, height)
    shade = 0.7 + 0.25 * _noise(rng, width, height, 48) + 0.03 * _noise(rng, width, height, 3)
    shade *= alpha
    red, green, blue = COLORS[number % len(COLORS)]
    return np.stack([shade * red, shade * green, shade * blue, alpha], axis=2)


def _spots(rng: np.random.Generator, width: int, height: int) -> Plane:
    """Coverage in [0, 1] of a few discs whose edges are a tenth of their radius wide."""
    covered = np.zeros((height, width), np.float32)
    y, x = np.arange(height, dtype=np.float32)[:, None], np.arange(width, dtype=np.float32)
    for center_x, center_y, size in rng.random((SPOTS, 3)):
        radius = np.float32(height * (0.2 + 0.25 * size))
        distance = np.hypot(y - np.float32(center_y * height), x - np.float32(center_x * width))
        ramp = np.clip((radius - distance) * (10 / radius), 0, 1)
        np.maximum(covered, ramp * ramp * (3 - 2 * ramp), out=covered)
    return covered


def _noise(rng: np.random.Generator, width: int, height: int, cell: int) -> Plane:
    """Random values in [0, 1] every `cell` pixels, linear between them."""
    grid = rng.random((height // cell + 2, width // cell + 2), dtype=np.float32)
    rows, down = np.divmod(np.arange(height), cell)
    columns, along = np.divmod(np.arange(width), cell)
    coarse = _between(grid[rows], grid[rows + 1], np.float32(down[:, None] / cell))
    return _between(coarse[:, columns], coarse[:, columns + 1], np.float32(along / cell))


def _between(first: Plane, second: Plane, share: Plane) -> Plane:
    return first + share * (second - first)


def main() -> None:
    import hpcomp

    width, height = map(int, sys.argv[1:3])
    for number, path in enumerate(sys.argv[3:]):
        hpcomp.write_image(path, layer(number, width, height))


if __name__ == "__main__":
    main()
