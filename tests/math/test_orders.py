"""Weights and blend orders: a stack as a weighted sum, and the laws of each way to reduce it."""

import itertools
import math
import time

import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import (
    HUE_TOLERANCES,
    ORDER_NAMES,
    color_of,
    gray_biases,
    hue_tolerances,
    hues,
    operators,
    orders,
    stacks,
)
from tolerances import ANGLE_DEG, FLOAT32, FLOAT64, HARD_SWITCH, HAS_HUE, ROUNDING, assert_near

from hpcomp.blending.orders import ORDERS
from hpcomp.engine.arrays import hue_add
from hpcomp.errors import SettingError

#: Three labels no two of which have a hue in common, as strong as each other.
THREE_HUES = [color_of(hue, 0.1, 0.3) for hue in (0, 120, 240)]

#: Pairs of neighbours, level by level; the odd one goes up.
BALANCED_TREES = {
    1: 0,
    2: (0, 1),
    3: ((0, 1), 2),
    4: ((0, 1), (2, 3)),
    5: (((0, 1), (2, 3)), 4),
    6: (((0, 1), (2, 3)), (4, 5)),
    7: (((0, 1), (2, 3)), ((4, 5), 6)),
}


def reduced(composite, colors, order, hue_tolerance=2.0, **rules):
    """The colours alone, reduced in that order: `plus` of glows has weight 1 for each of them."""
    layers = [np.array([*c, 0.0]) for c in colors]
    return composite(layers, op="plus", order=order, hue_tolerance=hue_tolerance, **rules)[..., :3]


def simultaneous(composite, colors, hue_tolerance=2.0, **rules):
    return reduced(composite, colors, "simultaneous", hue_tolerance, **rules)


def chroma(c):
    return oracle.length(oracle.difference(tuple(float(component) for component in c)))


def angle_deg(c1, c2):
    d1, d2 = (oracle.difference(tuple(float(x) for x in c)) for c in (c1, c2))
    return math.degrees(oracle.angle(d1, d2))


def size_of(colors):
    return sum(max(abs(float(component)) for component in c[:3]) for c in colors) + 1e-300


def tolerance_of(hue_tolerance):
    return FLOAT64 if hue_tolerance else HARD_SWITCH


def test_the_orders_are_these():
    assert tuple(ORDERS) == ORDER_NAMES


class TestWeights:
    """§1.4: the colour of any stack is a reduction of w_i c_i; w depends on alphas alone."""

    @given(data=st.data(), order=orders, hue_tolerance=hue_tolerances)
    def test_a_stack_is_the_reduction_of_its_weighted_terms(
        self, composite, data, order, hue_tolerance
    ):
        layers = data.draw(stacks(hue_tolerance))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        w, alpha = oracle.weights([layer[3] for layer in layers], ops)
        terms = [oracle.scaled(w_i, layer[:3]) for w_i, layer in zip(w, layers, strict=True)]
        expected = reduced(composite, terms, order, hue_tolerance)
        actual = composite(
            [np.array(layer) for layer in layers], op=ops, order=order, hue_tolerance=hue_tolerance
        )
        assert_near(actual[:3], expected, tolerance_of(hue_tolerance), size_of(layers))
        assert_near(actual[3], alpha, ROUNDING)

    @given(data=st.data(), order=orders)
    def test_colour_does_not_change_weights(self, composite, data, order):
        # Greys add like numbers in every order: what comes out is the sum of the weights.
        layers = data.draw(stacks(hdr=False))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        w, _ = oracle.weights([layer[3] for layer in layers], ops)
        greys = [np.array([1.0, 1.0, 1.0, layer[3]]) for layer in layers]
        result = composite(greys, op=ops, order=order)
        assert_near(result[:3], [sum(w)] * 3, FLOAT64)

    def test_over_weighs_by_what_shows_through(self, composite):
        layers = [np.array([*c, 0.5]) for c in np.eye(3) * 0.5]
        result = composite(layers, blending="traditional")
        assert_near(result, [0.125, 0.25, 0.5, 0.875], ROUNDING)

    @given(data=st.data())
    def test_for_plus_the_order_has_no_effect(self, composite, data):
        layers = data.draw(stacks())
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        permutation = data.draw(st.permutations(range(len(layers))))
        arrays = [np.array(layer) for layer in layers]
        results = [
            composite(arrays, op=ops, blending="traditional", order=order)
            for order in (*ORDER_NAMES, permutation)
        ]
        for result in results[1:]:
            assert_near(result, results[0], FLOAT64, size_of(layers) + 1)

    def test_for_hue_preserving_the_order_has_an_effect(self, composite):
        # The paper, §5: three colours of which any two give grey have three possible results.
        results = {
            order: reduced(composite, THREE_HUES, order) for order in ("0,1,2", "1,2,0", "2,0,1")
        }
        for last, result in zip((240, 0, 120), results.values(), strict=True):
            assert_near(result, color_of(last, 0.1, 0.9), FLOAT64)

    @given(data=st.data(), order=orders, hue_tolerance=hue_tolerances)
    def test_luminance_is_that_of_plus(self, composite, data, order, hue_tolerance):
        layers = data.draw(stacks(hue_tolerance))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        arrays = [np.array(layer) for layer in layers]
        preserving = composite(arrays, op=ops, order=order, hue_tolerance=hue_tolerance)
        plus = composite(arrays, op=ops, blending="traditional")
        size = size_of(layers)
        assert_near(oracle.luminance(preserving), oracle.luminance(plus), FLOAT64, size)
        assert_near(preserving[3], plus[3], ROUNDING)

    @given(data=st.data(), order=orders, hue_tolerance=hue_tolerances)
    def test_every_order_stays_in_gamut(self, composite, data, order, hue_tolerance):
        layers = data.draw(stacks(hue_tolerance, hdr=False))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        w, _ = oracle.weights([layer[3] for layer in layers], ops)
        result = composite(
            [np.array(layer) for layer in layers], op=ops, order=order, hue_tolerance=hue_tolerance
        )
        most = sum(w_i * layer[3] for w_i, layer in zip(w, layers, strict=True))
        assert np.all(result[:3] >= -FLOAT64)
        assert np.all(result[:3] <= most + FLOAT64)


class TestFolds:
    @given(data=st.data(), hue_tolerance=hue_tolerances)
    def test_a_permutation_is_a_left_fold(self, composite, data, hue_tolerance):
        colors = [layer[:3] for layer in data.draw(stacks(hue_tolerance))]
        permutation = data.draw(st.permutations(range(len(colors))))
        expected = np.array(colors[permutation[0]])
        for number in permutation[1:]:
            expected = hue_add(expected, np.array(colors[number]), hue_tolerance=hue_tolerance)
        for order in (permutation, tuple(permutation), ",".join(map(str, permutation))):
            result = reduced(composite, colors, order, hue_tolerance)
            assert_near(result, expected, tolerance_of(hue_tolerance), size_of(colors))

    @given(data=st.data(), hue_tolerance=hue_tolerances)
    def test_the_named_folds_are_permutations(self, composite, data, hue_tolerance):
        layers = data.draw(stacks(hue_tolerance))
        ops = [None, *(data.draw(operators) for _ in layers[1:])]
        arrays = [np.array(layer) for layer in layers]
        numbers = list(range(len(layers)))
        for name, permutation in (("bottom-up", numbers), ("top-down", numbers[::-1])):
            results = [
                composite(arrays, op=ops, order=order, hue_tolerance=hue_tolerance)
                for order in (name, permutation)
            ]
            size = size_of(layers) + 1
            assert_near(results[0], results[1], tolerance_of(hue_tolerance), size)

    def test_bottom_up_is_the_default(self, composite):
        layers = [np.array([*c, 0.5]) for c in THREE_HUES]
        assert composite(layers).tolist() == composite(layers, order="bottom-up").tolist()
        assert composite(layers).tolist() != composite(layers, order="top-down").tolist()


class TestBalanced:
    def by_tree(self, tree, colors, hue_tolerance):
        if isinstance(tree, int):
            return np.array(colors[tree])
        left, right = (self.by_tree(part, colors, hue_tolerance) for part in tree)
        return hue_add(left, right, hue_tolerance=hue_tolerance)

    @pytest.mark.parametrize("n", BALANCED_TREES)
    @given(data=st.data(), hue_tolerance=hue_tolerances)
    def test_is_this_tree(self, composite, n, data, hue_tolerance):
        colors = [layer[:3] for layer in data.draw(stacks(hue_tolerance, n, n))]
        expected = self.by_tree(BALANCED_TREES[n], colors, hue_tolerance)
        result = reduced(composite, colors, "balanced", hue_tolerance)
        assert_near(result, expected, tolerance_of(hue_tolerance), size_of(colors))

    def test_transparency_does_not_change_the_tree(self, composite):
        a, b, c = THREE_HUES
        nothing = (0.0, 0.0, 0.0)
        # (a ⊕ 0) ⊕ (b ⊕ c): b and c make grey, and a is left. Without the empty layer c would be.
        result = reduced(composite, [a, nothing, b, c], "balanced")
        assert_near(result, color_of(0, 0.1, 0.9), FLOAT64)
        without = reduced(composite, [a, b, c], "balanced")
        assert_near(without, color_of(240, 0.1, 0.9), FLOAT64)


class TestSimultaneous:
    @given(data=st.data(), hue_tolerance=hue_tolerances)
    def test_permutation_invariant(self, composite, data, hue_tolerance):
        colors = [layer[:3] for layer in data.draw(stacks(hue_tolerance, min_size=2))]
        shuffled = data.draw(st.permutations(colors))
        first, second = (simultaneous(composite, c, hue_tolerance) for c in (colors, shuffled))
        assert_near(first, second, tolerance_of(hue_tolerance), size_of(colors))

    @given(data=st.data(), hue_tolerance=hue_tolerances)
    def test_two_terms_are_plus_in_a_circle(self, composite, data, hue_tolerance):
        c1, c2 = (layer[:3] for layer in data.draw(stacks(hue_tolerance, 2, 2)))
        expected = hue_add(np.array(c1), np.array(c2), hue_tolerance=hue_tolerance)
        result = simultaneous(composite, [c1, c2], hue_tolerance)
        assert_near(result, expected, tolerance_of(hue_tolerance), size_of([c1, c2]))

    @given(data=st.data(), hue_tolerance=hue_tolerances, k=st.floats(1e-3, 1e3))
    def test_homogeneous(self, composite, data, hue_tolerance, k):
        colors = [layer[:3] for layer in data.draw(stacks(hue_tolerance))]
        expected = k * simultaneous(composite, colors, hue_tolerance)
        scaled = [oracle.scaled(k, c) for c in colors]
        result = simultaneous(composite, scaled, hue_tolerance)
        assert_near(result, expected, tolerance_of(hue_tolerance), k * size_of(colors))

    @given(
        base=hues,
        groups=st.lists(
            st.lists(st.floats(0.01, 1), min_size=1, max_size=4), min_size=2, max_size=3
        ),
        hue_tolerance=hue_tolerances,
        data=st.data(),
    )
    def test_clear_cut_groups_leave_the_largest_minus_the_runner_up(
        self, composite, base, groups, hue_tolerance, data
    ):
        # Groups 120° apart, members of a group of one hue.
        colors = [
            color_of(base + 120 * number, m, 1.0) for number, g in enumerate(groups) for m in g
        ]
        colors = data.draw(st.permutations(colors))
        totals = sorted(((sum(g), number) for number, g in enumerate(groups)), reverse=True)
        (largest, winner), (runner_up, _) = totals[:2]
        result = simultaneous(composite, colors, hue_tolerance)
        expected = color_of(base + 120 * winner, largest - runner_up, float(len(colors)))
        assert_near(result, expected, tolerance_of(hue_tolerance), size_of(colors))

    def test_many_weak_ones_beat_a_strong_one(self, composite):
        # What folding two by two cannot see: five of chroma 0.1 against one of 0.3.
        colors = [color_of(40, 0.1, 0.3)] * 5 + [color_of(200, 0.3, 0.3)]
        for order in itertools.permutations(colors):
            assert_near(simultaneous(composite, order), color_of(40, 0.2, 1.8), FLOAT64)

    @given(
        base=hues,
        chromas=st.lists(st.floats(0.05, 1), min_size=2, max_size=6),
        hue_tolerance=st.sampled_from([0.5, 2.0, 10.0]),
    )
    def test_a_chain_of_near_hues(self, composite, base, chromas, hue_tolerance):
        # Each is of one hue with its neighbours, the ends are not with each other.
        colors = [color_of(base + 0.8 * hue_tolerance * i, m, 1.0) for i, m in enumerate(chromas)]
        result = simultaneous(composite, colors, hue_tolerance)
        assert_near(result, oracle.simultaneous(colors, hue_tolerance), FLOAT64, size_of(colors))
        if chroma(result) > HAS_HUE:
            # The hue is within the chain, as nothing is scaled below zero.
            ends = angle_deg(result, colors[0]) + angle_deg(result, colors[-1])
            assert_near(ends, 0.8 * hue_tolerance * (len(colors) - 1), ANGLE_DEG)

    @given(
        base=hues,
        chromas=st.lists(st.floats(0.05, 1), min_size=1, max_size=6),
        place=st.integers(0, 5),
        other_hue=hues,
        in_chain=st.booleans(),
        exponent=st.integers(-15, -3),
        hue_tolerance=st.sampled_from([0.5, 2.0, 10.0]),
    )
    def test_a_vanishing_term_changes_nothing(
        self, composite, base, chromas, place, other_hue, in_chain, exponent, hue_tolerance
    ):
        # Its effect is bounded by a few times its chroma for each pair of terms; counting terms
        # (a cap of n·m_j) would let the result of a chain jump when one appears.
        spacing = 0.8 * hue_tolerance
        colors = [color_of(base + spacing * i, m, 1.0) for i, m in enumerate(chromas)]
        hue = base + spacing * place if in_chain else other_hue
        vanishing = color_of(hue, 10.0**exponent, 0.0)
        absent = simultaneous(composite, colors, hue_tolerance)
        present = simultaneous(composite, [*colors, vanishing], hue_tolerance)
        pairs = (len(colors) + 1) ** 2
        assert_near(present, absent, 4 * pairs * 10.0**exponent + FLOAT64)

    @given(data=st.data(), exponent=st.integers(-9, -4))
    def test_a_small_step_is_a_small_change(self, composite, data, exponent):
        colors = [layer[:3] for layer in data.draw(stacks(min_size=2, hdr=False))]
        step = 10.0**exponent * np.array(data.draw(st.tuples(*[st.floats(-1, 1)] * 3)))
        moved = [np.array(colors[0]) + step, *colors[1:]]
        change = simultaneous(composite, moved) - simultaneous(composite, colors)
        # The slope of ⊕ at 2°, 1 + 3/τ, for each pair that the step takes part in.
        slope = len(colors) ** 2 * (1 + 3 / math.radians(2))
        assert np.linalg.norm(change) <= slope * np.linalg.norm(step) + FLOAT64

    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    @given(data=st.data(), place=st.integers(0, 6), grey=st.sampled_from([0.0, 0.25]))
    def test_a_layer_without_chroma_drops_out(self, composite, hue_tolerance, data, place, grey):
        colors = [layer[:3] for layer in data.draw(stacks(hue_tolerance))]
        without = simultaneous(composite, colors, hue_tolerance)
        with_it = simultaneous(
            composite, [*colors[:place], (grey,) * 3, *colors[place:]], hue_tolerance
        )
        assert_near(with_it, without + grey, ROUNDING, size_of(colors) + grey)

    @given(data=st.data(), place=st.integers(1, 6), op=st.sampled_from(["over", "plus", "xor"]))
    def test_an_added_transparent_layer_changes_nothing(self, composite, data, place, op):
        layers = [np.array(layer) for layer in data.draw(stacks())]
        more = [*layers[:place], np.zeros(4), *layers[place:]]
        result = composite(layers, op=op, order="simultaneous")
        assert composite(more, op=op, order="simultaneous").tolist() == result.tolist()

    @pytest.mark.pairwise
    @pytest.mark.parametrize(("dtype", "tiny"), [(np.float64, 1e-310), (np.float32, 1e-40)])
    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    def test_subnormal_terms(self, composite, dtype, tiny, hue_tolerance):
        # Finite, and without a warning: ratios of chromas leave the range of the type here.
        colors = [color_of(0, 0.2, 0.5), color_of(100, tiny, 0.0), color_of(190, tiny, 0.0)]
        for order in itertools.permutations(colors):
            layers = [np.array([*c, 0.0], dtype) for c in order]
            result = composite(layers, op="plus", order="simultaneous", hue_tolerance=hue_tolerance)
            assert_near(result[:3], colors[0], FLOAT32)

    def test_cost_follows_the_terms_that_are_there(self, composite):
        # Labels seldom overlap: of 32 layers three show in a pixel, other ones in each. All pairs
        # of all layers are a hundred times the work; half of it is asked for, to be safe.
        rng = np.random.default_rng(7)
        crowded = rng.random((32, 600, 4))
        sparse = np.zeros_like(crowded)
        for pixel in range(sparse.shape[1]):
            there = rng.choice(32, 3, replace=False)
            sparse[there, pixel] = crowded[there, pixel]

        def seconds(layers):
            best = math.inf
            for _ in range(3):
                start = time.process_time()
                composite(list(layers), op="plus", order="simultaneous")
                best = min(best, time.process_time() - start)
            return best

        assert seconds(sparse) < 0.5 * seconds(crowded)


class TestGrayBias:
    """§1.7, where more than two colours meet; of two it is `test_addition`'s."""

    @given(data=st.data(), hue_tolerance=hue_tolerances, gray_bias=gray_biases)
    def test_two_terms_are_plus_in_a_circle(self, composite, data, hue_tolerance, gray_bias):
        c1, c2 = (layer[:3] for layer in data.draw(stacks(hue_tolerance, 2, 2)))
        rules = {"hue_tolerance": hue_tolerance, "gray_bias": gray_bias}
        expected = hue_add(np.array(c1), np.array(c2), **rules)
        for order in ORDER_NAMES:
            result = reduced(composite, [c1, c2], order, **rules)
            assert_near(result, expected, tolerance_of(hue_tolerance), size_of([c1, c2]))

    @given(data=st.data(), gray_bias=gray_biases)
    def test_simultaneous_is_permutation_invariant(self, composite, data, gray_bias):
        colors = [layer[:3] for layer in data.draw(stacks(min_size=2))]
        shuffled = data.draw(st.permutations(colors))
        first, second = (
            simultaneous(composite, c, gray_bias=gray_bias) for c in (colors, shuffled)
        )
        assert_near(first, second, FLOAT64, size_of(colors))

    @given(
        groups=st.lists(
            st.lists(st.floats(0.01, 1), min_size=1, max_size=4), min_size=2, max_size=3
        ),
        gray_bias=gray_biases,
    )
    def test_the_largest_group_is_left_less_the_power_of_the_runner_up(
        self, composite, groups, gray_bias
    ):
        colors = [color_of(120 * number, m, 1.0) for number, g in enumerate(groups) for m in g]
        totals = [sum(group) for group in groups]
        expected = 0
        for number, total in enumerate(totals):
            rival = max(other for i, other in enumerate(totals) if i != number)
            left = 1 - min(1, rival / total) ** (1 + 3 * gray_bias)
            expected = expected + left * np.array(color_of(120 * number, total, 0.0))
        result = simultaneous(composite, colors, gray_bias=gray_bias)
        assert_near(result, expected + len(colors), FLOAT64, size_of(colors))

    @pytest.mark.pairwise
    @pytest.mark.parametrize("order", ORDER_NAMES)
    @pytest.mark.parametrize("gray_bias", [0.0, 0.2, 1.0])
    def test_continuous_along_random_paths(self, composite, order, gray_bias):
        # Three colours at a time, each on its own way through the gamut. Every ⊕ that a colour goes
        # through multiplies its step by 1 + 3b + 3/τ at most; `simultaneous` does so once for each
        # pair. Single precision, so that the kernel is meant, adds its rounding.
        tolerance = 30.0
        rng = np.random.default_rng(15)
        corners = rng.random((3, 60, 3))
        corners[:, ::3] = corners[:, ::3].round()
        corners[1, ::7] = 0.4 * corners[0, ::7]
        steps = np.linspace(0, 1, 2000, endpoint=False)[:, None, None]
        paths = [c[None, :-1] + steps * np.diff(c, axis=0)[None] for c in corners]
        colors = np.array([path.swapaxes(0, 1).reshape(-1, 3) for path in paths], np.float32)
        layers = np.concatenate([colors, np.zeros((*colors.shape[:2], 1), np.float32)], axis=2)
        rules = {"op": "plus", "order": order, "hue_tolerance": tolerance, "gray_bias": gray_bias}
        result = composite(list(layers), **rules)[:, :3].astype(np.float64)
        moved = np.linalg.norm(np.diff(colors.astype(np.float64), axis=1), axis=2).sum(axis=0)
        changes = np.linalg.norm(np.diff(result, axis=0), axis=1)
        slope = 1 + 3 * gray_bias + 3 / math.radians(tolerance)
        multiple = math.sqrt(3) + (9 * slope if order == "simultaneous" else slope**2)
        assert np.all(changes <= multiple * moved + FLOAT32)
        # The same without a shoulder jumps.
        hard = composite(list(layers), **{**rules, "hue_tolerance": 0})[:, :3].astype(np.float64)
        jumps = np.linalg.norm(np.diff(hard, axis=0), axis=1)
        assert np.any(jumps > multiple * moved + FLOAT32)


class TestArguments:
    LAYERS = [np.full((2, 4), 0.5)] * 3

    @pytest.mark.parametrize(
        "order", ["", "bottom", "topdown", "random", "Bottom-Up", "2;0;1", "a,b,c", "0.0,1,2"]
    )
    def test_an_unknown_order_is_an_error_that_lists_the_valid_ones(self, composite, order):
        with pytest.raises(SettingError) as caught:
            composite(self.LAYERS, order=order)
        for valid in ORDER_NAMES:
            assert valid in str(caught.value)

    @pytest.mark.parametrize(
        "order",
        ["0,1", "0,1,1", "0,1,2,3", "1,2,3", "-1,0,1", "2", [0, 1], [0, 0, 1], [0, 1, 3], []],
    )
    def test_a_sequence_that_is_no_permutation_of_the_layers_is_an_error(self, composite, order):
        with pytest.raises(SettingError):
            composite(self.LAYERS, order=order)

    @pytest.mark.parametrize("order", ["2,0,1", [2, 0, 1], (2, 0, 1), np.array([2, 0, 1])])
    def test_a_permutation_is_text_or_a_sequence(self, composite, order):
        expected = composite(self.LAYERS, order="2,0,1")
        assert composite(self.LAYERS, order=order).tolist() == expected.tolist()
