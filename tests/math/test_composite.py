"""The engines against the oracle in all that can be asked of them, and `composite`'s contract."""

import functools
import itertools
import subprocess
import sys

import numpy as np
import oracle
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from strategies import (
    BLENDING_NAMES,
    OPERATOR_NAMES,
    ORDER_NAMES,
    alphas,
    hdr_layers,
    hue_tolerances,
    is_decided,
    jobs,
    operators,
    rules_of,
    shares,
    stacks,
    valid_color,
    valid_colors,
    valid_pairs,
)
from tolerances import FLOAT32, FLOAT64, HARD_SWITCH, ROUNDING, assert_near

from hpcomp.color.spaces import SPACES
from hpcomp.engine.arrays import hue_add
from hpcomp.errors import ExitCode, HpcompError, SettingError

RED = (1.0, 0.0, 0.0, 1.0)
GREEN = (0.0, 1.0, 0.0, 1.0)

#: More than two blocks of any engine and an odd rest.
MANY_PIXELS = 2 * 32768 + 7


def size_of(layers, background=None):
    """What roundings are measured by: the light of all layers, and at least 1 for alpha."""
    colors = [layer[:3] for layer in layers] + ([] if background is None else [background])
    return 1 + sum(max(abs(float(component)) for component in c) for c in colors)


def run(composite, job, dtype=np.float64, **rules):
    """An engine on the arguments of `oracle.composite`."""
    layers = [np.array(layer, dtype) for layer in job["layers"]]
    return composite(layers, **rules_of(job), **rules)


def corpus(n_layers, pixels=60, seed=8):
    """(n, pixels, 4): layers on the edges of what is valid, near and equal hues, HDR and glow."""
    rng = np.random.default_rng(seed)
    layers = np.empty((n_layers, pixels, 4))
    for pixel in range(pixels):
        hue = rng.uniform(0, 360)
        for number in range(n_layers):
            alpha = rng.choice([0.0, 1.0, 0.5, rng.random()], p=[0.1, 0.2, 0.2, 0.5])
            kind = rng.integers(5)
            if kind == 0:
                c = alpha * rng.integers(0, 2, 3)
            elif kind == 1:
                c = alpha * rng.random(3)
            elif kind == 2:
                c = rng.uniform(-0.5, 20, 3)
            else:
                # Equal hues, and in, on and beyond the shoulder of 2°.
                hue += rng.choice([0, 1.6, 2.5, 3.0, 3.9, 4.5, 180, -70])
                c = valid_color(hue, rng.random(), rng.uniform(0.1, 0.9), alpha)
            layers[number, pixel] = (*c, alpha)
    return layers


class TestEngineIsTheOracle:
    """Every operator × blending × order × precision, then everything mixed."""

    LAYERS = corpus(4)
    ORDERS = (*ORDER_NAMES, (2, 0, 3, 1))

    def expected(self, layers, **arguments):
        return [
            oracle.composite([tuple(layer) for layer in pixel], **arguments)
            for pixel in layers.swapaxes(0, 1).tolist()
        ]

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("blending", BLENDING_NAMES)
    @pytest.mark.parametrize("op", OPERATOR_NAMES)
    @pytest.mark.parametrize(
        ("dtype", "tolerance"),
        [(np.float64, FLOAT64), (np.float32, FLOAT32)],
        ids=["double", "single"],
    )
    def test_operator_blending_order(self, composite, op, blending, order, dtype, tolerance):
        layers, ops = self.LAYERS.astype(dtype), [None, *[op] * 3]
        decided = [is_decided(p, ops, blending=blending) for p in layers.swapaxes(0, 1).tolist()]
        assert sum(decided) > 0.7 * len(decided)
        layers = layers[:, decided]
        expected = self.expected(layers, ops=ops, blending=blending, order=order)
        actual = composite(list(layers), op=op, blending=blending, order=order)
        assert actual.dtype == dtype
        size = 1 + np.abs(layers).max(axis=-1).sum(axis=0)[:, None]
        assert_near(actual, expected, tolerance, size)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("gray_bias", [0.01, 0.3, 1.0])
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize(
        ("dtype", "tolerance"),
        [(np.float64, FLOAT64), (np.float32, FLOAT32)],
        ids=["double", "single"],
    )
    def test_gray_bias(self, composite, order, gray_bias, dtype, tolerance):
        layers = self.LAYERS.astype(dtype)
        expected = self.expected(layers, order=order, gray_bias=gray_bias)
        actual = composite(list(layers), order=order, gray_bias=gray_bias)
        size = 1 + np.abs(layers).max(axis=-1).sum(axis=0)[:, None]
        assert_near(actual, expected, tolerance, size)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("hue_tolerance", [0.0, 0.5, 10.0])
    @pytest.mark.parametrize("order", ORDERS)
    def test_other_tolerances(self, composite, order, hue_tolerance):
        expected = self.expected(self.LAYERS, order=order, hue_tolerance=hue_tolerance)
        actual = composite(list(self.LAYERS), order=order, hue_tolerance=hue_tolerance)
        size = 1 + np.abs(self.LAYERS).max(axis=-1).sum(axis=0)[:, None]
        assert_near(actual, expected, HARD_SWITCH, size)

    @given(job=jobs())
    def test_anything_double(self, composite, job):
        assume(is_decided(**job))
        tolerance = FLOAT64 if job["hue_tolerance"] else HARD_SWITCH
        size = size_of(job["layers"], job["background"])
        assert_near(run(composite, job), oracle.composite(**job), tolerance, size)

    @given(job=jobs(tolerances=st.sampled_from([2.0, 10.0])))
    def test_anything_single(self, composite, job):
        # The oracle sees the values as single precision holds them: their rounding is no error.
        job["layers"] = [
            tuple(float(np.float32(component)) for component in layer) for layer in job["layers"]
        ]
        assume(is_decided(**job))
        size = size_of(job["layers"], job["background"])
        actual = run(composite, job, np.float32)
        assert actual.dtype == np.float32
        assert_near(actual, oracle.composite(**job), FLOAT32, size)

    @pytest.mark.pairwise
    @pytest.mark.parametrize(
        ("dtype", "tolerance"),
        [(np.float64, FLOAT64), (np.float32, FLOAT32)],
        ids=["double", "single"],
    )
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("space", oracle.SPACES)
    def test_other_spaces(self, composite, space, order, dtype, tolerance):
        layers = self.LAYERS.astype(dtype)
        expected = [
            oracle.composite_in(space, [tuple(layer) for layer in pixel], order=order)
            for pixel in layers.swapaxes(0, 1).tolist()
        ]
        size = 1 + np.abs(layers).max(axis=-1).sum(axis=0)[:, None]
        actual = composite(list(layers), order=order, space=space)
        assert_near(actual, expected, tolerance, size)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDER_NAMES)
    @pytest.mark.parametrize("space", ["linear-rgb", *oracle.SPACES])
    def test_layers_that_add_nothing(self, composite, space, order):
        """One layer alone, some of no opacity, and channels that are empty in all."""
        dark = [self.LAYERS * np.array([*(np.arange(3) != channel), 1]) for channel in range(3)]
        for layers, opacities in (
            (self.LAYERS[:1], [1.0]),
            (self.LAYERS, [1.0, 0.0, 0.6, 0.0]),
            (self.LAYERS, [0.0] * 4),
            *((layers, [1.0] * 4) for layers in dark),
        ):
            job = {"order": order, "opacities": opacities}
            pixels = [[tuple(layer) for layer in pixel] for pixel in layers.swapaxes(0, 1).tolist()]
            of_space = oracle.composite
            if space in oracle.SPACES:
                of_space = functools.partial(oracle.composite_in, space)
            expected = [of_space(pixel, **job) for pixel in pixels]
            actual = composite(list(layers), opacity=opacities, order=order, space=space)
            size = 1 + np.abs(layers).max(axis=-1).sum(axis=0)[:, None]
            assert_near(actual, expected, FLOAT64, size)

    @pytest.mark.parametrize("space", oracle.SPACES)
    @given(job=jobs())
    def test_anything_in_other_spaces(self, composite, space, job):
        assume(is_decided(**job))
        tolerance = FLOAT64 if job["hue_tolerance"] else HARD_SWITCH
        size = size_of(job["layers"], job["background"])
        expected = oracle.composite_in(space, **job)
        assert_near(run(composite, job, space=space), expected, tolerance, size)

    @pytest.mark.parametrize("space", oracle.OPEN)
    @given(job=jobs(tolerances=st.sampled_from([2.0, 10.0]), hdr=False))
    def test_anything_single_in_other_spaces(self, composite, space, job):
        job["layers"] = [
            tuple(float(np.float32(component)) for component in layer) for layer in job["layers"]
        ]
        assume(is_decided(**job))
        size = size_of(job["layers"], job["background"])
        expected = oracle.composite_in(space, **job)
        assert_near(run(composite, job, np.float32, space=space), expected, FLOAT32, size)

    @pytest.mark.parametrize("space", SPACES)
    @given(job=jobs())
    def test_plain_addition_is_the_same_in_every_space(self, composite, space, job):
        job["blending"] = "traditional"
        size = size_of(job["layers"], job["background"])
        assert_near(run(composite, job, space=space), oracle.composite(**job), FLOAT64, size)

    @given(pair=valid_pairs(), hue_tolerance=hue_tolerances)
    def test_two_layers_added_are_hue_add(self, composite, pair, hue_tolerance):
        a, b = (np.array(layer) for layer in pair)
        result = composite([a, b], op="plus", hue_tolerance=hue_tolerance)
        expected = hue_add(a[:3], b[:3], hue_tolerance=hue_tolerance)
        assert_near(result[:3], expected, ROUNDING, size_of(pair))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    "rules",
    [
        *({"gray_bias": bias, "order": order} for bias in (0.3, 1.0) for order in ORDER_NAMES),
        {"blending": "foremost"},
    ],
    ids=str,
)
class TestRulesBesideThePaper:
    """What holds for every rule: exact luminance, and nothing leaves the gamut."""

    @pytest.mark.pairwise
    @given(data=st.data())
    def test_luminance_adds_and_nothing_leaves_the_gamut(self, composite, rules, dtype, data):
        layers = data.draw(stacks(hdr=False))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        background = data.draw(st.one_of(st.none(), st.tuples(shares, shares, shares)))
        arrays = [np.array(layer, dtype) for layer in layers]
        result = composite(arrays, op=ops, background=background, **rules)
        w, alpha = oracle.weights([layer[3] for layer in layers], ops)
        most = sum(w_i * layer[3] for w_i, layer in zip(w, layers, strict=True))
        most += 0 if background is None else 1 - alpha
        tolerance = FLOAT64 if dtype == np.float64 else FLOAT32
        assert result[:3].min() >= -tolerance
        assert result[:3].max() <= most + tolerance
        plain = composite(arrays, op=ops, background=background, blending="traditional")
        assert_near(oracle.luminance(result), oracle.luminance(plain), tolerance)


#: Three labels, each the strongest in its own channel.
THREE_LABELS = {
    "red": (0.4, 0.1, 0.1, 0.5),
    "green": (0.1, 0.3, 0.1, 0.5),
    "blue": (0.0, 0.1, 0.4, 0.5),
}


class TestForemost:
    """The baseline: the hue of the colour in front, whoever that is."""

    def survivor(self, composite, names, dtype=np.float64, **rules):
        """Whose hue the composite of these colours has."""
        layers = [np.array(THREE_LABELS.get(name, name), dtype) for name in names]
        d = oracle.difference(composite(layers, blending="foremost", **rules)[:3].tolist())
        if oracle.length(d) < 1e-7:
            return None
        return min(
            THREE_LABELS,
            key=lambda name: oracle.angle(d, oracle.difference(THREE_LABELS[name][:3])),
        )

    @pytest.mark.pairwise
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize(
        ("ops", "expected"),
        [
            (["over", "over"], "blue"),
            (["over", "dst-over"], "green"),
            (["dst-over", "dst-over"], "red"),
            (["dst-over", "over"], "blue"),
            (["atop", "dst-atop"], "green"),
            (["xor", "plus"], "blue"),
            (["over", "dst-in"], "green"),
            (["in", "dst-out"], "green"),
            (["dst-out", "under"], "red"),
            (["src", "dst"], "green"),
        ],
    )
    def test_operators_say_who_is_in_front(self, composite, ops, expected, dtype):
        names = ["red", "green", "blue"]
        assert self.survivor(composite, names, dtype, op=[None, *ops]) == expected

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_greys_and_transparent_layers_hide_no_hue(self, composite, dtype):
        grey, nothing = (0.3, 0.3, 0.3, 0.5), (0.0, 0.0, 0.0, 0.0)
        assert self.survivor(composite, ["red", "green", grey, nothing], dtype) == "green"
        assert self.survivor(composite, ["red", (0.5, 0.5, 0.5, 1.0)], dtype) is None
        assert self.survivor(composite, [grey, nothing], dtype) is None

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_the_background_is_at_the_very_back(self, composite, dtype):
        blue = (0.0, 0.0, 1.0)
        for ops in (["over"], ["dst-over"]):
            front = "green" if ops == ["over"] else "red"
            names = ["red", "green"]
            assert self.survivor(composite, names, dtype, op=[None, *ops], background=blue) == front
        assert self.survivor(composite, [(0.2, 0.2, 0.2, 0.5)], dtype, background=blue) == "blue"

    @given(data=st.data())
    def test_orders_have_no_effect(self, composite, data):
        layers = data.draw(stacks())
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        arrays = [np.array(layer, np.float32) for layer in layers]
        results = {
            composite(arrays, op=ops, order=order, blending="foremost").tobytes()
            for order in (*ORDER_NAMES, data.draw(st.permutations(range(len(layers)))))
        }
        assert len(results) == 1

    @pytest.mark.pairwise
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("tint", [1e-2, 1e-4, 1e-6, 1e-30])
    def test_the_least_tint_in_front_flips_the_hue(self, composite, tint, dtype):
        # What the paper says against it: "little tints of close-by colors could completely change
        # the final image". ⊕ of the same layers hardly changes.
        layers = [np.array(THREE_LABELS["red"], dtype), np.zeros(4, dtype)]
        veil = [layers[0], np.array([0.0, 0.0, tint, 0.0], dtype)]

        def moved(blending):
            before, after = (composite(part, blending=blending) for part in (layers, veil))
            return np.abs(after - before).max()

        assert moved("hue-preserving") <= 2 * tint + 1e-7
        lost = np.abs(np.array(oracle.difference(THREE_LABELS["red"][:3]))).max()
        assert moved("foremost") >= lost - 2 * tint - 1e-7


class TestOperators:
    @given(layers=stacks(min_size=2), op=operators)
    def test_one_name_is_for_every_layer_but_the_bottom(self, composite, layers, op):
        arrays = [np.array(layer) for layer in layers]
        each = composite(arrays, op=[None] + [op] * (len(layers) - 1))
        assert composite(arrays, op=op).tolist() == each.tolist()

    @pytest.mark.parametrize(
        ("alias", "name"), [("under", "dst-over"), ("mask", "dst-in"), ("lighter", "plus")]
    )
    def test_aliases(self, composite, alias, name):
        layers = [np.array(layer) for layer in corpus(3)]
        assert composite(layers, op=alias).tolist() == composite(layers, op=name).tolist()
        assert (
            composite(layers, op=[None, alias, "over"]).tolist()
            == composite(layers, op=[None, name, "over"]).tolist()
        )

    def test_over_is_the_default(self, composite):
        layers = list(corpus(3))
        assert composite(layers).tolist() == composite(layers, op="over").tolist()

    @given(a=valid_colors(), b=valid_colors())
    def test_what_each_operator_keeps(self, composite, a, b):
        below, layer = np.array(a), np.array(b)
        for op, expected in (
            ("clear", np.zeros(4)),
            ("src", layer),
            ("dst", below),
            ("in", layer * below[3]),
            ("dst-in", below * layer[3]),
            ("out", layer * (1 - below[3])),
            ("dst-out", below * (1 - layer[3])),
        ):
            assert_near(composite([below, layer], op=op), expected, ROUNDING)

    def test_operators_act_where_a_layer_is_transparent(self, composite):
        below, nothing = np.array([0.5, 0.25, 0.0, 0.5]), np.zeros(4)
        for op in ("src", "in", "out", "dst-in", "dst-atop", "clear"):
            assert composite([below, nothing], op=op).tolist() == [0, 0, 0, 0]
        for op in ("dst", "over", "dst-over", "dst-out", "atop", "xor", "plus"):
            assert_near(composite([below, nothing], op=op), below, ROUNDING)

    @given(layers=st.lists(st.tuples(*[st.floats(0, 3)] * 3, alphas), min_size=2, max_size=6))
    def test_plus_clamps_alpha_and_not_the_colour(self, composite, layers):
        result = composite([np.array(layer) for layer in layers], op="plus")
        assert_near(result[3], min(1.0, sum(layer[3] for layer in layers)), FLOAT64)
        luminance = sum(oracle.luminance(layer) for layer in layers)
        assert_near(oracle.luminance(result), luminance, FLOAT64, size_of(layers))

    def test_clamped_alpha_is_what_the_next_layer_sees(self, composite):
        half_red = np.array([0.75, 0.0, 0.0, 0.75])
        layers = [half_red, half_red, np.array(GREEN)]
        result = composite(layers, op=[None, "plus", "dst-over"])
        assert_near(result, [1.5, 0, 0, 1], ROUNDING)


class TestOneLayer:
    @given(layer=st.one_of(valid_colors(), hdr_layers), order=st.sampled_from(ORDER_NAMES))
    def test_is_itself(self, composite, layer, order):
        for blending in BLENDING_NAMES:
            result = composite([np.array(layer)], order=order, blending=blending)
            assert_near(result, layer, ROUNDING, size_of([layer]))

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDER_NAMES)
    @pytest.mark.parametrize(("dtype", "digits"), [(np.float32, 1e-6), (np.float64, ROUNDING)])
    def test_a_thin_one_keeps_its_ratio_of_colour_to_alpha(self, composite, order, dtype, digits):
        # Straight colour is c / α: an alpha that is right to 1e-7 of 1 only would put the thinnest
        # white of a 16-bit PNG out of gamut. A few roundings of the type, relative.
        for alpha in (1 / 255, 1 / 65535, 6e-8, 1e-12):
            layers = [np.full((1, 4), alpha, dtype), np.zeros((1, 4), dtype)]
            for stack in (layers, layers[::-1]):
                result = composite(stack, order=order)
                assert_near(result / dtype(alpha), np.ones((1, 4)), digits)

    def test_op_is_for_the_others(self, composite):
        result = composite([np.array(RED)], op="clear")
        assert_near(result, RED, ROUNDING)


class TestOpacity:
    @given(data=st.data())
    def test_scales_colour_and_alpha_before_the_operator(self, composite, data):
        layers = data.draw(stacks())
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        opacities = [data.draw(alphas) for _ in layers]
        result = composite([np.array(layer) for layer in layers], op=ops, opacity=opacities)
        scaled = [o * np.array(layer) for o, layer in zip(opacities, layers, strict=True)]
        assert_near(result, composite(scaled, op=ops), FLOAT64, size_of(layers))

    @pytest.mark.parametrize("kind", [int, float, np.float32, np.float64, np.int64, np.array])
    def test_is_a_number_of_any_kind(self, composite, kind):
        layers = [np.array(RED), np.array(GREEN)]
        assert_near(composite(layers, opacity=kind(1)), GREEN, ROUNDING)
        assert_near(composite(layers, opacity=[kind(1), kind(0)]), RED, ROUNDING)
        assert_near(composite(layers, opacity=np.array([1.0, 0.0])), RED, ROUNDING)

    @given(layers=stacks(), opacity=alphas)
    def test_one_number_is_for_every_layer(self, composite, layers, opacity):
        arrays = [np.array(layer) for layer in layers]
        each = composite(arrays, opacity=[opacity] * len(layers))
        assert composite(arrays, opacity=opacity).tolist() == each.tolist()

    def test_alpha_is_clamped_before_it(self, composite):
        result = composite([np.array([2.0, 0.0, 0.0, 4.0])], opacity=0.5)
        assert_near(result, [1.0, 0.0, 0.0, 0.5], ROUNDING)

    @pytest.mark.parametrize("opacity", [-0.1, 1.5, np.nan, np.inf, [1.0], [1.0] * 3, []])
    def test_out_of_range_or_of_another_number_is_an_error(self, composite, opacity):
        with pytest.raises(SettingError):
            composite([np.array(RED), np.array(GREEN)], opacity=opacity)

    def test_out_of_range_names_the_layer(self, composite):
        with pytest.raises(SettingError, match="layer 1"):
            composite([np.array(RED), np.array(GREEN)], opacity=[1.0, 2.0])


class TestBackground:
    @given(data=st.data(), background=st.tuples(shares, shares, shares))
    def test_is_an_opaque_layer_under_the_finished_stack(self, composite, data, background):
        layers = data.draw(stacks())
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        order = data.draw(st.sampled_from(ORDER_NAMES))
        arrays = [np.array(layer) for layer in layers]
        result = composite(arrays, op=ops, order=order, background=background)
        finished = composite(arrays, op=ops, order=order)
        expected = composite([finished, np.array([*background, 1.0])], op="dst-over")
        size = size_of(layers, background)
        assert_near(result, expected, FLOAT64, size)
        assert_near(result[3], 1.0, ROUNDING)

    @given(background=st.tuples(shares, shares, shares))
    def test_shows_alone_where_there_is_nothing(self, composite, background):
        assert_near(composite([np.zeros(4)], background=background), (*background, 1), ROUNDING)

    @given(layers=stacks(), background=st.tuples(shares, shares, shares))
    def test_does_not_show_under_opaque_layers(self, composite, layers, background):
        arrays = [np.array([*layer[:3], 1.0]) for layer in layers]
        result = composite(arrays, background=background)
        assert_near(result, composite(arrays), ROUNDING, size_of(layers))

    def test_has_no_number(self, composite):
        layers = [np.array([*c, 0.5]) for c in np.eye(3) / 2]
        numbered = composite(layers, order="0,1,2", background=(0.2, 0.4, 0.6))
        named = composite(layers, order="bottom-up", background=(0.2, 0.4, 0.6))
        assert_near(numbered, named, ROUNDING)
        with pytest.raises(SettingError):
            composite(layers, order="0,1,2,3", background=(0.2, 0.4, 0.6))

    @pytest.mark.parametrize("blending", BLENDING_NAMES)
    def test_is_added_as_the_layers_are(self, composite, blending):
        layer, background = (0.5, 0.0, 0.0, 0.5), (0.0, 0.0, 1.0)
        result = composite([np.array(layer)], blending=blending, background=background)
        expected = oracle.composite([layer], blending=blending, background=background)
        assert_near(result, expected, ROUNDING)

    @pytest.mark.parametrize("background", [(1, 1), (1, 1, 1, 1), ()])
    def test_not_three_numbers_is_an_error(self, composite, background):
        with pytest.raises(SettingError):
            composite([np.array(RED)], background=background)


class TestReading:
    @example(layer=(0.5, 0.25, 0.125, -0.5), other=GREEN)
    @example(layer=(0.5, 0.25, 0.125, 1.5), other=(0.0, 0.25, 0.0, 0.5))
    @given(
        layer=st.tuples(*[st.floats(-10, 10)] * 3, st.floats(-3, 3)),
        other=st.tuples(*[st.floats(-10, 10)] * 3, st.floats(-3, 3)),
    )
    def test_alpha_is_clamped_and_colour_is_not(self, composite, layer, other):
        arrays = [np.array(layer), np.array(other)]
        clamped = [np.array([*a[:3], min(1.0, max(0.0, a[3]))]) for a in arrays]
        for op in OPERATOR_NAMES:
            result = composite(arrays, op=op)
            assert result.tolist() == composite(clamped, op=op).tolist()
            assert 0 <= result[3] <= 1

    def test_colour_without_alpha_is_kept(self, composite):
        glow, below = np.array([3.0, 2.0, 1.0, 0.0]), np.array([0.5, 0.5, 0.5, 1.0])
        assert_near(composite([glow]), glow, ROUNDING, 3)
        assert_near(composite([below, glow]), [3.5, 2.5, 1.5, 1.0], ROUNDING, 4)


class TestArrays:
    ORDERS = (*ORDER_NAMES, "2,0,1")

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("shape", [(), (1,), (7,), (3, 5), (2, 3, 4), (0,), (3, 0), (0, 2)])
    def test_any_leading_shape(self, composite, shape, order):
        layers = np.random.default_rng(9).random((3, *shape, 4))
        result = composite(list(layers), order=order, background=(0.1, 0.2, 0.3))
        assert result.shape == (*shape, 4)
        flat = layers.reshape(3, -1, 4)
        for pixel, index in enumerate(np.ndindex(shape)):
            expected = composite(list(flat[:, pixel]), order=order, background=(0.1, 0.2, 0.3))
            assert result[index].tolist() == expected.tolist()

    @pytest.mark.parametrize(
        ("given_type", "result_type"),
        [
            (np.float64, np.float64),
            (np.float32, np.float32),
            (np.float16, np.float32),
            (np.uint8, np.float32),
            (np.int64, np.float32),
            (np.bool_, np.float32),
        ],
    )
    def test_float64_stays_and_the_rest_is_float32(self, composite, given_type, result_type):
        layers = [np.array(layer, given_type) for layer in (RED, GREEN, (0, 0, 0, 0))]
        for order in self.ORDERS:
            result = composite(layers, order=order, background=(0, 0, 1))
            assert result.dtype == result_type
            assert_near(result, GREEN, FLOAT32)
        assert composite(layers[:1]).dtype == result_type
        assert composite([np.empty((0, 4), given_type)]).dtype == result_type

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_inputs_are_neither_changed_nor_handed_out(self, composite, dtype, order):
        layers = [np.full((5, 4), 2.0, dtype), *np.full((2, 5, 4), 0.25, dtype)]
        before = [layer.copy() for layer in layers]
        for layer in layers:
            layer.flags.writeable = False
        result = composite(layers, order=order, opacity=0.5, background=(0.1, 0.2, 0.3))
        for layer, kept in zip(layers, before, strict=True):
            assert np.array_equal(layer, kept)
            assert not np.shares_memory(layer, result)
        alone = composite(layers[1:2])
        assert not np.shares_memory(layers[1], alone)
        alone[...] = 7
        assert np.array_equal(layers[1], before[1])

    @pytest.mark.parametrize("order", ORDERS)
    def test_views_of_any_stride(self, composite, order):
        whole = np.random.default_rng(10).random((3, 12, 9, 8)).astype(np.float32)
        views = whole[:, ::-2, 1::3, 6:2:-1]
        assert not views[0].flags.c_contiguous
        expected = composite([view.copy() for view in views], order=order)
        assert composite(list(views), order=order).tobytes() == expected.tobytes()

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_pixels_do_not_depend_on_their_block(self, composite, dtype, order):
        rng = np.random.default_rng(11)
        layers = rng.random((3, MANY_PIXELS, 4)).astype(dtype)
        layers[:, :, :3] *= layers[:, :, 3:]
        # Greys, empty pixels and near hues take other paths: every block must have some.
        layers[1, ::5, :3] = layers[1, ::5, :1]
        layers[2, ::3] = 0
        layers[1, ::4, :3] = 0.7 * layers[0, ::4, :3]
        whole = composite(list(layers), order=order, background=(0.1, 0.2, 0.3))
        for lengths in ([1, 6, 16384, 16383], [1000, 32768, 20000]):
            edges = np.cumsum([0, *lengths, MANY_PIXELS - sum(lengths)])
            for start, stop in itertools.pairwise(edges):
                part = composite(
                    list(layers[:, start:stop]), order=order, background=(0.1, 0.2, 0.3)
                )
                assert part.tobytes() == whole[start:stop].tobytes()
        square = composite(
            list(layers[:, :65536].reshape(3, 256, 256, 4)), order=order, background=(0.1, 0.2, 0.3)
        )
        assert square.tobytes() == whole[:65536].tobytes()

    def test_layers_are_any_sequence(self, composite):
        layers = np.random.default_rng(12).random((3, 5, 4))
        expected = composite(list(layers))
        assert composite(layers).tolist() == expected.tolist()
        assert composite(tuple(layers)).tolist() == expected.tolist()
        nested = composite(layers.tolist())
        assert_near(nested, expected, FLOAT32)

    def test_twice_the_same_bytes(self, composite):
        layers = list(corpus(4))
        for order in self.ORDERS[:-1]:
            first, second = (composite(layers, order=order) for _ in range(2))
            assert first.tobytes() == second.tobytes()


class TestArguments:
    LAYERS = [np.full((2, 4), 0.5)] * 2

    @pytest.mark.parametrize(
        ("arguments", "valid"),
        [
            ({"op": "normal"}, OPERATOR_NAMES),
            ({"op": [None, "normal"]}, OPERATOR_NAMES),
            ({"blending": "additive"}, BLENDING_NAMES),
            ({"order": "middle-out"}, ORDER_NAMES),
            ({"space": "srgb"}, ("linear-rgb",)),
        ],
    )
    def test_an_unknown_name_is_an_error_that_lists_the_valid_ones(
        self, composite, arguments, valid
    ):
        with pytest.raises(SettingError) as caught:
            composite(self.LAYERS, **arguments)
        for name in valid:
            assert name in str(caught.value)
        assert caught.value.exit_code == ExitCode.USAGE
        assert isinstance(caught.value, HpcompError)
        assert isinstance(caught.value, ValueError)

    @pytest.mark.parametrize(
        "op", [["over", "over"], [None], [None] * 3, [None, "over", "over"], []]
    )
    def test_one_operator_a_layer_and_none_for_the_bottom(self, composite, op):
        with pytest.raises(SettingError):
            composite(self.LAYERS, op=op)

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDER_NAMES)
    @pytest.mark.parametrize("blending", BLENDING_NAMES)
    def test_a_layer_above_the_bottom_needs_an_operator(self, composite, blending, order):
        with pytest.raises(SettingError):
            composite(self.LAYERS, op=[None, None], blending=blending, order=order)

    @pytest.mark.parametrize("gray_bias", [-0.1, 1.1, np.nan, np.inf])
    def test_a_bias_out_of_range_is_an_error(self, composite, gray_bias):
        with pytest.raises(SettingError, match=r"gray bias .* is outside 0 to 1"):
            composite(self.LAYERS, gray_bias=gray_bias)

    @pytest.mark.parametrize("hue_tolerance", [-1.0, np.nan, np.inf])
    def test_a_tolerance_out_of_range_is_an_error(self, composite, hue_tolerance):
        with pytest.raises(SettingError):
            composite(self.LAYERS, hue_tolerance=hue_tolerance)

    def test_no_layers_is_an_error(self, composite):
        with pytest.raises(HpcompError):
            composite([])

    @pytest.mark.parametrize("shape", [(3,), (2, 3), (5,), (4, 0), ()])
    def test_not_four_components_is_an_error(self, composite, shape):
        with pytest.raises(HpcompError):
            composite([np.zeros(shape)])

    @pytest.mark.parametrize("other", [(3, 4), (4,), (1, 4), (2, 1, 4), (2, 3)])
    def test_layers_of_different_shapes_are_an_error(self, composite, other):
        # Broadcasting would hide a layer of the wrong size.
        with pytest.raises(HpcompError):
            composite([np.zeros((2, 4)), np.zeros(other)])

    def test_an_unknown_argument_is_an_error(self, composite):
        with pytest.raises(TypeError):
            composite(self.LAYERS, hue_tolerence=2.0)


@pytest.mark.parametrize(
    "before",
    ["", "hpcomp.hue_add", "import hpcomp.engine.arrays", "from hpcomp.engine.arrays import hue_add"],
)
def test_the_package_offers_the_function_whatever_was_imported_before(before):
    # A function and the module it lives in must not share a name: importing the module, even on
    # the way to another name, must not put it in the function's place.
    code = f"import hpcomp\n{before}\nassert callable(hpcomp.composite), hpcomp.composite"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
