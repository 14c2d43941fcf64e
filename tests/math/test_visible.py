"""The measure "visible": closed forms, a literal count of cells, parts, and both engines."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from agreement import ENGINES
from engines import broken, layers_of_labels, strips_of
from hypothesis import given
from hypothesis import strategies as st
from strategies import BLENDING_NAMES, color_of

import hpcomp
from hpcomp.geometry import Window
from hpcomp.measures import labels as measures
from hpcomp.measures.cells import cells_of, pixels_seen
from hpcomp.measures.defaults import CELL
from hpcomp.measures.summary import StripToMeasure
from hpcomp.options import stack_rules

ORIGINS = ((0, 0), (3, 5), (-7, -21), (16, 160), (1000, 15))


def plane(height, width, hue_deg, chroma, where=(slice(None), slice(None))):
    """A layer of one colour in a part of a picture, and nothing beside it."""
    layer = np.zeros((height, width, 4), np.float32)
    layer[where] = (*color_of(hue_deg, chroma, 0.3), 0.5)
    return layer


def measured(layers, origin=(0, 0), **settings):
    return hpcomp.stack_measures(layers, op=[None, *["plus"] * (len(layers) - 1)], origin=origin, **settings)


def found(name, layers, origin=(0, 0), rules=None):
    """The measures of a strip by an engine."""
    rules = stack_rules(len(layers)) if rules is None else rules
    height, width = layers[0].shape[:2]
    strip = StripToMeasure(
        rules, measures.measure_settings(rules), 90, strips_of(layers), width, height, origin=origin
    )
    with np.errstate(all="ignore"):
        return ENGINES[name].summary(strip)[0].measures


def literal(layers, origin, name="reference", **settings):
    """`visible` of each layer and the background in both results, from measures of single pixels."""
    rules = stack_rules(len(layers), **settings)
    cells = {}
    for y, x in itertools.product(*map(range, layers[0].shape[:2])):
        one = found(name, layers[:, y : y + 1, x : x + 1], (0, 0), rules)
        for which in ("result", "traditional"):
            result = getattr(one, which)
            for number, of in enumerate((*result.layers, result.background)):
                cell = which, number, (y + origin[1]) // CELL, (x + origin[0]) // CELL
                pixels, seen = cells.get(cell, (0, False))
                cells[cell] = pixels + of.pixels, seen or of.survived > 0
    total = {}
    for (which, number, *_), (pixels, seen) in cells.items():
        total[which, number] = total.get((which, number), 0) + pixels * seen
    return total


def visible(of):
    return {
        (which, number): contributor.visible
        for which in ("result", "traditional")
        for number, contributor in enumerate((*getattr(of, which).layers, getattr(of, which).background))
    }


def scattered(layers):
    """The bottom layer, and of the others a pixel here and there, so that cells differ."""
    rng = np.random.default_rng(5)
    layers[1:][rng.random(layers[1:].shape[:3]) > 0.02] = 0
    return layers


# ---- closed forms --------------------------------------------------------------------------------


def test_a_label_alone_is_visible_wherever_it_is():
    layer = plane(40, 50, 30, 0.1, (slice(3, 29), slice(10, 41)))
    for origin in ORIGINS:
        of = measured([layer], origin).result
        assert (of.layers[0].visible, of.layers[0].pixels) == (26 * 31, 26 * 31)
        assert of.layers[0].visible_share == of.visible_share == 1
        assert of.background.visible == 0


def one_gap():
    """A label that a stronger one hides wherever it lies, but for one pixel at (20, 5)."""
    strong = plane(64, 64, 0, 0.2)
    strong[5, 20] = 0
    return [strong, plane(64, 64, 120, 0.1, (slice(0, 64), slice(8, 40)))]


@pytest.mark.parametrize("name", ENGINES)
def test_one_pixel_shows_a_label_in_its_cell_and_in_no_other(name):
    rules = stack_rules(2, op="plus")
    # The cell of (20, 5): columns 16 to 31 and rows 0 to 15, all of the label.
    weak = found(name, one_gap(), (0, 0), rules).result.layers[1]
    assert (weak.pixels, weak.survived, weak.visible) == (64 * 32, 1, 256)
    # Cells moved by 9 to the left and 3 up: columns 7 to 22, of which the label has 15; 13 rows.
    weak = found(name, one_gap(), (9, 3), rules).result.layers[1]
    assert (weak.survived, weak.visible) == (1, 15 * 13)
    # Before the canvas' corner cells go on: column -1 is the last of its cell.
    weak = found(name, one_gap(), (-21, -64), rules).result.layers[1]
    assert (weak.survived, weak.visible) == (1, 13 * 16)
    strong = found(name, one_gap(), (0, 0), rules).result.layers[0]
    assert (strong.survived, strong.visible) == (64 * 64 - 1,) * 2


def test_visible_of_all_is_of_the_pixels_of_layers():
    of = measured(one_gap()).result
    assert of.visible_share == (64 * 64 - 1 + 256) / (64 * 64 - 1 + 64 * 32)
    nothing = measured([np.zeros((3, 3, 4))]).result
    assert nothing.visible_share == nothing.layers[0].visible_share == 0


def test_the_background_is_visible_and_not_among_the_layers():
    layer = plane(32, 32, 0, 0.2, (slice(0, 16), slice(0, 32)))
    layer[..., 3] *= 2
    below = color_of(120, 0.2, 0.4)
    of = hpcomp.stack_measures([layer], background=below).result
    # Opaque above, nothing below: half of the picture is each one's.
    assert (of.background.pixels, of.background.visible) == (512, 512)
    assert (of.layers[0].pixels, of.layers[0].visible) == (512, 512)
    assert of.visible_share == 1


def test_layers_of_one_hue_are_one_label():
    """Each alone is weaker than the other hue, together they are stronger: both are visible."""
    layers = [plane(16, 32, 0, 0.1), plane(16, 32, 0, 0.1), plane(16, 32, 120, 0.15)]
    of = measured(layers, order="simultaneous").result
    assert [layer.visible for layer in of.layers] == [512, 512, 0]
    alone = measured(layers[1:], order="simultaneous").result
    assert [layer.visible for layer in alone.layers] == [0, 512]


def test_what_cannot_be_measured_is_in_no_cell():
    layers = np.array(one_gap())
    layers[0, 5, 20] = np.nan  # where the label showed
    for name in ENGINES:
        of = found(name, layers, (0, 0), stack_rules(2, op="plus"))
        assert of.unmeasured == 1
        assert of.result.layers[1].visible == 0


# ---- a literal count -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("blending", BLENDING_NAMES)
@pytest.mark.parametrize("origin", [(0, 0), (-9, 21)])
def test_visible_is_what_is_counted_cell_by_cell(name, blending, origin):
    layers = scattered(layers_of_labels(3, 21, 37))
    settings = {"blending": blending, "background": (0.9, 0.1, 0.23), "op": "atop"}
    of = found(name, layers, origin, stack_rules(3, **settings))
    expected = literal(layers, origin, name, **settings)
    assert visible(of) == expected
    # What lies in front is seen nearly everywhere.
    assert of.result.visible_share < 1 or blending == "foremost"


@pytest.mark.parametrize("order", ["bottom-up", "top-down", "balanced", "simultaneous", "2,0,1"])
def test_both_engines_see_the_same(order):
    layers = broken(scattered(layers_of_labels(3, 50, 600)))
    rules = stack_rules(3, order=order, background=(0.9, 0.1, 0.23), opacity=[1, 0.5, 0.3])
    for origin in ORIGINS:
        ours, theirs = (found(name, layers, origin, rules) for name in ENGINES)
        # A pixel that rounding decides decides a cell.
        for which, pixels in visible(ours).items():
            assert abs(pixels - visible(theirs)[which]) <= 2 * CELL**2
        assert 0 < ours.result.visible_share < 1


# ---- parts ---------------------------------------------------------------------------------------


@given(
    st.integers(1, 60), st.integers(1, 60), st.sampled_from(ORIGINS), st.integers(0, 2**31), st.data()
)
def test_parts_that_begin_at_cells_add_up_exactly(height, width, origin, seed, data):
    layers = scattered(layers_of_labels(3, height, width, seed))
    place = Window(*origin, width, height)
    step = CELL * data.draw(st.integers(1, 3))
    rules = stack_rules(3, background=(0.9, 0.1, 0.23))
    for name in ENGINES:
        whole = found(name, layers, origin, rules)
        total = measures.StackMeasures.none(rules, whole.settings)
        for part in place.blocks(step * step, CELL):
            rows, columns = part.moved(-origin[0], -origin[1]).slices
            total += found(name, layers[:, rows, columns], (part.x, part.y), rules)
        assert total == whole


def test_a_cell_in_two_parts_is_two():
    upper, lower = np.split(np.array(one_gap()), [8], axis=1)
    of = measured(upper) + measured(lower, (0, 8))
    assert of.result.layers[1].visible == 16 * 8


@pytest.mark.parametrize("origin", ORIGINS)
def test_blocks_do_not_show(monkeypatch, origin):
    layers = scattered(layers_of_labels(3, 50, 70))
    whole = hpcomp.stack_measures(layers, origin=origin)
    for pixels in (1, 256, 700, 1 << 11):
        monkeypatch.setattr(measures, "BLOCK_PIXELS", pixels)
        assert hpcomp.stack_measures(layers, origin=origin) == whole


def test_pictures_side_by_side_do_not_share_cells():
    picture = np.array(one_gap())
    other = np.array(one_gap())
    other[0, 5, 20] = other[0, 0, 0]  # the label is nowhere to be seen
    both = np.stack([picture, other], axis=1)
    assert measured(both).result.layers[1].visible == 256
    assert measured(both) == measured(picture) + measured(other)


@given(
    st.integers(-40, 40), st.integers(-40, 40), st.integers(1, 90), st.integers(1, 90),
    st.integers(1, 5000), st.sampled_from([1, 2, CELL]),
)  # fmt: skip
def test_every_cell_is_in_one_block(x, y, width, height, pixels, cell):
    window = Window(x, y, width, height)
    owner = {}
    covered = 0
    for number, block in enumerate(window.blocks(pixels, cell)):
        assert window.contains(block)
        assert 0 < block.pixels <= max(pixels, cell**2)
        covered += block.pixels
        for row in range(block.y // cell, (block.bottom - 1) // cell + 1):
            for column in range(block.x // cell, (block.right - 1) // cell + 1):
                assert owner.setdefault((row, column), number) == number
    assert covered == window.pixels


def test_cells_are_numbered_row_by_row():
    assert cells_of(Window(15, 31, 3, 2)).tolist() == [0, 1, 1, 2, 3, 3]
    assert cells_of(Window(-1, -1, 2, 1)).tolist() == [0, 1]
    none = np.zeros(0, bool)
    assert pixels_seen(none, none, cells_of(Window(0, 0, 0, 0))) == 0
