"""The laws of c₁ ⊕ c₂, each as a property, and the points that define its tolerance."""

import math

import numpy as np
import oracle
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from strategies import (
    HUE_TOLERANCES,
    alphas,
    any_pairs,
    color_of,
    gray_biases,
    hue_direction,
    hue_tolerances,
    hues,
    shares,
    valid_color,
    valid_pairs,
)
from tolerances import ANGLE_DEG, FLOAT32, FLOAT64, HARD_SWITCH, HAS_HUE, ROUNDING, assert_near

from hpcomp.blending import addition
from hpcomp.engine.arrays import hue_add
from hpcomp.errors import HpcompError, SettingError

# Cosine and sine of the defining angles are rounded, and the shoulder's slope, 1.5/τ a radian,
# turns that into some more.
SHOULDER = 1e-12

RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
PRIMARIES = (RED, GREEN, BLUE)

chromas = st.floats(0.01, 1)


def colors(pair):
    """Of two layers (R, G, B, alpha): the two colours, and the largest value in them."""
    c1, c2 = (np.array(layer[:3]) for layer in pair)
    return c1, c2, max(np.abs(c1).max(), np.abs(c2).max()) + 1e-300


def difference(c):
    return oracle.difference(tuple(float(component) for component in c))


def chroma(c):
    return oracle.length(difference(c))


def angle_deg(c1, c2):
    return math.degrees(oracle.angle(difference(c1), difference(c2)))


def tolerance_of(hue_tolerance):
    return FLOAT64 if hue_tolerance else HARD_SWITCH


class TestAgainstAlgorithm1:
    @given(pair=any_pairs, hue_tolerance=hue_tolerances)
    def test_is_the_oracles(self, pair, hue_tolerance):
        c1, c2, size = colors(pair)
        expected = oracle.hue_add(pair[0][:3], pair[1][:3], hue_tolerance)
        actual = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        assert_near(actual, expected, tolerance_of(hue_tolerance), size)

    @given(pair=valid_pairs(0.0))
    def test_closed_form_is_algorithm_1(self, pair):
        c1, c2, size = colors(pair)
        expected = oracle.algorithm_1(pair[0][:3], pair[1][:3])
        assert_near(hue_add(c1, c2, hue_tolerance=0), expected, HARD_SWITCH, size)

    def test_many_at_once(self):
        c1, c2 = np.random.default_rng(2).random((2, 500, 3))
        expected = [oracle.algorithm_1(a, b) for a, b in zip(c1.tolist(), c2.tolist(), strict=True)]
        assert_near(hue_add(c1, c2, hue_tolerance=0), expected, ROUNDING)

    def test_single_precision(self):
        c1, c2 = np.random.default_rng(3).random((2, 500, 3)).astype(np.float32)
        expected = [oracle.hue_add(a, b) for a, b in zip(c1.tolist(), c2.tolist(), strict=True)]
        actual = hue_add(c1, c2)
        assert actual.dtype == np.float32
        assert_near(actual, expected, FLOAT32)


class TestLaws:
    """§1.2; they hold at every tolerance."""

    @given(pair=any_pairs, hue_tolerance=hue_tolerances)
    def test_commutative(self, pair, hue_tolerance):
        c1, c2, size = colors(pair)
        there = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        assert_near(there, hue_add(c2, c1, hue_tolerance=hue_tolerance), ROUNDING, size)

    @given(pair=any_pairs, hue_tolerance=hue_tolerances, k=st.floats(1e-3, 1e3))
    def test_homogeneous(self, pair, hue_tolerance, k):
        c1, c2, size = colors(pair)
        expected = k * hue_add(c1, c2, hue_tolerance=hue_tolerance)
        actual = hue_add(k * c1, k * c2, hue_tolerance=hue_tolerance)
        assert_near(actual, expected, tolerance_of(hue_tolerance), k * size)

    @given(pair=any_pairs, hue_tolerance=hue_tolerances, exponent=st.integers(-20, 20))
    def test_homogeneous_to_the_last_bit_in_powers_of_two(self, pair, hue_tolerance, exponent):
        # Scaling by 2ⁿ rounds nothing, unless it leaves the range of normal doubles.
        c1, c2, _ = colors(pair)
        assume(all(c == 0 or abs(c) > 1e-100 for c in (*c1, *c2)))
        assume(all(m == 0 or m > 1e-100 for m in (chroma(c1), chroma(c2))))
        k = 2.0**exponent
        expected = k * hue_add(c1, c2, hue_tolerance=hue_tolerance)
        actual = hue_add(k * c1, k * c2, hue_tolerance=hue_tolerance)
        assert_near(actual, expected, ROUNDING, k * np.abs(np.concatenate([c1, c2])).max())

    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    def test_not_associative(self, hue_tolerance):
        # Three hues 120° apart with the same chroma: two of them give grey, the third one stays.
        a, b, c = (np.array(color_of(hue, 0.1, 0.3)) for hue in (0, 120, 240))

        def add(c1, c2):
            return hue_add(c1, c2, hue_tolerance=hue_tolerance)

        assert_near(add(add(a, b), c), color_of(240, 0.1, 0.9), FLOAT64)
        assert_near(add(a, add(b, c)), color_of(0, 0.1, 0.9), FLOAT64)

    @given(pair=any_pairs, hue_tolerance=hue_tolerances)
    def test_luminance_adds(self, pair, hue_tolerance):
        c1, c2, size = colors(pair)
        result = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        expected = oracle.luminance(pair[0]) + oracle.luminance(pair[1])
        assert_near(oracle.luminance(result), expected, ROUNDING, size)

    @given(pair=any_pairs)
    def test_hue_is_an_inputs_at_tolerance_0(self, pair):
        c1, c2, size = colors(pair)
        result = hue_add(c1, c2, hue_tolerance=0)
        assume(chroma(result) > HAS_HUE * size)
        apart = angle_deg(c1, c2) if min(chroma(c1), chroma(c2)) > HAS_HUE * size else 180.0
        nearest = min(angle_deg(result, c) for c in (c1, c2) if chroma(c) > 0)
        if apart > math.degrees(1.001 * oracle.ROUNDING_ANGLE):
            assert nearest <= ANGLE_DEG
        else:
            assert nearest <= math.degrees(oracle.ROUNDING_ANGLE)

    @given(pair=any_pairs, hue_tolerance=st.sampled_from([0.5, 2.0, 10.0]))
    def test_hue_is_an_inputs_within_twice_the_tolerance(self, pair, hue_tolerance):
        c1, c2, size = colors(pair)
        result = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        assume(chroma(result) > HAS_HUE * size)
        nearest = min(angle_deg(result, c) for c in (c1, c2) if chroma(c) > 0)
        assert nearest <= 2 * hue_tolerance + ANGLE_DEG

    @given(
        hue=hues,
        apart=st.floats(0, 180),
        m1=chromas,
        m2=chromas,
        hue_tolerance=st.sampled_from([0.5, 2.0, 10.0]),
    )
    def test_hue_lies_between_near_hues_and_is_one_of_distinct_ones(
        self, hue, apart, m1, m2, hue_tolerance
    ):
        c1, c2 = color_of(hue, m1, 1), color_of(hue + apart, m2, 1)
        result = hue_add(np.array(c1), np.array(c2), hue_tolerance=hue_tolerance)
        assume(chroma(result) > HAS_HUE)
        angles = angle_deg(result, c1), angle_deg(result, c2)
        if apart > 2 * hue_tolerance + ANGLE_DEG:
            assert min(angles) <= ANGLE_DEG
        else:
            # Neither input's hue, perhaps, but none outside them.
            assert_near(sum(angles), apart, ANGLE_DEG)

    @given(pair=any_pairs, grey=st.floats(-10, 1e4), hue_tolerance=hue_tolerances)
    def test_greys_are_neutral(self, pair, grey, hue_tolerance):
        c, _, size = colors(pair)
        for result in (
            hue_add(c, np.full(3, grey), hue_tolerance=hue_tolerance),
            hue_add(np.full(3, grey), c, hue_tolerance=hue_tolerance),
        ):
            assert_near(result, c + grey, ROUNDING, size + abs(grey))

    @given(
        hue=hues,
        chromas=st.tuples(chromas, chromas),
        luminances=st.tuples(shares, shares),
        hue_tolerance=hue_tolerances,
    )
    def test_equal_to_plus_for_equal_and_opposite_hues(
        self, hue, chromas, luminances, hue_tolerance
    ):
        c1 = np.array(color_of(hue, chromas[0], luminances[0]))
        for turned in (0, 180):
            c2 = np.array(color_of(hue + turned, chromas[1], luminances[1]))
            result = hue_add(c1, c2, hue_tolerance=hue_tolerance)
            assert_near(result, c1 + c2, tolerance_of(hue_tolerance))

    @given(
        hue=hues,
        apart=st.floats(25, 180),
        m1=chromas,
        m2=chromas,
        hue_tolerance=hue_tolerances,
    )
    def test_dominant_colour_is_the_one_nearest_in_hue_to_plus(
        self, hue, apart, m1, m2, hue_tolerance
    ):
        assume(abs(m1 - m2) > HAS_HUE)
        c1 = np.array(color_of(hue, m1, 1))
        c2 = np.array(color_of(hue + apart, m2, 1))
        result = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        if angle_deg(c1 + c2, c1) < angle_deg(c1 + c2, c2):
            dominant, other = c1, c2
        else:
            dominant, other = c2, c1
        assert angle_deg(result, dominant) <= ANGLE_DEG
        assert_near(chroma(result), chroma(dominant) - chroma(other), ROUNDING)

    @given(data=st.data(), hue_tolerance=hue_tolerances)
    def test_closed_in_gamut(self, data, hue_tolerance):
        pair = data.draw(valid_pairs(hue_tolerance))
        c1, c2, _ = colors(pair)
        result = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        assert np.all(result >= -ROUNDING)
        assert np.all(result <= pair[0][3] + pair[1][3] + ROUNDING)

    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    def test_closed_in_gamut_on_its_edges(self, hue_tolerance):
        # The 26 points of the cube's corners, edge middles and face middles; every two of them.
        steps = np.array([0.0, 0.5, 1.0])
        points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        for alpha_1, alpha_2 in ((1, 1), (1, 0.25), (0.5, 0.75), (1, 0)):
            result = hue_add(
                alpha_1 * points[:, None], alpha_2 * points[None], hue_tolerance=hue_tolerance
            )
            assert result.shape == (27, 27, 3)
            assert result.min() >= -ROUNDING
            assert result.max() <= alpha_1 + alpha_2 + ROUNDING

    def test_red_green_and_blue_keep_the_stronger_hue(self):
        # Figure 5 of the paper: traditional + would make yellow, magenta, cyan of them.
        for c1 in PRIMARIES:
            for c2 in PRIMARIES:
                if c1 == c2:
                    continue
                result = hue_add(np.array(c1), np.array(c2))
                stronger = max(c1, c2, key=chroma)
                assert angle_deg(result, stronger) <= ANGLE_DEG
                assert_near(chroma(result), abs(chroma(c1) - chroma(c2)), ROUNDING)

    def test_opposite_colour_would_leave_the_gamut_but_the_sum_does_not(self):
        # The intermediate colour of Algorithm 1 is far below zero here; clamping it would show.
        c1, c2 = (0.25, 0.0, 1.0), (0.0, 0.0, 1.0)
        assert min(oracle.opposite_color(c1, c2)) < -0.8
        result = hue_add(np.array(c1), np.array(c2), hue_tolerance=0)
        assert_near(result, oracle.algorithm_1(c1, c2), ROUNDING)
        assert result.min() >= 0


class TestShoulder:
    """§1.3: e is 1 up to τ, 0 from 2τ on, a smoothstep of the angle between."""

    @staticmethod
    def e(apart_rad, hue_tolerance, m1=1.0, m2=1.0, hue_rad=0.7, dtype=np.float64):
        p1 = m1 * np.array([math.cos(hue_rad), math.sin(hue_rad)])
        p2 = m2 * np.array([math.cos(hue_rad + apart_rad), math.sin(hue_rad + apart_rad)])
        # Planes first, one pixel.
        p1, p2 = (p.astype(dtype)[:, None] for p in (p1, p2))
        (e,) = addition.shoulder(p1, p2, hue_tolerance)
        return float(e)

    @pytest.mark.parametrize("hue_tolerance", [0.1, 0.5, 1.0, 2.0, 10.0, 30.0, 45.0])
    @pytest.mark.parametrize("sign", [1, -1])
    def test_defining_points(self, hue_tolerance, sign):
        # (2τ − θ)/τ at these θ, and t²(3 − 2t) of it.
        for multiple, expected in (
            (0.0, 1.0),
            (0.5, 1.0),
            (1.0, 1.0),
            (1.25, 0.84375),
            (1.5, 0.5),
            (1.75, 0.15625),
            (2.0, 0.0),
            (2.5, 0.0),
            (3.0, 0.0),
        ):
            apart = sign * math.radians(multiple * hue_tolerance)
            assert_near(self.e(apart, hue_tolerance), expected, SHOULDER)

    @given(
        hue=st.floats(0, 6.3),
        apart=st.floats(-math.pi, math.pi),
        magnitudes=st.tuples(st.floats(1e-9, 1e5), st.floats(1e-9, 1e5)),
        hue_tolerance=st.floats(0.1, 60),
    )
    def test_depends_on_the_angle_alone(self, hue, apart, magnitudes, hue_tolerance):
        expected = oracle.shoulder(abs(apart), hue_tolerance)
        actual = self.e(apart, hue_tolerance, *magnitudes, hue_rad=hue)
        assert_near(actual, expected, SHOULDER)
        assert 0 <= actual <= 1

    def test_falls_steadily(self):
        angles = np.radians(np.linspace(0, 8, 4001))
        p1 = np.stack([np.ones_like(angles), np.zeros_like(angles)])
        e = addition.shoulder(p1, np.stack([np.cos(angles), np.sin(angles)]), 2.0)
        assert e.shape == angles.shape
        assert np.all(np.diff(e) <= SHOULDER)
        # The smoothstep is steepest at its middle: 1.5 over τ = 1000 steps.
        assert np.diff(e).min() >= -1.5 / 1000 - SHOULDER

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_tolerance_0_switches_at_the_rounding_angle(self, dtype):
        for apart, expected in ((0, 1), (5e-5, 1), (9e-5, 1), (1.1e-4, 0), (5e-4, 0), (0.1, 0)):
            for hue in (0.0, 0.7, 2.0, 4.0):
                assert self.e(apart, 0.0, hue_rad=hue, dtype=dtype) == expected
                assert self.e(-apart, 0.0, hue_rad=hue, dtype=dtype) == expected

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_tolerance_0_of_colours(self, dtype):
        # In RGB, with the rounding of the way to p: half and twice the switch.
        c1 = np.array(color_of(20, 0.4, 0.5))
        for apart_rad, kept in ((5e-5, True), (2e-4, False)):
            c2 = np.array(color_of(20 + math.degrees(apart_rad), 0.3, 0.4))
            result = hue_add(c1.astype(dtype), c2.astype(dtype), hue_tolerance=0)
            assert_near(chroma(result), 0.7 if kept else 0.1, FLOAT32)

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_single_precision_resolves_a_small_tolerance(self, dtype):
        # An arc cosine in single precision cannot tell angles below 0.02° from 0.
        for multiple, expected in ((0.9, 1.0), (1.5, 0.5), (2.1, 0.0)):
            apart = math.radians(multiple * 0.05)
            # 1.5/τ a radian, times the 6e-8 that rounding turns the vectors by.
            assert_near(self.e(apart, 0.05, dtype=dtype), expected, 1e-3)

    @given(
        hue_1=hues,
        # Of different hue at the default tolerance, and of one at 90°.
        apart=st.one_of(st.floats(2.001, 3.999), st.floats(2.001, 89.9)),
        side=st.sampled_from([1, -1]),
        chroma_1=chromas,
        chroma_2=chromas,
        luminance=st.floats(-1, 1e4),
    )
    def test_between_sum_and_difference_in_the_shoulder(
        self, hue_1, apart, side, chroma_1, chroma_2, luminance
    ):
        c1 = np.array(color_of(hue_1, chroma_1, 0.5))
        c2 = np.array(color_of(hue_1 + side * apart, chroma_2, luminance))
        whole = hue_add(c1, c2, hue_tolerance=90)
        none = hue_add(c1, c2, hue_tolerance=0)
        theta = oracle.angle(difference(c1), difference(c2))
        e = oracle.shoulder(theta, 2.0)
        assert oracle.shoulder(theta, 90.0) == 1
        assert e < 1
        size = max(np.abs(c1).max(), np.abs(c2).max())
        assert_near(hue_add(c1, c2), e * whole + (1 - e) * none, HARD_SWITCH, size)

    @pytest.mark.parametrize("hue_tolerance", [-1.0, -1e-9, math.nan, math.inf, 1000.0])
    def test_a_tolerance_out_of_range_is_an_error(self, hue_tolerance):
        with pytest.raises(SettingError):
            hue_add(np.array(RED), np.array(BLUE), hue_tolerance=hue_tolerance)


class TestContinuity:
    """[D3]: small changes of the inputs are small changes of the result."""

    @staticmethod
    def slope(hue_tolerance, gray_bias=0.0):
        """How much ⊕ can turn a change of one input into.

        The sum has slope 1 in p and Y, the difference 1 + 3b; they differ by up to 2|p_small|, of
        which the shoulder mixes 1.5/τ a radian, and a radian is at least |p_small| of change. Of Y
        the colour has √3 at most.
        """
        return 1 + 3 * gray_bias + 3 / math.radians(hue_tolerance) + math.sqrt(3)

    @given(
        pair=valid_pairs(),
        step=st.tuples(*[st.floats(-1, 1)] * 3),
        exponent=st.integers(-9, -2),
        hue_tolerance=st.sampled_from([0.5, 2.0, 10.0]),
    )
    def test_a_small_step_is_a_small_change(self, pair, step, exponent, hue_tolerance):
        c1, c2, _ = colors(pair)
        step = 10.0**exponent * np.array(step)
        change = hue_add(c1 + step, c2, hue_tolerance=hue_tolerance) - hue_add(
            c1, c2, hue_tolerance=hue_tolerance
        )
        bound = self.slope(hue_tolerance) * np.linalg.norm(step) + FLOAT64
        assert np.linalg.norm(change) <= bound

    @pytest.mark.parametrize("hue_tolerance", [0.5, 2.0, 10.0])
    @pytest.mark.parametrize("m2", [0.05, 0.2, 0.2000001, 0.4])
    def test_across_the_shoulder(self, hue_tolerance, m2):
        steps = 4000
        turned = np.linspace(-3 * hue_tolerance, 3 * hue_tolerance, steps + 1)
        c1 = np.array(color_of(33, 0.2, 0.5))
        c2 = np.array([color_of(33 + degrees, m2, 0.5) for degrees in turned])
        result = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        step = m2 * math.radians(6 * hue_tolerance / steps)
        changes = np.linalg.norm(np.diff(result, axis=0), axis=1)
        assert changes.max() <= self.slope(hue_tolerance) * step
        # And it does go all the way, from the difference to the sum.
        chromas = [chroma(c) for c in result]
        assert_near(min(chromas), abs(0.2 - m2), FLOAT64)
        assert_near(max(chromas), 0.2 + m2, FLOAT64)

    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    @pytest.mark.parametrize(
        ("c1", "c2"), [(RED, GREEN), (GREEN, BLUE), (RED, BLUE), (RED, (0, 1, 1))]
    )
    def test_through_grey(self, hue_tolerance, c1, c2):
        # Eq. 3 of the paper, (1 − α) c₁ ⊕ α c₂: from one hue to the other through grey [R3].
        steps = 2000
        alpha = np.linspace(0, 1, steps + 1)[:, None]
        c1, c2 = np.array(c1), np.array(c2)
        result = hue_add((1 - alpha) * c1, alpha * c2, hue_tolerance=hue_tolerance)
        changes = np.linalg.norm(np.diff(result, axis=0), axis=1)
        assert changes.max() <= (np.linalg.norm(c1) + np.linalg.norm(c2)) * 2 / steps
        chromas = np.array([chroma(c) for c in result])
        grey = int(chromas.argmin())
        assert 0 < grey < steps
        assert chromas[grey] <= (chroma(c1) + chroma(c2)) / steps
        assert all(angle_deg(c, c1) <= ANGLE_DEG for c in result[: grey - 1])
        assert all(angle_deg(c, c2) <= ANGLE_DEG for c in result[grey + 2 :])

    @given(hue=hues, other=hues, m=chromas, exponent=st.integers(-300, -13))
    def test_a_vanishing_colour_changes_nothing(self, hue, other, m, exponent):
        c = np.array(color_of(hue, m, 1))
        tiny = np.array(color_of(other, 10.0**exponent, 0.0))
        for hue_tolerance in HUE_TOLERANCES:
            assert_near(hue_add(c, tiny, hue_tolerance=hue_tolerance), c, FLOAT64)


class TestGrayBias:
    """§1.7: hues cancel (small/big)^(1 + 3b) of the stronger one; at b = 0 ⊕ is the paper's."""

    @given(pair=any_pairs, hue_tolerance=hue_tolerances, gray_bias=gray_biases)
    def test_is_the_oracles(self, pair, hue_tolerance, gray_bias):
        c1, c2, size = colors(pair)
        expected = oracle.hue_add(pair[0][:3], pair[1][:3], hue_tolerance, gray_bias)
        actual = hue_add(c1, c2, hue_tolerance=hue_tolerance, gray_bias=gray_bias)
        assert_near(actual, expected, tolerance_of(hue_tolerance), size)

    @given(pair=any_pairs, hue_tolerance=hue_tolerances)
    def test_none_is_the_paper_to_the_last_bit(self, pair, hue_tolerance):
        c1, c2, _ = colors(pair)
        expected = hue_add(c1, c2, hue_tolerance=hue_tolerance)
        actual = hue_add(c1, c2, hue_tolerance=hue_tolerance, gray_bias=0)
        assert actual.tobytes() == expected.tobytes()

    @pytest.mark.parametrize(
        ("gray_bias", "kept"), [(0.0, 1 / 2), (1 / 3, 3 / 4), (2 / 3, 7 / 8), (1.0, 15 / 16)]
    )
    def test_half_as_strong_a_rival(self, gray_bias, kept):
        c1, c2 = color_of(20, 0.2, 0.5), color_of(140, 0.1, 0.25)
        for a, b in ((c1, c2), (c2, c1)):
            result = hue_add(np.array(a), np.array(b), gray_bias=gray_bias)
            assert_near(result, color_of(20, 0.2 * kept, 0.75), FLOAT64)

    @given(
        pair=any_pairs,
        hue_tolerance=hue_tolerances,
        biases=st.tuples(gray_biases, gray_biases).map(sorted),
    )
    def test_the_more_of_it_the_more_chroma_up_to_plain_sums_of_lengths(
        self, pair, hue_tolerance, biases
    ):
        c1, c2, size = colors(pair)
        less, more = (hue_add(c1, c2, hue_tolerance=hue_tolerance, gray_bias=b) for b in biases)
        assert chroma(less) <= chroma(more) + tolerance_of(hue_tolerance) * size
        assert chroma(more) <= chroma(c1) + chroma(c2) + tolerance_of(hue_tolerance) * size

    @given(pair=any_pairs, hue_tolerance=hue_tolerances, gray_bias=gray_biases)
    def test_commutative_and_luminance_adds(self, pair, hue_tolerance, gray_bias):
        c1, c2, size = colors(pair)
        rules = {"hue_tolerance": hue_tolerance, "gray_bias": gray_bias}
        result = hue_add(c1, c2, **rules)
        assert_near(result, hue_add(c2, c1, **rules), ROUNDING, size)
        expected = oracle.luminance(pair[0]) + oracle.luminance(pair[1])
        assert_near(oracle.luminance(result), expected, ROUNDING, size)

    @given(pair=any_pairs, gray_bias=gray_biases, k=st.floats(1e-3, 1e3))
    def test_homogeneous(self, pair, gray_bias, k):
        c1, c2, size = colors(pair)
        expected = k * hue_add(c1, c2, gray_bias=gray_bias)
        assert_near(hue_add(k * c1, k * c2, gray_bias=gray_bias), expected, FLOAT64, k * size)

    @given(hue=hues, apart=st.floats(25, 180), m1=chromas, m2=chromas, gray_bias=gray_biases)
    def test_the_hue_is_that_of_the_stronger_one(self, hue, apart, m1, m2, gray_bias):
        assume(abs(m1 - m2) > HAS_HUE)
        c1, c2 = color_of(hue, m1, 1), color_of(hue + apart, m2, 1)
        result = hue_add(np.array(c1), np.array(c2), gray_bias=gray_bias)
        assert angle_deg(result, c1 if m1 > m2 else c2) <= ANGLE_DEG

    @pytest.mark.parametrize("gray_bias", [0.0, 0.01, 0.5, 1.0])
    @given(hue=hues, m1=chromas, m2=chromas)
    def test_opposite_hues_are_added_as_usual_without_it_alone(self, gray_bias, hue, m1, m2):
        c1, c2 = np.array(color_of(hue, m1, 1)), np.array(color_of(hue + 180, m2, 1))
        result = hue_add(c1, c2, gray_bias=gray_bias)
        ratio = min(m1, m2) / max(m1, m2)
        # What is left beyond |m1 − m2|; nothing where they are as strong as each other.
        more = max(m1, m2) * (ratio - ratio ** (1 + 3 * gray_bias))
        assert_near(chroma(result) - chroma(c1 + c2), more, FLOAT64)
        assert gray_bias == 0 or more > 0 or ratio == 1

    @given(hue=hues, m=chromas, gray_bias=gray_biases, data=st.data())
    def test_equal_hues_are_added_as_usual(self, hue, m, gray_bias, data):
        c1, c2 = (np.array(color_of(hue + data.draw(st.floats(0, 0.9)), m, 1)) for _ in range(2))
        assert_near(hue_add(c1, c2, gray_bias=gray_bias), c1 + c2, FLOAT64)

    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    @pytest.mark.parametrize("gray_bias", [0.1, 0.5, 1.0])
    def test_closed_in_gamut_on_its_edges(self, hue_tolerance, gray_bias):
        steps = np.array([0.0, 0.5, 1.0])
        points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        for alpha_1, alpha_2 in ((1, 1), (1, 0.25), (0.5, 0.75), (1, 0)):
            result = hue_add(
                alpha_1 * points[:, None],
                alpha_2 * points[None],
                hue_tolerance=hue_tolerance,
                gray_bias=gray_bias,
            )
            assert result.min() >= -ROUNDING
            assert result.max() <= alpha_1 + alpha_2 + ROUNDING

    @pytest.mark.parametrize("gray_bias", [0.0, 0.2, 1.0])
    @pytest.mark.parametrize("hue_tolerance", [0.5, 2.0, 30.0])
    def test_continuous_along_random_paths(self, hue_tolerance, gray_bias):
        # From corner to corner of the gamut, each colour on its own way: no step of the result is
        # longer than the stated multiple of the steps of both.
        rng = np.random.default_rng(14)
        corners = rng.random((2, 200, 3))
        corners[:, ::3] = corners[:, ::3].round()
        corners[1, ::7] = 0.4 * corners[0, ::7]  # through equal hues, and through grey
        corners[0, ::11] = 0.5
        steps = np.linspace(0, 1, 400, endpoint=False)[:, None, None]
        paths = corners[:, None, :-1] + steps * np.diff(corners, axis=1)[:, None]
        c1, c2 = (path.swapaxes(0, 1).reshape(-1, 3) for path in paths)
        result = hue_add(c1, c2, hue_tolerance=hue_tolerance, gray_bias=gray_bias)
        moved = sum(np.linalg.norm(np.diff(c, axis=0), axis=1) for c in (c1, c2))
        changes = np.linalg.norm(np.diff(result, axis=0), axis=1)
        slope = TestContinuity.slope(hue_tolerance, gray_bias)
        assert np.all(changes <= slope * moved + FLOAT64)
        # A switch without a shoulder would show: its jumps are many times as long.
        hard = hue_add(c1, c2, hue_tolerance=0, gray_bias=gray_bias)
        jumps = np.linalg.norm(np.diff(hard, axis=0), axis=1)
        assert hue_tolerance < 30 or np.any(jumps > 10 * slope * moved)

    @pytest.mark.parametrize("gray_bias", [-1e-9, -1.0, 1.001, math.nan, math.inf])
    def test_a_bias_out_of_range_is_an_error(self, gray_bias):
        with pytest.raises(SettingError, match=r"gray bias .* is outside 0 to 1"):
            hue_add(np.array(RED), np.array(BLUE), gray_bias=gray_bias)

    @pytest.mark.parametrize(("dtype", "tiny"), [(np.float64, 1e-310), (np.float32, 1e-40)])
    def test_subnormal_colours(self, dtype, tiny):
        small = (tiny * np.array(PRIMARIES)).astype(dtype)
        large = np.array(PRIMARIES, dtype)
        result = hue_add(large[:, None], small[None], gray_bias=1)
        assert_near(result, np.broadcast_to(large[:, None], result.shape), FLOAT32)


class TestForemost:
    def test_the_front_one_or_what_is_behind_it(self):
        front = np.array([[0.1, 0.0, 0.0, 1e-300, 0.0], [0.2, 0.0, -0.1, 0.0, -0.0]])
        behind = np.array([[1.0, 2.0, 3.0, 4.0, 5.0], [1.0, 1.0, 1.0, 1.0, 0.0]])
        expected = [[0.1, 2.0, 0.0, 1e-300, 5.0], [0.2, 1.0, -0.1, 0.0, 0.0]]
        for rules in ((2.0, 0.0), (0.0, 1.0)):
            both = np.array([front, behind])
            kept = addition.keep_foremost(front, behind, *rules)
            assert addition.added(both, kept).tolist() == expected
            kept = addition.keep_foremost_of_many(both, *rules)
            assert addition.added(both, kept).tolist() == expected

    def test_no_multiple_bounds_its_steps(self):
        # The paper: "little tints of close-by colors could completely change the final image".
        red = np.array([[0.5], [0.1]])
        for tint in (1e-1, 1e-3, 1e-9, 1e-300):
            veil = np.array([[0.0], [-tint]])
            with_veil, without = (
                addition.added((front, red), addition.keep_foremost(front, red, 2.0))
                for front in (veil, 0 * veil)
            )
            assert np.linalg.norm(with_veil - without) > 0.5


class TestPaleLabels:
    """Why the default is 2°: 8-bit rounding turns the hue of a pale label by up to about 2°."""

    #: Share of its chroma that a label loses to itself, on average over its shadings.
    LOST_AT_1 = (0.03, 0.07)
    LOST_AT_2 = (-1e-9, 0.002)

    @staticmethod
    def decoded(code):
        """sRGB, IEC 61966-2-1."""
        value = code / 255
        return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4

    @classmethod
    def shading(cls, hexadecimal, shade):
        """The label at `shade` times its linear light, as an 8-bit PNG stores it; linear."""
        c = []
        for start in (0, 2, 4):
            linear = shade * cls.decoded(int(hexadecimal[start : start + 2], 16))
            encoded = 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055
            c.append(cls.decoded(round(255 * encoded)))
        return c

    def lost(self, hexadecimal, hue_tolerance, dtype):
        """Mean share of chroma lost over every two shadings from 20% to 100%."""
        shadings = np.array([self.shading(hexadecimal, i / 100) for i in range(20, 101, 2)], dtype)
        c1, c2 = np.broadcast_arrays(shadings[:, None], shadings[None])
        mixed = hue_add(c1, c2, hue_tolerance=hue_tolerance).reshape(-1, 3).tolist()
        summed = (c1 + c2).reshape(-1, 3).tolist()
        return np.mean([1 - chroma(m) / chroma(s) for m, s in zip(mixed, summed, strict=True)])

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    @pytest.mark.parametrize("label", ["9ebcda", "d2b48c"])
    def test_a_pale_label_keeps_its_chroma_at_2_degrees_and_loses_at_1(self, label, dtype):
        low, high = self.LOST_AT_1
        assert low <= self.lost(label, 1.0, dtype) <= high
        low, high = self.LOST_AT_2
        # Single precision: the chroma of the result is a difference of larger numbers.
        rounding = 1e-6 if dtype == np.float32 else 0
        assert low - rounding <= self.lost(label, 2.0, dtype) <= high

    def test_two_shadings_one_and_a_half_degrees_apart(self):
        c1, c2 = (np.array(self.shading("9ebcda", shade)) for shade in (0.9, 0.45))
        assert 1.5 < angle_deg(c1, c2) < 1.75
        whole = chroma(c1 + c2)
        assert_near(chroma(hue_add(c1, c2, hue_tolerance=2)), whole, FLOAT64)
        assert chroma(hue_add(c1, c2, hue_tolerance=1)) < 0.8 * whole
        assert hue_add(c1, c2).tolist() == hue_add(c1, c2, hue_tolerance=2).tolist()


class TestTraditional:
    @given(pair=any_pairs, hue_tolerance=hue_tolerances)
    def test_is_plus(self, pair, hue_tolerance):
        p1, p2 = np.array(pair[0][:2]), np.array(pair[1][:2])
        for rules in ((hue_tolerance,), (hue_tolerance, 0.7)):
            kept = addition.keep_all(p1, p2, *rules)
            assert addition.added((p1, p2), kept).tolist() == (p1 + p2).tolist()


class TestRange:
    """Numbers of every size that the type holds: finite in, finite out, and no warning."""

    @pytest.mark.parametrize(("dtype", "tiny"), [(np.float64, 1e-310), (np.float32, 1e-40)])
    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    def test_subnormal_colours(self, dtype, tiny, hue_tolerance):
        # Thin layers under thin layers get there: 6e-8, the least half float, to the sixth power.
        small = (tiny * np.array([*PRIMARIES, (1, 1, 0), (0.3, 0.2, 0.9)])).astype(dtype)
        large = np.array([*PRIMARIES, (1, 1, 0), (0.3, 0.2, 0.9)], dtype)
        result = hue_add(large[:, None], small[None], hue_tolerance=hue_tolerance)
        assert_near(result, np.broadcast_to(large[:, None], result.shape), FLOAT32)
        result = hue_add(small[:, None], small[None], hue_tolerance=hue_tolerance)
        assert_near(result, np.zeros((5, 5, 3)), 4 * tiny)

    @pytest.mark.parametrize(("dtype", "huge"), [(np.float64, 1e300), (np.float32, 1e37)])
    @pytest.mark.parametrize("hue_tolerance", HUE_TOLERANCES)
    def test_huge_colours(self, dtype, huge, hue_tolerance):
        c1 = huge * np.array(color_of(10, 0.3, 0.5))
        c2 = huge * np.array(color_of(140, 0.2, 0.5))
        result = hue_add(c1.astype(dtype), c2.astype(dtype), hue_tolerance=hue_tolerance)
        assert_near(result / huge, color_of(10, 0.1, 1.0), FLOAT32)

    @example(pair=((5e-324, 0.0, 0.0, 0.0), (0.0, 0.0, 1e-320, 1.0)))
    @given(pair=st.tuples(*[st.tuples(*[st.floats(0, 1e-300)] * 3, alphas)] * 2))
    def test_any_tiny_pair(self, pair):
        c1, c2, _ = colors(pair)
        assert_near(hue_add(c1, c2), c1 + c2, 1, 4e-300)
        opaque = np.array(RED)
        assert_near(hue_add(opaque, c2), opaque, ROUNDING)


class TestArguments:
    @pytest.mark.parametrize("shape", [(), (0,), (7,), (2, 3), (0, 4)])
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_colours_last_any_leading_shape(self, shape, dtype):
        c1, c2 = np.random.default_rng(4).random((2, *shape, 3)).astype(dtype)
        before = c1.copy(), c2.copy()
        result = hue_add(c1, c2)
        assert result.shape == (*shape, 3)
        assert result.dtype == dtype
        assert np.array_equal(c1, before[0])
        assert np.array_equal(c2, before[1])
        for index in np.ndindex(shape):
            assert result[index].tolist() == hue_add(c1[index], c2[index]).tolist()

    def test_broadcast(self):
        c1, c2 = np.random.default_rng(5).random((5, 1, 3)), np.random.default_rng(6).random((4, 3))
        result = hue_add(c1, c2)
        assert result.shape == (5, 4, 3)
        for i, j in np.ndindex(5, 4):
            assert result[i, j].tolist() == hue_add(c1[i, 0], c2[j]).tolist()

    def test_lists_are_colours_too(self):
        assert_near(hue_add([1, 0, 0], [0, 0, 1]), oracle.hue_add(RED, BLUE), FLOAT32)

    @pytest.mark.parametrize("shape", [(), (2,), (4,), (3, 4), (0,)])
    def test_anything_but_three_components_is_an_error(self, shape):
        with pytest.raises(HpcompError):
            hue_add(np.zeros(shape), np.zeros(shape))

    def test_an_unknown_space_is_an_error_that_lists_the_valid_ones(self):
        with pytest.raises(SettingError, match="linear-rgb"):
            hue_add(np.array(RED), np.array(BLUE), space="rgb")


def test_the_helpers_of_these_tests_build_what_they_say():
    for hue in (0, 77, 200):
        c = color_of(hue, 0.2, 0.4)
        assert_near(oracle.luminance(c), 0.4, ROUNDING)
        assert_near(chroma(c), 0.2, ROUNDING)
        assert_near(math.degrees(oracle.angle(difference(c), hue_direction(hue))), 0, ANGLE_DEG)
        edge = valid_color(hue, 1.0, 0.4, 0.5)
        assert_near(oracle.luminance(edge), 0.2, ROUNDING)
        assert min(edge) == 0 or max(edge) == 0.5
