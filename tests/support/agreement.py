"""Both engines find the same of a stack, each number as exactly as it must."""

from __future__ import annotations

import dataclasses

import numpy as np

from hpcomp.engine import reference
from hpcomp.kernel import fused as kernel
from hpcomp.measures import labels as measures
from hpcomp.measures.defaults import CELL
from hpcomp.measures.histogram import HueHistogram
from hpcomp.measures.squares import Squares
from hpcomp.measures.summary import StripToMeasure

ENGINES = {"kernel": kernel.ENGINE, "reference": reference.ENGINE}
# Rounding decides which side of a bin's edge or of a threshold a pixel is on: so many may differ.
TIES = 2
# Sums of float32 values, each rounded to a unit of the sum; the shoulder enlarges some roundings.
SUMS = 2e-5
# And so many units in the nine pixels of a square, where channels are small beside others.
SQUARE_SUMS = 200
# Of provenance: a difference of nearly equal lengths keeps fewer digits than either.
PLANES = 1e-4


def both(rules, strips, width, height, *, bins=360, **settings):
    """Findings, provenance and squares by the kernel, then by the reference."""
    chosen = measures.measure_settings(rules, **settings)
    with np.errstate(all="ignore"):
        for by in ENGINES.values():
            squares = Squares(3, 1, width, height)
            strip = StripToMeasure(
                rules, chosen, bins, strips, width, height, with_provenance=True, squares=squares
            )
            yield *by.summary(strip), squares.sums


def numbers(found):
    """(name, value) of each number and array of findings but for the histograms of layers."""
    for name, value in vars(found).items():
        if dataclasses.is_dataclass(value):
            yield from ((f"{name}.{inner}", number) for inner, number in numbers(value))
        elif name == "layers" and isinstance(value[0], HueHistogram):
            continue
        elif isinstance(value, tuple):
            for index, item in enumerate(value):
                if dataclasses.is_dataclass(item):
                    yield from ((f"{name}[{index}].{i}", number) for i, number in numbers(item))
                else:
                    yield f"{name}[{index}]", item
        elif value is not None and not isinstance(value, (str, float)):
            yield name, value


COUNTS = {"count", "grey", "transparent", "nonfinite", "chromatic", "foreign", "pixels",
          "survived", "visible", "unmeasured", "order_sensitive"}  # fmt: skip


def assert_agree(rules, strips, width, height, **settings):
    """Both engines find the same, each as exactly as it must; the kernel's findings."""
    (ours, our_planes, our_sums), (theirs, their_planes, their_sums) = both(
        rules, strips, width, height, **settings
    )
    assert ours.measures.settings == theirs.measures.settings
    assert ours.layers == theirs.layers
    compared = set()
    for (name, mine), (_, other) in zip(numbers(ours), numbers(theirs), strict=True):
        mine, other = np.asarray(mine), np.asarray(other)
        assert (mine.dtype, mine.shape) == (other.dtype, other.shape) == (np.int64, mine.shape)
        error = abs(mine - other)
        last = name.rpartition(".")[2]
        compared.add(last)
        if last == "visible":
            # One pixel decides what all those of its cell count as.
            assert error.sum() <= 2 * TIES * CELL**2, name
        elif last in COUNTS:
            # One that changes sides is missing here and too many there.
            assert error.sum() <= 2 * TIES, name
        else:
            allowed = SUMS * abs(other) + width * height
            beyond = (error > allowed).reshape(*mine.shape[:1], -1).any(axis=-1)
            assert np.count_nonzero(beyond) <= 2 * TIES * (mine.ndim > 0), name
    assert compared >= COUNTS | {"chroma", "alpha", "rgb", "kept", "foreign_chroma", "light[2]"}
    same = our_planes.layer == their_planes.layer
    assert np.count_nonzero(~same) <= TIES
    for name in ("grey", "margin"):
        mine, other = getattr(our_planes, name), getattr(their_planes, name)
        assert (mine.dtype, mine.shape) == (np.float32, (height, width))
        # Where nothing has a hue that a float32 can hold, both are 0 or both are not told apart.
        assert np.allclose(mine[same], other[same], rtol=PLANES, atol=PLANES, equal_nan=True), name
    assert set(our_sums) == set(their_sums) == {*range(len(strips)), "result", "traditional"}
    for picture, mine in our_sums.items():
        other = their_sums[picture]
        assert (mine.dtype, mine.shape) == (other.dtype, other.shape) == (np.int64, mine.shape)
        if isinstance(picture, int):
            assert np.array_equal(mine, other), picture
        else:
            # What nearly cancels keeps fewer digits, and whose hue is kept a tie may decide.
            beyond = (abs(mine - other) > SUMS * abs(other) + SQUARE_SUMS).any(axis=-1)
            assert np.count_nonzero(beyond) <= 2 * TIES, picture
    return ours
