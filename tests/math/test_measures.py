"""What blending did to the labels of a stack: closed forms, laws, and a literal second opinion."""

import dataclasses
import math

import numpy as np
import oracle
import pytest
import strategies
from hypothesis import assume, given
from hypothesis import strategies as st

import hpcomp
from hpcomp.errors import MismatchError, SettingError
from hpcomp.measures import labels as measures
from hpcomp.measures.defaults import CELL
from hpcomp.measures.histogram import LARGEST_ADDEND, SUM_UNIT
from hpcomp.options import stack_rules
from hpcomp.report import measures as report

ORDERS = ("bottom-up", "top-down", "balanced", "simultaneous")

#: Float32 through a map and back, and the unit of the sums.
NEAR = 2e-6


def label(hue_deg, chroma, luminance=0.3, alpha=0.5):
    """A layer of one pixel with that hue, |p| and Y."""
    return np.array([[*strategies.color_of(hue_deg, chroma, luminance), alpha]])


def measured(layers, **settings):
    """The measures of layers whose terms are they themselves, whatever is below them."""
    return hpcomp.stack_measures(layers, op=[None, *["plus"] * (len(layers) - 1)], **settings)


def provenance(layers, op="plus", half_step=measures.HALF_STEP_FINE, **settings):
    rules = stack_rules(len(layers), op=[None, *[op] * (len(layers) - 1)], **settings)
    chosen = measures.measure_settings(rules, half_step=half_step)
    row = np.array(layers, np.float32)[:, None]
    planes = measures.measures_of(rules, chosen, row)[1]
    return measures.Provenance(planes.layer[0], planes.grey[0], planes.margin[0])


# ---- closed forms ------------------------------------------------------------------------------


def test_two_labels_of_different_hue():
    found = measured([label(0, 0.3), label(120, 0.1)])
    result, plain = found.result, found.traditional
    assert (found.pixels, found.unmeasured, found.order_sensitive) == (1, 0, 0)
    assert (result.chromatic, result.foreign) == (1, 0)
    # ⊕ leaves 0.3 − 0.1 of 0.3 + 0.1, all of it the first one's.
    assert result.lost == pytest.approx(0.5, abs=NEAR)
    assert [layer.lost for layer in result.layers] == pytest.approx([1 / 3, 1], abs=NEAR)
    assert [layer.survived for layer in result.layers] == [1, 0]
    assert [layer.pixels for layer in result.layers] == [1, 1]
    # + gives a vector between them, as long as √(0.3² + 0.1² − 0.3·0.1), and nobody's.
    length = math.sqrt(0.09 + 0.01 - 0.03)
    assert (plain.chromatic, plain.foreign) == (1, 1)
    assert plain.foreign_share == plain.foreign_chroma_share == 1
    assert plain.lost == pytest.approx(1 - length / 0.4, abs=NEAR)
    assert [layer.lost for layer in plain.layers] == pytest.approx([plain.lost] * 2, abs=NEAR)
    assert [layer.survived for layer in plain.layers] == [0, 0]


def test_equal_hues_lose_nothing():
    found = measured([label(40, 0.3), label(41, 0.1)])
    for result in (found.result, found.traditional):
        assert result.lost == pytest.approx(0, abs=1e-4)  # a degree apart
        assert [layer.survived for layer in result.layers] == [1, 1]
        assert result.foreign == 0


def test_chroma_that_others_add_to_a_near_hue_is_theirs():
    """Plain + near the stronger of two hues is longer than it: no layer keeps more than it had."""
    found = measured([label(0, 0.4), label(60, 0.01)])
    strong, weak = found.traditional.layers
    assert (found.traditional.foreign, strong.survived) == (0, 1)
    length = math.sqrt(0.4**2 + 0.01**2 + 0.4 * 0.01)
    assert strong.lost == 0
    assert weak.lost == pytest.approx(1 - (length - 0.4) / 0.01, abs=1e-3)


def test_foreign_tolerance_decides_how_far_a_hue_may_be():
    layers = [label(0, 0.2), label(60, 0.2)]  # + is 30° from both
    for tolerance, foreign in ((29.9, 1), (30.1, 0)):
        found = measured(layers, foreign_tolerance=tolerance)
        assert found.traditional.foreign == foreign
        assert found.result.foreign == 0


def test_foreign_tolerance_is_twice_the_hue_tolerance_and_never_below_rounding():
    for hue_tolerance, expected in ((2.0, 4.0), (10.0, 20.0), (0.0, math.degrees(1e-4))):
        rules = stack_rules(2, hue_tolerance=hue_tolerance)
        assert measures.measure_settings(rules).foreign_tolerance == pytest.approx(expected)


def test_faint_layers_of_one_hue_count_together():
    """None alone is above half a step, their sum is: the hue is theirs."""
    step = 0.01
    faint = [label(200, 0.6 * step) for _ in range(2)]
    found = measured(faint, half_step=step)
    assert (found.result.chromatic, found.result.foreign) == (1, 0)
    assert [layer.pixels for layer in found.result.layers] == [0, 0]
    alone = measured([label(200, 0.6 * step)], half_step=step)
    assert alone.result.chromatic == 0


def test_grey_pixels_have_neither_hue_nor_survivor():
    found = measured([label(0, 0.2), label(180, 0.2)])
    assert (found.result.chromatic, found.result.foreign) == (0, 0)
    assert found.result.lost == pytest.approx(1, abs=NEAR)
    assert [layer.survived for layer in found.result.layers] == [0, 0]
    assert found.result.foreign_share == found.order_sensitivity == 0


def test_what_counts_as_grey_is_a_setting():
    color = np.array([[0.5, 0.5, 0.45, 1.0]])  # saturation 0.1
    for achromatic, chromatic in ((0.09, 1), (0.11, 0), (0.0, 1)):
        assert hpcomp.stack_measures([color], achromatic=achromatic).result.chromatic == chromatic


def test_order_sensitivity_compares_bottom_up_with_top_down():
    layers = [label(0, 0.3), label(120, 0.2), label(240, 0.2)]
    # Bottom-up 0.3 − 0.2 meets 0.2 and loses; top-down 0.2 − 0.2 leaves all to the first.
    found = measured(layers, order="top-down")
    assert (found.order_sensitive, found.order_sensitivity) == (1, 1.0)
    assert found.result.layers[0].survived == 1
    assert measured(layers).order_sensitive == 1
    assert measured(layers[:2]).order_sensitive == 0
    assert measured(layers, blending="traditional").order_sensitive == 0
    assert measured(layers, blending="foremost").order_sensitive == 0


def test_a_stack_that_is_added_as_usual_measures_the_same_twice():
    found = measured([label(0, 0.3), label(100, 0.1)], blending="traditional")
    assert found.result == found.traditional


def test_the_foremost_keeps_its_chroma_and_all_others_lose_theirs():
    layers = [label(0, 0.3), label(120, 0.1), label(240, 0.2)]
    for order in ORDERS:
        found = measured(layers, blending="foremost", order=order)
        assert [layer.survived for layer in found.result.layers] == [0, 0, 1]
        assert [layer.lost for layer in found.result.layers] == pytest.approx([1, 1, 0], abs=NEAR)
        assert found.result.lost == pytest.approx(0.4 / 0.6, abs=NEAR)
        assert found.result.foreign == 0
        assert found.traditional == measured(layers).traditional
    ops = [None, "dst-over", "dst-atop"]
    behind = hpcomp.stack_measures(layers, blending="foremost", op=ops)
    assert [layer.survived for layer in behind.result.layers] == [1, 0, 0]


def test_a_bias_against_grey_loses_less():
    lost = [
        measured([label(0, 0.2), label(120, 0.1)], gray_bias=bias).result.lost
        for bias in (0, 1 / 3, 1)
    ]
    assert lost == pytest.approx([1 - 0.1 / 0.3, 1 - 0.15 / 0.3, 1 - 0.1875 / 0.3], abs=NEAR)


def test_the_background_contributes_and_has_no_number():
    layer = label(0, 0.1, alpha=0.25)
    background = strategies.color_of(120, 0.2, 0.4)
    found = hpcomp.stack_measures([layer], background=background)
    # 0.75 · 0.2 of the background against 0.1 of the layer.
    below = found.result.background
    assert (below.pixels, below.survived) == (1, 1)
    assert below.lost == pytest.approx(0.1 / 0.15, abs=NEAR)
    assert found.result.layers[0].lost == 1
    assert found.result.foreign == 0
    where = measures.measures_of(
        stack_rules(1, background=background),
        measures.measure_settings(stack_rules(1)),
        np.array([[layer]], np.float32),
    )[1]
    assert (where.layer[0, 0], where.margin[0, 0]) == (0, 0)
    assert where.grey[0, 0] == pytest.approx(1 - 0.05 / 0.25, abs=NEAR)


def test_exposure_is_left_out():
    layers = [label(0, 0.3), label(100, 0.1)]
    assert measured(layers, exposure=3.0) == measured(layers)


def test_energy_is_a_weighted_sum_of_light():
    color = np.array([[0.5, 0.25, -0.125, 1.0]] * 3)
    result = hpcomp.stack_measures([color]).result
    assert [SUM_UNIT * c for c in result.light] == pytest.approx([1.5, 0.75, 0], abs=1e-6)
    assert result.energy((1, 0, 0)) == pytest.approx(1.5, abs=1e-6)
    assert result.energy((0.5, 2, 9)) == pytest.approx(2.25, abs=1e-6)
    white = hpcomp.stack_measures([np.ones((7, 4))]).result
    assert white.energy() == pytest.approx(7, abs=1e-5)
    red, green, blue = measures.ENERGY_WEIGHTS
    assert green < red < blue
    assert red + green + blue == pytest.approx(1)


@pytest.mark.parametrize("weights", [(1, 2), (1, 2, 3, 4), (-1, 0, 0), (math.nan, 0, 0), (math.inf, 0, 0)])
def test_energy_weights_are_three_finite_numbers(weights):
    with pytest.raises(SettingError, match="energy weights"):
        hpcomp.stack_measures([np.ones((1, 4))]).result.energy(weights)


# ---- provenance ----------------------------------------------------------------------------------


def test_provenance_names_the_survivor_its_margin_and_what_is_cancelled():
    found = provenance([label(0, 0.1), label(120, 0.3), label(121, 0.2)])
    assert found.layer.dtype == np.uint32
    assert found.grey.dtype == found.margin.dtype == np.float32
    # 0.3 and 0.2 are of one hue: the larger has it, and 0.1 is the runner-up.
    assert found.layer.tolist() == [2]
    assert found.grey[0] == pytest.approx(1 - 0.4 / 0.6, abs=1e-4)
    assert found.margin[0] == pytest.approx(1 - 0.1 / 0.3, abs=NEAR)


def test_provenance_of_one_layer_and_of_none():
    alone = provenance([label(75, 0.2)])
    assert (alone.layer[0], alone.margin[0]) == (1, 1)
    assert alone.grey[0] == pytest.approx(0, abs=NEAR)
    for layers in ([np.zeros((1, 4))], [label(0, 0.2), label(180, 0.2)]):
        none = provenance(layers)
        assert (none.layer[0], none.margin[0]) == (0, 0)
    assert none.grey[0] == pytest.approx(1, abs=NEAR)


def test_a_survivor_that_was_not_the_strongest_has_a_margin_below_zero():
    found = provenance([label(0, 0.3), label(120, 0.2), label(240, 0.2)])
    assert found.layer.tolist() == [3]
    assert found.margin[0] == pytest.approx(1 - 0.3 / 0.2, abs=1e-5)


def test_the_lower_of_two_equal_layers_is_the_survivor():
    assert provenance([label(0, 0.1), label(50, 0.3), label(50, 0.3)]).layer.tolist() == [2]


def test_provenance_lies_where_its_pixels_do():
    red, green = label(0, 0.2)[0], label(120, 0.2)[0]
    pixels = np.array([red, np.full(4, np.nan), green, red])
    found = provenance([pixels, np.zeros_like(pixels)])
    assert found.layer.tolist() == [1, 0, 1, 1]
    assert found.margin.tolist() == [1, 0, 1, 1]


# ---- pixels that cannot be measured --------------------------------------------------------------


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf, 1e30])
def test_pixels_without_a_measure_are_counted_and_left_out(broken):
    layers = [np.repeat(label(0, 0.3), 3, axis=0), np.repeat(label(120, 0.1), 3, axis=0)]
    layers[1][1, 0] = broken
    found = measured(layers)
    assert (found.pixels, found.unmeasured) == (3, 1)
    twice = measured([layer[:1] for layer in layers])
    assert found.result == (twice + twice).result


def test_light_without_alpha_counts_and_bright_values_are_bounded():
    glow = np.array([[1e6, 0.0, 0.0, 0.0]])
    found = hpcomp.stack_measures([glow])
    assert found.result.layers[0].chroma == LARGEST_ADDEND / SUM_UNIT
    assert (found.result.chromatic, found.result.foreign, found.result.lost) == (1, 0, 0)


def test_no_pixels_and_nothing_in_them():
    empty = hpcomp.stack_measures([np.zeros((0, 4))] * 2)
    assert empty.pixels == 0
    assert empty.result.lost == empty.result.foreign_share == empty.result.energy() == 0
    clear = hpcomp.stack_measures([np.zeros((5, 4))] * 2)
    assert clear == dataclasses.replace(empty, pixels=5)


# ---- angles --------------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [0.0057, 4.0, 60.0, 90.0, 135.0, 180.0])
def test_angles_are_compared_without_an_arc(tolerance):
    near = 1e-4
    degrees = np.linspace(0, 359.7, 1200)
    turned = np.radians(degrees)
    p = np.array([np.cos(turned), np.sin(turned)], np.float32) * np.float32(0.37)
    angle = np.minimum(degrees, 360 - degrees)
    for start in (0.0, 77.0, 200.0):
        first = np.array([[math.cos(math.radians(start))], [math.sin(math.radians(start))]])
        turned = np.radians(degrees + start)
        p = np.array([np.cos(turned), np.sin(turned)], np.float32) * np.float32(0.37)
        holds = measures.Angle.of(tolerance).holds(first.astype(np.float32), p)
        clear = np.abs(angle - tolerance) > near
        assert np.array_equal(holds[clear], (angle < tolerance)[clear])
    nothing = np.zeros((2, 1), np.float32)
    assert measures.Angle.of(tolerance).holds(nothing, p).all()


def test_a_tolerance_can_differ_from_pixel_to_pixel():
    tolerances = np.array([5.0, 15.0, 180.0])
    p = np.array([[math.cos(math.radians(10))], [math.sin(math.radians(10))]], np.float32)
    first = np.array([[1.0], [0.0]], np.float32)
    holds = measures.Angle.of(tolerances).holds(first, np.repeat(p, 3, axis=1))
    assert holds.tolist() == [False, True, True]


# ---- laws ----------------------------------------------------------------------------------------


@st.composite
def pixel_stacks(draw, min_pixels=1, max_pixels=12):
    """Layers (n, pixels, 4) and the rules of a stack."""
    pixels = draw(st.integers(min_pixels, max_pixels))
    n = draw(st.integers(1, 5))
    seed = draw(st.integers(0, 2**31))
    random = np.random.default_rng(seed)
    alpha = random.choice([0.0, 0.3, 1.0, 1 / 255], (n, pixels, 1)) * random.random((n, pixels, 1))
    layers = np.concatenate([alpha * random.random((n, pixels, 3)), alpha], axis=2)
    rules = {
        "op": [None, *(draw(strategies.operators) for _ in range(n - 1))],
        "opacity": [draw(strategies.alphas) for _ in range(n)],
        "order": draw(st.one_of(strategies.orders, st.permutations(range(n)))),
        "blending": draw(st.sampled_from(strategies.BLENDING_NAMES)),
        "hue_tolerance": draw(strategies.hue_tolerances),
        "gray_bias": draw(st.sampled_from(strategies.GRAY_BIASES)),
        "background": draw(st.one_of(st.none(), st.tuples(*[st.floats(0, 1)] * 3))),
        "half_step": draw(st.sampled_from((measures.HALF_STEP_8_BIT, measures.HALF_STEP_FINE))),
    }
    return layers.astype(np.float32), rules


@given(pixel_stacks(min_pixels=2), st.data())
def test_parts_add_up_to_the_whole_exactly(stack, data):
    layers, rules = stack
    cut = CELL * data.draw(st.integers(0, layers.shape[1]))
    layers = np.repeat(layers, CELL, axis=1)
    whole = hpcomp.stack_measures(layers, **rules)
    below, above = (
        hpcomp.stack_measures(part, **rules) for part in (layers[:, :cut], layers[:, cut:])
    )
    assert below + above == above + below == whole


@pytest.mark.parametrize("shape", [(24, 4), (4, 6, 4), (2, 3, 4, 4), (2, 1, 12, 4)])
def test_leading_axes_are_further_pictures(shape):
    layers = np.random.default_rng(4).random((3, *shape)).astype(np.float32)
    found = hpcomp.stack_measures(layers, background=(0.2, 0.1, 0.4))
    one_by_one = layers.reshape(3, -1, 1, 4)
    parts = [hpcomp.stack_measures(pixel, background=(0.2, 0.1, 0.4)) for pixel in one_by_one.swapaxes(0, 1)]
    assert found.pixels == 24
    assert found.result.light == sum(parts[1:], parts[0]).result.light
    assert found.result.chroma == sum(parts[1:], parts[0]).result.chroma


def test_blocks_do_not_show(monkeypatch):
    random = np.random.default_rng(5)
    layers = random.random((3, 101, 4)).astype(np.float32)
    layers[1, 7] = np.nan
    whole = hpcomp.stack_measures(layers)
    rules = stack_rules(3)
    planes = measures.measures_of(rules, measures.measure_settings(rules), layers[:, None])[1]
    monkeypatch.setattr(measures, "BLOCK_PIXELS", 8)
    assert hpcomp.stack_measures(layers) == whole
    blocks = measures.measures_of(rules, measures.measure_settings(rules), layers[:, None])[1]
    for name, plane in vars(planes).items():
        assert np.array_equal(plane, getattr(blocks, name)), name


@given(pixel_stacks())
def test_losses_add_up_and_no_layer_keeps_more_than_it_had(stack):
    layers, rules = stack
    found = hpcomp.stack_measures(layers, **rules)
    for result in (found.result, found.traditional):
        everyone = (*result.layers, result.background)
        chroma = sum(layer.chroma for layer in everyone)
        kept = sum(layer.kept for layer in everyone)
        assert result.lost == ((chroma - kept) / chroma if chroma else 0)
        for layer in everyone:
            assert 0 <= layer.kept <= layer.chroma
            assert 0 <= layer.survived <= layer.pixels <= found.pixels
        assert 0 <= result.foreign <= result.chromatic <= found.pixels
        assert 0 <= result.foreign_chroma <= result.chroma
    assert 0 <= found.order_sensitive <= found.result.chromatic


@st.composite
def distinct_labels(draw):
    """A stack of labels whose hues are more than three tolerances apart, with random alphas."""
    hue_tolerance = draw(st.sampled_from((2.0, 0.0, 5.0)))
    n = draw(st.integers(2, 5))
    start, places = draw(st.floats(0, 360)), draw(st.permutations(range(12)))
    layers = []
    for place in places[:n]:
        hue = start + 30 * place + draw(st.floats(-5, 5))
        color = strategies.valid_color(hue, draw(st.floats(0.3, 1)), draw(st.floats(0.1, 0.9)))
        alphas = np.array(draw(st.lists(st.floats(0, 1), min_size=4, max_size=4)))
        layers.append(np.column_stack([np.outer(alphas, color), alphas]))
    return np.array(layers, np.float32), hue_tolerance


@pytest.mark.parametrize("space", hpcomp.SPACES)
@given(distinct_labels(), strategies.orders, st.lists(strategies.operators, min_size=4, max_size=4))
def test_no_hue_of_a_hue_preserving_stack_is_foreign(space, stack, order, operators):
    """The paper's claim, before anything is quantised."""
    layers, hue_tolerance = stack
    found = hpcomp.stack_measures(
        layers,
        op=[None, *operators[: len(layers) - 1]],
        order=order,
        space=space,
        hue_tolerance=hue_tolerance,
    )
    assert found.result.foreign == found.result.foreign_chroma == 0


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_chroma_is_that_of_the_space(space):
    layers = [label(0, 0.3), label(120, 0.1)]
    found = measured(layers, space=space)
    colors = np.array(layers)[:, 0, :3].T
    sizes = np.hypot(*hpcomp.SPACES[space].forward(colors)[1])
    result = found.result
    assert result.chroma * SUM_UNIT == pytest.approx(abs(sizes[0] - sizes[1]), abs=NEAR)
    assert [layer.chroma * SUM_UNIT for layer in result.layers] == pytest.approx(sizes, abs=NEAR)


def test_the_same_stacks_are_mostly_foreign_when_added_as_usual():
    random = np.random.default_rng(3)
    alphas = random.random((3, 2000, 1))
    colors = np.array([(0.9, 0.1, 0.1), (0.1, 0.8, 0.1), (0.1, 0.2, 0.9)])
    layers = np.concatenate([alphas * colors[:, None], alphas], axis=2)
    for order in ORDERS:
        found = hpcomp.stack_measures(layers, order=order)
        assert found.result.foreign == 0
        assert found.traditional.foreign_share > 0.7
        assert found.traditional.lost < found.result.lost < 1


# ---- a literal second opinion --------------------------------------------------------------------


def literal(layers, settings, **job):
    """The measures of one pixel in plain Python, from the oracle's terms and composites."""
    scaled = oracle.as_read(layers, job["opacities"])
    weights, alpha = oracle.weights([a for _, a in scaled], job["ops"])
    terms = [oracle.difference(oracle.scaled(w, c)) for w, (c, _) in zip(weights, scaled, strict=True)]
    if job["background"] is not None:
        terms.append(oracle.difference(oracle.scaled(1 - alpha, job["background"])))
    sizes = [oracle.length(t) for t in terms]
    tolerance, step = math.radians(settings.foreign_tolerance), settings.half_step

    def composite(**changes):
        return oracle.composite(layers, **{**job, **changes})[:3]

    def near(d):
        return [m > 0 and oracle.angle(d, t) <= tolerance for t, m in zip(terms, sizes, strict=True)]

    def survivor(d):
        support = near(d)
        backing = sum(m for m, n in zip(sizes, support, strict=True) if n)
        if oracle.length(d) <= step or backing <= step:
            return None
        ours = [(m, -i) for i, (m, n) in enumerate(zip(sizes[: len(layers)], support, strict=False)) if n]
        return -max(ours)[1] if sum(m for m, _ in ours) > step else None

    def result(c):
        d = oracle.difference(c)
        size, support = oracle.length(d), near(d)
        backing = sum(m for m, n in zip(sizes, support, strict=True) if n)
        saturation = (max(c) - min(c)) / max(abs(max(c)), abs(min(c)), 1e-300)
        chromatic = size > step and saturation >= settings.achromatic
        kept = []
        for m, n in zip(sizes, support, strict=True):
            if n:
                kept.append(m * min(1, size / backing))
            else:
                others = sum(sizes) - backing
                kept.append(m * min(1, max(0, size - backing) / others) if others > 0 else 0.0)
        return {
            "chromatic": chromatic,
            "foreign": chromatic and backing <= step,
            "survived": [chromatic and n and m > step for m, n in zip(sizes, support, strict=True)],
            "kept": kept,
            "light": [max(0, v) for v in c],
            "size": size,
        }

    ours, plain = composite(), composite(blending="traditional")
    found = result(ours)
    winner = survivor(oracle.difference(ours))
    rivals = [
        m
        for t, m in zip(terms, sizes, strict=True)
        if winner is not None and m > 0 and oracle.angle(t, terms[winner]) > tolerance
    ]
    return {
        "sizes": sizes,
        "contributes": [m > step for m in sizes],
        "result": found,
        "traditional": result(plain),
        "sensitive": job["blending"] == "hue-preserving"
        and found["chromatic"]
        and survivor(oracle.difference(composite(order="bottom-up")))
        != survivor(oracle.difference(composite(order="top-down"))),
        "layer": 0 if winner is None else winner + 1,
        "grey": 1 - min(1, found["size"] / sum(sizes)) if sum(sizes) else 0,
        "margin": 0 if winner is None else 1 - max(rivals, default=0) / sizes[winner],
    }


@given(pixel_stacks(max_pixels=6))
def test_measures_and_provenance_agree_with_the_literal_ones(stack):
    layers, rules = stack
    own = {"half_step": rules.pop("half_step")}
    n = len(layers)
    checked = stack_rules(n, **rules)
    settings = measures.measure_settings(checked, **own)
    found, planes = measures.measures_of(checked, settings, layers[:, None])
    pixels = [
        literal(
            [tuple(map(float, layers[i, x])) for i in range(n)],
            settings,
            ops=rules["op"],
            opacities=rules["opacity"],
            order=rules["order"],
            blending=rules["blending"],
            hue_tolerance=rules["hue_tolerance"],
            gray_bias=rules["gray_bias"],
            background=rules["background"],
        )
        for x in range(layers.shape[1])
    ]
    for x in range(layers.shape[1]):
        assume(strategies.is_decided(layers[:, x].tolist(), rules["op"], rules["opacity"],
                                     rules["blending"], rules["background"]))  # fmt: skip
    # A hair from a threshold float and double may part.
    for pixel in pixels:
        for value in (*pixel["sizes"], pixel["result"]["size"], pixel["traditional"]["size"]):
            assume(abs(value - settings.half_step) > 1e-6)
    assert found.order_sensitive == sum(pixel["sensitive"] for pixel in pixels)
    for name in ("result", "traditional"):
        ours, theirs = getattr(found, name), [pixel[name] for pixel in pixels]
        assert ours.chromatic == sum(p["chromatic"] for p in theirs)
        assert ours.foreign == sum(p["foreign"] for p in theirs)
        everyone = ours.layers
        if rules["background"] is not None:
            everyone += (ours.background,)
        for i, row in enumerate(everyone):
            assert row.pixels == sum(p["contributes"][i] for p in pixels)
            assert row.survived == sum(p["survived"][i] for p in theirs)
            assert row.chroma * SUM_UNIT == pytest.approx(sum(p["sizes"][i] for p in pixels), abs=1e-5)
            assert row.kept * SUM_UNIT == pytest.approx(sum(p["kept"][i] for p in theirs), abs=5e-5)
        for channel in range(3):
            light = sum(p["light"][channel] for p in theirs)
            assert ours.light[channel] * SUM_UNIT == pytest.approx(light, abs=5e-5)
    assert planes.layer[0].tolist() == [pixel["layer"] for pixel in pixels]
    for x, pixel in enumerate(pixels):
        if pixel["layer"]:
            assert planes.grey[0, x] == pytest.approx(pixel["grey"], abs=5e-3)
            assert planes.margin[0, x] == pytest.approx(pixel["margin"], abs=5e-3 * (1 + abs(pixel["margin"])))


# ---- settings and reports ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"half_step": -1}, "half step -1 is outside 0 to 1"),
        ({"achromatic": 1.5}, "achromatic saturation 1.5 is outside 0 to 1"),
        ({"foreign_tolerance": 181}, "foreign tolerance 181 is outside 0 to 180"),
        ({"foreign_tolerance": math.nan}, "foreign tolerance nan"),
        ({"order": "upside-down"}, "unknown order"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(SettingError, match=message):
        hpcomp.stack_measures([np.zeros((1, 4))], **settings)


@pytest.mark.parametrize("shapes", [((2, 4), (3, 4)), ((2, 3), (2, 3)), ((), ())])
def test_layers_need_one_shape(shapes):
    with pytest.raises(MismatchError, match=r"RGBA needs 4 components on the last axis|place all layers on one canvas"):
        hpcomp.stack_measures([np.zeros(shape) for shape in shapes])


def test_measures_of_other_settings_do_not_add_up():
    one, other = (
        hpcomp.stack_measures([np.zeros((1, 4))], achromatic=share) for share in (0.02, 0.1)
    )
    with pytest.raises(SettingError, match="do not add up"):
        one + other
    with pytest.raises(TypeError):
        one + 1


def test_half_steps_of_outputs():
    assert measures.half_step("uint8") == 0.5 / 255
    assert {measures.half_step(kind) for kind in ("uint16", "half", "float")} == {0.5 / 65535}


def test_reports_hold_the_numbers():
    found = measured([label(0, 0.3), label(120, 0.1)], background=(0.2, 0.1, 0.1))
    data = report.as_data(found, ["red", "green"])
    assert data["result"]["foreign_share"] == 0
    assert data["traditional"]["foreign_share"] == 1
    assert data["result"]["lost_to_grey"] == found.result.lost
    assert [row["label"] for row in data["result"]["layers"]] == ["red", "green"]
    assert data["result"]["layers"][1]["lost_to_grey"] == found.result.layers[1].lost
    assert data["result"]["background"] is None  # plus of two halves leaves nothing uncovered
    assert data["energy_weights"] == list(measures.ENERGY_WEIGHTS)
    text = report.as_text(found, ["red", "gr\x1been"])
    assert "gr\\x1been: lost to grey" in text
    assert "foreign hue, of pixels  " in text
    assert "100.000%" in text
    below = hpcomp.stack_measures([label(0, 0.3)], background=(0.2, 0.1, 0.1))
    assert report.as_data(below, ["red"])["result"]["background"]["pixels"] == 1
    assert "background: hue survived" in report.as_text(below, ["red"])


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_plain_addition_is_measured_as_the_picture_it_makes(space):
    layers = [label(0, 0.3), label(100, 0.2)]
    rules = {"space": space, "op": "plus", "background": (0.1, 0.2, 0.05)}
    picture = hpcomp.composite(layers, blending="traditional", **rules)
    chroma = np.hypot(*hpcomp.SPACES[space].forward(picture.reshape(-1, 4).T[:3])[1])
    for blending in ("traditional", "hue-preserving"):
        found = hpcomp.stack_measures(layers, blending=blending, **rules)
        assert found.traditional.chroma * SUM_UNIT == pytest.approx(chroma.sum(), abs=NEAR)
    assert hpcomp.stack_measures(layers, blending="traditional", **rules).result.chroma == pytest.approx(
        chroma.sum() / SUM_UNIT, abs=NEAR / SUM_UNIT
    )


@pytest.mark.parametrize("space", hpcomp.SPACES)
def test_the_foreign_tolerance_allows_for_the_way_back_into_gamut(space):
    found = hpcomp.stack_measures([label(0, 0.3)], space=space, hue_tolerance=3.0)
    turn = {"oklab": 0.5, "cielab": 4.5}.get(space, 0.0)
    assert found.settings.foreign_tolerance == 6 + turn
