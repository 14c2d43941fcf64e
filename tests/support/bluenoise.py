"""Makes the blue-noise threshold tile of woven blending: void and cluster, in integers, no hpcomp.

    python tests/support/bluenoise.py hpcomp/blending/bluenoise.npy

The tile is a permutation of 0 … SIZE² − 1 on a torus. Whatever the threshold, the pixels below it are
spread evenly: no two of them are nearer, and no gap is wider, than their number asks for.
Source: R. Ulichney, The void-and-cluster method for dither array generation, Proc. SPIE 1913, 1993.
"""

from __future__ import annotations

import math
import random
import sys

import numpy as np

SIZE = 128
SEED = 16
#: Ulichney's width of the filter, in pixels.
SIGMA = 1.5
#: Few pixels are too far from each other for that filter: where it sees no difference, this one decides.
SIGMA_OF_FEW = 12.0
#: The filters in fixed point. The sum of the wider one over the tile stays below 2³² and that of both
#: below 2⁶³, so that sums are exact and the first filter decides before the second.
UNIT = 1 << 20
FIRST = 1 << 32
#: The share of pixels of the pattern that the method begins with.
INITIAL = 0.1


def energy_table():
    """(2·SIZE, 2·SIZE) int64: what a pixel at (SIZE, SIZE) adds to each, twice around the torus.

    Rounding to 2⁻²⁰ leaves nothing of the last digits of an exponential, in which machines differ.
    """
    near = [min(step % SIZE, -step % SIZE) for step in range(2 * SIZE)]

    def filtered(squared):
        narrow, wide = (
            round(UNIT * math.exp(-squared / (2 * sigma**2))) for sigma in (SIGMA, SIGMA_OF_FEW)
        )
        return narrow * FIRST + wide

    return np.array([[filtered(x * x + y * y) for x in near] for y in near], np.int64)


class Pattern:
    """A set of pixels and, for every pixel, how crowded it is there."""

    def __init__(self, table, members=()):
        self.table = table
        self.inside = np.zeros((SIZE, SIZE), bool)
        self.energy = np.zeros((SIZE, SIZE), np.int64)
        for pixel in members:
            self.put(pixel)

    def copy(self):
        other = Pattern(self.table)
        other.inside, other.energy = self.inside.copy(), self.energy.copy()
        return other

    def around(self, pixel):
        y, x = pixel
        return self.table[SIZE - y : 2 * SIZE - y, SIZE - x : 2 * SIZE - x]

    def put(self, pixel):
        self.inside[pixel] = True
        self.energy += self.around(pixel)

    def take(self, pixel):
        self.inside[pixel] = False
        self.energy -= self.around(pixel)

    def tightest_cluster(self):
        """The member in the most crowded place; of equals the first, row by row."""
        return first_largest(np.where(self.inside, self.energy, -1))

    def largest_void(self):
        """The other pixel in the least crowded place; of equals the first, row by row."""
        return first_largest(np.where(self.inside, np.iinfo(np.int64).min, -self.energy))


def first_largest(values):
    return divmod(int(np.argmax(values)), SIZE)


def spread(pattern):
    """Moves pixels from the tightest cluster to the largest void until none is emptier."""
    while True:
        cluster = pattern.tightest_cluster()
        pattern.take(cluster)
        void = pattern.largest_void()
        if pattern.energy[void] >= pattern.energy[cluster]:
            pattern.put(cluster)
            return
        pattern.put(void)


def tile():
    """(SIZE, SIZE) uint16: the rank of each pixel, 0 for the one that is set first."""
    count = SIZE * SIZE
    generator = random.Random(SEED)
    shuffled = sorted((generator.random(), number) for number in range(count))
    initial = [divmod(number, SIZE) for _, number in shuffled[: round(INITIAL * count)]]
    pattern = Pattern(energy_table(), initial)
    spread(pattern)
    ranks = np.zeros((SIZE, SIZE), np.uint16)
    # Downwards from the initial pattern: the pixel in the tightest cluster has the highest rank.
    fewer = pattern.copy()
    for rank in reversed(range(len(initial))):
        pixel = fewer.tightest_cluster()
        fewer.take(pixel)
        ranks[pixel] = rank
    # And upwards. Beyond a half Ulichney looks for the tightest cluster of the pixels that are left:
    # that is the largest void of the others, as both fields of energy add to a constant, here exactly.
    for rank in range(len(initial), count):
        pixel = pattern.largest_void()
        pattern.put(pixel)
        ranks[pixel] = rank
    return ranks


if __name__ == "__main__":
    np.save(sys.argv[1], tile())
