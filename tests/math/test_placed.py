"""A layer that is small or absent changes what one changes that is transparent around its pixels."""

import numpy as np
import pytest
from engines import layers_of_labels, run
from strategies import BLENDING_NAMES, ORDER_NAMES, SPACE_NAMES

from hpcomp.blending.porter_duff import OPERATORS
from hpcomp.color.primaries import REC709
from hpcomp.color.quantization import Losses
from hpcomp.color.samples import NOTHING, Strip, spread
from hpcomp.engine import reference
from hpcomp.geometry import Window
from hpcomp.kernel import fused as kernel
from hpcomp.measures.labels import measure_settings
from hpcomp.measures.summary import StripToMeasure
from hpcomp.options import stack_rules
from hpcomp.pipeline.strips import _grouped

ENGINES = {"kernel": kernel, "reference": reference}
WIDTH, HEIGHT = 300, 7
# Left and top, columns and rows: all, some of a block, over edges and blocks, whole rows, one pixel, none.
PLACES = [
    (0, 0, 300, 7), (0, 0, 40, 3), (-9, -2, 30, 6), (250, 3, 90, 9), (100, 1, 60, 4), (0, 2, 300, 2),
    (127, 0, 2, 7), (299, 6, 1, 1), (60, 2, 200, 4), (-50, 0, 40, 7), (0, 9, 300, 4),
]  # fmt: skip
ORDERS = (*ORDER_NAMES, tuple(np.random.default_rng(5).permutation(len(PLACES)).tolist()))


def placed_layers(bottom=PLACES[0]):
    """Layers where they are placed, `NOTHING` where they are not; and filled up with nothing."""
    strips, whole = [], []
    for number, (left, top, columns, rows) in enumerate([bottom, *PLACES[1:]]):
        pixels = layers_of_labels(1, rows, columns, seed=number + 3)[0]
        strip = Strip(pixels, left=left, top=top)
        common = Window(left, top, columns, rows).intersection(Window(0, 0, WIDTH, HEIGHT))
        strips.append(strip if common else NOTHING)
        filled = np.zeros((HEIGHT, WIDTH, 4), np.float32)
        if common:
            inside = pixels[common.y - top : common.bottom - top, common.x - left : common.right - left]
            filled = spread(inside, common.x, common.y, WIDTH, HEIGHT).reshape(HEIGHT, WIDTH, 4)
        whole.append(Strip(filled))
    return strips, whole


def assert_same(by, rules, strips, whole, **how):
    placed = run(by, rules, strips, WIDTH, HEIGHT, **how)
    filled = run(by, rules, whole, WIDTH, HEIGHT, **how)
    np.testing.assert_array_equal(placed.samples, filled.samples)  # 0 and -0 are one
    assert (placed.losses, placed.nonfinite) == (filled.losses, filled.nonfinite)
    assert np.any(placed.samples)


@pytest.mark.pairwise
@pytest.mark.parametrize("background", [None, (0.2, 0.05, 0.4)], ids=["none", "colour"])
@pytest.mark.parametrize("space", SPACE_NAMES)
@pytest.mark.parametrize("order", ORDERS, ids=str)
@pytest.mark.parametrize("blending", [*BLENDING_NAMES, "woven"])
@pytest.mark.parametrize("engine", ENGINES)
def test_of_all_blendings_and_orders(engine, blending, order, space, background):
    rules = stack_rules(
        len(PLACES), blending=blending, order=order, space=space, background=background
    )
    assert_same(ENGINES[engine], rules, *placed_layers(), at_once=len(PLACES))


@pytest.mark.pairwise
@pytest.mark.parametrize("at_once", [1, 3, len(PLACES)])
@pytest.mark.parametrize("strength", ["chroma", "coverage"])
@pytest.mark.parametrize("order", ["bottom-up", "top-down", "balanced", "simultaneous"])
@pytest.mark.parametrize("op", OPERATORS)
@pytest.mark.parametrize("engine", ENGINES)
def test_of_all_operators(engine, op, order, strength, at_once):
    # Absent ones that erase what lies outside leave nothing to look at.
    last = [op] * 2 if OPERATORS[op].keeps_outside else ["over"] * 2
    ops = [None, *["over"] * 3, op, op, op, op, "over", *last]
    rules = stack_rules(len(ops), op=ops, order=order, strength=strength)
    assert_same(ENGINES[engine], rules, *placed_layers(), at_once=at_once)


@pytest.mark.parametrize("bottom", [PLACES[1], PLACES[9]], ids=["small", "absent"])
@pytest.mark.parametrize("order", ORDERS, ids=str)
@pytest.mark.parametrize("engine", ENGINES)
def test_of_a_bottom_that_does_not_fill_the_strip(engine, order, bottom):
    ops = [None, *["over", "atop", "plus", "xor", "dst-over"] * 2]
    rules = stack_rules(len(ops), op=ops, order=order)
    assert_same(ENGINES[engine], rules, *placed_layers(bottom), at_once=len(ops))


@pytest.mark.parametrize("background", [None, (0.2, 0.05, 0.4)], ids=["none", "colour"])
@pytest.mark.parametrize("order", ORDERS, ids=str)
@pytest.mark.parametrize("engine", ENGINES)
def test_of_measures(engine, order, background):
    rules = stack_rules(len(PLACES), order=order, background=background)
    settings = measure_settings(rules)

    def found(strips):
        strip = StripToMeasure(rules, settings, 90, strips, WIDTH, HEIGHT, True)
        alone = ENGINES[engine].ENGINE.summary(strip)
        accumulator = ENGINES[engine].ENGINE.start(rules, WIDTH, HEIGHT)
        numbers = list(rules.arrival)
        accumulator.add(numbers, [strips[number] for number in numbers])
        _, *together = accumulator.result_and_summary("float", Losses(), REC709, strip)
        return alone, tuple(together)

    placed, filled = (found(strips) for strips in placed_layers())
    for (summary, planes), (other, other_planes) in zip(placed, filled, strict=True):
        assert summary == other
        for name, plane in vars(planes).items():
            np.testing.assert_array_equal(plane, getattr(other_planes, name), err_msg=name)
    assert placed[0][0] == placed[1][0]
    assert placed[0][0].layers[9].transparent == WIDTH * HEIGHT


def test_groups_hold_so_many_that_are_there():
    assert [list(group) for group in _grouped(range(6), {1, 2, 5}, 2)] == [[0, 1, 2, 3, 4], [5]]
    assert [list(group) for group in _grouped(range(3), set(), 2)] == [[0, 1, 2]]
    assert [list(group) for group in _grouped(range(3)[::-1], {0, 1, 2}, 1)] == [[2], [1], [0]]
